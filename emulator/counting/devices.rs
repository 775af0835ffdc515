//! Devices of the counting image, one shipped device per mechanism. The image has no TOML reader, so the numbers of the
//! device files are repeated here. tests/counted_devices.rs compares both.

use core::f64::consts::TAU;
use haptic_bridge::model::catalogue::Kind;
use haptic_bridge::model::catalogue::{MAX_JOINTS, MAX_LINKS};
use haptic_bridge::model::description::{Description, Encoder, Homing, Joint, JointFrame, Link, MAX_MODES};

const fn link(mass: f64, com: f64, inertia: f64, inertia_axial: f64, inertia_transverse: f64) -> Link {
    let (com_across, inertia_products) = ([0.0; 2], [0.0; 3]);
    Link { mass, com, com_across, inertia, inertia_axial, inertia_transverse, inertia_products }
}

const NO_LINK: Link = link(0.0, 0.0, 0.0, 0.0, 0.0);

const fn joint(inertia: f64, viscous: f64, coulomb: f64, counts_per_turn: f64) -> Joint {
    let encoder = Some(Encoder { counts_per_turn, offset: 0.0, inverted: false });
    Joint { inertia, viscous, coulomb, encoder, ..NO_JOINT }
}

const NO_JOINT: Joint = Joint {
    prismatic: false,
    frame: JointFrame::SAME,
    inertia: 0.0,
    viscous: 0.0,
    coulomb: 0.0,
    limits: None,
    encoder: None,
    absolute: None,
    motor: None,
    transmission: None,
    rigid: false,
    friction: None,
    cogging: None,
    modes: [None; MAX_MODES],
};

/// The device of `devices/hapkit-paddle.toml`.
pub const PADDLE: Description = Description {
    kind: Kind::Paddle,
    gravity: [0.0; 3],
    geometry: [0.07, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    links: [NO_LINK; MAX_LINKS],
    joints: [joint(0.0008, 0.0008, 0.004, 60_000.0), NO_JOINT, NO_JOINT],
    handle_mass: 0.0,
    sensed: [None; 3],
    home: Some([0.0; MAX_JOINTS]),
    homing: Homing::Hand,
};

/// The device of `devices/haply-2diy.toml`.
pub const FIVE_BAR: Description = Description {
    kind: Kind::FiveBar,
    gravity: [0.0; 3],
    geometry: [0.038, 0.07, 0.07, 0.09, 0.09, 1.0, 0.0, 0.0],
    links: [
        link(0.018, 0.03, 9.0e-6, 0.0, 9.0e-6),
        link(0.018, 0.03, 9.0e-6, 0.0, 9.0e-6),
        link(0.012, 0.045, 9.0e-6, 0.0, 9.0e-6),
        link(0.012, 0.045, 9.0e-6, 0.0, 9.0e-6),
    ],
    joints: [joint(1.4e-6, 0.0003, 0.002, 10_752.0), joint(1.4e-6, 0.0003, 0.002, 10_752.0), NO_JOINT],
    handle_mass: 0.02,
    sensed: [None; 3],
    home: Some([2.3, 0.84159265358979, 0.0]),
    homing: Homing::Hand,
};

/// The device of `devices/fictive-five-bar-turret.toml`.
pub const FIVE_BAR_TURRET: Description = Description {
    kind: Kind::FiveBarTurret,
    gravity: [0.0, 0.0, -9.81],
    geometry: [0.04, 0.09, 0.085, 0.12, 0.125, 1.0, 0.0, 0.0],
    links: [
        link(0.04, 0.035, 3.0e-5, 3.0e-6, 2.8e-5),
        link(0.038, 0.034, 2.7e-5, 2.8e-6, 2.5e-5),
        link(0.03, 0.06, 4.0e-5, 1.5e-6, 3.9e-5),
        link(0.031, 0.062, 4.3e-5, 1.5e-6, 4.2e-5),
    ],
    joints: [
        joint(0.0004, 0.001, 0.005, 40_000.0),
        joint(8.0e-5, 0.0008, 0.004, 40_000.0),
        joint(7.0e-5, 0.0008, 0.004, 40_000.0),
    ],
    handle_mass: 0.03,
    sensed: [None; 3],
    home: Some([0.0, 2.2, 0.94159265358979]),
    homing: Homing::Hand,
};

/// The device of `devices/phantom-premium-1.5.toml`.
pub const PARALLELOGRAM: Description = Description {
    kind: Kind::Parallelogram,
    gravity: [0.0, -9.80665, 0.0],
    geometry: [0.20955, 0.169545, 0.03175, 0.0, 0.0, 0.0, 0.0, 0.0],
    links: [
        link(0.26784, -0.03518875, 0.00091667, 0.0001133, 0.00082222),
        link(0.02622, 0.05237892, 6.029e-5, 5.7e-7, 6.004e-5),
        link(0.21542, 0.05153541, 0.00026133, 0.0001214, 0.00015823),
        link(0.026146, 0.10477739, 0.00013177, 8.9e-7, 0.00013138),
    ],
    joints: [
        joint(0.001411, 0.0005, 0.01, 53_200.0),
        joint(0.00013548, 0.0005, 0.01, 44_800.0),
        joint(0.00013548, 0.0005, 0.01, 44_800.0),
    ],
    handle_mass: 0.0,
    sensed: [None; 3],
    home: Some([0.0, 1.2, -0.1]),
    homing: Homing::Hand,
};

/// The device of `devices/serial-3r.toml`.
pub const SERIAL_3R: Description = Description {
    kind: Kind::Serial3r,
    gravity: [0.0, -9.81, 0.0],
    geometry: [0.15, 0.12, 0.08, 0.0, 0.0, 0.0, 0.0, 0.0],
    links: [
        link(0.1, 0.07, 0.0002, 0.0, 0.0002),
        link(0.07, 0.06, 9.0e-5, 0.0, 9.0e-5),
        link(0.04, 0.04, 2.5e-5, 0.0, 2.5e-5),
        NO_LINK,
    ],
    joints: [
        joint(5.0e-5, 0.001, 0.005, 40_000.0),
        joint(2.0e-5, 0.0008, 0.004, 40_000.0),
        joint(1.0e-5, 0.0005, 0.003, 40_000.0),
    ],
    handle_mass: 0.03,
    sensed: [None; 3],
    home: Some([0.3, 1.2, 0.8]),
    homing: Homing::Hand,
};

/// The device of `devices/falcon-like.toml`.
pub const DELTA: Description = Description {
    kind: Kind::Delta,
    gravity: [0.0, -9.81, 0.0],
    geometry: [0.0372, 0.0144, 0.06, 0.125, 0.0, TAU / 3.0, 2.0 * TAU / 3.0, 1.0],
    links: [
        link(0.03, 0.028, 1.2e-5, 0.0, 1.2e-5),
        link(0.004, 0.0, 0.0, 0.0, 0.0),
        link(0.04, 0.0, 0.0, 0.0, 0.0),
        NO_LINK,
    ],
    joints: [
        joint(4.65e-5, 0.0002, 0.003, 9753.6),
        joint(4.65e-5, 0.0002, 0.003, 9753.6),
        joint(4.65e-5, 0.0002, 0.003, 9753.6),
    ],
    handle_mass: 0.02,
    sensed: [None; 3],
    home: Some([0.6108652381980153; 3]),
    homing: Homing::Hand,
};

/// Returns the link of a chain with its centre of mass on x and the inertia tensor diag(ixx, iyy, izz).
const fn chain_link(mass: f64, com: f64, [ixx, iyy, izz]: [f64; 3]) -> Link {
    link(mass, com, izz, ixx, iyy)
}

const fn placed(joint: Joint, x: f64, axis: [f64; 3]) -> Joint {
    Joint { frame: JointFrame { origin: [x, 0.0, 0.0], rpy: [0.0; 3], axis }, ..joint }
}

const X: [f64; 3] = [1.0, 0.0, 0.0];
const Y: [f64; 3] = [0.0, 1.0, 0.0];
const Z: [f64; 3] = [0.0, 0.0, 1.0];

/// The device of `devices/two-paddles.toml`.
pub const PADDLES_2: Description = Description {
    kind: Kind::Paddles2,
    gravity: [0.0; 3],
    geometry: [0.07, 0.07, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    links: [NO_LINK; MAX_LINKS],
    joints: [joint(3.4e-4, 0.0008, 0.004, 26_087.0), joint(3.4e-4, 0.0008, 0.004, 26_087.0), NO_JOINT],
    handle_mass: 0.0,
    sensed: [None; 3],
    home: Some([0.0; MAX_JOINTS]),
    homing: Homing::Hand,
};

/// Three paddles like those of `devices/two-paddles.toml`.
pub const PADDLES_3: Description = Description {
    kind: Kind::Paddles3,
    geometry: [0.07, 0.07, 0.07, 0.0, 0.0, 0.0, 0.0, 0.0],
    joints: [PADDLES_2.joints[0]; 3],
    ..PADDLES_2
};

/// The device of `devices/fader.toml`.
pub const CHAIN_1: Description = Description {
    kind: Kind::Chain1,
    gravity: [0.0; 3],
    geometry: [0.0; 8],
    links: [chain_link(0.02, 0.0, [1.0e-6; 3]), NO_LINK, NO_LINK, NO_LINK],
    joints: [Joint { prismatic: true, ..placed(joint(0.003, 0.2, 0.4, 23_622.0 * TAU), 0.0, X) }, NO_JOINT, NO_JOINT],
    handle_mass: 0.0,
    sensed: [None; 3],
    home: Some([0.05, 0.0, 0.0]),
    homing: Homing::Hand,
};

/// The device of `devices/planar-arm.toml`.
pub const CHAIN_2: Description = Description {
    kind: Kind::Chain2,
    gravity: [0.0; 3],
    geometry: [0.14, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
    links: [
        chain_link(0.17, 0.136, [1.0e-5, 2.5e-4, 2.5e-4]),
        chain_link(0.03, 0.07, [2.0e-6, 5.0e-5, 5.0e-5]),
        NO_LINK,
        NO_LINK,
    ],
    joints: [
        placed(joint(1.0e-4, 0.001, 0.006, 40_000.0), 0.0, Z),
        placed(joint(1.0e-4, 0.001, 0.006, 40_000.0), 0.16, Z),
        NO_JOINT,
    ],
    handle_mass: 0.02,
    sensed: [None; 3],
    home: Some([0.5, 1.2, 0.0]),
    homing: Homing::Hand,
};

/// The device of `devices/touch.toml`.
pub const CHAIN_3: Description = Description {
    kind: Kind::Chain3,
    gravity: [0.0, -9.81, 0.0],
    geometry: [0.1325, 0.0, 0.0, 0.0, 1.0, 2.0, 0.0, 0.0],
    links: [
        chain_link(0.25, -0.01, [1.2e-4; 3]),
        chain_link(0.06, 0.045, [8.0e-6, 9.0e-5, 9.0e-5]),
        chain_link(0.03, 0.05, [3.0e-6, 4.0e-5, 4.0e-5]),
        NO_LINK,
    ],
    joints: [
        placed(joint(1.0e-4, 0.001, 0.012, 15_300.0), 0.0, Y),
        placed(joint(1.0e-4, 0.001, 0.012, 15_300.0), 0.0, Z),
        placed(joint(1.0e-4, 0.001, 0.012, 15_300.0), 0.134, Z),
    ],
    handle_mass: 0.015,
    sensed: [None; 3],
    home: Some([0.0, 0.23, -2.15]),
    homing: Homing::Hand,
};
