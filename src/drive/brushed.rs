//! Torque → current → voltage → duty, for one brushed motor on a bridge.
//!
//! The voltage that takes a winding like the device file's to the target within one carrier period, or as far as the
//! bus allows, is worked out from the motor's resistance, inductance and back-EMF. Where the board senses current, a PI
//! loop takes out what that leaves: it compares each sample with the current that such a winding would have at that
//! instant, not with the target, which no current can have reached yet, so steps do not overshoot.
//!
//! Limits (torque, current, voltage, duty) are enforced here and nowhere else. The duty returned is signed, -1..1 of
//! the bus voltage across the motor; legs run at ½ ± duty/2.
//!
//! A duty that applies in time, to a current that is where it should be and a voltage that is there, is a few
//! multiplications and additions ([`Stage::drive_easily`]); what any other one takes is in `Axis::hardly`, which gives the
//! same numbers where both may.

use super::bits::margin_bits;
use super::stage::{Bridge, Duty, MAX_DUTY, Stage, Supply};
use crate::math::limited;
use crate::model::motor::Motor;

/// [`MAX_DUTY`] less what rounding may add.
const USABLE_DUTY: f32 = MAX_DUTY * (1.0 - 2.0 * f32::EPSILON);

/// Share of the loop's bandwidth where the device file leaves the inductance at 0. The motor may have one all the same:
/// the whole voltage of the target is applied at once, so its current rises with L/R and overshoots by what the loop
/// has integrated meanwhile, with the boards' 1 kHz by 7 % at L/R = 0.3 ms, 14 % at 0.8 ms and 16 % at 1 ms
/// (tests/drive.rs).
pub const UNKNOWN_WINDING: f32 = 0.05;

/// Largest overshoot of a current: a multiple of its limit, plus an absolute amount, A.
const OVERSHOOT: f32 = 1.3;
const OVERSHOOT_FLOOR: f32 = 0.6;
/// Share of the available change that rounding leaves.
const EASILY: f32 = 1.0 - 8.0 * f32::EPSILON;

/// The current below which dead-time compensation fades, A: its sign is noise around zero.
const DEAD_TIME_KNEE: f32 = 0.1;

/// Share by which a winding's resistance may exceed the device file's: copper gains 40 % per 100 K.
const RESISTANCE_DOUBT: f32 = 0.5;

/// Voltage of a motor that nothing here accounts for and that is no fault, V: brushes, ripple, zeros.
const VOLTAGE_DOUBT: f32 = 1.0;
/// Share of the back-EMF by which it may differ from the data sheet's.
const EMF_DOUBT: f32 = 0.2;
/// Weight of one sample in the mean difference between expected and measured current; and where the winding is not
/// known, whose current may lag behind what is expected for a millisecond or so.
const ERROR_WEIGHT: f32 = 1.0 / 4.0;
const SLOW_ERROR_WEIGHT: f32 = 1.0 / 64.0;
/// Share of the largest recent current that remains after a carrier period: the loop has forgotten it faster.
const RECENT: f32 = 15.0 / 16.0;
/// The same share of the largest recent difference between the fed-forward speed and the measured one.
const SWING: f32 = 255.0 / 256.0;
/// Largest error that such a lag may show while a current is reversed, as a share of the voltage at the largest.
const LAG_DOUBT: f32 = 1.3;

/// When a duty acts, as shares of currents: of what it changes the current by within a carrier period, if it acts so long.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Timing {
    /// Share of a change that the current makes until the next sample and until the next valley.
    sample: f32,
    valley: f32,
    /// Share of a change to ask for, so that a drive that acts half a period too long makes the whole change.
    part: f32,
}

/// One motor's drive: constants made when a device is loaded, and the loop's integrator. In this order in memory: what
/// every carrier period needs comes first.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C)]
pub struct Axis {
    amps_per_torque: f32,
    back_emf: f32,
    dead_time_share: f32,
    /// The current that the controller asked for, A.
    target: f32,
    /// The current that the next sample should show, and the one that the duties so far lead to at the next valley, A.
    expected: f32,
    reached: f32,
    /// By what the last sample was below what was expected, A.
    error: f32,
    /// Voltage the integrator holds, V.
    integrator: f32,
    proportional: f32,
    integral: f32,
    resistance: f32,
    /// Voltage that changes the current by 1 A within a carrier period, V/A.
    surge: f32,
    /// A change that can never be too large for a duty in time, A.
    easy: f32,
    /// When a duty in time acts, see [`Timing::sample`].
    half: f32,
    /// When a duty acts: in time, and late; and what is left of a free current after half a carrier period.
    timing: [Timing; 2],
    kept: f32,
    /// A/V, the inverse of `surge`.
    reach: f32,
    torque_per_amp: f32,
    /// The motor's own maximum current, A; 0 if it has no torque constant.
    motor_current: f32,
    max_current: f32,
    /// Largest current including overshoot, A.
    most: f32,
    /// Mean of what samples were below what was expected, A, and the weight of one.
    missing: f32,
    error_weight: f32,
    /// Voltage that the speed at the last sample needed may be off by, V.
    emf_doubt: f32,
    /// The largest recent difference between the fed-forward speed and the measured one, rad/s.
    swing: f32,
    /// The largest recent current, A: the integrator's part for a hot winding outlasts it.
    recent: f32,
    /// Largest voltage by which a sound motor may differ from its model at rest without current, V; and from which on it
    /// is looked at.
    doubt: f32,
    looked_at: f32,
    /// That without any current, V, and what each ampere allowed adds where the inductance is not known, Ω.
    least_doubt: f32,
    lag_resistance: f32,
    /// Voltage that each ampere of the largest recent current adds to that: a hot winding, Ω.
    doubt_resistance: f32,
}

/// The current (A) that a joint's speed of 1 rad/s may hide: the motor's volts are its back-EMF as well.
pub fn hidden_by_speed(motor: &Motor<f64>) -> f64 {
    f64::from(EMF_DOUBT) * motor.back_emf / motor.resistance
}

impl Axis {
    /// Sets when a duty acts, where `kept` is what is left of a free current after half a carrier period. With constant
    /// voltage a current nears its end as kept^(2t): within half a period it makes (1 - kept)/(1 - kept²) of what it makes
    /// in one.
    fn time(&mut self, kept: f32) {
        let half = 1.0 / (1.0 + kept);
        self.timing = [
            Timing { sample: half, valley: 1.0, part: 1.0 / (1.0 + half * kept * kept) },
            Timing { sample: 0.0, valley: half, part: 1.0 },
        ];
        (self.kept, self.half) = (kept, half);
    }

    /// Duty that makes up for the dead time: both legs lose it against the current. It fades where the current's sign is
    /// unsure.
    #[inline(always)]
    fn regained(&self) -> f32 {
        self.dead_time_share * (self.target / (self.target.abs() + DEAD_TIME_KNEE))
    }

    /// Voltage, V, that keeps the current where it begins, and takes out what the last sample was off by.
    #[inline(always)]
    fn hold(&self, begin: f32, error: f32, speed: f32) -> f32 {
        self.integrator + self.back_emf * speed + self.proportional * error + self.resistance * begin
    }

    /// [`Stage::drive`] at any time and at any limit, where the supply is usable.
    #[inline(never)]
    fn hardly(&mut self, supply: &Supply, current: f32, speed: f32, late: bool) -> f32 {
        let timing = self.timing[usize::from(late)];
        let error = self.expected - current;
        // The current at which the drive begins: until a late drive acts, the one before it goes on.
        let begin = if late { self.reached + self.kept * (self.reached - self.expected) } else { self.reached };
        // Should the next duty be late, this one makes more of it: no more than is short of an over-current.
        let (up, down) = ((self.most - begin) * timing.part, (self.most + begin) * -timing.part);
        let wanted = self.target - begin;
        let mut rise = if wanted > up { up } else { wanted };
        rise = if rise < down { down } else { rise };
        let (hold, regained) = (self.hold(begin, error, speed), self.regained());
        let mut duty = regained + supply.inverse * (hold + self.surge * rise);
        // Not further into a voltage that is not there.
        let integrates = if duty.abs() <= USABLE_DUTY {
            true
        } else {
            duty = limited(duty, USABLE_DUTY);
            rise = limited(((duty - regained) * supply.volts - hold) * self.reach, 2.0 * self.most);
            duty * error < 0.0
        };
        self.expected = begin + timing.sample * rise;
        self.reached = self.target - (wanted - timing.valley * rise);
        self.error = error;
        if integrates {
            self.integrator += self.integral * error;
        }
        duty
    }
}

impl Stage for Axis {
    type Sample = f32;
    type Drive = Duty;

    /// A motor without a torque constant gets no current.
    fn new(motor: &Motor<f32>, bridge: &Bridge, max_current: f32) -> Self {
        let kt = motor.torque_constant;
        let usable = kt.abs() > 1.0e-9;
        let carrier_hz = bridge.carrier_hz.max(1.0);
        let inductance = motor.inductance.max(0.0);
        // Without a current sensor there is nothing to correct by.
        let share = match (bridge.current_sensed, inductance > 0.0) {
            (true, true) => 1.0,
            (true, false) => UNKNOWN_WINDING,
            (false, _) => 0.0,
        };
        let bandwidth = share * core::f32::consts::TAU * bridge.bandwidth_hz;
        // A free current falls to exp(-fade) in a carrier period.
        let fade = motor.resistance / (inductance * carrier_hz);
        let surge = motor.resistance + inductance * carrier_hz / growth(fade);
        let mut axis = Self {
            amps_per_torque: if usable { 1.0 / kt } else { 0.0 },
            torque_per_amp: if usable { kt } else { 0.0 },
            motor_current: if usable { motor.max_current } else { 0.0 },
            resistance: motor.resistance,
            doubt_resistance: RESISTANCE_DOUBT * motor.resistance,
            back_emf: motor.back_emf,
            surge,
            reach: if surge > 0.0 { 1.0 / surge } else { 0.0 },
            proportional: bandwidth * inductance,
            integral: bandwidth * motor.resistance / carrier_hz,
            dead_time_share: 2.0 * bridge.dead_time * bridge.carrier_hz,
            least_doubt: if bridge.current_sensed { VOLTAGE_DOUBT } else { f32::INFINITY },
            lag_resistance: if inductance > 0.0 { 0.0 } else { LAG_DOUBT * motor.resistance },
            error_weight: if inductance > 0.0 { ERROR_WEIGHT } else { SLOW_ERROR_WEIGHT },
            ..Self::default()
        };
        axis.time(1.0 / (1.0 + 0.5 * fade * growth(0.5 * fade)));
        axis.limit(max_current);
        axis
    }

    fn limit(&mut self, max_current: f32) {
        self.max_current = self.motor_current.min(max_current).max(0.0);
        // The last command acts until the next step.
        self.target = limited(self.target, self.max_current);
        self.most = OVERSHOOT * self.max_current + OVERSHOOT_FLOOR;
        // From wherever the limit lets a current be to wherever it lets it go.
        self.easy = EASILY * ((self.most - self.max_current) * self.timing[0].part).max(0.0);
        self.doubt = self.least_doubt + self.lag_resistance * self.max_current;
        self.looked_at = self.doubt;
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

    fn asked(&self) -> f32 {
        self.target
    }

    #[inline(always)]
    fn command(&mut self, torque: f32) {
        self.target = limited(torque * self.amps_per_torque, self.max_current);
    }

    #[inline(always)]
    fn command_within(&mut self, torque: f32) {
        self.target = torque * self.amps_per_torque;
    }

    /// The duty for the next carrier period from the supply and the measured current (A, of no effect where none is
    /// sensed). Zero when the bus voltage is not usable.
    fn drive(&mut self, supply: &Supply, current: f32, speed: f32, late: bool) -> Duty {
        if !supply.is_usable() {
            self.integrator = 0.0;
            return Duty::default();
        }
        Duty(self.hardly(supply, current, speed, late))
    }

    /// A late drive makes no more of a change than was asked for, so only the voltage can be insufficient.
    #[inline(always)]
    fn drive_easily(&mut self, supply: &Supply, current: f32, speed: f32, late: bool) -> Option<Duty> {
        let begin = if late { self.reached + self.kept * (self.reached - self.expected) } else { self.reached };
        let error = self.expected - current;
        let rise = self.target - begin;
        let duty = self.regained() + supply.inverse * (self.hold(begin, error, speed) + self.surge * rise);
        let room = margin_bits(self.target, self.most) | margin_bits(begin, f32::MAX);
        if if late { room } else { margin_bits(rise, self.easy) } | margin_bits(duty, USABLE_DUTY) < 0 {
            return None;
        }
        (self.expected, self.reached) = if late {
            (begin + self.timing[1].sample * rise, self.target - (rise - self.timing[1].valley * rise))
        } else {
            (begin + self.half * rise, self.target)
        };
        self.error = error;
        self.integrator += self.integral * error;
        Some(Duty(duty))
    }

    #[inline(always)]
    fn settle(&mut self, bus_voltage: f32, given: f32, speed: f32, raw: f32) {
        self.integrator = limited(self.integrator, USABLE_DUTY * bus_voltage);
        self.missing += self.error_weight * (self.error - self.missing);
        let (reached, fading) = (self.reached.abs(), RECENT * self.recent);
        self.recent = if reached > fading { reached } else { fading };
        // A speed that jumps is ahead of its filters; between the counts of a coarse encoder it seems to be behind them.
        let (ahead, fading) = ((speed - given).abs(), SWING * self.swing);
        self.swing = if ahead > fading { ahead } else { fading };
        self.emf_doubt = (EMF_DOUBT * speed.abs() + self.swing + (raw - speed).abs()) * self.back_emf.abs();
    }

    fn driven_by(&self, speed: f32) -> f32 {
        if self.resistance > 0.0 { self.back_emf * speed / self.resistance } else { 0.0 }
    }

    /// The part of the voltage that is in phase with the current: the inductance's part is a quarter of a turn off, and
    /// the back-EMF's is taken out.
    fn resistance_of(&self, voltage: [f32; 2], current: [f32; 2], angle: [f32; 2], rate: f32) -> Option<(f32, f32)> {
        // The function a cos + b sin has the derivative rate (b cos - a sin).
        let turning = [rate * angle[1], -rate * angle[0]];
        let left = [voltage[0] - self.back_emf * turning[0], voltage[1] - self.back_emf * turning[1]];
        let squared = current[0] * current[0] + current[1] * current[1];
        let file = self.doubt_resistance / RESISTANCE_DOUBT;
        (squared > 0.0).then(|| ((left[0] * current[0] + left[1] * current[1]) / squared, file))
    }

    #[inline(always)]
    fn duty(drive: Duty) -> f32 {
        drive.0
    }

    /// The loop's integrator is what such a motor would not need; where the bus leaves it no room, a current that
    /// stays behind says as much.
    #[inline(always)]
    fn strain(&self) -> (f32, f32, f32) {
        let strain = self.integrator + self.resistance * self.missing;
        let most = self.doubt + self.doubt_resistance * self.recent + self.emf_doubt;
        (strain, self.looked_at + self.emf_doubt, most)
    }

    fn doubt_from(&mut self, torque: f32) {
        // Without a sensor nothing is known of a current.
        if self.doubt < f32::INFINITY {
            self.looked_at = self.doubt.min((torque * self.amps_per_torque * self.resistance).abs());
        }
    }

    fn told_by_volts(&self) -> f32 {
        let strain = self.integrator + self.resistance * self.missing;
        let beyond = strain - limited(strain, self.emf_doubt);
        self.reached + if self.resistance > 0.0 { beyond / self.resistance } else { 0.0 }
    }

    /// More than the file's may be brushes. What they take is no winding's, and too much of it would hide a current.
    fn know_resistance(&mut self, ohms: f32) {
        self.resistance = self.resistance.min(ohms);
    }

    fn turning(&self, volts: f32) -> f32 {
        if self.back_emf.abs() > 1.0e-6 { volts / self.back_emf } else { 0.0 }
    }

    fn flows_as_expected(&self) -> bool {
        self.missing.abs() <= 0.25 * self.reached.abs() + DEAD_TIME_KNEE
    }

    fn rest(&mut self) {
        self.integrator = 0.0;
        self.reached = 0.0;
        self.expected = 0.0;
        self.error = 0.0;
        self.missing = 0.0;
        self.recent = 0.0;
        self.target = 0.0;
        self.emf_doubt = 0.0;
        self.swing = 0.0;
    }

    fn inherit(&mut self, other: &Self) {
        let Self { integrator, reached, expected, error, missing, recent, target, resistance, .. } = *other;
        *self = Self { integrator, reached, expected, error, missing, recent, target, ..*self };
        // What was measured of this motor stays known.
        if self.doubt_resistance == other.doubt_resistance {
            self.resistance = resistance;
        }
    }

    /// The voltage less the resistance's part is back-EMF, less the doubt: a winding half as resistive again (hot, or a
    /// poor contact) and the dead time.
    #[inline(always)]
    fn speed_of(&self, duty: f32, bus_voltage: f32, current: f32) -> f32 {
        let drop = self.resistance * current;
        let left = duty * bus_voltage - drop;
        let doubt = RESISTANCE_DOUBT * drop.abs() + self.dead_time_share * bus_voltage;
        let usable = self.back_emf.abs() > 1.0e-6 && left.abs() > doubt;
        if usable { (left - doubt * left.signum()) / self.back_emf } else { 0.0 }
    }
}

/// (eˣ - 1)/x for x ≥ 0, by its series: exact where x is small and, where it is large, at least so large that what is
/// divided by it hardly counts. Infinite for infinity.
fn growth(x: f32) -> f32 {
    (2..=9).rev().fold(1.0, |sum, n| 1.0 + x / n as f32 * sum)
}
