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
            .flat_map(|rest| match rest.strip_prefix('{') {
                // Several at once.
                Some(list) => list.split('}').next().unwrap_or_default().split(',').filter_map(import).collect(),
                None => import(rest).into_iter().collect::<Vec<_>>(),
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

/// The (a, b) of a path `a::b` that a text starts with; none of a macro.
fn import(text: &str) -> Option<(String, String)> {
    let text = text.trim_start();
    let end = text.find(|c: char| !(c.is_alphanumeric() || c == '_' || c == ':')).unwrap_or(text.len());
    let mut names = text[..end].split("::");
    let (floor, module) = (names.next()?, names.next().unwrap_or_default());
    (!text[end..].starts_with('!')).then(|| (floor.to_string(), module.to_string()))
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

/// The sources below a folder of the repository, but for those roots that list the others.
fn sources_of(folder: &str) -> Vec<Source> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
    let mut found = Vec::new();
    sources(&root, &mut found);
    found
        .iter()
        .filter_map(|path| {
            let inside = path.strip_prefix(&root).expect("below the folder").to_str().expect("a plain name");
            let listed = ["lib.rs", "main.rs"].contains(&inside) || inside.starts_with("bin/");
            (!listed).then(|| Source::new(inside, &std::fs::read_to_string(path).expect("a readable source")))
        })
        .collect()
}

fn library() -> Vec<Source> {
    sources_of("src")
}

/// Which modules use which, of those that are in a circle: whatever uses nothing that is left is taken away, until only
/// circles, and what leads to them, remain. `name` says to which module a source belongs.
fn circles(sources: &[Source], name: impl Fn(&Source) -> String) -> BTreeMap<String, BTreeSet<String>> {
    let modules: BTreeSet<String> = sources.iter().map(&name).collect();
    let mut uses: BTreeMap<String, BTreeSet<String>> = modules.iter().map(|m| (m.clone(), BTreeSet::new())).collect();
    for source in sources {
        let own = name(source);
        for (floor, module) in source.imports() {
            let other = [format!("{floor}::{module}"), floor].into_iter().find(|name| modules.contains(name));
            let others = other.filter(|other| *other != own);
            uses.entry(own.clone()).or_default().extend(others);
        }
    }
    let links: usize = uses.values().map(BTreeSet::len).sum();
    assert!(links > 20, "only {links} uses found");
    while let Some(free) = uses.iter().find(|(_, others)| others.is_empty()).map(|(module, _)| module.clone()) {
        uses.remove(&free);
        for others in uses.values_mut() {
            others.remove(&free);
        }
    }
    uses
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
    let library = circles(&library(), Source::module);
    assert!(library.is_empty(), "circles among {library:#?}");
    for folder in ["firmware/src", "emulator/src"] {
        let circles = circles(&sources_of(folder), |source| source.floor().to_string());
        assert!(circles.is_empty(), "{folder}: circles among {circles:#?}");
    }
}

#[test]
fn a_circle_is_found() {
    let chain: Vec<String> = (0..30).map(|i| format!("use crate::m{}::X;", i + 1)).collect();
    let mut sources: Vec<Source> =
        chain.iter().enumerate().map(|(i, text)| Source::new(&format!("m{i}.rs"), text)).collect();
    sources.push(Source::new("m30.rs", ""));
    let name = |source: &Source| source.floor().to_string();
    assert!(circles(&sources, name).is_empty());
    sources[30] = Source::new("m30.rs", "use crate::m28::X;");
    assert!(circles(&sources, name).contains_key("m29"));
}

#[test]
fn an_import_that_runs_up_or_across_is_found() {
    let wrong = |path: &str, text: &str| Source::new(path, text).upward().len();
    assert_eq!(wrong("model/device.rs", "use crate::servo::Servo;"), 1);
    assert_eq!(wrong("model/device.rs", "fn f(x: crate::board::settings::Key) {}"), 1);
    assert_eq!(wrong("render/scene/plane.rs", "use crate::drive::carrier::Carrier;"), 1);
    assert_eq!(wrong("model/device.rs", "use crate::{math, render::scene, board};"), 2);
    assert_eq!(wrong("math.rs", "use crate::checksum::crc32;"), 1);
    assert_eq!(wrong("model/device.rs", "use super::super::servo::Servo;"), 1);
    assert_eq!(wrong("servo/watch.rs", "use crate::safety::fault::Fault;\ncrate::mechanisms!(define);"), 0);
    assert_eq!(wrong("model/device.rs", "// see crate::servo::Servo"), 0);
}
