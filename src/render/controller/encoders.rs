//! Joint angles and velocities from encoder counts.

use super::regularity::{FULL_REGULARITY, FULL_TERMS_TURN};
use crate::math::{Angle, BinaryAngle, Real};
use crate::model::device::{Device, Joint};
use crate::render::velocity::{Coefficients, LowPass};
use nalgebra::SVector;

/// Conversion of one joint's counts.
#[derive(Clone, Copy, Debug)]
struct Encoding<T> {
    radians_per_count: T,
    offset: T,
    /// Angular velocity of one count per control period, rad/s.
    speed_per_count: T,
    binary: Binary,
    /// Number of counts after which the angle repeats.
    period: i32,
    /// Number of complete turns in `period`.
    turns: i32,
    /// Joint angle of one part, rad. A turn has `period` parts, a count has `turns` parts.
    radians_per_part: T,
    /// Largest distance from count zero that is within the first turn, counts.
    counts_unturned: u32,
}

/// Conversion of counts to binary angles.
#[derive(Clone, Copy, Debug)]
struct Binary {
    /// Binary angle units per count, without the fraction.
    whole: u32,
    /// Fraction of the binary angle units per count, in units of 2⁻³².
    rest: i32,
    /// Angle at count zero.
    offset: BinaryAngle,
}

impl Binary {
    /// Makes the conversion for `period` counts in `turns` turns or, if 0, for `radians` per count. `offset` in rad.
    fn new(period: i32, turns: i32, radians: f64, offset: f64) -> Self {
        // Units of 2⁻³² of a binary angle unit.
        let per_count = match (u64::try_from(period), u64::try_from(turns)) {
            (Ok(period), Ok(turns)) if period > 0 && turns > 0 => {
                let (whole, left) = ((turns << 32) / period, (turns << 32) % period);
                let size = (whole << 32).wrapping_add(((left << 32) + period / 2) / period) as i64;
                if radians < 0.0 { size.wrapping_neg() } else { size }
            }
            _ => (radians * (18_446_744_073_709_551_616.0 / core::f64::consts::TAU)) as i64,
        };
        let rest = per_count as i32;
        let whole = (per_count.wrapping_sub(i64::from(rest)) >> 32) as u32;
        Self { whole, rest, offset: BinaryAngle::from_radians(offset) }
    }

    /// Returns the angle of `counts` counts without complete turns, by two multiplications and no division.
    #[inline(always)]
    fn of(&self, counts: i32) -> BinaryAngle {
        let rest = (i64::from(counts) * i64::from(self.rest)) >> 32;
        BinaryAngle(self.offset.0.wrapping_add((counts as u32).wrapping_mul(self.whole)).wrapping_add(rest as u32))
    }
}

impl<T: Real> Encoding<T> {
    /// Makes the conversion for a control rate in Hz.
    fn new(joint: &Joint<T>, rate: T) -> Self {
        let scale = joint.radians_per_count;
        let period = joint.counts_per_turn;
        let turns = T::from_i32(period) * scale.abs() * T::from_f64(1.0 / core::f64::consts::TAU) + T::from_f64(0.5);
        let turns = turns.integer_part();
        let repeats = period > 0 && turns > 0;
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

    /// Returns the angle of `relative` counts without offset and complete turns, rad. The error is two or three
    /// roundings of the result, for any number of turns.
    #[inline(always)]
    fn within_a_turn(&self, relative: i32) -> T {
        if self.turns == 1 {
            T::from_i32(relative.checked_rem(self.period).unwrap_or(relative)) * self.radians_per_count
        } else {
            self.within_a_fractional_turn(relative)
        }
    }

    /// Does the work of [`Encoding::within_a_turn`] for turns of p/q counts. Exact, because the counts are converted to
    /// parts of 1/q count, which are integers: p parts are a turn.
    #[cold]
    #[inline(never)]
    fn within_a_fractional_turn(&self, relative: i32) -> T {
        let parts = i64::from(relative) * i64::from(self.turns);
        // The remainder is smaller than the period, so it fits into an i32.
        let left = parts.checked_rem(i64::from(self.period)).unwrap_or(0) as i32;
        T::from_i32(left) * self.radians_per_part
    }
}

/// The encoders of N joints, and their last counts.
#[derive(Clone, Debug)]
pub(super) struct Encoders<T: Real, const N: usize> {
    joints: [Encoding<T>; N],
    zero: [i32; N],
    last_counts: [i32; N],
    filters: [LowPass<T>; N],
    /// Gain of the filters if only the guard and telemetry use the velocities.
    monitor_gain: T,
    /// Largest velocity of the estimate after a single count, rad/s.
    one_count: [T; N],
    /// Speed below which all velocity terms act in full in any pose, rad/s.
    full_terms_speed: T,
    /// True if rendering or compensation uses the joint velocities.
    moving: bool,
}

impl<T: Real, const N: usize> Encoders<T, N> {
    /// Makes the encoders of a device. Velocities are used if `moving`.
    #[inline(never)]
    pub fn new(device: &Device<T>, coefficients: &Coefficients<T>, moving: bool) -> Self {
        let mut encoders = Self {
            joints: core::array::from_fn(|i| Encoding::new(&device.joints[i], coefficients.rate())),
            zero: [0; N],
            last_counts: [0; N],
            filters: [LowPass::default(); N],
            monitor_gain: T::zero(),
            one_count: [T::zero(); N],
            full_terms_speed: T::zero(),
            moving,
        };
        encoders.retune(coefficients);
        encoders
    }

    /// Returns joint angles (rad), and the same angles without complete turns for sines and cosines.
    #[inline(always)]
    pub fn angles(&self, counts: &[i32; N]) -> (SVector<T, N>, [Angle<T>; N]) {
        let mut q = SVector::zeros();
        let mut angles = [Angle::from_radians(T::zero()); N];
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

    /// Returns the joints' velocities since the last step (rad/s), from wrapping differences of counts.
    #[inline(always)]
    pub fn raw_velocities(&self, counts: &[i32; N]) -> SVector<T, N> {
        let mut raw = SVector::<T, N>::zeros();
        for i in 0..N {
            raw[i] = T::from_i32(counts[i].wrapping_sub(self.last_counts[i])) * self.joints[i].speed_per_count;
        }
        raw
    }

    /// Returns filtered joint velocities, rad/s. The filter is of first order if only guard and telemetry need them.
    #[inline(always)]
    pub fn velocities(&mut self, counts: &[i32; N], filter: impl Fn(&mut LowPass<T>, T) -> T) -> SVector<T, N> {
        let raw = self.raw_velocities(counts);
        self.last_counts = *counts;
        if self.moving {
            SVector::from_fn(|i, _| filter(&mut self.filters[i], raw[i]))
        } else {
            SVector::from_fn(|i, _| self.filters[i].step_first_order(self.monitor_gain, raw[i]))
        }
    }

    /// Sets the initial positions of the joints.
    pub fn begin(&mut self, counts: &[i32; N]) {
        self.last_counts = *counts;
        self.filters = [LowPass::default(); N];
    }

    /// Returns true if velocity terms act in full at `qd` (rad/s) in every pose with full feed-forward.
    #[inline(always)]
    pub fn are_velocity_terms_full(&self, qd: &SVector<T, N>) -> bool {
        let mut known = true;
        for i in 0..N {
            known &= qd[i].abs() <= self.full_terms_speed;
        }
        known
    }

    /// Returns the part of the joint velocities `qd` (rad/s) beyond single counts, see [`beyond_uncertainty`].
    #[inline(always)]
    pub fn velocities_beyond_one_count(&self, qd: &SVector<T, N>) -> SVector<T, N> {
        SVector::from_fn(|i, _| beyond_uncertainty(qd[i], self.one_count[i]))
    }

    /// Declares that the joints are at `q` (rad) for these counts.
    #[inline(never)]
    pub fn home(&mut self, counts: &[i32; N], q: &[T; N]) {
        for i in 0..N {
            let joint = &self.joints[i];
            self.zero[i] = counts[i].wrapping_sub(counts_of(q[i] - joint.offset, joint.radians_per_count));
        }
    }

    /// Returns the counts that homing has subtracted.
    pub fn zero(&self) -> [i32; N] {
        self.zero
    }

    /// Takes over the homing of another controller.
    pub fn set_zero(&mut self, zero: [i32; N]) {
        self.zero = zero;
    }

    /// Sets new coefficients between two steps.
    pub fn retune(&mut self, coefficients: &Coefficients<T>) {
        self.monitor_gain = coefficients.first_order_gain();
        self.full_terms_speed = T::from_f64(FULL_TERMS_TURN * FULL_REGULARITY) / coefficients.lag();
        for (one_count, known) in self.one_count.iter_mut().zip(coefficients.one_count()) {
            *one_count = *known;
        }
    }
}

/// Returns the part of a velocity that exceeds its uncertainty: zero up to the uncertainty, v - uncertainty²/v beyond.
/// This is 3/4 of v at twice the uncertainty and 99 % at ten times, continuous with a slope of at most 2. Used for
/// forces that grow with v², because near rest every count looks like a short fast motion. (The nonnegative garrote:
/// Breiman, Technometrics 37(4), 1995.) Returns zero for NaN.
#[inline(always)]
pub fn beyond_uncertainty<T: Real>(velocity: T, uncertainty: T) -> T {
    if velocity.abs() > uncertainty { velocity - uncertainty * (uncertainty / velocity) } else { T::zero() }
}

/// Returns the number of counts in an angle (rad) at this scale; 0 if the scale is 0.
fn counts_of<T: Real>(angle: T, radians_per_count: T) -> i32 {
    if radians_per_count == T::zero() {
        return 0;
    }
    let counts = angle / radians_per_count;
    let half = T::from_f64(0.5);
    (if counts < T::zero() { counts - half } else { counts + half }).integer_part()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::catalogue::Kind;
    use crate::model::description::{self, Description, Encoder, Homing};

    /// Returns the conversion of joint 0 of a redundant arm with this encoder, as on a board.
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
            sensed: [None; 3],
            home: None,
            homing: Homing::Hand,
        };
        let device = Device::<f32>::new("arm", &description).expect("a sound device");
        Encoding::new(&device.joints[0], 1_000.0)
    }

    /// Returns the remainder of `count` after complete turns, with its sign. Exact, because an f64 `counts_per_turn` is
    /// m/2ᵏ and the remainder is taken in integers.
    fn remainder(count: i32, counts_per_turn: f64) -> f64 {
        let mut denominator = 1_i128;
        while (counts_per_turn * denominator as f64).fract() != 0.0 {
            denominator *= 2;
        }
        let turn = (counts_per_turn * denominator as f64) as i128;
        (i128::from(count) * denominator % turn) as f64 / denominator as f64
    }

    /// Returns four roundings of half an epsilon: size of a count, size of a part, remaining parts, product.
    fn rounding(angle: f64) -> f64 {
        angle.abs() * 2.0 * f64::from(f32::EPSILON)
    }

    #[test]
    fn complete_turns_of_fractional_counts_are_removed_exactly() {
        // Encoders of 4000 counts with gears of 43:4, 7:3 and 355:113, a decimal number, and an irrational gear ratio.
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
                            let left = remainder(count, counts_per_turn) * core::f64::consts::TAU / counts_per_turn;
                            let right = if inverted { -left } else { left };
                            let angle = f64::from(encoding.within_a_turn(count));
                            // Decimals and roots equal p/q to within 3e-5 of a count after these turns, 1e-8 rad.
                            assert!(
                                (angle - right).abs() <= rounding(right) + 1.0e-8,
                                "{counts_per_turn} per turn, {turns} turns, {count}: {angle} is not {right}"
                            );
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn errors_over_the_full_counter_range_are_below_a_count() {
        // Worst cases for a continued fraction, because the first convergent is near and the second out of reach.
        for counts_per_turn in [20_000.0 + 1.0e-5, 2_048.0 + 1.0e-6, 1.0e6 + 3.0e-4, 62_831.853_071_795_86] {
            let encoding = encoding(counts_per_turn, false);
            let turn = core::f64::consts::TAU;
            for count in [i32::MAX, i32::MIN, i32::MAX / 2, -1_234_567_890] {
                let right = remainder(count, counts_per_turn) * turn / counts_per_turn;
                let error = f64::from(encoding.within_a_turn(count)) - right;
                let error = (error - (error / turn).round() * turn).abs();
                assert!(error <= turn / counts_per_turn + rounding(turn), "{counts_per_turn} at {count}: {error} rad");
            }
        }
    }

    #[test]
    fn binary_angles_are_right_over_the_full_counter_range() {
        let part = core::f64::consts::TAU / 4_294_967_296.0;
        for counts_per_turn in [20_000.0, 10_752.5, 28_000.0 / 3.0, 2e4 * 1.1_f64.sqrt(), 62_831.853_071_795_86] {
            for inverted in [false, true] {
                let binary = encoding(counts_per_turn, inverted).binary;
                for count in [0, 1, -1, 7, 4_999, -20_000, 123_456_789, i32::MAX, i32::MIN] {
                    let left = remainder(count, counts_per_turn) * core::f64::consts::TAU / counts_per_turn;
                    let right = if inverted { -left } else { left };
                    let angle = f64::from(binary.of(count).0) * part;
                    let turns = (angle - right) / core::f64::consts::TAU;
                    // The error of a fractional count's turns (see `counts_until_repeat`), and two roundings down.
                    let uncertainty = f64::from(count).abs() / f64::from(i32::MAX) * part.max(1.0e-4) + 2.0 * part;
                    let error = (turns - turns.round()) * core::f64::consts::TAU;
                    assert!(error.abs() <= uncertainty, "{counts_per_turn} at {count}: {error} rad");
                    if counts_per_turn == 20_000.0 || counts_per_turn == 10_752.5 {
                        assert!(error.abs() <= 2.0 * part, "{counts_per_turn} at {count}: {error} rad");
                    }
                }
            }
        }
    }

    #[test]
    fn counts_within_the_first_turn_are_unchanged() {
        for counts_per_turn in [10_752.5, 20_000.0] {
            assert_eq!(encoding(counts_per_turn, false).counts_unturned, counts_per_turn as u32);
        }
    }
}
