//! Commands in README.md and docs/ work as written. The info string of a fenced block says how to run it:
//!
//! - `sh`: the commands are run as written.
//! - `sh board`: the same, with a strict simulated board at HAPTIC_PORT, `my-device.toml` and `my-scene.toml`.
//! - `sh slow: REASON`: `cargo xtask test --deep documents` runs the commands, when the images are built.
//! - `sh no-run: REASON`, `python no-run: REASON` and so on, `text`: not run.
//! - `toml device`, `toml scene`: `haptic check` must accept the file. Scenes are checked on the coupled five-bar.

pub mod blocks;
pub mod session;
pub mod tables;

use blocks::{Block, Kind, blocks, documents};

/// Runs the `chosen` blocks of all documents and returns their number. Fails with a list of all errors.
pub fn run_blocks(chosen: fn(&Kind) -> bool, mut run: impl FnMut(&Block) -> Result<(), String>) -> usize {
    let (mut wrong, mut count) = (Vec::new(), 0);
    for path in documents() {
        match blocks(&path) {
            Err(error) => wrong.push(error),
            Ok(blocks) => {
                for block in blocks.iter().filter(|block| chosen(&block.kind)) {
                    count += 1;
                    wrong.extend(run(block).err());
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n\n"));
    count
}
