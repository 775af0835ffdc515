//! The pictures in docs/drawings/, the demo's and the maps in docs/results/ are what the tool draws now.

use crate::common::{file, files, haptic, root, shipped};
use haptic_bridge::model::admissible::Admissible;
use haptic_show::plot::coupling::draw;
use haptic_show::plot::paper::Paper;
use haptic_stability::analysis::pose::TaskPose;
use haptic_stability::skeleton::{Turret, skeleton};

#[test]
fn the_drawings_of_the_documents_are_those_of_the_tool() {
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
        let device = file(&format!("{device}.toml"));
        haptic(&["check", &device, "--svg"]).arg(&drawn).assert().success();
        let kept = std::fs::read_to_string(root().join("docs/drawings").join(format!("{drawing}.svg"))).unwrap();
        assert!(
            std::fs::read_to_string(drawn).unwrap() == kept,
            "{drawing}.svg: docs/devices.md says how to draw it anew"
        );
    }
    // The eighth is a board's, which emulator/tests/emulated/drawing.rs holds.
    assert_eq!(std::fs::read_dir(root().join("docs/drawings")).unwrap().count(), 8);
}

#[test]
fn the_papers_first_figure_is_what_the_tool_draws() {
    let told = std::fs::read_to_string(root().join("docs/design.md")).unwrap();
    let line =
        "haptic design devices/coupled-five-bar.toml --q 2.6,1.75 --normal 0.94,-0.34 --points 300 --svg coupling.svg";
    assert!(told.contains(line) && told.contains("(drawings/coupling.svg)"));
    // The search of that line has no part in the picture.
    let device = shipped("coupled-five-bar");
    let size = 0.94_f64.hypot(-0.34);
    let normal = [0.94 / size, -0.34 / size];
    let drawn = draw(&device.description, &device.name, &[2.6, 1.75], &normal, Admissible::default(), Paper::default());
    let drawn = drawn.unwrap().unwrap();
    let kept = std::fs::read_to_string(root().join("docs/drawings/coupling.svg")).unwrap();
    assert!(drawn.svg() == kept, "`{line}` draws docs/drawings/coupling.svg anew");
}

#[test]
fn the_pictures_of_the_results_are_what_their_commands_draw() {
    let folder = tempfile::tempdir().unwrap();
    let text = std::fs::read_to_string(root().join("docs/results.md")).unwrap();
    let ranges = std::fs::read_to_string(root().join("docs/results/ranges.sh")).unwrap();
    let mut lines: Vec<&str> =
        ranges.lines().filter(|line| line.starts_with("haptic map ") && line.contains(" docs/results/")).collect();
    assert_eq!(lines.len(), 2);
    let demo = "haptic demo --svg docs/results/demo.svg";
    assert!(text.contains(demo));
    lines.push(demo);
    let host = "haptic range devices/coupled-five-bar.toml --q 2.6,1.75 --normal 0.94,-0.34 --rate 20000 --cutoff 500 \
                --delay 0.5 --host-rate 1000 --host-delay 0.001 --svg docs/results/host-wall.svg";
    let told = std::fs::read_to_string(root().join("docs/host-force.md")).unwrap().replace("\\\n  ", "");
    assert!(told.contains(&host.replace("docs/results/", "")));
    lines.push(host);
    for line in lines {
        let mut words: Vec<String> = line.split_whitespace().skip(1).map(String::from).collect();
        let picture = words.iter_mut().find(|word| word.starts_with("docs/results/")).unwrap();
        let drawn = folder.path().join("drawn");
        let published = std::mem::replace(picture, drawn.display().to_string());
        if !line.contains("--force") {
            words.push("--force".into());
        }
        haptic(&words.iter().map(String::as_str).collect::<Vec<_>>()).assert().success();
        let kept = std::fs::read(root().join(&published)).unwrap();
        assert!(std::fs::read(drawn).unwrap() == kept, "`{line}` draws {published} anew");
    }
}

/// The numbers after `key`.
fn numbers(text: &str, key: &str) -> Vec<f64> {
    let value = text.split_once(key).unwrap_or_else(|| panic!("{key} in {text}")).1.split('"').next().unwrap();
    let words = value.split(|c: char| c.is_whitespace() || c.is_alphabetic()).filter(|word| !word.is_empty());
    words.map(|word| word.parse().unwrap()).collect()
}

#[test]
fn the_drawing_of_a_device_holds_all_of_its_reach() {
    let folder = tempfile::tempdir().unwrap();
    let mut grounds = 0;
    for entry in files("") {
        let drawn = folder.path().join("drawn.svg");
        haptic(&["check", "--force"]).arg(&entry).arg("--svg").arg(&drawn).assert().success();
        let svg = std::fs::read_to_string(&drawn).unwrap();
        let Some(ground) = svg.lines().find(|line| line.starts_with("<path transform")) else { continue };
        grounds += 1;
        let clip = svg.lines().find(|line| line.starts_with("<clipPath")).unwrap();
        let [x, y, width, height] = [" x=\"", " y=\"", " width=\"", " height=\""].map(|key| numbers(clip, key)[0]);
        // Steps of tenths of a pixel, every outline from where the one before began.
        let path = ground.split_once(" d=\"").unwrap().1.split('"').next().unwrap();
        let mut began = [0.0, 0.0];
        for outline in path.split('z').filter(|outline| !outline.is_empty()) {
            let steps = numbers(&format!("d=\"{outline}\""), "d=\"");
            let mut pen = began;
            for (index, step) in steps.chunks_exact(2).enumerate() {
                pen = [pen[0] + step[0] / 10.0, pen[1] + step[1] / 10.0];
                if index == 0 {
                    began = pen;
                }
                let inside = (x..=x + width).contains(&pen[0]) && (y..=y + height).contains(&pen[1]);
                assert!(inside, "{}: {pen:?} is outside of {clip}", entry.display());
            }
        }
    }
    assert!(grounds > 5);
}

#[test]
fn every_drawn_tip_is_where_the_model_has_it() {
    for name in ["pantograph-mk2", "fictive-five-bar-turret", "phantom-premium-1.5", "serial-3r", "coupled-five-bar"] {
        let description = shipped(name).description;
        let mut seen = 0;
        for i in 0..200 {
            let angle = |step: f64| (f64::from(i) * step).sin() * 3.0;
            let mut q = vec![angle(0.7), angle(1.3), angle(2.9)];
            q.truncate(description.kind.spec().joints);
            let drawn = skeleton(&description, &q);
            if Turret::of(description.kind).is_some() {
                q[0] = 0.0;
            }
            let pose = TaskPose::at(&description, &q).unwrap();
            if pose.regularity.parallel < 1e-6 {
                continue;
            }
            let tip = drawn.unwrap().tip;
            assert!((tip.0 - pose.position[0]).hypot(tip.1 - pose.position[1]) < 1e-12, "{name} {q:?}");
            seen += 1;
        }
        assert!(seen > 50, "{name}: {seen}");
    }
}
