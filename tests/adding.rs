//! The work of adding something, as the table in docs/architecture.md tells it: every file that a row names exists, and
//! where a test can do the work, one does. Such a test adds a toy through the very table or trait that ships, so it does
//! not compile where a row leaves a place out.

use std::path::Path;

/// The rows of the table, each with the test that adds a toy, if one can.
const ROWS: [(&str, Option<(&str, &str)>); 11] = [
    ("mechanism", Some(("tests/mechanism.rs", "a_toy_mechanism_is_one_impl_and_renders_walls_with_the_feed_forward"))),
    ("straight step", None),
    ("wall shape", Some(("tests/shape.rs", "a_toy_shape_is_one_impl"))),
    ("telemetry signal", Some(("src/board/telemetry.rs", "a_toy_signal_is_one_line"))),
    ("signal of the walls", Some(("src/board/telemetry.rs", "a_toy_signal_is_one_line"))),
    ("fault", Some(("src/safety/fault.rs", "a_toy_fault_is_one_line"))),
    ("velocity estimator", Some(("tests/estimators.rs", "a_toy_estimator_is_one_impl"))),
    ("request", Some(("src/board/dispatch.rs", "a_toy_request_is_a_line_and_an_arm"))),
    ("command", Some(("tool/src/commands/mod.rs", "a_toy_command_is_a_file_and_a_line"))),
    ("board", Some(("emulator/tests/emulated/toy.rs", "a_toy_board_is_one_file_and_renders_a_wall"))),
    (
        "motor stage",
        Some((
            "tests/stages.rs",
            "an_amplifier_gets_the_current_of_the_walls_torque_and_nothing_once_the_motors_are_off",
        )),
    ),
];

/// Characters of a path.
fn of_a_path(c: char) -> bool {
    c.is_ascii_alphanumeric() || "_-./".contains(c)
}

fn read(path: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(path);
    std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// The rows of the table, by their first cells.
fn table() -> Vec<(String, String)> {
    let text = read("docs/architecture.md");
    let section = text.split("## Adding things").nth(1).expect("the section");
    let lines = section.lines().filter(|line| line.starts_with("| ")).skip(1);
    lines.map(|line| (line.split('|').nth(1).expect("a first cell").trim().into(), line.into())).collect()
}

/// The files that a text names, but for those whose name is the reader's choice.
fn files(text: &str) -> Vec<&str> {
    let words = text.split(|c: char| !of_a_path(c)).map(|word| word.trim_end_matches('.'));
    let of_a_file = |word: &&str| word.contains('/') && Path::new(word).extension().is_some();
    words.filter(of_a_file).filter(|word| !word.contains("NAME")).collect()
}

#[test]
fn every_file_that_the_table_names_exists() {
    let table = table();
    assert_eq!(table.iter().map(|(name, _)| name.as_str()).collect::<Vec<_>>(), ROWS.map(|(name, _)| name));
    for (name, line) in &table {
        let files = files(line);
        assert!(!files.is_empty(), "{name} names no file");
        for file in files {
            assert!(Path::new(env!("CARGO_MANIFEST_DIR")).join(file).exists(), "{name}: there is no {file}");
        }
    }
}

#[test]
fn every_row_but_one_has_a_test_that_adds_a_toy() {
    assert_eq!(ROWS.iter().filter(|(_, toy)| toy.is_none()).count(), 1);
    for (name, toy) in ROWS {
        let Some((file, test)) = toy else { continue };
        assert!(read(file).contains(&format!("fn {test}()")), "{name}: {file} has no {test}");
    }
}

#[test]
fn a_file_is_found_in_a_row() {
    let row = "| a | `src/NAME.rs` | its line in src/lib.rs, and `b` (.cargo/config.toml). | c |";
    assert_eq!(files(row), ["src/lib.rs", ".cargo/config.toml"]);
}
