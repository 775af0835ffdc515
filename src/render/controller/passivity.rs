//! A passivity observer and controller (Hannaford and Ryu 2002): it counts the energy that the walls give out and pays
//! it back.
//!
//! The observer counts what all torques of the walls do in the joints, so the sideways push of the feed-forward and what
//! moves with the linkage are in it: for a torque held between two samples that is exact. Weight, springs, fields, the
//! host's force and a posture are not in it.
//!
//! A hand that slides with the sideways push while it presses, and back without, gains what that push does, and no
//! damping along the normal is worth as much (docs/model.md section 3). So the controller pays in two ways: the feed-forward
//! fades while the walls owe energy, as the tank of Ferraguti, Secchi and Fantuzzi (ICRA 2013) lets a change of
//! impedance do no more work than it holds; and damping along the normal takes up the rest.

use crate::math::Real;
use nalgebra::SVector;

/// Energy owed by the walls (J) from which on nothing is shaped any more: a wall of 10 kN/m stores as much at 4.5 N.
const MOST_OWED: f64 = 1.0e-3;

/// Most damping that the controller adds, as a share of the damping at which a mass of 1 kg would stop in a step: beyond
/// it the controller itself would be the instability.
const DAMPING_SHARE: f64 = 0.01;

/// The observer. The steps of a controller that neither pays back nor shows the energy leave it out.
#[derive(Clone, Debug)]
pub(super) struct Passivity<T: Real, const N: usize> {
    /// s
    period: T,
    /// Taken up since contact began, less what was owed then, J.
    energy: T,
    /// Joint torques of the walls since the last step, N m.
    held: SVector<T, N>,
}

/// The walls' energy debt.
#[derive(Clone, Copy, Debug)]
pub(super) struct Debt<T> {
    /// J
    owed: T,
    /// Hz
    rate: T,
}

impl<T: Real, const N: usize> Passivity<T, N> {
    /// Nothing counted, at a control rate in Hz.
    pub fn new(rate: T) -> Self {
        Self { period: T::one() / rate, energy: T::zero(), held: SVector::zeros() }
    }

    /// Forgets what was counted.
    pub fn forget(&mut self) {
        (self.energy, self.held) = (T::zero(), SVector::zeros());
    }

    /// Counts the last period, in which the joints turned at `speed` (rad/s, not filtered).
    #[inline(always)]
    pub fn observe(&mut self, speed: &SVector<T, N>) {
        self.energy -= self.held.dot(speed) * self.period;
    }

    /// The walls ask for these joint torques (N m) until the next step.
    #[inline(always)]
    pub fn hold(&mut self, torque: &SVector<T, N>) {
        self.held = *torque;
    }

    /// No wall is touched: what they still owe stays for the next touch.
    #[inline(always)]
    pub fn leave(&mut self) {
        self.energy = self.energy.lesser(T::zero());
        self.held = SVector::zeros();
    }

    /// J
    #[inline(always)]
    pub fn energy(&self) -> T {
        self.energy
    }

    /// The energy that is owed and due now.
    #[inline(always)]
    pub fn debt(&self, rate: T) -> Option<Debt<T>> {
        (self.energy < T::zero()).then(|| Debt { owed: -self.energy, rate })
    }
}

impl<T: Real> Debt<T> {
    /// The damping (N s/m) that takes up the whole debt in one step at `v` (m/s).
    #[inline(always)]
    pub fn damping(&self, v: T) -> T {
        if v == T::zero() {
            return T::zero();
        }
        let most = self.rate * T::from_f64(DAMPING_SHARE);
        (self.owed * self.rate / (v * v).greater(T::from_f64(1.0e-12))).lesser(most)
    }

    /// The share of the feed-forward that is left: all where nothing is owed, none from [`MOST_OWED`] on.
    #[inline(always)]
    pub fn feed_forward_share(&self) -> T {
        (T::one() - self.owed * T::from_f64(1.0 / MOST_OWED)).greater(T::zero())
    }
}
