//! The modules of the library form floors. A module uses only its own and lower floors, and modules do not form
//! circles.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{read_dir, read_to_string};
use std::path::{Path, PathBuf};

/// The floors from the lowest to the highest. Floors of one level do not use each other.
const LEVELS: [&[&str]; 6] =
    [&["math", "checksum"], &["model"], &["render", "drive"], &["safety"], &["control"], &["board"]];

/// The source folders of the host's crates, the tool last. Cargo prevents imports of a crate by a lower crate.
const HOST_FOLDERS: [&str; 7] = [
    "host/src",
    "crates/flash/src",
    "crates/sim/src",
    "crates/stability/src",
    "crates/predict/src",
    "crates/show/src",
    "tool/src",
];

/// Words for boards and chips, which must not occur in the library because all boards share the library.
const BOARD_WORDS: [&str; 6] = ["odrive", "h-bridge", "stm32", "f405", "cortex", "embassy"];

/// Files below the tool that may contain options because they write complete command lines.
const FILES_WITH_OPTIONS: [&str; 4] = [
    "crates/stability/src/analysis/prediction.rs",
    "crates/predict/src/plausible/scene.rs",
    "crates/show/src/demo.rs",
    "crates/flash/src/probe.rs",
];

const TEST_MODULE_START: &str = "#[cfg(test)]\nmod ";

fn level_of(floor: &str) -> Option<usize> {
    LEVELS.iter().position(|floors| floors.contains(&floor))
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn collect_files(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in read_dir(folder).expect("a readable folder") {
        let path = entry.expect("a readable entry").path();
        if path.is_dir() {
            collect_files(&path, found);
        } else if path.extension().is_some_and(|end| end == "rs") {
            found.push(path);
        }
    }
}

/// Returns the path (relative to `folder`) and the code without comments of each source file in `folder`.
fn sources(folder: &str) -> Vec<(String, String)> {
    let folder = root().join(folder);
    let mut found = Vec::new();
    collect_files(&folder, &mut found);
    let read = |path: PathBuf| {
        let text = read_to_string(&path).expect("a readable source");
        let lines = text.lines().filter(|line| !line.trim_start().starts_with("#[doc"));
        let code = lines.map(|line| line.split("//").next().unwrap_or_default().to_owned() + "\n").collect();
        (path.strip_prefix(&folder).expect("below the folder").to_str().expect("a plain name").to_owned(), code)
    };
    found.into_iter().map(read).collect()
}

/// A source file: its path below `src/`, and every path of this crate in it, from the crate's root.
struct Source {
    path: Vec<String>,
    uses: Vec<Vec<String>>,
}

impl Source {
    fn new(file: &str, code: &str) -> Self {
        let path: Vec<String> = file.trim_end_matches(".rs").split('/').map(String::from).collect();
        let mut source = Self { path: path.clone(), uses: Vec::new() };
        let (own, tests) = code.split_once(TEST_MODULE_START).unwrap_or((code, ""));
        source.record_paths(&path, own);
        source.record_paths(&[&path[..], &["tests".to_owned()]].concat(), tests);
        source
    }

    /// Records the paths in a module's code that begin with `crate` or `super`, also in braces. Other paths are local.
    fn record_paths(&mut self, module: &[String], code: &str) {
        let is_path = |c: char| c.is_alphanumeric() || "_:".contains(c);
        for start in ["crate::", "super::"] {
            for (at, _) in code.match_indices(start) {
                if code[..at].ends_with(is_path) {
                    continue;
                }
                let rest = &code[at..];
                let end = rest.find(|c| !is_path(c)).unwrap_or(rest.len());
                let (path, rest) = rest.split_at(end);
                let braces = rest.strip_prefix('{').and_then(|rest| rest.split('}').next());
                for name in braces.map_or(vec![""], |names| names.split(',').collect()) {
                    self.record_use(module, &(path.to_owned() + name.trim()));
                }
            }
        }
    }

    fn record_use(&mut self, module: &[String], path: &str) {
        let mut place = if path.starts_with("crate") { Vec::new() } else { module.to_vec() };
        for name in path.split("::").filter(|name| !name.is_empty()) {
            match name {
                "crate" => {}
                "super" => drop(place.pop()),
                name => place.push(name.to_owned()),
            }
        }
        // Leaves out exports of the crate's root, such as macros, because they are not modules.
        if place.len() > 1 || place.first().is_some_and(|name| level_of(name).is_some()) {
            self.uses.push(place);
        }
    }

    fn floor(&self) -> &str {
        &self.path[0]
    }

    /// Returns the path's first two parts: the floor, and the module on the floor.
    fn module(&self) -> String {
        self.path[..self.path.len().min(2)].join("::")
    }

    fn file(&self) -> String {
        self.path.join("::")
    }

    /// Returns the uses of other floors on the same or a higher level.
    fn upward_uses(&self) -> Vec<String> {
        let own = level_of(self.floor()).unwrap_or_else(|| panic!("{} is on no floor", self.floor()));
        let other =
            |path: &&Vec<String>| path[0] != self.floor() && level_of(&path[0]).is_none_or(|other| other >= own);
        self.uses.iter().filter(other).map(|path| format!("{} uses {}", self.path.join("/"), path.join("::"))).collect()
    }
}

/// Returns the modules below a folder of the repository, except files that only list modules.
fn modules(folder: &str) -> Vec<Source> {
    let is_root = |file: &str| ["lib.rs", "main.rs"].contains(&file) || file.starts_with("bin/");
    let sources = sources(folder).into_iter().filter(|(file, _)| !is_root(file));
    sources.map(|(file, code)| Source::new(&file, &code)).collect()
}

/// Returns the modules in circles and their uses. Repeatedly removes modules without uses, until only circles and their
/// users remain. `name` returns the module of a source.
fn modules_in_circles(sources: &[Source], name: impl Fn(&Source) -> String) -> BTreeMap<String, BTreeSet<String>> {
    let modules: BTreeSet<String> = sources.iter().map(&name).collect();
    let mut uses: BTreeMap<String, BTreeSet<String>> = modules.iter().map(|m| (m.clone(), BTreeSet::new())).collect();
    for source in sources {
        let own = name(source);
        for path in &source.uses {
            // The longest prefix of the path that is a module's name.
            let other = (1..=path.len()).rev().map(|end| path[..end].join("::")).find(|name| modules.contains(name));
            // A submodule may use its parents, so `a/b.rs` may use `a.rs`.
            let others = other.filter(|other| *other != own && !own.starts_with(&format!("{other}::")));
            uses.entry(own.clone()).or_default().extend(others);
        }
    }
    assert!(uses.values().any(|others| !others.is_empty()), "no use found");
    while let Some(outside) = uses.iter().find(|(_, others)| others.is_empty()).map(|(module, _)| module.clone()) {
        uses.remove(&outside);
        for others in uses.values_mut() {
            others.remove(&outside);
        }
    }
    uses
}

#[test]
fn floors_import_lower_floors_only() {
    let library = modules("src");
    for floor in LEVELS.iter().copied().flatten() {
        assert!(library.iter().any(|source| source.floor() == *floor), "no module is on the floor {floor}");
    }
    let uses: usize = library.iter().map(|source| source.uses.len()).sum();
    assert!(uses > 500, "only {uses} uses found");
    let violations: Vec<String> = library.iter().flat_map(Source::upward_uses).collect();
    assert!(violations.is_empty(), "{}", violations.join("\n"));
    // The reader must find a use in each of these forms.
    for code in ["use crate::control::A;", "x: crate::board::B", "use super::super::control::{C, D};", "[crate::board]"]
    {
        assert!(!Source::new("model/device.rs", code).upward_uses().is_empty(), "{code}");
    }
}

#[test]
fn no_module_is_in_a_circle() {
    for folder in ["src", "firmware/src", "emulator/src", "xtask/src"].into_iter().chain(HOST_FOLDERS) {
        let sources = modules(folder);
        let mut names: Vec<fn(&Source) -> String> = vec![|source| source.floor().to_string()];
        if folder == "src" || HOST_FOLDERS.contains(&folder) {
            // The files inside these modules must not form circles either.
            names.extend([Source::module as fn(&Source) -> String, Source::file]);
        }
        for name in names {
            let circles = modules_in_circles(&sources, name);
            assert!(circles.is_empty(), "{folder}: circles among {circles:#?}");
        }
    }
}

#[test]
fn the_library_names_no_board_and_no_chip() {
    let sources = sources("src");
    assert!(sources.len() > 60, "only {} sources found", sources.len());
    for (file, code) in sources {
        let code = code.to_lowercase().replace('_', "-");
        let words: Vec<&str> = BOARD_WORDS.into_iter().filter(|word| code.contains(word)).collect();
        assert!(words.is_empty(), "{file}: {words:?}");
    }
}

#[test]
fn no_crate_below_the_tool_names_an_option_of_the_tool() {
    let (mut read, mut violations) = (0, Vec::new());
    for folder in HOST_FOLDERS.iter().filter(|folder| **folder != "tool/src") {
        for (file, code) in sources(folder) {
            let path = format!("{folder}/{file}");
            if !FILES_WITH_OPTIONS.contains(&path.as_str()) {
                read += 1;
                let own = code.split(TEST_MODULE_START).next().unwrap_or_default();
                let names_option = |line: &&str| {
                    line.split("--").skip(1).any(|rest| rest.starts_with(|c: char| c.is_ascii_lowercase()))
                };
                violations.extend(own.lines().filter(names_option).map(|line| format!("{path}: {}", line.trim())));
            }
        }
    }
    assert!(read > 100, "only {read} sources found");
    assert_eq!(violations, Vec::<String>::new(), "let main.rs name the option that makes a `Choice`");
}
