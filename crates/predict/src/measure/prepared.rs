//! A board prepared for a measurement: holds the tip, pulls it aside and follows its motion in the tested walls.

use super::earlier_settings::EarlierSettings;
use super::excitation::Excitation;
use super::swing::{Swing, Verdict};
use super::walls::{ASIDE_DISTANCE, LONGEST_PULL, Layout, complement, scene};
use super::{MeasureError, MeasurementSetup};
use haptic_bridge::board::telemetry::Field;
use haptic_bridge::control::{HostAction, Rules};
use haptic_bridge::model::units::JointUnits;
use haptic_bridge::render::controller::Gains;
use haptic_bridge::render::scene::FeedForward;
use haptic_bridge::safety::fault::{Fault, State};
use haptic_host::device_file::DeviceFile;
use haptic_host::link::{Board, columns, fields};
use haptic_stability::analysis::plant::Linearised;
use haptic_stability::analysis::pose::PoseError;
use haptic_stability::analysis::several::WallSet;
use nalgebra::{DMatrix, DVector};
use std::f64::consts::{PI, TAU};
use std::time::Duration;

/// Time after which the board turns the motors off if it no longer hears from this tool, s.
const HOST_SECONDS: f32 = 1.0;

/// Smallest and largest position at which the tip may come to rest, as shares of the pull.
const PULL_RANGE: (f64, f64) = (0.9, 1.15);
const MAX_CORRECTIONS: usize = 16;

/// Largest distance to which friction may hold the tip off, m. Beyond this distance the hold is made firmer.
const FRICTION_OFFSET: f64 = 5e-4;

/// Angular frequency of a soft hold per control rate, rad/s per Hz.
const SOFT_HOLD: f64 = 0.05;
/// Largest angular frequency of a hold per control rate, rad/s per Hz: half the frequency of the paper's stiffest wall.
const FIRM_HOLD: f64 = 0.2;

/// Largest deviation of a joint from its first angle that friction causes, in addition to the tip's motion, rad (of a
/// slide times its lever).
/// Another pose with the same tip position is farther away unless it is nearly singular.
const SAME_POSE_RAD: f64 = 0.03;
/// Singular value of a Jacobian below which the value counts as zero, m.
const ZERO_SINGULAR_VALUE: f64 = 1e-9;
/// Factor on joint deviations that the Jacobian predicts, because the tip may be [`LEFT_POSE_DISTANCE`] away.
const JACOBIAN_FACTOR: f64 = 1.5;
/// Tip motion after which the tip counts as swinging, m.
const SWING_START: f64 = 2e-5;
/// Tip motion along the walls after which the device has left its pose, m. In a long pull the tip slides by up to four
/// times the pull if friction brakes the joints unevenly.
const LEFT_POSE_DISTANCE: f64 = 0.03;
const MAX_RETRIES: usize = 2;
/// Time in which the user of a simulated device brings the device back to its pose, s.
const CARRY_SECONDS: f64 = 3.0;

/// Largest distance to which the tip is held aside, as a share of [`ASIDE_DISTANCE`].
const MAX_ASIDE_SHARE: f64 = 0.9;

/// Factor on the frequency of the hold if the tip does not come to rest.
const SOFTEN_FACTOR: f64 = 0.5;
/// Maximum number of reductions of the frequency of the hold, down to a 32nd.
const MAX_SOFTENINGS: usize = 5;

/// A board prepared for a measurement. The board turns the motors off if the tool is killed or unplugged. Dropping this
/// value disarms the board and restores its earlier settings.
pub struct PreparedBoard<'a> {
    board: &'a mut Board,
    setup: MeasurementSetup,
    interrupted: &'a dyn Fn() -> bool,
    q: Vec<f64>,
    units: Vec<&'static JointUnits>,
    tip: DVector<f64>,
    /// Unit vector along the pulls, d entries; for one wall its normal.
    direction: DVector<f64>,
    layout: Layout,
    /// Share of each tested wall in the gains, and true if the wall has the feed-forward.
    shares: Vec<(f64, bool)>,
    /// Force along the pull per newton of total stiffness times pull; 1 for one wall.
    force_ratio: f64,
    /// Effective inertia along the pull, then along each direction across the pull, kg.
    inertia: Vec<f64>,
    /// Largest effective inertia at the tested walls, kg.
    heaviest: f64,
    /// Natural angular frequency of the hold, rad/s.
    hold_frequency: f64,
    softenings: usize,
    /// Joint motion per tip motion along each axis, N x d, rad/m.
    joint_per_tip_motion: DMatrix<f64>,
    excitation: Excitation,
    divider: u32,
    /// Columns of the tip's position in a telemetry row.
    tip_columns: Vec<usize>,
    state_column: usize,
    before: EarlierSettings,
}

impl<'a> PreparedBoard<'a> {
    /// Loads the scene at the tip's position, limits the torque, arms the board and waits until the tip rests.
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
        let direction = set.middle_of_stiffest_directions().ok_or(PoseError::NoDirection)?;
        let across = complement(&direction);
        let total: f64 = setup.walls.iter().map(|wall| wall.share).sum();
        let shares = setup.walls.iter().map(|wall| (wall.share / total, wall.feed_forward)).collect();

        // Keeps the natural frequency of the hold well below the filter and the rate.
        let at_most = |share: f64| (share * setup.rate_hz).min(0.3 * TAU * setup.tempo_hz());
        let mut hold_frequency = at_most(SOFT_HOLD);
        let mut inertia = Vec::new();
        for direction in std::iter::once(&direction).chain(&across) {
            let seen = Linearised::at(&file.description, &q, direction.as_slice())?;
            inertia.push(seen.w_eff().unwrap_or_else(|| seen.w_rr()));
        }
        let heaviest = [false, true]
            .into_iter()
            .filter_map(|feed_forward| set.effective_inertia(feed_forward))
            .fold(0.0, f64::max);

        let before = EarlierSettings::of(board)?;
        let rules = rules_for(before.rules(), setup.torque_limit);
        let device = Linearised::at(&file.description, &q, direction.as_slice())?;
        let torques = [false, true].map(|feed_forward| set.torque(&direction, feed_forward));
        let mut excitation = Excitation::new(file, &device, &torques, &rules, setup.largest_pull);
        let offset = excitation.friction / gains_of(inertia[0], hold_frequency).0;
        if offset > FRICTION_OFFSET {
            let firmer = hold_frequency * (offset / FRICTION_OFFSET).sqrt();
            hold_frequency = firmer.min(at_most(FIRM_HOLD)).max(hold_frequency);
        }
        if setup.law.may_lengthen_pull {
            excitation.longest_pull = excitation.longest_pull.max(offset).min(LONGEST_PULL);
        }
        // Leaves the board unchanged if not even the soft hold can be measured.
        excitation.pull(gains_of(inertia[0], hold_frequency).0, "the hold for this rate, cutoff and inertia")?;

        let units = file.description.units().to_vec();
        let request = fields("tip,state").map_err(MeasureError::Scene)?;
        let columns = columns(request, &units, 0);
        let column = |field, axis| columns.iter().position(|column| (column.field, column.axis) == (field, axis));
        let tip_columns = (0..spec.task).filter_map(|axis| column(Field::Tip, axis)).collect();
        let state_column = column(Field::State, 0).unwrap_or_default();

        let (layout, wanted) = scene(&setup, &q, &tip, &direction, &across)?;
        // From here on, dropping `prepared` restores the board.
        let mut prepared = Self {
            board,
            interrupted,
            q,
            units,
            tip,
            force_ratio: set.force(&direction).dot(&direction),
            direction,
            layout,
            shares,
            inertia,
            heaviest,
            hold_frequency,
            softenings: 0,
            joint_per_tip_motion: device
                .flexible
                .tip
                .pseudo_inverse(ZERO_SINGULAR_VALUE)
                .map_err(|why| MeasureError::Scene(why.into()))?
                .abs(),
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
        prepared.wait_for_rest()?;
        Ok(prepared)
    }

    fn wait_for_rest(&mut self) -> Result<(), MeasureError> {
        loop {
            // The board raises torques over half a second after arming.
            match self.wait(0.6).and_then(|()| self.rest_at(0.0)) {
                Err(MeasureError::Fault(fault)) if is_caused_by_oscillation(fault) && self.soften() => {
                    self.hold(0.0)?;
                    self.arm_again()?;
                }
                other => return other.and_then(|_| self.check_pose(ASIDE_DISTANCE)),
            }
        }
    }

    /// Returns an error if a joint moved farther than a tip motion of `apart` (m) along each axis explains.
    fn check_pose(&mut self, apart: f64) -> Result<(), MeasureError> {
        let now = self.board.status()?;
        let off = DVector::from_fn(self.tip.len(), |i, _| (f64::from(now.tip[i]) - self.tip[i]).abs().min(apart));
        for (joint, (began, turned)) in self.q.iter().zip(&(&self.joint_per_tip_motion * off)).enumerate() {
            let (by, units) = (f64::from(now.q[joint]) - began, self.units[joint]);
            if by.abs() > SAME_POSE_RAD * f64::from(units.lever) + JACOBIAN_FACTOR * turned {
                return Err(MeasureError::Away { joint, by, unit: units.travel });
            }
        }
        Ok(())
    }

    /// Lowers the frequency of the hold, or returns false if the frequency is the lowest.
    fn soften(&mut self) -> bool {
        if self.softenings == MAX_SOFTENINGS {
            return false;
        }
        self.softenings += 1;
        self.hold_frequency *= SOFTEN_FACTOR;
        true
    }

    /// Returns stiffness (N/m) and damping (N s/m) of the hold along the pull.
    fn hold_gains(&self) -> (f64, f64) {
        gains_of(self.inertia[0], self.hold_frequency)
    }

    /// Returns the board, for requests that do not disturb the measurement.
    pub fn board(&mut self) -> &mut Board {
        self.board
    }

    /// Returns the joint angles of the measurement, rad.
    pub fn pose(&self) -> &[f64] {
        &self.q
    }

    /// Returns the bounds of the pulls.
    pub fn excitation(&self) -> &Excitation {
        &self.excitation
    }

    /// Returns the stiffness of the soft hold, at which a search starts, N/m.
    pub fn soft_hold_stiffness(&self) -> f64 {
        self.hold_gains().0
    }

    /// Returns the damping of the soft hold, at which a search starts, N s/m.
    pub fn soft_hold_damping(&self) -> f64 {
        self.hold_gains().1
    }

    /// Returns true if walls with this total stiffness (N/m) and damping (N s/m) oscillate after a pull.
    pub fn oscillates(
        &mut self,
        feed_forward: FeedForward,
        kp: f64,
        kd: f64,
        strength: f64,
    ) -> Result<bool, MeasureError> {
        Ok(self.judge(feed_forward, kp, kd, strength)? != Verdict::Decays)
    }

    /// Judges the tip's motion in walls with these totals. `strength` is the signed factor on the pull.
    pub fn judge(
        &mut self,
        feed_forward: FeedForward,
        kp: f64,
        kd: f64,
        strength: f64,
    ) -> Result<Verdict, MeasureError> {
        let (damped, gentle) = (kd * self.hold_frequency, self.soft_hold_stiffness());
        let hardest = kp.max(damped).max(gentle);
        let of = match hardest {
            hardest if hardest == kp => "a tested wall",
            hardest if hardest == damped => "the damping of a wall at the frequency of its swing",
            _ => "the hold for this rate, cutoff and inertia",
        };
        let pull = self.excitation.pull(hardest, of)?;
        let pull = strength.signum() * (strength.abs() * pull).max(self.excitation.shortest_pull()).min(LONGEST_PULL);
        let (mut trips, mut left) = (0, 0);
        loop {
            match self.swing_from_rest(feed_forward, pull, kp > gentle) {
                // An earlier oscillation may have left the device in a pose in which it cannot be pulled.
                Err(error) if error.is_local() && left < MAX_RETRIES && self.check_pose(ASIDE_DISTANCE).is_err() => {
                    left += 1;
                    self.bring_back()?;
                    continue;
                }
                // A limit tripped because the device still oscillated. The motors have stopped it now.
                Err(MeasureError::Fault(fault)) if is_caused_by_oscillation(fault) && trips < 3 => {
                    trips += 1;
                    self.arm_again()?;
                    continue;
                }
                other => other?,
            }
            let verdict = self.follow_motion(feed_forward, kp, kd, pull);
            // Only a growing motion may leave the pose.
            let there = match &verdict {
                Ok(Verdict::Decays | Verdict::Vibrates(_)) => self.check_pose(LEFT_POSE_DISTANCE),
                _ => Ok(()),
            };
            // Returns to the hold at once after any verdict.
            self.hold(0.0)?;
            match (verdict, there) {
                (Ok(_), Err(MeasureError::Away { .. })) | (Err(MeasureError::Away { .. }), _) if left < MAX_RETRIES => {
                    left += 1;
                    self.bring_back()?;
                }
                (Ok(_), Err(error)) => return Err(error),
                // A limit tripped before the telemetry showed the oscillation.
                (Err(MeasureError::Fault(fault)), _) if is_caused_by_oscillation(fault) => {
                    self.arm_again()?;
                    return Ok(Verdict::Grows);
                }
                (verdict, Ok(())) => return verdict,
                (Err(error), _) => return Err(error),
            }
        }
    }

    /// Pulls the tip aside by `pull` (m) and lets it swing back. Pulls harder if friction holds the tip.
    fn swing_from_rest(&mut self, feed_forward: FeedForward, pull: f64, stiffer: bool) -> Result<(), MeasureError> {
        let friction = self.excitation.friction / self.hold_gains().0;
        let mut aim = pull + friction * pull.signum();
        let enough = (PULL_RANGE.0 * pull.abs()).min(pull.abs() - 2.0 * self.excitation.quantum);
        for _ in 0..MAX_CORRECTIONS {
            let rested =
                self.rest_at(aim.clamp(-MAX_ASIDE_SHARE * ASIDE_DISTANCE, MAX_ASIDE_SHARE * ASIDE_DISTANCE))?;
            let along = rested * pull.signum();
            if along >= enough && along <= PULL_RANGE.1 * pull.abs() + 2.0 * self.excitation.quantum {
                self.check_pose(ASIDE_DISTANCE)?;
                return self.swing_back(feed_forward, pull, rested, stiffer);
            }
            aim += pull - rested;
        }
        Err(self.friction_error(pull))
    }

    /// Brings the device back to its pose with the hold, or by the user of a simulated device.
    fn bring_back(&mut self) -> Result<(), MeasureError> {
        if self.rest_at(0.0).and_then(|_| self.check_pose(ASIDE_DISTANCE)).is_ok() {
            return Ok(());
        }
        if self.board.details()?.real {
            return Err(MeasureError::Moved);
        }
        self.board.disarm()?;
        self.arm()?;
        self.wait_for_rest()
    }

    fn friction_error(&self, pull: f64) -> MeasureError {
        let (pull, friction) = (pull.abs(), self.excitation.friction);
        MeasureError::Stuck { pull, force: pull * self.hold_gains().0, friction }
    }

    /// Clears the fault of an oscillation and arms with the soft hold, unless another program cleared it.
    fn arm_again(&mut self) -> Result<(), MeasureError> {
        if self.board.status()?.state != State::Fault {
            return Err(MeasureError::Disarmed);
        }
        self.board.clear()?;
        self.arm()?;
        self.wait(0.4)
    }

    /// Arms the board. The user of a simulated device first brings the device back.
    fn arm(&mut self) -> Result<(), MeasureError> {
        if !self.board.details()?.real {
            self.wait_in_any_state(CARRY_SECONDS)?;
        }
        self.board.arm()?;
        // Rows on their way may still have the state of a fault or of disarmed motors.
        self.wait_in_any_state(0.3)
    }

    fn wait_in_any_state(&mut self, seconds: f64) -> Result<(), MeasureError> {
        let until = self.board.now() + Duration::from_secs_f64(seconds);
        while self.board.now() < until {
            self.board.rows(Duration::from_millis(20))?;
        }
        Ok(())
    }

    /// Turns the motors off and restores the board.
    pub fn finish(self) -> Result<(), MeasureError> {
        self.board.stop_stream()?;
        self.board.disarm()?;
        Ok(())
    }

    fn set_wall_gains(&mut self, wall: u8, kp: f64, kd: f64, feed_forward: FeedForward) -> Result<(), MeasureError> {
        let gains = Gains {
            wall,
            stiffness: kp as f32,
            damping: kd as f32,
            feed_forward,
            washout_hz: self.setup.washout_hz as f32,
        };
        Ok(self.board.set_wall_gains(gains)?)
    }

    /// Sets the gains of the tested walls to their shares of these totals.
    fn set_tested_gains(&mut self, kp: f64, kd: f64, feed_forward: FeedForward) -> Result<(), MeasureError> {
        for (wall, (share, with)) in self.shares.clone().into_iter().enumerate() {
            let feed_forward = if with { feed_forward } else { FeedForward::Off };
            self.set_wall_gains(wall as u8, kp * share, kd * share, feed_forward)?;
        }
        Ok(())
    }

    /// Holds the tip at `pull` (m) along the pull: the wall at the tip's position and a wall aside share the stiffness.
    fn hold(&mut self, pull: f64) -> Result<(), MeasureError> {
        let (kp, kd) = self.hold_gains();
        let share = (pull / ASIDE_DISTANCE).clamp(-MAX_ASIDE_SHARE, MAX_ASIDE_SHARE);
        let Layout { hold, aside, across } = self.layout;
        self.set_wall_gains(hold, kp * (1.0 - share.abs()), kd, FeedForward::Off)?;
        if hold > 0 {
            self.set_tested_gains(0.0, 0.0, FeedForward::Off)?;
        }
        // Only one of the walls at +ASIDE_DISTANCE and -ASIDE_DISTANCE is used, by the sign of the pull.
        let [used, unused] = if pull >= 0.0 { aside } else { [aside[1], aside[0]] };
        self.set_wall_gains(unused, 0.0, 0.0, FeedForward::Off)?;
        self.set_wall_gains(used, kp * share.abs(), 0.0, FeedForward::Off)?;
        for (index, inertia) in self.inertia.clone().into_iter().skip(1).enumerate() {
            let (kp, kd) = gains_of(inertia, self.hold_frequency);
            self.set_wall_gains(across + index as u8, kp, kd, FeedForward::Off)?;
        }
        Ok(())
    }

    /// Sets the gains of the holding walls to 0.
    fn release(&mut self) -> Result<(), MeasureError> {
        let Layout { hold, aside, across } = self.layout;
        for wall in aside {
            self.set_wall_gains(wall, 0.0, 0.0, FeedForward::Off)?;
        }
        for index in 0..self.inertia.len() - 1 {
            self.set_wall_gains(across + index as u8, 0.0, 0.0, FeedForward::Off)?;
        }
        if hold > 0 {
            self.set_wall_gains(hold, 0.0, 0.0, FeedForward::Off)?;
        }
        Ok(())
    }

    /// Waits until the tip rests near `pull`, and softens the hold if needed. Returns the tip's position, m.
    fn rest_at(&mut self, pull: f64) -> Result<f64, MeasureError> {
        loop {
            match self.hold_until_still(pull) {
                Err(MeasureError::Restless) if self.soften() => {}
                other => return other,
            }
        }
    }

    /// Holds the tip near `pull` (m) until the tip rests in all directions. Returns its position along the pull, m.
    fn hold_until_still(&mut self, pull: f64) -> Result<f64, MeasureError> {
        self.hold(pull)?;
        let period = TAU / self.hold_frequency;
        // A motion within the encoder steps counts as rest.
        let steps = self.excitation.shortest_pull();
        let tolerance = steps.max(0.1 * pull.abs()).max(self.setup.largest_pull * 1e-3);
        let mut quiet = Vec::new();
        let started = self.board.now();
        // Friction may hold the tip away from its target, so accept rest at any position.
        while (self.board.now() - started).as_secs_f64() < (60.0 * period).max(0.5) {
            for at in self.tip_positions(period / 4.0)? {
                quiet.push(at);
            }
            let window = self.samples_in(0.5 * period);
            if quiet.len() > 4 * window {
                let recent = &quiet[quiet.len() - window..];
                let (low, high) = span(recent.iter().map(|at| at.place));
                let (near, far) = span(recent.iter().map(|at| at.aside));
                // A tip that slides across the pull would also slide in the trial.
                if high - low <= tolerance && far - near <= tolerance {
                    return Ok((high + low) / 2.0);
                }
            }
        }
        Err(MeasureError::Restless)
    }

    /// Pulls the tip back with the tested walls as softly as the hold, and returns as soon as the tip moves. Returns an
    /// error if friction stops the tip, because its motion then cannot be judged.
    ///
    /// The tested feed-forward already acts, because otherwise the pull would start admissible motions.
    fn swing_back(
        &mut self,
        feed_forward: FeedForward,
        pull: f64,
        rested: f64,
        stiffer: bool,
    ) -> Result<(), MeasureError> {
        let (kp, _) = self.hold_gains();
        self.release()?;
        self.set_tested_gains(kp / self.force_ratio, 0.0, feed_forward)?;
        let started = self.board.now();
        let quarter = 0.5 * PI / self.hold_frequency;
        // Friction takes much of the soft pull's force, so a stiffer wall takes over almost at once and pulls the tip.
        let aim = if stiffer && self.excitation.friction > 0.0 {
            rested - SWING_START.min(0.1 * pull.abs()).copysign(pull)
        } else {
            0.5 * rested
        };
        // Without friction the tip is half way after two thirds of a quarter period.
        while (self.board.now() - started).as_secs_f64() < 2.0 * quarter {
            let latest = self.tip_positions(quarter / 8.0)?;
            if latest.iter().any(|at| (at.place - aim) * pull.signum() < 0.0) {
                return Ok(());
            }
        }
        // A fast swing may be over before its rows arrive. Friction this small does not hold the tip.
        if self.excitation.friction < 0.05 * kp * rested.abs() { Ok(()) } else { Err(self.friction_error(pull)) }
    }

    /// Switches to the tested gains while the tip moves, and follows the motion until its verdict.
    fn follow_motion(
        &mut self,
        feed_forward: FeedForward,
        kp: f64,
        kd: f64,
        pull: f64,
    ) -> Result<Verdict, MeasureError> {
        self.set_tested_gains(kp, kd, feed_forward)?;
        let row_seconds = f64::from(self.divider) / self.setup.rate_hz;
        let slowest = (TAU * (self.heaviest / kp).sqrt(), kd < 2.0 * (kp * self.heaviest).sqrt());
        let mut swing = Swing::new(row_seconds, self.setup.tempo_hz(), slowest, self.excitation.quantum, pull.abs());
        let first = self.board.status()?.step;
        loop {
            for at in self.tip_positions(0.02)? {
                // Rows from before the switch may arrive late.
                if at.step.wrapping_sub(first) > u32::MAX / 2 {
                    continue;
                }
                if let Some(verdict) = swing.add_position(at.place) {
                    return Ok(verdict);
                }
                if at.aside > LEFT_POSE_DISTANCE {
                    let lost = self.check_pose(ASIDE_DISTANCE).err().unwrap_or(MeasureError::Restless);
                    return if swing.still_swings() { Ok(Verdict::Grows) } else { Err(lost) };
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
            self.tip_positions(0.05)?;
        }
        Ok(())
    }

    /// Returns the tip positions in the rows that have arrived. Waits at most `seconds` for the first row.
    fn tip_positions(&mut self, seconds: f64) -> Result<Vec<TipPosition>, MeasureError> {
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
                // A fault without a record means that numbers in the row were not finite.
                let fault = self.board.status()?.fault.map_or(Fault::NotFinite, |record| record.fault);
                return Err(MeasureError::Fault(fault));
            }
            let off = DVector::from_fn(self.tip.len(), |i, _| row.values[self.tip_columns[i]] - self.tip[i]);
            let place = off.dot(&self.direction);
            places.push(TipPosition { step: row.step, place, aside: (off - &self.direction * place).norm() });
        }
        Ok(places)
    }
}

/// Returns the rules of a measurement: motors go off without the tool, torques are at most `torque_limit` (N m).
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
        // If the board does not reply, the rules of the measurement turn the motors off.
        let _ = self.board.stop_stream();
        let _ = self.before.restore(self.board);
    }
}

/// Tip position at a control step: position along the pull, and distance across it, m.
struct TipPosition {
    step: u32,
    place: f64,
    aside: f64,
}

/// Returns stiffness and damping for an inertia (kg), a natural frequency (rad/s) and a damping ratio of 0.7.
fn gains_of(inertia: f64, frequency: f64) -> (f64, f64) {
    (inertia * frequency.powi(2), 1.4 * inertia * frequency)
}

fn span(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)))
}

/// Returns true for faults that an oscillation causes and that can be cleared afterwards.
fn is_caused_by_oscillation(fault: Fault) -> bool {
    matches!(fault, Fault::SpeedLimit | Fault::OverCurrent | Fault::PowerLimit | Fault::ForceLimit)
}
