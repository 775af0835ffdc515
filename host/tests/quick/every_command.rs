//! Every command once, with the cheapest arguments that make sense: its exit code is 0, and its first line says what it
//! should. A command that `haptic help` lists and nobody runs here fails.
#![cfg(unix)]

use crate::common::sim::{Sim, until};
use crate::common::{haptic, root};
use rustix::fs::{Mode, OFlags};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{Winsize, tcsetwinsize};
use std::collections::BTreeSet;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};

/// What is typed, and how the first line begins that it prints.
type Line = (&'static str, &'static str);

const ANALYSIS: [Line; 15] = [
    ("demo", ""),
    ("new five-bar -o mine.toml", ""),
    ("check devices/hapkit-paddle.toml", ""),
    ("model devices/hapkit-paddle.toml", ""),
    ("map devices/hapkit-paddle.toml --normal 1 --points 20", ""),
    ("plan devices/hapkit-paddle.toml devices/scenes/hapkit-paddle/wall.toml", ""),
    ("precompute devices/haply-2diy.toml --kind frozen --box 1.8,2.2,0.9,1.3 -o frozen.json", ""),
    ("bench devices/hapkit-paddle.toml", ""),
    ("range devices/hapkit-paddle.toml --normal 1", ""),
    ("estimators devices/hapkit-paddle.toml --normal 1 --rate 1000", ""),
    ("tune devices/hapkit-paddle.toml --normal 1 --rates 1000 --feed-forward off", ""),
    ("design devices/haply-2diy.toml --points 20", ""),
    ("report devices/hapkit-paddle.toml --without estimators,tune,map,range,design", ""),
    ("list", ""),
    ("completions bash", ""),
];

/// On a board in a process of its own, or in the command's.
const BOARD: [Line; 25] = [
    ("info --port sim", ""),
    ("latency --port sim --exchanges 2", ""),
    ("faults --port sim", ""),
    ("stream --port sim --seconds 0.1", ""),
    (
        "measure-range devices/hapkit-paddle.toml --port sim --normal 1 --kd 5 --repeats 1 --feed-forward off --frictionless --counts 8388608",
        "",
    ),
    ("device devices/coupled-five-bar.toml", ""),
    ("scene devices/scenes/coupled-five-bar/wall.toml", ""),
    ("gains --stiffness 800", ""),
    ("rules", ""),
    ("home", ""),
    ("polarity", ""),
    ("arm", ""),
    ("record contact.csv --seconds 0.1", ""),
    ("disarm", ""),
    ("clear", ""),
    ("name bench", ""),
    ("save", ""),
    ("backup board.json", ""),
    ("restore board.json", ""),
    ("restart", ""),
    ("dfu", ""),
    ("plot contact.csv", ""),
    ("replay contact.csv", ""),
    ("info", ""),
    ("stream --seconds 0.1", ""),
];

/// They end with Ctrl-C, after what they say first.
const SERVING: [Line; 3] =
    [("sim --tcp 0", ""), ("view --port sim --listen 127.0.0.1:0", ""), ("serve --haply --port sim --listen 0", "")];

/// A folder with the devices that ship.
fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::os::unix::fs::symlink(root().join("devices"), folder.path().join("devices")).unwrap();
    folder
}

fn words(line: &str) -> Vec<&str> {
    line.split(' ').collect()
}

fn each(lines: &[Line], folder: &Path, port: &str) {
    for (line, begins) in lines {
        let typed = haptic(&words(line)).current_dir(folder).env("HAPTIC_PORT", port).assert().success();
        let said = String::from_utf8_lossy(&typed.get_output().stdout).into_owned();
        println!("{line}: {:?}", said.lines().next());
        assert!(said.starts_with(begins), "haptic {line}\n{said}");
    }
}

#[test]
fn every_command_without_a_board() {
    each(&ANALYSIS, folder().path(), "");
}

#[test]
fn every_command_with_a_board() {
    each(&BOARD, folder().path(), &Sim::start(&["--fast"]).port);
}

fn interrupt(child: &Child) {
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
}

#[test]
fn every_command_that_serves() {
    for (line, begins) in SERVING {
        let mut command = Command::new(env!("CARGO_BIN_EXE_haptic"));
        let mut child = command.args(words(line)).stdout(Stdio::piped()).spawn().unwrap();
        let mut said = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut said).unwrap();
        println!("{line}: {said:?}");
        assert!(said.starts_with(begins), "haptic {line}\n{said}");
        interrupt(&child);
        assert!(child.wait().unwrap().success(), "haptic {line}");
    }
}

#[test]
fn the_monitor() {
    let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
    grantpt(&master).unwrap();
    unlockpt(&master).unwrap();
    tcsetwinsize(&master, Winsize { ws_row: 24, ws_col: 80, ws_xpixel: 0, ws_ypixel: 0 }).unwrap();
    let path = ptsname(&master, Vec::new()).unwrap();
    let slave = rustix::fs::open(path.as_c_str(), OFlags::RDWR | OFlags::NOCTTY, Mode::empty()).unwrap();
    let end = || Stdio::from(slave.try_clone().unwrap());
    let mut command = Command::new(env!("CARGO_BIN_EXE_haptic"));
    command.args(["monitor", "--port", "sim"]).env("TERM", "xterm-256color");
    let mut child = command.stdin(end()).stdout(end()).stderr(end()).spawn().unwrap();
    let (mut said, mut bytes) = (Vec::new(), [0; 4096]);
    until("the device's name", || {
        let count = rustix::io::read(&master, &mut bytes).unwrap();
        said.extend(&bytes[..count]);
        String::from_utf8_lossy(&said).contains("coupled-five-bar")
    });
    rustix::io::write(&master, b"q").unwrap();
    // It ends once somebody has read what it says at last.
    drop(slave);
    while rustix::io::read(&master, &mut bytes).is_ok_and(|count| count > 0) {}
    assert!(child.wait().unwrap().success());
}

/// The commands of the help page.
#[test]
fn no_command_is_left_out() {
    let page = haptic(&["help"]).assert().success().get_output().stdout.clone();
    let page = String::from_utf8(page).unwrap();
    let (listing, _) = page.split_once("Start here").unwrap();
    let listed = listing.lines().filter_map(|line| line.strip_prefix("  ")?.split_whitespace().next());
    let run = [&ANALYSIS[..], &BOARD, &SERVING].concat();
    let run: BTreeSet<&str> = run.into_iter().map(|(line, _)| words(line)[0]).chain(["monitor"]).collect();
    assert_eq!(listed.collect::<BTreeSet<_>>(), run);
}
