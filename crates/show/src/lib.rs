//! Shows devices and measurements on them: drawings, the page of `haptic view`, the monitor in a terminal, and
//! recordings. Recordings are read and written without any feature; PNG (feature `png`), the servers for browsers and
//! for programs made for other devices (`serve`) and the monitor (`monitor`) each bring their own dependencies. The
//! demonstration is also here: a wall that buzzes without the feed-forward and is quiet with it, with its picture.
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
//! | show a device in the browser or in a terminal | [`view`], `monitor` |
//! | let programs made for other devices use one | `haply` |
#![forbid(unsafe_code)]

pub mod demo;
#[cfg(feature = "serve")]
pub mod haply;
pub mod outline;
pub mod plot;
pub mod recorder;
pub mod replay;
pub mod view;
