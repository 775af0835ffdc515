//! The library is a house of floors: what lies on one may use its own and those below, and no module is in a circle.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// The floors from the ground up; those that stand on the same level do not know each other.
const LEVELS: [&[&str]; 6] =
    [&["math", "checksum"], &["model"], &["render", "drive"], &["safety"], &["servo"], &["board"]];

/// Level of a floor.
fn level(floor: &str) -> Option<usize> {
    LEVELS.iter().position(|floors| floors.contains(&floor))
}

/// A module's source: its place below `src/`, and its text.
struct Source {
    path: Vec<String>,
    text: String,
}

impl Source {
    fn new(path: &str, text: &str) -> Self {
        let path = path.trim_end_matches(".rs").split('/').map(String::from).collect();
        // Comments link where they like, and so do those that macros make of text in quotes.
        let code = text.lines().map(|line| {
            let outside: String = line.split('"').step_by(2).collect();
            outside.split("//").next().unwrap_or_default().to_string()
        });
        Self { path, text: code.collect::<Vec<_>>().join("\n") }
    }

    fn floor(&self) -> &str {
        &self.path[0]
    }

    /// The module that this file belongs to: a floor's own, or one on it with everything below.
    fn module(&self) -> String {
        self.path[..self.path.len().min(2)].join("::")
    }

    /// Every `crate::a::b` in it, as (a, b); macros, which the crate's root exports, aside.
    fn imports(&self) -> Vec<(String, String)> {
        let parts = self.text.split("crate::").skip(1);
        parts
            .filter_map(|rest| {
                let end = rest.find(|c: char| !(c.is_alphanumeric() || c == '_' || c == ':')).unwrap_or(rest.len());
                let mut names = rest[..end].split("::");
                let (floor, module) = (names.next()?, names.next().unwrap_or_default());
                (!rest[end..].starts_with('!')).then(|| (floor.to_string(), module.to_string()))
            })
            .collect()
    }

    /// What it uses that is not below it.
    fn upward(&self) -> Vec<String> {
        let own = level(self.floor()).unwrap_or_else(|| panic!("{} is on no floor", self.floor()));
        let mut wrong: Vec<String> = self
            .imports()
            .into_iter()
            .filter(|(floor, _)| floor != self.floor() && level(floor).is_none_or(|other| other >= own))
            .map(|(floor, module)| format!("{} uses {floor}::{module}", self.path.join("/")))
            .collect();
        if self.text.contains("super::super") && self.path.len() <= 2 {
            wrong.push(format!("{} reaches outside its floor by super::super", self.path.join("/")));
        }
        wrong
    }
}

fn sources(directory: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(directory).expect("a readable directory") {
        let path = entry.expect("a readable entry").path();
        if path.is_dir() {
            sources(&path, found);
        } else if path.extension().is_some_and(|end| end == "rs") {
            found.push(path);
        }
    }
}

/// The library, but for the root, which lists the floors.
fn library() -> Vec<Source> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut found = Vec::new();
    sources(&root, &mut found);
    found
        .iter()
        .filter(|path| !path.ends_with("src/lib.rs"))
        .map(|path| {
            let inside = path.strip_prefix(&root).expect("below src").to_str().expect("a plain name");
            Source::new(inside, &std::fs::read_to_string(path).expect("a readable source"))
        })
        .collect()
}

#[test]
fn imports_go_down_only() {
    let library = library();
    for floor in LEVELS.iter().copied().flatten() {
        assert!(library.iter().any(|source| source.floor() == *floor), "no floor {floor}");
    }
    let imports: usize = library.iter().map(|source| source.imports().len()).sum();
    assert!(imports > 100, "only {imports} imports found");
    let wrong: Vec<String> = library.iter().flat_map(Source::upward).collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn no_module_is_in_a_circle() {
    let library = library();
    let modules: BTreeSet<String> = library.iter().map(Source::module).collect();
    let mut uses: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for source in &library {
        let own = source.module();
        for (floor, module) in source.imports() {
            let other = [format!("{floor}::{module}"), floor].into_iter().find(|name| modules.contains(name));
            uses.entry(own.clone()).or_default().extend(other.filter(|other| *other != own));
        }
    }
    assert!(uses.len() > 20, "only {} modules use others", uses.len());
    // Whatever uses nothing that is left is taken away, until only circles remain.
    while let Some(free) =
        modules.iter().find(|module| uses.get(*module).is_some_and(BTreeSet::is_empty)).cloned().or_else(|| {
            let named: BTreeSet<&String> = uses.values().flatten().collect();
            named.into_iter().find(|name| !uses.contains_key(*name)).cloned()
        })
    {
        uses.remove(&free);
        uses.values_mut().for_each(|others| {
            others.remove(&free);
        });
    }
    assert!(uses.is_empty(), "circles among {uses:#?}");
}

#[test]
fn an_import_that_runs_up_or_across_is_found() {
    let wrong = |path: &str, text: &str| Source::new(path, text).upward().len();
    assert_eq!(wrong("model/device.rs", "use crate::servo::Servo;"), 1);
    assert_eq!(wrong("model/device.rs", "fn f(x: crate::board::settings::Key) {}"), 1);
    assert_eq!(wrong("render/scene/plane.rs", "use crate::drive::carrier::Carrier;"), 1);
    assert_eq!(wrong("math.rs", "use crate::checksum::crc32;"), 1);
    assert_eq!(wrong("model/device.rs", "use super::super::servo::Servo;"), 1);
    assert_eq!(wrong("servo/watch.rs", "use crate::safety::fault::Fault;\ncrate::mechanisms!(define);"), 0);
    assert_eq!(wrong("model/device.rs", "// see crate::servo::Servo"), 0);
}
