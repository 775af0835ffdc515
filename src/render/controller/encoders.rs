//! Encoder counts in; joint angles and velocities out.

use super::regularity::{FULL_REGULARITY, KNOWN_TURN};
use crate::math::{Angle, BinaryAngle, Real};
use crate::model::device::{Device, Joint};
use crate::render::velocity::{Coefficients, LowPass};
use nalgebra::SVector;

/// The reading of one joint.
#[derive(Clone, Copy, Debug)]
struct Encoding<T> {
    radians_per_count: T,
    offset: T,
    /// Angular velocity of one count per control period, rad/s.
    speed_per_count: T,
    binary: Binary,
    /// Counts after which the angle repeats, and the turns that they make.
    period: i32,
    turns: i32,
    /// Joint angle per count and turn of the period, rad: one turn is `period` of these parts.
    radians_per_part: T,
    /// Counts from zero up to which no whole turn has to be taken off.
    counts_unturned: u32,
}

/// Counts as binary angles.
#[derive(Clone, Copy, Debug)]
struct Binary {
    /// Parts of a turn in a count: whole ones, and the rest in parts of 2³², at most half a part either way. Over the whole
    /// range of the counter that is off by less than a part.
    whole: u32,
    rest: i32,
    /// The angle at count zero.
    offset: BinaryAngle,
}

impl Binary {
    /// `period` counts make so many `turns`; where they make none, one count makes `radians`. `offset` in rad.
    fn new(period: i32, turns: i32, radians: f64, offset: f64) -> Self {
        // In parts of 2³² of a part.
        let of_a_count = match (u64::try_from(period), u64::try_from(turns)) {
            (Ok(period), Ok(turns)) if period > 0 && turns > 0 => {
                let (whole, left) = ((turns << 32) / period, (turns << 32) % period);
                let size = (whole << 32).wrapping_add(((left << 32) + period / 2) / period) as i64;
                if radians < 0.0 { size.wrapping_neg() } else { size }
            }
            _ => (radians * (18_446_744_073_709_551_616.0 / core::f64::consts::TAU)) as i64,
        };
        let rest = of_a_count as i32;
        let whole = (of_a_count.wrapping_sub(i64::from(rest)) >> 32) as u32;
        Self { whole, rest, offset: BinaryAngle::of_radians(offset) }
    }

    /// The angle of so many counts: a multiplication for each half, no division, and no turn to take off.
    #[inline(always)]
    fn of(&self, counts: i32) -> BinaryAngle {
        let rest = (i64::from(counts) * i64::from(self.rest)) >> 32;
        BinaryAngle(self.offset.0.wrapping_add((counts as u32).wrapping_mul(self.whole)).wrapping_add(rest as u32))
    }
}

impl<T: Real> Encoding<T> {
    /// `rate` in Hz. `periodic`: whole turns are the same pose.
    fn new(joint: &Joint<T>, rate: T, periodic: bool) -> Self {
        let scale = joint.radians_per_count;
        let period = joint.counts_per_turn;
        let turns = T::from_i32(period) * scale.abs() * T::from_f64(1.0 / core::f64::consts::TAU) + T::from_f64(0.5);
        let turns = turns.whole();
        let repeats = periodic && period > 0 && turns > 0;
        Self {
            radians_per_count: scale,
            speed_per_count: scale * rate,
            binary: Binary::new(if repeats { period } else { 0 }, turns, scale.to_f64(), joint.offset.to_f64()),
            period,
            turns,
            radians_per_part: if repeats { scale / T::from_i32(turns) } else { scale },
            counts_unturned: period.checked_div(turns).filter(|_| repeats).map_or(u32::MAX, i32::unsigned_abs),
            offset: joint.offset,
        }
    }

    /// The angle of so many counts, offset aside and whole turns taken off (rad): exact but for two or three roundings
    /// of what is left, however many turns there were.
    #[inline(always)]
    fn within_a_turn(&self, relative: i32) -> T {
        if self.turns == 1 {
            T::from_i32(relative.checked_rem(self.period).unwrap_or(relative)) * self.radians_per_count
        } else {
            self.within_a_fractional_turn(relative)
        }
    }

    /// A turn of p/q counts is p parts of 1/q count: n counts are n q parts, and whole turns of p come off exactly.
    #[cold]
    #[inline(never)]
    fn within_a_fractional_turn(&self, relative: i32) -> T {
        let parts = i64::from(relative) * i64::from(self.turns);
        // Smaller than the period, so it fits.
        let left = parts.checked_rem(i64::from(self.period)).unwrap_or(0) as i32;
        T::from_i32(left) * self.radians_per_part
    }
}

/// The encoders of N joints, and what their counts were.
#[derive(Clone, Debug)]
pub(super) struct Encoders<T: Real, const N: usize> {
    joints: [Encoding<T>; N],
    zero: [i32; N],
    last: [i32; N],
    filters: [LowPass<T>; N],
    /// Gain of the filters where only guard and telemetry look at them.
    watch: T,
    /// The largest velocity that the estimate shows of one single count, rad/s.
    one_count: [T; N],
    /// Slower than this all velocity terms act, whatever the pose, rad/s.
    sure: T,
    /// True if something is rendered or compensated with joint velocities.
    moving: bool,
}

impl<T: Real, const N: usize> Encoders<T, N> {
    /// For a control rate in Hz. `periodic`: whole turns are the same pose. `moving`: something is rendered with the
    /// velocities.
    #[inline(never)]
    pub fn new(device: &Device<T>, coefficients: &Coefficients<T>, periodic: bool, moving: bool) -> Self {
        let mut encoders = Self {
            joints: core::array::from_fn(|i| Encoding::new(&device.joints[i], coefficients.rate(), periodic)),
            zero: [0; N],
            last: [0; N],
            filters: [LowPass::default(); N],
            watch: T::zero(),
            one_count: [T::zero(); N],
            sure: T::zero(),
            moving,
        };
        encoders.retune(coefficients);
        encoders
    }

    /// Joint angles (rad), and the same for the mechanism's sines, whole turns taken off.
    #[inline(always)]
    pub fn angles(&self, counts: &[i32; N]) -> (SVector<T, N>, [Angle<T>; N]) {
        let mut q = SVector::zeros();
        let mut angles = [Angle::of_radians(T::zero()); N];
        for i in 0..N {
            let joint = &self.joints[i];
            let relative = counts[i].wrapping_sub(self.zero[i]);
            q[i] = T::from_i32(relative) * joint.radians_per_count + joint.offset;
            let turned = if relative.unsigned_abs() > joint.counts_unturned {
                joint.within_a_turn(relative) + joint.offset
            } else {
                q[i]
            };
            angles[i] = Angle { radians: turned, binary: Some(joint.binary.of(relative)) };
        }
        (q, angles)
    }

    /// The joints' velocities since the last step (rad/s), from integer count differences, which wrap.
    #[inline(always)]
    pub fn turned(&self, counts: &[i32; N]) -> SVector<T, N> {
        let mut raw = SVector::<T, N>::zeros();
        for i in 0..N {
            raw[i] = T::from_i32(counts[i].wrapping_sub(self.last[i])) * self.joints[i].speed_per_count;
        }
        raw
    }

    /// Filtered joint velocities. Where nothing is rendered with them, only guard and
    /// telemetry watch, and a first-order filter at the same cutoff is enough.
    #[inline(always)]
    pub fn velocities(&mut self, counts: &[i32; N], filter: impl Fn(&mut LowPass<T>, T) -> T) -> SVector<T, N> {
        let raw = self.turned(counts);
        self.last = *counts;
        if self.moving {
            SVector::from_fn(|i, _| filter(&mut self.filters[i], raw[i]))
        } else {
            SVector::from_fn(|i, _| self.filters[i].step_first_order(self.watch, raw[i]))
        }
    }

    /// Sets the joints' positions as the velocities begin.
    pub fn begin(&mut self, counts: &[i32; N]) {
        self.last = *counts;
        self.filters = [LowPass::default(); N];
    }

    /// Returns true if the velocity terms are known in full at these velocities (rad/s) wherever the feed-forward acts
    /// in full.
    #[inline(always)]
    pub fn surely_known(&self, qd: &SVector<T, N>) -> bool {
        let mut known = true;
        for i in 0..N {
            known &= qd[i].abs() <= self.sure;
        }
        known
    }

    /// The part of joint velocities (rad/s) that is more than single counts, see [`beyond`].
    #[inline(always)]
    pub fn certain(&self, qd: &SVector<T, N>) -> SVector<T, N> {
        SVector::from_fn(|i, _| beyond(qd[i], self.one_count[i]))
    }

    /// Declares the joints to be at `q` (rad) for these counts.
    #[inline(never)]
    pub fn home(&mut self, counts: &[i32; N], q: &[T; N]) {
        for i in 0..N {
            let joint = &self.joints[i];
            self.zero[i] = counts[i].wrapping_sub(counts_of(q[i] - joint.offset, joint.radians_per_count));
        }
    }

    /// Counts that homing has subtracted.
    pub fn zero(&self) -> [i32; N] {
        self.zero
    }

    /// Takes over homing.
    pub fn set_zero(&mut self, zero: [i32; N]) {
        self.zero = zero;
    }

    /// Takes over new coefficients between two steps.
    pub fn retune(&mut self, coefficients: &Coefficients<T>) {
        self.watch = coefficients.first_order_gain();
        self.sure = T::from_f64(KNOWN_TURN * FULL_REGULARITY) / coefficients.lag();
        for (one_count, known) in self.one_count.iter_mut().zip(coefficients.one_count()) {
            *one_count = *known;
        }
    }
}

/// The part of a velocity that exceeds a doubt: nothing up to the doubt, from there on v - doubt²/v, which is 3/4 of it
/// at twice the doubt and 99 % at ten times, without a step anywhere and nowhere steeper than 2. It is for forces that
/// grow with the square of a velocity: near rest an estimate is a row of single counts, and each looks like a burst of
/// fast motion. (The nonnegative garrote: Breiman, Technometrics 37(4), 1995.) NaN gives zero.
#[inline(always)]
pub fn beyond<T: Real>(velocity: T, doubt: T) -> T {
    if velocity.abs() > doubt { velocity - doubt * (doubt / velocity) } else { T::zero() }
}

/// Counts that make up an angle (rad) at so many radians per count; none when there is no scale.
fn counts_of<T: Real>(angle: T, radians_per_count: T) -> i32 {
    if radians_per_count == T::zero() {
        return 0;
    }
    let counts = angle / radians_per_count;
    let half = T::from_f64(0.5);
    (if counts < T::zero() { counts - half } else { counts + half }).whole()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::catalogue::Kind;
    use crate::model::description::{self, Description, Encoder};

    /// A redundant arm with this encoder at joint 0, as a board has it.
    fn encoding(counts_per_turn: f64, inverted: bool) -> Encoding<f32> {
        let link = description::Link { mass: 0.1, com: 0.1, inertia: 1.0e-4, ..Default::default() };
        let mut joints = [description::Joint { inertia: 1.0e-4, ..Default::default() }; 3];
        joints[0].encoder = Some(Encoder { counts_per_turn, offset: 0.0, inverted });
        let description = Description {
            kind: Kind::Serial3r,
            gravity: [0.0; 3],
            geometry: [0.2; _],
            links: [link; _],
            joints,
            handle_mass: 0.0,
            home: None,
        };
        let device = Device::<f32>::new("arm", &description).expect("a sound device");
        Encoding::new(&device.joints[0], 1_000.0, true)
    }

    /// `count` counts in counts of the last turn begun, signed as `count` is: the f64 `counts_per_turn` is m/2ᵏ, so
    /// whole turns come off in integers.
    fn left_of(count: i32, counts_per_turn: f64) -> f64 {
        let mut denominator = 1_i128;
        while (counts_per_turn * denominator as f64).fract() != 0.0 {
            denominator *= 2;
        }
        let turn = (counts_per_turn * denominator as f64) as i128;
        (i128::from(count) * denominator % turn) as f64 / denominator as f64
    }

    /// Four roundings of half an epsilon: the size of a count, that of a part, the parts that are left, the product.
    fn rounding(angle: f64) -> f64 {
        angle.abs() * 2.0 * f64::from(f32::EPSILON)
    }

    #[test]
    fn whole_turns_of_fractional_counts_come_off_exactly() {
        // An encoder of 4000 behind 43:4, 7:3 and 355:113, one with decimals, and a gear ratio that is no fraction.
        for counts_per_turn in
            [20_000.0, 10_752.5, 28_000.0 / 3.0, 4_000.0 * 355.0 / 113.0, 16_384.07, 2e4 * 1.1_f64.sqrt()]
        {
            for inverted in [false, true] {
                let encoding = encoding(counts_per_turn, inverted);
                for turns in [2, 3, 10, 999, 1_000, 4_999, 10_000] {
                    for sign in [1, -1] {
                        for step in 0..97 {
                            let share = f64::from(turns) + f64::from(step) / 97.0 + 1.0e-3;
                            let count = sign * (share * counts_per_turn) as i32;
                            let left = left_of(count, counts_per_turn) * core::f64::consts::TAU / counts_per_turn;
                            let right = if inverted { -left } else { left };
                            let found = f64::from(encoding.within_a_turn(count));
                            // Decimals and roots are p/q to 3e-5 of a count after so many turns, 1e-8 rad.
                            assert!(
                                (found - right).abs() <= rounding(right) + 1.0e-8,
                                "{counts_per_turn} per turn, {turns} turns, {count}: {found} is not {right}"
                            );
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn the_whole_range_of_the_counter_is_off_by_less_than_a_count() {
        // The worst for a continued fraction: its first convergent is near, its second out of reach.
        for counts_per_turn in [20_000.0 + 1.0e-5, 2_048.0 + 1.0e-6, 1.0e6 + 3.0e-4, 62_831.853_071_795_86] {
            let encoding = encoding(counts_per_turn, false);
            let turn = core::f64::consts::TAU;
            for count in [i32::MAX, i32::MIN, i32::MAX / 2, -1_234_567_890] {
                let right = left_of(count, counts_per_turn) * turn / counts_per_turn;
                let apart = f64::from(encoding.within_a_turn(count)) - right;
                let apart = (apart - (apart / turn).round() * turn).abs();
                assert!(apart <= turn / counts_per_turn + rounding(turn), "{counts_per_turn} at {count}: {apart} rad");
            }
        }
    }

    #[test]
    fn binary_angles_are_right_over_the_whole_range_of_the_counter() {
        let part = core::f64::consts::TAU / 4_294_967_296.0;
        for counts_per_turn in [20_000.0, 10_752.5, 28_000.0 / 3.0, 2e4 * 1.1_f64.sqrt(), 62_831.853_071_795_86] {
            for inverted in [false, true] {
                let binary = encoding(counts_per_turn, inverted).binary;
                for count in [0, 1, -1, 7, 4_999, -20_000, 123_456_789, i32::MAX, i32::MIN] {
                    let left = left_of(count, counts_per_turn) * core::f64::consts::TAU / counts_per_turn;
                    let right = if inverted { -left } else { left };
                    let found = f64::from(binary.of(count).0) * part;
                    let turns = (found - right) / core::f64::consts::TAU;
                    // The error of the turns of a fractional count (see `repeats_after`), and rounding down twice.
                    let doubt = f64::from(count).abs() / f64::from(i32::MAX) * part.max(1.0e-4) + 2.0 * part;
                    let apart = (turns - turns.round()) * core::f64::consts::TAU;
                    assert!(apart.abs() <= doubt, "{counts_per_turn} at {count}: {apart} rad");
                    if counts_per_turn == 20_000.0 || counts_per_turn == 10_752.5 {
                        assert!(apart.abs() <= 2.0 * part, "{counts_per_turn} at {count}: {apart} rad");
                    }
                }
            }
        }
    }

    #[test]
    fn within_the_first_turn_nothing_is_taken_off() {
        for counts_per_turn in [10_752.5, 20_000.0] {
            assert_eq!(encoding(counts_per_turn, false).counts_unturned, counts_per_turn as u32);
        }
    }
}
