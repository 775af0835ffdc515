//! Compares velocity estimators on a device by simulation: stable area, force ripple, delay and noise.
//!
//! [`super::wall`] simulates every wall with the board's own step and the device's complete equations.

use super::wall::{RenderedWall, Trial, WallSimulation};
use crate::contact::deviation_from_line;
use crate::ripple::{self, PUSH_N};
use haptic_bridge::model::admissible::Admissible;
use haptic_bridge::render::scene::FeedForward;
use haptic_bridge::render::velocity::{Chosen, Coefficients, CutoffMeaning, Estimator};
use haptic_host::device_file::DeviceFile;
use haptic_host::error::{Choice, Failure};
use haptic_stability::analysis::control_loop::TorquePath;
use haptic_stability::analysis::plant::{Drive, Linearised};
use haptic_stability::analysis::prediction::{Prediction, Subject};
use haptic_stability::analysis::range::stiffness_at;
use haptic_stability::analysis::sampled::{LinearEstimator, Loop, Mode};
use haptic_stability::sweep::Sweep;
use serde::{Deserialize, Serialize};

const SETTLE_S: f64 = 0.3;
const RECORD_S: f64 = 0.3;
/// Speed of the slow motion in which the velocity noise is computed, m/s.
const SLOW_SPEED: f64 = 0.01;
const SLOW_MOTION_S: f64 = 0.2;
/// Number of dampings at which the largest quiet stiffness is searched.
const DAMPING_COUNT: usize = 8;
/// Largest ratio of unstable to stable stiffness at the end of a search.
const STIFFNESS_RATIO: f64 = 1.05;
/// Amplitude of the tip when a wall is struck, encoder counts.
const STRIKE_COUNTS: f64 = 40.0;
/// Amplitude below which the wall counts as quiet, encoder counts.
const QUIET_COUNTS: f64 = 6.0;
/// Time within which the tip must come to rest in a struck wall, s.
const REST_S: f64 = 0.25;

/// Device and wall with which the estimators are compared.
pub struct Comparison<'a> {
    /// The device.
    pub file: &'a DeviceFile,
    /// Pose, rad.
    pub q: &'a [f64],
    /// Unit normal of the wall.
    pub normal: &'a [f64],
    /// Control rate, Hz.
    pub rate_hz: f64,
    /// Cutoff of the estimator, Hz.
    pub cutoff_hz: f64,
    /// Stiffness (N/m) and damping (N s/m) of the wall that is pressed for the ripple.
    pub wall: (f64, f64),
}

impl Comparison<'_> {
    fn rendered_wall(&self, kind: Estimator, cutoff_hz: f64) -> RenderedWall {
        RenderedWall {
            kind,
            cutoff_hz,
            feed_forward: FeedForward::Off,
            washout_hz: 2.0,
            damping_compensation: false,
            admissible: Admissible::default(),
            stiffness: self.wall.0,
            damping: self.wall.1,
        }
    }
}

/// Results for one estimator.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Name of the estimator in scene files.
    pub estimator: String,
    /// Parameter of the estimator; `None` without a parameter.
    pub value: Option<u32>,
    /// Cutoff, Hz; `None` if the estimator has none.
    pub cutoff_hz: Option<f64>,
    /// ∫ largest quiet stiffness over damping, N²s/m², with encoder steps and friction. A lower bound: the search ends
    /// at 1e7 N/m and at five times the damping that is predicted stable with the Butterworth.
    pub area: f64,
    /// Root mean square of the force about its fitted line under a growing push, N, without and with feed-forward.
    pub press_n: [Option<f64>; 2],
    /// Root mean square of the force about its mean under a steady push, N, without feed-forward.
    pub ripple_n: Option<f64>,
    /// True if the mean force on the pressed wall is within a tenth of the hand's push.
    pub holds: bool,
    /// Delay of the velocity, s.
    pub delay_s: f64,
    /// Root mean square of the velocity error in a slow steady motion, m/s.
    pub noise_m_s: f64,
}

/// Difference of press ripples that counts as zero, N. A board's arithmetic and a hand vary by more.
pub const RESOLUTION_N: f64 = 1e-3;

/// Returns each estimator with its default parameter and with its longest window. Estimators whose cutoff is the
/// bandwidth also get a quarter, a sixteenth and a thirty-second of the cutoff. Omits optional low-passes.
fn candidates(comparison: &Comparison<'_>) -> Vec<RenderedWall> {
    let mut results = Vec::new();
    let mut add = |kind, share| results.push(comparison.rendered_wall(kind, share * comparison.cutoff_hz));
    for (_, kind) in Estimator::ALL {
        let (Some(spec), Some(usual)) = (kind.spec(), kind.chosen()) else {
            add(*kind, 1.0);
            continue;
        };
        let mut values = vec![usual.value];
        values.extend(spec.key.filter(|key| key.unit == "samples").map(|key| key.range.1));
        for value in values {
            let kind = kind.with_options(Chosen { value, filtered: false });
            let own = spec.cutoff == CutoffMeaning::Bandwidth;
            let shares: &[f64] = if own { &[1.0, 0.25, 0.0625, 0.03125] } else { &[1.0] };
            shares.iter().for_each(|share| add(kind, *share));
        }
    }
    results
}

/// Returns stiffness (N/m) and damping (N s/m) of a wall on which estimators differ: half of the damping and a quarter
/// of the stiffness that `haptic range --board` predicts stable with the Butterworth.
pub fn comparison_wall(
    file: &DeviceFile,
    q: &[f64],
    normal: &[f64],
    rate_hz: f64,
    cutoff_hz: f64,
) -> Result<(f64, f64), Failure> {
    let around = Loop::with_torque_path(&TorquePath::usual(rate_hz), rate_hz, LinearEstimator::Butterworth(cutoff_hz));
    let prediction = Prediction::new(Subject::new(&file.description).map_err(Failure::wrong)?, around);
    let damping = 0.5 * prediction.stiffness_at(q, normal, Mode::Off, 0.0)?.1;
    let (stiffness, _) = prediction.stiffness_at(q, normal, Mode::Off, damping)?;
    if stiffness > 0.0 {
        return Ok((0.25 * stiffness, damping));
    }
    Err(Failure::impossible(format!(
        "{}: no wall here is predicted stable with the Butterworth at {cutoff_hz} Hz and {rate_hz} Hz",
        file.name
    ))
    .remedy("name the wall to press, or choose another rate and cutoff")
    .choose(Choice::Wall))
}

/// Compares all estimators. Estimators that hold the hand and have at least the Butterworth's area come first, in
/// ascending order of press ripple; the others follow in descending order of area.
pub fn compare(comparison: &Comparison<'_>, sweep: &Sweep) -> Result<Vec<Row>, Failure> {
    let tried = Trials::new(comparison, sweep)?;
    let (rate_hz, butterworth) = (comparison.rate_hz, LinearEstimator::Butterworth(comparison.cutoff_hz));
    let path = TorquePath { drive: Drive::Ideal, ..TorquePath::usual(rate_hz) };
    let around = Loop::with_torque_path(&path, rate_hz, butterworth);
    let (_, damping) = stiffness_at(&tried.linearised, &around, Mode::Off, 0.0)?;
    let mut rows = sweep.map("estimators", &candidates(comparison), |candidate| tried.row(candidate, damping))?;
    let enough = rows.iter().find(|row| row.estimator == "butterworth").map_or(0.0, |row| row.area);
    rows.sort_by(|a, b| {
        let first = |row: &Row| row.area >= enough && row.holds;
        let ripple = |row: &Row| row.press_n[0].unwrap_or(f64::INFINITY);
        let within = |a: &Row, b: &Row| {
            if first(a) { ripple(a).total_cmp(&ripple(b)) } else { b.area.total_cmp(&a.area) }
        };
        first(b)
            .cmp(&first(a))
            .then_with(|| within(a, b))
            .then_with(|| a.estimator.cmp(&b.estimator))
            .then_with(|| a.value.cmp(&b.value))
            .then_with(|| b.delay_s.total_cmp(&a.delay_s))
    });
    Ok(rows)
}

/// Returns [`Row::ripple_n`] for one estimator, N.
pub fn ripple_of(comparison: &Comparison<'_>, kind: Estimator) -> Result<Option<f64>, Failure> {
    let sweep = Sweep::quiet();
    Ok(Trials::new(comparison, &sweep)?.ripple(&comparison.rendered_wall(kind, comparison.cutoff_hz))?.0)
}

struct Trials<'a> {
    rate_hz: f64,
    simulation: WallSimulation,
    linearised: Linearised,
    sweep: &'a Sweep,
}

impl<'a> Trials<'a> {
    fn new(comparison: &Comparison<'_>, sweep: &'a Sweep) -> Result<Self, Failure> {
        let Comparison { file, q, normal, rate_hz, .. } = *comparison;
        let description = &file.description;
        Ok(Self {
            rate_hz,
            simulation: WallSimulation::new(description, description, q, normal, rate_hz)?,
            linearised: Linearised::at(description, q, normal)?,
            sweep,
        })
    }

    fn row(&self, wall: &RenderedWall, damping: f64) -> Result<Row, Failure> {
        let (ripple_n, holds) = self.ripple(wall)?;
        let spec = wall.kind.spec();
        let plain = matches!(wall.kind, Estimator::BackwardDifference);
        let has_cutoff = spec.map_or(!plain, |spec| spec.cutoff == CutoffMeaning::Bandwidth);
        let coefficients = Coefficients::<f64>::new(wall.kind, self.rate_hz, wall.cutoff_hz).map_err(Failure::wrong)?;
        Ok(Row {
            estimator: wall.kind.name().into(),
            value: spec.and_then(|spec| spec.key).and(wall.kind.chosen()).map(|chosen| chosen.value),
            cutoff_hz: has_cutoff.then_some(wall.cutoff_hz),
            area: self.area(wall, damping)?,
            press_n: [self.press_ripple(wall, FeedForward::Off)?, self.press_ripple(wall, FeedForward::Full)?],
            ripple_n,
            holds,
            delay_s: coefficients.lag(),
            noise_m_s: self.velocity_noise(wall)?,
        })
    }

    /// Computes ∫ largest quiet stiffness over damping by the trapezoidal rule at evenly spaced dampings, until no wall
    /// is quiet. `damping` (N s/m) is the largest damping that is predicted stable with the Butterworth.
    fn area(&self, wall: &RenderedWall, damping: f64) -> Result<f64, Failure> {
        let step = damping * 1.25 / DAMPING_COUNT as f64;
        let (mut area, mut last) = (0.0, 0.0);
        let mut i = 1.0;
        // Estimators without lag are stable with more damping; five times the predicted damping is enough.
        while step > 0.0 && i <= 4.0 * DAMPING_COUNT as f64 {
            let most = self.largest_quiet_stiffness(&RenderedWall { damping: i * step, ..*wall })?;
            area += step * 0.5 * (last + most);
            if most == 0.0 {
                break;
            }
            last = most;
            i += 1.0;
        }
        Ok(area)
    }

    /// Returns the stiffness up to which every wall with this damping comes to rest, N/m; 0 if no wall comes to rest.
    fn largest_quiet_stiffness(&self, wall: &RenderedWall) -> Result<f64, Failure> {
        // The smallest stiffness is large enough for the tip to swing back within the allowed time.
        let comes_to_rest = |stiffness: f64| self.is_quiet_when_struck(&RenderedWall { stiffness, ..*wall });
        let (mut low, mut high) = (100.0, 100.0);
        if !comes_to_rest(low)? {
            return Ok(0.0);
        }
        while comes_to_rest(high * 2.0)? {
            high *= 2.0;
            if high > 1.0e7 {
                return Ok(high);
            }
        }
        low = high.max(low);
        high *= 2.0;
        while high / low > STIFFNESS_RATIO {
            let middle = (low * high).sqrt();
            if comes_to_rest(middle)? { low = middle } else { high = middle }
        }
        Ok(low)
    }

    /// Returns true if the tip comes to rest after it was struck along the normal.
    fn is_quiet_when_struck(&self, wall: &RenderedWall) -> Result<bool, Failure> {
        self.sweep.check_interrupted()?;
        let mass = self.linearised.w_eff().ok_or_else(|| Failure::impossible("the device has no inertia here"))?;
        let count = self.simulation.count;
        // Initial speed of the wall's own oscillation with this amplitude, at most the speed of a hand's strike.
        let speed = (STRIKE_COUNTS * count * (wall.stiffness / mass).sqrt()).min(0.5);
        let late = (REST_S * self.rate_hz) as usize * 3 / 4;
        let (mut n, mut low, mut high) = (0, f64::INFINITY, f64::NEG_INFINITY);
        let tip_stays = self.simulation.run(wall, Trial::Struck(speed), REST_S, |_, along| {
            if n >= late {
                (low, high) = (along.min(low), along.max(high));
            }
            n += 1;
            high - low < QUIET_COUNTS * count
        })?;
        Ok(tip_stays && high - low < QUIET_COUNTS * count)
    }

    /// Returns the wall's force in the last `recorded` seconds of a trial, N, or `None` if the tip flies off.
    fn last_forces(
        &self,
        simulation: &WallSimulation,
        wall: &RenderedWall,
        trial: Trial,
        seconds: f64,
        recorded: f64,
    ) -> Result<Option<Vec<f64>>, Failure> {
        self.sweep.check_interrupted()?;
        let mut forces = Vec::new();
        let tip_stays = simulation.run(wall, trial, seconds, |force, _| {
            forces.push(force);
            true
        })?;
        let begin = (forces.len() as f64 * (seconds - recorded) / seconds) as usize;
        Ok(tip_stays.then(|| forces.split_off(begin)))
    }

    /// Returns the force ripple under a hand that presses, and true if the wall holds the hand.
    fn ripple(&self, wall: &RenderedWall) -> Result<(Option<f64>, bool), Failure> {
        let late = self.last_forces(&self.simulation, wall, Trial::Pressed, SETTLE_S + RECORD_S, RECORD_S)?;
        let Some(late) = late else { return Ok((None, false)) };
        let mean = late.iter().sum::<f64>() / late.len() as f64;
        let square = late.iter().map(|force| (force - mean).powi(2)).sum::<f64>() / late.len() as f64;
        // Friction and the hand's own stiffness carry a part of the push.
        let friction = self.simulation.friction();
        Ok((Some(square.sqrt()), (mean / PUSH_N - 1.0).abs() < 0.1 + friction / PUSH_N))
    }

    /// Returns the largest force ripple over several encoder offsets while a hand presses ever harder, N.
    fn press_ripple(&self, wall: &RenderedWall, feed_forward: FeedForward) -> Result<Option<f64>, Failure> {
        let wall = RenderedWall { feed_forward, ..*wall };
        let mut most: f64 = 0.0;
        for offset in 0..ripple::COUNT_OFFSETS {
            let moved = self
                .simulation
                .with_count_offsets(|j| (offset as f64 / ripple::COUNT_OFFSETS as f64 + 0.37 * j as f64).fract());
            let seconds = ripple::SETTLE_S + ripple::RECORD_S;
            let late = self.last_forces(&moved, &wall, Trial::PressedHarder, seconds, ripple::RECORD_S)?;
            let Some(late) = late else { return Ok(None) };
            most = most.max(deviation_from_line(&late).0);
        }
        Ok(Some(most))
    }

    /// Returns the root mean square of the velocity error while the joints turn slowly and steadily, m/s.
    fn velocity_noise(&self, wall: &RenderedWall) -> Result<f64, Failure> {
        let still = RenderedWall { stiffness: 0.0, damping: 0.0, ..*wall };
        let velocities = self.simulation.velocity_estimates(&still, SLOW_SPEED, SLOW_MOTION_S)?;
        let late = &velocities[velocities.len() / 2 + 1..];
        Ok((late.iter().map(|velocity| (velocity - SLOW_SPEED).powi(2)).sum::<f64>() / late.len() as f64).sqrt())
    }
}
