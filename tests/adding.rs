//! Checks the table "Adding things" of docs/architecture.md. Every file that a row names must exist. For every row but
//! "straight step" a test adds a toy through the shipped table or trait. If a row omits a file, its test does not
//! compile.

use std::path::Path;

/// The rows of the table, each with the file and name of the test that adds a toy.
const ROWS: [(&str, Option<(&str, &str)>); 11] = [
    ("mechanism", Some(("tests/mechanism.rs", "a_toy_mechanism_is_one_impl_and_renders_walls"))),
    ("straight step", None),
    ("wall shape", Some(("tests/shape.rs", "a_toy_shape_is_one_impl"))),
    ("telemetry signal", Some(("src/board/telemetry.rs", "a_field_needs_only_one_line"))),
    ("signal of the walls", Some(("src/board/telemetry.rs", "a_field_needs_only_one_line"))),
    ("fault", Some(("src/safety/fault.rs", "a_fault_needs_only_one_line"))),
    ("velocity estimator", Some(("tests/estimators.rs", "a_toy_estimator_is_one_impl"))),
    ("request", Some(("src/board/dispatch.rs", "an_endpoint_needs_one_line_and_one_arm"))),
    ("command", Some(("tool/src/commands/mod.rs", "a_toy_command_is_a_file_and_a_line"))),
    ("board", Some(("emulator/tests/emulated/toy.rs", "a_toy_board_is_one_file_and_renders_a_wall"))),
    ("motor stage", Some(("tests/stages.rs", "an_amplifier_gets_the_current_of_the_walls_torque"))),
];

fn is_path_char(c: char) -> bool {
    c.is_ascii_alphanumeric() || "_-./".contains(c)
}

fn read(path: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(path);
    std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Returns every row of the table as its first cell and its full text.
fn table_rows() -> Vec<(String, String)> {
    let text = read("docs/architecture.md");
    let section = text.split("## Adding things").nth(1).expect("the section");
    let lines = section.lines().filter(|line| line.starts_with("| ")).skip(1);
    lines.map(|line| (line.split('|').nth(1).expect("a first cell").trim().into(), line.into())).collect()
}

/// Returns the file paths in `text`, except paths that contain `NAME`.
fn file_paths(text: &str) -> Vec<&str> {
    let words = text.split(|c: char| !is_path_char(c)).map(|word| word.trim_end_matches('.'));
    let is_file = |word: &&str| word.contains('/') && Path::new(word).extension().is_some();
    words.filter(is_file).filter(|word| !word.contains("NAME")).collect()
}

#[test]
fn every_file_that_the_table_names_exists() {
    let table = table_rows();
    assert_eq!(table.iter().map(|(name, _)| name.as_str()).collect::<Vec<_>>(), ROWS.map(|(name, _)| name));
    for (name, line) in &table {
        let files = file_paths(line);
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
fn the_files_of_a_row_are_found() {
    let row = "| a | `src/NAME.rs` | its line in src/lib.rs, and `b` (.cargo/config.toml). | c |";
    assert_eq!(file_paths(row), ["src/lib.rs", ".cargo/config.toml"]);
}
