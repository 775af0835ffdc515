//! `board [BOARD] [--device FILE.toml] [--tcp PORT] [--fast]` runs the real firmware on an emulated board with a
//! simulated device, for manual use. `cargo xtask board` runs this program.
//!
//! Prints the ports for `haptic --port …`, and the firmware's log as it arrives. Ctrl-C stops the board. With `--fast`,
//! virtual time runs as fast as the emulator can. Otherwise it follows the clock.
//! Exit codes: 1 if the board could not be started, 2 if the command is wrong.

mod bridge;
mod log;

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, Instant};

use haptic_emulator::boards::{BoardKind, Wiring};
use haptic_emulator::hardware::Hardware;
use haptic_emulator::image::Firmware;
use haptic_emulator::rig;
use haptic_emulator::run::{MILLISECOND, SECOND, VirtualBoard};
use haptic_host::device_file::DeviceFile;
use haptic_sim::{Options, PowerStage, SimulatedDevice};

use crate::bridge::{Outlet, TcpOutlet};
use crate::log::Decoder;

struct Arguments {
    board: BoardKind,
    device: PathBuf,
    port: u16,
    fast: bool,
}

fn main() -> ExitCode {
    let Some(arguments) = parse_arguments(std::env::args().skip(1)) else {
        let boards = BoardKind::ALL.map(BoardKind::name).join("|");
        eprintln!("usage: board [{boards}] [--device FILE.toml] [--tcp PORT] [--fast]");
        return ExitCode::from(2);
    };
    match run(&arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("board: {error}");
            ExitCode::from(1)
        }
    }
}

fn parse_arguments(mut words: impl Iterator<Item = String>) -> Option<Arguments> {
    let device = rig::devices().join("pantograph-mk2.toml");
    let mut arguments = Arguments { board: BoardKind::OdriveV3, device, port: 0, fast: false };
    while let Some(word) = words.next() {
        match word.as_str() {
            "--device" => arguments.device = words.next()?.into(),
            "--tcp" => arguments.port = words.next()?.parse().ok()?,
            "--fast" => arguments.fast = true,
            name => arguments.board = BoardKind::from_name(name)?,
        }
    }
    Some(arguments)
}

/// Writes a copy of the device file at `path` that can be armed, with verified motors, and with joint limits where the
/// file has none. This is safe because the board has no real motors.
fn ready_to_arm(path: &Path, file: &DeviceFile) -> std::io::Result<PathBuf> {
    let text = std::fs::read_to_string(path)?;
    let mut joints = file.description.joints.iter();
    let mut copy = String::new();
    for line in text.lines().filter(|line| !line.trim_start().starts_with("verified")) {
        copy += line;
        copy.push('\n');
        match line.split('#').next().unwrap_or("").trim() {
            "[[joint]]" => {
                let joint = joints.next();
                if joint.is_some_and(|joint| joint.limits.is_none()) {
                    copy += "limits = [-3.14, 3.14]\n";
                }
            }
            "[joint.motor]" => copy += "verified = true\n",
            _ => {}
        }
    }
    let place = std::env::temp_dir().join(format!("haptic-virtual-{}.toml", file.name));
    std::fs::write(&place, copy)?;
    Ok(place)
}

fn run(arguments: &Arguments) -> Result<(), Box<dyn std::error::Error>> {
    let wiring = Wiring::of_board(arguments.board);
    let file = DeviceFile::load(&arguments.device)?;
    let bridge = PowerStage { bus_voltage: wiring.bus_voltage, dead_time: wiring.dead_time, ..PowerStage::default() };
    let device = SimulatedDevice::new(&file.description, &Options { bridge, ..Options::default() })?;
    let firmware = Firmware::build(wiring.name)?;
    let decoder = Decoder::new(&firmware);
    let mut log = decoder.as_ref().map(Decoder::reader);
    let mut board = VirtualBoard::start(&firmware, Hardware::new(wiring, Box::new(device))?)?;

    // The ports are printed only when the board has tested itself and replies.
    if !board.run_until(2 * SECOND, MILLISECOND, |stopped| stopped.usb().is_ready()) {
        return Err("the firmware did not open its USB port within 2 s".into());
    }

    println!("{} with {}, firmware {}", wiring.name, file.name, firmware.path().display());
    let ready = ready_to_arm(&arguments.device, &file)?;
    let mut outlets: Vec<Box<dyn Outlet>> = Vec::new();
    let tcp = TcpOutlet::listen(arguments.port)?;
    println!("port: tcp:127.0.0.1:{}", tcp.port()?);
    outlets.push(Box::new(tcp));
    #[cfg(unix)]
    {
        let terminal = bridge::TerminalOutlet::new()?;
        println!("port: {}", terminal.path());
        outlets.push(Box::new(terminal));
    }

    println!("\nIn another terminal, with one of these ports:");
    let device = ready.display();
    println!("  haptic info --port PORT");
    println!("  haptic device {device} --port PORT    # the shipped file with joint limits and verified = true");
    println!("  haptic scene SCENE.toml --port PORT   # devices/scenes has some for {}", file.name);
    println!("  haptic home, polarity, arm, stream, disarm (--port PORT)\nCtrl-C ends the board. Its log:\n");

    let (began, started) = (Instant::now(), board.now());
    loop {
        board.run(MILLISECOND);
        let mut written = Vec::new();
        for outlet in &mut outlets {
            if outlet.is_open() {
                written.extend(outlet.read());
            }
        }
        let (sent, raw) = board.while_stopped(move |stopped| {
            stopped.usb().write(&written);
            (stopped.usb().take(), stopped.take_log())
        });
        for outlet in &mut outlets {
            outlet.write(&sent);
        }
        if let Some(log) = &mut log {
            for line in log.feed(&raw) {
                println!("{:10.3} {line}", board.now() as f64 * 1e-9);
            }
        }
        let ahead = Duration::from_nanos(board.now() - started).saturating_sub(began.elapsed());
        if !arguments.fast && ahead > Duration::ZERO {
            std::thread::sleep(ahead);
        }
    }
}
