//! The `haptic` library.
