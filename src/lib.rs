//! haptic-bridge: the control code that board and host share.
//!
//! Encoder counts go in, motor duty comes out, and between the two the board renders a wall on a device whose inertia
//! it knows and shapes. One control period, in the order the data flows:
//!
//! ```text
//!  at the crest of the carrier                                     called by the control interrupt
//!   encoder counts ──► control::compiled::render
//!      │                 └─ Controller::render ────────────────────┐
//!      ├─► joint angles, velocities        (render::velocity)      │
//!      ├─► pose: tip, J, sines             (model::mechanism)      │  while the converters work
//!      ├─► contacts: distance, normal      (render::scene)         │
//!      ├─► wall force fr = -kp x - kd v    (render::controller)    │
//!      ├─► the paper's feed-forward (4):                           │
//!      │     τ = M E Wrr⁻¹(fr - Eᵀb) + b   (model::mechanism)      │
//!      └─► joint torques ◄─────────────────────────────────────────┘
//!   currents, bus voltage ──► control::compiled::crest
//!             ├─► limits, faults, arming   (safety)
//!             └─► current ► voltage ► duty (drive)
//!  at the valley
//!   control::compiled::note               the step's samples and its row of telemetry
//!   control::compiled::check_slow_faults  motor models, heat, stalls, the force that currents make
//! ```
//!
//! On a computer `control::ControlLoop::crest` is a whole crest, `ControlLoop::check_slow_faults` the valley.
//!
//! Everything around that path configures it or watches it ([`board`]). The modules are floors, and imports go down
//! only: [`board`] → [`control`] → [`safety`] → [`drive`], [`render`] → [`model`] → [`math`], [`checksum`]. Nothing here
//! knows a chip or a computer, its files or its ports: the firmware and the tool (`host`) bring those. Only what a board
//! says to people, its refusals and remedies, names the tool's commands.
//!
//! The code is generic over the float and its trigonometry ([`math`]): the board runs `f32`, the analysis runs the same
//! lines in `f64`, and the difference between the two is how error is measured. All quantities are in SI units.
#![no_std]
#![forbid(unsafe_code)]

pub mod checksum;
pub mod math;

/// The device: the maker's description, one file for each mechanism, and the inertia it feels like.
pub mod model {
    pub mod admissible;
    pub mod catalogue;
    pub mod description;
    pub mod device;
    pub mod inertia;
    pub mod mechanism;
    pub mod motor;
    pub(crate) mod padding;
    pub mod precomputed;
    pub mod principal;
    pub mod shipped;
    pub mod solve;
}

/// From encoder counts to joint torques: the scene that is rendered, and the step that renders it.
pub mod render {
    pub mod controller;
    pub mod scene;
    pub mod step_result;
    pub mod velocity;
}

/// From joint torques to duties.
pub mod drive {
    pub(crate) mod bits;
    pub mod brushed;
    pub mod carrier;
    pub mod heat;
    pub mod stage;
}

/// The protection of the person at the device: faults, refusals, limits.
pub mod safety {
    pub mod fault;
    pub mod limits;
    pub mod pace;
    pub mod refusal;
}

pub mod control;

/// The board's interface and memory: its protocol, settings and telemetry, and the service behind them.
pub mod board {
    pub mod configuration;
    pub mod dispatch;
    pub(crate) mod flash;
    pub mod framing;
    pub mod machine;
    pub mod protocol;
    pub mod service;
    pub mod settings;
    pub mod storage;
    pub mod telemetry;
}
