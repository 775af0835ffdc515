//! Ctrl-C sets a flag that long-running commands check, so that they end in order.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};

static INTERRUPTED: AtomicBool = AtomicBool::new(false);
static WATCHED: OnceLock<()> = OnceLock::new();

/// Access to the flag that Ctrl-C sets.
#[derive(Clone, Copy, Debug)]
pub struct Interrupt(());

/// Makes Ctrl-C and SIGTERM set the flag. If the system allows no handler, they end the process as before.
pub fn watch() -> Interrupt {
    WATCHED.get_or_init(|| {
        let _ = ctrlc::set_handler(|| INTERRUPTED.store(true, Ordering::SeqCst));
    });
    Interrupt(())
}

impl Interrupt {
    pub fn is_set(self) -> bool {
        INTERRUPTED.load(Ordering::SeqCst)
    }

    pub fn flag(self) -> &'static AtomicBool {
        &INTERRUPTED
    }
}
