//! `unsafe` stands only where the chip is: in the firmware binary, and in the images that count the step and prove it
//! free of panics.

use std::path::{Path, PathBuf};

const ALLOWED: [&str; 3] = ["firmware", "tests/no-panic", "benches/chip"];

fn sources(directory: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(directory).expect("a readable directory") {
        let path = entry.expect("a readable entry").path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if path.is_dir() && name != "target" && !name.starts_with('.') {
            sources(&path, found);
        } else if name.ends_with(".rs") {
            found.push(path);
        }
    }
}

/// Whether this line of code (not comment, not text in quotes) makes something unsafe.
fn is_unsafe(line: &str) -> bool {
    let code = line.split("//").next().unwrap_or_default();
    let marks =
        [concat!("uns", "afe {"), concat!("uns", "afe fn"), concat!("uns", "afe impl"), concat!("uns", "afe extern")];
    marks.iter().any(|mark| code.contains(mark)) || code.contains(concat!("[uns", "afe("))
}

#[test]
fn unsafe_code_is_only_where_the_chip_is() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut found = Vec::new();
    sources(root, &mut found);
    assert!(found.len() > 100, "{} sources", found.len());
    let mut allowed = 0;
    for path in found {
        let inside = path.strip_prefix(root).expect("below the root");
        let text = std::fs::read_to_string(&path).expect("a readable source");
        let lines = text.lines().filter(|line| is_unsafe(line)).count();
        if ALLOWED.iter().any(|place| inside.starts_with(place)) {
            allowed += lines;
        } else {
            assert_eq!(lines, 0, "{}", inside.display());
        }
    }
    assert!(allowed > 0, "this test finds what it looks for");
}

#[test]
fn library_and_tool_forbid_it_to_themselves() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    for file in ["src/lib.rs", "host/src/lib.rs", "host/src/main.rs"] {
        let text = std::fs::read_to_string(root.join(file)).expect("a crate's root");
        assert!(text.contains("#![forbid(unsafe_code)]"), "{file}");
    }
}
