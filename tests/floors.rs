//! The modules of the library form floors. A module uses modules of its own floor and of lower floors only, and no
//! modules use each other in a circle.

use proc_macro2::{TokenStream, TokenTree};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use syn::visit::{self, Visit};

/// The floors from the ground up. Floors on the same level do not use each other.
const LEVELS: [&[&str]; 6] =
    [&["math", "checksum"], &["model"], &["render", "drive"], &["safety"], &["control"], &["board"]];

/// Returns the level of a floor.
fn level(floor: &str) -> Option<usize> {
    LEVELS.iter().position(|floors| floors.contains(&floor))
}

/// The source of a module: its path below `src/`, and every path in it, resolved from the crate's root.
struct Source {
    path: Vec<String>,
    paths: Vec<Vec<String>>,
}

impl Source {
    fn new(path: &str, text: &str) -> Self {
        let path: Vec<String> = path.trim_end_matches(".rs").split('/').map(String::from).collect();
        let file = syn::parse_file(text).unwrap_or_else(|error| panic!("{}: {error}", path.join("/")));
        let mut reader = Reader { module: path.clone(), paths: Vec::new() };
        reader.visit_file(&file);
        Self { path, paths: reader.paths }
    }

    fn floor(&self) -> &str {
        &self.path[0]
    }

    /// Returns the module of this file: the floor's own, or a module on the floor with its submodules.
    fn module(&self) -> String {
        self.path[..self.path.len().min(2)].join("::")
    }

    /// Returns the path of this file's own module.
    fn file(&self) -> String {
        self.path.join("::")
    }

    /// Returns the uses of modules on the same or a higher level, outside the source's own floor.
    fn upward(&self) -> Vec<String> {
        let own = level(self.floor()).unwrap_or_else(|| panic!("{} is on no floor", self.floor()));
        let other = |path: &&Vec<String>| path[0] != self.floor() && level(&path[0]).is_none_or(|other| other >= own);
        let mut wrong: Vec<String> = self
            .paths
            .iter()
            .filter(other)
            .map(|path| format!("{} uses {}", self.path.join("/"), path.join("::")))
            .collect();
        wrong.sort();
        wrong.dedup();
        wrong
    }
}

/// Collects paths that begin with `crate` or `super`. Relative paths stay inside the module and are ignored.
struct Reader {
    module: Vec<String>,
    paths: Vec<Vec<String>>,
}

impl Reader {
    /// Resolves a written path and stores it.
    fn take(&mut self, names: &[String]) {
        let mut place = match names.first().map(String::as_str) {
            Some("crate") => Vec::new(),
            Some("super") => self.module.clone(),
            _ => return,
        };
        for name in names {
            match name.as_str() {
                "crate" => {}
                "super" => drop(place.pop()),
                name => place.push(name.to_string()),
            }
        }
        // Exports of the crate's root (macros, `super` in a floor's own file) are not modules.
        if place.len() > 1 || place.first().is_some_and(|name| level(name).is_some()) {
            self.paths.push(place);
        }
    }

    /// Stores every path of a `use`.
    fn tree(&mut self, before: &[String], tree: &syn::UseTree) {
        let and = |name: &dyn ToString| [before, &[name.to_string()]].concat();
        match tree {
            syn::UseTree::Path(path) => self.tree(&and(&path.ident), &path.tree),
            syn::UseTree::Name(name) => self.take(&and(&name.ident)),
            syn::UseTree::Rename(name) => self.take(&and(&name.ident)),
            syn::UseTree::Glob(_) => self.take(before),
            syn::UseTree::Group(group) => group.items.iter().for_each(|item| self.tree(before, item)),
        }
    }

    /// Stores the paths in the tokens of a macro, which are not parsed as code.
    fn tokens(&mut self, tokens: TokenStream) {
        let mut names: Vec<String> = Vec::new();
        let mut joined = false;
        for token in tokens {
            match token {
                TokenTree::Ident(name) => {
                    if !joined {
                        self.take(&std::mem::take(&mut names));
                    }
                    names.push(name.to_string());
                    joined = false;
                }
                TokenTree::Punct(mark) if mark.as_char() == ':' => joined = true,
                other => {
                    // `crate::name!` is a macro and belongs to no floor.
                    let is_macro = matches!(&other, TokenTree::Punct(mark) if mark.as_char() == '!');
                    let names = std::mem::take(&mut names);
                    if !is_macro {
                        self.take(&names);
                    }
                    joined = false;
                    if let TokenTree::Group(group) = other {
                        self.tokens(group.stream());
                    }
                }
            }
        }
        self.take(&names);
    }
}

impl<'a> Visit<'a> for Reader {
    fn visit_item_use(&mut self, item: &'a syn::ItemUse) {
        self.tree(&[], &item.tree);
    }

    fn visit_path(&mut self, path: &'a syn::Path) {
        let names: Vec<String> = path.segments.iter().map(|segment| segment.ident.to_string()).collect();
        self.take(&names);
        visit::visit_path(self, path);
    }

    fn visit_macro(&mut self, call: &'a syn::Macro) {
        // The macro's own path is not a use of a floor.
        self.tokens(call.tokens.clone());
    }

    fn visit_item_mod(&mut self, item: &'a syn::ItemMod) {
        self.module.push(item.ident.to_string());
        visit::visit_item_mod(self, item);
        self.module.pop();
    }

    fn visit_visibility(&mut self, _: &'a syn::Visibility) {
        // `pub(super)` is not a use.
    }

    fn visit_attribute(&mut self, _: &'a syn::Attribute) {
        // Comments may link to any floor.
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

/// Reads the sources below a folder of the repository, except root files that only list modules.
fn sources_of(folder: &str) -> Vec<Source> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
    let mut found = Vec::new();
    sources(&root, &mut found);
    found
        .iter()
        .filter_map(|path| {
            let inside = path.strip_prefix(&root).expect("below the folder").to_str().expect("a plain name");
            let is_root = ["lib.rs", "main.rs"].contains(&inside) || inside.starts_with("bin/");
            (!is_root).then(|| Source::new(inside, &std::fs::read_to_string(path).expect("a readable source")))
        })
        .collect()
}

fn library() -> Vec<Source> {
    sources_of("src")
}

/// Returns the uses among modules in circles. Modules without uses are removed until only circles and their users
/// remain.
/// `name` returns the module of a source.
fn circles(sources: &[Source], name: impl Fn(&Source) -> String) -> BTreeMap<String, BTreeSet<String>> {
    let modules: BTreeSet<String> = sources.iter().map(&name).collect();
    let mut uses: BTreeMap<String, BTreeSet<String>> = modules.iter().map(|m| (m.clone(), BTreeSet::new())).collect();
    for source in sources {
        let own = name(source);
        for path in &source.paths {
            // The longest prefix of the path that is a module.
            let other = (1..=path.len()).rev().map(|end| path[..end].join("::")).find(|name| modules.contains(name));
            // Submodules may use their parents (files in `a/` may use `a.rs`).
            let others = other.filter(|other| *other != own && !own.starts_with(&format!("{other}::")));
            uses.entry(own.clone()).or_default().extend(others);
        }
    }
    let links: usize = uses.values().map(BTreeSet::len).sum();
    assert!(links > 0, "no use found");
    while let Some(outside) = uses.iter().find(|(_, others)| others.is_empty()).map(|(module, _)| module.clone()) {
        uses.remove(&outside);
        for others in uses.values_mut() {
            others.remove(&outside);
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
    let imports: usize = library.iter().map(|source| source.paths.len()).sum();
    assert!(imports > 100, "only {imports} imports found");
    let wrong: Vec<String> = library.iter().flat_map(Source::upward).collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn no_module_is_in_a_circle() {
    let library = library();
    for name in [Source::module, Source::file] {
        let circles = circles(&library, name);
        assert!(circles.is_empty(), "circles among {circles:#?}");
    }
    for folder in ["firmware/src", "emulator/src", "xtask/src"].into_iter().chain(HOST) {
        let sources = sources_of(folder);
        let mut names: Vec<fn(&Source) -> String> = vec![|source| source.floor().to_string()];
        if HOST.contains(&folder) {
            // Modules here have files in them, which must not be in a circle either.
            names.extend([Source::module as fn(&Source) -> String, Source::file]);
        }
        for name in names {
            let circles = circles(&sources, name);
            assert!(circles.is_empty(), "{folder}: circles among {circles:#?}");
        }
    }
}

/// Returns the types that a source declares, and the names in the fields of its structs.
fn types(text: &str) -> (BTreeSet<String>, BTreeSet<String>) {
    struct Names(BTreeSet<String>);
    impl<'a> Visit<'a> for Names {
        fn visit_path(&mut self, path: &'a syn::Path) {
            self.0.extend(path.segments.iter().map(|segment| segment.ident.to_string()));
            visit::visit_path(self, path);
        }
    }
    let file = syn::parse_file(text).expect("a source that compiles");
    let (mut declared, mut held) = (BTreeSet::new(), Names(BTreeSet::new()));
    for item in &file.items {
        match item {
            syn::Item::Struct(item) => {
                declared.insert(item.ident.to_string());
                item.fields.iter().for_each(|field| held.visit_type(&field.ty));
            }
            syn::Item::Enum(item) => drop(declared.insert(item.ident.to_string())),
            _ => {}
        }
    }
    (declared, held.0)
}

/// Returns the child modules that use their parent's types while the parent's structs have fields of the child's types.
/// `texts` are sources by the paths of their modules.
fn children_in_circles(texts: &BTreeMap<String, String>) -> Vec<String> {
    let mut found = Vec::new();
    for (child, text) in texts {
        let Some((parent, _)) = child.rsplit_once("::") else { continue };
        let Some(above) = texts.get(parent) else { continue };
        let (own, held) = types(above);
        let (declared, _) = types(text);
        let source = Source::new(&format!("{}.rs", child.replace("::", "/")), text);
        let used = |name: &String| {
            let path: Vec<&str> = parent.split("::").chain([name.as_str()]).collect();
            source.paths.iter().any(|used| used.iter().map(String::as_str).eq(path.iter().copied()))
        };
        if !declared.is_disjoint(&held) && own.iter().any(used) {
            found.push(child.clone());
        }
    }
    found
}

/// Modules of the library that are in such a circle with their parents. The list may only shrink.
const CHILDREN_IN_CIRCLES: [&str; 8] = [
    "control::budgets",
    "control::crest",
    "control::fade",
    "control::host_force",
    "control::polarity",
    "control::requests",
    "render::controller::straight",
    "render::velocity::low_pass",
];

#[test]
fn no_new_child_is_in_a_circle_with_its_parent() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut paths = Vec::new();
    sources(&root, &mut paths);
    let name = |path: &PathBuf| {
        let inside = path.strip_prefix(&root).expect("below the folder").to_str().expect("a plain name");
        inside.trim_end_matches(".rs").replace('/', "::")
    };
    let read = |path: &PathBuf| std::fs::read_to_string(path).expect("a readable source");
    let texts: BTreeMap<String, String> = paths.iter().map(|path| (name(path), read(path))).collect();
    assert_eq!(children_in_circles(&texts), CHILDREN_IN_CIRCLES);
}

#[test]
fn a_child_in_a_circle_with_its_parent_is_found() {
    let text = |of: &str| match of {
        "a" => "mod b; struct A { b: [b::B; 3] } struct C;",
        _ => "use super::A; struct B; impl A {}",
    };
    let texts = |child: &str| ["a", child].map(|name| (name.to_string(), text(name).to_string())).into();
    assert_eq!(children_in_circles(&texts("a::b")), ["a::b"]);
    assert_eq!(children_in_circles(&texts("c::b")), [""; 0]);
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
fn an_import_from_a_higher_or_equal_level_is_found() {
    let wrong = |path: &str, text: &str| Source::new(path, text).upward().len();
    assert_eq!(wrong("model/device.rs", "use crate::control::ControlLoop;"), 1);
    assert_eq!(wrong("model/device.rs", "fn f(x: crate::board::settings::Key) {}"), 1);
    assert_eq!(wrong("render/scene/plane.rs", "use crate::drive::carrier::Carrier;"), 1);
    assert_eq!(wrong("model/device.rs", "use crate::{math, render::scene, board};"), 2);
    assert_eq!(wrong("math.rs", "use crate::checksum::crc32;"), 1);
    assert_eq!(wrong("model/device.rs", "use super::super::control::ControlLoop;"), 1);
    assert_eq!(wrong("control.rs", "use super::board::settings::Key;"), 1);
    assert_eq!(wrong("model/mechanism/five_bar.rs", "use super::super::super::render::scene::Scene;"), 1);
    assert_eq!(wrong("model/mechanism.rs", "mod tests { use super::super::super::render::scene::Scene; }"), 1);
    assert_eq!(wrong("model/device.rs", "use crate::{model::{catalogue::Kind, solve}, board::settings};"), 1);
    assert_eq!(wrong("model/device.rs", "define! { [crate::board::settings::Key] }"), 1);
    assert_eq!(wrong("model/mechanism/five_bar.rs", "use super::super::solve; use super::Mechanism;"), 0);
    assert_eq!(wrong("control/watch.rs", "use crate::safety::fault::Fault;\ncrate::mechanisms!(define);"), 0);
    assert_eq!(wrong("model/device.rs", "// see crate::control::ControlLoop"), 0);
}

/// The crates of the computer's side, the tool last. Cargo prevents imports of a crate by a lower crate.
const HOST: [&str; 7] = [
    "host/src",
    "crates/flash/src",
    "crates/sim/src",
    "crates/stability/src",
    "crates/predict/src",
    "crates/show/src",
    "tool/src",
];

/// Names of boards and chips that the library must not contain, because all boards share it.
const FOREIGN: [&str; 6] = ["odrive", "h-bridge", "stm32", "f405", "cortex", "embassy"];

/// Returns the names of [`FOREIGN`] in a source without its comments.
fn foreign_names(text: &str) -> Vec<&'static str> {
    let code: String = text.lines().map(|line| line.split("//").next().unwrap_or_default().to_lowercase()).collect();
    let code = code.replace('_', "-");
    FOREIGN.into_iter().filter(|word| code.contains(word)).collect()
}

#[test]
fn the_library_names_no_board_and_no_chip() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut found = Vec::new();
    sources(&root, &mut found);
    assert!(found.len() > 60, "only {} sources", found.len());
    for path in &found {
        let words = foreign_names(&std::fs::read_to_string(path).expect("a readable source"));
        assert!(words.is_empty(), "{}: {words:?}", path.display());
    }
    assert_eq!(
        foreign_names("const NAME: &str = \"ODrive\"; // stm32\nfn h_bridge_f405() {}"),
        ["odrive", "h-bridge", "f405"]
    );
}

/// Files below the tool that write complete command lines, for people or for another program.
const WRITERS: [&str; 4] = [
    "crates/stability/src/analysis/prediction.rs",
    "crates/predict/src/plausible/scene.rs",
    "crates/show/src/demo.rs",
    "crates/flash/src/probe.rs",
];

/// Returns the texts in a source that name an option of a command line, without comments and tests.
fn option_texts(tokens: TokenStream) -> Vec<String> {
    let tokens: Vec<TokenTree> = tokens.into_iter().collect();
    let is_comment = |at: usize| at >= 2 && tokens[at - 2].to_string() == "doc";
    let names_option =
        |text: &str| text.split("--").skip(1).any(|rest| rest.starts_with(|c: char| c.is_ascii_lowercase()));
    let found = tokens.iter().enumerate().flat_map(|(at, token)| match token {
        TokenTree::Group(group) => option_texts(group.stream()),
        TokenTree::Literal(text) if !is_comment(at) && names_option(&text.to_string()) => vec![text.to_string()],
        _ => Vec::new(),
    });
    found.collect()
}

fn without_tests(text: &str) -> TokenStream {
    text.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default().parse().expect("a source that compiles")
}

#[test]
fn no_crate_below_the_tool_names_an_option_of_the_tool() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut found = Vec::new();
    for folder in HOST.iter().filter(|folder| **folder != "tool/src") {
        sources(&root.join(folder), &mut found);
    }
    let (mut read, mut wrong) = (0, Vec::new());
    for path in &found {
        let inside = path.strip_prefix(root).expect("below the root").to_str().expect("a plain name");
        if WRITERS.contains(&inside) {
            continue;
        }
        read += 1;
        let text = std::fs::read_to_string(path).expect("a readable source");
        wrong.extend(option_texts(without_tests(&text)).into_iter().map(|text| format!("{inside}: {text}")));
    }
    assert!(read > 100, "only {read} sources");
    assert_eq!(wrong, Vec::<String>::new(), "let main.rs name the option that makes a `Choice`");
}

#[test]
fn an_option_in_a_text_is_found() {
    let text =
        "/// By `--q`.\nfn f() { g(\"another with --q\"); }\n#[cfg(test)]\nmod tests { const T: &str = \"--p\"; }";
    assert_eq!(option_texts(without_tests(text)), ["\"another with --q\""]);
}
