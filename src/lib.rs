//! haptic-bridge: the control code that board and host share.
//!
//! Encoder counts go in, motor duty comes out, and between the two the board renders a wall on a device whose inertia
//! it knows and shapes. One control period, in the order the data flows:
//!
//! ```text
//!  encoder counts                                                     servo::Servo::control
//!      │  controller::Controller::step ───────────────────────────┐        │
//!      ├─► joint angles, velocities        (velocity)             │        │
//!      ├─► pose: tip, J, sines             (mechanism)            │        │
//!      ├─► contacts: distance, normal      (scene)                │        │
//!      ├─► wall force fr = -kp x - kd v    (scene, velocity)      │        │
//!      ├─► the paper's feed-forward (4):                          │        │
//!      │     τ = M E Wrr⁻¹(fr - Eᵀb) + b   (inertia, precomputed) │        │
//!      └─► joint torques ◄────────────────────────────────────────┘        │
//!             ├─► limits, faults, arming   (guard)  ◄──────────────────────┘
//!             └─► current ► voltage ► duty (drive)  ◄── servo::Servo::duties
//! ```
//!
//! Everything around that path configures it ([`service`], [`settings`], [`protocol`], [`dispatch`]) or watches it
//! ([`telemetry`]). Nothing here knows a chip, a host or a file: the firmware (`src/firmware`) and the tool (`host`)
//! bring those.
//!
//! The code is generic over the float and its trigonometry ([`math`]): the board runs `f32`, the analysis runs the same
//! lines in `f64`, and the difference between the two is how error is measured. All quantities are in SI units.
#![no_std]
#![forbid(unsafe_code)]

pub mod board_step;
pub mod carrier;
pub mod controller;
pub mod description;
pub mod device;
pub mod dispatch;
pub mod drive;
pub mod guard;
pub mod inertia;
pub mod math;
pub mod mechanism;
pub mod precomputed;
pub mod program;
pub mod protocol;
pub mod scene;
pub mod service;
pub mod servo;
pub mod settings;
pub mod storage;
pub mod telemetry;
pub mod velocity;
