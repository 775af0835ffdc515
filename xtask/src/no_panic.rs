//! Proves that the control step cannot panic, and that its machine code has no indirect calls, no recursion and a
//! bounded stack.

use std::process::Command;

use anyhow::{Context as _, Result, ensure};

use crate::paths::{root, target_directory};
use crate::thumb::Image;
use crate::toolchain::{TARGET, chip_cargo, run};
use crate::tools::{self, Tool};

/// Maximum stack of the control step, bytes: an eighteenth of the stack that memory.x reserves.
const STACK_LIMIT: u32 = 2950;

/// Name of an undefined function that a panic would call, which the linker then reports.
const PANIC_FUNCTION: &str = "the_control_step_can_panic";

fn cargo(feature: &str) -> Command {
    let mut command = chip_cargo();
    command.current_dir(root().join("firmware")).arg("--target-dir").arg(target_directory());
    command.args(["--locked", "--bin", "no-panic", "--profile", "firmware", "--features", feature]);
    // The same optimisation level as in the library's build.
    command.args(["--", "-Copt-level=3"]);
    command
}

/// Links the control step without the rest of the firmware, and checks the image.
pub fn prove() -> Result<()> {
    tools::check(&[Tool::Chip])?;
    run(&mut cargo("no-panic")).context("the control step can panic, see the linker's message above")?;
    let image = Image::read(&target_directory().join(TARGET).join("firmware/no-panic"))?;
    let reach = image.reach(&[
        "control_step",
        "carrier_render",
        "carrier_angles",
        "carrier_crest",
        "carrier_generally",
        "carrier_notes",
        "carrier_sums",
    ])?;
    println!("control step: links without a panic; {} functions, no recursion", reach.functions);
    for (root, stack) in &reach.stack {
        println!("{root}: at most {stack} bytes of stack (limit {STACK_LIMIT})");
        ensure!(*stack <= STACK_LIMIT, "{root} needs {stack} bytes of stack, more than the limit of {STACK_LIMIT}");
    }
    ensure!(reach.indirect.is_empty(), "indirect jumps in the control step:\n    {}", reach.indirect.join("\n    "));
    println!("no indirect calls");

    // Checks that the proof can fail: with one unbounded index the image must not link.
    let broken = cargo("broken").output().context("cannot run cargo")?;
    let message = String::from_utf8_lossy(&broken.stderr);
    ensure!(
        !broken.status.success() && message.contains(PANIC_FUNCTION),
        "the proof does not detect a step that can panic: xtask/src/no_panic.rs is broken"
    );
    println!("the proof can fail: with one unbounded index the step does not link");
    Ok(())
}
