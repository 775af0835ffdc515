//! Velocity estimators compared on a device, in simulation with the steps of its encoders: how large a range of walls
//! stays quiet, how much a pressed wall's force ripples, how late and how noisy the velocity is.
//!
//! The controller is the board's own, in its precision; the device moves by its full equations with friction, torque
//! follows half a carrier period late, and nothing limits it: motors and their limits are the same for every estimator.
//! [`mod@crate::tune`] asks here as well. [`crate::analysis::ripple`] is another simulation because it has the loop of
//! a prediction, with any drive, delay and linear estimator, where this one has the board's own step; host/tests/quick/ripple.rs
//! holds both to each other.

use crate::analysis::control_loop::usual_delay;
use crate::analysis::plant::{Drive, Linearised};
use crate::analysis::pose::TaskPose;
use crate::analysis::range::stiffness_at;
use crate::analysis::ripple::{self, LIGHT_HAND, PUSH_N, about_its_line};
use crate::analysis::sampled::{LinearEstimator, Loop, Mode};
use crate::device_file::DeviceFile;
use crate::error::Failure;
use crate::measure::complement;
use crate::sim::{EncoderModel, Load, Plant};
use crate::sweep::Sweep;
use crate::vectors::{padded, padded_to};
use haptic_bridge::model::admissible::Admissible;
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::model::description::Description;
use haptic_bridge::model::device::Device;
use haptic_bridge::model::mechanism::Mechanism;
use haptic_bridge::render::controller::Controller;
use haptic_bridge::render::scene::{FeedForward, Plane, Scene, Surface, Wall};
use haptic_bridge::render::velocity::{Chosen, Coefficients, CutoffMeans, Estimator};
use haptic_bridge::servo::compiled::BoardMath;
use haptic_bridge::with_mechanism;
use serde::{Deserialize, Serialize};

/// The hand that presses the wall for the ripple: mass (kg), damping (N s/m), stiffness (N/m) and push (N).
const HAND: (f64, f64, f64, f64) = (LIGHT_HAND.mass, LIGHT_HAND.damping, LIGHT_HAND.stiffness, PUSH_N);
/// Time to settle before the ripple is looked at, and time in which it is, s.
const SETTLE_S: f64 = 0.3;
const LOOK_S: f64 = 0.3;
/// Speed of the motion whose velocity estimate is judged, m/s, and for how long, s.
const SLOW: f64 = 0.01;
const SLOW_S: f64 = 0.2;
/// Dampings at which the largest quiet stiffness is sought.
const DAMPINGS: usize = 8;
/// Ratio to which a largest stiffness is found.
const CLOSE: f64 = 1.05;
/// How many counts the tip moves along the normal when a wall is tried, and how many it may keep moving for the wall to
/// count as quiet.
const STRUCK: f64 = 40.0;
const QUIET: f64 = 6.0;
/// A tip this far from the wall's surface is lost, m.
const FAR_M: f64 = 0.02;
/// Time in which a struck wall must come to rest, s.
const REST_S: f64 = 0.25;

/// What is compared.
pub struct Comparison<'a> {
    /// The device.
    pub file: &'a DeviceFile,
    /// Pose, rad.
    pub q: &'a [f64],
    /// Unit normal of the wall.
    pub normal: &'a [f64],
    /// Control rate, Hz.
    pub rate_hz: f64,
    /// Cutoff, Hz.
    pub cutoff_hz: f64,
    /// Stiffness (N/m) and damping (N s/m) of the wall that is pressed for the ripple.
    pub wall: (f64, f64),
}

/// What one estimator makes of the device.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Its word in scene files.
    pub estimator: String,
    /// Its own value, where it takes one.
    pub value: Option<u32>,
    /// Its cutoff, Hz, where it has one.
    pub cutoff_hz: Option<f64>,
    /// ∫ largest quiet stiffness over damping, N²s/m²: simulated, with encoder steps and friction. Sought up to 1e7 N/m
    /// and to five times the damping that is predicted stable with the Butterworth; beyond, the area is at least this.
    pub area: f64,
    /// Root mean square of the force of the wall under a hand that presses ever harder, about its straight line, N:
    /// without the feed-forward, and with all of it; none where the tip flies off.
    pub press_n: [Option<f64>; 2],
    /// The same under a hand at rest, about its mean, without the feed-forward: friction may hold the tip between two
    /// counts.
    pub ripple_n: Option<f64>,
    /// Whether the pressed wall pushed on average as hard as the hand, within a tenth.
    pub holds: bool,
    /// How late the velocity is, s.
    pub delay_s: f64,
    /// Root mean square of its error at a slow steady motion, m/s.
    pub noise_m_s: f64,
}

/// One estimator with its choices, and what the wall does with its velocity.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    kind: Estimator,
    cutoff_hz: f64,
    shaping: Shaping,
}

/// The feed-forward of the wall.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shaping {
    /// How much of it.
    pub feed_forward: FeedForward,
    /// Corner of the washout, Hz.
    pub washout_hz: f64,
    /// Whether the joints' own damping is compensated.
    pub damping_compensation: bool,
    /// What a redundant device holds.
    pub admissible: Admissible,
}

impl Shaping {
    /// None: estimators are compared without.
    const NONE: Self = Self {
        feed_forward: FeedForward::Off,
        washout_hz: 2.0,
        damping_compensation: false,
        admissible: Admissible::Orientation,
    };
}

/// What is done to a wall.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Trial {
    /// A hand pushes steadily. Friction may then lock the tip between two encoder steps, and a wall that would rattle
    /// is quiet.
    Pressed,
    /// A hand pushes ever harder, as in [`crate::analysis::ripple`]: friction cannot hold the tip for good.
    PressedHarder,
    /// A hand pushes now more, now less, and slides along the wall.
    SlidAlong,
    /// The tip strikes it at this speed (m/s), without a hand.
    Struck(f64),
}

/// A press below this is zero beside what a board's arithmetic and a hand are, N: such rows are equal.
pub const RESOLUTION_N: f64 = 1e-3;

/// Sliding along the wall, m/s; how the push of a hand that slides swings, as a share of it and in Hz; how long is
/// looked, s; and from which frequency on (Hz) a force is ripple and no longer what the hand does.
const SLIDE: f64 = 0.03;
const SWINGS: (f64, f64) = (0.5, 1.0);
const SLIDE_S: f64 = 0.5;
const RIPPLE_HZ: f64 = 20.0;

/// How a wall is under a hand that presses it and slides along it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pressed {
    /// Root mean square of what its force has above 20 Hz, N; none where the tip flies off.
    pub ripple_n: Option<f64>,
    /// Whether it pushes on average as hard as the hand does there, within a tenth and friction.
    pub holds: bool,
}

/// Presses the wall of a comparison with one estimator and feed-forward, by simulation, and slides along it.
pub fn pressed(
    comparison: &Comparison<'_>,
    kind: Estimator,
    cutoff_hz: f64,
    shaping: Shaping,
) -> Result<Pressed, Failure> {
    let device = comparison.file.device().map_err(Failure::wrong)?;
    let simulation = WallSimulation::new(comparison, device)?;
    let mut held = comparison.file.description;
    held.handle_mass += HAND.0;
    let candidate = Candidate { kind, cutoff_hz, shaping };
    let seconds = SETTLE_S + SLIDE_S;
    let trace = simulation.run(&candidate, comparison.wall, false, &held, Trial::SlidAlong, seconds)?;
    if trace.lost {
        return Ok(Pressed { ripple_n: None, holds: false });
    }
    let settled = (SETTLE_S * comparison.rate_hz) as usize;
    let mean = trace.force[settled..].iter().sum::<f64>() / (trace.force.len() - settled) as f64;
    let square = fast(&trace.force, comparison.rate_hz, settled).map(|fast| fast * fast).sum::<f64>();
    let ripple = (square / (trace.force.len() - settled) as f64).sqrt();
    // A soft wall gives way, and the hand's own spring holds a part.
    let pushes =
        (settled..trace.force.len()).filter_map(|n| simulation.hand(Trial::SlidAlong, n as f64 / comparison.rate_hz));
    let push = pushes.map(|(_, push)| push).sum::<f64>() / (trace.force.len() - settled) as f64;
    let expected = push * comparison.wall.0 / (comparison.wall.0 + HAND.2);
    Ok(Pressed {
        ripple_n: Some(ripple),
        holds: (mean / expected - 1.0).abs() < 0.1 + simulation.friction() / expected,
    })
}

/// What a force has above `RIPPLE_HZ` from sample `from` on: less a trend that two poles make of it, one after the
/// other.
pub fn fast(force: &[f64], rate_hz: f64, from: usize) -> impl Iterator<Item = f64> + '_ {
    let share = 1.0 - (-std::f64::consts::TAU * RIPPLE_HZ / rate_hz).exp();
    let (mut first, mut second) = (0.0, 0.0);
    let all = force.iter().map(move |force| {
        first += share * (force - first);
        let quick = force - first;
        second += share * (quick - second);
        quick - second
    });
    all.skip(from)
}

/// Every estimator with its usual value and its longest window; where the cutoff is its bandwidth also at a quarter, a
/// sixteenth and a thirty-second of it, and without a low-pass where that is a choice.
fn candidates(cutoff_hz: f64) -> Vec<Candidate> {
    let mut found = Vec::new();
    for (_, kind) in Estimator::ALL {
        let (Some(spec), Some(usual)) = (kind.spec(), kind.chosen()) else {
            found.push(Candidate { kind: *kind, cutoff_hz, shaping: Shaping::NONE });
            continue;
        };
        let mut values = vec![usual.value];
        values.extend(spec.key.filter(|key| key.unit == "samples").map(|key| key.range.1));
        for value in values {
            let kind = kind.choosing(Chosen { value, filtered: false });
            let own = spec.cutoff == CutoffMeans::Bandwidth;
            let shares: &[f64] = if own { &[1.0, 0.25, 0.0625, 0.03125] } else { &[1.0] };
            found.extend(shares.iter().map(|share| Candidate {
                kind,
                cutoff_hz: cutoff_hz * share,
                shaping: Shaping::NONE,
            }));
        }
    }
    found
}

/// Half of what is predicted stable with the Butterworth: a wall (N/m, N s/m) on which estimators differ.
pub fn telling_wall(
    device: &Device<f64>,
    q: &[f64],
    normal: &[f64],
    rate_hz: f64,
    cutoff_hz: f64,
) -> Result<(f64, f64), Failure> {
    let linearised = Linearised::of(device, q, normal, Admissible::default())?;
    let around = around(rate_hz, cutoff_hz);
    let (_, damping) = stiffness_at(&linearised, &around, Mode::Off, 0.0)?;
    let (stiffness, _) = stiffness_at(&linearised, &around, Mode::Off, 0.5 * damping)?;
    Ok((0.25 * stiffness, 0.5 * damping))
}

fn around(rate_hz: f64, cutoff_hz: f64) -> Loop {
    Loop {
        rate_hz,
        delay_samples: usual_delay(rate_hz),
        estimator: LinearEstimator::Butterworth(cutoff_hz),
        drive: Drive::Ideal,
        damping_compensation: false,
    }
}

/// Compares every estimator. Those with at least the Butterworth's area come first, by their ripple under a hand that
/// presses ever harder; the others follow by area. The same in any order of work: nothing is random.
pub fn compare(comparison: &Comparison<'_>, sweep: &Sweep) -> Result<Vec<Row>, Failure> {
    let device = comparison.file.device().map_err(Failure::wrong)?;
    let linearised = Linearised::of(&device, comparison.q, comparison.normal, Admissible::default())?;
    let around = around(comparison.rate_hz, comparison.cutoff_hz);
    let (_, damping) = stiffness_at(&linearised, &around, Mode::Off, 0.0)?;
    let simulation = WallSimulation::new(comparison, device)?;
    let mut rows =
        sweep.map("estimators", &candidates(comparison.cutoff_hz), |candidate| simulation.row(candidate, damping))?;
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

/// Root mean square of the force of the pressed wall with one estimator, as [`Row::ripple_n`], N.
pub fn ripple_of(comparison: &Comparison<'_>, kind: Estimator) -> Result<Option<f64>, Failure> {
    let device = comparison.file.device().map_err(Failure::wrong)?;
    let candidate = Candidate { kind, cutoff_hz: comparison.cutoff_hz, shaping: Shaping::NONE };
    Ok(WallSimulation::new(comparison, device)?.ripple(&candidate)?.0)
}

/// The device with its wall.
struct WallSimulation<'a> {
    comparison: &'a Comparison<'a>,
    device: Device<f64>,
    board: Device<f32>,
    encoders: Vec<EncoderModel>,
    q: [f64; MAX_JOINTS],
    normal: [f64; MAX_JOINTS],
    tip: [f64; MAX_JOINTS],
    /// A unit vector along the wall; zero where there is only one direction.
    across: [f64; MAX_JOINTS],
    /// Joint motion per metre of tip motion along the normal, rad/m.
    motion: [f64; MAX_JOINTS],
    /// Tip motion along the normal in one count of the coarsest joint, m.
    count: f64,
}

/// What a run showed at every control step, until the tip flew off.
struct Trace {
    /// Distance of the tip along the normal, m.
    distance: Vec<f64>,
    /// Force of the wall, N.
    force: Vec<f64>,
    /// Whether the tip went farther than [`FAR_M`].
    lost: bool,
}

impl<'a> WallSimulation<'a> {
    fn new(comparison: &'a Comparison<'a>, device: Device<f64>) -> Result<Self, Failure> {
        let description = &comparison.file.description;
        let joints = device.axes();
        let encoders = (0..joints)
            .map(|i| description.joints[i].encoder.map(|encoder| EncoderModel::new(&encoder, encoder.offset)))
            .collect::<Option<Vec<_>>>()
            .ok_or_else(|| {
                Failure::wrong(format!("{} has joints without [joint.encoder]", comparison.file.name))
                    .remedy("estimators are compared by what they make of encoder steps: add them")
            })?;
        let pose = TaskPose::of(&device.mechanism, comparison.q)?.regular()?;
        // The device as it was sent has home where count 0 may not be; here counts begin at the encoders' offset.
        let board =
            Device::<f32>::new("compared", &Description { home: None, ..*description }).map_err(Failure::wrong)?;
        let plant = Plant::new(description, padded(comparison.q), true, [(f64::NEG_INFINITY, f64::INFINITY); 3])
            .map_err(Failure::wrong)?;
        let row = pose.jacobian.tr_mul(&padded_to(pose.jacobian.nrows(), comparison.normal));
        let per_count = row.iter().zip(&encoders).map(|(lever, encoder)| (lever * encoder.resolution()).abs());
        let count = per_count.fold(0.0, f64::max);
        let normal = nalgebra::DVector::from_column_slice(comparison.normal);
        let across = complement(&normal).first().map_or([0.0; MAX_JOINTS], |across| padded(across.as_slice()));
        let mut pushed = plant.clone();
        pushed.push(padded(comparison.normal));
        Ok(Self {
            comparison,
            device,
            board,
            encoders,
            q: padded(comparison.q),
            normal: padded(comparison.normal),
            tip: plant.tip(),
            across,
            motion: pushed.qd(),
            count,
        })
    }

    /// A wall through the tip.
    fn scene(&self, candidate: &Candidate, (stiffness, damping): (f64, f64), bilateral: bool) -> Scene<f32> {
        let wall = Wall {
            surface: Surface::Plane(Plane { point: self.tip.map(|v| v as f32), normal: self.normal.map(|v| v as f32) }),
            stiffness: stiffness as f32,
            damping: damping as f32,
            feed_forward: candidate.shaping.feed_forward,
            washout_hz: candidate.shaping.washout_hz as f32,
            damping_compensation: candidate.shaping.damping_compensation,
            bilateral,
        };
        Scene {
            task: self.comparison.file.spec().task as u8,
            rate_hz: self.comparison.rate_hz as f32,
            cutoff_hz: candidate.cutoff_hz as f32,
            estimator: candidate.kind,
            admissible: candidate.shaping.admissible,
            walls: [wall].into_iter().collect(),
            ..Scene::default()
        }
    }

    fn row(&self, candidate: &Candidate, damping: f64) -> Result<Row, Failure> {
        let (ripple_n, holds) = self.ripple(candidate)?;
        let spec = candidate.kind.spec();
        let plain = matches!(candidate.kind, Estimator::BackwardDifference);
        let has_cutoff = spec.map_or(!plain, |spec| spec.cutoff == CutoffMeans::Bandwidth);
        let coefficients = Coefficients::<f64>::new(candidate.kind, self.comparison.rate_hz, candidate.cutoff_hz)
            .map_err(Failure::wrong)?;
        Ok(Row {
            estimator: candidate.kind.name().into(),
            value: spec.and_then(|spec| spec.key).and(candidate.kind.chosen()).map(|chosen| chosen.value),
            cutoff_hz: has_cutoff.then_some(candidate.cutoff_hz),
            area: self.area(candidate, damping)?,
            press_n: [self.press(candidate, FeedForward::Off)?, self.press(candidate, FeedForward::Full)?],
            ripple_n,
            holds,
            delay_s: coefficients.lag(),
            noise_m_s: self.noise(candidate)?,
        })
    }

    /// ∫ largest quiet stiffness over damping: the trapezoidal rule on even dampings from the first up, until nothing
    /// is quiet any more. `damping` (N s/m) is the most that is predicted stable with the Butterworth.
    fn area(&self, candidate: &Candidate, damping: f64) -> Result<f64, Failure> {
        let step = damping * 1.25 / DAMPINGS as f64;
        let (mut area, mut last) = (0.0, 0.0);
        let mut i = 1.0;
        // An estimator without lag is stable to more damping; four times as far is far enough.
        while i <= 4.0 * DAMPINGS as f64 {
            let most = self.stiffest(candidate, i * step)?;
            area += step * 0.5 * (last + most);
            if most == 0.0 {
                break;
            }
            last = most;
            i += 1.0;
        }
        Ok(area)
    }

    /// The largest stiffness (N/m) up to which every tried wall with this damping comes to rest; 0 where none does.
    fn stiffest(&self, candidate: &Candidate, damping: f64) -> Result<f64, Failure> {
        // The least that is looked at swings back in the time a wall has.
        let quiet = |stiffness: f64| self.comes_to_rest(candidate, (stiffness, damping));
        let (mut low, mut high) = (100.0, 100.0);
        if !quiet(low)? {
            return Ok(0.0);
        }
        while quiet(high * 2.0)? {
            high *= 2.0;
            if high > 1.0e7 {
                return Ok(high);
            }
        }
        low = high.max(low);
        high *= 2.0;
        while high / low > CLOSE {
            let middle = (low * high).sqrt();
            if quiet(middle)? { low = middle } else { high = middle }
        }
        Ok(low)
    }

    /// Whether the tip, struck along the normal in the wall, is quiet in the end.
    fn comes_to_rest(&self, candidate: &Candidate, wall: (f64, f64)) -> Result<bool, Failure> {
        let description = self.comparison.file.description;
        // As fast as the wall's own swing of so many counts, but no faster than a hand strikes.
        let mass = self.mass()?;
        let speed = (STRUCK * self.count * (wall.0 / mass).sqrt()).min(0.5);
        let trace = self.run(candidate, wall, true, &description, Trial::Struck(speed), REST_S)?;
        if trace.lost {
            return Ok(false);
        }
        let late = &trace.distance[trace.distance.len() * 3 / 4..];
        let (low, high) = late.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), d| (l.min(*d), h.max(*d)));
        Ok(high - low < QUIET * self.count)
    }

    fn mass(&self) -> Result<f64, Failure> {
        let linearised =
            Linearised::of(&self.device, self.comparison.q, self.comparison.normal, Admissible::default())?;
        linearised.w_eff().ok_or_else(|| Failure::impossible("the device has no inertia here"))
    }

    /// Ripple of the force under a hand that presses, and whether the wall holds it.
    fn ripple(&self, candidate: &Candidate) -> Result<(Option<f64>, bool), Failure> {
        let mut held = self.comparison.file.description;
        held.handle_mass += HAND.0;
        let trace = self.run(candidate, self.comparison.wall, false, &held, Trial::Pressed, SETTLE_S + LOOK_S)?;
        if trace.lost {
            return Ok((None, false));
        }
        let late = &trace.force[(trace.force.len() as f64 * SETTLE_S / (SETTLE_S + LOOK_S)) as usize..];
        let mean = late.iter().sum::<f64>() / late.len() as f64;
        let square = late.iter().map(|force| (force - mean).powi(2)).sum::<f64>() / late.len() as f64;
        // What the hand's own spring gives back, and friction, are part of what the wall need not hold.
        Ok((Some(square.sqrt()), (mean / HAND.3 - 1.0).abs() < 0.1 + self.friction() / HAND.3))
    }

    /// Ripple of the force under a hand that presses ever harder, N: the largest of several offsets of the encoders.
    fn press(&self, candidate: &Candidate, feed_forward: FeedForward) -> Result<Option<f64>, Failure> {
        let candidate = Candidate { shaping: Shaping { feed_forward, ..candidate.shaping }, ..*candidate };
        let mut held = self.comparison.file.description;
        held.handle_mass += HAND.0;
        let mut most: f64 = 0.0;
        for offset in 0..ripple::OFFSETS {
            let shares =
                (0..self.encoders.len()).map(|j| (offset as f64 / ripple::OFFSETS as f64 + 0.37 * j as f64).fract());
            let moved = self.encoders.iter().zip(shares).map(|(encoder, share)| encoder.moved(share)).collect();
            let simulation = Self { encoders: moved, device: self.device.clone(), board: self.board.clone(), ..*self };
            let seconds = ripple::SETTLE_S + ripple::LOOK_S;
            let trace =
                simulation.run(&candidate, self.comparison.wall, false, &held, Trial::PressedHarder, seconds)?;
            if trace.lost {
                return Ok(None);
            }
            most = most.max(
                about_its_line(&trace.force[(trace.force.len() as f64 * ripple::SETTLE_S / seconds) as usize..]).0,
            );
        }
        Ok(Some(most))
    }

    /// What dry friction can hold along the normal, N.
    fn friction(&self) -> f64 {
        let joints = self.comparison.file.description.joints;
        joints.iter().zip(self.motion).map(|(joint, motion)| joint.dry_friction(0.0) * motion.abs()).sum()
    }

    /// Simulates so many seconds of a trial of the wall.
    fn run(
        &self,
        candidate: &Candidate,
        wall: (f64, f64),
        bilateral: bool,
        description: &Description,
        trial: Trial,
        seconds: f64,
    ) -> Result<Trace, Failure> {
        let mut plant =
            Plant::new(description, self.q, true, [(f64::NEG_INFINITY, f64::INFINITY); 3]).map_err(Failure::wrong)?;
        if let Trial::Struck(speed) = trial {
            plant.push(self.normal.map(|n| -n * speed));
        }
        let scene = self.scene(candidate, wall, bilateral);
        with_mechanism!(&self.board.mechanism, m => self.simulate(*m, &scene, &mut plant, trial, seconds))
    }

    fn simulate<M: Mechanism<f32, N>, const N: usize>(
        &self,
        mechanism: M,
        scene: &Scene<f32>,
        plant: &mut Plant,
        trial: Trial,
        seconds: f64,
    ) -> Result<Trace, Failure> {
        let mut controller =
            Controller::<f32, M, BoardMath, N>::new(mechanism, &self.board, scene).map_err(Failure::wrong)?;
        let rate = self.comparison.rate_hz;
        let period = 1.0 / rate;
        let late = usual_delay(rate) * period;
        let steps = (seconds * rate) as usize;
        let mut trace = Trace { distance: Vec::with_capacity(steps), force: Vec::with_capacity(steps), lost: false };
        let mut before = [0.0; MAX_JOINTS];
        for n in 0..steps {
            let hand = self.hand(trial, n as f64 * period);
            let q = plant.q();
            let counts: [i32; N] = core::array::from_fn(|i| self.encoders[i].counts(q[i]));
            let step = controller.step_after(&before.map(|torque| torque as f32), &counts);
            let torque: [f64; MAX_JOINTS] =
                core::array::from_fn(|i| if i < N { f64::from(step.torque[i]) } else { 0.0 });
            trace.force.push(f64::from(step.wall_force));
            let tip = plant.tip();
            let distance = (0..MAX_JOINTS).map(|i| self.normal[i] * (tip[i] - self.tip[i])).sum::<f64>();
            trace.distance.push(distance);
            if distance.is_nan() || distance.abs() >= FAR_M {
                trace.lost = true;
                break;
            }
            self.advance(plant, before, late, hand);
            self.advance(plant, torque, period - late, hand);
            before = torque;
        }
        Ok(trace)
    }

    /// Where the hand wants to be (m) and how hard it pushes (N) at a time (s); `None` in a trial without a hand.
    fn hand(&self, trial: Trial, time: f64) -> Option<([f64; MAX_JOINTS], f64)> {
        let push = HAND.3;
        match trial {
            Trial::Struck(_) => None,
            Trial::Pressed => Some((self.tip, push)),
            Trial::PressedHarder => Some((self.tip, push + ripple::RISE * time)),
            Trial::SlidAlong => {
                let (share, hz) = SWINGS;
                let goal = core::array::from_fn(|i| self.tip[i] + SLIDE * time * self.across[i]);
                Some((goal, push * (1.0 + share * (std::f64::consts::TAU * hz * time).sin())))
            }
        }
    }

    /// Lets the device move under motor torques and a hand, in steps of 50 µs at most.
    fn advance(&self, plant: &mut Plant, torque: [f64; MAX_JOINTS], time: f64, hand: Option<([f64; MAX_JOINTS], f64)>) {
        let pieces = (time / 50.0e-6).ceil().max(1.0);
        for _ in 0..pieces as usize {
            let mut force = [0.0; MAX_JOINTS];
            if let Some((goal, push)) = hand {
                let (_, damping, stiffness, _) = HAND;
                let (tip, velocity) = (plant.tip(), plant.tip_velocity());
                // A hand carries its own weight.
                let gravity = self.comparison.file.description.gravity;
                for i in 0..MAX_JOINTS {
                    force[i] = -push * self.normal[i]
                        - stiffness * (tip[i] - goal[i])
                        - damping * velocity[i]
                        - HAND.0 * gravity[i];
                }
            }
            plant.step(&Load { torque, damping: [0.0; MAX_JOINTS], force }, time / pieces);
        }
    }

    /// Root mean square of the velocity's error where the joints turn slowly and steadily, m/s.
    fn noise(&self, candidate: &Candidate) -> Result<f64, Failure> {
        let scene = self.scene(candidate, (0.0, 0.0), true);
        with_mechanism!(&self.board.mechanism, m => self.slow_motion(*m, &scene))
    }

    fn slow_motion<M: Mechanism<f32, N>, const N: usize>(
        &self,
        mechanism: M,
        scene: &Scene<f32>,
    ) -> Result<f64, Failure> {
        let mut controller =
            Controller::<f32, M, BoardMath, N>::new(mechanism, &self.board, scene).map_err(Failure::wrong)?;
        let steps = (SLOW_S * self.comparison.rate_hz) as usize;
        let (mut sum, mut looked) = (0.0, 0);
        for n in 0..steps {
            let moved = SLOW * n as f64 / self.comparison.rate_hz;
            let counts = core::array::from_fn(|i| self.encoders[i].counts(self.q[i] + self.motion[i] * moved));
            let found = f64::from(controller.step(&counts).normal_velocity);
            if n > steps / 2 {
                sum += (found - SLOW).powi(2);
                looked += 1;
            }
        }
        Ok((sum / f64::from(looked)).sqrt())
    }
}
