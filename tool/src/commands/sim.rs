//! `haptic sim`: runs a simulated board until interrupted, on a port that any command can open.

use super::interrupt;
use super::port::parse_address;
use clap::ValueEnum;
use haptic_host::device_file::DeviceFile;
use haptic_host::error::{Failure, print};
use haptic_host::scene_file::SceneFile;
use haptic_sim::door::{Patience, tcp};
use haptic_sim::server::{Pace, serve};
use haptic_sim::{BoardOptions, DriveModel, HandLoop, HandSettings, SHIPPED_DEVICE, Support, ready_board};
use std::path::PathBuf;

/// Run a simulated board with a device on it, until Ctrl-C
///
/// The board runs the firmware's own control code on a nonlinear simulation of the device and uses the real protocol on
/// a pseudo-terminal, or on TCP with --tcp. The device is loaded, and the board is ready for a scene. If the device has
/// weight, the simulation carries it until the motors are armed for the first time and their torque has ramped up.
#[derive(clap::Args)]
pub struct Args {
    /// Device file (TOML) [default: the coupled five-bar of this tool]
    device: Option<PathBuf>,
    /// Scene file (TOML) to load as well
    #[arg(long, value_name = "FILE")]
    scene: Option<PathBuf>,
    /// Listen on this TCP address instead of a pseudo-terminal: PORT or HOST:PORT
    #[arg(long, value_name = "ADDRESS")]
    tcp: Option<String>,
    /// Let simulated time pass as fast as possible while a tool is connected
    #[arg(long)]
    fast: bool,
    /// Require the same steps as a real board: verified motors, limits, homing, polarity check. The simulation holds
    /// the device, at home when the board starts and again after a polarity check, until the motors are armed for the
    /// first time and their torque has ramped up
    #[arg(long)]
    strict: bool,
    /// Behaviour of the simulated hand
    #[arg(long, value_name = "KIND", default_value = "none")]
    hand: HandKind,
    /// Leave friction out of the simulated device
    #[arg(long)]
    frictionless: bool,
    /// Apply commanded torques at once, without bridges, windings and a current loop
    #[arg(long)]
    ideal_drive: bool,
    /// Number of motor axes of the board
    #[arg(long, value_name = "COUNT", default_value_t = 3, value_parser = clap::value_parser!(u8).range(1..=3))]
    axes: u8,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum HandKind {
    /// No hand
    None,
    /// A hand that moves the tip around a small loop repeatedly while the motors are armed, on a wall of the scene if
    /// it can reach one
    Loop,
}

pub fn run(args: Args) -> Result<(), Failure> {
    let file = match &args.device {
        Some(path) => DeviceFile::load(path)?,
        None => DeviceFile::parse(SHIPPED_DEVICE, "coupled-five-bar.toml")?,
    };
    let joints = file.spec().joints;
    if joints > usize::from(args.axes) {
        let reason =
            format!("{} has {joints} joints, and --axes {} gives the board only {}", file.name, args.axes, args.axes);
        return Err(Failure::wrong(reason).remedy("leave out --axes, or name a device with fewer joints"));
    }
    let mut options = BoardOptions {
        drive: if args.ideal_drive { DriveModel::Ideal } else { DriveModel::Electric },
        strict: args.strict,
        support: match args.strict {
            true => Support::Held,
            false if file.description.gravity == [0.0; 3] => Support::None,
            false => Support::Carried,
        },
        axes: args.axes.into(),
        ..BoardOptions::default()
    };
    options.device.friction = !args.frictionless;
    let wrong = |error: &dyn std::fmt::Display| Failure::wrong(format!("{}: {error}", file.path.display()));
    let mut board = ready_board(&file, options).map_err(|error| wrong(&error))?;
    let mut walls = None;
    if let Some(path) = &args.scene {
        let unusable = |error: &dyn std::fmt::Display| Failure::wrong(format!("{}: {error}", path.display()));
        let loaded = SceneFile::load(path, file.spec().task)?;
        walls = Some(loaded.scene::<f64>().map_err(|error| unusable(&error))?);
        let scene = loaded.scene::<f32>().map_err(|error| unusable(&error))?;
        board.load(&file.name, &file.description, Some(scene)).map_err(|refusal| wrong(&refusal))?;
    }
    if args.hand == HandKind::Loop {
        let tip = board.device().tip();
        let settings = HandSettings { tremor: 2e-4, ..HandSettings::default() };
        let path = HandLoop::find(&file, walls.as_ref(), tip);
        if args.scene.is_some() && !path.on_a_wall {
            haptic_host::tell!("the hand cannot reach a wall of the scene from home: it moves in free space");
        }
        board.set_hand_loop(settings, path);
    }
    let listener = match &args.tcp {
        Some(text) => {
            let address = parse_address(text, "--tcp")?;
            tcp(address, Patience::default()).map_err(|error| {
                Failure::impossible(format!("cannot listen on {address}: {error}")).remedy("choose another --tcp PORT")
            })?
        }
        None => pseudo_terminal()?,
    };
    let pace = if args.fast { Pace::AsFastAsItCan } else { Pace::RealTime };
    let stop = interrupt::watch();
    print(&format!(
        "a simulated board with {} is on {}\ntry: haptic info --port {}\nCtrl-C ends it\n",
        file.name, listener.port, listener.port
    ))?;
    serve(&mut board, &listener, pace, stop.flag());
    haptic_host::tell!("simulated {:.3} s", board.time());
    Ok(())
}

#[cfg(unix)]
fn pseudo_terminal() -> Result<haptic_sim::door::ToolListener, Failure> {
    haptic_sim::door::pseudo_terminal().map_err(|error| {
        Failure::impossible(format!("cannot open a pseudo-terminal: {error}")).remedy("use --tcp PORT")
    })
}

#[cfg(not(unix))]
fn pseudo_terminal() -> Result<haptic_sim::door::ToolListener, Failure> {
    Err(Failure::wrong("this system has no pseudo-terminals").remedy("use --tcp PORT"))
}
