//! Commands in README.md and docs/ work as written. The info string of a fenced block says how to run it:
//!
//! - `sh`: typed as written. `sh board`: with a strict simulated board at HAPTIC_PORT (`haptic sim --strict`);
//!   `my-device.toml` and `my-scene.toml` exist.
//! - `sh slow: REASON`: typed by `cargo xtask test --deep documents`, when the images are built.
//! - `sh no-run: REASON`, `python no-run: REASON` and so on: not run.
//! - `toml device`, `toml scene`: a file that passes `haptic check`, a scene on the coupled five-bar.
//! - `text`: nothing to run.

pub mod blocks;
pub mod session;
pub mod tables;

use blocks::{Block, Kind, blocks, documents};

/// Runs the `chosen` blocks of all documents. Fails with a list of all errors.
pub fn all(chosen: fn(&Kind) -> bool, mut run: impl FnMut(&Block) -> Result<(), String>) -> usize {
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
