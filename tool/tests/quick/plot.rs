//! `haptic plot` draws the recorded values. These tests plot recordings of known functions and read the values from the
//! picture by its ticks and labels, without the drawing code.

use crate::common::{Folder, haptic, json, output, shipped_path, svg_number, type_lines};
use haptic_show::plot::axes::{Axis, CurveName, PlotArea};
use haptic_show::plot::canvas::Canvas;
use predicates::str::contains;
use std::f64::consts::TAU;
use std::path::Path;

/// Rows per second of the recordings.
const ROWS_PER_SECOND: f64 = 1000.0;
/// Number of rows of [`write_recording`], including the missing rows.
const ROW_COUNT: usize = 2000;
/// Rows that are missing in [`write_recording`].
const MISSING_ROWS: std::ops::Range<usize> = 600..700;

fn depth(t: f64) -> f64 {
    2e-3 * (TAU * 2.0 * t).sin()
}

fn force(t: f64) -> f64 {
    (3000.0 * depth(t)).max(0.0)
}

fn torque(t: f64) -> f64 {
    0.25 + 0.5 * (TAU * 125.0 * t).sin()
}

fn write_recording(path: &Path) {
    let mut text =
        "# haptic-bridge recording\n# date 2026-01-01\n# device a-device\n# control rate 1000 Hz, every step\n\
                    # wall 0: plane, 3000 N/m\nstep,time_s,torque0_n_m,distance_m,velocity_m_s,rendered_n\n"
            .to_string();
    for row in (0..ROW_COUNT).filter(|row| !MISSING_ROWS.contains(row)) {
        let t = row as f64 / ROWS_PER_SECOND;
        let speed = -2e-3 * TAU * 2.0 * (TAU * 2.0 * t).cos();
        text.push_str(&format!("{},{t},{},{},{speed},{}\n", row + 77, torque(t), -depth(t), force(t)));
    }
    std::fs::write(path, text).unwrap();
}

/// A panel read from an SVG: labels of the axes, and lines in SI units.
#[derive(Debug, Default)]
struct SvgPanel {
    labels: Vec<String>,
    lines: Vec<Vec<(f64, f64)>>,
}

fn text_of(line: &str) -> &str {
    line.split_once('>').and_then(|(_, rest)| rest.split_once('<')).map_or("", |(words, _)| words)
}

/// Returns the factor of the unit's prefix in a label such as "time (ms)".
fn prefix_factor(label: &str) -> f64 {
    let unit = label.rsplit_once('(').map_or("", |(_, unit)| unit.trim_end_matches(')'));
    match unit {
        "m" | "s" | "N" | "Hz" | "N m" | "m/s" | "dB" | "" => 1.0,
        unit if unit.starts_with('m') => 1e-3,
        unit if unit.starts_with('µ') => 1e-6,
        unit if unit.starts_with('k') => 1e3,
        other => panic!("{other}"),
    }
}

fn read_panels(svg: &str) -> Vec<SvgPanel> {
    let mut panels = Vec::new();
    let (mut drawn, mut ticks, mut labels) = (Vec::new(), [Vec::new(), Vec::new()], Vec::new());
    let lines: Vec<&str> = svg.lines().collect();
    for (index, line) in lines.iter().enumerate() {
        if let Some((_, rest)) = line.split_once("<polyline points=\"") {
            let pairs = rest.split_once('"').unwrap().0.split(' ').filter_map(|pair| pair.split_once(','));
            // A dashed line is not a curve but the axis through zero.
            if !line.contains("stroke-dasharray") {
                drawn.push(pairs.map(|(x, y)| (x.parse().unwrap(), y.parse().unwrap())).collect::<Vec<(f64, f64)>>());
            }
        } else if line.starts_with("<line") {
            let at = |name| svg_number(line, name).unwrap();
            let value: Option<f64> = text_of(lines[index + 1]).parse().ok();
            match value {
                Some(value) if at("x1") == at("x2") => ticks[0].push((at("x1"), value)),
                Some(value) if at("y1") == at("y2") => ticks[1].push((at("y1"), value)),
                _ => {}
            }
        } else if line.starts_with("<text") && line.contains("font-size=\"13\"") {
            labels.push(text_of(line).to_string());
            if labels.len() == 2 {
                let scale = |axis: usize, pixel: f64| {
                    let ((p0, v0), (p1, v1)) = (ticks[axis][0], *ticks[axis].last().unwrap());
                    (v0 + (pixel - p0) / (p1 - p0) * (v1 - v0)) * prefix_factor(&labels[axis])
                };
                let lines = drawn.iter().map(|line| line.iter().map(|(x, y)| (scale(0, *x), scale(1, *y))).collect());
                panels.push(SvgPanel { lines: lines.collect(), labels: std::mem::take(&mut labels) });
                (drawn, ticks) = (Vec::new(), [Vec::new(), Vec::new()]);
            }
        }
    }
    panels
}

#[test]
fn the_picture_shows_the_recorded_values() {
    let folder = tempfile::tempdir().unwrap();
    let (csv, svg, png) = (folder.path().join("a.csv"), folder.path().join("a.svg"), folder.path().join("a.png"));
    write_recording(&csv);
    let plot = |more: &[&str]| haptic(&["plot"]).arg(&csv).args(more).assert();
    let files = ["--svg", svg.to_str().unwrap(), "--png", png.to_str().unwrap()];
    plot(&files)
        .success()
        .stdout(contains("1900 rows over 1.999 s, 100 rows missing between them"))
        .stdout(contains("stiffness found: 3000 N/m"));
    plot(&files).code(1).stderr(contains("--force"));
    let text = std::fs::read_to_string(&svg).unwrap();
    assert!(
        text.contains("a-device in contact with a wall, recorded 2026-01-01")
            && text.contains("wall 0: plane, 3000 N/m")
    );
    let panels = read_panels(&text);
    let names: Vec<&str> = panels.iter().flat_map(|panel| &panel.labels).map(String::as_str).collect();
    let expected = [
        "time (s)",
        "force (N)",
        "penetration (mm)",
        "force (N)",
        "frequency (Hz)",
        "amplitude re 1 N (dB)",
        "distance to the wall (mm)",
        "velocity (mm/s)",
    ];
    assert_eq!(names, expected);
    // In the panel over time every point lies on the function, and no line crosses the missing rows.
    let time = &panels[0];
    assert_eq!(time.lines.len(), 2, "{}", time.lines.len());
    assert!(time.lines[0].len() > 300);
    for (t, f) in time.lines.iter().flatten() {
        assert!((f - force(*t)).abs() < 0.06, "{f} N at {t} s, not {}", force(*t));
    }
    assert!((time.lines[0].last().unwrap().0 - 0.599).abs() < 2e-3 && (time.lines[1][0].0 - 0.7).abs() < 2e-3);
    let highest = time.lines.iter().flatten().fold(0.0_f64, |most, (_, f)| most.max(*f));
    assert!((highest - 6.0).abs() < 0.02, "{highest}");
    // The panel over penetration shows the wall's stiffness from outside the wall to a depth of 2 mm.
    let wall = panels[1].lines.iter().flatten();
    assert!(wall.clone().any(|(x, _)| *x > 1.99e-3) && wall.clone().all(|(x, _)| *x > -0.3e-3));
    for (x, f) in wall {
        assert!((f - 3000.0 * x.max(0.0)).abs() < 0.06, "{f} N at a depth of {x} m");
    }
    // The phase portrait is the ellipse (x/2 mm)² + (v/25.1 mm/s)² = 1.
    for (x, v) in panels[3].lines.iter().flatten() {
        let radius = (x / 2e-3).hypot(v / (2e-3 * TAU * 2.0));
        assert!((radius - 1.0).abs() < 0.02, "{x} m, {v} m/s");
    }
    let picture = std::fs::read(&png).unwrap();
    assert_eq!(&picture[1..4], b"PNG");
    let size = |at: usize| u32::from_be_bytes(picture[at..at + 4].try_into().unwrap());
    let height: f64 = svg_number(text.lines().next().unwrap(), "height").unwrap();
    assert_eq!((size(16), size(20)), (1440, (2.0 * height) as u32), "two pixels per unit");
    // The spectrum of a sine has the sine's amplitude at its frequency and almost 0 elsewhere, also at 0 Hz.
    plot(&["--signals", "torque0_n_m", "--show", "spectrum", "--force", "--svg", files[1]])
        .success()
        .stdout(contains("at 125.0 Hz"));
    let panels = read_panels(&std::fs::read_to_string(&svg).unwrap());
    assert_eq!(panels[0].labels, ["frequency (Hz)", "amplitude re 1 N m (dB)"].map(str::to_string));
    let line: Vec<(f64, f64)> = panels[0].lines[0].iter().map(|(hz, db)| (*hz, 10f64.powf(db / 20.0))).collect();
    let top = line.iter().max_by(|a, b| a.1.total_cmp(&b.1)).unwrap();
    assert!((top.0 - 125.0).abs() < 1.0 && (top.1 - 0.5).abs() < 0.005, "{top:?}");
    assert!(line.iter().all(|(hz, a)| (hz - 125.0).abs() < 5.0 || *a < 0.01));
    // The points of --json are the recorded values.
    let json = plot(&["--json", "--show", "time", "--from", "0.1", "--to", "0.2"]).success();
    let json: serde_json::Value = serde_json::from_slice(&json.get_output().stdout).unwrap();
    let points = json["panels"][0]["curves"][0]["pieces"][0].as_array().unwrap();
    assert_eq!((points.len(), json["rows"].as_u64(), json["missing"].as_u64()), (101, Some(101), Some(0)));
    let (t, f) = (points[50][0].as_f64().unwrap(), points[50][1].as_f64().unwrap());
    assert!((t - 0.15).abs() < 1e-9 && (f - force(0.15)).abs() < 1e-9);
}

#[test]
fn names_stand_at_their_curves_and_cover_none() {
    let frame = PlotArea {
        at: (100.0, 50.0),
        size: (600.0, 300.0),
        x: Axis::new("x", "m", 0.0, 600.0),
        y: Axis::new("y", "m", 0.0, 300.0),
    };
    let line =
        |from: f64, to: f64| (0..=60).map(move |i| (10.0 * f64::from(i), from + (to - from) * f64::from(i) / 60.0));
    let curves: [Vec<(f64, f64)>; 2] = [line(0.0, 300.0).collect(), line(300.0, 0.0).collect()];
    let names = [("rising", "red"), ("falling", "blue")].into_iter().zip(&curves);
    let names: Vec<CurveName<'_>> =
        names.map(|((name, colour), curve)| CurveName { curve: curve.clone(), colour, name: name.into() }).collect();
    let mut canvas = Canvas::new(800.0, 400.0);
    frame.name_curves(&mut canvas, &curves, &names);
    let svg = canvas.finish("", "").svg().to_string();
    for (index, name) in ["rising", "falling"].iter().enumerate() {
        let text = svg.lines().find(|line| line.contains(&format!(">{name}<"))).unwrap();
        let (x, y) = (svg_number(text, "x").unwrap(), svg_number(text, "y").unwrap());
        let distance = |curve: &[(f64, f64)]| {
            let at = curve.iter().map(|&(x, y)| frame.pixel(x, y));
            let from =
                |p: (f64, f64)| (p.0 - p.0.clamp(x, x + 6.0 * name.len() as f64)).hypot(p.1 - p.1.clamp(y - 9.0, y));
            at.map(from).fold(f64::INFINITY, f64::min)
        };
        let (own, other) = (distance(&curves[index]), distance(&curves[1 - index]));
        assert!((3.0..30.0).contains(&own) && other > own, "{name} at {x}, {y}: {own}, {other}");
    }
}

/// A velocity that jumps between rows at 20 kHz is drawn as a line of means, not as an area; --json has all rows.
#[test]
fn the_phase_portrait_of_fast_rows_is_drawn_from_means() {
    let (folder, csv) = write_rows(20e3, "distance_m,velocity_m_s", 10_000, |t| {
        let row = (t * 20e3).round();
        format!("{},{}", 1e-6 * row, if row % 2.0 == 0.0 { 0.12 } else { -0.08 })
    });
    let svg = folder.path("a.svg");
    type_lines(&format!("plot --show phase {csv} --svg {svg}"), &[]);
    let text = std::fs::read_to_string(&svg).unwrap();
    assert!(text.contains("means over 20 rows"), "{text}");
    let line = &read_panels(&text)[0].lines[0];
    assert!((400..=500).contains(&line.len()), "{}", line.len());
    assert!(line.iter().all(|(_, v)| (v - 0.02).abs() < 6e-3), "{line:?}");
    let json = json(&["plot", "--show", "phase", &csv]);
    assert_eq!(json["panels"][0]["curves"][0]["pieces"][0].as_array().unwrap().len(), 10_000);
}

#[test]
fn a_constant_signal_has_a_spectrum_at_the_floor() {
    let (_folder, csv) = write_rows(ROWS_PER_SECOND, "distance_m", 3000, |_| "0".into());
    let json = json(&["plot", &csv, "--signals", "distance_m", "--show", "spectrum"]);
    let points = json["panels"][0]["curves"][0]["pieces"][0].as_array().unwrap();
    assert!(points.len() > 100 && points.iter().all(|point| (point[1].as_f64().unwrap() + 120.0).abs() < 1e-9));
}

#[test]
fn undrawable_recordings_are_refused() {
    let folder = Folder::new();
    let csv = folder.path("a.csv");
    write_recording(Path::new(&csv));
    type_lines(
        &format!(
            "2: plot {csv} --signals nothing_n => no column nothing_n; it has step, time_s, torque0_n_m
            2: plot {csv} --from 5 => 0 rows to draw; the recording has rows from 0 to 1.999 s
            2: plot {csv} --show colour => time, force, spectrum, phase
            2: plot {csv} --svg - => /dev/stdout for the standard output"
        ),
        &[],
    );
    for (contents, words) in [
        (&b"not, a recording\n1,2\n"[..], "no column step"),
        (b"\x89MCAP0\r\nrubbish", "no channel /rows"),
        (&[0xff, 0xfe, 0x00], "neither MCAP nor text"),
    ] {
        folder.write("a.csv", contents);
        type_lines(&format!("2: plot {csv} => {words}"), &[]);
    }
}

/// Writes a recording with these columns. Returns its folder and path.
fn write_rows(rate_hz: f64, columns: &str, rows: usize, row: impl Fn(f64) -> String) -> (Folder, String) {
    let folder = Folder::new();
    let head = format!("# haptic-bridge recording\n# control rate {rate_hz} Hz, every step\nstep,time_s,{columns}\n");
    let rows = (0..rows).map(|i| format!("{i},{},{}\n", i as f64 / rate_hz, row(i as f64 / rate_hz)));
    let csv = folder.write("a.csv", head + &rows.collect::<String>());
    (folder, csv)
}

#[test]
fn a_vibration_at_the_end_is_in_the_spectrum() {
    let late = |t: f64| if t < 0.77 { 0.0 } else { (TAU * 50.0 * t).sin() };
    let (_folder, csv) = write_rows(ROWS_PER_SECOND, "rendered_n", 1000, |t| late(t).to_string());
    let strongest = json(&["plot", &csv])["strongest"].clone();
    let (hz, amplitude) = (strongest["frequency"].as_f64().unwrap(), strongest["amplitude"].as_f64().unwrap());
    assert!((hz - 50.0).abs() < 2.0 && (0.2..1.0).contains(&amplitude), "{strongest}");
    type_lines(&format!("plot {csv} => above 20 Hz: "), &[]);
}

/// A wall of 60 kN/m, pressed 0.5 mm deep by a device with a force limit.
#[test]
fn the_stiffness_is_fitted_to_unlimited_rows() {
    let plot_press = |most: f64| {
        let (folder, csv) =
            write_rows(ROWS_PER_SECOND, "distance_m,rendered_n,saturated0,saturated1,state", 1000, |t| {
                let depth = 0.5e-3 * (TAU * t).sin();
                let requested_force = (60e3 * depth).max(0.0);
                // From 0.4 s on the motors are off in the wall.
                let (force, state) = if t < 0.4 { (requested_force.min(most), "Armed") } else { (0.0, "Disarmed") };
                format!("{},{force},0,{},{state}", -depth, u8::from(requested_force > most && t < 0.4))
            });
        let svg = folder.path("a.svg");
        let printed = output(&["plot", "--svg", &svg, &csv]);
        (printed, json(&["plot", &csv]), std::fs::read_to_string(&svg).unwrap())
    };
    let (printed, found, drawn) = plot_press(5.0);
    let (rows, cut) = (found["contact_rows"].as_u64().unwrap(), found["saturated_rows"].as_u64().unwrap());
    assert!((395..=400).contains(&rows) && cut > 300 && rows - cut > 20, "{rows}, {cut}");
    assert!((found["stiffness"].as_f64().unwrap() - 60e3).abs() < 1.0, "{}", found["stiffness"]);
    assert!(printed.contains(&format!("{} rows in contact, without {cut} that a limit cut", rows - cut)), "{printed}");
    assert!(printed.contains("stiffness found: 60000 N/m"), "{printed}");
    // The fitted line is drawn from the first to the last fitted row.
    let ends: [[f64; 2]; 2] = serde_json::from_value(found["panels"][1]["line"].clone()).unwrap();
    assert!(ends.iter().all(|[x, y]| (y - 60e3 * x).abs() < 1e-6) && ends[1][1] < 5.0 && ends[1][1] > 4.5, "{ends:?}");
    assert_eq!(drawn.matches("stroke-dasharray=\"7 4\"").count(), 1);
    let (printed, found, drawn) = plot_press(0.5);
    assert!(found["stiffness"].is_null() && found["panels"][1]["line"].is_null(), "{found}");
    assert!(printed.contains("no stiffness, too few for a line: ") && printed.contains("found: none"), "{printed}");
    assert!(!drawn.contains("stroke-dasharray=\"7 4\""));
}

/// The recording begins with arming in the wall, after which the torque ramps up for half a second.
#[test]
fn the_stiffness_ignores_the_ramp_after_arming() {
    let (_folder, csv) = write_rows(ROWS_PER_SECOND, "distance_m,rendered_n,state", 2000, |t| {
        let depth = 1e-3 * (1.0 + 0.5 * (TAU * t).sin());
        let ramp = ((t - 0.1) / 0.5).clamp(0.0, 1.0);
        format!("{},{},{}", -depth, 1500.0 * depth * ramp, if t < 0.1 { "Disarmed" } else { "Armed" })
    });
    let found = json(&["plot", &csv]);
    let stiffness = found["stiffness"].as_f64().unwrap();
    assert!((stiffness - 1500.0).abs() < 1.0, "{stiffness}");
    assert_eq!(found["contact_rows"], 1400);
    // The ramp is also left out if arming is before the drawn rows.
    let later = json(&["plot", &csv, "--from", "0.3"]);
    assert_eq!(later["contact_rows"], 1400);
}

#[test]
fn a_force_that_does_not_follow_the_depth_has_no_stiffness() {
    let (_folder, csv) = write_rows(ROWS_PER_SECOND, "distance_m,rendered_n", 1000, |t| {
        let depth = 1e-3 + 1e-5 * (TAU * 3.0 * t).sin();
        format!("{},{}", -depth, 2.0 + (TAU * 71.0 * t).sin())
    });
    let found = json(&["plot", &csv]);
    assert!(found["stiffness"].is_null(), "{}", found["stiffness"]);
    assert!(found["panels"][1]["note"].as_str().unwrap().contains("the force does not follow the depth"), "{found}");
}

/// Encoder steps make a phase portrait unreadable, so by default it is drawn only for a real motion.
#[test]
fn the_phase_portrait_of_noise_is_drawn_only_on_request() {
    let views = |speed: fn(f64) -> f64, more: &[&str]| {
        let columns = "distance_m,velocity_m_s,rendered_n";
        let (_folder, csv) = write_rows(ROWS_PER_SECOND, columns, 1000, |t| format!("{t},{},0", speed(t)));
        let found = json(&[&["plot", &csv], more].concat());
        let panels = found["panels"].as_array().unwrap().iter();
        let phase_panels = panels.filter(|panel| panel["view"] == "phase").count();
        (phase_panels, found["said"].to_string().contains("velocity over distance is left out"))
    };
    let noise = |t: f64| (1e3 * t * t * 7919.0).sin() * f64::from(u8::from(((1e3 * t) as u64).is_multiple_of(2)));
    assert_eq!(views(|t| (TAU * 70.0 * t).sin(), &[]), (1, false));
    assert_eq!(views(noise, &[]), (0, true));
    assert_eq!(views(noise, &["--show", "phase"]), (1, false));
}

/// Returns the texts of a picture of this width that are smaller than 8 pt or extend beyond the picture.
fn misplaced_texts(svg: &str, width_mm: f64) -> Vec<String> {
    let head = svg.lines().next().unwrap();
    assert!(head.contains(&format!(" width=\"{width_mm:.2}mm\"")), "{head}");
    let sides = head.split("viewBox=\"0 0 ").nth(1).unwrap().split('"').next().unwrap();
    let (units, high) = sides.split_once(' ').unwrap();
    let (units, high): (f64, f64) = (units.parse().unwrap(), high.parse().unwrap());
    let points_a_unit = width_mm / 25.4 * 72.0 / units;
    let texts: Vec<&str> = svg.lines().filter(|line| line.starts_with("<text")).collect();
    assert!(texts.len() > 5);
    let bad = |line: &&&str| {
        let size = svg_number(line, "font-size").unwrap();
        if size * points_a_unit <= 7.99 {
            return true;
        }
        let Some(x) = svg_number(line, "x") else { return false };
        let long = 0.56 * size * text_of(line).replace("&gt;", ">").chars().count() as f64;
        let begins = [("start", 0.0), ("middle", 0.5), ("end", 1.0)];
        let before = begins.iter().find(|(anchor, _)| line.contains(anchor)).unwrap().1 * long;
        let (at, end) = if line.contains("rotate") { (svg_number(line, "y").unwrap(), high) } else { (x, units) };
        // Rotated text runs upwards.
        let begin = if line.contains("rotate") { at + before - long } else { at - before };
        begin < 0.0 || begin + long > end
    };
    texts.iter().filter(bad).map(ToString::to_string).collect()
}

/// Columns of journals are often 85 mm wide, pages 170 mm, and the smallest text has 8 pt.
#[test]
fn pictures_for_a_paper_have_its_width_and_letter_size() {
    let folder = tempfile::tempdir().unwrap();
    let (csv, svg, png) = (folder.path().join("a.csv"), folder.path().join("a.svg"), folder.path().join("a.png"));
    write_recording(&csv);
    let csv = csv.to_str().unwrap();
    let [coupled, phantom, paddle] =
        ["coupled-five-bar", "phantom-premium-1.5", "hapkit-paddle"].map(|name| shipped_path(&format!("{name}.toml")));
    let at = ["--q=2.6,1.75", "--normal=0.94,-0.34"];
    let range = ["range", &coupled, at[0], at[1], "--delay", "0.5", "--washout", "2", "--host-rate", "500"];
    let commands: [(&[&str], &[&str]); 6] = [
        (&["plot", csv, "--signals", "torque0_n_m,rendered_n,velocity_m_s"], &["85", "170"]),
        (&range, &["85", "170"]),
        (&["range", &coupled, at[0], at[1], "--board", "odrive-v3", "--why"], &["85", "170"]),
        (&["map", &coupled, at[1], "--points", "50"], &["85"]),
        (&["map", &paddle, "--normal=1"], &["85"]),
        (&["design", &phantom, "--normal=1,1,0", "--points", "50"], &["85"]),
    ];
    for (command, widths) in commands {
        for width in widths {
            let files = ["--svg", svg.to_str().unwrap(), "--force", "--width", width];
            haptic(&[command, &files].concat()).assert().success();
            let misplaced = misplaced_texts(&std::fs::read_to_string(&svg).unwrap(), width.parse().unwrap());
            assert!(misplaced.is_empty(), "{command:?} at {width} mm: {misplaced:#?}");
        }
    }
    // A PNG has 600 dots per inch.
    haptic(&["plot", csv, "--png", png.to_str().unwrap(), "--width", "85"]).assert().success();
    let picture = std::fs::read(&png).unwrap();
    let width_px = u32::from_be_bytes(picture[16..20].try_into().unwrap());
    assert!((f64::from(width_px) / (85.0 / 25.4) - 600.0).abs() < 3.0, "{width_px}");
    haptic(&["plot", csv, "--width", "20"]).assert().code(2).stderr(contains("60 to 400 mm"));
}
