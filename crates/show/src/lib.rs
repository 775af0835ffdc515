//! Shows devices and measurements on them: drawings, recordings, the page of `haptic view`, and the demonstration of a
//! wall that buzzes without the feed-forward. Recordings and SVG need no feature; PNG (feature `png`) and the servers
//! for browsers and for programs made for other devices (`serve`) bring their own dependencies.
//!
//! ```
//! use haptic_show::recorder::Recording;
//!
//! let text = "# control rate 20000 Hz\nstep,time_s,force_n\n0,0,1.5\n1,0.00005,1.25\n";
//! let recording = Recording::parse(text).unwrap();
//! let force = recording.column("force_n").unwrap();
//! assert_eq!(recording.rate_hz(), Some(20_000.0));
//! assert_eq!(recording.rows[1][force], 1.25);
//! ```
//!
//! | to | see |
//! |---|---|
//! | record, and replay a recording | [`recorder`], [`replay`] |
//! | draw | [`plot`] |
//! | show a device in the browser | [`view`] |
//! | let programs made for other devices use one | `haply` |
#![forbid(unsafe_code)]

pub mod demo;
#[cfg(feature = "serve")]
pub mod haply;
pub mod outline;
pub mod plot;
pub mod recorder;
pub mod replay;
pub mod track;
pub mod view;
