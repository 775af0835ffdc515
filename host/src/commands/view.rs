//! `haptic view`: a page in the browser on a board, or on a simulated one with a hand to lead.

use super::port::{Port, address};
use haptic::device_file::DeviceFile;
use haptic::error::{Failure, print};
use haptic::interrupt;
use haptic::link::PortSpec;
use haptic::scene_file::SceneFile;
use haptic::view::hub::Hub;
use haptic::view::{Door, Stage, World};
use std::net::Ipv4Addr;
use std::path::PathBuf;
use std::thread;
use std::time::Duration;

/// Where the page is unless asked otherwise.
const USUAL_PORT: u16 = 7720;

/// Look at a device in the browser: walls to drag, gains to turn, an oscilloscope
///
/// Serves one page until Ctrl-C; what it shows is inside this tool, nothing is loaded from elsewhere. Motors are on only
/// while somebody holds a key (Space) on the page in command: letting go, closing the page or losing the network turns
/// them off.
///
/// With --port sim the mouse is a hand on a simulated device. Without DEVICE it is that of `haptic demo`, with a wall that
/// buzzes without the feed-forward and is quiet with it.
#[derive(clap::Args)]
pub struct Args {
    /// Device file (TOML), for its links [default: a board's tip is drawn without them]
    device: Option<PathBuf>,
    #[command(flatten)]
    port: Port,
    /// On --port sim: scene file (TOML) [default: one wall in front of the tip]
    #[arg(long, value_name = "FILE")]
    scene: Option<PathBuf>,
    /// Where to listen: PORT on this computer, or HOST:PORT for others, who then need the token in the printed address
    /// [default: 7720, or a free port where that is taken]
    #[arg(long, value_name = "ADDRESS")]
    listen: Option<String>,
    /// Rows a second that the page is told of, at most the control rate [default: as many as the link carries]
    #[arg(long, value_name = "HZ", value_parser = rate)]
    rate: Option<f64>,
}

fn rate(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value > 0.0 => Ok(value),
        Ok(_) => Err("must be greater than zero".into()),
        Err(_) => Err("not a number".into()),
    }
}

/// Serves the page.
pub fn run(args: Args) -> Result<(), Failure> {
    let stop = interrupt::watch();
    let named = match args.port.spec() {
        PortSpec::Sim(Some(path)) => Some(path),
        _ => args.device.as_ref(),
    };
    let file = named.map(DeviceFile::load).transpose()?;
    let simulated = matches!(args.port.spec(), PortSpec::Sim(_));
    let scene = match &args.scene {
        None => None,
        Some(_) if !simulated => {
            return Err(Failure::wrong("--scene is for --port sim; a board keeps the scene it has")
                .remedy("load it first: haptic scene FILE"));
        }
        Some(path) => {
            let task = file.as_ref().map(|file| file.spec().task).ok_or_else(|| {
                Failure::wrong("--scene without a device file").remedy("name the device: haptic view DEVICE --port sim")
            })?;
            let scene = SceneFile::load(path, task)?.scene::<f32>();
            Some(scene.map_err(|error| Failure::wrong(format!("{}: {error}", path.display())))?)
        }
    };
    let open = |file: Option<DeviceFile>, scene| match (simulated, file) {
        (true, None) => World::demo(),
        (true, Some(file)) => World::simulate(file, scene),
        (false, file) => Ok(World::of(args.port.open()?, file)),
    };
    let mut world = open(file.clone(), scene)?;

    let door = match &args.listen {
        Some(text) => {
            let address = address(text, "--listen")?;
            Door::open(address).map_err(|error| {
                Failure::impossible(format!("cannot listen on {address}: {error}"))
                    .remedy("choose another --listen PORT")
            })?
        }
        None => Door::open((Ipv4Addr::LOCALHOST, USUAL_PORT).into())
            .or_else(|_| Door::open((Ipv4Addr::LOCALHOST, 0).into()))
            .map_err(Failure::impossible)?,
    };
    let url = door.url().map_err(Failure::impossible)?;
    let (hub, events) = Hub::new();
    let mut door = Some(door);
    loop {
        let mut stage = Stage::open(&mut world, &hub, &events, args.rate)?;
        if let Some(door) = door.take() {
            print(&format!("open {url} in a browser\nCtrl-C ends it\n"))?;
            door.serve(hub.clone());
        }
        let Err(lost) = stage.run(stop.flag()) else { return Ok(()) };
        if simulated {
            return Err(lost.into());
        }
        // A board that was unplugged is waited for; the pages stay, and say so. Its port is closed first.
        drop(world);
        haptic::tell!("{lost}; waiting for it");
        let why = serde_json::json!({"is": "lost", "why": lost.to_string()}).to_string();
        world = loop {
            if stop.is_set() {
                return Err(lost.into());
            }
            hub.to_all(|outbox| outbox.messages.push_back(why.clone()));
            thread::sleep(Duration::from_millis(500));
            if let Ok(back) = open(file.clone(), None) {
                break back;
            }
        };
        // Nobody is in command of a board that has just come back.
        while events.try_recv().is_ok() {}
    }
}
