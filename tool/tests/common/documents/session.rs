//! Runs the lines of a block one by one, as a user types them at a terminal.
//!
//! Every line is passed to a shell as written, in a new directory with a copy of devices/. `haptic` and
//! `cargo run … --package haptic --` run the tool of this build; other cargo commands run in the repository. Servers
//! (`haptic sim`, `cargo xtask board`) keep running during the rest of the block, as in another terminal. Comments in a
//! line are instructions: "Ctrl-C" interrupts the command once it handles interrupts, "asks" replies `y`, and the text
//! quoted after "prints" must be in the output. The documents' TCP port 7710 is replaced by a free port.

use super::blocks::{Block, Kind, root};
use serialport::{SerialPort, TTYPort};
use std::fs::{self, File};
use std::io::{BufRead, BufReader, Read, Write};
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread::{sleep, spawn};
use std::time::{Duration, Instant};

const TOOL: &str = env!("CARGO_BIN_EXE_haptic");
/// Command that runs the tool in a checkout, as the documents write it.
const TOOL_IN_CHECKOUT: &str = "cargo run --release --package haptic --";

/// Runs the commands of one block; each may take at most `patience`.
pub fn run(block: &Block, patience: Duration) -> Result<(), String> {
    let mut session = Session::new(block.kind == Kind::Board, patience);
    for command in block.commands() {
        session.run_line(&command).map_err(|error| format!("{}: `{command}`: {error}", block.place))?;
    }
    session.end().map_err(|error| format!("{}: {error}", block.place))
}

/// Runs `haptic check` on a block that is a device or scene file.
pub fn check(block: &Block) -> Result<(), String> {
    let place = tempfile::tempdir().unwrap();
    let file = place.path().join("file.toml");
    fs::write(&file, block.lines.join("\n") + "\n").unwrap();
    let mut check = Command::new(TOOL);
    check.arg("check");
    if block.kind == Kind::Scene {
        check.arg(root().join("devices/coupled-five-bar.toml"));
    }
    let output = check.arg(&file).output().unwrap();
    if output.status.success() { Ok(()) } else { Err(format!("{}: {}", block.place, lossy_text(&output.stderr))) }
}

fn lossy_text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

struct Session {
    place: tempfile::TempDir,
    environment: Vec<(String, String)>,
    servers: Vec<(String, Child)>,
    /// TCP port of the newest server, which replaces 7710.
    port: String,
    patience: Duration,
}

impl Session {
    fn new(board: bool, patience: Duration) -> Self {
        let place = tempfile::tempdir().unwrap();
        copy_folder(&root().join("devices"), &place.path().join("devices"));
        fs::create_dir(place.path().join("bin")).unwrap();
        std::os::unix::fs::symlink(TOOL, place.path().join("bin/haptic")).unwrap();
        let path = format!("{}:{}", place.path().join("bin").display(), std::env::var("PATH").unwrap());
        let (environment, port) = (vec![("PATH".into(), path)], "7710".into());
        let mut session = Self { place, environment, servers: Vec::new(), port, patience };
        if board {
            session.write_own_files();
            session.start_server("haptic sim --strict --tcp 7710 my-device.toml").unwrap();
            session.environment.push(("HAPTIC_PORT".into(), format!("tcp:127.0.0.1:{}", session.port)));
        }
        session
    }

    /// Writes my-device.toml, a verified shipped device, and my-scene.toml, a scene for it.
    fn write_own_files(&self) {
        let shipped = fs::read_to_string(self.place.path().join("devices/coupled-five-bar.toml")).unwrap();
        let own = shipped.replace("\n[joint.motor]\n", "\n[joint.motor]\nverified = true\n");
        let own = own.replace("\n[[joint]]\n", "\n[[joint]]\nlimits = [-3.14, 3.14]\n");
        assert!(own.matches("verified = true").count() == 2 && own.matches("limits = ").count() == 2);
        fs::write(self.place.path().join("my-device.toml"), own).unwrap();
        let scene = self.place.path().join("devices/scenes/coupled-five-bar/wall.toml");
        fs::copy(scene, self.place.path().join("my-scene.toml")).unwrap();
    }

    fn run_line(&mut self, line: &str) -> Result<(), String> {
        let line = line.replace(TOOL_IN_CHECKOUT, "haptic");
        if line.starts_with("haptic sim") || line.starts_with("cargo xtask board") {
            return self.start_server(line.split_once(" #").map_or(&line, |(command, _)| command));
        }
        let line = line.replace("7710", &self.port);
        let (command, comment) = line.split_once(" #").unwrap_or((&line, ""));
        if let Some((name, value)) = command.trim().strip_prefix("export ").and_then(|set| set.split_once('=')) {
            self.environment.push((name.into(), value.into()));
            return Ok(());
        }
        let mut shell = self.shell(command);
        let mut terminal = comment.contains("asks").then(|| TTYPort::pair().unwrap());
        if let Some((_, slave)) = &terminal {
            let name = slave.name().unwrap();
            shell.stdin(File::options().read(true).write(true).open(name).unwrap());
        }
        let mut child = shell.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        if let Some((master, _)) = &mut terminal {
            master.write_all(b"y\n").unwrap();
        }
        let output_readers =
            [read_in_background(child.stdout.take().unwrap()), read_in_background(child.stderr.take().unwrap())];
        if comment.contains("Ctrl-C") {
            let start = Instant::now();
            while !handles_interrupts(&mut child) && start.elapsed() < self.patience {
                sleep(Duration::from_millis(10));
            }
            sleep(Duration::from_secs(1));
            send_signal(&child, "INT");
        }
        let status = wait_for_exit(&mut child, self.patience)?;
        let printed = output_readers.map(|reader| reader.join().unwrap()).concat();
        if status != Some(0) {
            return Err(format!("exit code {status:?}, output:\n{printed}"));
        }
        let promised = comment.split_once("prints ").map_or("", |(_, promised)| promised);
        match promised.split('"').skip(1).step_by(2).find(|words| !printed.contains(words)) {
            Some(words) => Err(format!("does not print \"{words}\", output:\n{printed}")),
            None => Ok(()),
        }
    }

    fn shell(&self, command: &str) -> Command {
        let mut shell = Command::new("sh");
        // A shell's background jobs and their children ignore Ctrl-C. Commands of a terminal do not.
        let interruptible = if cfg!(target_os = "linux") { "env --default-signal=INT" } else { "" };
        // `exec` replaces the shell, so that signals reach the command itself.
        shell
            .args(["-c", &format!("exec {interruptible} {command}")])
            .envs(self.environment.iter().cloned())
            .stdin(Stdio::null())
            .process_group(0);
        shell.current_dir(if command.starts_with("cargo ") { root() } else { self.place.path().into() });
        shell
    }

    /// Starts a server and waits until it prints its port.
    fn start_server(&mut self, command: &str) -> Result<(), String> {
        let mut child = self.shell(&command.replace("7710", "0")).stdout(Stdio::piped()).spawn().unwrap();
        let mut output = BufReader::new(child.stdout.take().unwrap());
        let mut printed = String::new();
        while !printed.contains("tcp:") && !printed.contains("/dev/") {
            if output.read_line(&mut printed).unwrap_or(0) == 0 {
                let status = wait_for_exit(&mut child, self.patience)?;
                return Err(format!("ended with exit code {status:?} before it printed its port, output:\n{printed}"));
            }
        }
        if let Some((_, port)) = printed.split_once("tcp:127.0.0.1:") {
            self.port = port.chars().take_while(char::is_ascii_digit).collect();
        }
        read_in_background(output);
        self.servers.push((command.into(), child));
        Ok(())
    }

    /// Interrupts all servers. A simulated board must end with exit code 0; an emulated board may fail.
    fn end(mut self) -> Result<(), String> {
        for (command, mut child) in std::mem::take(&mut self.servers) {
            send_signal(&child, "INT");
            let status = wait_for_exit(&mut child, self.patience)?;
            if status != Some(0) && command.starts_with("haptic") {
                return Err(format!("`{command}` ended with exit code {status:?}"));
            }
        }
        Ok(())
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        for (_, child) in &mut self.servers {
            send_signal(child, "KILL");
            let _ = child.wait();
        }
    }
}

/// Sends a signal to a command and its children, as a terminal does.
fn send_signal(child: &Child, name: &str) {
    let _ = Command::new("sh").args(["-c", &format!("kill -{name} -{}", child.id())]).status();
}

/// Returns true if a command handles interrupts or has ended, or if the system has no such information.
fn handles_interrupts(child: &mut Child) -> bool {
    let Ok(status) = fs::read_to_string(format!("/proc/{}/status", child.id())) else { return true };
    let caught_mask = status.lines().find_map(|line| line.strip_prefix("SigCgt:"));
    let caught_mask = caught_mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    // Bit 1 is SIGINT.
    caught_mask.is_none_or(|mask| mask & 2 != 0) || child.try_wait().unwrap().is_some()
}

fn wait_for_exit(child: &mut Child, patience: Duration) -> Result<Option<i32>, String> {
    let start = Instant::now();
    while start.elapsed() < patience {
        if let Some(status) = child.try_wait().unwrap() {
            return Ok(status.code());
        }
        sleep(Duration::from_millis(10));
    }
    send_signal(child, "KILL");
    let _ = child.wait();
    Err(format!("did not end within {} s", patience.as_secs()))
}

/// Reads all output in another thread, so that the writer never blocks.
fn read_in_background(mut output: impl Read + Send + 'static) -> std::thread::JoinHandle<String> {
    spawn(move || {
        let mut bytes = Vec::new();
        let _ = output.read_to_end(&mut bytes);
        lossy_text(&bytes)
    })
}

fn copy_folder(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap().map(Result::unwrap) {
        let target = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy_folder(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), target).unwrap();
        }
    }
}

#[test]
fn a_failing_line_is_detected() {
    let block = |line: &str| Block { place: "x.md:1".into(), kind: Kind::Quick, lines: vec![line.into()] };
    let run = |line: &str| run(&block(line), Duration::from_secs(600));
    assert_eq!(run("haptic model devices/coupled-five-bar.toml --q 2.6,1.75   # a remark"), Ok(()));
    let message = run("haptic model devices/coupled-five-bar.toml --no-such-option").unwrap_err();
    assert!(message.contains("x.md:1") && message.contains("no-such-option"), "{message}");
    assert!(run("haptic sim no-such-file.toml").unwrap_err().contains("exit code Some(2)"));
    let line = "haptic model devices/haply-2diy.toml --normal 0,1 # prints";
    assert_eq!(run(&format!("{line} \"has almost no benefit\"")), Ok(()));
    assert!(run(&format!("{line} \"buys a lot\"")).unwrap_err().contains("does not print \"buys a lot\""));
    let endless = super::session::run(&block("sleep 1000"), Duration::ZERO);
    assert!(endless.unwrap_err().contains("did not end"));
}
