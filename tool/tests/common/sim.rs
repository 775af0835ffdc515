//! `haptic sim` in a process of its own.

pub use super::{file, haptic};
use assert_cmd::cargo::CommandCargoExt;
use std::io::{BufRead, BufReader};
use std::process::{Child, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

/// What only a hang reaches.
pub const HANG: Duration = Duration::from_secs(600);

/// Waits until something is so, however slow the machine.
pub fn until(what: &str, mut so: impl FnMut() -> bool) {
    let began = Instant::now();
    while !so() {
        assert!(began.elapsed() < HANG, "{what}: not after {HANG:?}");
        sleep(Duration::from_millis(10));
    }
}

/// `haptic sim …` in a process of its own.
pub struct Sim {
    pub child: Child,
    pub port: String,
}

impl Sim {
    /// Behind a TCP port.
    pub fn start(arguments: &[&str]) -> Self {
        let port = if arguments.contains(&"--tcp") { &[][..] } else { &["--tcp", "0"] };
        let sim = Self::launch(&[port, arguments].concat());
        assert!(sim.port.starts_with("tcp:127.0.0.1:"), "{}", sim.port);
        sim
    }

    /// Behind a pseudo-terminal.
    pub fn on_pseudo_terminal(arguments: &[&str]) -> Self {
        Self::launch(arguments)
    }

    fn launch(arguments: &[&str]) -> Self {
        let mut command = std::process::Command::cargo_bin("haptic").unwrap();
        let mut child = command.arg("sim").args(arguments).stdout(Stdio::piped()).spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let port = line.trim().rsplit(' ').next().unwrap().to_string();
        Self { child, port }
    }

    /// Runs the tool on this board.
    pub fn run(&self, arguments: &[&str]) -> assert_cmd::assert::Assert {
        let mut command = haptic(arguments);
        command.args(["--port", &self.port]).assert()
    }

    /// Waits until the board's state is like this, however slow the machine.
    pub fn until(&self, so: impl Fn(&str) -> bool) {
        until("the board's state", || {
            let info = self.run(&["info", "--json"]).success().get_output().stdout.clone();
            let info: serde_json::Value = serde_json::from_slice(&info).unwrap();
            so(info["state"].as_str().unwrap())
        });
    }

    /// Starts the tool on this board in the background.
    pub fn spawn(&self, arguments: &[&str]) -> Child {
        let mut command = std::process::Command::cargo_bin("haptic").unwrap();
        command.args(arguments).args(["--port", &self.port]).stdout(Stdio::null()).stderr(Stdio::piped());
        command.spawn().unwrap()
    }
}

impl Drop for Sim {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
