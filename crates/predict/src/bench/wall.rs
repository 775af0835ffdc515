//! Simulates one wall, rendered by the board's own control step, with a hand, a tap or a strike.
//!
//! Torques act half a carrier period late, without limits, because motors and limits are the same for all
//! estimators. [`super::estimators`] compares estimators by this simulation, and [`mod@crate::tune`] searches with it.

use crate::contact::{Contact, Grip, Law, LawOutput, RippleFilter};
use crate::measure::complement;
use crate::ripple::{LIGHT_HAND, PUSH_N, PUSH_RISE};
use haptic_bridge::control::compiled::BoardMath;
use haptic_bridge::model::admissible::Admissible;
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::model::description::Description;
use haptic_bridge::model::device::Device;
use haptic_bridge::model::mechanism::Mechanism;
use haptic_bridge::render::controller::Controller;
use haptic_bridge::render::scene::{FeedForward, Plane, Scene, Surface, Wall};
use haptic_bridge::render::velocity::Estimator;
use haptic_bridge::with_mechanism;
use haptic_host::error::Failure;
use haptic_host::vectors::{padded, padded_to};
use haptic_sim::{EncoderModel, Plant};
use haptic_stability::analysis::control_loop::{Loop, TorquePath};
use haptic_stability::analysis::flexible::Hand;
use haptic_stability::analysis::plant::Drive;
use haptic_stability::analysis::pose::TaskPose;
use haptic_stability::analysis::sampled::LinearEstimator;

const SETTLE_S: f64 = 0.3;
const SLIDE_S: f64 = 0.5;
/// Speed along the wall, m/s.
const SLIDE_SPEED: f64 = 0.03;
/// Variation of a sliding hand's push: share of the push, and frequency, Hz.
const PUSH_VARIATION: (f64, f64) = (0.5, 1.0);
/// Speed of a tap, m/s.
pub const TAP_SPEED: f64 = 0.2;
/// Time in which the rebounds of a tap are counted, s.
const TAP_S: f64 = 0.3;

/// Settings of a rendered wall.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderedWall {
    /// Velocity estimator.
    pub kind: Estimator,
    /// Cutoff of the estimator, Hz.
    pub cutoff_hz: f64,
    /// Feed-forward of the wall.
    pub feed_forward: FeedForward,
    /// Corner of the washout, Hz.
    pub washout_hz: f64,
    /// True if the joints' own damping is compensated.
    pub damping_compensation: bool,
    /// The coordinate that the feed-forward of a redundant device holds.
    pub admissible: Admissible,
    /// Stiffness, N/m.
    pub stiffness: f64,
    /// Damping, N s/m.
    pub damping: f64,
}

/// Motion with which a wall is tested.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Trial {
    /// A hand pushes steadily. Friction may lock the tip between two encoder counts and so hide a rattle.
    Pressed,
    /// A hand pushes ever harder, as in [`crate::ripple`], so that friction cannot hold the tip permanently.
    PressedHarder,
    /// A hand slides along the wall with varying push.
    SlidAlong,
    /// The tip starts in a `bilateral` wall at this speed into the wall (m/s), without a hand.
    Struck(f64),
    /// A hand pushes the tip onto the wall at this speed, m/s.
    Tapped(f64),
}

/// Result of a slide along a wall.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlideResult {
    /// Root mean square of the force above 20 Hz, N; `None` if the tip flies off.
    pub ripple_n: Option<f64>,
    /// True if the mean force differs from the hand's expected push by at most a tenth of this push plus friction.
    pub holds: bool,
}

/// A device with a wall at its tip.
#[derive(Clone)]
pub struct WallSimulation {
    /// The device with the mass of a light hand at its tip.
    held_device: Description,
    free_device: Description,
    board: Device<f32>,
    pub(super) encoders: Vec<EncoderModel>,
    around: Loop,
    pub(super) q: [f64; MAX_JOINTS],
    normal: [f64; MAX_JOINTS],
    tip: [f64; MAX_JOINTS],
    /// Unit vector along the wall; zero if the task has one direction.
    tangent: [f64; MAX_JOINTS],
    /// Joint motion per metre of tip motion along the normal, rad/m.
    pub(super) motion: [f64; MAX_JOINTS],
    /// Tip motion along the normal per count of the coarsest joint, m.
    pub(super) count: f64,
}

impl WallSimulation {
    /// Prepares a simulation at a pose (rad) with a wall across the unit normal `normal` and a control rate (Hz). The
    /// board uses `model`, and `device` is the simulated device.
    pub fn new(
        model: &Description,
        device: &Description,
        q: &[f64],
        normal: &[f64],
        rate_hz: f64,
    ) -> Result<Self, Failure> {
        let encoders = model.joints[..q.len()]
            .iter()
            .map(|joint| joint.encoder.map(|encoder| EncoderModel::new(&encoder, encoder.offset)))
            .collect::<Option<Vec<_>>>()
            .ok_or_else(|| {
                Failure::wrong("the device has joints without [joint.encoder]")
                    .remedy("add the encoders: walls are simulated with their steps")
            })?;
        let pose = TaskPose::at(model, q)?.regular()?;
        // Removes the device's home, because counts start at the encoders' offset in this simulation.
        let board = Device::<f32>::new("tried", &Description { home: None, ..*model }).map_err(Failure::wrong)?;
        let free_device = *device;
        let mut held_device = free_device;
        held_device.handle_mass += LIGHT_HAND.mass;
        let row = pose.jacobian.tr_mul(&padded_to(pose.jacobian.nrows(), normal));
        let per_count = row.iter().zip(&encoders).map(|(lever, encoder)| (lever * encoder.resolution()).abs());
        let tangents = complement(&nalgebra::DVector::from_column_slice(normal));
        let count = per_count.fold(0.0, f64::max);
        let mut pushed = plant(&free_device, padded(q))?;
        let tip = pushed.tip();
        pushed.push(padded(normal));
        Ok(Self {
            held_device,
            free_device,
            board,
            encoders,
            // The loop has no estimator because the board's step estimates velocities.
            around: Loop::with_torque_path(
                &TorquePath { drive: Drive::Ideal, ..TorquePath::usual(rate_hz) },
                rate_hz,
                LinearEstimator::BackwardDifference,
            ),
            q: padded(q),
            normal: padded(normal),
            tip,
            tangent: tangents.first().map_or([0.0; MAX_JOINTS], |tangent| padded(tangent.as_slice())),
            motion: pushed.qd(),
            count,
        })
    }

    /// Returns this simulation with each encoder shifted by a share of one count.
    pub(super) fn with_count_offsets(&self, share: impl Fn(usize) -> f64) -> Self {
        let moved = self.encoders.iter().enumerate().map(|(j, encoder)| encoder.with_shifted_edges(share(j))).collect();
        Self { encoders: moved, ..self.clone() }
    }

    /// Returns the largest force along the normal that dry friction holds, N.
    pub(super) fn friction(&self) -> f64 {
        let joints = self.free_device.joints;
        joints.iter().zip(self.motion).map(|(joint, motion)| joint.dry_friction(0.0) * motion.abs()).sum()
    }

    /// Simulates a slide along a wall, and stops early once the ripple must exceed `bound_n` (N).
    pub fn slide(&self, wall: &RenderedWall, bound_n: f64) -> Result<SlideResult, Failure> {
        let rate_hz = self.around.rate_hz;
        let (settle, all) = ((SETTLE_S * rate_hz) as usize, ((SETTLE_S + SLIDE_S) * rate_hz).round() as usize);
        let recorded = (all - settle) as f64;
        let mut fast = RippleFilter::new(rate_hz);
        let (mut n, mut force_sum, mut square) = (0, 0.0, 0.0);
        let enough = bound_n * bound_n * recorded;
        let tip_stays = self.run(wall, Trial::SlidAlong, SETTLE_S + SLIDE_S, |force, _| {
            let fast = fast.filter(force);
            if n >= settle {
                force_sum += force;
                square += fast * fast;
            }
            n += 1;
            square <= enough
        })?;
        if !tip_stays {
            return Ok(SlideResult { ripple_n: None, holds: false });
        }
        // A soft wall moves, so the hand's own stiffness carries a part of the push.
        let pushes = (settle..all).map(|n| hand_push(Trial::SlidAlong, n as f64 / rate_hz));
        let expected = pushes.sum::<f64>() / recorded * wall.stiffness / (wall.stiffness + LIGHT_HAND.stiffness);
        Ok(SlideResult {
            ripple_n: Some((square / recorded).sqrt()),
            holds: n == all && (force_sum / recorded / expected - 1.0).abs() < 0.1 + self.friction() / expected,
        })
    }

    /// Counts the rebounds of a tip that arrives at 0.2 m/s with a push of 3 N, or returns `None` if the tip flies off.
    pub fn rebounds(&self, wall: &RenderedWall) -> Result<Option<usize>, Failure> {
        let (mut inside, mut left) = (false, 0);
        let tip_stays = self.run(wall, Trial::Tapped(TAP_SPEED), TAP_S, |_, along| {
            left += usize::from(inside && along > 0.0);
            inside = along < 0.0;
            true
        })?;
        Ok(tip_stays.then_some(left))
    }

    /// Simulates a trial for `seconds`, or until `seen` returns false. In each period `seen` receives the wall's force
    /// (N) and the tip's position along the normal (m). Returns false if the tip flies off.
    pub(super) fn run(
        &self,
        wall: &RenderedWall,
        trial: Trial,
        seconds: f64,
        seen: impl FnMut(f64, f64) -> bool,
    ) -> Result<bool, Failure> {
        let alone = matches!(trial, Trial::Struck(_));
        let mut plant = plant(if alone { &self.free_device } else { &self.held_device }, self.q)?;
        if let Trial::Struck(speed) | Trial::Tapped(speed) = trial {
            plant.push(self.normal.map(|n| -n * speed));
        }
        let scene = self.scene(wall, alone);
        let Hand { mass, .. } = LIGHT_HAND;
        let grip = |time: f64| {
            let along = if trial == Trial::SlidAlong { SLIDE_SPEED * time } else { 0.0 };
            (!alone).then(|| Grip {
                goal: core::array::from_fn(|i| self.tip[i] + along * self.tangent[i]),
                // A hand carries its own weight.
                push: core::array::from_fn(|i| {
                    -hand_push(trial, time) * self.normal[i] - mass * self.free_device.gravity[i]
                }),
            })
        };
        let contact = Contact::new(plant, self.normal, &self.around, LIGHT_HAND);
        with_mechanism!(&self.board.mechanism, m => {
            let mut law = BoardLaw::new(self, *m, &scene)?;
            Ok(contact.run(&mut law, seconds, grip, seen))
        })
    }

    fn scene(&self, wall: &RenderedWall, bilateral: bool) -> Scene<f32> {
        let surface =
            Surface::Plane(Plane { point: self.tip.map(|v| v as f32), normal: self.normal.map(|v| v as f32) });
        Scene {
            task: self.free_device.kind.spec().task as u8,
            rate_hz: self.around.rate_hz as f32,
            cutoff_hz: wall.cutoff_hz as f32,
            estimator: wall.kind,
            admissible: wall.admissible,
            walls: [Wall {
                surface,
                stiffness: wall.stiffness as f32,
                damping: wall.damping as f32,
                feed_forward: wall.feed_forward,
                washout_hz: wall.washout_hz as f32,
                damping_compensation: wall.damping_compensation,
                bilateral,
            }]
            .into_iter()
            .collect(),
            ..Scene::default()
        }
    }

    /// Returns the board's velocity estimates while the joints turn steadily and the tip moves at `speed`, m/s.
    pub(super) fn velocity_estimates(
        &self,
        wall: &RenderedWall,
        speed: f64,
        seconds: f64,
    ) -> Result<Vec<f64>, Failure> {
        let scene = self.scene(wall, true);
        let rate_hz = self.around.rate_hz;
        with_mechanism!(&self.board.mechanism, m => {
            let mut board = BoardLaw::new(self, *m, &scene)?;
            let moved = (0..(seconds * rate_hz) as usize).map(|n| speed * n as f64 / rate_hz);
            Ok(moved.map(|moved| {
                let q = core::array::from_fn(|i| self.q[i] + self.motion[i] * moved);
                f64::from(board.controller.step(&board.counts(&q)).normal_velocity)
            }).collect())
        })
    }
}

fn hand_push(trial: Trial, time: f64) -> f64 {
    match trial {
        Trial::PressedHarder => PUSH_N + PUSH_RISE * time,
        Trial::SlidAlong => {
            let (share, hz) = PUSH_VARIATION;
            PUSH_N * (1.0 + share * (std::f64::consts::TAU * hz * time).sin())
        }
        Trial::Pressed | Trial::Struck(_) | Trial::Tapped(_) => PUSH_N,
    }
}

fn plant(description: &Description, q: [f64; MAX_JOINTS]) -> Result<Plant, Failure> {
    Plant::new(description, q, true, [(f64::NEG_INFINITY, f64::INFINITY); 3]).map_err(Failure::wrong)
}

struct BoardLaw<'a, M: Mechanism<f32, N>, const N: usize> {
    controller: Controller<f32, M, BoardMath, N>,
    encoders: &'a [EncoderModel],
    last_torque: [f32; MAX_JOINTS],
}

impl<'a, M: Mechanism<f32, N>, const N: usize> BoardLaw<'a, M, N> {
    fn new(simulation: &'a WallSimulation, mechanism: M, scene: &Scene<f32>) -> Result<Self, Failure> {
        let controller = Controller::new(mechanism, &simulation.board, scene).map_err(Failure::wrong)?;
        Ok(Self { controller, encoders: &simulation.encoders, last_torque: [0.0; MAX_JOINTS] })
    }

    fn counts(&self, q: &[f64; MAX_JOINTS]) -> [i32; N] {
        core::array::from_fn(|i| self.encoders[i].counts(q[i]))
    }
}

impl<M: Mechanism<f32, N>, const N: usize> Law for BoardLaw<'_, M, N> {
    fn evaluate(&mut self, measured: &[f64; MAX_JOINTS]) -> LawOutput {
        let step = self.controller.step_with_torque(&self.last_torque, &self.counts(measured));
        self.last_torque = core::array::from_fn(|i| if i < N { step.torque[i] } else { 0.0 });
        LawOutput { force: f64::from(step.wall_force), torque: self.last_torque.map(f64::from) }
    }
}
