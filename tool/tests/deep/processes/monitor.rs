//! `haptic view --terminal` in a real terminal: a pseudo-terminal whose screen is read as a person would.
#![cfg(unix)]

use crate::common::sim::{HANG, Sim, until};
use crate::common::socket::Socket;
use crate::common::{file, haptic};

use haptic_show::recorder::Recording;
use rustix::event::{PollFd, PollFlags, poll};
use rustix::fs::{Mode, OFlags};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{Winsize, tcsetwinsize};
use std::num::NonZero;
use std::os::fd::OwnedFd;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

fn size_of(count: u16) -> NonZero<u16> {
    NonZero::new(count).unwrap()
}

struct Terminal {
    master: OwnedFd,
    screen: vt100::Parser,
    child: Child,
    /// Space is held, as a terminal tells: it comes again and again. Where this process was too slow and the motors went
    /// off, that switches them on again.
    holding: Option<Instant>,
}

impl Terminal {
    /// The tool in a session and terminal of its own.
    fn start(arguments: &[&str], rows: u16, columns: u16) -> Self {
        Self::run(&[&["view", "--terminal"], arguments].concat(), rows, columns)
    }

    fn run(arguments: &[&str], rows: u16, columns: u16) -> Self {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
        grantpt(&master).unwrap();
        unlockpt(&master).unwrap();
        let path = ptsname(&master, Vec::new()).unwrap();
        let slave = rustix::fs::open(path.as_c_str(), OFlags::RDWR | OFlags::NOCTTY, Mode::empty()).unwrap();
        let size = |rows, columns| Winsize { ws_row: rows, ws_col: columns, ws_xpixel: 0, ws_ypixel: 0 };
        tcsetwinsize(&master, size(rows, columns)).unwrap();
        let mut command = Command::new("setsid");
        command.args(["--ctty", "--wait"]).arg(assert_cmd::cargo::cargo_bin("haptic")).args(arguments);
        command.env("TERM", "xterm-256color").env("LC_ALL", "C.UTF-8").env_remove("HAPTIC_PORT");
        let end = || Stdio::from(slave.try_clone().unwrap());
        let child = command.stdin(end()).stdout(end()).stderr(end()).spawn().unwrap();
        Self { master, screen: vt100::Parser::new(size_of(rows), size_of(columns), 0), child, holding: None }
    }

    fn resize(&mut self, rows: u16, columns: u16) {
        tcsetwinsize(&self.master, Winsize { ws_row: rows, ws_col: columns, ws_xpixel: 0, ws_ypixel: 0 }).unwrap();
        self.screen.screen_mut().set_size(size_of(rows), size_of(columns));
    }

    fn press(&mut self, keys: &str) {
        let mut bytes = keys.as_bytes();
        while !bytes.is_empty() {
            let written = rustix::io::write(&self.master, bytes).unwrap();
            bytes = &bytes[written..];
        }
    }

    fn hold(&mut self) {
        self.holding = Some(Instant::now());
        self.press(" ");
    }

    /// Reads what has come; false once nobody writes any more.
    fn read(&mut self) -> bool {
        if self.holding.is_some_and(|last| last.elapsed() > Duration::from_millis(40)) {
            self.hold();
        }
        let mut waited = [PollFd::new(&self.master, PollFlags::IN)];
        let time = rustix::event::Timespec { tv_sec: 0, tv_nsec: 20_000_000 };
        if poll(&mut waited, Some(&time)).unwrap() == 0 {
            return true;
        }
        let mut bytes = [0; 65_536];
        match rustix::io::read(&self.master, &mut bytes) {
            Ok(count) if count > 0 => {
                self.screen.process(&bytes[..count]);
                true
            }
            _ => false,
        }
    }

    fn text(&self) -> String {
        self.screen.screen().contents()
    }

    fn until(&mut self, what: &str, so: impl Fn(&str) -> bool) {
        let began = Instant::now();
        while !so(&self.text()) {
            assert!(began.elapsed() < HANG, "{what}:\n{}", self.text());
            assert!(self.read(), "{what}: it has ended\n{}", self.text());
        }
    }

    fn shows(&mut self, words: &str) {
        self.until(words, |text| text.contains(words));
    }

    fn ended(mut self) -> (ExitStatus, String) {
        let began = Instant::now();
        let status = loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                break status;
            }
            assert!(began.elapsed() < HANG, "{}", self.text());
            self.read();
        };
        while self.read() {}
        assert!(!self.screen.screen().alternate_screen(), "the terminal is itself again");
        (status, self.text())
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The number before a unit, behind a word: "force 2.31 N".
fn number(text: &str, word: &str) -> f64 {
    let rest = text.split_once(word).unwrap_or_else(|| panic!("{word} in\n{text}")).1;
    let mut parts = rest.split_whitespace();
    let value: f64 = parts.next().unwrap().parse().unwrap_or_else(|_| panic!("{word} in\n{text}"));
    match parts.next().unwrap_or_default() {
        unit if unit.starts_with('m') && unit != "m" => 1e-3 * value,
        unit if unit.starts_with('µ') => 1e-6 * value,
        _ => value,
    }
}

/// Pressed by arrow keys, felt by numbers: what the page in the browser does, a terminal does as well.
#[test]
fn a_wall_is_pressed_its_gains_are_turned_and_it_is_recorded() {
    let folder = tempfile::tempdir().unwrap();
    let to = folder.path().to_str().unwrap();
    let mut terminal = Terminal::start(&["--port", "sim", "--record-to", to], 40, 120);
    terminal.shows("you command");
    for words in [
        "coupled-five-bar",
        "motors off",
        "tip and walls",
        "1: rendered_n",
        "2: distance_m",
        "outside",
        "wall 0 (plane): 8700 N/m, 80 N s/m, feed-forward washout",
        "hold Space: motors on",
        "rows lost 0",
    ] {
        terminal.shows(words);
    }
    assert!(terminal.text().chars().any(|c| ('\u{2801}'..='\u{28ff}').contains(&c)), "something is drawn");
    // A single press does not arm.
    terminal.press(" ");
    terminal.press("r");
    terminal.shows("● recording");
    assert!(terminal.text().contains("motors off  you command"), "{}", terminal.text());
    terminal.hold();
    terminal.shows(" motors on  you command");
    // Into the wall, which lies below: half a millimetre a press, ten times as far with Shift.
    terminal.press("\u{1b}[1;2B\u{1b}[1;2B\u{1b}[1;2B\u{1b}[1;2B\u{1b}[1;2B");
    terminal.until("a force", |text| text.contains("depth ") && number(text, "force ") > 1.0);
    terminal.press("h");
    terminal.shows("8700 N/m, 76.19 N s/m");
    terminal.press("jjj");
    terminal.until("a softer wall", |text| !text.contains("): 8700 N/m"));
    terminal.press("1");
    terminal.until("the next signal", |text| !text.contains("1: rendered_n"));
    terminal.press("r");
    terminal.shows("none lost");
    // Any size: what is drawn then is drawn in it.
    terminal.resize(24, 80);
    terminal.until("the smaller screen", |text| text.contains("motors on  you") && text.contains("wall 0 (plane)"));
    terminal.resize(8, 44);
    terminal.until("a tiny screen", |text| text.contains("motors on  you") && text.contains("wall 0"));
    terminal.resize(5, 20);
    terminal.until("hardly any screen", |text| text.contains("motors on"));
    terminal.resize(50, 160);
    terminal.until("a large one", |text| text.contains("tip and walls") && text.contains("q: end"));
    // Letting go.
    terminal.holding = None;
    terminal.shows("motors off");
    terminal.press("q");
    let (status, _) = terminal.ended();
    assert!(status.success());
    let file = std::fs::read_dir(folder.path()).unwrap().next().unwrap().unwrap().path();
    let recording = Recording::load(&file).unwrap();
    let force = recording.column("rendered_n").unwrap();
    assert!(!recording.torn && recording.rows.iter().any(|row| row[force] > 1.0), "{}", recording.rows.len());
    assert!(recording.about.iter().any(|line| line.starts_with("wall 0: plane, 8700 N/m, 76.19 N s/m")));
}

#[test]
fn gains_that_are_predicted_to_be_unstable_are_asked_about_first() {
    let mut terminal = Terminal::start(&["--port", "sim"], 24, 80);
    terminal.shows("you command");
    // The boundary is worked out meanwhile; until it is there, nothing is refused. A terminal of the usual size shows
    // how stiff the wall may be in whole words.
    terminal.until("the limit", |text| {
        let words = text.split_whitespace().collect::<Vec<_>>().join(" ");
        words.split_once("predicted stable up to ").is_some_and(|(_, rest)| {
            let mut rest = rest.split_whitespace();
            rest.next().is_some_and(|number| number.parse::<f64>().is_ok())
                && rest.next().is_some_and(|unit| unit.ends_with("N/m"))
        })
    });
    terminal.resize(40, 120);
    terminal.press("f");
    terminal.shows("predicted to be unstable here");
    terminal.shows("feed-forward washout");
    terminal.press("y");
    terminal.shows("feed-forward off");
    terminal.press("\u{3}");
    assert!(terminal.ended().0.success(), "Ctrl-C ends it in order");
}

/// The scene of a board that is switched off is gone, unless it was saved.
#[test]
fn a_board_that_is_unplugged_is_waited_for_also_where_it_comes_back_without_its_scene() {
    let wall = file("scenes/coupled-five-bar/wall.toml");
    let socket = Socket::empty();
    socket.plug(&["--scene", &wall]);
    let mut terminal = Terminal::start(&["--port", &socket.address], 30, 100);
    terminal.shows("motors off");
    for back in [&["--scene", &wall][..], &[]] {
        socket.unplug();
        terminal.shows("waiting for it");
        terminal.shows("no connection");
        socket.plug(back);
        if back.is_empty() {
            terminal.until("what to do", |text| text.contains("haptic scene FILE") && !text.contains("motors off"));
            // Between two looks the board is free for others.
            let scene = ["scene", &wall, "--port", &socket.address];
            until("the scene", || haptic(&scene).output().unwrap().status.success());
        }
        terminal.until("its return", |text| text.contains("motors off") && !text.contains("waiting for it"));
        terminal.shows("nobody commands");
        terminal.press("t");
        terminal.shows("you command");
    }
    terminal.press("q");
    assert!(terminal.ended().0.success());
}

#[test]
fn where_there_is_no_terminal_it_says_so() {
    let refused = haptic(&["view", "--terminal", "--port", "sim"]).assert().code(2);
    assert!(String::from_utf8_lossy(&refused.get_output().stderr).contains("no terminal"));
}

#[test]
fn arm_with_a_key_has_the_motors_on_only_while_space_is_held() {
    let sim = Sim::start(&["--scene", &file("scenes/coupled-five-bar/wall.toml")]);
    let mut terminal = Terminal::run(&["arm", "--key", "--port", &sim.port], 10, 80);
    terminal.shows("hold Space");
    for _ in 0..2 {
        terminal.hold();
        terminal.shows("motors on");
        terminal.holding = None;
        terminal.shows("motors off");
    }
    terminal.press("q");
    let (status, text) = terminal.ended();
    assert!(status.success() && text.contains("disarmed"), "{text}");
    sim.until(|state| state == "Disarmed");
}
