//! The checks at the carrier's valley, right after the drives of the preceding crest: the tip force of the measured
//! currents, and each motor against its device file. Heat, stalls and lost encoders build up over milliseconds at
//! least, so each valley checks them for one joint in turn.

use super::ControlLoop;
use crate::control::frame::{Outputs, Samples};
use crate::control::joints::{Counts, Torques};
use crate::control::program::Program;
use crate::drive::bits::margin_bits;
use crate::drive::stage::Stage;
use crate::math::{Math, Real, clamp, sqrt};
use crate::model::device::{Leverage, squared};
use crate::safety::fault::{Fault, State};
use crate::safety::limits::VOLTS_MARGIN;
use crate::safety::refusal::Refusal;
use core::ops::DerefMut;

/// Longest time of torque near its limit without encoder motion, s.
pub const STALL_SECONDS: f32 = 5.0;
/// Longest time that an encoder may stand still while the back-EMF shows a turning joint, s.
pub const LOSS_SECONDS: f32 = 0.05;

/// Sums of one joint for the checks of heat, stalls and lost encoders.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Sums {
    /// Encoder count when the joint was last checked.
    count: i32,
    /// Sum of the squared motor current since the last check, A².
    current_squares: f32,
    /// Time without a count in spite of torque, s.
    still_seconds: f32,
    /// Torque that moves any unblocked joint, N m.
    stall_torque: f32,
    /// Time without a count in spite of back-EMF, s.
    lost_seconds: f32,
    /// Speed by back-EMF above which counts must change, rad/s.
    suspicious_speed: f32,
}

impl Sums {
    /// Clears the times without a count; the heat is kept.
    pub(super) fn reset(&mut self) {
        (self.still_seconds, self.lost_seconds) = (0.0, 0.0);
    }

    /// Sets the thresholds from the motor's largest torque (N m) and the joint's speed limit (rad/s).
    pub(super) fn set_limits(&mut self, torque: f32, speed: f32) {
        self.stall_torque = if torque > 0.0 { 0.8 * torque } else { f32::INFINITY };
        self.suspicious_speed = 0.25 * speed;
    }
}

/// Averaging time of the tip force that is compared with the limit, s. A few carrier periods far above the limit trip.
const FORCE_AVERAGING_SECONDS: f32 = 5.0e-4;
/// Factor by which the force that voltages show is averaged for longer, so that the measured currents trip first.
const VOLTAGE_AVERAGING_FACTOR: f32 = 4.0;
/// Ratio by which measured currents may exceed the largest commanded force, because the current loop overshoots.
const CURRENT_FORCE_MARGIN: f32 = 1.05;
/// Largest share of the force limit that the sensors' error may hide, because even a small torque is a large force near
/// a singular pose.
const MAX_HIDDEN_FORCE_SHARE: f32 = 0.05;
/// Error of the mean reading of a current sensor over [`FORCE_AVERAGING_SECONDS`], A: its zero and its noise.
const CURRENT_SENSOR_ERROR: f32 = 0.05;
/// Largest share of the force limit that the sensors may show while the bridges are off.
const MAX_STRAY_FORCE_SHARE: f32 = 0.5;
/// Time in which currents and their mean force follow a lowered limit, s.
const SETTLING_SECONDS: f32 = 5.0e-3;
/// Rate at which the leverage is recomputed, Hz. A tip at 1 m/s moves by half a millimetre between two computations.
const LEVERAGE_HZ: f32 = 2.0e3;
/// Relative change of leverage that [`CURRENT_FORCE_MARGIN`] covers, so that the commanded force is not reduced.
const FREE_LEVERAGE_CHANGE: f32 = 0.02;
/// Share of the largest recent change that is kept at the next recomputation.
const LEVERAGE_CHANGE_DECAY: f32 = 0.75;

/// Forces at the tip that the measured currents make.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Flow {
    /// Mean torques that the sensors show while no bridge drives, N m.
    torque: Torques,
    sample_weight: f32,
    /// Mean force of the measured currents beyond the device's weight, N.
    force: f32,
    /// Limit of `force`, N.
    max_force: f32,
    /// Mean force that the motors' voltages show while a motor is inspected, N.
    voltage_force: f32,
    /// Number of inspections since the leverage was recomputed.
    inspections: u32,
    /// Largest relative change of the leverage in recent recomputations.
    leverage_change: f32,
    /// Number of valleys until the leverage is recomputed.
    valleys_left: u32,
    /// Number of valleys between two recomputations of the leverage.
    leverage_valleys: u32,
    next: NextLeverage,
    /// Time for which the earlier, larger force may still flow after the limit was lowered, s.
    settling_seconds: f32,
}

/// Progress of the recomputation of the leverage, one part in each valley because a valley has no time for all.
#[derive(Clone, Copy, Debug, Default)]
enum NextLeverage {
    #[default]
    Unknown,
    Computed(Leverage),
    /// Leverage whose change from the present leverage is already recorded.
    Compared(Leverage),
}

impl Flow {
    /// Clears the state of the previous armed time.
    pub(super) fn reset(&mut self) {
        *self = Self { sample_weight: self.sample_weight, leverage_valleys: self.leverage_valleys, ..Self::default() };
    }

    /// Allows the earlier force for one control `period` (s) and the currents' settling after a limit was lowered.
    pub(super) fn settle(&mut self, period: f32) {
        self.settling_seconds = period + SETTLING_SECONDS;
    }

    /// Sets the carrier period, s.
    pub(super) fn set_period(&mut self, period: f32) {
        self.sample_weight = (period / FORCE_AVERAGING_SECONDS).min(1.0);
        self.leverage_valleys = (1.0 / (period * LEVERAGE_HZ)) as u32;
    }
}

impl<P, K, S> ControlLoop<P, S>
where
    P: DerefMut<Target = Program<K, S>>,
    K: Math<f32>,
    S: Stage,
{
    /// Checks heat, stalls, lost encoders and the tip force with the samples of the preceding crest (`seen`), and
    /// returns the state of the bridges. Call at every valley, after [`ControlLoop::duties`].
    pub fn check_slow_faults(&mut self, seen: &Samples) -> Outputs {
        let seen = &self.complete_samples(seen);
        let supplied = core::mem::take(&mut self.drive_voltage);
        let sensed = self.hardware.bridge.current_sensed && self.hardware.bus_sensed;
        self.check_slow_faults_of(seen, (supplied > 0.0).then_some(supplied), sensed);
        self.outputs()
    }

    /// Implements [`ControlLoop::check_slow_faults`]. `supplied` is the bus voltage of the drives since the last valley
    /// (V), `None` without drives. `sensed` is true if currents and bus voltage are measured.
    #[inline(always)]
    pub(super) fn check_slow_faults_of(&mut self, seen: &Samples, supplied: Option<f32>, sensed: bool) {
        let active = self.state.drives();
        if active {
            match self.count() {
                2 => self.check_motors_and_force::<2>(seen, supplied),
                3 => self.check_motors_and_force::<3>(seen, supplied),
                _ => self.check_motors_and_force::<1>(seen, supplied),
            }
            // Only a slow carrier has time for both.
            if !self.check_polarity_at_valley() || self.flow.leverage_valleys == 0 {
                match self.flow.valleys_left.checked_sub(1) {
                    Some(valleys) => self.flow.valleys_left = valleys,
                    None => self.advance_leverage(&seen.counts),
                }
            }
        } else {
            self.average_readings(seen, sensed);
        }
        let joints = self.count();
        let i = if self.next_joint < joints { self.next_joint } else { 0 };
        self.next_joint = i + 1;
        if joints > 0
            && let Some((fault, value)) = self.spent_budget(i, seen, sensed, active)
            && active
        {
            self.trip(fault, Some(i as u8), value);
        }
    }

    /// Averages the sensors' readings while the bridges are off.
    fn average_readings(&mut self, seen: &Samples, sensed: bool) {
        let readings = seen.currents.iter().zip(seen.imbalance.iter());
        for ((joint, (current, direct)), mean) in self.joints.iter().zip(readings).zip(self.flow.torque.iter_mut()) {
            // Any component of a three-phase motor's current makes torque at some angle of the rotor.
            let three_phase = joint.stage.is_three_phase();
            let current = if three_phase { sqrt(current * current + direct * direct) } else { *current };
            let shown = if sensed { joint.stage.torque_of(current) } else { 0.0 };
            *mean += self.flow.sample_weight * (shown - *mean);
        }
    }

    /// Returns an error if the sensors show currents of half the force limit while the bridges are off, because a
    /// bridge is broken, or a sensor error would hide a force as large.
    pub(super) fn refuse_stray_current(&mut self) -> Result<(), Refusal> {
        if let Some(leverage) = self.leverage_at(&{ self.now.counts }) {
            self.compare_leverage(&leverage);
            self.set_leverage(leverage);
        }
        let most = MAX_STRAY_FORCE_SHARE * self.rules.limits.tip_force;
        if margin_bits(self.leverage.force_squared(&self.flow.torque), most * most) >= 0 {
            return Ok(());
        }
        let worth = |i: usize, torque: &f32| self.leverage.force_bound(i) * torque.abs();
        let worst = self.joints.iter().zip(self.flow.torque.iter()).enumerate().take(self.count());
        let worst = worst.max_by(|(i, (_, one)), (j, (_, other))| worth(*i, one).total_cmp(&worth(*j, other)));
        let Some((i, (joint, torque))) = worst else { return Ok(()) };
        self.trip(Fault::StrayCurrent, Some(i as u8), torque / joint.stage.torque_of(1.0));
        Err(Refusal::Faulted(Fault::StrayCurrent))
    }

    /// Checks the currents and voltages of J joints against their motors' models, and the tip force against its limit.
    #[inline(always)]
    fn check_motors_and_force<const J: usize>(&mut self, seen: &Samples, supplied: Option<f32>) {
        let mut least = 0;
        let held = self.gravity_torques();
        let mut acting = Torques::default();
        let motors = self.joints.iter_mut().zip(seen.currents.iter()).zip(acting.iter_mut().zip(held.iter()));
        for ((joint, current), (acting, held)) in motors.take(J) {
            joint.sums.current_squares += current * current;
            *acting = joint.stage.torque_of(*current) - held;
            if let Some(bus_voltage) = supplied {
                let (strain, doubt, _) = joint.settle(bus_voltage);
                least |= margin_bits(strain, doubt);
            }
        }
        // The mean of the magnitude, because a force that alternates within a millisecond acts on a hand, too.
        let force = sqrt(squared(&self.leverage.force::<J>(&acting)));
        self.flow.force += self.flow.sample_weight * (force - self.flow.force);
        least |= margin_bits(self.flow.force, self.flow.max_force);
        if least < 0 {
            self.find_strained_motor(&held);
        }
    }

    /// Returns the part of the commanded torques that holds the device against gravity, N m.
    #[inline(always)]
    fn gravity_torques(&self) -> Torques {
        match self.state {
            // The torque that carried the weight may still fade in a scene without gravity compensation.
            State::Armed if self.was_cut() => self.cut_torques.gravity,
            State::Armed if self.compensates_weight => Torques(self.now.result.asked.gravity),
            _ => Torques::default(),
        }
    }

    #[inline(never)]
    fn leverage_at(&self, counts: &Counts) -> Option<Leverage> {
        let program = self.program.as_ref()?;
        Some(program.mechanism.leverage::<K>(&core::array::from_fn(|i| self.angle(i, counts[i]))))
    }

    /// Runs the next part of the recomputation of the leverage, at these counts.
    #[inline(never)]
    fn advance_leverage(&mut self, counts: &Counts) {
        match self.flow.next {
            NextLeverage::Unknown => {
                self.flow.next = self.leverage_at(counts).map_or(NextLeverage::Unknown, NextLeverage::Computed);
            }
            NextLeverage::Computed(leverage) => {
                self.compare_leverage(&leverage);
                self.flow.next = NextLeverage::Compared(leverage);
                // A slow carrier has time for both parts.
                if self.flow.leverage_valleys == 0 {
                    self.set_leverage(leverage);
                }
            }
            NextLeverage::Compared(leverage) => self.set_leverage(leverage),
        }
    }

    fn set_leverage(&mut self, leverage: Leverage) {
        self.flow.next = NextLeverage::Unknown;
        self.leverage = leverage;
        self.update_force_bounds();
    }

    #[inline(always)]
    fn compare_leverage(&mut self, leverage: &Leverage) {
        let change = leverage.relative_change_from(&self.leverage).lesser(1.0);
        if change > 0.0 {
            self.flow.leverage_change = change.greater(LEVERAGE_CHANGE_DECAY * self.flow.leverage_change);
        }
    }

    /// Computes the largest force that may flow at the present leverage. Also computes the largest commanded force,
    /// which stays within the limit if leverage changes as in recent recomputations.
    pub(super) fn update_force_bounds(&mut self) {
        let (count, limit) = (self.count(), self.rules.limits.tip_force);
        let (mut error, free) = (0.0, (VOLTS_MARGIN - CURRENT_FORCE_MARGIN) * limit / count.max(1) as f32);
        for (i, joint) in self.joints.iter_mut().enumerate().take(count) {
            let leverage = self.leverage.force_bound(i);
            error += leverage * joint.stage.torque_of(CURRENT_SENSOR_ERROR).abs();
            // Smaller torques of all motors make at most the force that the voltages may show without an inspection.
            joint.stage.inspect_above(free / leverage);
        }
        self.set_max_tip_force(limit / (1.0 + (self.flow.leverage_change - FREE_LEVERAGE_CHANGE).greater(0.0)));
        let most = CURRENT_FORCE_MARGIN * limit + error.lesser(MAX_HIDDEN_FORCE_SHARE * limit);
        let flow = &mut self.flow;
        // One of the valleys was used for the comparison.
        flow.valleys_left = flow.leverage_valleys.saturating_sub(1);
        if core::mem::take(&mut flow.inspections) == 0 {
            flow.voltage_force = 0.0;
        }
        if flow.settling_seconds > 0.0 {
            flow.settling_seconds -= (flow.leverage_valleys + 1) as f32 * self.crests.period;
            flow.max_force = flow.max_force.greater(most);
        } else {
            flow.max_force = most;
        }
    }

    /// Finds the motor that differs from the device file and turns the motors off. Does nothing if all agree.
    #[cold]
    #[inline(never)]
    fn find_strained_motor(&mut self, held: &Torques) {
        let joints = self.count();
        let flowing = self.flow.force;
        if margin_bits(flowing, self.flow.max_force) < 0 {
            self.trip(Fault::ForceLimit, None, flowing);
            return;
        }
        let shown =
            Torques::from_fn(|i| self.joints[i].stage.torque_of(self.joints[i].stage.current_from_voltage()) - held[i]);
        let force = sqrt(self.leverage.force_squared(&shown));
        let flow = &mut self.flow;
        flow.voltage_force += flow.sample_weight / VOLTAGE_AVERAGING_FACTOR * (force - flow.voltage_force);
        flow.inspections += 1;
        let hard = margin_bits(
            flow.voltage_force,
            VOLTS_MARGIN / (CURRENT_FORCE_MARGIN + MAX_HIDDEN_FORCE_SHARE) * flow.max_force,
        ) < 0;
        let strained = self.joints.iter().enumerate().take(joints).filter_map(|(i, joint)| {
            let (strain, doubt, most) = joint.stage.strain();
            let bound = if hard { doubt } else { most };
            (margin_bits(strain, bound) < 0).then_some((i, joint, strain))
        });
        let Some((i, joint, strain)) = strained.max_by(|one, other| one.2.abs().total_cmp(&other.2.abs())) else {
            return;
        };
        // If the current is as expected and only motion explains the voltage, the encoder is dead.
        let (fault, value) = if joint.stage.has_expected_current() && joint.stands_still() {
            (Fault::EncoderLoss, joint.stage.speed_of_back_emf(strain))
        } else {
            (Fault::MotorModel, strain)
        };
        self.trip(fault, Some(i as u8), value);
    }

    /// Updates the heat and times of joint `i`. Returns the fault and its value if a budget is spent.
    #[inline(always)]
    fn spent_budget(&mut self, i: usize, seen: &Samples, sensed: bool, active: bool) -> Option<(Fault, f32)> {
        let period = self.crests.period;
        let elapsed = period * self.count() as f32;
        let (joint, motor) = (self.joints.get_mut(i)?, self.heat.get_mut(i)?);
        let (motors, sums) = (&self.now.motors, &mut joint.sums);
        let (count, current) = (seen.counts[i], seen.currents[i]);
        let mut spent = None;
        let moved = core::mem::replace(&mut sums.count, count) != count;
        let heat = clamp(core::mem::take(&mut sums.current_squares) * period, f32::MAX);
        // The heat is also updated while the motors are off, because the motors cool.
        if motor.warm(heat, elapsed) {
            spent = Some((Fault::ThermalBudget, current));
        }
        if moved {
            sums.reset();
        } else if active {
            if motors.torque[i].abs() > sums.stall_torque {
                sums.still_seconds += elapsed;
                if sums.still_seconds > STALL_SECONDS {
                    spent = Some((Fault::EncoderStall, sums.still_seconds));
                }
            }
            // The motor's voltage less R i is its back-EMF. If it corresponds to several rad/s, counts must change.
            if sensed {
                let turning = joint.stage.least_speed(motors.duty[i], seen.bus_voltage, current);
                sums.lost_seconds =
                    if turning.abs() > sums.suspicious_speed { sums.lost_seconds + elapsed } else { 0.0 };
                if sums.lost_seconds > LOSS_SECONDS {
                    spent = Some((Fault::EncoderLoss, turning));
                }
            }
        }
        spent
    }
}
