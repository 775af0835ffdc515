//! `haptic view`: shows a board, real or simulated, on a page in the browser.

use super::interrupt;
use super::port::{Port, parse_address};
use super::stream::parse_positive;
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

/// Interval between attempts to reopen a lost board, long enough for other tools to connect in between.
const RETRY_INTERVAL: Duration = Duration::from_millis(500);

const DEFAULT_PORT: u16 = 7720;

/// Watch a device in the browser: walls to drag, gains to change, signals, recording
///
/// Serves one page until Ctrl-C; the whole page is inside this tool and loads nothing from elsewhere. A board's motors
/// are on only while a key (Space) is held on the page in command: releasing the key, closing the page or losing the
/// network turns them off.
///
/// If the board is unplugged, the command waits for it. Over ssh, forward the page's port: ssh -L 7720:localhost:7720 HOST.
///
/// With --port sim the mouse is a hand on a simulated device. Without DEVICE this is the device of `haptic demo`, with
/// less dry friction and finer encoders, in front of a wall that buzzes without the feed-forward and is quiet with it;
/// until the first touch it runs by itself.
#[derive(clap::Args)]
pub struct Args {
    /// Device file (TOML); its links are drawn [default: only the tip of the board's device is drawn]
    device: Option<PathBuf>,
    #[command(flatten)]
    port: Port,
    /// With --port sim: scene file (TOML) [default: one wall in front of the tip]
    #[arg(long, value_name = "FILE")]
    scene: Option<PathBuf>,
    /// Address to listen on: PORT for this computer only, or HOST:PORT for others, who then need the token in the
    /// printed address [default: 7720, or a free port if that is taken]
    #[arg(long, value_name = "ADDRESS")]
    listen: Option<String>,
    /// Folder for recordings
    #[arg(long, value_name = "FOLDER", default_value = ".")]
    record_to: PathBuf,
    /// Rows a second to read, at most the control rate [default: as many as the link carries]
    #[arg(long, value_name = "HZ", value_parser = parse_positive)]
    rate: Option<f64>,
}

/// The board to show, and the options of the view.
pub(super) struct View {
    port: Port,
    file: Option<DeviceFile>,
    /// The scene, and the name of its file for links to the page.
    scene: Option<(Scene<f32>, Option<String>)>,
    rate: Option<f64>,
    folder: PathBuf,
}

impl View {
    fn load(
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
                return Err(Failure::wrong("--scene applies only to --port sim; a board keeps its scene")
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

    /// Tries to reopen a lost board. The error is the reason if the board is connected again but lacks something for a
    /// view, or `None` while it is gone. Meanwhile other tools may load the missing device or scene.
    fn reopen(&self, hub: &Hub) -> Result<Stage, Option<String>> {
        let back = |why: &dyn Display| Some(format!("the board is connected again, but {why}"));
        let mut world = self.open().map_err(|_| None)?;
        match world.missing_setting() {
            Ok(None) => Stage::open(world, hub.clone(), self.rate, Some(self.folder.clone())).map_err(|why| back(&why)),
            Ok(Some(refusal)) => Err(back(&refusal)),
            Err(_) => Err(None),
        }
    }

    /// Shows the board until `stop`. Waits for a board that was unplugged, also if it returns without its device or
    /// scene. Calls `opened` once when the view begins, and `lost` with the reason whenever a wait begins.
    pub(super) fn show(
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
            // Keeps the pages open, and closes the port of the lost board.
            drop(stage);
            let mut why = error.to_string();
            lost(&why);
            stage = loop {
                if stop.load(Ordering::SeqCst) {
                    return Err(error.into());
                }
                let notice = serde_json::json!({"is": "lost", "why": why}).to_string();
                hub.with_every_outbox(|outbox| outbox.queue_document(notice.clone()));
                thread::sleep(RETRY_INTERVAL);
                match self.reopen(hub) {
                    Ok(stage) => break stage,
                    Err(Some(reason)) if reason != why => {
                        lost(&reason);
                        why = reason;
                    }
                    Err(_) => {}
                }
            };
            // Drops old messages, so that no page is in command of a reopened board.
            hub.drop_incoming();
        }
    }
}

pub fn run(args: Args) -> Result<(), Failure> {
    let stop = interrupt::watch();
    let view = View::load(args.port, args.device.as_ref(), args.scene.as_ref(), args.rate, args.record_to)?;
    let hub = Hub::default();
    let opened = || {
        let listener = match &args.listen {
            Some(text) => {
                let address = parse_address(text, "--listen")?;
                PageListener::open(address).map_err(|error| {
                    Failure::impossible(format!("cannot listen on {address}: {error}"))
                        .remedy("choose another --listen PORT")
                })?
            }
            None => PageListener::open((Ipv4Addr::LOCALHOST, DEFAULT_PORT).into())
                .or_else(|_| PageListener::open((Ipv4Addr::LOCALHOST, 0).into()))
                .map_err(Failure::impossible)?,
        };
        let url = listener.url().map_err(Failure::impossible)?;
        let scope = match listener.reach().map_err(Failure::impossible)? {
            Reach::Address => "",
            Reach::Others => ", here or on another computer of this network",
            Reach::Unknown => " on this computer; on other computers replace its address by this computer's",
        };
        print(&format!("open {url} in a browser{scope}\nCtrl-C ends it\n"))?;
        listener.serve(hub.clone());
        Ok(())
    };
    view.show(&hub, stop.flag(), opened, |lost| haptic_host::tell!("{lost}; waiting for it"))
}
