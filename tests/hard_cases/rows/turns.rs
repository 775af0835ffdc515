//! Encoders with fractional counts per turn, over thousands of turns. The tip position of the f32 step is compared with
//! the tip at the angles n 2π/C, which are not reduced to one turn.

use super::singular::{Random, cast};
use super::steps::{controller, pad_to_three, scene, with_encoders};
use super::{Exact, ExactMath};
use super::{mean_length, shipped_device};
use haptic_bridge::control::compiled::BoardMath;
use haptic_bridge::math::Real;
use haptic_bridge::model::description::Description;
use haptic_bridge::model::mechanism::Mechanism;
use haptic_bridge::render::scene::FeedForward;
use nalgebra::SVector;

/// Counts per turn: with half a count, 20,000 counts behind gears of 7:3 and √1.1:1, a measured value, and 16 bits.
pub const ENCODER_COUNTS: [f64; 5] = [10_752.5, 140_000.0 / 3.0, 20_976.176_963_403_03, 16_384.07, 65_536.0];
/// Whole turns away from home.
pub const TURNS: [i32; 4] = [0, 100, 1_000, 10_000];

#[derive(Clone, Debug)]
pub struct Row {
    pub device: &'static str,
    pub counts_per_turn: f64,
    /// Largest error of the tip position, in mean link lengths, for each of [`TURNS`].
    pub tip: [f64; 4],
}

/// Returns 2π with more digits than f64.
fn two_pi() -> Exact {
    Exact::from_f64(std::f64::consts::TAU) + Exact::from_f64(2.449_293_598_294_706_4e-16)
}

fn row<A, B, C, const N: usize>(double: A, board: B, reference: C, name: &'static str, device: &Description) -> Vec<Row>
where
    A: Mechanism<f64, N>,
    B: Mechanism<f32, N>,
    C: Mechanism<Exact, N>,
{
    let task = A::SPEC.task;
    let length = mean_length(device);
    ENCODER_COUNTS
        .map(|counts_per_turn| {
            let mut device = with_encoders(device);
            for joint in &mut device.joints {
                if let Some(encoder) = &mut joint.encoder {
                    encoder.counts_per_turn = counts_per_turn;
                }
            }
            let far = pad_to_three(&SVector::<f64, N>::from_element(10.0), task);
            let up = [1.0, 0.0, 0.0];
            let far_wall = scene(task, far.map(|x| -x), up, 1.0, 0.0, FeedForward::Off);
            let mut controller = controller::<f32, BoardMath, _, N>(board, &device, &far_wall);
            let mut row = Row { device: name, counts_per_turn, tip: [0.0; 4] };
            for (index, turns) in TURNS.into_iter().enumerate() {
                let mut random = Random(13);
                for pose in 0..60 {
                    let q: SVector<f64, N> = random.regular_pose(&double);
                    let sign = if pose % 2 == 0 { -1 } else { 1 };
                    let share = q / std::f64::consts::TAU;
                    let counts = share.map(|x| ((x + f64::from(sign * turns)) * counts_per_turn).round() as i32);
                    let angles =
                        counts.map(|n| Exact::from_f64(f64::from(n)) * two_pi() / Exact::from_f64(counts_per_turn));
                    let exact: SVector<f64, N> = cast(&reference.tip(&reference.pose::<ExactMath>(&angles)));
                    let found: SVector<f64, N> = cast(&controller.step(&counts.into()).tip);
                    for i in 0..task {
                        row.tip[index] = row.tip[index].max((found[i] - exact[i]).abs() / length);
                    }
                }
            }
            row
        })
        .to_vec()
}

pub fn all_rows() -> Vec<Row> {
    [
        ("five-bar", "haply-2diy"),
        ("serial-3r", "serial-3r"),
        ("chain-2", "planar-arm"),
        ("chain-3", "touch"),
        ("delta", "falcon-like"),
    ]
    .into_iter()
    .flat_map(|(name, file)| {
        let device = shipped_device(file);
        in_three_precisions!(&device, (a, b, c) => row(a, b, c, name, &device))
    })
    .collect()
}
