//! The torque a variant renders, by the board's own code in the board's precision, against f64 and the closed form.

use crate::bench::precompute::Precomputed;
use crate::bench::probe::Probe;
use crate::error::Failure;
use crate::precision::rounded;
use haptic_bridge::math::{Libm, Math, Micromath, Minimax, Real};
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::model::device::Device;
use haptic_bridge::model::inertia::{frame_rate, shaped_torque};
use haptic_bridge::model::mechanism::{AnyMechanism, Mechanism};
use haptic_bridge::model::precomputed::MassModel;
use nalgebra::SVector;
use serde::Serialize;

/// Bus voltage that duty steps are reckoned with, V.
pub const BUS_VOLTAGE: f64 = 24.0;
/// Steps of the duty: a centre-aligned carrier of 20 kHz from 168 MHz counts to 4200.
pub const DUTY_STEPS: f64 = 4200.0;

/// What of equation (4) a variant computes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Terms {
    /// Jᵀ f alone.
    None,
    /// The feed-forward without velocity terms.
    FeedForward,
    /// All of it.
    FeedForwardZ,
}

impl Terms {
    /// All, from the cheapest.
    pub const ALL: [Terms; 3] = [Terms::None, Terms::FeedForward, Terms::FeedForwardZ];

    /// The name in reports and counts.
    pub fn name(self) -> &'static str {
        match self {
            Terms::None => "none",
            Terms::FeedForward => "feed-forward",
            Terms::FeedForwardZ => "feed-forward+z",
        }
    }
}

/// Sines and cosines as the variant computes them. (`minimax+vsqrt` differs from `Minimax`, what ships, by the last
/// digit of a square root.)
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Trigonometry {
    /// Minimax polynomials.
    Minimax,
    /// The micromath crate.
    Micromath,
    /// libm.
    Libm,
}

/// Size of a set of errors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Size {
    /// The largest.
    pub max: f64,
    /// What 99 % of them stay below.
    pub most: f64,
    /// Root of their mean square.
    pub rms: f64,
}

impl Size {
    fn of(mut errors: Vec<f64>) -> Self {
        errors.sort_by(f64::total_cmp);
        let count = errors.len().max(1);
        let at = (0.99 * count as f64).ceil() as usize;
        Self {
            max: errors.last().copied().unwrap_or(0.0),
            most: errors.get(at.saturating_sub(1)).copied().unwrap_or(0.0),
            rms: (errors.iter().map(|e| e * e).sum::<f64>() / count as f64).sqrt(),
        }
    }
}

/// The error of a variant over a set of situations; of each the worst joint counts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Errors {
    /// N m
    pub torque: Size,
    /// In shares of the largest joint torque of the whole force there.
    pub share: Size,
    /// In steps of the duty: torque / torque constant · resistance, on a 24 V bus.
    pub duty: Size,
}

/// The joint torques (N m) of `probe` under a mass model and terms, in the precision `T`.
pub fn torque<T: Real, K: Math<T>, M: Mechanism<T, N>, const N: usize>(
    mechanism: &M,
    (mass, values): (&MassModel<T, N>, &[T]),
    terms: Terms,
    probe: &Probe,
) -> [f64; MAX_JOINTS] {
    let vector = |values: &[f64; MAX_JOINTS]| SVector::<T, N>::from_fn(|i, _| T::from_f64(values[i]));
    let (q, n, force) = (vector(&probe.q), vector(&probe.normal), T::from_f64(probe.force));
    let pose = mechanism.pose::<K>(&q);
    let torque = if terms == Terms::None {
        mechanism.transpose(&pose, &(n * force))
    } else {
        let shaping = mass.shaping(mechanism, values, &q, &pose, &n);
        let mut b = SVector::zeros();
        if terms == Terms::FeedForwardZ {
            let tip =
                SVector::from_fn(|i, _| if i < M::SPEC.task { T::from_f64(probe.velocity[i]) } else { T::zero() });
            let turning = -frame_rate(&n, &vector(&probe.normal_rate), &tip);
            b = mechanism.velocity_torque(&pose, &vector(&probe.qd)) + mechanism.shaping(&pose, &turning).me;
        }
        shaped_torque(&shaping, force, &b)
    };
    std::array::from_fn(|i| if i < N { torque[i].to_f64() } else { 0.0 })
}

macro_rules! define {
    ($(($Variant:ident, $module:ident, $n:literal))*) => {
        /// The error of a variant over `probes`.
        pub fn errors(
            device: &Device<f64>,
            probes: &[Probe],
            model: &Precomputed,
            terms: Terms,
            trigonometry: Trigonometry,
        ) -> Result<Errors, Failure> {
            let board = rounded(&device.mechanism)?;
            Ok(match (&device.mechanism, &board) {
                $((AnyMechanism::$Variant(exact), AnyMechanism::$Variant(board)) => match trigonometry {
                    Trigonometry::Minimax => compare::<Minimax, _, _, $n>(device, exact, board, probes, model, terms),
                    Trigonometry::Micromath => compare::<Micromath, _, _, $n>(device, exact, board, probes, model, terms),
                    Trigonometry::Libm => compare::<Libm, _, _, $n>(device, exact, board, probes, model, terms),
                },)*
                _ => Errors::default(),
            })
        }
    };
}
haptic_bridge::mechanisms!(define);

fn compare<K: Math<f32>, E: Mechanism<f64, N>, B: Mechanism<f32, N>, const N: usize>(
    device: &Device<f64>,
    exact: &E,
    board: &B,
    probes: &[Probe],
    model: &Precomputed,
    terms: Terms,
) -> Errors {
    let Some(mass) = MassModel::<f32, N>::new::<B>(&model.data) else { return Errors::default() };
    let steps = duty_steps(device);
    let (mut torques, mut shares, mut duties) = (Vec::new(), Vec::new(), Vec::new());
    for probe in probes {
        let right = torque::<f64, Libm, E, N>(exact, (&MassModel::Exact, &[]), Terms::FeedForwardZ, probe);
        let found = torque::<f32, K, B, N>(board, (&mass, &model.values), terms, probe);
        let whole = torque::<f64, Libm, E, N>(exact, (&MassModel::Exact, &[]), Terms::None, probe);
        let off: [f64; MAX_JOINTS] = std::array::from_fn(|i| {
            let off = (found[i] - right[i]).abs();
            if off.is_finite() { off } else { f64::INFINITY }
        });
        let largest = |values: [f64; MAX_JOINTS]| values.into_iter().fold(0.0, f64::max);
        torques.push(largest(off));
        shares.push(largest(off) / largest(whole.map(f64::abs)));
        duties.push(largest(std::array::from_fn(|i| off[i] * steps[i])));
    }
    Errors { torque: Size::of(torques), share: Size::of(shares), duty: Size::of(duties) }
}

/// Duty steps per N m at each joint; 0 where the device file names no motor.
pub fn duty_steps(device: &Device<f64>) -> [f64; MAX_JOINTS] {
    device.joints.map(|joint| {
        joint.motor.map_or(0.0, |motor| motor.resistance / motor.torque_constant.abs() / BUS_VOLTAGE * DUTY_STEPS)
    })
}
