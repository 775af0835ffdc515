//! The checks at a crest of the carrier, which turn the motors off at any control rate. On the board,
//! `ControlLoop::crest_of` does the entire work of a crest in one pass.
//!
//! Speed and power come from encoder counts through a filter that no scene, gain or rate changes. A sample is checked
//! by a few comparisons of bit patterns whose signs are combined; the fault is identified only if one of them fails.

use super::ControlLoop;
use super::absolute::ANGLE_NOISE;
use super::budgets::Sums;
use super::polarity::stops::HOMING_MARGIN;
use crate::control::frame::Samples;
use crate::control::program::Program;
use crate::drive::bits::{margin_bits, margin_bits_between, margin_counts};
use crate::drive::stage::{BUS_VOLTAGE, Stage, Supply};
use crate::math::{Math, Real, clamp, floor_to_i32};
use crate::model::catalogue::MAX_JOINTS;
use crate::model::description::Homing;
use crate::safety::fault::{Fault, State};
use crate::safety::limits::POWER_SECONDS;
use core::ops::DerefMut;

/// Cutoff of the first-order filter for speed and power limits, Hz. Twice the speed limit is detected after 0.6 ms.
pub const SPEED_FILTER_HZ: f32 = 200.0;
/// Lowest cutoff of the filter for speed and power limits, Hz.
const MIN_SPEED_FILTER_HZ: f32 = 5.0;
/// Largest share of the speed limit that a single count may appear as. A coarse encoder is filtered for longer, until
/// the joint has moved by a few counts.
const MAX_COUNT_SPEED_SHARE: f32 = 0.25;
/// Largest change of the torque by a single count when back-EMF is fed forward, as a share of the torque limit.
const MAX_COUNT_TORQUE_SHARE: f32 = 1.0 / 32.0;
/// Largest difference of two current sensors as a share of the current limit, from their gains and settling times.
const IMBALANCE_SHARE: f32 = 0.15;
/// Largest difference of two current sensors at zero current, A, from their zeros and noise.
const IMBALANCE_FLOOR: f32 = 0.5;
/// Speed below which an encoder stands still, in counts per carrier period: one count in 1000 periods.
const STANDSTILL_SPEED: f32 = 1.0e-3;

/// Number that [`ControlLoop::one_pass_joints`] adds to the joints of a device with three-phase motors.
pub(super) const PHASES_PASS: u8 = 4;

/// A joint and its motor. The fields are contiguous in the order of a crest, so that one address reaches every field.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C)]
pub(super) struct Joint<S> {
    /// Count at the previous crest.
    count: i32,
    /// Filtered speed, counts per carrier period.
    speed: f32,
    /// Speed for the back-EMF's feed-forward, with a slower filter, counts per carrier period.
    steady_speed: f32,
    /// Unfiltered speed of the last carrier period, counts per carrier period.
    unfiltered_speed: f32,
    bounds: Bounds,
    pub(super) stage: S,
    pub(super) sums: Sums,
}

/// The bounds of a joint, recomputed whenever device, homing, rules or rate change.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C)]
struct Bounds {
    /// Largest motion in a carrier period, counts.
    max_jump: i32,
    gain: f32,
    /// Gain of the filter for back-EMF.
    steady_gain: f32,
    /// Speed limit, counts per carrier period.
    speed: f32,
    /// Speed of one count per carrier period, rad/s, with its sign.
    radians: f32,
    /// First and last count of the joint's range. They apply if `has_range`.
    first: i32,
    last: i32,
    has_range: bool,
    /// Largest accepted measured current, A, above any overshoot of the current loop.
    current: f32,
    /// Largest difference of two current sensors, A.
    imbalance: f32,
}

impl Bounds {
    /// Returns a negative number if `count` is outside the joint's range.
    #[inline(always)]
    fn range_margin(&self, count: i32) -> i32 {
        count.wrapping_sub(self.first) | self.last.wrapping_sub(count)
    }
}

impl<S: Stage> Joint<S> {
    /// Stores the count of a crest and updates the speeds. Returns a negative number if the count jumped.
    #[inline(always)]
    fn update_count(&mut self, count: i32) -> i32 {
        let moved = count.wrapping_sub(self.count);
        self.unfiltered_speed = moved as f32;
        self.speed += self.bounds.gain * (self.unfiltered_speed - self.speed);
        self.steady_speed += self.bounds.steady_gain * (self.unfiltered_speed - self.steady_speed);
        margin_counts(moved, self.bounds.max_jump)
    }

    /// Returns a negative number if speed or current is beyond its bound.
    #[inline(always)]
    fn margin(&self, current: f32, imbalance: f32) -> i32 {
        margin_bits(self.speed, self.bounds.speed)
            | margin_bits(current, self.bounds.current)
            | margin_bits(imbalance, self.bounds.imbalance)
    }

    /// Returns a negative number if the joint has a range and the count is outside.
    fn range_margin(&self, count: i32) -> i32 {
        if self.bounds.has_range { self.bounds.range_margin(count) } else { 0 }
    }

    /// Returns the count at the previous crest.
    pub(super) fn count(&self) -> i32 {
        self.count
    }

    /// Sets the count at the previous crest, so that the next crest shows no motion from another count.
    pub(super) fn start_at(&mut self, count: i32) {
        self.count = count;
    }

    /// Returns true if the joint can move by these counts in a carrier period.
    pub(super) fn can_move(&self, counts: i32) -> bool {
        margin_counts(counts, self.bounds.max_jump) >= 0
    }

    /// Returns the motion of the next carrier period at the present speed, within the speed limit, counts.
    pub(super) fn expected_motion(&self) -> i32 {
        floor_to_i32(clamp(self.speed, self.bounds.speed) + 0.5)
    }

    pub(super) fn is_limited(&self) -> bool {
        self.bounds.has_range
    }

    /// Returns the speed, rad/s.
    #[inline(always)]
    pub(super) fn speed(&self) -> f32 {
        self.speed * self.bounds.radians
    }

    /// Returns the speed for the back-EMF's feed-forward, rad/s.
    #[inline(always)]
    pub(super) fn steady_speed(&self) -> f32 {
        self.steady_speed * self.bounds.radians
    }

    /// Updates the motor model with the last drive and the bus voltage (V), and returns [`Stage::strain`].
    #[inline(always)]
    pub(super) fn settle(&mut self, bus_voltage: f32) -> (f32, f32, f32) {
        let (speed, raw) = (self.speed(), self.unfiltered_speed * self.bounds.radians);
        self.stage.settle(bus_voltage, self.steady_speed(), speed, raw);
        self.stage.strain()
    }

    pub(super) fn stands_still(&self) -> bool {
        self.speed.abs() < STANDSTILL_SPEED
    }
}

/// The reason why a crest is unusual.
#[derive(Clone, Copy, Debug)]
enum UnusualCrest {
    /// The samples of the crest are beyond a bound.
    Crest,
    /// The step has begun and must be checked for a fault.
    Step,
    /// The scene is not in force, or limits cut the scene's torques in this step or the previous step.
    Torques,
}

/// Bounds and sums of a crest that all joints share.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Crests {
    /// True after the first crest.
    has_run: bool,
    /// Lowest and highest bus voltage, V.
    bus: (f32, f32),
    /// Mean power into the hand and its limit, W.
    power: f32,
    max_power: f32,
    power_gain: f32,
    /// Carrier period, s.
    pub(super) period: f32,
}

impl Crests {
    /// Clears the mean power of the previous armed time.
    pub(super) fn reset(&mut self) {
        self.power = 0.0;
    }

    /// Averages the present power into the hand (W), and returns true if the mean is within its limit.
    #[inline(always)]
    fn allows_power(&mut self, power: f32) -> bool {
        self.power += (power - self.power) * self.power_gain;
        self.power <= self.max_power
    }
}

impl<P, K, S> ControlLoop<P, S>
where
    P: DerefMut<Target = Program<K, S>>,
    K: Math<f32>,
    S: Stage,
{
    /// Sets the bounds that all joints share. Call after a change of device, rules or rate.
    pub(super) fn set_crest_bounds(&mut self) {
        let Some(program) = self.program.as_ref() else { return };
        let limits = &self.rules.limits;
        let period = 1.0 / program.carrier_hz.max(1.0);
        self.crests.period = period;
        self.flow.set_period(period);
        self.crests.power_gain = period / POWER_SECONDS;
        self.crests.max_power = limits.power;
        self.crests.bus = if self.hardware.bus_sensed {
            (limits.bus_min.max(BUS_VOLTAGE.0), limits.bus_max.min(BUS_VOLTAGE.1))
        } else {
            (0.0, f32::MAX)
        };
    }

    /// Sets the joints' ranges, which include the stops during homing. Call after a change of device or homing.
    pub(super) fn set_ranges(&mut self) {
        let Some(program) = self.program.as_ref() else { return };
        let zero = program.controller.zero();
        for (i, (joint, zero)) in self.joints.iter_mut().zip(*zero).enumerate() {
            let limits = match program.homing {
                Homing::Stop(stops) if self.state == State::Homing => {
                    let margin = program.lever[i] * HOMING_MARGIN;
                    program.limits[i]
                        .map(|(low, high)| (low.lesser(stops[i]) - margin, high.greater(stops[i]) + margin))
                }
                _ => program.limits[i],
            };
            let range = range(limits, program.radians_per_count[i], program.offsets[i], zero);
            joint.bounds.has_range = range.is_some();
            (joint.bounds.first, joint.bounds.last) = range.unwrap_or_default();
        }
    }

    /// Sets the bounds of joint `i` other than its range.
    pub(super) fn set_crest_bounds_of(&mut self, i: usize) {
        let (Some(program), Some(joint)) = (self.program.as_ref(), self.joints.get_mut(i)) else { return };
        let period = self.crests.period;
        let scale = program.radians_per_count[i];
        let size = scale.abs().max(f32::MIN_POSITIVE);
        let speed = self.rules.limits.speed[i].max(0.0) * program.lever[i] * period / size;
        let max_current = joint.stage.max_current();
        let gain = (core::f32::consts::TAU * SPEED_FILTER_HZ * period)
            .min((MAX_COUNT_SPEED_SHARE * speed).max(core::f32::consts::TAU * MIN_SPEED_FILTER_HZ * period));
        // Torque of one count if its back-EMF were fed forward for a complete carrier period.
        let kick = joint.stage.torque_of(joint.stage.back_emf_current(size / period)).abs();
        joint.bounds = Bounds {
            // A real motion is slower than five times the speed limit, and noise is less than four counts.
            max_jump: ((5.0 * speed) as i32).max(if program.absolute[i] { ANGLE_NOISE } else { 4 }),
            gain,
            // The current loop removes the back-EMF that a slower filter leaves.
            steady_gain: gain.min(MAX_COUNT_TORQUE_SHARE * self.max_joint_torque[i] / kick),
            speed,
            radians: scale * program.carrier_hz,
            // The loop overshoots by less than half of the limit.
            current: 1.5 * max_current + 1.0,
            imbalance: IMBALANCE_SHARE * max_current + IMBALANCE_FLOOR,
            ..joint.bounds
        };
    }

    /// Runs a crest with a due control step in one pass, for J joints on a board that senses currents and bus voltage.
    /// Checks the samples, commands the torques that [`ControlLoop::render`] computed, and writes the next drives
    /// `into` `legs`. Returns false if the motors are off now.
    ///
    /// Call if [`ControlLoop::one_pass_joints`] is J, or with `PHASES` if it is J + [`PHASES_PASS`]. Computes the same as
    /// [`ControlLoop::crest_of_any_kind`].
    #[inline(always)]
    pub(super) fn crest_of<const J: usize, const PHASES: bool, L>(
        &mut self,
        seen: &Samples,
        samples: &[S::Sample; MAX_JOINTS],
        into: &impl Fn(S::Drive) -> L,
        legs: &mut [L; MAX_JOINTS],
    ) -> bool {
        if !self.check_samples_of::<J>(seen) {
            return self.finish_unusual_crest::<J, PHASES, L>(UnusualCrest::Crest, seen, samples, into, legs);
        }
        for (joint, count) in self.joints.iter_mut().zip(seen.counts.iter()).take(J) {
            joint.count = *count;
        }
        self.begin_step();
        let watched = self.watch::<J>();
        if self.steady | watched < 0 || self.fits::<J>() < 0 {
            let unusual = if watched < 0 { UnusualCrest::Step } else { UnusualCrest::Torques };
            return self.finish_unusual_crest::<J, PHASES, L>(unusual, seen, samples, into, legs);
        }
        self.command_unlimited::<J>();
        let supply = Supply::of(seen.bus_voltage);
        if seen.late {
            return self.drive_unusually::<J, PHASES, L>(&supply, true, samples, into, legs);
        }
        self.drive_all::<J, PHASES, L>(&supply, false, samples, into, legs)
    }

    #[cold]
    #[inline(never)]
    fn finish_unusual_crest<const J: usize, const PHASES: bool, L>(
        &mut self,
        unusual: UnusualCrest,
        seen: &Samples,
        samples: &[S::Sample; MAX_JOINTS],
        into: &impl Fn(S::Drive) -> L,
        legs: &mut [L; MAX_JOINTS],
    ) -> bool {
        match unusual {
            UnusualCrest::Torques if self.in_force && self.finite_margin::<J>() >= 0 => self.command_limited::<J>(),
            UnusualCrest::Torques | UnusualCrest::Step => self.slow_step(seen),
            UnusualCrest::Crest => {
                self.find_at_crest(seen);
                self.store_counts(seen);
                self.step(seen);
            }
        }
        let supply = Supply::of(seen.bus_voltage);
        if self.state.drives() && supply.is_usable() {
            self.drive_voltage = seen.bus_voltage;
            return self.drive_unusually::<J, PHASES, L>(&supply, seen.late, samples, into, legs);
        }
        self.drive(seen.bus_voltage, samples, seen.late, into, legs)
    }

    /// Drives the legs of J joints after an unusual step or with late duties.
    #[inline(never)]
    fn drive_unusually<const J: usize, const PHASES: bool, L>(
        &mut self,
        supply: &Supply,
        late: bool,
        samples: &[S::Sample; MAX_JOINTS],
        into: &impl Fn(S::Drive) -> L,
        legs: &mut [L; MAX_JOINTS],
    ) -> bool {
        self.drive_all::<J, PHASES, L>(supply, late, samples, into, legs)
    }

    /// Drives the legs of J joints while the motors are on and the supply is usable.
    #[inline(always)]
    fn drive_all<const J: usize, const PHASES: bool, L>(
        &mut self,
        supply: &Supply,
        late: bool,
        samples: &[S::Sample; MAX_JOINTS],
        into: &impl Fn(S::Drive) -> L,
        legs: &mut [L; MAX_JOINTS],
    ) -> bool {
        #[allow(clippy::needless_range_loop, reason = "one number for four arrays")]
        for i in 0..J {
            let joint = &mut self.joints[i];
            let drive = match PHASES {
                true => Some(drive_one(joint, supply, samples[i], late)),
                false => joint.stage.drive_in_range(supply, samples[i], joint.steady_speed(), late),
            };
            let Some(drive) = drive else {
                return self.drive_rest(i, supply, late, samples, into, legs);
            };
            self.now.motors.duty[i] = S::duty(drive);
            legs[i] = into(drive);
        }
        true
    }

    /// Drives the legs of joint `from` and later joints, if joint `from` needs the slower path.
    #[cold]
    #[inline(never)]
    fn drive_rest<L>(
        &mut self,
        from: usize,
        supply: &Supply,
        late: bool,
        samples: &[S::Sample; MAX_JOINTS],
        into: &impl Fn(S::Drive) -> L,
        legs: &mut [L; MAX_JOINTS],
    ) -> bool {
        let joints = self.count();
        let motors = self.joints.iter_mut().zip(self.now.motors.duty.iter_mut()).zip(samples).zip(legs);
        for (((joint, duty), sample), legs) in motors.take(joints).skip(from) {
            let drive = drive_one(joint, supply, *sample, late);
            (*duty, *legs) = (S::duty(drive), into(drive));
        }
        true
    }

    /// Returns true if all samples of J joints at the crest are within their bounds.
    #[inline(always)]
    fn check_samples_of<const J: usize>(&mut self, seen: &Samples) -> bool {
        let mut least = margin_bits_between(seen.bus_voltage, self.crests.bus);
        let mut power = None;
        for (i, joint) in self.joints.iter_mut().enumerate().take(J) {
            least |= joint.update_count(seen.counts[i]);
            least |= joint.bounds.range_margin(seen.counts[i]) | joint.margin(seen.currents[i], seen.imbalance[i]);
            let share = self.now.motors.torque[i] * joint.speed();
            power = Some(power.map_or(share, |sum| sum + share));
        }
        let power = power.unwrap_or(0.0);
        let allowed = self.crests.allows_power(power);
        least >= 0 && allowed
    }

    /// Runs a crest in any state, with or without a `due` control step, and with duties in time or late.
    #[cold]
    #[inline(never)]
    pub(super) fn crest_of_any_kind<L>(
        &mut self,
        seen: &Samples,
        samples: &[S::Sample; MAX_JOINTS],
        due: bool,
        into: &impl Fn(S::Drive) -> L,
        legs: &mut [L; MAX_JOINTS],
    ) -> bool {
        self.check_samples(seen);
        if due {
            self.step(seen);
        }
        self.drive(seen.bus_voltage, samples, seen.late, into, legs)
    }

    /// Replaces the currents of three-phase motors by their torque currents, see [`Stage::read`]. Call once per crest
    /// with the board's readings, before every other use of the samples.
    #[inline(always)]
    pub fn read_phases(&mut self, seen: &mut Samples) {
        let Samples { counts, currents, imbalance, .. } = seen;
        let readings = currents.iter_mut().zip(imbalance.iter_mut()).zip(counts.iter());
        for (joint, ((current, imbalance), count)) in self.joints.iter_mut().zip(readings) {
            if joint.stage.is_three_phase() {
                (*current, *imbalance) = joint.stage.read(*current, *imbalance, *count);
            }
        }
    }

    /// Checks the samples of a crest. While the motors are off, only encoders are checked, and only for jumps.
    pub(super) fn check_samples(&mut self, seen: &Samples) {
        if !core::mem::replace(&mut self.crests.has_run, true) {
            self.store_counts(seen);
        }
        let joints = self.count();
        let (mut least, mut most, mut power) = (0, margin_bits_between(seen.bus_voltage, self.crests.bus), 0.0);
        for (i, joint) in self.joints.iter_mut().enumerate().take(joints) {
            least |= joint.update_count(seen.counts[i]);
            most |= joint.range_margin(seen.counts[i]) | joint.margin(seen.currents[i], seen.imbalance[i]);
            power += self.now.motors.torque[i] * joint.speed();
        }
        if self.state.drives() {
            least |= if self.crests.allows_power(power) { most } else { -1 };
        }
        if least < 0 {
            self.find_at_crest(seen);
        }
        self.store_counts(seen);
    }

    fn store_counts(&mut self, seen: &Samples) {
        for (joint, count) in self.joints.iter_mut().zip(seen.counts.iter()) {
            joint.count = *count;
        }
    }

    /// Finds the first fault of a crest, and turns the motors off.
    #[cold]
    #[inline(never)]
    fn find_at_crest(&mut self, seen: &Samples) {
        let active = self.state.drives();
        let mut found = None;
        let mut note = |wrong: bool, fault: Fault, axis: Option<usize>, value: f32| {
            if wrong && found.is_none() {
                found = Some((fault, axis.map(|i| i as u8), value));
            }
        };
        let (crests, bus) = (&self.crests, seen.bus_voltage);
        let joints = || self.joints.iter().enumerate().take(self.count());
        for (i, _) in joints() {
            // NaN is checked first because it makes every comparison below meaningless.
            note(active && !seen.currents[i].is_finite(), Fault::NotFinite, Some(i), seen.currents[i]);
        }
        note(active && !bus.is_finite(), Fault::NotFinite, None, bus);
        for (i, joint) in joints() {
            let (bounds, count, current) = (&joint.bounds, seen.counts[i], seen.currents[i]);
            let moved = count.wrapping_sub(joint.count);
            note(margin_counts(moved, bounds.max_jump) < 0, Fault::EncoderJump, Some(i), moved as f32);
            if active {
                note(margin_bits(joint.speed, bounds.speed) < 0, Fault::SpeedLimit, Some(i), joint.speed());
                note(joint.range_margin(count) < 0, Fault::JointLimit, Some(i), self.angle(i, count));
                note(margin_bits(current, bounds.current) < 0, Fault::OverCurrent, Some(i), current);
                let imbalance = seen.imbalance[i];
                note(margin_bits(imbalance, bounds.imbalance) < 0, Fault::CurrentSensor, Some(i), imbalance);
            }
        }
        if active {
            let power = crests.power;
            note(power > crests.max_power || power.is_nan(), Fault::PowerLimit, None, power);
            note(bus < crests.bus.0, Fault::BusUnderVoltage, None, bus);
            note(bus > crests.bus.1, Fault::BusOverVoltage, None, bus);
        }
        if let Some((fault, axis, value)) = found {
            self.trip(fault, axis, value);
        }
    }

    /// Returns the angle (rad) of a joint at a count.
    pub(super) fn angle(&self, joint: usize, count: i32) -> f32 {
        let Some(program) = self.program.as_ref() else { return 0.0 };
        let relative = count.wrapping_sub(program.controller.zero()[joint]);
        relative as f32 * program.radians_per_count[joint] + program.offsets[joint]
    }
}

/// Returns the drive of one motor's legs from a usable supply.
#[inline(always)]
pub(super) fn drive_one<S: Stage>(joint: &mut Joint<S>, supply: &Supply, sample: S::Sample, late: bool) -> S::Drive {
    let speed = joint.steady_speed();
    let easily = match joint.stage.is_three_phase() {
        true => None,
        false => joint.stage.drive_in_range(supply, sample, speed, late),
    };
    easily.unwrap_or_else(|| joint.stage.drive(supply, sample, speed, late))
}

/// Returns a joint's range in counts, rounded outward by less than one count; `None` without limits.
fn range(limits: Option<(f32, f32)>, radians_per_count: f32, offset: f32, zero: i32) -> Option<(i32, i32)> {
    let (low, high) = limits?;
    let ends = [low, high].map(|angle| (angle - offset) / radians_per_count);
    let (first, last) = (ends[0].min(ends[1]), ends[0].max(ends[1]));
    // Ends are clamped because differences of counts wrap: beyond half of the counter's range, a joint far outside its
    // limits would appear to be inside them.
    let most = i32::MAX as f32 * 0.25;
    let within = |end: f32| end.clamp(-most, most);
    Some((zero.wrapping_add(floor_to_i32(within(first))), zero.wrapping_add(-floor_to_i32(-within(last)))))
}

#[test]
fn joint_limits_hold_beyond_a_quarter_of_the_counter() {
    for zero in [0, 12_345, i32::MAX, i32::MIN] {
        let (first, last) = range(Some((-1.0e9, 1.0e9)), 1.0e-3, 0.0, zero).expect("limits");
        let bounds = Bounds { first, last, ..Bounds::default() };
        let within = |relative: i32| bounds.range_margin(zero.wrapping_add(relative)) >= 0;
        let quarter = i32::MAX / 4 + 1;
        assert!(within(quarter) && within(-quarter));
        let beyond = [quarter + 1, i32::MAX / 2, i32::MAX, i32::MIN, i32::MIN / 2, -quarter - 1];
        assert!(!beyond.into_iter().any(within), "from {first} to {last}");
    }
}
