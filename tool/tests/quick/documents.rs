//! The quick commands, numbers, links and rows of tables in README.md and docs/ are correct (common/documents).
#![cfg(unix)]

use crate::common::documents::blocks::{Block, Kind, documents, root};
use crate::common::documents::{run_blocks, session, tables};
use crate::common::read;
use crate::common::sim::HANG_TIMEOUT;
use haptic_bridge::board::protocol::{MAX_FRAME, PROTOCOL};
use haptic_bridge::control::KEY_SECONDS;
use haptic_bridge::safety::limits::GENTLE_FORCE;
use haptic_predict::tip::BOARD_SPEED;
use std::collections::BTreeMap;
use std::fs;
use std::process::Command;

#[test]
fn quick_commands_of_the_documents_work() {
    let run = |block: &Block| session::run(block, HANG_TIMEOUT);
    assert!(run_blocks(|kind| *kind == Kind::Quick, run) >= 2, "README alone has two");
}

#[test]
fn commands_of_the_documents_with_a_board_work() {
    assert!(run_blocks(|kind| *kind == Kind::Board, |block| session::run(block, HANG_TIMEOUT)) >= 1);
}

#[test]
fn files_in_the_documents_are_sound() {
    let files = run_blocks(|kind| matches!(kind, Kind::File | Kind::Scene), session::check);
    assert!(files >= 2, "docs/files.md shows a device and a scene");
}

#[test]
fn numbers_in_the_documents_equal_those_of_the_code() {
    let says = |page: &str, text: String| {
        assert!(read(page).replace('\n', " ").contains(&text), "{page} lacks this text: {text}");
    };
    says("docs/protocol.md", format!("version, now {PROTOCOL}."));
    says("docs/protocol.md", format!("at most {MAX_FRAME} bytes before"));
    says("docs/protocol.md", format!("at most {KEY_SECONDS} s (`KeyTooOld`)"));
    says("docs/safety.md", format!("every joint at {BOARD_SPEED} rad/s, the speed limit that real boards start with"));
    says("README.md", format!("{GENTLE_FORCE} N at the tip to begin with"));
    let words = read("README.md").split("```").step_by(2).map(|text| text.split_whitespace().count()).sum::<usize>();
    assert!(words <= 650, "README.md has {words} words: it is read in two minutes");
}

#[test]
fn links_lead_to_files_and_headings() {
    let pages = ["CONTRIBUTING.md", "CHANGELOG.md", "clients/python/README.md"].map(|name| root().join(name));
    let (mut wrong, mut seen) = (Vec::new(), 0);
    for page in documents().into_iter().chain(pages) {
        let text = fs::read_to_string(&page).unwrap();
        for link in tables::links(&text) {
            seen += 1;
            let (file, heading) = link.split_once('#').unwrap_or((link, ""));
            let to = if file.is_empty() { page.clone() } else { page.parent().unwrap().join(file) };
            let slug = |line: &str| -> String {
                let is_kept = |c: char| c.is_alphanumeric() || "-_ ".contains(c);
                line.to_lowercase().chars().filter(|c| is_kept(*c)).collect::<String>().trim().replace(' ', "-")
            };
            let found = match heading {
                "" => to.exists(),
                _ => fs::read_to_string(&to)
                    .is_ok_and(|text| text.lines().any(|line| line.starts_with('#') && slug(line) == heading)),
            };
            if !found {
                wrong.push(format!("{}: {link}", page.display()));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(seen > 100, "{seen}");
}

/// If all columns of a table are columns of a linked CSV file, its rows are rows of that file.
#[test]
fn table_rows_are_rows_of_the_linked_file() {
    let (mut wrong, mut seen) = (Vec::new(), 0);
    for page in documents() {
        let text = fs::read_to_string(&page).unwrap();
        let files = tables::links(&text).filter(|link| link.ends_with(".csv"));
        let files: Vec<tables::Table> = files.map(|link| tables::csv(page.parent().unwrap().join(link))).collect();
        for shown in tables::markdown_tables(&text) {
            let columns = |file: &tables::Table| -> Option<Vec<usize>> {
                shown[0].iter().map(|name| file[0].iter().position(|other| other == name)).collect()
            };
            let files: Vec<_> = files.iter().filter_map(|file| Some((&file[1..], columns(file)?))).collect();
            for row in shown[1..].iter().filter(|_| !files.is_empty()) {
                seen += 1;
                let stands_in = |(rows, columns): &(&[Vec<String>], Vec<usize>)| {
                    rows.iter().any(|published_row| columns.iter().map(|at| &published_row[*at]).eq(row))
                };
                if !files.iter().any(stands_in) {
                    wrong.push(format!("{}: {row:?}", page.display()));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "rows that differ from the linked file:\n{}", wrong.join("\n"));
    assert!(seen > 40, "{seen}");
}

/// Text in backticks that begins with `haptic` or `cargo xtask` names existing commands and options.
#[test]
fn commands_in_sentences_exist() {
    let tool = |arguments: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_haptic")).args(arguments).output().unwrap();
        output.status.success().then(|| String::from_utf8(output.stdout).unwrap())
    };
    let xtask = read("xtask/src/main.rs");
    let is_word = |word: &str| !word.starts_with('-') && word.chars().all(|c| c.is_ascii_lowercase() || c == '-');
    let mut help: BTreeMap<String, Option<String>> = BTreeMap::new();
    let (mut wrong, mut seen) = (Vec::new(), 0);
    for path in documents() {
        let text = fs::read_to_string(&path).unwrap();
        for quoted in text.split('`').skip(1).step_by(2) {
            let words: Vec<&str> = quoted.split_whitespace().collect();
            let complain = |what: &str| format!("{}: `{quoted}`: {what}", path.display());
            match words.as_slice() {
                ["haptic", name, rest @ ..] if is_word(name) => {
                    seen += 1;
                    // Some commands have subcommands, such as `haptic board save`.
                    let command_words = 1 + usize::from(rest.first().is_some_and(|word| is_word(word)));
                    let help_command = [&words[1..=command_words], &["--help"]].concat();
                    let help = help.entry(help_command.join(" ")).or_insert_with(|| tool(&help_command));
                    match help {
                        None => wrong.push(complain("no such command")),
                        Some(help) => {
                            let options = rest.iter().map(|word| word.trim_start_matches('[').trim_end_matches(']'));
                            for option in options.filter(|word| word.starts_with("--") && word.len() > 2) {
                                let name = option.split('=').next().unwrap();
                                if !help.split(|c: char| c.is_whitespace() || c == ',').any(|word| word == name) {
                                    wrong.push(complain(&format!("no option {name}")));
                                }
                            }
                        }
                    }
                }
                ["cargo", "xtask", name, ..] => {
                    seen += 1;
                    // xtask's commands are variants of an enum: test-board is TestBoard.
                    let words = name.split('-').map(|word| word[..1].to_uppercase() + &word[1..]);
                    if !xtask.contains(&format!("\n    {}", words.collect::<String>())) {
                        wrong.push(complain("no such command"));
                    }
                }
                _ => {}
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(seen > 50, "{seen}");
}
