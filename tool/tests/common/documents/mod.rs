//! What README.md and docs/ tell a reader to type works as it is written. Their fenced blocks say in the info string
//! how each is run, or why it cannot be:
//!
//! - `sh`: typed as it is. `sh board`: with a board connected; here it is a simulated one that asks for everything that
//!   a real one asks for (`haptic sim --strict`), at HAPTIC_PORT, and `my-device.toml` and `my-scene.toml` are there.
//! - `sh slow: REASON`: typed by `cargo xtask test --deep documents`, when the images are built.
//! - `sh no-run: REASON`, `python no-run: REASON` and so on.
//! - `toml device`, `toml scene`: a file that `haptic check` finds sound, a scene on the coupled five-bar.
//! - `text`: nothing to run.

pub mod blocks;
pub mod session;
pub mod tables;

use blocks::{Block, Kind, blocks, documents};

/// Runs what `chosen` picks of all documents' blocks, and fails with everything that did not work.
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
