//! The passivity observer and controller (Hannaford and Ryu 2002), which takes back the energy that walls give out.
//!
//! The observer counts the work of all torques of the walls at the joints, including the sideways push of the
//! feed-forward and the torques that move with the linkage. The count is exact, because a torque is constant between
//! two samples. It does not include weight, springs, fields, the host's force and a posture.
//!
//! A hand gains energy if it slides along with the sideways push while it presses, and slides back without pressing. No
//! damping along the normal absorbs this energy (docs/model.md section 3). The controller therefore fades the
//! feed-forward while the walls owe energy, and absorbs the rest by damping along the normal. The debt resembles the
//! energy tank of Ferraguti, Secchi and Fantuzzi (ICRA 2013), which bounds the work of a change of impedance.

use crate::math::Real;
use nalgebra::SVector;

/// Energy debt of the walls above which the feed-forward is off, J. A wall of 10 kN/m stores this energy at 4.5 N.
const MAX_DEBT: f64 = 1.0e-3;
/// Largest damping of the controller, as a share of the damping that stops a mass of 1 kg within one step. More damping
/// would be unstable.
const DAMPING_SHARE: f64 = 0.01;

/// The energy observer. Runs only if the passivity controller is on or the energy is displayed.
#[derive(Clone, Debug)]
pub(super) struct Passivity<T: Real, const N: usize> {
    /// Control period, s.
    period: T,
    /// Energy absorbed since contact began, less the initial debt, J.
    energy: T,
    /// Joint torques of the walls since the last step, N m.
    wall_torque: SVector<T, N>,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Debt<T> {
    /// Energy owed, J.
    energy: T,
    /// Control rate, Hz.
    rate: T,
}

impl<T: Real, const N: usize> Passivity<T, N> {
    /// Makes an observer with an empty count, for a control rate in Hz.
    pub fn new(rate: T) -> Self {
        Self { period: T::one() / rate, energy: T::zero(), wall_torque: SVector::zeros() }
    }

    /// Clears the count.
    pub fn forget(&mut self) {
        (self.energy, self.wall_torque) = (T::zero(), SVector::zeros());
    }

    /// Adds the energy of the last period, in which the joint velocity was `speed` (rad/s, unfiltered).
    #[inline(always)]
    pub fn observe(&mut self, speed: &SVector<T, N>) {
        self.energy -= self.wall_torque.dot(speed) * self.period;
    }

    /// Records the walls' joint torques (N m), which act until the next step.
    #[inline(always)]
    pub fn record_wall_torques(&mut self, torque: &SVector<T, N>) {
        self.wall_torque = *torque;
    }

    /// Records that no wall is touched. A debt remains for the next contact.
    #[inline(always)]
    pub fn record_no_contact(&mut self) {
        self.energy = self.energy.lesser(T::zero());
        self.wall_torque = SVector::zeros();
    }

    /// Returns the energy absorbed, J.
    #[inline(always)]
    pub fn energy(&self) -> T {
        self.energy
    }

    /// Returns the present debt; `None` without debt.
    #[inline(always)]
    pub fn debt(&self, rate: T) -> Option<Debt<T>> {
        (self.energy < T::zero()).then(|| Debt { energy: -self.energy, rate })
    }
}

impl<T: Real> Debt<T> {
    /// Returns the damping (N s/m) that absorbs the complete debt in one step at the velocity `v` (m/s).
    #[inline(always)]
    pub fn damping(&self, v: T) -> T {
        if v == T::zero() {
            return T::zero();
        }
        let limit = self.rate * T::from_f64(DAMPING_SHARE);
        (self.energy * self.rate / (v * v).greater(T::from_f64(1.0e-12))).lesser(limit)
    }

    /// Returns the remaining share of the feed-forward: 1 without debt, 0 from [`MAX_DEBT`] on.
    #[inline(always)]
    pub fn feed_forward_share(&self) -> T {
        (T::one() - self.energy * T::from_f64(1.0 / MAX_DEBT)).greater(T::zero())
    }
}
