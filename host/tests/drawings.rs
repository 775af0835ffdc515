//! The pictures in docs/drawings/, the demo's and the maps in docs/results/ are what the tool draws now.

use assert_cmd::Command;
use std::path::Path;

#[test]
fn the_drawings_of_the_documents_are_those_of_the_tool() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let folder = tempfile::tempdir().unwrap();
    for (drawing, device) in [
        ("paddle", "hapkit-paddle"),
        ("five-bar", "pantograph-mk2"),
        ("five-bar-turret", "fictive-five-bar-turret"),
        ("parallelogram", "phantom-premium-1.5"),
        ("serial-3r", "serial-3r"),
        ("capstan-pantograph", "capstan-pantograph"),
    ] {
        let drawn = folder.path().join(drawing);
        let device = root.join("devices").join(format!("{device}.toml"));
        Command::cargo_bin("haptic").unwrap().arg("check").arg(device).arg("--svg").arg(&drawn).assert().success();
        let kept = std::fs::read_to_string(root.join("docs/drawings").join(format!("{drawing}.svg"))).unwrap();
        assert!(
            std::fs::read_to_string(drawn).unwrap() == kept,
            "{drawing}.svg: docs/devices.md says how to draw it anew"
        );
    }
    assert_eq!(std::fs::read_dir(root.join("docs/drawings")).unwrap().count(), 6);
}

#[test]
fn the_pictures_of_the_results_are_what_their_commands_draw() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let folder = tempfile::tempdir().unwrap();
    let text = std::fs::read_to_string(root.join("docs/results.md")).unwrap();
    let mut lines: Vec<&str> = text.lines().filter(|line| line.starts_with("haptic map ")).collect();
    assert_eq!(lines.len(), 2);
    let demo = "haptic demo --svg docs/results/demo.svg";
    assert!(text.contains(demo));
    lines.push(demo);
    for line in lines {
        let mut words: Vec<String> = line.split_whitespace().skip(1).map(String::from).collect();
        let published = words.pop().unwrap();
        let drawn = folder.path().join("drawn");
        words.extend([drawn.display().to_string(), "--force".into()]);
        Command::cargo_bin("haptic").unwrap().current_dir(&root).args(words).assert().success();
        let kept = std::fs::read(root.join(&published)).unwrap();
        assert!(std::fs::read(drawn).unwrap() == kept, "`{line}` draws {published} anew");
    }
}
