//! Tests of the library with simulated boards, by a program that loads it like CHAI3D.
#![cfg(target_os = "linux")]

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// Compiles the program and links the library, under both names, next to the program. Returns the program and its
/// folder.
fn compile_program(name: &str) -> (PathBuf, PathBuf) {
    // Uses the crate, so that cargo builds it.
    assert_eq!(hdPhantom::hdPhantomGetButtons(0), 0);
    let built = std::env::current_exe().unwrap().parent().unwrap().to_path_buf();
    let folder = built.join(format!("chai3d-{name}"));
    std::fs::create_dir_all(&folder).unwrap();
    for link in ["libHD.so", "libhdPhantom.so"] {
        let _ = std::fs::remove_file(folder.join(link));
        std::os::unix::fs::symlink(built.join("libhdPhantom.so"), folder.join(link)).unwrap();
    }
    let program = folder.join("sphere");
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/sphere.c");
    let compiled = Command::new("gcc")
        .args(["-std=gnu11", "-Wall", "-Wextra", "-Werror"])
        .arg(source)
        .args(["-ldl", "-lm", "-o"])
        .arg(&program)
        .output()
        .expect("gcc: `apt-get install gcc`");
    assert!(compiled.status.success(), "{}", String::from_utf8_lossy(&compiled.stderr));
    (program, folder)
}

fn run(program: &Path, folder: &Path, port: &str, axes: Option<&str>) -> Output {
    let mut command = Command::new(program);
    command.env("LD_LIBRARY_PATH", folder).env("HAPTIC_PORT", port).env_remove("HAPTIC_AXES");
    command.envs(axes.map(|axes| ("HAPTIC_AXES", axes))).output().unwrap()
}

/// Returns the program's output: name, radius, first and last distance from the sphere's centre, tip, seconds, buttons.
fn output_fields(output: &Output) -> Vec<String> {
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{:?}: {text}{}", output.status, String::from_utf8_lossy(&output.stderr));
    text.trim().split('|').map(str::to_owned).collect()
}

#[test]
fn a_sphere_pushes_the_tip_out_at_1000_ticks_per_second() {
    let (program, folder) = compile_program("sphere");
    let phantom = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../devices/phantom-premium-1.5.toml");
    let phantom = format!("sim:{}", phantom.display());
    let all = [
        ("sim", "haptic-bridge coupled-five-bar", None),
        ("sim", "haptic-bridge coupled-five-bar", Some("-x,y,0")),
        (&phantom, "haptic-bridge phantom-premium-1.5", None),
    ];
    // Runs the programs in parallel, because each waits for its ticks.
    let outputs = std::thread::scope(|scope| {
        let (program, folder) = (&program, &folder);
        all.map(|(port, _, axes)| scope.spawn(move || run(program, folder, port, axes))).map(|run| run.join().unwrap())
    });
    for ((port, name, _), output) in all.into_iter().zip(outputs) {
        let output_fields = output_fields(&output);
        let number = |field: usize| output_fields[field].parse::<f64>().unwrap();
        assert_eq!(output_fields[0], name);
        assert!((0.02..0.4).contains(&number(1)), "radius {}", output_fields[1]);
        // The tip begins at the origin (its home), 10 mm from the centre of a sphere with a radius of 20 mm.
        assert!((number(2) - 0.01).abs() < 1e-4, "{output_fields:?}");
        // A tick takes at least a millisecond; on a busy computer it may be late.
        assert!(number(5) > 1.499, "{output_fields:?}");
        assert_eq!(output_fields[6], "0");
        if port != "sim" {
            // Skips this device, which falls before its motors are on because no hand holds it.
            continue;
        }
        // At the end 0.3 N press the tip 1 mm into 300 N/m, less friction of up to 0.2 N.
        assert!((number(3) - 0.019).abs() < 0.7e-3, "{output_fields:?}");
        // The tip has moved radially away from the centre.
        let tip: Vec<f64> = output_fields[4].split(' ').map(|number| number.parse().unwrap()).collect();
        let (along, across) = (0.6 * tip[0] - 0.8 * tip[1], 0.8 * tip[0] + 0.6 * tip[1]);
        assert!((along - 0.009).abs() < 2e-3 && across.abs() < 4e-3 && tip[2].abs() < 4e-3, "{output_fields:?}");
    }
}

#[test]
fn an_invalid_force_fails() {
    assert_eq!(hdPhantom::hdPhantomOpen(0), 0);
    // SAFETY: the pointers are valid.
    let set = |x: f64| unsafe { hdPhantom::hdPhantomSetForce(0, &x, &0.0, &0.0) };
    assert_eq!([0.1, f64::NAN, 1e30, f64::INFINITY, 0.1].map(set), [0, -1, -1, -1, 0]);
    assert_eq!(hdPhantom::hdPhantomClose(0), 0);
}

#[test]
fn a_missing_board_is_no_device_and_reports_the_reason() {
    let (program, folder) = compile_program("none");
    for (port, axes, words) in [
        ("tcp:127.0.0.1:1", None, "cannot connect"),
        ("tcp:", None, "not tcp:HOST:PORT"),
        ("sim", Some("x,x,0"), "HAPTIC_AXES: `x,x,0`"),
        ("sim", Some("x,y,z"), "the device has 2"),
    ] {
        let output = run(&program, &folder, port, axes);
        assert_eq!(output.status.code(), Some(3), "{output:?}");
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(error.contains(words) && error.lines().count() == 1, "{error}");
    }
}
