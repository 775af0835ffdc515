//! Tables in documents, and linked CSV files.

use super::blocks::root;
use std::fs;
use std::path::Path;

/// The rows of a table, header first.
pub type Table = Vec<Vec<String>>;

/// Reads a CSV file, whose path is relative to the repository.
pub fn csv(path: impl AsRef<Path>) -> Table {
    let path = root().join(path);
    let text = fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    text.lines().map(cells).collect()
}

/// Splits a line into cells. Quoted cells may contain commas and doubled quotes.
fn cells(line: &str) -> Vec<String> {
    let (mut cells, mut quoted) = (vec![String::new()], false);
    let mut characters = line.chars().peekable();
    while let Some(character) = characters.next() {
        let cell = cells.last_mut().unwrap();
        match character {
            '"' if quoted && characters.next_if_eq(&'"').is_some() => cell.push('"'),
            '"' => quoted = !quoted,
            ',' if !quoted => cells.push(String::new()),
            other => cell.push(other),
        }
    }
    cells
}

/// Returns the tables of a Markdown document with the emphasis removed.
pub fn markdown_tables(text: &str) -> Vec<Table> {
    let (mut tables, mut open) = (Vec::new(), Table::new());
    for line in text.lines().chain([""]) {
        match line.strip_prefix('|').and_then(|line| line.trim_end().strip_suffix('|')) {
            Some(row) if row.chars().all(|c| "-:| ".contains(c)) => {}
            Some(row) => open.push(row.split('|').map(|cell| cell.replace("**", "").trim().into()).collect()),
            None if !open.is_empty() => tables.push(std::mem::take(&mut open)),
            None => {}
        }
    }
    tables
}

/// Returns the local targets of a document's links, `[text](target)`.
pub fn links(text: &str) -> impl Iterator<Item = &str> {
    text.split("](").skip(1).filter_map(|rest| rest.split(')').next()).filter(|link| !link.starts_with("http"))
}

#[test]
fn cells_may_be_quoted_and_tables_end_at_other_lines() {
    assert_eq!(cells("a,\"b, \"\"c\"\"\",,d"), ["a", "b, \"c\"", "", "d"]);
    let tables = markdown_tables("| a | **b** |\n|---|--:|\n| 1 |  |\n<!-- -->\n| c |\n");
    assert_eq!(tables, [vec![vec!["a", "b"], vec!["1", ""]], vec![vec!["c"]]]);
}
