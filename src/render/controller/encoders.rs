//! Encoder counts in; joint angles and velocities out.

use crate::math::Real;
use crate::model::device::Device;
use crate::render::velocity::{Coefficients, LowPass};
use nalgebra::SVector;

/// How one joint is read.
#[derive(Clone, Copy, Debug)]
struct Encoding<T> {
    radians_per_count: T,
    /// Angular velocity of one count per control period, rad/s.
    speed_per_count: T,
    counts_per_turn: i32,
    /// Counts from zero up to which no whole turn has to be taken off.
    counts_unturned: u32,
    offset: T,
}

/// The encoders of N joints, and what their counts were.
#[derive(Clone, Debug)]
pub(super) struct Encoders<T: Real, const N: usize> {
    joints: [Encoding<T>; N],
    zero: [i32; N],
    last: [i32; N],
    primed: bool,
    filters: [LowPass<T>; N],
    /// Gain of the filters where only guard and telemetry look at them.
    watch: T,
    /// Whether something is rendered or compensated with joint velocities.
    moving: bool,
}

impl<T: Real, const N: usize> Encoders<T, N> {
    /// For a control rate in Hz. `periodic`: whole turns are the same pose. `moving`: something is rendered with the
    /// velocities.
    #[inline(never)]
    pub fn new(device: &Device<T>, coefficients: &Coefficients<T>, periodic: bool, moving: bool) -> Self {
        Self {
            joints: core::array::from_fn(|i| {
                let joint = &device.joints[i];
                let counts_per_turn = if periodic { joint.counts_per_turn } else { 0 };
                Encoding {
                    radians_per_count: joint.radians_per_count,
                    speed_per_count: joint.radians_per_count * coefficients.rate(),
                    counts_per_turn,
                    counts_unturned: if counts_per_turn > 0 { counts_per_turn.unsigned_abs() } else { u32::MAX },
                    offset: joint.offset,
                }
            }),
            zero: [0; N],
            last: [0; N],
            primed: false,
            filters: [LowPass::default(); N],
            watch: coefficients.first_order_gain(),
            moving,
        }
    }

    /// Joint angles (rad), and the same wrapped to within a turn for the mechanism's sines.
    #[inline(always)]
    pub fn angles(&self, counts: &[i32; N]) -> (SVector<T, N>, SVector<T, N>) {
        let mut q = SVector::zeros();
        let mut turned = SVector::zeros();
        for i in 0..N {
            let joint = &self.joints[i];
            let relative = counts[i].wrapping_sub(self.zero[i]);
            q[i] = T::from_i32(relative) * joint.radians_per_count + joint.offset;
            turned[i] = q[i];
            if relative.unsigned_abs() > joint.counts_unturned {
                let within = relative.checked_rem(joint.counts_per_turn).unwrap_or(relative);
                turned[i] = T::from_i32(within) * joint.radians_per_count + joint.offset;
            }
        }
        (q, turned)
    }

    /// Filtered joint velocities from integer count differences, which wrap. Where nothing is rendered with them, only
    /// guard and telemetry watch, and a first-order filter at the same cutoff is enough.
    #[inline(always)]
    pub fn velocities(&mut self, coefficients: &Coefficients<T>, counts: &[i32; N]) -> SVector<T, N> {
        if !self.primed {
            self.last = *counts;
            self.primed = true;
        }
        let mut qd = SVector::zeros();
        for i in 0..N {
            let moved = counts[i].wrapping_sub(self.last[i]);
            let raw = T::from_i32(moved) * self.joints[i].speed_per_count;
            qd[i] = if self.moving {
                self.filters[i].step(coefficients, raw)
            } else {
                self.filters[i].step_first_order(self.watch, raw)
            };
        }
        self.last = *counts;
        qd
    }

    /// Declares the joints to be at `q` (rad) for these counts. Velocities start anew.
    #[inline(never)]
    pub fn home(&mut self, counts: &[i32; N], q: &[T; N]) {
        for i in 0..N {
            let joint = &self.joints[i];
            self.zero[i] = counts[i].wrapping_sub(counts_of(q[i] - joint.offset, joint.radians_per_count));
        }
        self.forget();
    }

    /// Counts that homing has subtracted.
    pub fn zero(&self) -> [i32; N] {
        self.zero
    }

    /// Takes over homing.
    pub fn set_zero(&mut self, zero: [i32; N]) {
        self.zero = zero;
    }

    /// Starts the velocities anew.
    pub fn forget(&mut self) {
        self.primed = false;
        self.filters = [LowPass::default(); N];
    }

    /// Takes over new coefficients between two steps.
    pub fn retune(&mut self, coefficients: &Coefficients<T>) {
        self.watch = coefficients.first_order_gain();
    }
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
