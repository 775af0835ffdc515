//! The drawings in docs/drawings/ are what the tool draws of the devices that ship.

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
