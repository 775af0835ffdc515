//! `haptic monitor`: the page of `haptic view` in a terminal.

use super::interrupt;
use super::port::Port;
use super::view::{Shown, rate};
use haptic_host::error::Failure;
use haptic_show::monitor;
use haptic_show::view::hub::Hub;
use std::io::IsTerminal;
use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::thread;

/// Look at a device in the terminal: signals, tip and walls, gains by key, recording
///
/// Works over ssh. Motors are on only while Space is held: a terminal repeats a key that is held, and once it no longer
/// does, the motors go off. A board that is unplugged is waited for. The last line of the screen lists the keys.
///
/// With --port sim the arrow keys lead a hand on a simulated device. Without DEVICE it is that of `haptic demo`.
#[derive(clap::Args)]
pub struct Args {
    /// Device file (TOML), for its links [default: a board's tip is drawn without them]
    device: Option<PathBuf>,
    #[command(flatten)]
    port: Port,
    /// On --port sim: scene file (TOML) [default: one wall in front of the tip]
    #[arg(long, value_name = "FILE")]
    scene: Option<PathBuf>,
    /// Where recordings go
    #[arg(long, value_name = "FOLDER", default_value = ".")]
    record_to: PathBuf,
    /// Rows a second, at most the control rate [default: as many as the link carries]
    #[arg(long, value_name = "HZ", value_parser = rate)]
    rate: Option<f64>,
}

/// Shows the board until `q`.
pub fn run(args: Args) -> Result<(), Failure> {
    if !std::io::stdout().is_terminal() {
        return Err(
            Failure::wrong("this is no terminal that could be drawn on").remedy("see haptic stream, haptic record")
        );
    }
    let stop = interrupt::watch().flag();
    let shown = Shown::of(args.port, args.device.as_ref(), args.scene.as_ref(), args.rate, args.record_to)?;
    let hub = Hub::default();
    let mut screen = None;
    let opened = || {
        let hub = hub.clone();
        screen = Some(thread::spawn(move || monitor::run(&hub, stop)));
        Ok(())
    };
    let played = shown.play(&hub, stop, opened, |_| {});
    // The terminal is itself again before anything is said on it.
    let ended = stop.swap(true, Ordering::SeqCst);
    let drawn = screen.map_or(Ok(Ok(())), thread::JoinHandle::join);
    match (played, drawn) {
        // Whoever ended it while a board was waited for did so knowingly.
        (Err(_), _) if ended => Ok(()),
        (Err(failure), _) => Err(failure),
        (Ok(()), Ok(Err(error))) => Err(Failure::impossible(format!("the terminal cannot be drawn on: {error}"))),
        (Ok(()), _) => Ok(()),
    }
}
