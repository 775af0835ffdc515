//! The blocks of README.md and docs/ that take long to type.
#![cfg(unix)]

use crate::common::documents::blocks::Kind;
use crate::common::documents::{all, session};
use std::time::Duration;

#[test]
fn what_takes_longer_works_as_well() {
    assert!(all(|kind| *kind == Kind::Slow, |block| session::run(block, Duration::from_secs(3600))) >= 1);
}
