//! Documents that show rows of the CSV files that they link to: whatever makes a file anew puts its rows there, too.

use std::fs;

use anyhow::{Context as _, Result};

use crate::paths::root;

mod blocks {
    pub use crate::paths::root;
}
#[allow(dead_code, reason = "the tests of the documents use the rest")]
#[path = "../../host/tool/tests/common/documents/tables.rs"]
mod tables;

/// Puts the rows of docs/results/*.csv into the tables that show them.
pub fn refresh() -> Result<()> {
    for folder in [root().join("docs"), root().join("docs/results")] {
        for entry in fs::read_dir(&folder)? {
            let path = entry?.path();
            if path.extension().is_none_or(|extension| extension != "md") {
                continue;
            }
            let text = fs::read_to_string(&path)?;
            let files = tables::links(&text).filter(|link| link.ends_with(".csv"));
            let files: Vec<tables::Table> = files.map(|link| tables::csv(folder.join(link))).collect();
            let now = with_rows_of(&files, &text);
            if now != text {
                fs::write(&path, now).with_context(|| format!("cannot write {}", path.display()))?;
                println!("{}: its tables are written anew", path.display());
            }
        }
    }
    Ok(())
}

/// `text` with each row of a table whose columns are all some of a file's as the file has it: the row that is the same in the
/// most cells from the left, at least one.
fn with_rows_of(files: &[tables::Table], text: &str) -> String {
    let mut shown: Option<Option<(&tables::Table, Vec<usize>)>> = None;
    let mut now = String::new();
    for line in text.lines() {
        let cells: Option<Vec<&str>> = line
            .strip_prefix('|')
            .and_then(|line| line.strip_suffix('|'))
            .map(|line| line.split('|').map(str::trim).collect());
        let mut made = line.to_string();
        match (&shown, cells) {
            (_, None) => shown = None,
            (None, Some(head)) => {
                let place = |file: &tables::Table, name: &&str| file[0].iter().position(|other| other == name);
                let columns = |file| head.iter().map(|name| place(file, name)).collect::<Option<Vec<_>>>();
                shown = Some(files.iter().find_map(|file| Some((file, columns(file)?))));
            }
            (Some(Some((file, columns))), Some(cells)) => {
                let same =
                    |row: &&Vec<String>| cells.iter().zip(columns).take_while(|(cell, at)| row[**at] == **cell).count();
                // The first of those that are as near.
                if let Some(row) = file[1..].iter().rev().max_by_key(same).filter(|row| same(row) > 0) {
                    made = columns.iter().fold("|".to_string(), |line, at| line + " " + &row[*at] + " |");
                }
            }
            (Some(None), Some(_)) => {}
        }
        now += &made;
        now += "\n";
    }
    now
}

#[test]
fn rows_follow_the_file_and_other_tables_stay() {
    let file: tables::Table =
        [["case", "rate", "ms"], ["a", "1", "2.5"], ["a", "2", "3.5"]].map(|row| row.map(String::from).into()).into();
    let text = "| case | ms | rate |\n|---|--:|--:|\n| a | 9 | 2 |\n\n| case | rate | ms |\n|---|---|---|\n| a | 2 | 9 |\n\n| x |\n|---|\n| a |\n";
    let now = text.replace("| a | 9 | 2 |", "| a | 2.5 | 1 |").replace("| a | 2 | 9 |", "| a | 2 | 3.5 |");
    assert_eq!(with_rows_of(&[file], text), now);
}
