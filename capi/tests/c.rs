//! A program in C, compiled against the header and run with the shared library.

use hapticbridge::{Request, State};
use std::mem::{offset_of, size_of};
use std::path::Path;
use std::process::Command;

/// Where cargo has put the shared library: beside this test.
fn libraries() -> std::path::PathBuf {
    std::env::current_exe().unwrap().parent().unwrap().to_path_buf()
}

#[test]
#[cfg(target_os = "linux")]
fn the_example_compiles_without_a_warning_and_pushes_a_simulated_board() {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = libraries();
    let program = folder.join("capi-push");
    let compiled = Command::new("gcc")
        .args(["-std=c11", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-I"])
        .arg(here.join("include"))
        .arg(here.join("examples/push.c"))
        .arg("-L")
        .arg(&folder)
        .args(["-lhapticbridge", "-lm", "-o"])
        .arg(&program)
        .arg(format!("-Wl,-rpath,{}", folder.display()))
        .output()
        .expect("gcc: `apt-get install gcc`");
    assert!(compiled.status.success(), "{}", String::from_utf8_lossy(&compiled.stderr));
    let device = here.join("../devices/coupled-five-bar.toml");
    let ran = Command::new(&program).arg("sim").arg(device).output().unwrap();
    let said = String::from_utf8_lossy(&ran.stdout);
    assert!(ran.status.success(), "{said}{}", String::from_utf8_lossy(&ran.stderr));
    let lines: Vec<&str> = said.lines().collect();
    let numbers: Vec<f64> = lines[0].split(' ').filter_map(|word| word.parse().ok()).collect();
    // 0.5 N against 100 N/m, less what joint friction holds (0.005 N m on 0.1 m arms, twice); taken, armed.
    assert!((numbers[0] - 0.005).abs() < 0.001 && numbers[1].abs() < 0.001, "{said}");
    assert_eq!(numbers[2..], [0.0, 1.0], "{said}");
    let sizes = [size_of::<Request>(), size_of::<State>()];
    let offsets = [offset_of!(Request, damping_ns_m), offset_of!(State, force_n)];
    let expected = format!("sizes {} {} offsets {} {}", sizes[0], sizes[1], offsets[0], offsets[1]);
    assert_eq!(lines[1], expected, "header and library have the same structures");
    assert_eq!(lines[2], "the board is NULL, or no UTF-8");
}
