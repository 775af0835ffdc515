//! Both kinds of singularity at once: the elbow is almost stretched or folded, and the rods are almost in one line.

use super::routes::{Errors, routes};
use super::shipped_device;
use super::singular::{Random, at_hand_speed, cast, wide_five_bar};
use super::{Exact, ExactMath};
use haptic_bridge::control::compiled::BoardMath;
use haptic_bridge::math::Libm;
use haptic_bridge::model::description::Description;
use haptic_bridge::model::mechanism::Mechanism;
use haptic_bridge::render::controller::{FULL_REGULARITY, PARALLEL_REGULARITY};
use nalgebra::SVector;

/// Both sines, as multiples of the sines at which the feed-forward begins to fade.
pub const SINE_SHARES: [f64; 3] = [1.0, 0.4, 0.1];
const POSES_PER_ROW: usize = 30;
const NORMALS_PER_POSE: usize = 5;

#[derive(Clone, Debug)]
pub struct Row {
    pub device: &'static str,
    /// Both sines as a multiple of the sines at which the feed-forward begins to fade (0.05 and 0.15).
    pub share: f64,
    pub poses: usize,
    /// Errors of f32 with minimax sines.
    pub board: Errors,
    pub double: Errors,
}

/// Searches at random for a pose with both sines within 5 % of their targets.
fn pose_near<M: Mechanism<f64, N>, const N: usize>(
    m: &M,
    targets: [f64; 2],
    random: &mut Random,
) -> Option<SVector<f64, N>> {
    let apart = |q: &SVector<f64, N>| {
        let r = m.regularity(&m.pose::<Libm>(q));
        let apart = (r.serial / targets[0]).ln().abs().max((r.parallel / targets[1]).ln().abs());
        if apart.is_finite() { apart } else { f64::INFINITY }
    };
    let mut best = random.vector(3.1);
    let mut least = apart(&best);
    let mut reach = 0.5;
    for _ in 0..600 {
        let next = best + random.vector::<N>(reach);
        let found = apart(&next);
        if found < least {
            (best, least) = (next, found);
        } else {
            reach *= 0.98;
        }
    }
    (least < 0.05).then_some(best)
}

fn row<A, B, C, const N: usize>(
    (double, board, reference): (&A, &B, &C),
    device: &'static str,
    share: f64,
    targets: [f64; 2],
) -> Row
where
    A: Mechanism<f64, N>,
    B: Mechanism<f32, N>,
    C: Mechanism<Exact, N>,
{
    let mut random = Random(17);
    let mut row = Row { device, share, poses: 0, board: Errors::default(), double: Errors::default() };
    for _ in 0..2_000 {
        if row.poses == POSES_PER_ROW {
            break;
        }
        let Some(q) = pose_near(double, targets, &mut random) else { continue };
        row.poses += 1;
        let q: SVector<f32, N> = cast(&q);
        for _ in 0..NORMALS_PER_POSE {
            let n: SVector<f32, N> = cast(&random.normal::<N>(A::SPEC.task));
            let qd: SVector<f32, N> = cast(&at_hand_speed(double, &cast(&q), random.vector(1.0)));
            let exact = routes::<_, ExactMath, _, N>(reference, &cast(&q), &cast(&qd), &cast(&n));
            row.board.grow(&Errors::new(&routes::<_, BoardMath, _, N>(board, &q, &qd, &n), &exact));
            row.double.grow(&Errors::new(&routes::<_, Libm, _, N>(double, &cast(&q), &cast(&qd), &cast(&n)), &exact));
        }
    }
    row
}

fn rows(name: &'static str, device: &Description) -> Vec<Row> {
    SINE_SHARES
        .map(|share| {
            let targets = [FULL_REGULARITY, FULL_REGULARITY * PARALLEL_REGULARITY].map(|sine| sine * share);
            in_three_precisions!(device, (a, b, c) => row((&a, &b, &c), name, share, targets))
        })
        .to_vec()
}

/// Returns the rows of every mechanism with a closed loop.
pub fn all_rows() -> Vec<Row> {
    let turret = shipped_device("fictive-five-bar-turret");
    let devices = [
        ("five-bar (wide base)", wide_five_bar()),
        ("five-bar-turret", turret),
        ("delta", shipped_device("falcon-like")),
    ];
    devices.into_iter().flat_map(|(name, device)| rows(name, &device)).collect()
}
