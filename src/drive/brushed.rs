//! The motor stage of one brushed motor on a bridge: torque → current → voltage → duty.
//!
//! The motor's resistance, inductance and back-EMF give the voltage that brings the winding of the device file to the
//! target current within one carrier period, or as far as the bus allows. If the board senses current, a PI loop
//! removes the remaining error. It compares each sample with the current that the winding would have at that instant,
//! not with the target, which the current cannot have reached yet. Steps therefore do not overshoot.
//!
//! Only this module enforces the limits of torque, current, voltage and duty. The returned duty is the motor's voltage
//! as a signed share of the bus voltage, -1..1; the legs run at ½ ± duty/2.
//!
//! [`Stage::drive_in_range`] computes a duty within all limits with a few multiplications and additions.
//! `Axis::drive_at_limits` computes every other duty; within the limits both return the same number.

use super::bits::margin_bits;
use super::stage::{Bridge, Duty, MAX_DUTY, Stage, Supply};
use crate::math::{Real, clamp};
use crate::model::motor::Motor;

/// [`MAX_DUTY`] less the largest rounding error.
const USABLE_DUTY: f32 = MAX_DUTY * (1.0 - 2.0 * f32::EPSILON);
/// Share of the loop's bandwidth that is used if the device file gives the inductance as 0. If the real winding has
/// inductance, the current overshoots. At the boards' bandwidth of 1 kHz the overshoot is 7 % at L/R = 0.3 ms, 14 % at
/// 0.8 ms and 16 % at 1 ms (tests/drive.rs).
pub const UNKNOWN_INDUCTANCE_SHARE: f32 = 0.05;
/// Factor of the current limit in the largest current with overshoot.
const OVERSHOOT_FACTOR: f32 = 1.3;
/// Part of the largest current with overshoot that does not depend on the limit, A.
const OVERSHOOT_FLOOR: f32 = 0.6;
/// Share of the available change of current that is used, so that rounding does not exceed the available change.
const USABLE_RISE_SHARE: f32 = 1.0 - 8.0 * f32::EPSILON;
/// Current below which dead-time compensation fades, A, because near zero the sign of the current is noise.
const DEAD_TIME_KNEE: f32 = 0.1;
/// Accepted relative excess of a winding's resistance over the device file's value: copper gains 40 % per 100 K.
const RESISTANCE_TOLERANCE: f32 = 0.5;
/// Largest difference of a sound motor's voltage from its model, V, caused by brushes, ripple and the sensors' zeros.
const VOLTAGE_TOLERANCE: f32 = 1.0;
/// Accepted relative error of the data sheet's back-EMF.
const EMF_TOLERANCE: f32 = 0.2;
/// Weight of one sample in the mean difference between expected and measured current.
const ERROR_WEIGHT: f32 = 1.0 / 4.0;
/// Weight if the inductance is unknown, because the current may lag the expected current by about a millisecond.
const SLOW_ERROR_WEIGHT: f32 = 1.0 / 64.0;
/// Share of the largest recent current that remains after a carrier period. The integrator decays faster.
const CURRENT_DECAY: f32 = 15.0 / 16.0;
/// Share of the largest recent difference of fed-forward and measured speed that remains after a carrier period.
const SPEED_ERROR_DECAY: f32 = 255.0 / 256.0;
/// Largest voltage error while the current lags in a reversal, as a share of the voltage R i at the largest current.
const LAG_TOLERANCE: f32 = 1.3;

/// Effect of a duty, as shares of the current change that the duty makes in a full carrier period.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Timing {
    /// Share of the change at the next sample.
    sample: f32,
    /// Share of the change at the next valley.
    valley: f32,
    /// Share of a change to request, so that a duty that lasts half a period too long completes the change.
    request: f32,
}

/// The drive of one motor: constants that are computed when a device is loaded, and the state of the loop. The fields
/// of every carrier period come first in memory.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C)]
pub struct Axis {
    amps_per_torque: f32,
    back_emf: f32,
    dead_time_share: f32,
    /// Target current, A.
    target: f32,
    /// Current that the next sample should show, A.
    expected: f32,
    /// Current that the duties so far produce at the next valley, A.
    at_valley: f32,
    /// Expected current less measured current at the last sample, A.
    error: f32,
    /// Voltage of the integrator, V.
    integrator: f32,
    proportional: f32,
    integral: f32,
    resistance: f32,
    /// Voltage that changes the current by 1 A within a carrier period, V/A.
    volts_per_amp: f32,
    /// Change of current that a duty in time can make at any current within the limit, A.
    safe_rise: f32,
    /// Share of a change at the next sample if the duty applies in time, see [`Timing::sample`].
    next_sample_share: f32,
    /// Timing of a duty in time and of a late duty.
    timing: [Timing; 2],
    /// Share of a free current that remains after half a carrier period.
    free_share: f32,
    amps_per_volt: f32,
    torque_per_amp: f32,
    /// Maximum current of the motor itself, A; 0 without a torque constant.
    motor_current: f32,
    max_current: f32,
    /// Largest current including overshoot, A.
    peak_current: f32,
    /// Mean of expected less measured current, A.
    mean_error: f32,
    /// Weight of one sample in `mean_error`.
    error_weight: f32,
    /// Possible error of the back-EMF at the last sample's speed, V.
    emf_tolerance: f32,
    /// Largest recent difference between the fed-forward and the measured speed, rad/s.
    speed_error: f32,
    /// Largest recent current, A, because the integrator's voltage for a hot winding outlasts the current.
    recent_current: f32,
    /// Largest difference of a sound motor's voltage from the model at rest without current, V.
    tolerance: f32,
    /// Difference from the model above which the motor is inspected, V.
    inspection_voltage: f32,
    /// Part of `tolerance` without current, V.
    base_tolerance: f32,
    /// Part of `tolerance` per ampere if the inductance is unknown, Ω.
    lag_resistance: f32,
    /// Additional tolerance per ampere of the largest recent current, Ω, because the winding may be hot.
    tolerance_resistance: f32,
}

/// Returns the current (A) whose voltage R i equals the back-EMF of a joint speed of 1 rad/s.
pub fn hidden_by_speed(motor: &Motor<f64>) -> f64 {
    f64::from(EMF_TOLERANCE) * motor.back_emf / motor.resistance
}

impl Axis {
    /// Sets the timing of duties. f = `free_share` is the share of a free current that remains after half a carrier
    /// period. At constant voltage the remaining change falls as f^(2t), so half a period makes (1 - f)/(1 - f²) of it.
    fn set_timing(&mut self, free_share: f32) {
        let half = 1.0 / (1.0 + free_share);
        self.timing = [
            Timing { sample: half, valley: 1.0, request: 1.0 / (1.0 + half * free_share * free_share) },
            Timing { sample: 0.0, valley: half, request: 1.0 },
        ];
        (self.free_share, self.next_sample_share) = (free_share, half);
    }

    /// Returns the duty that compensates the dead time. It fades where the sign of the current is uncertain.
    #[inline(always)]
    fn dead_time_duty(&self) -> f32 {
        self.dead_time_share * (self.target / (self.target.abs() + DEAD_TIME_KNEE))
    }

    /// Returns the voltage (V) that keeps the current at `begin` and corrects the error of the last sample.
    #[inline(always)]
    fn holding_voltage(&self, begin: f32, error: f32, speed: f32) -> f32 {
        self.integrator + self.back_emf * speed + self.proportional * error + self.resistance * begin
    }

    /// Implements [`Stage::drive`] with any timing and at any limit, for a usable supply. `coupled` is a voltage (V) of
    /// the motor in addition to the back-EMF.
    #[inline(never)]
    fn drive_at_limits(&mut self, supply: &Supply, current: f32, speed: f32, coupled: f32, late: bool) -> f32 {
        let timing = self.timing[usize::from(late)];
        let error = self.expected - current;
        // The drive begins at this current. The previous drive continues until a late drive acts.
        let begin =
            if late { self.at_valley + self.free_share * (self.at_valley - self.expected) } else { self.at_valley };
        // If the next duty is late, this duty acts for longer, so the change stays below an over-current.
        let (up, down) = ((self.peak_current - begin) * timing.request, (self.peak_current + begin) * -timing.request);
        let change = self.target - begin;
        let mut rise = if change > up { up } else { change };
        rise = if rise < down { down } else { rise };
        let (hold, dead_time_duty) = (self.holding_voltage(begin, error, speed) + coupled, self.dead_time_duty());
        let mut duty = dead_time_duty + supply.inverse * (hold + self.volts_per_amp * rise);
        // A voltage that the bus cannot supply is not integrated further.
        let integrates = if duty.abs() <= USABLE_DUTY {
            true
        } else {
            duty = clamp(duty, USABLE_DUTY);
            rise = clamp(((duty - dead_time_duty) * supply.volts - hold) * self.amps_per_volt, 2.0 * self.peak_current);
            duty * error < 0.0
        };
        self.expected = begin + timing.sample * rise;
        self.at_valley = self.target - (change - timing.valley * rise);
        self.error = error;
        if integrates {
            self.integrator += self.integral * error;
        }
        duty
    }
}

/// Methods for an axis of the rotor frame of a three-phase motor, which obeys the equation of a brushed motor.
impl Axis {
    /// Returns the duty of an axis whose voltage also contains `coupled` (V), see [`Stage::drive`].
    pub(super) fn drive_coupled(
        &mut self,
        supply: &Supply,
        current: f32,
        speed: f32,
        coupled: f32,
        late: bool,
    ) -> Duty {
        Duty(self.drive_at_limits(supply, current, speed, coupled, late))
    }

    /// Returns the current that the sensors should show now, A.
    pub(super) fn expected_current(&self) -> f32 {
        self.expected
    }

    /// Returns the possible error of the back-EMF at the last sample's speed, V.
    pub(super) fn emf_tolerance(&self) -> f32 {
        self.emf_tolerance
    }

    /// Returns this axis without compensation of the dead time, which depends on the currents of the phases.
    pub(super) fn without_dead_time(self) -> Self {
        Self { dead_time_share: 0.0, ..self }
    }
}

impl Stage for Axis {
    type Sample = f32;
    type Drive = Duty;

    /// Makes the stage. A motor without a torque constant receives no current.
    fn new(motor: &Motor<f32>, bridge: &Bridge, max_current: f32) -> Self {
        let kt = motor.torque_constant;
        let usable = kt.abs() > 1.0e-9;
        let carrier_hz = bridge.carrier_hz.max(1.0);
        let inductance = motor.inductance.max(0.0);
        // Without a current sensor there is no error to correct.
        let share = match (bridge.current_sensed, inductance > 0.0) {
            (true, true) => 1.0,
            (true, false) => UNKNOWN_INDUCTANCE_SHARE,
            (false, _) => 0.0,
        };
        let bandwidth = share * core::f32::consts::TAU * bridge.bandwidth_hz;
        // A free current falls by a factor of exp(-fade) in a carrier period.
        let fade = motor.resistance / (inductance * carrier_hz);
        let surge = motor.resistance + inductance * carrier_hz / exprel(fade);
        let mut axis = Self {
            amps_per_torque: if usable { 1.0 / kt } else { 0.0 },
            torque_per_amp: if usable { kt } else { 0.0 },
            motor_current: if usable { motor.max_current } else { 0.0 },
            resistance: motor.resistance,
            tolerance_resistance: RESISTANCE_TOLERANCE * motor.resistance,
            back_emf: motor.back_emf,
            volts_per_amp: surge,
            amps_per_volt: if surge > 0.0 { 1.0 / surge } else { 0.0 },
            proportional: bandwidth * inductance,
            integral: bandwidth * motor.resistance / carrier_hz,
            dead_time_share: 2.0 * bridge.dead_time * bridge.carrier_hz,
            base_tolerance: if bridge.current_sensed { VOLTAGE_TOLERANCE } else { f32::INFINITY },
            lag_resistance: if inductance > 0.0 { 0.0 } else { LAG_TOLERANCE * motor.resistance },
            error_weight: if inductance > 0.0 { ERROR_WEIGHT } else { SLOW_ERROR_WEIGHT },
            ..Self::default()
        };
        axis.set_timing(1.0 / (1.0 + 0.5 * fade * exprel(0.5 * fade)));
        axis.limit(max_current);
        axis
    }

    fn limit(&mut self, max_current: f32) {
        self.max_current = self.motor_current.min(max_current).max(0.0);
        // The last command acts until the next control step.
        self.target = clamp(self.target, self.max_current);
        self.peak_current = OVERSHOOT_FACTOR * self.max_current + OVERSHOOT_FLOOR;
        // Change from any current within the limit to the largest current with overshoot.
        self.safe_rise = USABLE_RISE_SHARE * ((self.peak_current - self.max_current) * self.timing[0].request).max(0.0);
        self.tolerance = self.base_tolerance + self.lag_resistance * self.max_current;
        self.inspection_voltage = self.tolerance;
    }

    fn max_current(&self) -> f32 {
        self.max_current
    }

    fn motor_current(&self) -> f32 {
        self.motor_current
    }

    fn max_torque(&self) -> f32 {
        self.max_current * self.torque_per_amp.abs()
    }

    #[inline(always)]
    fn torque_of(&self, current: f32) -> f32 {
        current * self.torque_per_amp
    }

    fn target_current(&self) -> f32 {
        self.target
    }

    #[inline(always)]
    fn command(&mut self, torque: f32) {
        self.target = clamp(torque * self.amps_per_torque, self.max_current);
    }

    #[inline(always)]
    fn command_within(&mut self, torque: f32) {
        self.target = torque * self.amps_per_torque;
    }

    /// Returns the duty for the next carrier period. `current` is the measured current, A, ignored if the board senses
    /// none. Returns zero if the bus voltage is not usable.
    fn drive(&mut self, supply: &Supply, current: f32, speed: f32, late: bool) -> Duty {
        if !supply.is_usable() {
            self.integrator = 0.0;
            return Duty::default();
        }
        Duty(self.drive_at_limits(supply, current, speed, 0.0, late))
    }

    /// A late drive makes at most the requested change of current, so only its voltage can be out of range.
    #[inline(always)]
    fn drive_in_range(&mut self, supply: &Supply, current: f32, speed: f32, late: bool) -> Option<Duty> {
        let begin =
            if late { self.at_valley + self.free_share * (self.at_valley - self.expected) } else { self.at_valley };
        let error = self.expected - current;
        let rise = self.target - begin;
        let duty = self.dead_time_duty()
            + supply.inverse * (self.holding_voltage(begin, error, speed) + self.volts_per_amp * rise);
        let room = margin_bits(self.target, self.peak_current) | margin_bits(begin, f32::MAX);
        if if late { room } else { margin_bits(rise, self.safe_rise) } | margin_bits(duty, USABLE_DUTY) < 0 {
            return None;
        }
        (self.expected, self.at_valley) = if late {
            (begin + self.timing[1].sample * rise, self.target - (rise - self.timing[1].valley * rise))
        } else {
            (begin + self.next_sample_share * rise, self.target)
        };
        self.error = error;
        self.integrator += self.integral * error;
        Some(Duty(duty))
    }

    #[inline(always)]
    fn settle(&mut self, bus_voltage: f32, given: f32, speed: f32, raw: f32) {
        self.integrator = clamp(self.integrator, USABLE_DUTY * bus_voltage);
        self.mean_error += self.error_weight * (self.error - self.mean_error);
        let (at_valley, fading) = (self.at_valley.abs(), CURRENT_DECAY * self.recent_current);
        self.recent_current = if at_valley > fading { at_valley } else { fading };
        // After a jump the speed leads its filtered value; between the counts of a coarse encoder it seems to lag.
        let (ahead, fading) = ((speed - given).abs(), SPEED_ERROR_DECAY * self.speed_error);
        self.speed_error = if ahead > fading { ahead } else { fading };
        self.emf_tolerance =
            (EMF_TOLERANCE * speed.abs() + self.speed_error + (raw - speed).abs()) * self.back_emf.abs();
    }

    fn back_emf_current(&self, speed: f32) -> f32 {
        if self.resistance > 0.0 { self.back_emf * speed / self.resistance } else { 0.0 }
    }

    /// Uses only the voltage in phase with the current, because the inductance's voltage is a quarter period off.
    /// Subtracts the back-EMF.
    fn resistance_of(&self, voltage: [f32; 2], current: [f32; 2], angle: [f32; 2], rate: f32) -> Option<(f32, f32)> {
        // The derivative of a cos + b sin is rate (b cos - a sin).
        let turning = [rate * angle[1], -rate * angle[0]];
        let left = [voltage[0] - self.back_emf * turning[0], voltage[1] - self.back_emf * turning[1]];
        let squared = current[0] * current[0] + current[1] * current[1];
        let file = self.tolerance_resistance / RESISTANCE_TOLERANCE;
        (squared > 0.0).then(|| ((left[0] * current[0] + left[1] * current[1]) / squared, file))
    }

    #[inline(always)]
    fn duty(drive: Duty) -> f32 {
        drive.0
    }

    /// A sound motor leaves the integrator near zero. If the bus limits the voltage, the same error appears as a
    /// current below the expected current.
    #[inline(always)]
    fn strain(&self) -> (f32, f32, f32) {
        let strain = self.integrator + self.resistance * self.mean_error;
        let most = self.tolerance + self.tolerance_resistance * self.recent_current + self.emf_tolerance;
        (strain, self.inspection_voltage + self.emf_tolerance, most)
    }

    fn inspect_above(&mut self, torque: f32) {
        // Without a sensor the current is unknown.
        if self.tolerance < f32::INFINITY {
            self.inspection_voltage = (torque * self.amps_per_torque * self.resistance).abs().lesser(self.tolerance);
        }
    }

    fn current_from_voltage(&self) -> f32 {
        let strain = self.integrator + self.resistance * self.mean_error;
        let beyond = strain - clamp(strain, self.emf_tolerance);
        self.at_valley + if self.resistance > 0.0 { beyond / self.resistance } else { 0.0 }
    }

    /// Uses the smaller of the file's and the measured resistance. A larger measured value may include the brushes, and
    /// an overestimated resistance of the winding would hide a current.
    fn set_measured_resistance(&mut self, ohms: f32) {
        self.resistance = self.resistance.min(ohms);
    }

    fn speed_of_back_emf(&self, volts: f32) -> f32 {
        if self.back_emf.abs() > 1.0e-6 { volts / self.back_emf } else { 0.0 }
    }

    fn has_expected_current(&self) -> bool {
        self.mean_error.abs() <= 0.25 * self.at_valley.abs() + DEAD_TIME_KNEE
    }

    fn rest(&mut self) {
        self.integrator = 0.0;
        self.at_valley = 0.0;
        self.expected = 0.0;
        self.error = 0.0;
        self.mean_error = 0.0;
        self.recent_current = 0.0;
        self.target = 0.0;
        self.emf_tolerance = 0.0;
        self.speed_error = 0.0;
    }

    fn inherit(&mut self, other: &Self) {
        let Self { integrator, at_valley, expected, error, mean_error, recent_current, target, resistance, .. } =
            *other;
        *self = Self { integrator, at_valley, expected, error, mean_error, recent_current, target, ..*self };
        // The measured resistance of the same motor stays valid.
        if self.tolerance_resistance == other.tolerance_resistance {
            self.resistance = resistance;
        }
    }

    /// Subtracts the resistance's voltage and the possible error: half of this voltage (for a hot winding or a poor
    /// contact), and the dead time. The rest is back-EMF.
    #[inline(always)]
    fn least_speed(&self, duty: f32, bus_voltage: f32, current: f32) -> f32 {
        let drop = self.resistance * current;
        let left = duty * bus_voltage - drop;
        let tolerance = RESISTANCE_TOLERANCE * drop.abs() + self.dead_time_share * bus_voltage;
        let usable = self.back_emf.abs() > 1.0e-6 && left.abs() > tolerance;
        if usable { (left - tolerance * left.signum()) / self.back_emf } else { 0.0 }
    }
}

/// Returns (eˣ - 1)/x for x ≥ 0 by its series, exact for small x. A quotient by the result is negligible for large x.
/// Infinite for infinity.
fn exprel(x: f32) -> f32 {
    (2..=9).rev().fold(1.0, |sum, n| 1.0 + x / n as f32 * sum)
}
