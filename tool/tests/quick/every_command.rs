//! Runs every command once with cheap arguments, and checks that it succeeds and how its output begins. Fails if
//! `haptic help` lists a command that is not run here.
#![cfg(unix)]

use crate::common::sim::Sim;
use crate::common::{Process, haptic, output, root, send_signal};
use std::collections::BTreeSet;
use std::path::Path;

/// A command line and the beginning of its output.
type CommandCase = (&'static str, &'static str);

const COMMANDS_WITHOUT_BOARD: [CommandCase; 16] = [
    ("demo", "coupled-five-bar: a simulated board at 1000 Hz"),
    ("new five-bar -o mine.toml", "mine.toml: an example five-bar to fill in"),
    ("new scene --device mine.toml -o wall.toml", "wall.toml: a wall in front of mine at home; then `haptic check"),
    ("check mine.toml wall.toml", "mine.toml: sound: mine, a five-bar"),
    ("check devices/hapkit-paddle.toml", "devices/hapkit-paddle.toml: sound: hapkit-paddle"),
    ("model devices/hapkit-paddle.toml", "hapkit-paddle (paddle)"),
    ("map devices/hapkit-paddle.toml --normal 1 --points 20", "hapkit-paddle: 20 poses"),
    ("bench devices/hapkit-paddle.toml", "variant "),
    ("range devices/hapkit-paddle.toml --normal 1", "hapkit-paddle: q = (0.000) rad, n = (1.000)"),
    (
        "tune estimators devices/hapkit-paddle.toml --normal 1 --rate 1000",
        "hapkit-paddle: control at 1000 Hz; ripple on",
    ),
    ("tune devices/hapkit-paddle.toml --normal 1 --rates 1000 --feed-forward off", "hapkit-paddle: q = (0.000) rad"),
    ("design devices/haply-2diy.toml --points 20", "haply-2diy: q = (2.300, 0.842) rad"),
    ("report devices/hapkit-paddle.toml --without tune,map,design", "report.html: 3 parts"),
    ("board list --json", "{\"boards\":["),
    ("udev", "# haptic-bridge boards, for the local user of this computer"),
    ("completions bash", "_haptic() {"),
];

/// Commands for a board. Commands with `--port sim` simulate the board, the others use a board in another process.
const COMMANDS_WITH_BOARD: [CommandCase; 25] = [
    ("info --port sim", "board       simulated, serial number SIM0001, on sim"),
    ("board latency --port sim --exchanges 2", "2 exchanges, 10000 a second, on sim"),
    ("faults --port sim", "no faults since the board started"),
    ("stream --port sim --seconds 0.1", "    time_s "),
    (
        "measure-range devices/hapkit-paddle.toml --port sim --normal 1 --kd 5 --repeats 1 --feed-forward off --pull 2",
        "hapkit-paddle: largest stable stiffness, measured",
    ),
    ("device devices/coupled-five-bar.toml", "coupled-five-bar is loaded on tcp:"),
    ("scene devices/scenes/coupled-five-bar/wall.toml", "devices/scenes/coupled-five-bar/wall.toml is loaded on tcp:"),
    ("gains --stiffness 800", "wall 0: stiffness 800 N/m"),
    ("rules", "torque              5, 5 N m"),
    ("home", "homed: joints (2.3000, 0.8416) rad"),
    ("polarity", "every motor turns its joint the right way"),
    ("record contact.csv --arm --seconds 0.1", "2000 rows are in contact.csv"),
    ("arm", "armed: torque ramps up over 0.5 s"),
    ("disarm", "disarmed: the motors are off"),
    ("faults --clear", "no fault was latched"),
    ("board name bench", "this board is called bench"),
    ("board save", "saved: the board starts with this device and scene"),
    ("board backup board.json", "board.json: device, name, rules, scene"),
    ("board restore board.json", "rules: restored"),
    ("board restart", "the board restarts: it has the saved settings"),
    ("board dfu", "the board restarts into its boot loader"),
    ("plot contact.csv", "2000 rows over 0.100 s"),
    ("replay contact.csv", "2000 rows played, "),
    ("info", "board       simulated \"bench\", serial number SIM0001"),
    ("stream --seconds 0.1", "    time_s "),
];

/// Commands that run until Ctrl-C.
const SERVERS: [CommandCase; 3] = [
    ("sim --tcp 0", "a simulated board with coupled-five-bar is on tcp:127.0.0.1:"),
    ("view --port sim --listen 127.0.0.1:0", "open http://127.0.0.1:"),
    ("serve --haply --port sim --listen 0", "SIM0001 is an Inverse3 for programs, at ws://localhost:"),
];

/// Returns a temporary folder with a link to the shipped devices.
fn folder_with_devices() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::os::unix::fs::symlink(root().join("devices"), folder.path().join("devices")).unwrap();
    folder
}

fn split_words(line: &str) -> Vec<&str> {
    line.split(' ').collect()
}

fn run_commands(lines: &[CommandCase], folder: &Path, port: &str) {
    for (line, begins) in lines {
        let assert = haptic(&split_words(line)).current_dir(folder).env("HAPTIC_PORT", port).assert().success();
        let printed = [&assert.get_output().stdout[..], &assert.get_output().stderr].concat();
        assert!(printed.starts_with(begins.as_bytes()), "haptic {line}\n{}", String::from_utf8_lossy(&printed));
    }
}

#[test]
fn every_command_without_a_board_succeeds() {
    run_commands(&COMMANDS_WITHOUT_BOARD, folder_with_devices().path(), "sim");
}

#[test]
fn every_command_with_a_board_succeeds() {
    run_commands(&COMMANDS_WITH_BOARD, folder_with_devices().path(), &Sim::start(&["--fast"]).port);
}

/// Commands that no help page lists.
const UNLISTED_COMMANDS: [&str; 2] = ["bench", "udev"];

fn commands() -> BTreeSet<String> {
    let page = output(&["help"]);
    let (listing, _) = page.split_once("Start here").unwrap();
    let listed = listing.lines().filter_map(|line| line.strip_prefix("  ")?.split_whitespace().next());
    listed.chain(UNLISTED_COMMANDS).map(String::from).collect()
}

/// Commands whose examples are run. Examples of other commands need a board, a recording, or more than a second.
const COMMANDS_WITH_RUN_EXAMPLES: [&str; 4] = ["new", "check", "model", "range"];

#[test]
fn the_examples_of_every_help_page_name_files_that_ship() {
    let folder = folder_with_devices();
    let mut tested_commands = BTreeSet::new();
    for name in commands() {
        let page = output(&["help", &name]);
        let examples = page.split_once("Examples:\n").map_or("", |(_, examples)| examples);
        for line in examples.lines().filter_map(|line| line.trim().strip_prefix("haptic ")) {
            let files = split_words(line).into_iter().filter(|word| word.starts_with("devices/"));
            files.for_each(|file| assert!(root().join(file).is_file(), "haptic {line}: {file} does not ship"));
            if COMMANDS_WITH_RUN_EXAMPLES.contains(&name.as_str()) {
                haptic(&split_words(line)).current_dir(folder.path()).assert().success();
                tested_commands.insert(name.clone());
            }
        }
    }
    assert_eq!(tested_commands.len(), COMMANDS_WITH_RUN_EXAMPLES.len(), "{tested_commands:?}");
}

#[test]
fn every_server_starts_and_ends() {
    for (line, begins) in SERVERS {
        let mut server = Process::start(&split_words(line));
        assert!(server.first_line.starts_with(begins), "haptic {line}\n{}", server.first_line);
        send_signal(&server.child, "INT");
        assert!(server.child.wait().unwrap().success(), "haptic {line}");
    }
}

/// crates/flash/tests runs `haptic flash` with a scripted boot loader.
#[test]
fn flash_without_a_board_or_an_image_is_refused() {
    let folder = folder_with_devices();
    std::fs::write(folder.path().join("no.dfu"), "DfuSe").unwrap();
    let refuses = |line: &str, code: i32, says: &str| {
        let assert = haptic(&split_words(line)).current_dir(folder.path()).assert().code(code);
        let message = String::from_utf8_lossy(&assert.get_output().stderr).into_owned();
        assert!(message.contains(says), "haptic {line}\n{message}");
    };
    refuses("flash --port sim", 2, "a simulated board has no flash for firmware");
    refuses("flash --file no.dfu", 2, "no.dfu: the file is not a DfuSe update file");
    refuses("flash --file nowhere.dfu", 2, "nowhere.dfu: ");
    match haptic_flash::embedded_images() {
        [] => refuses("flash --port NOSUCHBOARD", 1, "this tool was built without images: in a checkout of its source"),
        _ => {
            refuses("flash --port NOSUCHBOARD", 1, "finding a board: ");
            refuses("flash toaster --port NOSUCHBOARD", 2, "this tool has no image for toaster");
        }
    }
}

/// tool/tests/deep/cogging.rs runs `haptic cogging`, which takes seconds.
#[test]
fn every_listed_command_is_run() {
    let run = [&COMMANDS_WITHOUT_BOARD[..], &COMMANDS_WITH_BOARD, &SERVERS].concat();
    let run = run.into_iter().map(|(line, _)| split_words(line)[0]).chain(["cogging", "flash"]).map(String::from);
    assert_eq!(commands(), run.collect());
}
