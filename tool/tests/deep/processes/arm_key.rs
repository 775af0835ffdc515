//! `haptic arm --key` in a pseudo-terminal.
#![cfg(unix)]

use crate::common::shipped_path;
use crate::common::sim::{HANG_TIMEOUT, Sim};

use rustix::event::{PollFd, PollFlags, poll};
use rustix::fs::{Mode, OFlags};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use std::os::fd::OwnedFd;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

struct Terminal {
    master: OwnedFd,
    text: String,
    child: Child,
    /// Time of the last Space while the key is held. Space repeats, so that the motors go on again on a slow computer.
    held: Option<Instant>,
}

impl Terminal {
    /// Runs the tool in a new session and a new terminal.
    fn start(arguments: &[&str]) -> Self {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
        grantpt(&master).unwrap();
        unlockpt(&master).unwrap();
        let path = ptsname(&master, Vec::new()).unwrap();
        let slave = rustix::fs::open(path.as_c_str(), OFlags::RDWR | OFlags::NOCTTY, Mode::empty()).unwrap();
        let mut command = Command::new("setsid");
        command.args(["--ctty", "--wait"]).arg(assert_cmd::cargo::cargo_bin("haptic")).args(arguments);
        let end = || Stdio::from(slave.try_clone().unwrap());
        let child = command.stdin(end()).stdout(end()).stderr(end()).spawn().unwrap();
        Self { master, text: String::new(), child, held: None }
    }

    fn press_space(&mut self) {
        self.held = Some(Instant::now());
        rustix::io::write(&self.master, b" ").unwrap();
    }

    /// Reads the output so far. Returns false once the tool has closed the terminal.
    fn read_output(&mut self) -> bool {
        if self.held.is_some_and(|last| last.elapsed() > Duration::from_millis(40)) {
            self.press_space();
        }
        let mut descriptors = [PollFd::new(&self.master, PollFlags::IN)];
        let time = rustix::event::Timespec { tv_sec: 0, tv_nsec: 20_000_000 };
        if poll(&mut descriptors, Some(&time)).unwrap() == 0 {
            return true;
        }
        let mut bytes = [0; 4096];
        match rustix::io::read(&self.master, &mut bytes) {
            Ok(count) if count > 0 => {
                self.text.push_str(&String::from_utf8_lossy(&bytes[..count]));
                true
            }
            _ => false,
        }
    }

    /// Waits until the tool has printed these words, then discards the output so far.
    fn wait_for(&mut self, words: &str) {
        let start = Instant::now();
        while !self.text.contains(words) {
            assert!(start.elapsed() < HANG_TIMEOUT, "{words}:\n{}", self.text);
            assert!(self.read_output(), "{words}: the tool has ended\n{}", self.text);
        }
        self.text.clear();
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[test]
fn the_motors_are_on_only_while_space_is_held() {
    let sim = Sim::start(&["--scene", &shipped_path("scenes/coupled-five-bar/wall.toml")]);
    let mut terminal = Terminal::start(&["arm", "--key", "--port", &sim.port]);
    terminal.wait_for("hold Space");
    for _ in 0..2 {
        terminal.press_space();
        terminal.wait_for("motors on");
        terminal.held = None;
        terminal.wait_for("motors off");
    }
    rustix::io::write(&terminal.master, b"q").unwrap();
    terminal.wait_for("disarmed");
    while terminal.read_output() {}
    assert!(terminal.child.wait().unwrap().success());
    sim.wait_for_state(|state| state == "Disarmed");
}
