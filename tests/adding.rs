//! Measures the work of adding something, as docs/architecture.md tells it: a row's files are the places where an
//! existing one is named; where a test can add one, the row names the test that adds a toy.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// The parts of the product.
const PRODUCT: [&str; 17] = [
    "src",
    "host/src",
    "host/sim/src",
    "host/predict/src",
    "host/show/src",
    "host/tool/src",
    "firmware/src",
    "firmware/Cargo.toml",
    "emulator/src",
    "emulator/programs/src",
    "xtask/src",
    "capi/src",
    "chai3d/src",
    "python/src",
    "python/package/haptic_bridge",
    "benches/chip",
    ".cargo/config.toml",
];

/// A row of the table, with those of its kind that are there and touch all of its files between them.
struct Row {
    name: &'static str,
    /// The words that name them.
    words: &'static [&'static str],
    /// The stems of their own files, where they have one.
    stems: &'static [&'static str],
    /// Files that use them, and would do without.
    users: &'static [&'static str],
    /// The file whose test adds a toy, and the test.
    toy: Option<(&'static str, &'static str)>,
}

const ROWS: [Row; 11] = [
    // One that stands in its own way, for other programs and in MuJoCo.
    Row {
        name: "mechanism",
        words: &["Parallelogram", "parallelogram"],
        stems: &["parallelogram"],
        users: &[],
        toy: Some(("tests/mechanism.rs", "a_toy_mechanism_is_one_impl_and_renders_walls_with_the_feed_forward")),
    },
    Row {
        name: "straight step",
        words: &["StepVariant", "render_wall", "render_round", "render_several"],
        stems: &["wall", "round", "several"],
        users: &[],
        toy: None,
    },
    Row {
        name: "wall shape",
        words: &["Cylinder", "cylinder"],
        stems: &["cylinder"],
        users: &[],
        toy: Some(("tests/shape.rs", "a_toy_shape_is_one_impl")),
    },
    Row {
        name: "telemetry signal",
        words: &["RenderedForce", "rendered_force"],
        stems: &[],
        users: &["host/sim/src/held.rs", "host/show/src/view/picture.rs"],
        toy: Some(("src/board/telemetry.rs", "a_toy_signal_is_one_line")),
    },
    Row {
        name: "signal of the walls",
        words: &["PassivityDamping", "passivity_damping"],
        stems: &[],
        users: &[],
        toy: Some(("src/board/telemetry.rs", "a_toy_signal_is_one_line")),
    },
    Row {
        name: "fault",
        words: &["IndexMismatch"],
        stems: &[],
        users: &[],
        toy: Some(("src/safety/fault.rs", "a_toy_fault_is_one_line")),
    },
    // One that is not linear, and one that is.
    Row {
        name: "velocity estimator",
        words: &["Levant", "levant", "AlphaBeta", "alpha_beta", "alpha-beta"],
        stems: &["levant", "alpha_beta"],
        users: &[],
        toy: Some(("tests/estimators.rs", "a_toy_estimator_is_one_impl")),
    },
    Row {
        name: "request",
        words: &["SetName", "set_name"],
        stems: &[],
        users: &["host/tool/src/commands/name.rs", "emulator/src/inject.rs"],
        toy: Some(("src/board/dispatch.rs", "a_toy_request_is_a_line_and_an_arm")),
    },
    Row {
        name: "command",
        words: &["Completions", "completions"],
        stems: &["completions"],
        users: &[],
        toy: Some(("host/tool/src/commands/mod.rs", "a_toy_command_is_a_file_and_a_line")),
    },
    Row {
        name: "board",
        words: &[
            "HBridgeF405",
            "h_bridge_f405",
            "h-bridge-f405",
            "flash-h-bridge-f405",
            "OdriveV3",
            "odrive_v3",
            "odrive-v3",
            "flash-odrive-v3",
        ],
        stems: &["h_bridge_f405", "odrive_v3"],
        users: &[
            // This program runs on one of them.
            "emulator/programs/src/bin/board/main.rs",
            "emulator/src/campaign.rs",
            "emulator/src/cases.rs",
            "emulator/src/inject.rs",
            "emulator/src/noise.rs",
            "emulator/src/range.rs",
            "emulator/src/soak.rs",
        ],
        toy: Some(("emulator/tests/emulated/toy.rs", "a_toy_board_is_one_file_and_renders_a_wall")),
    },
    Row {
        name: "motor stage",
        words: &["brushed"],
        stems: &["brushed"],
        users: &["host/sim/src/board.rs"],
        toy: Some((
            "tests/stages.rs",
            "an_amplifier_gets_the_current_of_the_walls_torque_and_nothing_once_the_motors_are_off",
        )),
    },
];

/// The endings of its files.
const ENDINGS: [&str; 4] = ["rs", "toml", "py", "pyi"];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn read(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

fn files(path: &Path, found: &mut Vec<PathBuf>) {
    if path.is_dir() {
        for entry in std::fs::read_dir(path).expect("a readable folder") {
            files(&entry.expect("a readable entry").path(), found);
        }
    } else if path.extension().is_some_and(|end| ENDINGS.iter().any(|known| end == *known)) {
        found.push(path.into());
    }
}

/// A source without comments and tests.
fn code(text: &str) -> String {
    let product = text.split("#[cfg(test)]").next().unwrap_or_default();
    product.lines().map(|line| line.split("//").next().unwrap_or_default()).collect::<Vec<_>>().join("\n")
}

/// Returns true if a word stands in a text by itself.
fn names(text: &str, word: &str) -> bool {
    let part = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    text.match_indices(word).any(|(at, _)| !text[..at].ends_with(part) && !text[at + word.len()..].starts_with(part))
}

/// The files of the product in which one of these words stands.
fn named_in(words: &[&str]) -> BTreeSet<String> {
    let mut found = Vec::new();
    PRODUCT.iter().for_each(|folder| files(&root().join(folder), &mut found));
    assert!(found.len() > 200, "only {} files", found.len());
    let named = found.iter().filter(|path| words.iter().any(|word| names(&code(&read(path)), word)));
    let inside = |path: &PathBuf| path.strip_prefix(root()).expect("below the root").to_str().expect("a name").into();
    named.map(inside).collect()
}

/// A row of the table in docs/architecture.md.
fn line(row: &str) -> String {
    let text = read(&root().join("docs/architecture.md"));
    let table = text.split("## Adding things").nth(1).expect("the section");
    let line = table.lines().find(|line| line.starts_with(&format!("| {row} |")));
    line.unwrap_or_else(|| panic!("no {row}")).into()
}

/// The files of a row of the table, with each of `stems` where it says NAME.
fn told(row: &str, stems: &[&str]) -> BTreeSet<String> {
    let line = line(row);
    let part = |c: char| c.is_ascii_alphanumeric() || "_-./".contains(c);
    let words = line.split(|c: char| !part(c)).filter(|word| word.contains('/'));
    let files =
        words.filter(|word| Path::new(word).extension().is_some_and(|end| ENDINGS.iter().any(|known| end == *known)));
    let files = files.filter(|file| !file.contains("tests/"));
    let each = |file: &str| -> Vec<String> {
        if file.contains("NAME") {
            stems.iter().map(|stem| file.replace("NAME", stem)).collect()
        } else {
            vec![file.into()]
        }
    };
    files.flat_map(each).collect()
}

#[test]
fn the_places_where_one_that_is_there_is_named_are_the_files_of_its_row() {
    for Row { name, words, stems, users, .. } in ROWS {
        let told = told(name, stems);
        assert!(told.iter().all(|file| root().join(file).exists()), "{name}: {told:?}");
        let mut named = named_in(words);
        for user in users {
            assert!(named.remove(*user), "{name}: {user} does not use it");
        }
        // A file need not say its own name.
        let own = |file: &&String| stems.iter().any(|stem| file.ends_with(&format!("/{stem}.rs")));
        named.extend(told.iter().filter(own).cloned());
        assert_eq!(named, told, "{name}: where {words:?} stands is not what the row says");
    }
}

#[test]
fn a_row_names_the_test_that_adds_a_toy_or_says_that_none_does() {
    for Row { name, toy, .. } in ROWS {
        let line = line(name);
        let told = line.trim_end_matches('|').rsplit('|').next().expect("a last column").trim();
        match toy {
            Some((file, test)) => {
                assert!(told.starts_with(file), "{name}: {told}");
                let source = read(&root().join(file));
                assert!(source.contains(&format!("fn {test}()")), "{name}: {file} has no {test}");
            }
            None => assert!(told.starts_with("none: "), "{name}: {told}"),
        }
    }
}

#[test]
fn a_word_is_found_by_itself_and_not_in_comments() {
    assert!(names("a Sphere(b)", "Sphere") && !names("Spheres", "Sphere") && !names("half-Sphere", "Sphere"));
    assert_eq!(code("one // two\nthree\n#[cfg(test)]\nmod tests {}"), "one \nthree");
}
