//! Motors that cannot make what a wall asks for: what is left along the normal and across it, of the control loop's f32
//! torques.

use super::rows::singular::Random;
use super::shipped;
use crate::common::prelude::*;
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::safety::limits::Limits;
use haptic_sim::{Press, PressedBoard, WIDE_LIMITS};
use nalgebra::SVector;

const POSES: usize = 12;
/// N/m
const STIFFNESS: f64 = 20_000.0;

/// One row of the table.
#[derive(Clone, Debug)]
pub struct Row {
    pub device: &'static str,
    /// Sines of the poses.
    pub sines: [f64; 2],
    /// Largest force asked for over the largest that the motors can make.
    pub beyond: f64,
    /// Largest error of the force along the normal as a share of what can be made, without and with the feed-forward.
    pub along: [f64; 2],
    /// Largest force across the normal, as the same share, without the feed-forward: none was asked for.
    pub across: f64,
}

fn row<M: Mechanism<f64, N>, const N: usize>(m: M, name: &'static str, device: &Description, sines: [f64; 2]) -> Row {
    let task = M::SPEC.task;
    let mut random = Random(23);
    let mut row = Row { device: name, sines, beyond: 0.0, along: [0.0; 2], across: 0.0 };
    let mut poses = 0;
    while poses < POSES {
        let q: SVector<f64, N> = random.vector(3.1);
        let mut n: SVector<f64, N> = random.vector(1.0);
        for i in task..N {
            n[i] = 0.0;
        }
        let pose = m.pose::<Libm>(&q);
        let r = m.regularity(&pose);
        if !(sines[0]..sines[1]).contains(&r.serial) || r.parallel < 0.3 || n.norm() < 0.1 {
            continue;
        }
        // As the board has it.
        n = (n / n.norm()).map(|x| f64::from(x as f32));
        poses += 1;
        let three = |v: &SVector<f64, N>| core::array::from_fn(|i| if i < N { v[i] } else { 0.0 });
        // Room for the device's own weight and for 5 N.
        let lever = m.transpose(&pose, &n).amax();
        let torque = (m.gravity(&pose).amax() + 5.0 * lever) as f32;
        for (index, feed_forward) in [FeedForward::Off, FeedForward::Full].into_iter().enumerate() {
            let limits = Limits { torque: [torque; MAX_JOINTS], ..WIDE_LIMITS };
            let press = Press { device, q: three(&q), normal: three(&n), stiffness: STIFFNESS, feed_forward, limits };
            let mut held = PressedBoard::new(&press).expect("nothing is in the way");
            for step in 1..=20 {
                let depth = 1.0e-4 * f64::from(step);
                let inside = held.pose(depth);
                let pose = m.pose::<Libm>(&SVector::from_fn(|i, _| inside[i]));
                if m.regularity(&pose).serial < 0.8 * sines[0] {
                    break;
                }
                let felt = held.forces_at(depth, 100);
                assert_eq!(felt.state, State::Armed, "{felt:?}");
                let asked = felt.asked;
                let gravity = m.gravity(&pose);
                // Computed here: the largest share of Jᵀ n f that fits every joint together with the weight.
                let rendered = m.transpose(&pose, &n) * asked;
                let room = |i: usize, most: f64| (most - gravity[i] * rendered[i].signum()) / rendered[i].abs();
                let fits = |most: f64| asked * (0..N).map(|i| room(i, most)).fold(1.0, f64::min);
                let right = fits(torque.into());
                // The feed-forward may need a 64th of a motor's torque.
                let least =
                    if feed_forward == FeedForward::Off { right } else { fits(f64::from(torque) * 63.0 / 64.0) };
                row.beyond = row.beyond.max(asked / right);
                row.along[index] = row.along[index].max((felt.along - felt.along.clamp(least, right)).abs() / right);
                if feed_forward == FeedForward::Off {
                    row.across = row.across.max(felt.across / right);
                }
            }
        }
    }
    row
}

/// Every mechanism that has more than one direction: in the open, and where an elbow's feed-forward begins to fade.
pub fn all() -> Vec<Row> {
    super::MECHANISMS
    .into_iter()
    .flat_map(|(name, file)| {
        let mut device = shipped(file);
        for joint in &mut device.joints {
            if let Some(motor) = &mut joint.motor {
                // The torque limit alone decides.
                motor.max_current = 1.0e3;
            }
        }
        let mechanism = AnyMechanism::<f64>::new(&device).expect("a shipped device is sound");
        haptic_bridge::with_mechanism!(mechanism, m => [[0.3, 1.1], [0.05, 0.1]].map(|sines| row(m, name, &device, sines)))
    })
    .collect()
}
