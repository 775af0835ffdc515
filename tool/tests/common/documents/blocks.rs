//! The fenced blocks of a document, and the info strings that say how to run them.

pub use super::super::root;
use std::fs;
use std::path::{Path, PathBuf};

/// Kind of a fenced block, from its info string.
#[derive(Clone, Debug, PartialEq)]
pub enum Kind {
    /// Info string `sh`: the quick tests run the commands.
    Quick,
    /// Info string `sh board`: the quick tests run the commands with a strict simulated board.
    Board,
    /// Info string `sh slow: REASON`: the deep tests run the commands.
    Slow,
    /// Info string `LANGUAGE no-run: REASON`: no test runs the block.
    NoRun,
    /// Info string `toml device`: `haptic check` must accept the file.
    File,
    /// Info string `toml scene`: `haptic check` must accept the file as a scene of the coupled five-bar.
    Scene,
    /// Info string `text`: no test runs the block.
    Text,
}

/// A fenced block of a document.
#[derive(Clone, Debug, PartialEq)]
pub struct Block {
    /// Document and line of the block, for messages.
    pub place: String,
    pub kind: Kind,
    pub lines: Vec<String>,
}

impl Block {
    fn parse_kind(info: &str) -> Result<Kind, String> {
        let reasoned = |kind: Kind, reason: &str| match reason.split_whitespace().count() {
            0..=2 => Err(format!("`{info}` has no reason: write one of at least three words")),
            _ => Ok(kind),
        };
        match info.split_once(": ").unwrap_or((info, "")) {
            ("sh", "") => Ok(Kind::Quick),
            ("sh board", "") => Ok(Kind::Board),
            ("sh slow", reason) => reasoned(Kind::Slow, reason),
            (what, reason) if what.ends_with(" no-run") => reasoned(Kind::NoRun, reason),
            ("toml device", "") => Ok(Kind::File),
            ("toml scene", "") => Ok(Kind::Scene),
            ("text", "") => Ok(Kind::Text),
            _ => Err(format!("unknown info string `{info}`; tool/tests/common/documents/mod.rs lists the valid ones")),
        }
    }

    /// Returns the commands of the block, without comment lines and with continued lines joined.
    pub fn commands(&self) -> Vec<String> {
        let mut commands = Vec::new();
        let mut open = String::new();
        for line in self.lines.iter().map(|line| line.trim()).filter(|line| !line.is_empty() && !line.starts_with('#'))
        {
            match line.strip_suffix('\\') {
                Some(begun) => open.push_str(begun),
                None => commands.push(std::mem::take(&mut open) + line),
            }
        }
        commands
    }
}

/// Returns the paths of README.md and of all documents in docs/, docs/learn/ and docs/results/.
pub fn documents() -> Vec<PathBuf> {
    let folders = ["docs", "docs/learn", "docs/results"].map(|folder| fs::read_dir(root().join(folder)).unwrap());
    let mut paths: Vec<PathBuf> = folders.into_iter().flatten().map(|entry| entry.unwrap().path()).collect();
    paths.retain(|path| path.extension().is_some_and(|end| end == "md"));
    paths.push(root().join("README.md"));
    paths.sort();
    paths
}

/// Returns the blocks of a document. Fails if an info string is unknown or if a command is outside of a block.
pub fn blocks(path: &Path) -> Result<Vec<Block>, String> {
    let name = path.strip_prefix(root()).unwrap_or(path).display().to_string();
    parse(&name, &fs::read_to_string(path).unwrap())
}

fn parse(name: &str, text: &str) -> Result<Vec<Block>, String> {
    let mut blocks = Vec::new();
    let mut open: Option<Block> = None;
    for (index, line) in text.lines().enumerate() {
        let place = format!("{name}:{}", index + 1);
        match (line.trim_start().strip_prefix("```"), open.take()) {
            (Some(""), Some(block)) => blocks.push(block),
            (Some(info), None) => {
                let kind = Block::parse_kind(info).map_err(|error| format!("{place}: {error}"))?;
                open = Some(Block { place, kind, lines: Vec::new() });
            }
            (None, Some(mut block)) => {
                block.lines.push(line.into());
                open = Some(block);
            }
            (None, None) => {
                let indented = line.strip_prefix("    ").unwrap_or("");
                let programs = ["haptic ", "cargo ", "apt-get ", "dfu-util ", "rustup "];
                if programs.iter().any(|program| indented.starts_with(program)) {
                    return Err(format!("{place}: a command outside of a fenced block, move it into one: {line}"));
                }
            }
            (Some(_), Some(_)) => return Err(format!("{place}: a block inside of a block")),
        }
    }
    match open {
        Some(block) => Err(format!("{}: a block without an end", block.place)),
        None => Ok(blocks),
    }
}

#[test]
fn every_block_needs_information_on_running_it() {
    let kinds = |text: &str| parse("x.md", text).map(|blocks| blocks.into_iter().map(|b| b.kind).collect::<Vec<_>>());
    assert_eq!(kinds("```sh\nhaptic demo\n```\ntext\n```sh board\n```\n"), Ok(vec![Kind::Quick, Kind::Board]));
    assert_eq!(kinds("```sh no-run: needs a board on USB\n```\n"), Ok(vec![Kind::NoRun]));
    assert_eq!(kinds("```python no-run: needs pandas and a recording\n```\n"), Ok(vec![Kind::NoRun]));
    for wrong in ["```\n```\n", "```sh no-run:\n```\n", "```sh slow: later\n```\n", "    haptic demo\n", "```sh\n"] {
        assert!(kinds(wrong).is_err(), "{wrong}");
    }
    let block = &parse("x.md", "```sh\n# first\nhaptic range \\\n  --q 1\n\nhaptic demo # then\n```\n").unwrap()[0];
    assert_eq!(block.commands(), ["haptic range --q 1", "haptic demo # then"]);
}
