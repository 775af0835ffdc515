//! What README.md and docs/ tell a reader to type works as it is written, as far as it is quick, and what they say of
//! commands and times is so. common/documents says how a block is tried.
#![cfg(unix)]

use crate::common::documents::blocks::{Block, Kind, blocks, documents, root};
use crate::common::documents::{all, session, tables};
use crate::common::sim::HANG;
use haptic_bridge::board::protocol::{MAX_FRAME, PROTOCOL};
use haptic_bridge::control::KEY_SECONDS;
use haptic_bridge::safety::limits::GENTLE_FORCE;
use haptic_predict::tip::BOARD_SPEED;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::process::Command;

#[test]
fn what_the_documents_say_to_type_works() {
    let run = |block: &Block| session::run(block, HANG);
    assert!(all(|kind| *kind == Kind::Quick, run) >= 2, "README alone has two");
}

#[test]
fn what_they_say_to_type_with_a_board_works() {
    assert!(all(|kind| *kind == Kind::Board, |block| session::run(block, HANG)) >= 1);
}

#[test]
fn the_files_that_they_show_are_sound() {
    let files = all(|kind| matches!(kind, Kind::File | Kind::Scene), session::check);
    assert!(files >= 2, "docs/files.md shows a device and a scene");
}

/// Lines too long for any test still begin in a checkout: none stops at a published picture, which is there, or at what
/// the line before it has measured.
#[test]
fn published_command_lines_work_where_their_pictures_are() {
    let (mut wrong, mut seen) = (Vec::new(), BTreeSet::new());
    let lines = blocks(&root().join("docs/results.md")).unwrap().into_iter().flat_map(|block| block.commands());
    let kept = fs::read_to_string(root().join("docs/results/ranges.sh")).unwrap();
    for line in lines.chain(kept.lines().map(String::from)) {
        let after = |option: &str| line.split_once(option).and_then(|(_, rest)| rest.split_whitespace().next());
        let picture = ["--svg ", "--png "].into_iter().find_map(after);
        if picture.is_some_and(|path| root().join(path).exists()) && !line.contains("--force") {
            wrong.push(format!("its picture exists: {line}"));
        }
        if line.starts_with("haptic measure-range") && !seen.insert(after("--progress ").map(str::to_string)) {
            wrong.push(format!("another line has its progress file: {line}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(seen.len() > 18 && !seen.contains(&None), "{seen:?}");
}

/// What docs/safety.md says in words of how soon broken sensors are seen holds for what was measured.
#[test]
fn the_times_of_the_motor_model_are_those_measured() {
    let said = "at most 0.5 ms ([measured](results/faults.md)); sensors frozen while a hand moves at most 15, 11, 7 ms";
    assert!(fs::read_to_string(root().join("docs/safety.md")).unwrap().contains(said));
    let (mut frozen, mut soon) = (Vec::new(), 0);
    for row in tables::csv("docs/results/broken.csv") {
        let [broken, _, seen, after, ..] = row.as_slice() else { panic!("{row:?}") };
        let Ok(after) = after.parse::<f64>() else { continue };
        if broken == "current sensors frozen, hand moves" {
            frozen.push(after);
        } else if seen.contains("MotorModel") && !broken.contains("frozen") {
            assert!(after <= 0.5, "{row:?}");
            soon += 1;
        }
    }
    assert!(soon >= 15, "{soon}");
    assert_eq!(frozen.len(), 3, "{frozen:?}");
    assert!(frozen.iter().zip([15.0, 11.0, 7.0]).all(|(found, said)| *found <= said), "{frozen:?}");
}

/// A number in a sentence or a table is the code's constant, or the committed figure.
#[test]
fn numbers_of_the_documents_are_those_of_the_code() {
    let says = |page: &str, said: String| {
        let text = fs::read_to_string(root().join(page)).unwrap();
        assert!(text.replace('\n', " ").contains(&said), "{page} should say: {said}");
    };
    says("docs/protocol.md", format!("version, now {PROTOCOL}."));
    says("docs/protocol.md", format!("at most {MAX_FRAME} bytes before"));
    says("docs/protocol.md", format!("at most {KEY_SECONDS} s (`KeyTooOld`)"));
    says("docs/safety.md", format!("every joint at {BOARD_SPEED} rad/s, the speed limit that real boards start with"));
    says("README.md", format!("{GENTLE_FORCE} N at the tip to begin with"));
    let counts = fs::read_to_string(root().join("crates/predict/src/bench/counts.json")).unwrap();
    let counts: serde_json::Value = serde_json::from_str(&counts).unwrap();
    for variant in counts["variants"].as_array().unwrap() {
        if let Some(mechanism) = variant["name"].as_str().unwrap().strip_suffix("/table/exact/feed-forward+z") {
            says("README.md", format!("| {mechanism} | {} |", variant["instructions"]));
        }
    }
}

/// The documents and what they say: a file, or a heading of one.
#[test]
fn links_lead_somewhere() {
    let pages = ["CONTRIBUTING.md", "CHANGELOG.md", "clients/python/README.md"].map(|name| root().join(name));
    let (mut wrong, mut seen) = (Vec::new(), 0);
    for page in documents().into_iter().chain(pages) {
        let text = fs::read_to_string(&page).unwrap();
        for link in tables::links(&text) {
            seen += 1;
            let (file, heading) = link.split_once('#').unwrap_or((link, ""));
            let to = if file.is_empty() { page.clone() } else { page.parent().unwrap().join(file) };
            let slug = |line: &str| -> String {
                let kept = |c: char| c.is_alphanumeric() || "-_ ".contains(c);
                line.to_lowercase().chars().filter(|c| kept(*c)).collect::<String>().trim().replace(' ', "-")
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

/// A document that shows rows of a CSV file that it links to shows them as they are: a table whose columns are all some of
/// the file's is made of its rows.
#[test]
fn rows_that_are_shown_of_a_file_stand_in_it() {
    let (mut wrong, mut seen) = (Vec::new(), 0);
    for page in documents() {
        let text = fs::read_to_string(&page).unwrap();
        let files = tables::links(&text).filter(|link| link.ends_with(".csv"));
        let files: Vec<tables::Table> = files.map(|link| tables::csv(page.parent().unwrap().join(link))).collect();
        for shown in tables::shown(&text) {
            let columns = |file: &tables::Table| -> Option<Vec<usize>> {
                shown[0].iter().map(|name| file[0].iter().position(|other| other == name)).collect()
            };
            let files: Vec<_> = files.iter().filter_map(|file| Some((&file[1..], columns(file)?))).collect();
            for row in shown[1..].iter().filter(|_| !files.is_empty()) {
                seen += 1;
                let stands_in = |(rows, columns): &(&[Vec<String>], Vec<usize>)| {
                    rows.iter().any(|kept| columns.iter().map(|at| &kept[*at]).eq(row))
                };
                if !files.iter().any(stands_in) {
                    wrong.push(format!("{}: {row:?}", page.display()));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "no row of the file:\n{}", wrong.join("\n"));
    assert!(seen > 40, "{seen}");
}

#[test]
fn the_readme_says_what_haptic_is_before_it_types_it() {
    let text = fs::read_to_string(root().join("README.md")).unwrap();
    let (said, typed) = (text.find("cargo install --path tool"), text.find("\nhaptic "));
    assert!(said.is_some() && said < typed, "{said:?}, {typed:?}");
}

/// Words between backticks that begin with `haptic` or `cargo xtask` name commands and options that there are.
#[test]
fn commands_in_sentences_exist() {
    let tool = |arguments: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_haptic")).args(arguments).output().unwrap();
        output.status.success().then(|| String::from_utf8(output.stdout).unwrap())
    };
    let xtask = fs::read_to_string(root().join("xtask/src/main.rs")).unwrap();
    let is_word =
        |word: &str| word.starts_with(char::is_alphabetic) && word.chars().all(|c| c.is_ascii_lowercase() || c == '-');
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
                    // Some commands stand under others: `haptic board save`.
                    let named = 1 + usize::from(rest.first().is_some_and(|word| is_word(word)));
                    let typed = [&words[1..=named], &["--help"]].concat();
                    let help = help.entry(typed.join(" ")).or_insert_with(|| tool(&typed));
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
                    // Words of the command line are variants there: test-board is TestBoard.
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
