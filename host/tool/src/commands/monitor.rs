//! `haptic view --terminal`: the page of `haptic view` in a terminal.

use super::interrupt;
use super::view::Shown;
use haptic_host::error::Failure;
use haptic_show::monitor;
use haptic_show::view::hub::Hub;
use std::io::IsTerminal;
use std::sync::atomic::Ordering;
use std::thread;

/// Refuses to draw where there is no terminal.
pub fn check() -> Result<(), Failure> {
    if !std::io::stdout().is_terminal() {
        return Err(
            Failure::wrong("this is no terminal that could be drawn on").remedy("see haptic stream, haptic record")
        );
    }
    Ok(())
}

/// Shows the board until `q`.
pub fn run(shown: &Shown) -> Result<(), Failure> {
    let stop = interrupt::watch().flag();
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
