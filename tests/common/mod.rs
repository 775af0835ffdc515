//! Helpers of several tests: shipped and random devices, rigid bodies, and the seeds of random cases.

pub mod bodies;
pub mod device_file;

use haptic_bridge::math::Real;
use haptic_bridge::model::catalogue::{Kind, MAX_GEOMETRY, MAX_JOINTS, MAX_LINKS};
use haptic_bridge::model::description::{Description, Encoder, Homing, Joint, JointFrame, Link};
use haptic_bridge::render::scene::{FeedForward, Surface, Wall};
use nalgebra::{DMatrix, SMatrix, SVector};
use proptest::test_runner::{Config, RngSeed};
use std::f64::consts::TAU;
use std::hash::{BuildHasher, RandomState};

/// Configures a property test with `cases` cases, which are the same in every run. With `HAPTIC_FRESH_SEEDS` the cases
/// differ in every run. `PROPTEST_RNG_SEED` repeats the cases of a printed seed.
pub fn property_config(cases: u32) -> Config {
    let default = Config::default();
    let rng_seed = match default.rng_seed {
        RngSeed::Random if std::env::var_os("HAPTIC_FRESH_SEEDS").is_none() => RngSeed::Fixed(34),
        RngSeed::Random => RngSeed::Fixed(RandomState::new().hash_one(0)),
        given => given,
    };
    println!("PROPTEST_RNG_SEED={rng_seed}");
    Config { cases, rng_seed, failure_persistence: None, ..default }
}

/// A stream of numbers in [0, 1). A test case is a list of numbers, so that proptest can shrink it.
pub struct TestNumbers<'a>(pub std::slice::Iter<'a, f64>);

impl<'a> TestNumbers<'a> {
    pub fn new(numbers: &'a [f64]) -> Self {
        Self(numbers.iter())
    }

    /// Maps the next number to `low..high`, linearly.
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.next().copied().expect("a test case has enough numbers")
    }

    /// Maps the next number to `low..high`, logarithmically.
    pub fn log_uniform(&mut self, low: f64, high: f64) -> f64 {
        self.uniform(low.ln(), high.ln()).exp()
    }

    /// Draws every entry from `low..high`.
    pub fn list<const N: usize>(&mut self, low: f64, high: f64) -> [f64; N] {
        core::array::from_fn(|_| self.uniform(low, high))
    }
}

/// Number of random numbers that suffice for one device and one pose.
pub const NUMBERS_PER_CASE: usize = 140;

/// Draws a link with possible inertias and a centre of mass between a counterweight and the far end.
fn random_link(draw: &mut TestNumbers<'_>, length: f64) -> Link {
    let mass = draw.log_uniform(0.002, 0.5);
    let squared = |extent: f64| mass * extent * extent / 12.0;
    let thick = draw.uniform(0.02, 0.5) * length;
    Link {
        mass,
        com: draw.uniform(-0.4, 1.0) * length,
        inertia: squared(length) + squared(thick),
        inertia_axial: 2.0 * squared(thick),
        inertia_transverse: draw.uniform(0.8, 1.2) * (squared(length) + squared(thick)),
        ..Link::default()
    }
}

/// Draws a link with any centre of mass and a possible inertia tensor.
fn random_spatial_link(draw: &mut TestNumbers<'_>) -> Link {
    let [x, y, z] = draw.list(-0.08, 0.08);
    let mut link = Link { com: x, com_across: [y, z], ..Link::default() };
    // A body of point masses.
    for _ in 0..4 {
        link.add_point(draw.log_uniform(0.002, 0.1), draw.list(-0.1, 0.1));
    }
    link
}

/// Draws a hand-sized device of this kind for which every term of the equations of motion matters.
pub fn random_device(kind: Kind, draw: &mut TestNumbers<'_>) -> Description {
    let mut geometry = [0.0; MAX_GEOMETRY];
    let mut links = [Link::default(); MAX_LINKS];
    let mut place = |index: usize, link: Link| links[index] = link;
    let length = |draw: &mut TestNumbers<'_>| draw.uniform(0.05, 0.25);
    match kind {
        Kind::Paddle | Kind::Paddles2 | Kind::Paddles3 => {
            for (i, arm) in geometry.iter_mut().enumerate().take(kind.spec().joints) {
                *arm = length(draw);
                place(i, Link { inertia_axial: 0.0, ..random_link(draw, *arm) });
            }
        }
        Kind::Chain1 | Kind::Chain2 | Kind::Chain3 => {
            geometry[..3].copy_from_slice(&draw.list::<3>(-0.15, 0.15));
            // An even or odd permutation of the base's axes.
            let (first, step) = (draw.uniform(0.0, 3.0).floor(), if draw.uniform(0.0, 1.0) < 0.5 { 1.0 } else { 2.0 });
            for i in 0..3 {
                geometry[3 + i] = (first + step * i as f64) % 3.0;
                place(i, random_spatial_link(draw));
            }
        }
        Kind::FiveBar | Kind::FiveBarTurret => {
            geometry[0] = draw.uniform(0.0, 0.08);
            for i in 0..4 {
                geometry[i + 1] = length(draw) * if i < 2 { 1.0 } else { 1.4 };
                place(i, random_link(draw, geometry[i + 1]));
            }
            geometry[5] = if draw.uniform(0.0, 1.0) < 0.5 { 1.0 } else { -1.0 };
        }
        Kind::Parallelogram => {
            geometry[..3].copy_from_slice(&[length(draw), length(draw), draw.uniform(0.02, 0.06)]);
            for (i, reach) in [geometry[0], geometry[1], geometry[2], geometry[0]].into_iter().enumerate() {
                place(i, random_link(draw, reach));
            }
        }
        Kind::Delta => {
            let (base, platform, upper) = (draw.uniform(0.02, 0.1), draw.uniform(0.01, 0.05), length(draw));
            let azimuth = |i: f64, draw: &mut TestNumbers<'_>| (i + draw.uniform(-0.15, 0.15)) * TAU / 3.0;
            let azimuths = [azimuth(0.0, draw), azimuth(1.0, draw), azimuth(2.0, draw)];
            geometry[..4].copy_from_slice(&[base, platform, upper, upper * draw.uniform(1.2, 2.5)]);
            geometry[4..7].copy_from_slice(&azimuths);
            geometry[7] = if draw.uniform(0.0, 1.0) < 0.5 { 1.0 } else { -1.0 };
            place(0, random_link(draw, upper));
            place(1, Link { mass: draw.log_uniform(0.001, 0.05), ..Link::default() });
            place(2, Link { mass: draw.log_uniform(0.005, 0.1), ..Link::default() });
        }
        Kind::Serial3r => {
            for (i, arm) in geometry[..3].iter_mut().enumerate() {
                *arm = length(draw);
                place(i, random_link(draw, *arm));
            }
        }
    }
    let mut gravity = draw.list(-10.0, 10.0);
    gravity[kind.spec().gravity..].fill(0.0);
    let mut joints = [Joint::default(); MAX_JOINTS];
    for joint in &mut joints {
        joint.inertia = draw.log_uniform(1.0e-5, 1.0e-3);
        if kind.spec().name == "chain" {
            joint.frame =
                JointFrame { origin: draw.list(-0.1, 0.1), rpy: draw.list(-3.0, 3.0), axis: draw.list(-1.0, 1.0) };
            joint.prismatic = draw.uniform(0.0, 1.0) < 0.25;
        }
    }
    if kind == Kind::Chain3 && draw.uniform(0.0, 1.0) < 0.3 {
        // An arm in a plane that holds the first axis, with its tip in the plane or a little beside it.
        geometry[2] = if draw.uniform(0.0, 1.0) < 0.7 { 0.0 } else { 1.0e-4 };
        joints[0].frame.axis[2] = 0.0;
        for (joint, link) in joints.iter_mut().zip(&mut links).skip(1) {
            joint.prismatic = false;
            joint.frame.origin[2] = 0.0;
            joint.frame.rpy[..2].fill(0.0);
            joint.frame.axis = [0.0, 0.0, 1.0];
            link.com_across[1] = 0.0;
            link.inertia_products[1..].fill(0.0);
        }
    }
    let handle_mass = if kind.spec().name == "paddles" { 0.0 } else { draw.log_uniform(1.0e-3, 0.3) };
    let (home, homing, sensed) = (None, Homing::Hand, [None; 3]);
    Description { kind, gravity, geometry, links, joints, handle_mass, home, homing, sensed }
}

pub fn inverse<const N: usize>(matrix: &SMatrix<f64, N, N>) -> SMatrix<f64, N, N> {
    let inverse = to_dynamic(matrix).try_inverse().expect("a regular matrix");
    SMatrix::from_fn(|i, j| inverse[(i, j)])
}

pub fn determinant<const N: usize>(matrix: &SMatrix<f64, N, N>) -> f64 {
    to_dynamic(matrix).determinant()
}

fn to_dynamic<const N: usize>(matrix: &SMatrix<f64, N, N>) -> DMatrix<f64> {
    DMatrix::from_fn(N, N, |i, j| matrix[(i, j)])
}

/// Counts per turn of encoders so fine that quantisation does not matter.
pub const FINE_COUNTS: f64 = 1.0e9;

pub fn with_fine_encoders(mut device: Description) -> Description {
    for joint in &mut device.joints {
        joint.encoder = Some(Encoder { counts_per_turn: FINE_COUNTS, offset: 0.0, inverted: false });
    }
    device
}

/// Returns the counts of fine encoders at joint angles, rad.
pub fn fine_counts<const N: usize>(q: &SVector<f64, N>) -> [i32; N] {
    q.map(|angle| (angle / TAU * FINE_COUNTS).round() as i32).into()
}

/// Returns a bilateral wall with the full feed-forward and without damping. The stiffness is in N/m.
pub fn bilateral_wall<T: Real>(surface: Surface<T>, stiffness: f64) -> Wall<T> {
    Wall {
        surface,
        stiffness: T::from_f64(stiffness),
        damping: T::zero(),
        feed_forward: FeedForward::Full,
        washout_hz: T::from_f64(2.0),
        damping_compensation: false,
        bilateral: true,
    }
}
