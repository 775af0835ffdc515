//! Runs the targets of fuzz/ under libFuzzer, guided by coverage. Stable compilers can instrument the program, but
//! libFuzzer needs a C++ compiler.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Mutex;
use std::thread;

use anyhow::{Context as _, Result, bail};
use clap::builder::PossibleValuesParser;

use crate::paths::{root, target_directory};
use crate::report;
use crate::toolchain::{cargo, host, run as run_command};
use crate::tools::{self, Tool};

/// Names of the targets in fuzz/src/main.rs.
const TARGETS: [&str; 8] =
    ["bytes", "requests", "answers", "settings", "device_file", "scene_file", "kept_file", "command_line"];

/// Text about the invariants of all targets in docs/results/fuzz.md.
const INVARIANTS: &str = "\
No target panics. These invariants hold after every request and every control step (tests/rig/board.rs): duties and
torques are zero unless the motors are on; motors turn on only by arming and by the polarity check; limits hold and are
not raised while the motors are on; flash is not written while the motors are on; disarming works. The board accepts
every file that the tool accepts. fuzz/src describes each target.
";

/// Compiler options for the instrumentation, the same as in cargo-fuzz (libFuzzer's documentation, "Advanced
/// features").
const INSTRUMENTATION: &str = "-Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4 \
    -Cllvm-args=-sanitizer-coverage-inline-8bit-counters -Cllvm-args=-sanitizer-coverage-pc-table \
    -Cllvm-args=-sanitizer-coverage-trace-compares";

/// Options of `cargo xtask fuzz`.
#[derive(Debug, PartialEq, clap::Args)]
pub struct Options {
    /// Targets to fuzz [default: all]
    #[arg(value_name = "TARGET", value_parser = PossibleValuesParser::new(TARGETS))]
    targets: Vec<String>,
    /// Seconds for each target
    #[arg(long, default_value_t = 60, value_parser = clap::value_parser!(u32).range(1..))]
    seconds: u32,
    /// Write docs/results/fuzz.md
    #[arg(long)]
    record: bool,
}

impl Options {
    /// Returns options that run every target for `seconds` each.
    pub fn short(seconds: u32) -> Self {
        Self { targets: Vec::new(), seconds, record: false }
    }
    fn targets(&self) -> Vec<&'static str> {
        TARGETS.into_iter().filter(|name| self.targets.is_empty() || self.targets.iter().any(|t| t == name)).collect()
    }
}

/// Result of fuzzing a target without a crash.
struct Outcome {
    executions: u64,
    /// Number of control-flow edges that were reached.
    covered: u64,
    /// Number of inputs that reached new control-flow edges.
    corpus: u64,
}

/// Builds the targets and runs one target per processor at a time. Stores the input of a crash and returns an error.
pub fn run(options: &Options) -> Result<()> {
    tools::check(&[Tool::Cpp])?;
    let date_and_commit = report::date_and_commit();
    let out = target_directory().join("fuzz");
    let program = build(&out)?;
    let queue = Mutex::new(options.targets());
    let outcomes = Mutex::new(Vec::new());
    let next = || queue.lock().ok().and_then(|mut queue| queue.pop());
    let workers = thread::available_parallelism().map_or(1, Into::into);
    thread::scope(|scope| {
        for _ in 0..workers {
            scope.spawn(|| {
                while let Some(target) = next() {
                    let outcome = fuzz(&program, target, &out, options);
                    if let Ok(mut outcomes) = outcomes.lock() {
                        outcomes.push((target, outcome));
                    }
                }
            });
        }
    });
    let mut table = String::from("| target | executions | edges reached | inputs kept |\n|---|--:|--:|--:|\n");
    let mut outcomes = outcomes.into_inner().unwrap_or_default();
    outcomes.sort_by_key(|(target, _)| TARGETS.iter().position(|known| known == target));
    let mut crashes = Vec::new();
    for (target, outcome) in outcomes {
        match outcome {
            Ok(Outcome { executions, covered, corpus }) => {
                table += &format!("| {target} | {executions} | {covered} | {corpus} |\n");
            }
            Err(error) => crashes.push(format!("{target}: {error:#}")),
        }
    }
    println!("{table}");
    if !crashes.is_empty() {
        bail!("{}", crashes.join("\n"));
    }
    if options.record {
        let text = format!(
            "# Fuzzing\n\n{}. `cargo xtask fuzz --seconds {} --record`: {} s per target, no crash.\n\n{INVARIANTS}\n{table}",
            date_and_commit, options.seconds, options.seconds
        );
        report::write("fuzz.md", &text)?;
    }
    Ok(())
}

fn build(out: &Path) -> Result<PathBuf> {
    let host = host()?;
    let mut build = cargo();
    build.current_dir(root().join("fuzz")).args(["build", "--locked", "--release", "--target", &host, "--target-dir"]);
    // With `--target`, the flags do not apply to build scripts and macros.
    build.arg(out).env("RUSTFLAGS", INSTRUMENTATION).env_remove("CARGO_ENCODED_RUSTFLAGS");
    run_command(&mut build)?;
    Ok(out.join(host).join("release/haptic-fuzz"))
}

fn fuzz(program: &Path, target: &str, out: &Path, options: &Options) -> Result<Outcome> {
    let corpus = out.join("corpus").join(target);
    fs::create_dir_all(&corpus).with_context(|| format!("cannot make {}", corpus.display()))?;
    let output = Command::new(program)
        .env("HAPTIC_FUZZ", target)
        .args([
            "-print_final_stats=1",
            "-max_len=4096",
            "-timeout=300",
            &format!("-max_total_time={}", options.seconds),
        ])
        .arg(format!("-artifact_prefix={}/{target}-", out.display()))
        .args([&corpus, &seeds(target)])
        .output()
        .with_context(|| format!("cannot run {}", program.display()))?;
    let log = String::from_utf8_lossy(&output.stderr);
    if !output.status.success() {
        let lines: Vec<&str> =
            log.lines().filter(|line| line.contains("panicked") || !line.starts_with(['#', '\t'])).collect();
        bail!("a crash\n{}", lines[lines.len().saturating_sub(60)..].join("\n"));
    }
    outcome(&log).with_context(|| format!("cannot read libFuzzer's report:\n{log}"))
}

/// Returns the folder with the initial inputs of a target, which are the shipped files for device and scene files.
fn seeds(target: &str) -> PathBuf {
    match target {
        "device_file" | "scene_file" => root().join("devices"),
        _ => root().join("fuzz/seeds").join(target),
    }
}

/// Reads the last `cov:` and `corp:` and the final statistics from libFuzzer's log.
fn outcome(log: &str) -> Option<Outcome> {
    let after = |line: &str, name: &str| -> Option<u64> {
        let rest = line.split_once(name)?.1.trim_start();
        rest.split(|c: char| !c.is_ascii_digit()).next()?.parse().ok()
    };
    let last = log.lines().rfind(|line| line.starts_with('#') && line.contains("cov:"))?;
    let executions = log.lines().find_map(|line| after(line, "stat::number_of_executed_units:"))?;
    Some(Outcome { executions, covered: after(last, "cov:")?, corpus: after(last, "corp:")? })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_a_target_all_targets_run() {
        assert_eq!(Options::short(5).targets(), TARGETS);
        assert_eq!(Options { targets: vec!["requests".into()], ..Options::short(5) }.targets(), ["requests"]);
    }

    #[test]
    fn libfuzzers_report_is_read() {
        let log = "#2\tINITED cov: 10 ft: 12 corp: 1/2b\n#900\tDONE   cov: 345 ft: 678 corp: 9/10Kb lim: 4 exec/s: 1\n\
                   stat::number_of_executed_units: 900\n";
        let outcome = outcome(log).unwrap();
        assert_eq!((outcome.executions, outcome.covered, outcome.corpus), (900, 345, 9));
    }

    #[test]
    fn every_target_exists_in_the_program_and_has_seeds() {
        let program = fs::read_to_string(root().join("fuzz/src/main.rs")).unwrap();
        for target in TARGETS {
            assert!(program.contains(&format!("(\"{target}\",")), "{target}");
            assert!(fs::read_dir(seeds(target)).is_ok_and(|mut seeds| seeds.next().is_some()), "{target}");
        }
    }
}
