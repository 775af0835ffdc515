//! Stable domain of a wall on one device: boundary, area and islands.
//!
//! The area is ∫ kp_max dkd. A stable interval above the first crossing is an island: it is reported but not added to
//! the area. The integral uses the trapezoidal rule on dampings spaced like Chebyshev points, like the reference cases
//! (tests/golden/range.json, reproduced to 1e-8). On a smooth boundary the result is 5e-4 lower than the exact
//! integral; if kp_max jumps, the error is up to 2e-2 (tool/tests/quick/range_golden.rs). Ratios of areas of the same
//! shape have no such error.

use super::boundary::{CircleResponses, Interval};
use super::control_loop::{Loop, Mode};
use super::error::AnalysisError;
use super::flexible::felt_stiffness;
use super::oscillation::Oscillation;
use super::plant::Linearised;
use super::several::{WallLoops, WallSet, open_loop};
use serde::Serialize;

/// Default number of damping values on a boundary.
pub const BOUNDARY_POINTS: usize = 200;

/// Largest damping that counts as zero, in units of m/T. A smaller limit only reflects the smallest stiffness analysed.
const SMALLEST_DAMPING: f64 = 1e-7;
/// Range of dampings searched for islands if nothing is stable from zero up, in units of m/T.
const ISLAND_DAMPINGS: (f64, f64) = (1e-5, 2.0);

/// A point of the boundary.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, serde::Deserialize)]
pub struct BoundaryPoint {
    /// Damping, N s/m.
    pub kd: f64,
    /// Largest stiffness up to which all stiffnesses are stable, N/m; zero if no stiffness is stable.
    pub kp: f64,
    /// Stiffness that a hand at the tip feels if transmissions are compliant, N/m ([`super::flexible::felt_stiffness`]).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub felt: Option<f64>,
    /// Frequency at which a stiffer wall oscillates, Hz; `None` if nothing is stable or the wall creeps instead.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hz: Option<f64>,
}

impl BoundaryPoint {
    /// Creates a point from a damping (N s/m) and a stiffness (N/m).
    pub(super) fn new(kd: f64, kp: f64) -> Self {
        Self { kd, kp, felt: None, hz: None }
    }
}

/// A stable interval of stiffness above an unstable interval at the same damping.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Island {
    /// Damping, N s/m.
    pub kd: f64,
    /// Lower end of the interval, N/m.
    pub kp_low: f64,
    /// Upper end of the interval, N/m.
    pub kp_high: f64,
}

/// The stable domain for one kind of feed-forward.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Domain {
    /// ∫ kp_max dkd, N²s/m².
    pub area: f64,
    /// Damping at which kp_max reaches zero, N s/m.
    pub kd_max: f64,
    /// Point with the largest stiffness; only among the requested dampings if any were requested.
    #[serde(skip)]
    pub top: BoundaryPoint,
    /// Boundary points in order of damping.
    pub boundary: Vec<BoundaryPoint>,
    /// Stable intervals above the boundary, at the same dampings and slightly beyond.
    pub islands: Vec<Island>,
}

impl Domain {
    /// Sets the stiffness that a hand feels, for transmissions with this compliance (m/N).
    pub(super) fn with_compliance(mut self, compliance: Option<f64>) -> Self {
        for point in self.boundary.iter_mut().chain([&mut self.top]) {
            point.felt = compliance.and_then(|compliance| felt_stiffness(point.kp, compliance));
        }
        self
    }
}

/// Predicts the stable domain for one kind of feed-forward.
pub fn domain(device: &Linearised, around: &Loop, mode: Mode, kd: Option<&[f64]>) -> Result<Domain, AnalysisError> {
    if let Some(&refused) = kd.unwrap_or_default().iter().find(|kd| !(kd.is_finite() && **kd >= 0.0)) {
        return Err(AnalysisError::Damping(refused));
    }
    let open = open_loop(device, device, around, mode)?;
    let result =
        domain_from_intervals(&mut CircleResponses::new(&open, around.delay_samples), open.mass, open.sample_s, kd)?;
    Ok(result.with_compliance(device.compliance(mode)))
}

/// Like [`domain`], for several walls that act together.
pub fn domain_of_several(
    set: &WallSet,
    around: &Loop,
    mode: Mode,
    kd: Option<&[f64]>,
) -> Result<Domain, AnalysisError> {
    if let Some(&refused) = kd.unwrap_or_default().iter().find(|kd| !(kd.is_finite() && **kd >= 0.0)) {
        return Err(AnalysisError::Damping(refused));
    }
    let mut loops = WallLoops::new(set, around, mode)?;
    let (mass, sample_s) = (loops.mass, loops.sample_s);
    domain_from_intervals(&mut loops, mass, sample_s, kd)
}

/// Computes the stable intervals of one gain while the other gain is constant, in sample units.
pub(super) trait StableIntervals {
    fn stiffness_intervals(&mut self, kd: f64) -> Result<Vec<Interval>, AnalysisError>;
    fn damping_intervals(&mut self) -> Result<Vec<Interval>, AnalysisError>;
    fn oscillation(&self, kp: f64, kd: f64) -> Option<Oscillation>;
}

impl StableIntervals for CircleResponses<'_> {
    fn stiffness_intervals(&mut self, kd: f64) -> Result<Vec<Interval>, AnalysisError> {
        CircleResponses::stiffness_intervals(self, kd)
    }
    fn damping_intervals(&mut self) -> Result<Vec<Interval>, AnalysisError> {
        CircleResponses::damping_intervals(self)
    }
    fn oscillation(&self, kp: f64, kd: f64) -> Option<Oscillation> {
        self.open().oscillation(kp, kd)
    }
}

impl StableIntervals for WallLoops {
    fn stiffness_intervals(&mut self, kd: f64) -> Result<Vec<Interval>, AnalysisError> {
        WallLoops::stiffness_intervals(self, kd)
    }
    fn damping_intervals(&mut self) -> Result<Vec<Interval>, AnalysisError> {
        WallLoops::damping_intervals(self)
    }
    fn oscillation(&self, kp: f64, kd: f64) -> Option<Oscillation> {
        WallLoops::oscillation(self, kp, kd)
    }
}

pub(super) fn domain_from_intervals(
    circle: &mut impl StableIntervals,
    mass: f64,
    sample_s: f64,
    kd: Option<&[f64]>,
) -> Result<Domain, AnalysisError> {
    let damping_unit = mass / sample_s;
    let stiffness_unit = damping_unit / sample_s;

    let support = support(circle)?;
    let kd_max = support.last().map_or(0.0, |last| last.high);
    let mut stable_at = |kd: f64| match circle.stiffness_intervals(kd) {
        // At exactly the largest damping the stiffness may be unbounded, so no stiffness counts there.
        Err(AnalysisError::Unbounded) if !is_supported(&support, kd) => Ok(Vec::new()),
        result => result,
    };
    let area = area(kd_max, |kd| Ok(supported_stiffness(&support, kd, &stable_at(kd)?)))?;

    let share = |i: usize| i as f64 / (BOUNDARY_POINTS - 1) as f64;
    let at: Vec<f64> = match kd {
        Some(requested) => requested.iter().map(|kd| kd / damping_unit).collect(),
        None if kd_max > 0.0 => (0..BOUNDARY_POINTS).map(|i| kd_max * share(i)).collect(),
        None => (0..BOUNDARY_POINTS)
            .map(|i| ISLAND_DAMPINGS.0 * (ISLAND_DAMPINGS.1 / ISLAND_DAMPINGS.0).powf(share(i)))
            .collect(),
    };
    let mut boundary: Vec<BoundaryPoint> = Vec::with_capacity(at.len());
    let mut islands = Vec::new();
    for &kd_hat in &at {
        let stable = stable_at(kd_hat)?;
        let kp = supported_stiffness(&support, kd_hat, &stable);
        boundary.push(BoundaryPoint::new(kd_hat * damping_unit, kp * stiffness_unit));
        push_islands(&mut islands, kd_hat, &stable, damping_unit, stiffness_unit);
    }
    let highest = boundary.iter().enumerate().max_by(|(_, a), (_, b)| a.kp.total_cmp(&b.kp));
    let mut top = highest.map_or(BoundaryPoint::new(0.0, 0.0), |(_, point)| *point);
    if let (None, Some((place, _)), true) = (kd, highest, kd_max > 0.0) {
        let around = (at[place.saturating_sub(1)], at[(place + 1).min(at.len() - 1)]);
        maximise(around, |kd_hat| {
            let kp = supported_stiffness(&support, kd_hat, &stable_at(kd_hat)?) * stiffness_unit;
            if kp > top.kp {
                top = BoundaryPoint::new(kd_hat * damping_unit, kp);
            }
            Ok(kp)
        })?;
    }
    if kd.is_none() && kd_max > 0.0 {
        // Searches up to twice the largest damping, because islands may lie beyond it.
        for i in 1..=32 {
            let kd_hat = kd_max + kd_max * f64::from(i) / 32.0;
            let stable = stable_at(kd_hat)?;
            push_islands(&mut islands, kd_hat, &stable, damping_unit, stiffness_unit);
        }
    }
    for point in boundary.iter_mut().chain([&mut top]).filter(|point| point.kp > 0.0) {
        let mode = circle.oscillation(point.kp / stiffness_unit, point.kd / damping_unit);
        point.hz = mode.and_then(|mode| mode.sustained_hz(sample_s));
    }
    let area = area * damping_unit * stiffness_unit;
    Ok(Domain { area, kd_max: kd_max * damping_unit, top, boundary, islands })
}

/// Returns the least damped oscillation of a wall of `kp` (N/m) and `kd` (N s/m); `None` if no mode oscillates.
pub fn oscillation(
    device: &Linearised,
    around: &Loop,
    mode: Mode,
    kp: f64,
    kd: f64,
) -> Result<Option<Oscillation>, AnalysisError> {
    let open = open_loop(device, device, around, mode)?;
    let (kp, kd) = in_sample_units(kp, kd, open.mass, open.sample_s)?;
    Ok(open.oscillation(kp, kd))
}

/// Like [`oscillation`], for several walls that act together with this total stiffness and damping.
pub fn oscillation_of_several(
    set: &WallSet,
    around: &Loop,
    mode: Mode,
    kp: f64,
    kd: f64,
) -> Result<Option<Oscillation>, AnalysisError> {
    let loops = WallLoops::new(set, around, mode)?;
    let (kp, kd) = in_sample_units(kp, kd, loops.mass, loops.sample_s)?;
    Ok(loops.oscillation(kp, kd))
}

fn in_sample_units(kp: f64, kd: f64, mass: f64, sample_s: f64) -> Result<(f64, f64), AnalysisError> {
    let refused = [kp, kd].into_iter().find(|gain| !(gain.is_finite() && *gain >= 0.0));
    refused.map_or(Ok((kp * sample_s * sample_s / mass, kd * sample_s / mass)), |gain| Err(AnalysisError::Gain(gain)))
}

/// Returns the largest stable stiffness at damping `kd`, N/m (0 if no stiffness is stable), and the largest damping.
pub fn stiffness_at(device: &Linearised, around: &Loop, mode: Mode, kd: f64) -> Result<(f64, f64), AnalysisError> {
    let open = open_loop(device, device, around, mode)?;
    let damping_unit = open.mass / open.sample_s;
    let mut circle = CircleResponses::new(&open, around.delay_samples);
    let support = support(&mut circle)?;
    let kd_max = support.last().map_or(0.0, |last| last.high);
    let kd_hat = kd / damping_unit;
    let kp = match is_supported(&support, kd_hat) {
        true => supported_stiffness(&support, kd_hat, &circle.stiffness_intervals(kd_hat)?),
        false => 0.0,
    };
    Ok((kp * damping_unit / open.sample_s, kd_max * damping_unit))
}

/// Returns the largest stable stiffness at each damping of `kd`, N/m, for a controller with this `model`.
pub fn stiffnesses(
    device: &Linearised,
    model: &Linearised,
    around: &Loop,
    mode: Mode,
    kd: &[f64],
) -> Result<Vec<f64>, AnalysisError> {
    let points = boundary_of(device, model, around, mode, |_| kd.to_vec())?;
    Ok(points.into_iter().map(|point| point.kp).collect())
}

/// Returns boundary points of a device whose controller has this `model`. The function `kd` receives the
/// largest damping at which any stiffness is stable and returns the dampings of the points, N s/m.
pub fn boundary_of(
    device: &Linearised,
    model: &Linearised,
    around: &Loop,
    mode: Mode,
    kd: impl FnOnce(f64) -> Vec<f64>,
) -> Result<Vec<BoundaryPoint>, AnalysisError> {
    let open = open_loop(device, model, around, mode)?;
    let damping_unit = open.mass / open.sample_s;
    let mut circle = CircleResponses::new(&open, around.delay_samples);
    let support = support(&mut circle)?;
    let kd_max = support.last().map_or(0.0, |last| last.high) * damping_unit;
    let mut points = Vec::new();
    for kd in kd(kd_max) {
        let kd_hat = kd / damping_unit;
        let kp_hat = match is_supported(&support, kd_hat) {
            true => supported_stiffness(&support, kd_hat, &circle.stiffness_intervals(kd_hat)?),
            false => 0.0,
        };
        points.push(BoundaryPoint::new(kd, kp_hat * damping_unit / open.sample_s));
    }
    Ok(points)
}

/// Returns the dampings at which the smallest stiffness is stable, in units of m/T; empty if all are negligible.
fn support(circle: &mut impl StableIntervals) -> Result<Vec<Interval>, AnalysisError> {
    let result = circle.damping_intervals()?;
    Ok(if result.last().is_some_and(|last| last.high > SMALLEST_DAMPING) { result } else { Vec::new() })
}

/// Returns true if the smallest stiffness is stable at this damping.
fn is_supported(support: &[Interval], kd_hat: f64) -> bool {
    support.iter().any(|interval| interval.low <= kd_hat && kd_hat < interval.high)
}

/// Returns kp_max at one damping: the end of the interval from the smallest stiffness; zero without one.
fn supported_stiffness(support: &[Interval], kd_hat: f64, stable: &[Interval]) -> f64 {
    match stable.first() {
        Some(first) if is_supported(support, kd_hat) && first.low <= super::boundary::SMALLEST_STIFFNESS => first.high,
        _ => 0.0,
    }
}

/// Number of golden-section steps, which narrow two grid intervals to 0.3 %; at a kink the stiffness is within 1e-5.
const GOLDEN_SECTION_STEPS: usize = 12;

/// Searches the largest value in a bracket by golden section. The caller keeps the largest value.
fn maximise(
    (mut low, mut high): (f64, f64),
    mut value: impl FnMut(f64) -> Result<f64, AnalysisError>,
) -> Result<(), AnalysisError> {
    let golden = (5.0_f64.sqrt() - 1.0) / 2.0;
    let mut inner = [high - golden * (high - low), low + golden * (high - low)];
    let mut values = [value(inner[0])?, value(inner[1])?];
    for _ in 0..GOLDEN_SECTION_STEPS {
        if values[0] > values[1] {
            high = inner[1];
            (inner[1], values[1]) = (inner[0], values[0]);
            inner[0] = high - golden * (high - low);
            values[0] = value(inner[0])?;
        } else {
            low = inner[0];
            (inner[0], values[0]) = (inner[1], values[1]);
            inner[1] = low + golden * (high - low);
            values[1] = value(inner[1])?;
        }
    }
    Ok(())
}

/// Number of intervals of the trapezoidal rule for the area.
const AREA_INTERVALS: u32 = 60;

/// Computes ∫₀^end value by trapezoids between end (1 - cos φ)/2 at evenly spaced φ.
fn area(end: f64, mut value: impl FnMut(f64) -> Result<f64, AnalysisError>) -> Result<f64, AnalysisError> {
    let at = |i: u32| end * (1.0 - (std::f64::consts::PI * f64::from(i) / f64::from(AREA_INTERVALS)).cos()) / 2.0;
    let mut total = 0.0;
    let mut left = value(0.0)?;
    for i in 1..=AREA_INTERVALS {
        let right = value(at(i))?;
        total += (at(i) - at(i - 1)) * (left + right) / 2.0;
        left = right;
    }
    Ok(total)
}

fn push_islands(into: &mut Vec<Island>, kd_hat: f64, stable: &[Interval], damping: f64, stiffness: f64) {
    let above = stable.iter().filter(|s| s.low > super::boundary::SMALLEST_STIFFNESS);
    into.extend(above.map(|s| Island { kd: kd_hat * damping, kp_low: s.low * stiffness, kp_high: s.high * stiffness }));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::flexible::Flexible;
    use crate::analysis::plant::Drive;
    use crate::analysis::sampled::LinearEstimator;
    use nalgebra::{DMatrix, DVector};
    use std::f64::consts::TAU;

    fn mass(m: f64, b: f64) -> Linearised {
        Linearised {
            gain: 1.0,
            flexible: Flexible::default(),
            mass: DMatrix::from_element(1, 1, m),
            viscous: DVector::from_element(1, b),
            row: DVector::from_element(1, 1.0),
            unit_motion: DVector::from_element(1, 1.0),
        }
    }

    fn control_loop(rate: f64, cutoff: f64, delay: f64) -> Loop {
        Loop {
            rate_hz: rate,
            delay_samples: delay,
            estimator: LinearEstimator::Butterworth(cutoff),
            drive: Drive::Ideal,
            damping_compensation: false,
        }
    }

    fn in_sample_units_of_a_mass(rate: f64, cutoff: f64, delay: f64) -> (f64, f64, f64) {
        let m = 0.2;
        let d = domain(&mass(m, 0.0), &control_loop(rate, cutoff, delay), Mode::Off, None).unwrap();
        let t = 1.0 / rate;
        let top = d.boundary.iter().map(|p| p.kp).fold(0.0, f64::max);
        (top * t * t / m, d.kd_max * t / m, d.area * t.powi(3) / (m * m))
    }

    #[test]
    fn an_undamped_mass_has_the_known_domain() {
        for (rate, cutoff, kp, kd, area) in [
            (200.0, 20.0, 0.08921, 0.5190, 0.02981),
            (1000.0, 20.0, 0.008215, 0.1520, 7.699e-4),
            (20000.0, 500.0, 0.01184, 0.1838, 1.351e-3),
        ] {
            let result = in_sample_units_of_a_mass(rate, cutoff, 0.0);
            for (got, known) in [(result.0, kp), (result.1, kd), (result.2, area)] {
                assert!((got / known - 1.0).abs() < 1e-3, "{rate}/{cutoff}: {got} is not {known}");
            }
        }
    }

    #[test]
    fn the_largest_stiffness_is_refined_between_grid_dampings() {
        // Without filter and delay the boundary is 2β(2 - β)/(2 + β), with its maximum 12 - 8√2 at β = 2(√2 - 1).
        let around = Loop { estimator: LinearEstimator::BackwardDifference, ..control_loop(1000.0, 1.0, 0.0) };
        let result = domain(&mass(1.0, 0.0), &around, Mode::Off, None).unwrap();
        let (kp, kd) = (result.top.kp * 1e-6, result.top.kd * 1e-3);
        assert!((kp / (12.0 - 8.0 * 2.0_f64.sqrt()) - 1.0).abs() < 1e-8, "{kp}");
        assert!((kd - 2.0 * (2.0_f64.sqrt() - 1.0)).abs() < 1e-4, "{kd}");
        // The neighbouring grid points are 3e-6 lower. At a kink of soft transmissions it could be 3e-3.
        let grid = result.boundary.iter().map(|point| point.kp).fold(0.0, f64::max) * 1e-6;
        assert!(grid < kp - 1e-7, "{grid}");
        // If dampings are requested, the top is the largest stiffness at the requested dampings.
        let requested = domain(&mass(1.0, 0.0), &around, Mode::Off, Some(&[300.0, 700.0])).unwrap();
        assert_eq!(requested.top, requested.boundary[1]);
    }

    #[test]
    fn a_sample_of_delay_costs_most_of_the_domain() {
        for (rate, cutoff, lost) in [(200.0, 20.0, 0.67), (20000.0, 500.0, 0.43)] {
            let share = in_sample_units_of_a_mass(rate, cutoff, 1.0).2 / in_sample_units_of_a_mass(rate, cutoff, 0.0).2;
            assert!((1.0 - share - lost).abs() < 0.006, "{share}");
        }
    }

    #[test]
    fn domain_without_filter_or_delay_equals_the_textbook() {
        // By Jury. Backward difference and double integrator, 1 + K (z+1)/(2(z-1)²) + D (z+1)/(2z(z-1)), have the
        // polynomial
        // z(z-1)² + (k/2) z (z+1) + (d/2)(z+1)(z-1) = z³ + (k/2 + d/2 - 2) z² + (1 + k/2) z - d/2.
        let around = Loop { estimator: LinearEstimator::BackwardDifference, ..control_loop(1000.0, 1.0, 0.0) };
        let result = domain(&mass(1.0, 0.0), &around, Mode::Off, Some(&[200.0])).unwrap();
        // Jury's criterion for this cubic. At d = 0.2 its last condition, |a0² - 1| > |a0 a2 - a1|, fails first.
        let d = 0.2;
        let stable = |k: f64| {
            let (a2, a1, a0) = (k / 2.0 + d / 2.0 - 2.0, 1.0 + k / 2.0, -d / 2.0);
            1.0 + a2 + a1 + a0 > 0.0
                && 1.0 - a2 + a1 - a0 > 0.0
                && a0.abs() < 1.0
                && (a0 * a0 - 1.0_f64).abs() > (a0 * a2 - a1).abs()
        };
        let (mut low, mut high) = (1e-6, 4.0);
        for _ in 0..60 {
            let middle = (low + high) / 2.0;
            if stable(middle) { low = middle } else { high = middle }
        }
        assert!((result.boundary[0].kp * 1e-6 / low - 1.0).abs() < 1e-9);
        // At k = 0 the polynomial is (z - 1)(z² - (1 - d/2) z + d/2); its second factor is stable up to d = 2.
        assert!((result.kd_max * 1e-3 - 2.0).abs() < 1e-6, "{}", result.kd_max);
    }

    const RATE: f64 = 1000.0;

    /// Returns a joint of 1 kg and a loop with backward difference, no filter and no delay. In units of m/T² and m/T
    /// the characteristic polynomial is z³ + (k/2 + d/2 - 2) z² + (1 + k/2) z - d/2.
    fn joint() -> (Linearised, Loop) {
        let around = Loop { estimator: LinearEstimator::BackwardDifference, ..control_loop(RATE, 1.0, 0.0) };
        (mass(1.0, 0.0), around)
    }

    #[test]
    fn oscillation_of_a_joint_matches_its_polynomial() {
        let (device, around) = joint();
        // Without damping one root is 0, and the pair has |z|² = 1 + k/2 and sum 2 - k/2.
        for k in [1e-6, 0.01, 1.0, 3.0] {
            let result = oscillation(&device, &around, Mode::Off, k * RATE * RATE, 0.0).unwrap().unwrap();
            let size = (1.0 + k / 2.0_f64).sqrt();
            let hz = ((1.0 - k / 4.0) / size).acos() * RATE / TAU;
            assert!((result.hz / hz - 1.0).abs() < 1e-6, "{k}: {result:?} is not {hz} Hz");
            assert!((result.growth_per_s / (size.ln() * RATE) - 1.0).abs() < 1e-6, "{k}: {result:?}");
        }
        // With d = 0.4 and a pair at 0.9 e^{±iθ}, the third root is r = d/2/0.81. The sum of all roots and the sum of
        // their products in pairs give θ and k.
        let (size, d) = (0.9_f64, 0.4_f64);
        let r = d / 2.0 / (size * size);
        let cosine = (3.0 - d / 2.0 - r - size * size) / (2.0 * size * (1.0 + r));
        let k = 2.0 * (2.0 * r * size * cosine + size * size - 1.0);
        let result = oscillation(&device, &around, Mode::Off, k * RATE * RATE, d * RATE).unwrap().unwrap();
        assert!((result.hz - cosine.acos() * RATE / TAU).abs() < 1e-9 && k > 0.0, "{result:?}");
        assert!((result.growth_per_s - size.ln() * RATE).abs() < 1e-9, "{result:?}");
    }

    #[test]
    fn the_boundary_reports_its_frequency() {
        let (device, around) = joint();
        // On the unit circle the third root is d/2, and cos θ = (2 - d)/(2 + d).
        let requested: Vec<f64> = [0.0, 0.1, 0.5, 1.9, 2.5].iter().map(|d| d * RATE).collect();
        let result = domain(&device, &around, Mode::Off, Some(&requested)).unwrap();
        for (point, d) in result.boundary.iter().zip(&requested).skip(1).take(3) {
            let d = d / RATE;
            let hz = ((2.0 - d) / (2.0 + d)).acos() * RATE / TAU;
            assert!((point.hz.unwrap() / hz - 1.0).abs() < 1e-6, "{point:?} is not at {hz} Hz");
        }
        assert_eq!([result.boundary[0].hz, result.boundary[4].hz], [None; 2], "nothing is stable there");
        assert!(oscillation(&device, &around, Mode::Off, -1.0, 0.0).is_err());
    }
}
