//! `haptic` and `haptic sim`, as a person types them.

use assert_cmd::Command;
use assert_cmd::cargo::CommandCargoExt;
use std::io::{BufRead, BufReader};
use std::path::PathBuf;
use std::process::{Child, Stdio};

/// A file that ships.
pub fn file(name: &str) -> String {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../devices").join(name).display().to_string()
}

/// Waits until something is so, however slow the machine.
pub fn until(what: &str, so: impl Fn() -> bool) {
    for _ in 0..30_000 {
        if so() {
            return;
        }
        std::thread::sleep(std::time::Duration::from_millis(10));
    }
    panic!("{what}: not after five minutes");
}

/// The tool, with these arguments.
pub fn haptic(arguments: &[&str]) -> Command {
    let mut command = Command::cargo_bin("haptic").unwrap();
    command.args(arguments);
    command
}

/// `haptic sim …` in a process of its own.
pub struct Sim {
    pub child: Child,
    pub port: String,
}

impl Sim {
    /// Behind a TCP port.
    pub fn start(arguments: &[&str]) -> Self {
        let sim = Self::launch(&[&["--tcp", "0"], arguments].concat());
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
        let mut state = String::new();
        for _ in 0..3_000 {
            let info = self.run(&["info", "--json"]).success().get_output().stdout.clone();
            let info: serde_json::Value = serde_json::from_slice(&info).unwrap();
            state = info["state"].as_str().unwrap().into();
            if so(&state) {
                return;
            }
            std::thread::sleep(std::time::Duration::from_millis(100));
        }
        panic!("the board is still {state} after five minutes");
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
