//! Updates the tables of documents from their linked CSV files.

use std::fs;

use anyhow::Result;

mod blocks {
    pub use crate::paths::root;
}
#[allow(dead_code, reason = "only the tests of the documents use the rest")]
#[path = "../../tool/tests/common/documents/tables.rs"]
mod tables;

/// Updates the tables of docs/results/*.md.
pub fn refresh() -> Result<()> {
    let folder = blocks::root().join("docs/results");
    for entry in fs::read_dir(&folder)? {
        let path = entry?.path();
        if path.extension().is_some_and(|extension| extension == "md") {
            let text = fs::read_to_string(&path)?;
            let links = tables::links(&text).filter(|link| link.ends_with(".csv"));
            let files: Vec<tables::Table> = links.map(|link| tables::csv(folder.join(link))).collect();
            fs::write(&path, with_rows_of(&files, &text))?;
        }
    }
    Ok(())
}

/// Updates the tables in `text` all of whose columns are columns of a file. Replaces a row by the row of the file with
/// the most equal cells from the left, if at least the first cell is equal.
fn with_rows_of(files: &[tables::Table], text: &str) -> String {
    let (mut in_table, mut source) = (false, None);
    let lines = text.lines().map(|line| {
        let row = line.strip_prefix('|').and_then(|line| line.strip_suffix('|'));
        let cells: Vec<&str> = row.map_or(vec![], |row| row.split('|').map(str::trim).collect());
        if cells.is_empty() || !in_table {
            in_table = !cells.is_empty();
            let columns = |file: &tables::Table| -> Option<Vec<usize>> {
                cells.iter().map(|name| file[0].iter().position(|other| other == name)).collect()
            };
            source = files.iter().filter(|_| in_table).find_map(|file| Some((file, columns(file)?)));
        } else if let Some((file, columns)) = &source {
            let agreeing =
                |row: &&Vec<String>| cells.iter().zip(columns).take_while(|(c, at)| row[**at] == **c).count();
            if let Some(row) = file[1..].iter().rev().max_by_key(agreeing).filter(|row| agreeing(row) > 0) {
                return columns.iter().fold("|".to_string(), |line, at| line + " " + &row[*at] + " |") + "\n";
            }
        }
        line.to_string() + "\n"
    });
    lines.collect()
}
