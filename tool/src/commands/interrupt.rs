//! Ctrl-C: a flag that long-running commands look at, so that they end in order.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};

static INTERRUPTED: AtomicBool = AtomicBool::new(false);
static WATCHED: OnceLock<()> = OnceLock::new();

/// The flag that is set once the user has asked for the end.
#[derive(Clone, Copy, Debug)]
pub struct Interrupt(());

/// From now on Ctrl-C (and a polite kill) sets the flag instead of ending the process. Where the system does not allow
/// that, Ctrl-C ends the process as before.
pub fn watch() -> Interrupt {
    WATCHED.get_or_init(|| {
        let _ = ctrlc::set_handler(|| INTERRUPTED.store(true, Ordering::SeqCst));
    });
    Interrupt(())
}

impl Interrupt {
    /// Returns true if the flag is set.
    pub fn is_set(self) -> bool {
        INTERRUPTED.load(Ordering::SeqCst)
    }

    /// The flag itself.
    pub fn flag(self) -> &'static AtomicBool {
        &INTERRUPTED
    }
}
