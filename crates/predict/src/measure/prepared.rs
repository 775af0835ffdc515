//! A board made ready to measure: how the tip is held, pulled aside, handed over to the tested wall and followed.

use std::f64::consts::{PI, TAU};
use std::time::Duration;

use haptic_bridge::board::telemetry::Field;
use haptic_bridge::control::{HostAction, Rules};
use haptic_bridge::render::controller::Gains;
use haptic_bridge::render::scene::FeedForward;
use haptic_bridge::safety::fault::{Fault, State};
use nalgebra::{DMatrix, DVector};

use super::before::Before;
use super::excitation::Excitation;
use super::swing::{Swing, Verdict};
use super::walls::{APART, LONGEST_PULL, Layout, complement, scene};
use super::{MeasureError, MeasurementSetup};
use haptic_host::device_file::DeviceFile;
use haptic_host::link::{Board, columns, fields};
use haptic_stability::analysis::plant::Linearised;
use haptic_stability::analysis::pose::PoseError;
use haptic_stability::analysis::several::WallSet;

/// Time for which the board goes on without this tool, s: a measurement must not outlive the user who watches it.
const HOST_SECONDS: f32 = 1.0;

/// Least and largest share of a pull at which the tip may rest, and how often it is pulled harder or less until it does.
const PULLED: (f64, f64) = (0.9, 1.15);
const HARDER: usize = 16;

/// Distance by which friction may hold the tip off its place, m: the hold is firmer where it holds it farther off.
const OFF_ITS_PLACE: f64 = 5e-4;

/// Share of the rate, rad/s for each Hz, at which the tip is held; and the most where friction asks for it: half of the
/// 0.4 at which the stiffest wall of the paper's setting swings.
const SOFT: f64 = 0.05;
const FIRM: f64 = 0.2;

/// Angle by which a joint may differ from where the measurement began, beside what the tip's place explains, rad:
/// friction holds joints off their places. Another pose with the same tip is farther away, unless that pose is nearly
/// singular.
const SAME_POSE: f64 = 0.03;
/// Singular values of a Jacobian below this are none, m.
const SINGULAR: f64 = 1e-9;
/// Times as far as a Jacobian says a joint may turn until the tip is [`ASIDE`].
const BENT: f64 = 1.5;
/// A tip that has moved so far is on its way, m.
const EDGE: f64 = 2e-5;
/// A tip that slides this far along the walls has left its pose, m: a long pull's slides by up to four times the pull
/// where friction brakes the joints unevenly.
const ASIDE: f64 = 0.03;
/// Number of times that a trial is repeated which the device left its pose in.
const AGAIN: usize = 2;
/// Time in which the user of a simulated device carries it back, s.
const CARRIED: f64 = 3.0;

/// The most that the tip can be held aside, in [`APART`].
const HOLDS: f64 = 0.9;

/// Factor by which the tip is held more softly where it does not come to rest, and the number of times that this is
/// tried: down to a 32nd of the hold's frequency.
const SOFTER: f64 = 0.5;
const SOFTEST: usize = 5;

/// A board made ready to measure. While it measures, a tool that is killed or unplugged takes the motors with it; when
/// dropped it disarms the board and puts back what was loaded before.
pub struct PreparedBoard<'a> {
    board: &'a mut Board,
    setup: MeasurementSetup,
    interrupted: &'a dyn Fn() -> bool,
    q: Vec<f64>,
    tip: DVector<f64>,
    /// Unit direction of the pulls, d entries: the normal of one wall.
    direction: DVector<f64>,
    layout: Layout,
    /// Each tested wall's part of the whole, and whether it has the feed-forward.
    shares: Vec<(f64, bool)>,
    /// Force along the pull for each newton of the whole stiffness times the pull: 1 for one wall.
    along: f64,
    /// Inertia that the hold meets along each of them, kg.
    inertia: Vec<f64>,
    /// The largest inertia that the tested walls meet, kg.
    heaviest: f64,
    /// Natural frequency of the hold, rad/s, and how often it was lowered.
    hold_frequency: f64,
    softened: usize,
    /// The angle by which each joint turns for each metre of the tip along each axis, N x d, rad/m.
    turns: DMatrix<f64>,
    excitation: Excitation,
    divider: u32,
    /// Columns of a row that hold the tip, and the one that holds the state.
    tip_columns: Vec<usize>,
    state_column: usize,
    before: Before,
}

impl<'a> PreparedBoard<'a> {
    /// Loads the scene at the present tip, limits the torque, arms and waits until the tip rests.
    pub fn new(
        board: &'a mut Board,
        file: &DeviceFile,
        setup: MeasurementSetup,
        interrupted: &'a dyn Fn() -> bool,
    ) -> Result<Self, MeasureError> {
        let spec = file.spec();
        let status = board.status()?;
        let q: Vec<f64> = status.q[..spec.joints].iter().map(|&v| f64::from(v)).collect();
        let tip = DVector::from_fn(spec.task, |i, _| f64::from(status.tip[i]));
        let set = WallSet::at(&file.description, &q, &setup.walls, setup.law.admissible)?;
        let direction = set.between_stiffest().ok_or(PoseError::NoDirection)?;
        let across = complement(&direction);
        let total: f64 = setup.walls.iter().map(|wall| wall.share).sum();
        let shares = setup.walls.iter().map(|wall| (wall.share / total, wall.feed_forward)).collect();

        // The hold: natural frequency well below filter and rate.
        let at_most = |share: f64| (share * setup.rate_hz).min(0.3 * TAU * setup.tempo_hz());
        let mut hold_frequency = at_most(SOFT);
        let mut inertia = Vec::new();
        for direction in std::iter::once(&direction).chain(&across) {
            let seen = Linearised::at(&file.description, &q, direction.as_slice())?;
            inertia.push(seen.w_eff().unwrap_or_else(|| seen.w_rr()));
        }
        let heaviest = [false, true].into_iter().filter_map(|feed_forward| set.met(feed_forward)).fold(0.0, f64::max);

        let before = Before::of(board)?;
        let rules = rules_for(before.rules(), setup.torque_limit);
        let device = Linearised::at(&file.description, &q, direction.as_slice())?;
        let torques = [false, true].map(|feed_forward| set.torque(&direction, feed_forward));
        let mut excitation = Excitation::new(file, &device, &torques, &rules, setup.largest_pull);
        let off_its_place = excitation.friction / gains_of(inertia[0], hold_frequency).0;
        if off_its_place > OFF_ITS_PLACE {
            let firmer = hold_frequency * (off_its_place / OFF_ITS_PLACE).sqrt();
            hold_frequency = firmer.min(at_most(FIRM)).max(hold_frequency);
        }
        if setup.law.farther {
            excitation.largest = excitation.largest.max(off_its_place).min(LONGEST_PULL);
        }
        // Not even the soft hold could be told from a loose tip: nothing is touched then.
        excitation.pull(gains_of(inertia[0], hold_frequency).0, "the hold that rate, cutoff and inertia ask for")?;

        let request = fields("tip,state").map_err(MeasureError::Scene)?;
        let columns = columns(request, spec.joints);
        let column = |field, axis| columns.iter().position(|column| (column.field, column.axis) == (field, axis));
        let tip_columns = (0..spec.task).filter_map(|axis| column(Field::Tip, axis)).collect();
        let state_column = column(Field::State, 0).unwrap_or_default();

        let (layout, wanted) = scene(&setup, &q, &tip, &direction, &across)?;
        // From here on the board is put back as it was whenever this is dropped.
        let mut prepared = Self {
            board,
            interrupted,
            q,
            tip,
            along: set.force(&direction).dot(&direction),
            direction,
            layout,
            shares,
            inertia,
            heaviest,
            hold_frequency,
            softened: 0,
            turns: device.flexible.tip.pseudo_inverse(SINGULAR).map_err(|why| MeasureError::Scene(why.into()))?.abs(),
            excitation,
            divider: (setup.rate_hz / 10_000.0).ceil().max(1.0) as u32,
            setup,
            tip_columns,
            state_column,
            before,
        };
        prepared.board.set_rules(&rules)?;
        prepared.board.set_scene(&wanted)?;
        prepared.board.keep_alive();
        prepared.hold(0.0)?;
        prepared.board.arm()?;
        prepared.board.start_stream(request, prepared.divider)?;
        prepared.settle()?;
        Ok(prepared)
    }

    /// Waits until the armed tip rests where it stands.
    fn settle(&mut self) -> Result<(), MeasureError> {
        loop {
            // Torque ramps up over half a second after arming.
            match self.wait(0.6).and_then(|()| self.rest(0.0)) {
                Err(MeasureError::Fault(fault)) if violent(fault) && self.soften() => {
                    self.hold(0.0)?;
                    self.arm_again()?;
                }
                other => return other.and_then(|_| self.check_pose(APART)),
            }
        }
    }

    /// Refuses a device whose joints are not where the measurement began, nor where a tip turns them that is at most
    /// `apart` (m) off its place along each axis.
    fn check_pose(&mut self, apart: f64) -> Result<(), MeasureError> {
        let now = self.board.status()?;
        let off = DVector::from_fn(self.tip.len(), |i, _| (f64::from(now.tip[i]) - self.tip[i]).abs().min(apart));
        for (joint, (began, turned)) in self.q.iter().zip(&(&self.turns * off)).enumerate() {
            let by = f64::from(now.q[joint]) - began;
            if by.abs() > SAME_POSE + BENT * turned {
                return Err(MeasureError::Away { joint, by });
            }
        }
        Ok(())
    }

    /// Holds more softly from here on; false where that was tried often enough.
    fn soften(&mut self) -> bool {
        if self.softened == SOFTEST {
            return false;
        }
        self.softened += 1;
        self.hold_frequency *= SOFTER;
        true
    }

    /// Stiffness and damping that hold the tip along the pull, N/m and N s/m.
    fn holding(&self) -> (f64, f64) {
        gains_of(self.inertia[0], self.hold_frequency)
    }

    /// The board, for what does not disturb the measurement.
    pub fn board(&mut self) -> &mut Board {
        self.board
    }

    /// Joint angles where the measurement takes place, rad.
    pub fn pose(&self) -> &[f64] {
        &self.q
    }

    /// The bounds of the pulls here.
    pub fn excitation(&self) -> &Excitation {
        &self.excitation
    }

    /// The stiffness at which a search begins: the soft hold's own, N/m.
    pub fn gentle_stiffness(&self) -> f64 {
        self.holding().0
    }

    /// The damping at which a search begins, N s/m.
    pub fn gentle_damping(&self) -> f64 {
        self.holding().1
    }

    /// Returns true if walls of this stiffness and damping in all oscillate. `strength` scales and signs the excitation
    /// (1 or a little less).
    pub fn oscillates(
        &mut self,
        feed_forward: FeedForward,
        kp: f64,
        kd: f64,
        strength: f64,
    ) -> Result<bool, MeasureError> {
        Ok(self.judge(feed_forward, kp, kd, strength)? != Verdict::Decays)
    }

    /// Judges the tip's motion against walls of this stiffness (N/m) and damping (N s/m) in all. `strength` scales and
    /// signs the excitation (1 or a little less).
    pub fn judge(
        &mut self,
        feed_forward: FeedForward,
        kp: f64,
        kd: f64,
        strength: f64,
    ) -> Result<Verdict, MeasureError> {
        let (damped, gentle) = (kd * self.hold_frequency, self.gentle_stiffness());
        let hardest = kp.max(damped).max(gentle);
        let of = match hardest {
            hardest if hardest == kp => "a wall that is tried",
            hardest if hardest == damped => "what a wall's damping makes of its swing",
            _ => "the hold that rate, cutoff and inertia ask for",
        };
        let pull = self.excitation.pull(hardest, of)?;
        let pull = strength.signum() * (strength.abs() * pull).max(self.excitation.smallest()).min(LONGEST_PULL);
        let (mut trips, mut left) = (0, 0);
        loop {
            match self.swing_from_rest(feed_forward, pull, kp > gentle) {
                // An oscillation before may have left it in another pose, which may be one that cannot be pulled.
                Err(error) if error.is_local() && left < AGAIN && self.check_pose(APART).is_err() => {
                    left += 1;
                    self.bring_back()?;
                    continue;
                }
                // The device was still ringing from the oscillation before, and that tripped the guard. It has stopped
                // by now.
                Err(MeasureError::Fault(fault)) if violent(fault) && trips < 3 => {
                    trips += 1;
                    self.arm_again()?;
                    continue;
                }
                other => other?,
            }
            let verdict = self.watch(feed_forward, kp, kd, pull);
            // A motion that grew has left the pose by growing; any other was that of the pose, or of none.
            let there = match &verdict {
                Ok(Verdict::Decays | Verdict::Vibrates(_)) => self.check_pose(ASIDE),
                _ => Ok(()),
            };
            // Back off at once, whatever came out.
            self.hold(0.0)?;
            match (verdict, there) {
                (Ok(_), Err(MeasureError::Away { .. })) | (Err(MeasureError::Away { .. }), _) if left < AGAIN => {
                    left += 1;
                    self.bring_back()?;
                }
                (Ok(_), Err(error)) => return Err(error),
                // The guard was quicker than the telemetry: an oscillation that violent is one.
                (Err(MeasureError::Fault(fault)), _) if violent(fault) => {
                    self.arm_again()?;
                    return Ok(Verdict::Grows);
                }
                (verdict, Ok(())) => return verdict,
                (Err(error), _) => return Err(error),
            }
        }
    }

    /// Pulls the tip aside by `pull` and lets it swing back. Where friction keeps it from coming along, it is pulled
    /// harder: a pull that went half as far would find another boundary.
    fn swing_from_rest(&mut self, feed_forward: FeedForward, pull: f64, stiffer: bool) -> Result<(), MeasureError> {
        let friction = self.excitation.friction / self.holding().0;
        let mut aim = pull + friction * pull.signum();
        let enough = (PULLED.0 * pull.abs()).min(pull.abs() - 2.0 * self.excitation.quantum);
        for _ in 0..HARDER {
            let rested = self.rest(aim.clamp(-HOLDS * APART, HOLDS * APART))?;
            let along = rested * pull.signum();
            if along >= enough && along <= PULLED.1 * pull.abs() + 2.0 * self.excitation.quantum {
                self.check_pose(APART)?;
                return self.swing_back(feed_forward, pull, rested, stiffer);
            }
            aim += pull - rested;
        }
        Err(self.stuck(pull))
    }

    /// Brings the device back to its pose: by the hold or, where that only brings back the tip, by the user of a
    /// simulated device. The user of a real one is asked to.
    fn bring_back(&mut self) -> Result<(), MeasureError> {
        if self.rest(0.0).and_then(|_| self.check_pose(APART)).is_ok() {
            return Ok(());
        }
        if self.board.details()?.real {
            return Err(MeasureError::Moved);
        }
        self.board.disarm()?;
        self.arm()?;
        self.settle()
    }

    fn stuck(&self, pull: f64) -> MeasureError {
        let (pull, friction) = (pull.abs(), self.excitation.friction);
        MeasureError::Stuck { pull, force: pull * self.holding().0, friction }
    }

    /// Clears the fault that a violent oscillation tripped, and arms with the soft hold; unless somebody else has
    /// cleared it.
    fn arm_again(&mut self) -> Result<(), MeasureError> {
        if self.board.status()?.state != State::Fault {
            return Err(MeasureError::Disarmed);
        }
        self.board.clear()?;
        self.arm()?;
        self.wait(0.4)
    }

    /// Arms once a simulated device is back in its pose.
    fn arm(&mut self) -> Result<(), MeasureError> {
        if !self.board.details()?.real {
            self.pass(CARRIED)?;
        }
        self.board.arm()?;
        // Rows from before still tell of a fault, or of motors that are off.
        self.pass(0.3)
    }

    /// Lets time pass (s), whatever the board's state.
    fn pass(&mut self, seconds: f64) -> Result<(), MeasureError> {
        let until = self.board.now() + Duration::from_secs_f64(seconds);
        while self.board.now() < until {
            self.board.rows(Duration::from_millis(20))?;
        }
        Ok(())
    }

    /// Motors off, and everything as it was before.
    pub fn finish(self) -> Result<(), MeasureError> {
        self.board.stop_stream()?;
        self.board.disarm()?;
        Ok(())
    }

    fn gains(&mut self, wall: u8, kp: f64, kd: f64, feed_forward: FeedForward) -> Result<(), MeasureError> {
        let gains = Gains {
            wall,
            stiffness: kp as f32,
            damping: kd as f32,
            feed_forward,
            washout_hz: self.setup.washout_hz as f32,
        };
        Ok(self.board.set_wall_gains(gains)?)
    }

    /// Gives the tested walls their parts of these gains.
    fn test(&mut self, kp: f64, kd: f64, feed_forward: FeedForward) -> Result<(), MeasureError> {
        for (wall, (share, with)) in self.shares.clone().into_iter().enumerate() {
            let feed_forward = if with { feed_forward } else { FeedForward::Off };
            self.gains(wall as u8, kp * share, kd * share, feed_forward)?;
        }
        Ok(())
    }

    /// Holds the tip `pull` metres along the pull's direction from where it was: the wall there and the one beside it
    /// share the stiffness.
    fn hold(&mut self, pull: f64) -> Result<(), MeasureError> {
        let (kp, kd) = self.holding();
        let share = (pull / APART).clamp(-HOLDS, HOLDS);
        let Layout { hold, aside, across } = self.layout;
        self.gains(hold, kp * (1.0 - share.abs()), kd, FeedForward::Off)?;
        if hold > 0 {
            self.test(0.0, 0.0, FeedForward::Off)?;
        }
        // The wall beside lies at +APART or -APART; only one is used, by the sign of the pull.
        let [used, unused] = if pull >= 0.0 { aside } else { [aside[1], aside[0]] };
        self.gains(unused, 0.0, 0.0, FeedForward::Off)?;
        self.gains(used, kp * share.abs(), 0.0, FeedForward::Off)?;
        for (index, inertia) in self.inertia.clone().into_iter().skip(1).enumerate() {
            let (kp, kd) = gains_of(inertia, self.hold_frequency);
            self.gains(across + index as u8, kp, kd, FeedForward::Off)?;
        }
        Ok(())
    }

    /// Lets go of everything but the tested walls.
    fn release(&mut self) -> Result<(), MeasureError> {
        let Layout { hold, aside, across } = self.layout;
        for wall in aside {
            self.gains(wall, 0.0, 0.0, FeedForward::Off)?;
        }
        for index in 0..self.inertia.len() - 1 {
            self.gains(across + index as u8, 0.0, 0.0, FeedForward::Off)?;
        }
        if hold > 0 {
            self.gains(hold, 0.0, 0.0, FeedForward::Off)?;
        }
        Ok(())
    }

    /// Waits until the tip rests near `pull`, held as softly as that takes; returns where it rests. How much damping a
    /// device's transmissions let a hold have need not be known beforehand.
    fn rest(&mut self, pull: f64) -> Result<f64, MeasureError> {
        loop {
            match self.held_still(pull) {
                Err(MeasureError::Restless) if self.soften() => {}
                other => return other,
            }
        }
    }

    /// Holds the tip near `pull` until it rests, along its direction and across it; returns where it rests.
    fn held_still(&mut self, pull: f64) -> Result<f64, MeasureError> {
        self.hold(pull)?;
        let period = TAU / self.hold_frequency;
        // A tip that only encoder steps keep moving is as much at rest as it will ever be.
        let steps = self.excitation.smallest();
        let tolerance = steps.max(0.1 * pull.abs()).max(self.setup.largest_pull * 1e-3);
        let mut quiet = Vec::new();
        let started = self.board.now();
        // Friction may hold the tip off its place: then it rests, but elsewhere.
        while (self.board.now() - started).as_secs_f64() < (60.0 * period).max(0.5) {
            for at in self.places(period / 4.0)? {
                quiet.push(at);
            }
            let window = self.samples_in(0.5 * period);
            if quiet.len() > 4 * window {
                let recent = &quiet[quiet.len() - window..];
                let (low, high) = span(recent.iter().map(|at| at.place));
                let (near, far) = span(recent.iter().map(|at| at.aside));
                // A tip that slides across would go on sliding when the trial lets go of it.
                if high - low <= tolerance && far - near <= tolerance {
                    return Ok((high + low) / 2.0);
                }
            }
        }
        Err(MeasureError::Restless)
    }

    /// Pulls back towards the tested walls, as softly as they were held, and returns when the tip is on its way. A tip
    /// that friction stops before is not swinging, and what it does then says nothing of a wall.
    ///
    /// With the feed-forward that is tested: without it the pull would set the admissible directions moving, and with
    /// it nothing would stop them again.
    fn swing_back(
        &mut self,
        feed_forward: FeedForward,
        pull: f64,
        rested: f64,
        stiffer: bool,
    ) -> Result<(), MeasureError> {
        let (kp, _) = self.holding();
        self.release()?;
        self.test(kp / self.along, 0.0, feed_forward)?;
        let started = self.board.now();
        let quarter = 0.5 * PI / self.hold_frequency;
        // Friction takes much of what the soft pull gives: a stiffer wall pulls by itself from where the tip was held.
        let aim = if stiffer && self.excitation.friction > 0.0 {
            rested - EDGE.min(0.1 * pull.abs()).copysign(pull)
        } else {
            0.5 * rested
        };
        // Without friction it is half way after two thirds of a quarter.
        while (self.board.now() - started).as_secs_f64() < 2.0 * quarter {
            let latest = self.places(quarter / 8.0)?;
            if latest.iter().any(|at| (at.place - aim) * pull.signum() < 0.0) {
                return Ok(());
            }
        }
        // A quick swing is over before its rows arrive: so little friction does not hold a tip.
        if self.excitation.friction < 0.05 * kp * rested.abs() { Ok(()) } else { Err(self.stuck(pull)) }
    }

    /// Hands the moving tip to the tested gains and follows it until the verdict.
    fn watch(&mut self, feed_forward: FeedForward, kp: f64, kd: f64, pull: f64) -> Result<Verdict, MeasureError> {
        self.test(kp, kd, feed_forward)?;
        let row_seconds = f64::from(self.divider) / self.setup.rate_hz;
        let slowest = (TAU * (self.heaviest / kp).sqrt(), kd < 2.0 * (kp * self.heaviest).sqrt());
        let mut swing = Swing::new(row_seconds, self.setup.tempo_hz(), slowest, self.excitation.quantum, pull.abs());
        let first = self.board.status()?.step;
        loop {
            for at in self.places(0.02)? {
                // Rows from before the hand-over were still on their way.
                if at.step.wrapping_sub(first) > u32::MAX / 2 {
                    continue;
                }
                if let Some(verdict) = swing.take(at.place) {
                    return Ok(verdict);
                }
                if at.aside > ASIDE {
                    let lost = self.check_pose(APART).err().unwrap_or(MeasureError::Restless);
                    return if swing.goes_on() { Ok(Verdict::Grows) } else { Err(lost) };
                }
            }
        }
    }

    fn samples_in(&self, seconds: f64) -> usize {
        (seconds * self.setup.rate_hz / f64::from(self.divider)).ceil().max(4.0) as usize
    }

    fn wait(&mut self, seconds: f64) -> Result<(), MeasureError> {
        let until = self.board.now() + Duration::from_secs_f64(seconds);
        while self.board.now() < until {
            self.places(0.05)?;
        }
        Ok(())
    }

    /// The positions of the tip, as far as rows have come, waiting at most `seconds` for the first.
    fn places(&mut self, seconds: f64) -> Result<Vec<Place>, MeasureError> {
        if (self.interrupted)() {
            return Err(MeasureError::Interrupted);
        }
        let rows = self.board.rows(Duration::from_secs_f64(seconds.clamp(1e-4, 0.1)))?;
        let mut places = Vec::with_capacity(rows.len());
        for row in rows {
            let state = row.values[self.state_column];
            if state == f64::from(State::Disarmed as u8) {
                return Err(MeasureError::Disarmed);
            }
            if state == f64::from(State::Fault as u8) {
                // The record names it; without one the numbers themselves were no good.
                let fault = self.board.status()?.fault.map_or(Fault::NotFinite, |record| record.fault);
                return Err(MeasureError::Fault(fault));
            }
            let off = DVector::from_fn(self.tip.len(), |i, _| row.values[self.tip_columns[i]] - self.tip[i]);
            let place = off.dot(&self.direction);
            places.push(Place { step: row.step, place, aside: (off - &self.direction * place).norm() });
        }
        Ok(places)
    }
}

/// The rules that a measurement sets on a board with these: motors off soon after its tool is gone, and at most
/// `torque_limit` N m.
#[must_use]
pub fn rules_for(before: &Rules, torque_limit: f64) -> Rules {
    let mut rules = *before;
    if rules.host_action != HostAction::Disarm || rules.host_seconds > HOST_SECONDS {
        (rules.host_action, rules.host_seconds) = (HostAction::Disarm, HOST_SECONDS);
    }
    for limit in &mut rules.limits.torque {
        *limit = limit.min(torque_limit as f32);
    }
    rules
}

impl Drop for PreparedBoard<'_> {
    fn drop(&mut self) {
        // The board may be gone; the rules set for the measurement then take the motors off.
        let _ = self.board.stop_stream();
        let _ = self.before.put_back(self.board);
    }
}

/// The position of the tip at a step: along the pull and how far beside it, m.
struct Place {
    step: u32,
    place: f64,
    aside: f64,
}

/// Stiffness and damping that hold an inertia (kg) at a natural frequency (rad/s) with 0.7 of critical damping.
fn gains_of(inertia: f64, frequency: f64) -> (f64, f64) {
    (inertia * frequency.powi(2), 1.4 * inertia * frequency)
}

/// Smallest and largest.
fn span(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)))
}

/// Faults that an oscillation trips and that pass with it.
fn violent(fault: Fault) -> bool {
    matches!(fault, Fault::SpeedLimit | Fault::OverCurrent | Fault::PowerLimit | Fault::ForceLimit)
}
