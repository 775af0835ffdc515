//! The tool draws the pictures in docs/drawings/ and docs/results/.

use crate::common::{Folder, read, root, shipped_device, svg_number, toml_files, type_lines};
use haptic_bridge::model::admissible::Admissible;
use haptic_show::plot::coupling::draw;
use haptic_show::plot::paper::Paper;
use haptic_stability::analysis::pose::TaskPose;
use haptic_stability::skeleton::{Turret, skeleton};

/// Runs a command that draws a published picture, but into a temporary folder, and compares the two pictures.
fn compare_picture(line: &str, published: &str) {
    let folder = Folder::new();
    let drawn_path = folder.path("drawn");
    type_lines(&line.replace(published, &drawn_path), &[]);
    let published_bytes = std::fs::read(root().join(published)).unwrap();
    assert!(std::fs::read(drawn_path).unwrap() == published_bytes, "`haptic {line} --force` updates {published}");
}

#[test]
fn the_pictures_of_the_documents_are_drawn_by_their_commands() {
    for (drawing, device) in [
        ("paddle", "hapkit-paddle"),
        ("five-bar", "pantograph-mk2"),
        ("five-bar-turret", "fictive-five-bar-turret"),
        ("parallelogram", "phantom-premium-1.5"),
        ("serial-3r", "serial-3r"),
        ("paddles", "two-paddles"),
        ("chain", "touch"),
        ("delta", "falcon-like"),
        ("capstan-pantograph", "capstan-pantograph"),
    ] {
        let drawing = format!("docs/drawings/{drawing}.svg");
        compare_picture(&format!("check devices/{device}.toml --svg {drawing}"), &drawing);
    }
    // The other two pictures show the coupling (next test) and a board (emulator/tests/emulated/drawing.rs).
    assert_eq!(std::fs::read_dir(root().join("docs/drawings")).unwrap().count(), 11);
    let ranges = read("docs/results/ranges.sh");
    let maps = ranges.lines().filter(|line| line.starts_with("haptic map ") && line.contains(" docs/results/"));
    let maps: Vec<&str> = maps.collect();
    assert_eq!(maps.len(), 2);
    let demo = "haptic demo --svg docs/results/demo.svg";
    assert!(read("docs/results.md").contains(demo));
    let host = "haptic range devices/coupled-five-bar.toml --q 2.6,1.75 --normal 0.94,-0.34 --rate 20000 --cutoff 500 \
                --delay 0.5 --host-rate 1000 --host-delay 0.001 --svg docs/results/host-wall.svg";
    assert!(read("docs/host-force.md").replace("\\\n  ", "").contains(&host.replace("docs/results/", "")));
    for line in maps.into_iter().chain([demo, host]) {
        let line = line.strip_prefix("haptic ").unwrap().replace(" --force", "");
        let picture = line.split(' ').find(|word| word.starts_with("docs/results/")).unwrap();
        compare_picture(&line, picture);
    }
}

/// Leaves out the search of the command, which takes minutes and does not affect the picture.
#[test]
fn the_coupling_picture_is_drawn_by_its_command() {
    let line =
        "haptic design devices/coupled-five-bar.toml --q 2.6,1.75 --normal 0.94,-0.34 --points 300 --svg coupling.svg";
    let page = read("docs/design.md");
    assert!(page.contains(line) && page.contains("(drawings/coupling.svg)"));
    let device = shipped_device("coupled-five-bar");
    let size = 0.94_f64.hypot(-0.34);
    let normal = [0.94 / size, -0.34 / size];
    let image = draw(&device.description, &device.name, &[2.6, 1.75], &normal, Admissible::default(), Paper::default());
    let image = image.unwrap().unwrap();
    assert!(image.svg() == read("docs/drawings/coupling.svg"), "`{line}` updates docs/drawings/coupling.svg");
}

/// Returns the numbers after `key`.
fn numbers_after_key(text: &str, key: &str) -> Vec<f64> {
    let value = text.split_once(key).unwrap_or_else(|| panic!("{key} in {text}")).1.split('"').next().unwrap();
    let words = value.split(|c: char| c.is_whitespace() || c.is_alphabetic()).filter(|word| !word.is_empty());
    words.map(|word| word.parse().unwrap()).collect()
}

#[test]
fn the_drawing_of_a_device_contains_its_whole_reach() {
    let folder = Folder::new();
    let svg_path = folder.path("drawn.svg");
    let mut grounds = 0;
    for entry in toml_files("") {
        type_lines(&format!("check {} --force --svg {svg_path}", entry.display()), &[]);
        let svg = std::fs::read_to_string(&svg_path).unwrap();
        let Some(ground) = svg.lines().find(|line| line.starts_with("<path transform")) else { continue };
        grounds += 1;
        let clip = svg.lines().find(|line| line.starts_with("<clipPath")).unwrap();
        let [x, y, width, height] = ["x", "y", "width", "height"].map(|key| svg_number(clip, key).unwrap());
        // Coordinates are steps in tenths of a pixel. An outline starts relative to the start of the previous outline.
        let path = ground.split_once(" d=\"").unwrap().1.split('"').next().unwrap();
        let mut outline_start = [0.0, 0.0];
        for outline in path.split('z').filter(|outline| !outline.is_empty()) {
            let steps = numbers_after_key(&format!("d=\"{outline}\""), "d=\"");
            let mut pen = outline_start;
            for (index, step) in steps.chunks_exact(2).enumerate() {
                pen = [pen[0] + step[0] / 10.0, pen[1] + step[1] / 10.0];
                if index == 0 {
                    outline_start = pen;
                }
                let inside = (x..=x + width).contains(&pen[0]) && (y..=y + height).contains(&pen[1]);
                assert!(inside, "{}: {pen:?} is outside of {clip}", entry.display());
            }
        }
    }
    assert!(grounds > 5);
}

#[test]
fn every_drawn_tip_is_at_the_models_position() {
    for name in [
        "pantograph-mk2",
        "fictive-five-bar-turret",
        "phantom-premium-1.5",
        "serial-3r",
        "coupled-five-bar",
        "planar-arm",
        "yoke",
        "touch",
        "falcon-like",
    ] {
        let description = shipped_device(name).description;
        let mut drawn_count = 0;
        for i in 0..200 {
            let angle = |step: f64| (f64::from(i) * step).sin() * 3.0;
            let mut q = vec![angle(0.7), angle(1.3), angle(2.9)];
            q.truncate(description.kind.spec().joints);
            let skeleton_points = skeleton(&description, &q);
            if Turret::of(description.kind).is_some() {
                q[0] = 0.0;
            }
            let pose = TaskPose::at(&description, &q).unwrap();
            if pose.regularity.parallel < 1e-6 {
                continue;
            }
            let tip = skeleton_points.unwrap().tip;
            assert!((tip.0 - pose.position[0]).hypot(tip.1 - pose.position[1]) < 1e-12, "{name} {q:?}");
            drawn_count += 1;
        }
        assert!(drawn_count > 50, "{name}: {drawn_count}");
    }
}
