//! The page of `haptic view` in a terminal (`haptic view --terminal`, docs/monitor.md): what is seen of a board
//! ([`seen`]), put on the screen ([`screen`]), and what keys say to it.
//!
//! It is one more page of the stage ([`crate::view::stage`]), in this process: everything that moves a board goes
//! through the same messages, with the same questions and the same dead man's key. A terminal does not tell when a key
//! is let go, but repeats one that is held: Space switches the motors on once it repeats, and they go off when it no
//! longer does. With each Space goes the newest control step that was known before it came, as far as the board.

pub mod screen;
pub mod seen;

use crate::view::hub::{Hub, PageId};
use crate::view::message::FromPage;
use ratatui::crossterm::event::{self, Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use ratatui::crossterm::terminal;
use seen::Seen;
use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Between two looks at keys and at what has come: a picture of the stage.
const LOOK: Duration = Duration::from_millis(16);
/// Longest time that a held key may take to begin repeating. Terminals take 250 to 660 ms.
const REPEAT: Duration = Duration::from_millis(1000);
/// Longest pause between repeats before the key counts as let go.
const LET_GO: Duration = Duration::from_millis(400);
/// A step of the hand, m; ten times as far with Shift.
const STEP: f64 = 5e-4;
/// A step of a gain.
const TURN: f32 = 1.05;

/// The dead man's key of a terminal.
#[derive(Debug, Default)]
pub struct HeldKey {
    /// When Space last came.
    pressed: Option<Instant>,
    /// True if the motors were asked for.
    on: bool,
    /// The newest control step that was known when no key was left in the terminal: whatever comes was pressed later.
    seen: u32,
}

impl HeldKey {
    /// Space has come: what to say.
    pub fn press(&mut self, now: Instant) -> Option<FromPage> {
        let repeats = self.pressed.is_some_and(|before| now.duration_since(before) <= REPEAT);
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

    /// No key is left in the terminal, and the board has told this control step before: what to say.
    pub fn wait(&mut self, now: Instant, step: u32) -> Option<FromPage> {
        self.seen = step;
        let silent = self.pressed.is_none_or(|before| now.duration_since(before) > LET_GO);
        (self.on && silent).then(|| self.release())
    }

    /// It is let go: what to say.
    pub fn release(&mut self) -> FromPage {
        self.forget();
        FromPage::Release {}
    }

    /// Reads the keys that came to a raw terminal, where the board has told this control step: what to say, or `None` where
    /// it is to end.
    pub fn listen(&mut self, step: u32) -> io::Result<Option<Option<FromPage>>> {
        let mut said = None;
        while event::poll(Duration::ZERO)? {
            match event::read()? {
                Event::Key(key) if key.kind == KeyEventKind::Release => {}
                Event::Key(key) if is_end(&key) => return Ok(None),
                Event::Key(key) if key.code == KeyCode::Char(' ') => said = self.press(Instant::now()).or(said),
                // Whatever else is pressed in a hurry is meant to stop them.
                Event::Key(_) => said = Some(self.release()),
                _ => {}
            }
        }
        let waited = self.wait(Instant::now(), step);
        Ok(Some(said.or(waited)))
    }

    /// Something else turned the motors off: the key has to be pressed again.
    pub fn forget(&mut self) {
        (self.pressed, self.on) = (None, false);
    }
}

/// Does something while this terminal gives every key at once and shows none.
pub fn in_raw_terminal<T>(work: impl FnOnce() -> T) -> io::Result<T> {
    terminal::enable_raw_mode()?;
    let done = work();
    terminal::disable_raw_mode()?;
    Ok(done)
}

/// Shows a board in this terminal until `q`, or until `stop` is set; it is set afterwards.
pub fn run(hub: &Hub, stop: &AtomicBool) -> io::Result<()> {
    let watched = match hub.come() {
        None => Ok(()),
        Some(id) => ratatui::try_init().and_then(|mut terminal| {
            let watched = watch(&mut terminal, hub, id, stop);
            ratatui::restore();
            hub.go(id);
            watched
        }),
    };
    stop.store(true, Ordering::SeqCst);
    watched
}

fn watch(terminal: &mut ratatui::DefaultTerminal, hub: &Hub, id: PageId, stop: &AtomicBool) -> io::Result<()> {
    let plain = is_plain(|name| std::env::var(name).ok());
    let mut seen = Seen::default();
    let mut held = HeldKey::default();
    let mut here = Instant::now();
    let say = |message: FromPage| hub.said(id, Ok(message));
    say(FromPage::Take {});
    while !stop.load(Ordering::SeqCst) {
        let waiting = hub.take(id);
        let mut news = waiting.scope.is_some() || waiting.picture.is_some() || !waiting.messages.is_empty();
        for text in waiting.messages.iter().chain(&waiting.picture) {
            if let Some(request) = seen.hear(text) {
                say(request);
            }
        }
        if let Some(sweep) = waiting.scope {
            seen.sweep(&sweep);
        }
        if held.on && seen.was_held() && !seen.held() {
            held.forget();
        }
        seen.remember_held(held.on);
        while event::poll(Duration::ZERO)? {
            news = true;
            match event::read()? {
                Event::Key(key) if key.kind != KeyEventKind::Release => {
                    if is_end(&key) {
                        return Ok(());
                    }
                    let words = if key.code == KeyCode::Char(' ') {
                        held.press(Instant::now()).into_iter().collect()
                    } else {
                        pressed(&mut seen, &key)
                    };
                    for message in words {
                        if matches!(message, FromPage::Disarm {}) {
                            held.forget();
                        }
                        say(message);
                    }
                }
                _ => {}
            }
        }
        held.wait(Instant::now(), seen.step()).into_iter().for_each(say);
        if here.elapsed() > Duration::from_secs(1) {
            here = Instant::now();
            say(FromPage::Here {});
        }
        if news {
            terminal.draw(|frame| {
                screen::draw(frame, &seen);
                if plain {
                    screen::in_ascii(frame.buffer_mut());
                }
            })?;
        }
        event::poll(LOOK)?;
    }
    Ok(())
}

/// Returns true if a terminal shows ASCII alone, by its environment: the first of the locale's variables that is set
/// decides, as it does for other programs, and two kinds of terminal have no Braille.
fn is_plain(variable: impl Fn(&str) -> Option<String>) -> bool {
    if matches!(variable("TERM").as_deref(), Some("dumb" | "linux")) {
        return true;
    }
    let set = |name: &&str| variable(name).filter(|value| !value.is_empty());
    let locale = ["LC_ALL", "LC_CTYPE", "LANG"].iter().find_map(set).unwrap_or_default().to_lowercase();
    // Windows has none of them.
    !(cfg!(windows) || locale.contains("utf-8") || locale.contains("utf8"))
}

/// Returns true if a key ends the display: `q`, Ctrl-C, Ctrl-D.
fn is_end(key: &KeyEvent) -> bool {
    let control = key.modifiers.contains(KeyModifiers::CONTROL);
    matches!(key.code, KeyCode::Char('q')) || control && matches!(key.code, KeyCode::Char('c' | 'd'))
}

/// The messages to the board that a pressed key stands for; keys for the screen change `seen`.
fn pressed(seen: &mut Seen, key: &KeyEvent) -> Vec<FromPage> {
    let far = if key.modifiers.contains(KeyModifiers::SHIFT) { 10.0 } else { 1.0 };
    let mut lead = |x: f64, y: f64| seen.lead(far * STEP * x, far * STEP * y).into_iter().collect();
    match key.code {
        KeyCode::Left => lead(-1.0, 0.0),
        KeyCode::Right => lead(1.0, 0.0),
        KeyCode::Up => lead(0.0, 1.0),
        KeyCode::Down => lead(0.0, -1.0),
        KeyCode::Esc | KeyCode::Char('x') => vec![FromPage::Disarm {}],
        KeyCode::Char('g') => vec![FromPage::Hand { at: None }],
        KeyCode::Char('k') => seen.gains(TURN, 1.0, false),
        KeyCode::Char('j') => seen.gains(1.0 / TURN, 1.0, false),
        KeyCode::Char('l') => seen.gains(1.0, TURN, false),
        KeyCode::Char('h') => seen.gains(1.0, 1.0 / TURN, false),
        KeyCode::Char('f') => seen.gains(1.0, 1.0, true),
        KeyCode::Char('y') => seen.again().into_iter().collect(),
        KeyCode::Char('c') => vec![FromPage::Clear {}],
        KeyCode::Char('t') => vec![seen.take_or_give()],
        KeyCode::Char('r') => vec![FromPage::Record { on: !seen.is_recording() }],
        KeyCode::Char('w') => {
            seen.next_wall();
            Vec::new()
        }
        KeyCode::Char('1') => seen.next_signal(0).into_iter().collect(),
        KeyCode::Char('2') => seen.next_signal(1).into_iter().collect(),
        KeyCode::Char('s') => seen.next_window().into_iter().collect(),
        _ => Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[cfg(not(windows))]
    fn a_terminal_without_utf_8_gets_ascii() {
        let of = |set: &[(&str, &str)]| {
            is_plain(|name| set.iter().find(|(known, _)| *known == name).map(|(_, value)| value.to_string()))
        };
        assert!(of(&[]) && of(&[("LC_ALL", "C")]) && of(&[("LC_ALL", "C"), ("LANG", "en_GB.UTF-8")]));
        assert!(of(&[("LANG", "de_DE@euro")]) && of(&[("LC_CTYPE", "POSIX"), ("LANG", "en_GB.UTF-8")]));
        for utf8 in ["en_GB.UTF-8", "C.utf8"] {
            assert!(!of(&[("LC_ALL", ""), ("LANG", utf8), ("TERM", "xterm")]), "{utf8}");
            assert!(of(&[("LC_ALL", utf8), ("TERM", "dumb")]) && of(&[("LC_ALL", utf8), ("TERM", "linux")]));
        }
    }

    #[test]
    fn only_a_key_that_repeats_arms_and_one_that_stops_lets_go() {
        let (mut held, began) = (HeldKey::default(), Instant::now());
        let at = |ms: u64| began + Duration::from_millis(ms);
        assert_eq!(held.press(at(0)), None, "one press alone does not hold");
        assert_eq!(held.wait(at(500), 10), None);
        // Any number of Spaces may have waited in the terminal: no Space is known to be newer than the last look.
        assert_eq!(held.press(at(600)), Some(FromPage::Arm { seen: 10 }));
        assert_eq!(held.press(at(640)), Some(FromPage::Hold { seen: 10 }));
        assert_eq!(held.wait(at(1000), 20), None);
        assert_eq!(held.wait(at(1041), 21), Some(FromPage::Release {}));
        assert_eq!(held.wait(at(5000), 99), None);
        assert_eq!(held.press(at(5000)), None, "and it begins anew");
        assert_eq!(held.press(at(6001)), None, "two presses far apart do not hold");
    }
}
