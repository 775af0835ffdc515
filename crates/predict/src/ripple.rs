//! Effect of encoder steps on a pressed wall, by simulation because a quantiser is not linear.
//!
//! A hand presses the wall with a steady force in the simulation of contacts (`contact`). The control loop of the
//! prediction renders the wall with its delay, drive, estimator and feed-forward, linearised at the pose, and each
//! joint angle comes in encoder steps. [`crate::bench::wall`] simulates the board's own step with nonlinear estimators.
//!
//! A static wall is unilateral. Without friction no equilibrium exists between two counts, so there is a limit cycle;
//! friction that holds more than one count's force prevents it (Abbott and Okamura 2005). The size of the limit cycle
//! depends on the pose's position within a count. Each wall is therefore simulated with several count offsets, and the
//! largest ripple counts.

use crate::contact::{Contact, Grip, Law, LawOutput, deviation_from_line};
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::model::description::Description;
use haptic_host::error::Failure;
use haptic_host::vectors::padded;
use haptic_sim::Plant;
use haptic_stability::analysis::flexible::{Hand, Posture};
use haptic_stability::analysis::line::{DampingRule, StableLine};
use haptic_stability::analysis::plant::Linearised;
use haptic_stability::analysis::sampled::{Loop, Mode};
use haptic_stability::sweep::Sweep;
use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

/// Default light hand, which presses with [`PUSH_N`].
pub const LIGHT_HAND: Hand = Hand { mass: 0.05, damping: 3.0, stiffness: 200.0 };
/// Force with which the hand presses, N.
pub const PUSH_N: f64 = 3.0;
/// Rate at which the push of the hand grows, N/s. The growth moves a tip that friction would hold at rest.
pub(crate) const PUSH_RISE: f64 = 1.0;
pub(crate) const SETTLE_S: f64 = 0.5;
pub(crate) const RECORD_S: f64 = 0.3;
pub(crate) const COUNT_OFFSETS: usize = 4;
/// Number of decades below the largest stiffness of a line.
const DECADES: usize = 4;
const WALLS_PER_DECADE: usize = 5;
/// Largest ratio of two stiffnesses between which the ripple exceeds a bound.
const STIFFNESS_RATIO: f64 = 1.05;

/// Ripple of a pressed wall.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Ripple {
    /// Stiffness, N/m.
    pub kp: f64,
    /// Damping, N s/m.
    pub kd: f64,
    /// Root mean square of the wall's force about its fitted line, N; `None` if the tip flies off.
    pub rms_n: Option<f64>,
    /// Half of the difference between the largest and the smallest force, N.
    pub peak_n: Option<f64>,
    /// Tip motion along the normal from peak to peak, m.
    pub motion_m: Option<f64>,
}

impl Ripple {
    /// Returns true if the root mean square is at most `bound_n` (N).
    pub fn is_within(&self, bound_n: f64) -> bool {
        self.rms_n.is_some_and(|rms| rms <= bound_n)
    }
}

/// Walls along a line, with the smallest stiffness at which the ripple exceeds a bound.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RippleLine {
    /// Largest stiffness up to which every wall on the line is stable by linear theory, N/m.
    pub kp_stable: f64,
    /// Smallest stiffness at which the ripple exceeds the bound, N/m; `None` if no wall exceeds it.
    pub kp_from: Option<f64>,
    /// The simulated walls in order of stiffness.
    pub points: Vec<Ripple>,
}

/// A device and the hand that presses its wall.
#[derive(Clone, Debug)]
pub struct PressedWall<'a> {
    /// The linearised device.
    pub device: &'a Linearised,
    /// Description of the device, with its nonlinear effects.
    pub description: Description,
    /// Pose, rad.
    pub q: Vec<f64>,
    /// Unit normal of the wall, d entries.
    pub normal: Vec<f64>,
    /// Control loop.
    pub around: &'a Loop,
    /// The hand that presses the wall.
    pub hand: Hand,
    /// Force with which the hand presses, N.
    pub push_n: f64,
}

impl PressedWall<'_> {
    /// Returns the tip motion along the normal per count of the coarsest joint, m; `None` if a joint has no encoder.
    pub fn count_m(&self) -> Option<f64> {
        let steps = self.encoder_steps()?;
        Some(steps.iter().zip(self.device.row.iter()).map(|(step, lever)| (step * lever).abs()).fold(0.0, f64::max))
    }

    /// Returns the largest force change by one count, N, through the stiffness and the estimated velocity.
    pub fn step_n(&self, kp: f64, kd: f64) -> Option<f64> {
        Some(self.count_m()? * (kp + kd * self.around.estimator.peak_step_response(self.around.rate_hz)))
    }

    fn encoder_steps(&self) -> Option<Vec<f64>> {
        let joints = self.device.row.len();
        let counts =
            self.description.joints[..joints].iter().map(|joint| joint.encoder.map(|e| e.counts_per_turn.abs()));
        counts.map(|counts| counts.map(|counts| std::f64::consts::TAU / counts)).collect()
    }

    /// Simulates the ripple of a wall under the hand; returns `None` if a joint has no encoder.
    pub fn ripple(&self, mode: Mode, kp: f64, kd: f64) -> Option<Ripple> {
        let steps = self.encoder_steps()?;
        let lost = Ripple { kp, kd, rms_n: None, peak_n: None, motion_m: None };
        let mut worst = Ripple { rms_n: Some(0.0), peak_n: Some(0.0), motion_m: Some(0.0), ..lost };
        for offset in 0..COUNT_OFFSETS {
            let Some(result) = self.run(&steps, mode, kp, kd, offset as f64 / COUNT_OFFSETS as f64) else {
                return Some(lost);
            };
            let most = |a: Option<f64>, b: f64| a.map(|a| a.max(b));
            worst = Ripple {
                rms_n: most(worst.rms_n, result[0]),
                peak_n: most(worst.peak_n, result[1]),
                motion_m: most(worst.motion_m, result[2]),
                ..lost
            };
        }
        Some(worst)
    }

    /// Simulates walls along `line` and finds the stiffness at which the ripple exceeds `bound_n` (N).
    pub fn ripple_line(
        &self,
        mode: Mode,
        line: DampingRule,
        bound_n: f64,
        sweep: &Sweep,
    ) -> Result<Option<RippleLine>, Failure> {
        if self.encoder_steps().is_none() {
            return Ok(None);
        }
        let StableLine { mass, kp: kp_stable } = StableLine::of(self.device, self.around, mode, line)?;
        let tried: Vec<f64> = (0..=DECADES * WALLS_PER_DECADE)
            .map(|i| kp_stable * 10_f64.powf(i as f64 / WALLS_PER_DECADE as f64 - DECADES as f64))
            .filter(|kp| *kp > 0.0)
            .collect();
        let wall = |kp: &f64| self.ripple(mode, *kp, line.damping(*kp, mass));
        let stage = format!("ripple of walls, {mode:?}, {line:?}");
        let mut points: Vec<Ripple> = sweep.map(&stage, &tried, |kp| Ok(wall(kp)))?.into_iter().flatten().collect();
        let over = points.iter().position(|point| !point.is_within(bound_n));
        let kp_from = over.map(|at| {
            let mut high = points[at].kp;
            let Some(before) = at.checked_sub(1) else { return high };
            let mut low = points[before].kp;
            while high / low > STIFFNESS_RATIO {
                let middle = (low * high).sqrt();
                let Some(point) = wall(&middle) else { break };
                if point.is_within(bound_n) {
                    low = middle
                } else {
                    high = middle
                }
                points.push(point);
            }
            high
        });
        points.sort_by(|a, b| a.kp.total_cmp(&b.kp));
        Ok(Some(RippleLine { kp_stable, kp_from, points }))
    }

    /// Simulates a wall. Returns rms and peak of its force (N) and the tip motion (m); `None` if the tip flies off.
    fn run(&self, steps: &[f64], mode: Mode, kp: f64, kd: f64, offset: f64) -> Option<[f64; 3]> {
        let mut held = self.description;
        held.handle_mass += self.hand.mass;
        let q0: [f64; MAX_JOINTS] = padded(&self.q);
        let plant = Plant::new(&held, q0, true, [(f64::NEG_INFINITY, f64::INFINITY); 3]).ok()?;
        let (tip, weight) = (plant.tip(), plant.gravity());
        let mobility = self.device.mass.clone().cholesky()?.inverse();
        let shaped = self.device.shaped_torque();
        let holding: [f64; MAX_JOINTS] = padded(self.holding_force(mode, &mobility, &shaped)?.as_slice());
        let mut law = LinearLaw::new(self, steps, mode, (kp, kd), offset, &mobility, &shaped);
        let initial_torque = padded((&self.device.row * self.push_n).as_slice());
        let contact = Contact {
            weight_torque: weight,
            initial_torque,
            ..Contact::new(plant, padded(&self.normal), self.around, self.hand)
        };
        let settle = (SETTLE_S * self.around.rate_hz).round() as usize;
        let (mut forces, mut tips, mut n) = (Vec::new(), Vec::new(), 0);
        let tip_stays = contact.run(
            &mut law,
            SETTLE_S + RECORD_S,
            |time| Some(Grip { goal: tip, push: holding.map(|share| -(share * (self.push_n + PUSH_RISE * time))) }),
            |force, along| {
                if n >= settle {
                    forces.push(force);
                    tips.push(along);
                }
                n += 1;
                true
            },
        );
        let (rms, force) = deviation_from_line(&forces);
        tip_stays.then(|| [rms, 0.5 * force, deviation_from_line(&tips).1])
    }

    /// Returns the hand's force that keeps the tip in place, per newton of the wall's force, d entries. One part acts
    /// along the normal. The other part acts against the sideways push of the feed-forward, which is Λ J M⁻¹ times its
    /// torques; without it the hand's spring would move by millimetres, too far for the linearised loop.
    fn holding_force(&self, mode: Mode, mobility: &DMatrix<f64>, shaped: &DVector<f64>) -> Option<DVector<f64>> {
        let normal = DVector::from_column_slice(&self.normal);
        // A washout has no steady sideways push.
        if mode != Mode::Full {
            return Some(normal);
        }
        let tip = &self.device.flexible.tip;
        Some((tip * mobility * tip.transpose()).cholesky()?.solve(&(tip * mobility * shaped)))
    }
}

/// The linearised control loop of a prediction: its estimator, feed-forward and posture, with encoder steps.
struct LinearLaw<'a> {
    steps: &'a [f64],
    q0: [f64; MAX_JOINTS],
    offset: f64,
    device: &'a Linearised,
    shaped: &'a DVector<f64>,
    mobility: &'a DMatrix<f64>,
    estimator: DMatrix<f64>,
    wall: EstimatedMotion,
    held: Option<(Posture, EstimatedMotion)>,
    /// Motions of the joints, and the map from b of (4) to torques; `None` if joint damping is not compensated.
    compensated: Option<(Vec<EstimatedMotion>, DMatrix<f64>)>,
    mode: Mode,
    /// Slow part of the force, for a washout, N.
    slow_force: f64,
    kp: f64,
    kd: f64,
    /// Position of the wall's surface along the normal, m.
    surface: f64,
    period: f64,
    /// Last commanded torques, N m.
    commanded: DVector<f64>,
}

/// A motion of the joints, with its velocity estimator.
struct EstimatedMotion {
    row: DVector<f64>,
    last_position: f64,
    /// States of the estimator, then the motion in the last period, then the motion that the last command predicts.
    memory: DVector<f64>,
}

impl EstimatedMotion {
    /// Creates the motion at rest at these angles (rad).
    fn new(row: DVector<f64>, estimator: &DMatrix<f64>, angles: &DVector<f64>) -> Self {
        Self { last_position: row.dot(angles), row, memory: DVector::zeros(estimator.nrows() + 1) }
    }

    /// Returns position and velocity per sample. `given` is each joint's velocity from the last command, rad.
    fn estimate(&mut self, angles: &DVector<f64>, estimator: &DMatrix<f64>, given: &DVector<f64>) -> (f64, f64) {
        let x = self.row.dot(angles);
        let states = estimator.nrows() - 1;
        self.memory[states] = x - self.last_position;
        self.memory[states + 1] = self.row.dot(given);
        self.last_position = x;
        let change = estimator * &self.memory;
        for state in 0..states {
            self.memory[state] += change[state];
        }
        (x, change[states])
    }
}

impl<'a> LinearLaw<'a> {
    fn new(
        pressed: &'a PressedWall<'_>,
        steps: &'a [f64],
        mode: Mode,
        (kp, kd): (f64, f64),
        offset: f64,
        mobility: &'a DMatrix<f64>,
        shaped: &'a DVector<f64>,
    ) -> Self {
        let (device, joints) = (pressed.device, steps.len());
        let estimator = pressed.around.estimator.matrix(pressed.around.rate_hz);
        let q0 = padded(&pressed.q);
        let angles = encoder_angles(&q0, &q0, steps, offset);
        let estimated = |row: DVector<f64>| EstimatedMotion::new(row, &estimator, &angles);
        let unit = &device.unit_motion;
        let compensated = (pressed.around.damping_compensation && mode != Mode::Off).then(|| {
            let each = DMatrix::identity(joints, joints);
            let joints = each.column_iter().map(|joint| estimated(joint.into_owned())).collect();
            (joints, each - &device.mass * unit * unit.transpose() / device.w_rr())
        });
        Self {
            steps,
            q0,
            offset,
            device,
            shaped,
            mobility,
            wall: estimated(device.row.clone()),
            held: device.flexible.posture.as_ref().map(|(held, row)| (*held, estimated(row.clone()))),
            compensated,
            estimator,
            mode,
            slow_force: pressed.push_n,
            kp,
            kd,
            // At the start the wall carries the push of the hand.
            surface: if kp > 0.0 { -pressed.push_n / kp } else { 0.0 },
            period: 1.0 / pressed.around.rate_hz,
            commanded: DVector::zeros(joints),
        }
    }
}

/// Returns the joint angles relative to `q0` as the encoders show them, rad.
fn encoder_angles(q: &[f64; MAX_JOINTS], q0: &[f64; MAX_JOINTS], steps: &[f64], offset: f64) -> DVector<f64> {
    DVector::from_fn(steps.len(), |j, _| {
        // Each joint has another offset so that the joints do not step together.
        let origin = (offset + 0.37 * j as f64).fract();
        (((q[j] - q0[j]) / steps[j] - origin).round() + origin) * steps[j]
    })
}

impl Law for LinearLaw<'_> {
    fn evaluate(&mut self, measured: &[f64; MAX_JOINTS]) -> LawOutput {
        let (period, estimator) = (self.period, &self.estimator);
        let angles = encoder_angles(measured, &self.q0, self.steps, self.offset);
        let given = self.mobility * &self.commanded * (period * period);
        let (x, moved) = self.wall.estimate(&angles, estimator, &given);
        let force = (-self.kp * (self.surface + x) - self.kd * moved / period).max(0.0);
        let [plain, shaped] = match self.mode {
            Mode::Off => [force, 0.0],
            Mode::Full => [0.0, force],
            Mode::Washout(hz) => {
                let g = (std::f64::consts::PI * hz * period).tan();
                let step = (force - self.slow_force) * g / (1.0 + g);
                let washed = force - (self.slow_force + step);
                self.slow_force += 2.0 * step;
                [force - washed, washed]
            }
        };
        let mut torque = &self.device.row * plain + self.shaped * shaped;
        if let Some((posture, turn)) = &mut self.held {
            let (angle, moved) = turn.estimate(&angles, estimator, &given);
            torque -= &turn.row * (posture.stiffness * angle + posture.damping * moved / period);
        }
        if let Some((joints, bias)) = &mut self.compensated {
            let moved = joints.iter_mut().map(|joint| joint.estimate(&angles, estimator, &given).1 / period);
            let moved = DVector::from_iterator(self.steps.len(), moved);
            torque += &*bias * self.device.viscous.component_mul(&moved);
        }
        self.commanded.copy_from(&torque);
        LawOutput { force, torque: padded(torque.as_slice()) }
    }
}
