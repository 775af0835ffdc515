//! Walls that request more force than the motors can make: errors of the forces along and across the normal, in f32.

use super::rows::singular::Random;
use crate::common::prelude::*;
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::safety::limits::Limits;
use haptic_sim::{Press, PressedBoard, WIDE_LIMITS};
use nalgebra::SVector;

const POSES_PER_ROW: usize = 12;
/// Stiffness of the wall, N/m.
const STIFFNESS: f64 = 20_000.0;

/// A row of docs/hard-cases/motors-at-their-limit.csv.
#[derive(Clone, Debug)]
pub struct Row {
    pub device: &'static str,
    /// Smallest and largest sine of the angle between a pose and the elbow's singularity.
    pub sines: [f64; 2],
    /// Largest ratio of the requested force to the largest force of the motors.
    pub beyond: f64,
    /// Largest error of the force along the normal as a share of the largest force, without and with the feed-forward.
    pub along: [f64; 2],
    /// Largest force across the normal without the feed-forward, as a share of the largest force. The request is 0.
    pub across: f64,
}

fn row_of<M: Mechanism<f64, N>, const N: usize>(
    m: M,
    name: &'static str,
    device: &Description,
    sines: [f64; 2],
) -> Row {
    let mut random = Random(23);
    let mut row = Row { device: name, sines, beyond: 0.0, along: [0.0; 2], across: 0.0 };
    let mut poses = 0;
    while poses < POSES_PER_ROW {
        let q: SVector<f64, N> = random.pose(&m);
        let mut n: SVector<f64, N> = random.normal(M::SPEC.task);
        let pose = m.pose::<Libm>(&q);
        let r = m.regularity(&pose);
        if !(sines[0]..sines[1]).contains(&r.serial) || r.parallel < 0.3 || n.norm() < 0.1 {
            continue;
        }
        // The board rounds the normal to f32.
        n = (n / n.norm()).map(|x| f64::from(x as f32));
        poses += 1;
        let three = |v: &SVector<f64, N>| core::array::from_fn(|i| if i < N { v[i] } else { 0.0 });
        // The limit is the torque for the device's weight and for 5 N.
        let lever = m.transpose(&pose, &n).amax();
        let torque = (m.gravity(&pose).amax() + 5.0 * lever) as f32;
        for (index, feed_forward) in [FeedForward::Off, FeedForward::Full].into_iter().enumerate() {
            let limits = Limits { torque: [torque; MAX_JOINTS], ..WIDE_LIMITS };
            let press = Press { device, q: three(&q), normal: three(&n), stiffness: STIFFNESS, feed_forward, limits };
            let mut board = PressedBoard::new(&press).expect("a pressed board");
            for step in 1..=20 {
                let depth = 1.0e-4 * f64::from(step);
                let inside = board.pose(depth);
                let pose = m.pose::<Libm>(&SVector::from_fn(|i, _| inside[i]));
                if m.regularity(&pose).serial < 0.8 * sines[0] {
                    break;
                }
                let forces = board.forces_at(depth, 100);
                assert_eq!(forces.state, State::Armed, "{forces:?}");
                let requested = forces.requested;
                let gravity = m.gravity(&pose);
                // The largest share of Jᵀ n f that every joint can make in addition to the weight.
                let rendered = m.transpose(&pose, &n) * requested;
                let room = |i: usize, most: f64| (most - gravity[i] * rendered[i].signum()) / rendered[i].abs();
                let fits = |most: f64| requested * (0..N).map(|i| room(i, most)).fold(1.0, f64::min);
                let right = fits(torque.into());
                // The feed-forward may need a 64th of a motor's torque.
                let reduced = fits(f64::from(torque) * 63.0 / 64.0);
                let least = if feed_forward == FeedForward::Off { right } else { reduced };
                row.beyond = row.beyond.max(requested / right);
                row.along[index] =
                    row.along[index].max((forces.along - forces.along.clamp(least, right)).abs() / right);
                if feed_forward == FeedForward::Off {
                    row.across = row.across.max(forces.across / right);
                }
            }
        }
    }
    row
}

/// Returns the rows of every mechanism with more than one direction: far from singularities, and near an elbow's
/// singularity, where the feed-forward begins to fade.
pub fn all_rows() -> Vec<Row> {
    super::several_directions()
    .flat_map(|(name, mut device)| {
        for joint in &mut device.joints {
            if let Some(motor) = &mut joint.motor {
                // The current limit is so large that only the torque limit acts.
                motor.max_current = 1.0e3;
            }
        }
        let mechanism = AnyMechanism::<f64>::new(&device).expect("a shipped device is sound");
        // Paddles have no singularity.
        let sines = [[0.3, 1.1], [0.05, 0.1]].into_iter().take(if name.starts_with("paddles") { 1 } else { 2 });
        haptic_bridge::with_mechanism!(mechanism, m => sines.map(|sines| row_of(m, name, &device, sines)).collect::<Vec<_>>())
    })
    .collect()
}
