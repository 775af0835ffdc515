//! What one carrier period can show and must turn the motors off: looked for at every crest, whatever the control rate.
//!
//! Speed and power are made here from encoder counts, by a filter that no scene, gain or rate has a say in. Per motor
//! it is two subtractions, one multiply-add and a few comparisons of bit patterns whose signs are gathered; what is
//! wrong is found out only when something is.

use super::{Servo, for_joints};
use crate::drive::stage::Stage;
use crate::math::Math;
use crate::model::catalogue::MAX_JOINTS;
use crate::safety::fault::Fault;
use crate::safety::limits::{Limits, POWER_SECONDS};
use crate::servo::frame::{Outputs, Samples};
use crate::servo::joints::Counts;
use crate::servo::program::Program;
use core::ops::DerefMut;

/// Cutoff of the first-order filter behind speed and power limits, Hz: twice the speed limit is seen after 0.6 ms.
pub const SPEED_HZ: f32 = 200.0;
/// No limit makes that filter slower than this, Hz.
const SLOWEST_HZ: f32 = 5.0;
/// Largest share of the speed limit that a single count may look like: a coarse encoder is filtered for longer, until
/// the joint has moved by a few counts.
const COUNT_SHARE: f32 = 0.25;

/// What two current sensors may differ by: a share of the current limit (gains, settling at the edge of the duty) and
/// amperes (zeros, noise).
const IMBALANCE_SHARE: f32 = 0.15;
const IMBALANCE_FLOOR: f32 = 0.5;
/// Speed below which an encoder stands still, counts in a carrier period: one count in 1000 periods.
const STANDSTILL: f32 = 1.0e-3;

/// What a carrier period is held to, made ready whenever device, homing, rules or rate change.
#[derive(Clone, Copy, Debug, Default)]
struct Bounds {
    /// Most counts that a joint can move in a carrier period.
    jump: i32,
    /// Gain of the speed filter.
    gain: f32,
    /// Counts in a carrier period.
    speed: f32,
    /// First and last count of the joint's range, where it has one (all bits set, else none).
    first: i32,
    last: i32,
    limited: i32,
    /// Measured current that is not the loop's overshoot any more, A.
    current: f32,
    /// What two current sensors may differ by, A: anything where there are none.
    imbalance: f32,
    /// Speed of a count in a carrier period, rad/s, with its sign.
    radians: f32,
}

impl Bounds {
    /// Negative outside the joint's range.
    #[inline(always)]
    fn room(&self, count: i32) -> i32 {
        (count.wrapping_sub(self.first) | self.last.wrapping_sub(count)) & self.limited
    }
}

/// What the crests have shown.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Crests {
    bounds: [Bounds; MAX_JOINTS],
    primed: bool,
    counts: Counts,
    /// Filtered speeds, counts in a carrier period.
    speed: [f32; MAX_JOINTS],
    /// Squares of each motor's current since [`Crests::take_heat`], A².
    squares: [f32; MAX_JOINTS],
    /// Mean power into the hand, W.
    power: f32,
    power_gain: f32,
    /// s
    period: f32,
}

impl Crests {
    /// Forgets what was summed up while the motors were on the last time; what heated them stays.
    pub(super) fn anew(&mut self) {
        self.power = 0.0;
    }

    /// Speed of a joint, rad/s.
    #[inline(always)]
    pub(super) fn speed(&self, joint: usize) -> f32 {
        self.speed[joint] * self.bounds[joint].radians
    }

    /// That of the carrier, s.
    #[inline(always)]
    pub(super) fn period(&self) -> f32 {
        self.period
    }

    /// The integral of a motor's squared current since the last call, A² s.
    #[inline(always)]
    pub(super) fn take_heat(&mut self, joint: usize) -> f32 {
        core::mem::take(&mut self.squares[joint]) * self.period
    }
}

/// Negative when |`value`| exceeds `bound`, which is not negative, and when it is not a number. Bit patterns of
/// positive floats order like the floats, and signs of several such differences are gathered by OR: no branch, no flags
/// to move.
#[inline(always)]
pub(super) fn left(value: f32, bound: f32) -> i32 {
    bound.to_bits().wrapping_sub(value.abs().to_bits()) as i32
}

/// Negative when `value` is below `least`, which is not negative; not when it is no number.
#[inline(always)]
pub(super) fn left_from(value: f32, least: f32) -> i32 {
    let bits = value.to_bits();
    (bits | bits.wrapping_sub(least.to_bits())) as i32
}

/// Negative when |`moved`| exceeds `bound`, which is not negative: what wraps is as negative.
#[inline(always)]
fn left_of(moved: i32, bound: i32) -> i32 {
    bound.wrapping_sub(moved) | bound.wrapping_add(moved)
}

impl<P, K, S> Servo<P>
where
    P: DerefMut<Target = Program<K, S>>,
    K: Math<f32>,
    S: Stage,
{
    /// Makes the bounds ready: after anything they depend on has changed.
    pub(super) fn set_crest_bounds(&mut self) {
        let Some(program) = self.program.as_ref() else { return };
        let period = 1.0 / program.carrier_hz.max(1.0);
        self.crests.period = period;
        self.crests.power_gain = period / POWER_SECONDS;
        let zero = program.controller.zero();
        for (i, zero) in zero.into_iter().enumerate() {
            let scale = program.radians_per_count[i];
            let size = scale.abs().max(f32::MIN_POSITIVE);
            let speed = self.rules.limits.speed[i].max(0.0) * period / size;
            let axis = &program.axes[i];
            let range = range(program.limits[i], scale, program.offsets[i], zero);
            let (first, last) = range.unwrap_or_default();
            self.crests.bounds[i] = Bounds {
                // Five times the speed limit is no motion any more, and more than noise of a count no noise.
                jump: ((5.0 * speed) as i32).max(4),
                gain: (core::f32::consts::TAU * SPEED_HZ * period)
                    .min((COUNT_SHARE * speed).max(core::f32::consts::TAU * SLOWEST_HZ * period)),
                speed,
                first,
                last,
                limited: if range.is_some() { -1 } else { 0 },
                // The loop may overshoot a little; half again as much as the limit is not the loop.
                current: 1.5 * axis.max_current() + 1.0,
                imbalance: if self.hardware.bridge.current_sensed {
                    IMBALANCE_SHARE * axis.max_current() + IMBALANCE_FLOOR
                } else {
                    f32::INFINITY
                },
                radians: scale * program.carrier_hz,
            };
        }
    }

    /// Whether the bridges may go on driving after what this crest shows in counts, currents and supply. It leaves the
    /// index pulses and reported faults of `seen` to the control step. Call at every crest, before [`Servo::act`] where
    /// a step is due and before [`Servo::duties`].
    #[inline(always)]
    pub fn guard(&mut self, seen: &Samples) -> Outputs {
        for_joints!(self.joints(), J => self.guard_of::<J>(seen))
    }

    /// [`Servo::guard`] of J joints.
    #[inline(always)]
    pub(super) fn guard_of<const J: usize>(&mut self, seen: &Samples) -> Outputs {
        let Some(program) = self.program.as_mut() else { return Outputs { bridges: false } };
        let active = self.state.drives();
        let (crests, motors) = (&mut self.crests, &self.now.motors);
        if !crests.primed {
            crests.counts = seen.counts;
            crests.primed = true;
        }
        let currents = if self.hardware.bridge.current_sensed { &seen.currents } else { &motors.current };
        // Negative as soon as something is beyond its bound.
        let mut least = 0;
        let mut power = 0.0;
        let before = crests.counts;
        #[allow(clippy::needless_range_loop, reason = "one number for ten arrays")]
        for i in 0..J {
            let bounds = &crests.bounds[i];
            let moved = seen.counts[i].wrapping_sub(before[i]);
            least |= left_of(moved, bounds.jump);
            let raw = moved as f32;
            crests.speed[i] += bounds.gain * (raw - crests.speed[i]);
            let speed = crests.speed[i] * bounds.radians;
            let axis = &mut program.axes[i];
            axis.follow(speed, raw * bounds.radians);
            if active {
                // Of bridges that float only noise is measured.
                crests.squares[i] += currents[i] * currents[i];
                let (strain, doubt) = axis.strain();
                least |= left(crests.speed[i], bounds.speed)
                    | bounds.room(seen.counts[i])
                    | left(currents[i], bounds.current)
                    | left(seen.imbalance[i], bounds.imbalance)
                    | left(strain, doubt);
                power += motors.torque[i] * speed;
            }
        }
        crests.counts = seen.counts;
        if active {
            // Mean power into the hand: what the torques do on the joints.
            crests.power += (power - crests.power) * crests.power_gain;
            least |= if crests.power <= self.rules.limits.power { 0 } else { -1 };
            if self.hardware.bus_sensed {
                let Limits { bus_min, bus_max, .. } = &self.rules.limits;
                least |= left(seen.bus_voltage, *bus_max) | left_from(seen.bus_voltage, *bus_min);
            }
        }
        if least < 0 {
            self.find_at_crest(seen, &before, active);
        }
        self.outputs()
    }

    /// Something is not well: finds out what comes first, and turns the motors off.
    #[cold]
    #[inline(never)]
    fn find_at_crest(&mut self, seen: &Samples, before: &Counts, active: bool) {
        let Some(program) = self.program.as_ref() else { return };
        let joints = program.joints.min(MAX_JOINTS);
        let mut found = None;
        let mut note = |wrong: bool, fault: Fault, axis: Option<usize>, value: f32| {
            if wrong && found.is_none() {
                found = Some((fault, axis.map(|i| i as u8), value));
            }
        };
        let (crests, bus) = (&self.crests, seen.bus_voltage);
        let sensed = self.hardware.bridge.current_sensed;
        let current = |i: usize| if sensed { seen.currents[i] } else { self.now.motors.current[i] };
        for i in 0..joints {
            // No number first: it makes every comparison below meaningless.
            note(active && !current(i).is_finite(), Fault::NotFinite, Some(i), current(i));
        }
        note(active && self.hardware.bus_sensed && !bus.is_finite(), Fault::NotFinite, None, bus);
        for (i, bounds) in crests.bounds.iter().enumerate().take(joints) {
            let moved = seen.counts[i].wrapping_sub(before[i]);
            note(left_of(moved, bounds.jump) < 0, Fault::EncoderJump, Some(i), moved as f32);
            if active {
                note(left(crests.speed[i], bounds.speed) < 0, Fault::SpeedLimit, Some(i), crests.speed(i));
                let out = bounds.room(seen.counts[i]) < 0;
                note(out, Fault::JointLimit, Some(i), self.angle(i, seen.counts[i]));
                note(left(current(i), bounds.current) < 0, Fault::OverCurrent, Some(i), current(i));
            }
            if active && sensed {
                let differ = left(seen.imbalance[i], bounds.imbalance) < 0;
                note(differ, Fault::CurrentSensor, Some(i), seen.imbalance[i]);
                let axis = &program.axes[i];
                let (strain, doubt) = axis.strain();
                let strained = left(strain, doubt) < 0;
                // A current as it should be and a voltage that only motion explains: the encoder is what stands still.
                let unseen = axis.flows_as_expected() && crests.speed[i].abs() < STANDSTILL;
                note(strained && unseen, Fault::EncoderLoss, Some(i), axis.turning(strain));
                note(strained, Fault::MotorModel, Some(i), strain);
            }
        }
        if active {
            let limits = &self.rules.limits;
            note(crests.power > limits.power || crests.power.is_nan(), Fault::PowerLimit, None, crests.power);
            if self.hardware.bus_sensed {
                note(bus < limits.bus_min, Fault::BusUnderVoltage, None, bus);
                note(bus > limits.bus_max, Fault::BusOverVoltage, None, bus);
            }
        }
        if let Some((fault, axis, value)) = found {
            self.trip(fault, axis, value);
        }
    }

    /// Angle (rad) of a joint at a count.
    fn angle(&self, joint: usize, count: i32) -> f32 {
        let Some(program) = self.program.as_ref() else { return 0.0 };
        let relative = count.wrapping_sub(program.controller.zero()[joint]);
        relative as f32 * program.radians_per_count[joint] + program.offsets[joint]
    }
}

/// A joint's range as counts, rounded outward by less than one; `None` without limits.
fn range(limits: Option<(f32, f32)>, radians_per_count: f32, offset: f32, zero: i32) -> Option<(i32, i32)> {
    let (low, high) = limits?;
    let ends = [low, high].map(|angle| (angle - offset) / radians_per_count);
    let (first, last) = (ends[0].min(ends[1]), ends[0].max(ends[1]));
    // An end further away than half of what counts can tell apart is none; the other one still is.
    let most = i32::MAX as f32 * 0.25;
    let within = |end: f32| end.clamp(-most, most);
    Some((zero.wrapping_add(below(within(first))), zero.wrapping_add(-below(-within(last)))))
}

/// The largest whole number that is not above `value`.
fn below(value: f32) -> i32 {
    let whole = value as i32;
    if (whole as f32) > value { whole - 1 } else { whole }
}
