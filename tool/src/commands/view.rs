//! `haptic view`: a page in the browser, for a board or for a simulated one with a hand to lead.

use super::interrupt;
use super::port::{Port, address};
use super::stream::positive;
use haptic_bridge::render::scene::Scene;
use haptic_host::device_file::DeviceFile;
use haptic_host::error::{Failure, print};
use haptic_host::link::PortSpec;
use haptic_host::output;
use haptic_host::scene_file::SceneFile;
use haptic_show::view::hub::Hub;
use haptic_show::view::{PageListener, Reach, Stage, World};
use std::fmt::Display;
use std::net::Ipv4Addr;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

/// Between two looks for a board that is waited for: long enough for other tools to come in between.
const AGAIN: Duration = Duration::from_millis(500);

/// The default port of the page.
const USUAL_PORT: u16 = 7720;

/// Look at a device in the browser: walls to drag, gains to turn, signals, recording
///
/// Serves one page until Ctrl-C; what it shows is inside this tool, nothing is loaded from elsewhere. Motors are on
/// only while somebody holds a key (Space) on the page in command: letting go, closing the page or losing the network
/// turns them off.
///
/// A board that is unplugged is waited for. Over ssh, forward the page's port: ssh -L 7720:localhost:7720 HOST.
///
/// With --port sim the mouse is a hand on a simulated device. Without DEVICE it is that of `haptic demo`, with less dry
/// friction and finer encoders, before a wall that buzzes without the feed-forward and is quiet with it.
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
    /// Where recordings go
    #[arg(long, value_name = "FOLDER", default_value = ".")]
    record_to: PathBuf,
    /// Rows a second that are looked at, at most the control rate [default: as many as the link carries]
    #[arg(long, value_name = "HZ", value_parser = positive)]
    rate: Option<f64>,
}

/// The board to look at, and how often.
pub(super) struct Shown {
    port: Port,
    file: Option<DeviceFile>,
    /// The scene, and the name of its file.
    scene: Option<(Scene<f32>, Option<String>)>,
    rate: Option<f64>,
    folder: PathBuf,
}

impl Shown {
    /// Reads the files.
    fn of(
        port: Port,
        device: Option<&PathBuf>,
        scene: Option<&PathBuf>,
        rate: Option<f64>,
        folder: PathBuf,
    ) -> Result<Self, Failure> {
        output::check_folder(&folder)?;
        let named = match port.spec() {
            PortSpec::Sim(Some(path)) => Some(path),
            _ => device,
        };
        let file = named.map(DeviceFile::load).transpose()?;
        let scene = match scene {
            None => None,
            Some(_) if !matches!(port.spec(), PortSpec::Sim(_)) => {
                return Err(Failure::wrong("--scene is for --port sim; a board keeps the scene it has")
                    .remedy("load it first: haptic scene FILE"));
            }
            Some(path) => {
                let task = file.as_ref().map(|file| file.spec().task).ok_or_else(|| {
                    Failure::wrong("--scene without a device file").remedy("name the device as well, before --port sim")
                })?;
                let scene = SceneFile::load(path, task)?.scene::<f32>();
                let scene = scene.map_err(|error| Failure::wrong(format!("{}: {error}", path.display())))?;
                Some((scene, path.file_stem().map(|name| name.to_string_lossy().into_owned())))
            }
        };
        Ok(Self { port, file, scene, rate, folder })
    }

    fn open(&self) -> Result<World, Failure> {
        let file = self.file.clone();
        match (matches!(self.port.spec(), PortSpec::Sim(_)), file) {
            (true, None) => World::demo(),
            (true, Some(file)) => {
                let (scene, scene_name) = self.scene.clone().unzip();
                Ok(World { scene_name: scene_name.flatten(), ..World::simulate(file, scene)? })
            }
            (false, file) => Ok(World::of(self.port.open()?, file)),
        }
    }

    /// Opens a lost board once it is back. The error is the reason, if it is back but cannot be shown yet; until then
    /// it is free for other tools, which may load what it lacks.
    fn open_again(&self, hub: &Hub) -> Result<Stage, Option<String>> {
        let here = |why: &dyn Display| Some(format!("the board is there again, but {why}"));
        let mut world = self.open().map_err(|_| None)?;
        match world.lacks() {
            Ok(None) => Stage::open(world, hub.clone(), self.rate, Some(self.folder.clone())).map_err(|why| here(&why)),
            Ok(Some(refusal)) => Err(here(&refusal)),
            Err(_) => Err(None),
        }
    }

    /// Plays until `stop`; a board that was unplugged is waited for, also where it comes back without its device or
    /// scene. `opened` is called once, when there is something to see, and `lost` with the reason whenever a board is
    /// waited for.
    pub(super) fn play(
        &self,
        hub: &Hub,
        stop: &AtomicBool,
        opened: impl FnOnce() -> Result<(), Failure>,
        lost: impl Fn(&str),
    ) -> Result<(), Failure> {
        let mut stage = Stage::open(self.open()?, hub.clone(), self.rate, Some(self.folder.clone()))?;
        opened()?;
        loop {
            let Err(error) = stage.run(stop) else { return Ok(()) };
            if matches!(self.port.spec(), PortSpec::Sim(_)) {
                return Err(error.into());
            }
            // The pages stay, and say so. The board's port is closed first.
            drop(stage);
            let mut why = error.to_string();
            lost(&why);
            stage = loop {
                if stop.load(Ordering::SeqCst) {
                    return Err(error.into());
                }
                let told = serde_json::json!({"is": "lost", "why": why}).to_string();
                hub.to_all(|outbox| outbox.tell(told.clone()));
                thread::sleep(AGAIN);
                match self.open_again(hub) {
                    Ok(back) => break back,
                    Err(Some(lacks)) if lacks != why => {
                        lost(&lacks);
                        why = lacks;
                    }
                    Err(_) => {}
                }
            };
            // No page is in command of a board that has just come back.
            hub.forget();
        }
    }
}

/// Serves the page.
pub fn run(args: Args) -> Result<(), Failure> {
    let stop = interrupt::watch();
    let shown = Shown::of(args.port, args.device.as_ref(), args.scene.as_ref(), args.rate, args.record_to)?;
    let hub = Hub::default();
    let opened = || {
        let door = match &args.listen {
            Some(text) => {
                let address = address(text, "--listen")?;
                PageListener::open(address).map_err(|error| {
                    Failure::impossible(format!("cannot listen on {address}: {error}"))
                        .remedy("choose another --listen PORT")
                })?
            }
            None => PageListener::open((Ipv4Addr::LOCALHOST, USUAL_PORT).into())
                .or_else(|_| PageListener::open((Ipv4Addr::LOCALHOST, 0).into()))
                .map_err(Failure::impossible)?,
        };
        let url = door.url().map_err(Failure::impossible)?;
        let whence = match door.reach().map_err(Failure::impossible)? {
            Reach::Address => "",
            Reach::Others => ", here or on another computer of this network",
            Reach::Unknown => " on this computer; on others put this computer's address in the place of the one here",
        };
        print(&format!("open {url} in a browser{whence}\nCtrl-C ends it\n"))?;
        door.serve(hub.clone());
        Ok(())
    };
    shown.play(&hub, stop.flag(), opened, |lost| haptic_host::tell!("{lost}; waiting for it"))
}
