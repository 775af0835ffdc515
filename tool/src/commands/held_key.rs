//! The dead man's key of a terminal. A terminal does not report a released key, but repeats a held key: the motors go
//! on when Space repeats, and off when it no longer repeats. Each message to the board contains the newest control step
//! that was known before the key was pressed.

use crossterm::event::{self, Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use crossterm::terminal;
use haptic_show::view::message::FromPage;
use std::io;
use std::time::{Duration, Instant};

/// Longest delay between the first press of a held key and its first repeat. Terminals take 250 to 660 ms.
const MAX_REPEAT_DELAY: Duration = Duration::from_millis(1000);
/// Longest pause between repeats before the key counts as released.
const MAX_REPEAT_PAUSE: Duration = Duration::from_millis(400);

#[derive(Debug, Default)]
pub struct HeldKey {
    /// Time of the last Space.
    pressed: Option<Instant>,
    /// True while the motors are requested.
    on: bool,
    /// Newest control step that was known when the terminal had no more keys; later keys were pressed after that step.
    seen: u32,
}

impl HeldKey {
    /// Handles a Space. Returns the message for the board.
    pub fn handle_space(&mut self, now: Instant) -> Option<FromPage> {
        let repeats = self.pressed.is_some_and(|before| now.duration_since(before) <= MAX_REPEAT_DELAY);
        self.pressed = Some(now);
        match (self.on, repeats) {
            (true, _) => Some(FromPage::Hold { seen: self.seen }),
            (false, true) => {
                self.on = true;
                Some(FromPage::Arm { seen: self.seen })
            }
            (false, false) => None,
        }
    }

    /// Handles a moment without more keys at the board's control step `step`. Returns the message for the board.
    pub fn handle_pause(&mut self, now: Instant, step: u32) -> Option<FromPage> {
        self.seen = step;
        let silent = self.pressed.is_none_or(|before| now.duration_since(before) > MAX_REPEAT_PAUSE);
        (self.on && silent).then(|| self.release())
    }

    pub fn release(&mut self) -> FromPage {
        self.forget();
        FromPage::Release {}
    }

    /// Reads the keys of a raw terminal at control step `step`. Returns the message for the board; `None` ends.
    pub fn read_keys(&mut self, step: u32) -> io::Result<Option<Option<FromPage>>> {
        let mut message = None;
        while event::poll(Duration::ZERO)? {
            match event::read()? {
                Event::Key(key) if key.kind == KeyEventKind::Release => {}
                Event::Key(key) if is_end(&key) => return Ok(None),
                Event::Key(key) if key.code == KeyCode::Char(' ') => {
                    message = self.handle_space(Instant::now()).or(message)
                }
                Event::Key(_) => message = Some(self.release()),
                _ => {}
            }
        }
        let release = self.handle_pause(Instant::now(), step);
        Ok(Some(message.or(release)))
    }

    /// Forgets the key after something else turned the motors off, so that the key must be pressed again.
    pub fn forget(&mut self) {
        (self.pressed, self.on) = (None, false);
    }
}

/// Runs `work` while the terminal reports every key immediately and does not echo keys.
pub fn in_raw_terminal<T>(work: impl FnOnce() -> T) -> io::Result<T> {
    terminal::enable_raw_mode()?;
    let done = work();
    terminal::disable_raw_mode()?;
    Ok(done)
}

/// Returns true if a key ends the command: `q`, Ctrl-C, Ctrl-D.
fn is_end(key: &KeyEvent) -> bool {
    let control = key.modifiers.contains(KeyModifiers::CONTROL);
    matches!(key.code, KeyCode::Char('q')) || control && matches!(key.code, KeyCode::Char('c' | 'd'))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_repeating_key_arms_and_the_end_of_its_repeats_releases() {
        let (mut held, began) = (HeldKey::default(), Instant::now());
        let at = |ms: u64| began + Duration::from_millis(ms);
        assert_eq!(held.handle_space(at(0)), None, "one press alone does not hold");
        assert_eq!(held.handle_pause(at(500), 10), None);
        // The last pause gives the step, because the Spaces may have waited in the terminal since then.
        assert_eq!(held.handle_space(at(600)), Some(FromPage::Arm { seen: 10 }));
        assert_eq!(held.handle_space(at(640)), Some(FromPage::Hold { seen: 10 }));
        assert_eq!(held.handle_pause(at(1000), 20), None);
        assert_eq!(held.handle_pause(at(1041), 21), Some(FromPage::Release {}));
        assert_eq!(held.handle_pause(at(5000), 99), None);
        assert_eq!(held.handle_space(at(5000)), None, "after a release, one press does not hold");
        assert_eq!(held.handle_space(at(6001)), None, "two presses far apart do not hold");
    }
}
