//! Compensation of cogging: the slope of each motor's potential is added to the torque of its joint.
//!
//! The torques count as a feed-forward, like the compensation of damping: saturation.rs cuts them last, and their force
//! at the tip counts towards its limit. A device without potentials takes the path of one without a host's force.
//!
//! A potential depends on the shaft's angle to a fraction of a period. A person who declares the home pose again does
//! not repeat it as precisely, so the potentials of a real device that is homed by hand end with its home.

use super::ControlLoop;
use crate::control::joints::Counts;
use crate::control::program::Program;
use crate::drive::stage::Stage;
use crate::math::Math;
use crate::model::catalogue::MAX_JOINTS;
use crate::model::cogging::Compensation;
use crate::model::description::Homing;
use core::ops::DerefMut;

/// The compensation of all joints.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct CoggingCompensation {
    /// True if the compensation adds torques.
    pub acts: bool,
    compensations: [Compensation; MAX_JOINTS],
    /// Counts at joint angle zero less the offset.
    zero: Counts,
    /// `zero` of the home at which the potentials were learnt; `None` if that was before the start.
    learnt_at: Option<Counts>,
}

impl<P, K, S> ControlLoop<P, S>
where
    P: DerefMut<Target = Program<K, S>>,
    K: Math<f32>,
    S: Stage,
{
    /// Sets the compensation of a joint between two steps. `learnt_here` is true if it was learnt at the present home.
    pub(super) fn set_cogging(&mut self, joint: u8, compensation: &Compensation, learnt_here: bool) {
        if let Some(place) = self.cogging.compensations.get_mut(usize::from(joint)) {
            *place = *compensation;
        }
        self.cogging.learnt_at = (self.homed && learnt_here).then(|| self.zero());
        self.update_cogging();
    }

    /// Drops all compensations, which belong to another device.
    pub(super) fn forget_cogging(&mut self) {
        self.cogging = CoggingCompensation::default();
        self.update_added_torques();
    }

    /// Applies the compensation to the present home. Call after a change of home.
    pub(super) fn update_cogging(&mut self) {
        let zero = self.zero();
        let by_hand =
            self.program.as_ref().is_none_or(|program| program.homing == Homing::Hand && !program.homes_itself);
        let valid = !(self.hardware.real && by_hand) || self.cogging.learnt_at == Some(zero);
        self.cogging.zero = zero;
        self.cogging.acts = valid && self.cogging.compensations.iter().any(|joint| !joint.is_empty());
        self.update_added_torques();
    }

    fn zero(&self) -> Counts {
        self.program.as_ref().map_or(Counts::default(), |program| program.controller.zero())
    }

    /// Adds the compensation's torques to the demand.
    #[inline(always)]
    pub(super) fn add_cogging(&mut self, counts: &Counts) {
        let asked = &mut self.now.result.asked;
        let CoggingCompensation { compensations, zero, .. } = &self.cogging;
        let counts = counts.iter().zip(zero.iter());
        for ((compensation, total), (count, zero)) in compensations.iter().zip(&mut asked.total).zip(counts) {
            *total += compensation.torque(count.wrapping_sub(*zero));
        }
    }
}
