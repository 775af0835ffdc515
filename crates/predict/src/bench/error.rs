//! Torque of a variant, computed by the board's code in the board's precision, compared with the closed form in f64.
//!
//! The reference is the scene's law with all velocity terms (docs/model.md section 2). Terms count as error if a
//! variant omits them, or if the board fades them because its velocity estimates lag. A torque error is expressed as
//! the force J⁻ᵀ Δτ at the tip, which a hand would have to hold.

use crate::bench::probe::Probe;
use crate::boards::torque_at_rest;
use haptic_bridge::math::{Angle, BinaryAngle, Libm, Math, Real};
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::model::device::Device;
use haptic_bridge::model::inertia::frame_rate;
use haptic_bridge::model::mechanism::Mechanism;
use haptic_bridge::model::solve::solve_symmetric;
use haptic_bridge::render::controller::{beyond_uncertainty, velocity_term_share};
use haptic_bridge::render::scene::{Scene, VelocityTerms};
use haptic_bridge::render::velocity::Coefficients;
use haptic_bridge::with_mechanism;
use haptic_host::error::Failure;
use nalgebra::SVector;
use serde::Serialize;

/// Bus voltage that converts torque errors to duty steps, V.
pub const BUS_VOLTAGE: f64 = 24.0;
/// Duty steps of a centre-aligned 20 kHz carrier from 168 MHz.
pub const DUTY_STEPS: f64 = 4200.0;

/// Terms of equation (4) that a variant computes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Terms {
    /// Only Jᵀ f.
    None,
    /// Feed-forward without velocity terms.
    FeedForward,
    /// All terms.
    FeedForwardZ,
}

impl Terms {
    /// All values in ascending order of cost.
    pub const ALL: [Terms; 3] = [Terms::None, Terms::FeedForward, Terms::FeedForwardZ];

    /// Returns the name in reports and counts.
    pub fn name(self) -> &'static str {
        match self {
            Terms::None => "none",
            Terms::FeedForward => "feed-forward",
            Terms::FeedForwardZ => "feed-forward+z",
        }
    }
}

/// Law of the velocity terms, with lag and resolution of the velocity estimates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Law {
    /// Velocity terms of the scene. `Off` is compared with `Rendered`, so omitted terms count as error.
    pub terms: VelocityTerms,
    /// Lag of the estimates, s.
    pub lag: f64,
    /// Largest change of each velocity estimate by one encoder count, rad/s.
    pub one_count: [f64; MAX_JOINTS],
}

impl Law {
    /// Returns the law of a scene on a device. Rejects a cutoff that does not fit the rate.
    pub fn of(scene: &Scene<f64>, device: &Device<f64>) -> Result<Self, Failure> {
        let estimator = Coefficients::of_device::<Libm>((scene.estimator, scene.rate_hz, scene.cutoff_hz), device)
            .map_err(|_| Failure::wrong("the cutoff must lie between 0 and half the control rate"))?;
        Ok(Self { terms: scene.velocity_terms, lag: estimator.lag(), one_count: *estimator.one_count() })
    }

    /// Returns this law with exact velocities without lag, so that no term fades.
    fn without_fading(self) -> Self {
        Self { lag: 0.0, one_count: [0.0; MAX_JOINTS], ..self }
    }

    /// Returns the joint velocities from which the velocity terms are computed, rad/s.
    fn velocities<T: Real, const N: usize>(self, probe: &Probe) -> SVector<T, N> {
        SVector::from_fn(|i, _| beyond_uncertainty(T::from_f64(probe.qd[i]), T::from_f64(self.one_count[i])))
    }

    /// Returns the shares of `probes` at which the velocity terms are faded and at which they are off.
    pub fn fading_shares(self, device: &Device<f64>, probes: &[Probe]) -> [f64; 2] {
        let shares: Vec<f64> =
            with_mechanism!(&device.mechanism, m => probes.iter().map(|probe| self.share(m, probe)).collect());
        [1.0, f64::MIN_POSITIVE].map(|below| {
            let count = shares.iter().filter(|share| **share < below).count();
            count as f64 / shares.len().max(1) as f64
        })
    }

    /// Returns the share of the velocity terms that acts at a probe.
    fn share<M: Mechanism<f64, N>, const N: usize>(self, mechanism: &M, probe: &Probe) -> f64 {
        let pose = mechanism.pose::<Libm>(&SVector::from_fn(|i, _| probe.q[i]));
        velocity_term_share(&mechanism.regularity(&pose), &self.velocities::<f64, N>(probe), self.lag)
    }
}

/// Implementation of sines, cosines and square roots.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Trigonometry {
    /// Table with two terms of a series, and the FPU's square root; used by the firmware.
    Tabulated,
    /// Minimax polynomials.
    Minimax,
    /// The `micromath` crate.
    Micromath,
}

/// A variant of the torque computation.
#[derive(Clone, Copy, Debug)]
pub struct TorqueVariant {
    /// Terms of equation (4).
    pub terms: Terms,
    /// Implementation of sines, cosines and square roots.
    pub trigonometry: Trigonometry,
    /// Law of the velocity terms.
    pub law: Law,
}

/// Statistics of a set of errors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct ErrorStatistics {
    /// Largest error.
    pub max: f64,
    /// 99th percentile.
    pub most: f64,
    /// Root mean square.
    pub rms: f64,
}

impl ErrorStatistics {
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

/// Errors of a variant over a set of situations. Each situation counts with its worst joint.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Errors {
    /// Torque, N m.
    pub torque: ErrorStatistics,
    /// Force at the tip, N.
    pub force: ErrorStatistics,
    /// Torque error at the worst joint as a share of its motor's torque, which is also the tip force's error as a share of
    /// the largest tip force.
    pub share: ErrorStatistics,
    /// Duty steps on a 24 V bus: torque / torque constant · resistance.
    pub duty: ErrorStatistics,
}

/// Errors of a variant against two references.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct VariantErrors {
    /// Errors relative to the complete law.
    pub whole: Errors,
    /// Errors relative to a board that computes exactly but fades its velocity terms.
    pub unfaded_errors: Errors,
}

/// Computes the joint torques (N m) of `probe` with these terms, in the precision `T`.
pub fn torque<T: Real, K: Math<T>, M: Mechanism<T, N>, const N: usize>(
    mechanism: &M,
    terms: Terms,
    law: Law,
    probe: &Probe,
) -> [f64; MAX_JOINTS] {
    let vector = |values: &[f64; MAX_JOINTS]| SVector::<T, N>::from_fn(|i, _| T::from_f64(values[i]));
    let (q, n, force) = (vector(&probe.q), vector(&probe.normal), T::from_f64(probe.force));
    // A board represents encoder angles as parts of a turn.
    let angles = std::array::from_fn(|i| Angle { radians: q[i], binary: Some(BinaryAngle::from_radians(probe.q[i])) });
    let pose = mechanism.pose_at::<K>(&angles);
    let torque = if terms == Terms::None {
        mechanism.transpose(&pose, &(n * force))
    } else {
        let shaping = mechanism.shaping(&pose, &n);
        let mut b = SVector::zeros();
        if terms == Terms::FeedForwardZ {
            let qd = law.velocities(probe);
            let mut tip = mechanism.velocity(&pose, &qd);
            (M::SPEC.task..N).for_each(|i| tip[i] = T::zero());
            let turning = -frame_rate(&n, &vector(&probe.normal_rate), &tip);
            b = mechanism.velocity_torque(&pose, &qd) + mechanism.shaping(&pose, &turning).me;
            b *= velocity_term_share(&mechanism.regularity(&pose), &qd, T::from_f64(law.lag));
        }
        // With the paper's law the wall absorbs b along the normal; with the rendered law it absorbs none of b.
        let met = if law.terms == VelocityTerms::Paper { b } else { SVector::zeros() };
        shaping.torque(force, &b, &met)
    };
    std::array::from_fn(|i| if i < N { torque[i].to_f64() } else { 0.0 })
}

/// Evaluates an expression with `K` as the type of the trigonometry.
macro_rules! with_trigonometry {
    ($trigonometry:expr, $K:ident => $run:expr) => {{
        use $crate::bench::error::Trigonometry;
        match $trigonometry {
            Trigonometry::Tabulated => {
                type $K = haptic_bridge::math::Tabulated;
                $run
            }
            Trigonometry::Minimax => {
                type $K = haptic_bridge::math::Minimax;
                $run
            }
            Trigonometry::Micromath => {
                type $K = haptic_bridge::math::Micromath;
                $run
            }
        }
    }};
}
pub(super) use with_trigonometry;

/// Computes the errors of a variant over `probes`.
pub fn errors(device: &Device<f64>, probes: &[Probe], way: &TorqueVariant) -> VariantErrors {
    with_mechanism!(&device.mechanism, exact => {
        with_trigonometry!(way.trigonometry, K => compare::<K, _, _, _>(device, exact, &exact.cast(), probes, way))
    })
}

/// Computes the sources of a variant's error over `probes`.
pub fn error_sources(device: &Device<f64>, probes: &[Probe], way: &TorqueVariant) -> ErrorSources {
    with_mechanism!(&device.mechanism, exact => {
        with_trigonometry!(way.trigonometry, K => error_sources_of::<K, _, _, _>(exact, &exact.cast(), probes, way))
    })
}

fn compare<K: Math<f32>, E: Mechanism<f64, N>, B: Mechanism<f32, N>, const N: usize>(
    device: &Device<f64>,
    exact: &E,
    board: &B,
    probes: &[Probe],
    &TorqueVariant { terms, law, .. }: &TorqueVariant,
) -> VariantErrors {
    let torques: Vec<_> = probes.iter().map(|probe| torque::<f32, K, B, N>(board, terms, law, probe)).collect();
    let against = |law: Law| errors_against::<E, N>(device, exact, probes, &torques, law);
    VariantErrors { whole: against(law.without_fading()), unfaded_errors: against(law) }
}

/// Computes the errors of the torques `actual` against a law.
fn errors_against<E: Mechanism<f64, N>, const N: usize>(
    device: &Device<f64>,
    exact: &E,
    probes: &[Probe],
    actual: &[[f64; MAX_JOINTS]],
    law: Law,
) -> Errors {
    let steps = duty_steps(device);
    let (mut torques, mut forces, mut shares, mut duties) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for (probe, actual) in probes.iter().zip(actual) {
        let off = difference(*actual, reference::<E, N>(exact, Terms::FeedForwardZ, law, probe));
        let whole = largest_entry(reference::<E, N>(exact, Terms::None, law, probe));
        let share = |i: usize| {
            off[i].abs() / device.joints[i].motor.map_or(whole, |motor| torque_at_rest(&motor, device.axes()))
        };
        torques.push(largest_entry(off));
        forces.push(force_at_tip::<E, N>(exact, probe, off));
        shares.push((0..N).map(share).fold(0.0, f64::max));
        duties.push(largest_entry(std::array::from_fn(|i| off[i] * steps[i])));
    }
    Errors {
        torque: ErrorStatistics::of(torques),
        force: ErrorStatistics::of(forces),
        share: ErrorStatistics::of(shares),
        duty: ErrorStatistics::of(duties),
    }
}

fn reference<E: Mechanism<f64, N>, const N: usize>(
    exact: &E,
    terms: Terms,
    law: Law,
    probe: &Probe,
) -> [f64; MAX_JOINTS] {
    torque::<f64, Libm, E, N>(exact, terms, law, probe)
}

/// Returns the error of each joint torque, N m; infinity for a torque that is not finite.
fn difference(actual: [f64; MAX_JOINTS], right: [f64; MAX_JOINTS]) -> [f64; MAX_JOINTS] {
    std::array::from_fn(|i| {
        let off = actual[i] - right[i];
        if off.is_finite() { off } else { f64::INFINITY }
    })
}

fn largest_entry(values: [f64; MAX_JOINTS]) -> f64 {
    values.into_iter().fold(0.0, |most, value| most.max(value.abs()))
}

/// Returns the tip force of these joint torques, N.
fn force_at_tip<E: Mechanism<f64, N>, const N: usize>(exact: &E, probe: &Probe, torque: [f64; MAX_JOINTS]) -> f64 {
    let pose = exact.pose::<Libm>(&SVector::from_fn(|i, _| probe.q[i]));
    let force = exact.jacobian_inverse(&pose).tr_mul(&SVector::from_fn(|i, _| torque[i]));
    force.iter().take(E::SPEC.task).map(|entry| entry * entry).sum::<f64>().sqrt()
}

/// Stiffness that converts a position error of the tip to a force error, N/m.
pub const TIP_ERROR_STIFFNESS: f64 = 20_000.0;

/// Sources of a variant's error. Each source is computed separately, as its largest value over all situations.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct ErrorSources {
    /// Force at the tip of terms that are omitted or faded, N.
    pub dropped: f64,
    /// 90th percentile of `dropped`.
    pub dropped_mostly: f64,
    /// Force at the tip by the torque error from f32 rounding and trigonometry, N.
    pub rounding: f64,
    /// Tip position error from f32 rounding and trigonometry, times [`TIP_ERROR_STIFFNESS`], N.
    pub tip: f64,
    /// Smallest share of the exact feed-forward's stable area that remains: (effective inertia / Wrr)².
    pub area: f64,
}

fn error_sources_of<K: Math<f32>, E: Mechanism<f64, N>, B: Mechanism<f32, N>, const N: usize>(
    exact: &E,
    board: &B,
    probes: &[Probe],
    &TorqueVariant { terms, law, .. }: &TorqueVariant,
) -> ErrorSources {
    let mut parts = ErrorSources { area: f64::INFINITY, ..ErrorSources::default() };
    let more = |most: &mut f64, value: f64| *most = most.max(value);
    let mut dropped = Vec::new();
    for probe in probes {
        let tip_error = |a, b| force_at_tip::<E, N>(exact, probe, difference(a, b));
        let actual = torque::<f32, K, B, N>(board, terms, law, probe);
        let same = reference::<E, N>(exact, terms, law, probe);
        dropped.push(tip_error(same, reference::<E, N>(exact, Terms::FeedForwardZ, law.without_fading(), probe)));
        more(&mut parts.rounding, tip_error(actual, same));

        let (q, q32) = (SVector::<f64, N>::from_fn(|i, _| probe.q[i]), SVector::from_fn(|i, _| probe.q[i] as f32));
        let pose = exact.pose::<Libm>(&q);
        let seen = board.tip(&board.pose::<K>(&q32));
        // Both tip positions use angles rounded to f32, so that they differ only by the computation.
        let expected = exact.tip(&exact.pose::<Libm>(&q32.map(f64::from)));
        let off = (0..E::SPEC.task).map(|i| (f64::from(seen[i]) - expected[i]).powi(2)).sum::<f64>().sqrt();
        more(&mut parts.tip, TIP_ERROR_STIFFNESS * off);

        // The effective inertia at rest follows from the acceleration for a force of 1 N.
        let resting = Probe { qd: [0.0; MAX_JOINTS], force: 1.0, ..*probe };
        let without = if terms == Terms::None { Terms::None } else { Terms::FeedForward };
        let newton = torque::<f32, K, B, N>(board, without, law, &resting);
        let n = SVector::<f64, N>::from_fn(|i, _| probe.normal[i]);
        let moved = solve_symmetric(&exact.mass(&pose), &SVector::from_fn(|i, _| newton[i]));
        let met = 1.0 / exact.transpose(&pose, &n).dot(&moved);
        let ratio = met / exact.shaping(&pose, &n).w_rr;
        parts.area = parts.area.min(if ratio > 0.0 { ratio * ratio } else { 0.0 });
    }
    dropped.sort_by(f64::total_cmp);
    parts.dropped = dropped.last().copied().unwrap_or(0.0);
    parts.dropped_mostly = dropped.get(dropped.len() * 9 / 10).copied().unwrap_or(parts.dropped);
    parts
}

/// Returns the largest tip motion by one encoder count over `probes`, m; 0 without encoders.
pub fn encoder_step(device: &Device<f64>, probes: &[Probe]) -> f64 {
    fn largest_step<M: Mechanism<f64, N>, const N: usize>(m: &M, device: &Device<f64>, probes: &[Probe]) -> f64 {
        let moves = |probe: &Probe| {
            let jacobian = m.jacobian(&m.pose::<Libm>(&SVector::from_fn(|i, _| probe.q[i])));
            (0..N).map(move |joint| {
                let column = (0..M::SPEC.task).map(|i| jacobian[(i, joint)].powi(2)).sum::<f64>().sqrt();
                column * device.joints[joint].radians_per_count.abs()
            })
        };
        probes.iter().flat_map(moves).fold(0.0, f64::max)
    }
    with_mechanism!(&device.mechanism, m => largest_step(m, device, probes))
}

/// Returns the duty steps per N m of each joint; 0 for a joint without a motor.
pub fn duty_steps(device: &Device<f64>) -> [f64; MAX_JOINTS] {
    device.joints.map(|joint| {
        joint.motor.map_or(0.0, |motor| motor.resistance / motor.torque_constant.abs() / BUS_VOLTAGE * DUTY_STEPS)
    })
}
