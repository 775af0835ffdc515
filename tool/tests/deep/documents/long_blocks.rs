//! The slow commands in README.md and docs/ work as written.
#![cfg(unix)]

use crate::common::documents::blocks::Kind;
use crate::common::documents::{run_blocks, session};
use std::time::Duration;

#[test]
fn slow_commands_of_the_documents_succeed() {
    assert!(run_blocks(|kind| *kind == Kind::Slow, |block| session::run(block, Duration::from_secs(3600))) >= 1);
}
