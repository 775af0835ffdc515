//! Measures the time of the equations of motion and of equation (4) on this computer, and compares it with Pinocchio at
//! the same states (tool/benches/pinocchio.cpp).

use std::collections::BTreeMap;
use std::env;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context as _, Result, ensure};

use crate::paths::{root, target_directory};
use crate::toolchain::{cargo, run};

/// Number of rounds, in each of which both programs run once.
const ROUNDS: usize = 7;

/// Shortest time of all rounds by mechanism and row, ns.
type Times = BTreeMap<(String, String), f64>;

/// Prints a Markdown table of the times for one state and their ratios to Pinocchio's times. `pinocchio` is the folder
/// of Pinocchio's headers and library.
pub fn compare(pinocchio: &Path) -> Result<()> {
    let theirs = build_pinocchio(pinocchio)?;
    let states = target_directory().join("dynamics-states.txt");
    run(benchmark().arg("--states").stdout(File::create(&states)?))?;
    let (mut our_times, mut their_times) = (Times::new(), Times::new());
    for _ in 0..ROUNDS {
        add_times(&mut benchmark(), &mut our_times)?;
        add_times(Command::new(&theirs).stdin(File::open(&states)?), &mut their_times)?;
    }
    println!("| mechanism | row | ns | Pinocchio: ns | times |\n|---|---|--:|--:|--:|");
    for ((mechanism, row), ours) in &our_times {
        match their_times.get(&(mechanism.clone(), row.clone())) {
            Some(theirs) => println!("| {mechanism} | {row} | {ours:.1} | {theirs:.0} | {:.1} |", theirs / ours),
            None => println!("| {mechanism} | {row} | {ours:.1} | | |"),
        }
    }
    Ok(())
}

fn benchmark() -> Command {
    let mut command = cargo();
    command.current_dir(root());
    command.args(["bench", "--quiet", "--locked", "--package", "haptic", "--bench", "dynamics", "--"]);
    command
}

/// Builds the program with Pinocchio with `-march=native`, which this repository's benchmark does not use.
fn build_pinocchio(pinocchio: &Path) -> Result<PathBuf> {
    ensure!(
        ["pinocchio", "eigen3"].iter().all(|headers| pinocchio.join("include").join(headers).is_dir()),
        "no Pinocchio with Eigen's headers at {}: `pip install pin==4.1.0 cmeel-eigen` in a virtual environment installs \
         them in lib/python3.*/site-packages/cmeel.prefix",
        pinocchio.display()
    );
    let (include, library) = (pinocchio.join("include"), pinocchio.canonicalize()?.join("lib"));
    let executable = target_directory().join("pinocchio");
    run(Command::new(env::var("CXX").unwrap_or_else(|_| "c++".into()))
        .args(["-std=c++17", "-O3", "-march=native", "-DNDEBUG", "-w"])
        // Pinocchio's variant over all joint types needs these limits.
        .args(["-DBOOST_MPL_LIMIT_LIST_SIZE=30", "-DBOOST_MPL_CFG_NO_PREPROCESSED_HEADERS"])
        .arg("-I")
        .arg(&include)
        .arg("-I")
        .arg(include.join("eigen3"))
        .arg(root().join("tool/benches/pinocchio.cpp"))
        .arg("-o")
        .arg(&executable)
        .arg("-L")
        .arg(&library)
        .arg(format!("-Wl,-rpath,{}", library.display()))
        .arg("-lpinocchio_default"))?;
    Ok(executable)
}

/// Runs a program and adds its times. Each line of the output has a mechanism, nanoseconds, and a row that ends at a
/// colon.
fn add_times(command: &mut Command, times: &mut Times) -> Result<()> {
    let output = command.stderr(Stdio::inherit()).output()?;
    ensure!(output.status.success(), "{} failed", command.get_program().display());
    for line in String::from_utf8(output.stdout)?.lines() {
        let mut words = line.splitn(3, ' ');
        let mut word = || words.next().with_context(|| format!("cannot read {line:?}"));
        let (mechanism, nanoseconds, row) = (word()?, word()?.parse::<f64>()?, word()?);
        let row = row.split(':').next().unwrap_or(row);
        let fastest = times.entry((mechanism.into(), row.into())).or_insert(f64::INFINITY);
        *fastest = fastest.min(nanoseconds);
    }
    Ok(())
}
