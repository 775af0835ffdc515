//! haptic-bridge: the control code that board and computer share.
//!
//! Encoder counts go in and motor duties come out. Between the two the board renders a wall on a device of known
//! inertia and shapes that inertia. One control period, in the order of the data flow:
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
//! On a computer `control::ControlLoop::crest` runs a complete crest, and `ControlLoop::check_slow_faults` the valley.
//!
//! All other code configures or monitors that path ([`board`]). The modules are layers, and a module imports only from
//! the layers below it: [`board`] → [`control`] → [`safety`] → [`drive`], [`render`] → [`model`] → [`math`],
//! [`checksum`]. No module here depends on a chip, a computer, its files or its ports, which the firmware and the tool
//! (`host`) provide. Only refusals and remedies name the tool's commands.
//!
//! The code is generic over the float type and its trigonometry ([`math`]): the board runs `f32`, the analysis runs the
//! same code in `f64`, and the difference between the two results measures the error. All quantities are in SI units.
#![no_std]
#![forbid(unsafe_code)]

pub mod checksum;
pub mod math;

/// The device: the maker's description, one file for each mechanism, and the effective inertia.
pub mod model {
    pub mod admissible;
    pub mod catalogue;
    pub mod cogging;
    pub mod description;
    pub mod device;
    pub mod inertia;
    pub mod mechanism;
    pub mod motor;
    pub(crate) mod padding;
    pub mod principal;
    pub mod shipped;
    pub mod solve;
    pub mod units;
}

/// Rendering: the scene, and the control step that computes joint torques from encoder counts.
pub mod render {
    pub mod controller;
    pub mod scene;
    pub mod step_result;
    pub mod velocity;
}

/// The drive: duties from joint torques.
pub mod drive {
    pub(crate) mod bits;
    pub mod brushed;
    pub(crate) mod brushless;
    pub mod carrier;
    pub mod heat;
    pub mod motor_stage;
    pub mod stage;
}

/// Protection of the person at the device: faults, refusals, limits.
pub mod safety {
    pub mod fault;
    pub mod limits;
    pub mod pace;
    pub mod refusal;
}

pub mod control;

/// The board's interface and memory: protocol, settings, telemetry, and the service that handles requests.
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
