//! `haptic sim` in another process.

use super::{Process, haptic};
use assert_cmd::cargo::CommandCargoExt;
use std::process::{Child, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

/// Timeout of every wait. Only a process that hangs takes longer.
pub const HANG_TIMEOUT: Duration = Duration::from_secs(600);

/// Waits until a condition is true. The timeout is long, because a computer may be slow.
pub fn wait_until(what: &str, mut is_reached: impl FnMut() -> bool) {
    let start = Instant::now();
    while !is_reached() {
        assert!(start.elapsed() < HANG_TIMEOUT, "{what}: not reached within {HANG_TIMEOUT:?}");
        sleep(Duration::from_millis(10));
    }
}

/// Process of `haptic sim`.
pub struct Sim {
    pub process: Process,
    pub port: String,
}

impl Sim {
    /// Starts a board behind a TCP port.
    pub fn start(arguments: &[&str]) -> Self {
        let port = if arguments.contains(&"--tcp") { &[][..] } else { &["--tcp", "0"] };
        let sim = Self::launch(&[port, arguments].concat());
        assert!(sim.port.starts_with("tcp:127.0.0.1:"), "{}", sim.port);
        sim
    }

    /// Starts a board behind a pseudo-terminal.
    pub fn on_pseudo_terminal(arguments: &[&str]) -> Self {
        Self::launch(arguments)
    }

    fn launch(arguments: &[&str]) -> Self {
        let process = Process::start(&[&["sim"], arguments].concat());
        let port = process.first_line.rsplit(' ').next().unwrap().to_string();
        Self { process, port }
    }

    /// Runs a table of command lines on this board ([`super::type_lines`]).
    pub fn type_lines(&self, table: &str) {
        super::type_lines(table, &["--port", &self.port]);
    }

    /// Runs a command that must succeed on this board and returns its standard output.
    pub fn output(&self, arguments: &[&str]) -> String {
        super::output(&[arguments, &["--port", &self.port]].concat())
    }

    /// Runs a command with `--json` on this board and returns the document that it prints.
    pub fn json(&self, arguments: &[&str]) -> serde_json::Value {
        super::json(&[arguments, &["--port", &self.port]].concat())
    }

    pub fn run(&self, arguments: &[&str]) -> assert_cmd::assert::Assert {
        let mut command = haptic(arguments);
        command.args(["--port", &self.port]).assert()
    }

    /// Waits until the board's state fulfils a condition.
    pub fn wait_for_state(&self, is_reached: impl Fn(&str) -> bool) {
        wait_until("the board's state", || is_reached(self.json(&["info"])["state"].as_str().unwrap()));
    }

    /// Starts the tool on this board in the background.
    pub fn spawn(&self, arguments: &[&str]) -> Child {
        let mut command = std::process::Command::cargo_bin("haptic").unwrap();
        command.args(arguments).args(["--port", &self.port]).stdout(Stdio::null()).stderr(Stdio::piped());
        command.spawn().unwrap()
    }
}
