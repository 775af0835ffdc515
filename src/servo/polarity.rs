//! The polarity check: a small torque must move each joint the right way before a real device may be armed.

use super::Servo;
use crate::drive::stage::Stage;
use crate::math::Math;
use crate::model::catalogue::MAX_JOINTS;
use crate::safety::fault::{Fault, State};
use crate::safety::refusal::Refusal;
use crate::servo::joints::{Counts, Torques};
use crate::servo::program::Program;
use crate::servo::saturation::share_within;
use core::ops::DerefMut;

/// Largest share of a motor's torque that the polarity check applies.
pub const POLARITY_SHARE: f32 = 0.25;
/// Joint motion that decides the polarity check, rad.
pub const POLARITY_MOTION: f32 = 0.02;
/// Time the polarity check takes to reach its torque, s; it gives up after twice this.
pub const POLARITY_SECONDS: f32 = 1.0;
/// How long it waits at most for a joint to come to rest before its turn, s. What the joint before has thrown about, or a
/// hand moves, says nothing of this one's motor; a device almost without friction glides for seconds.
pub const POLARITY_PATIENCE: f32 = 5.0;

/// A joint is at rest for it that stays within so much (rad) for so long (s). A speed would not do: between two counts of
/// a coarse encoder, and where a joint turns back, it is nothing.
const REST_MOTION: f32 = 0.1 * POLARITY_MOTION;
const REST_SECONDS: f32 = 0.2;

/// Progress of the polarity check.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PolarityCheck {
    pub(super) axis: usize,
    seconds: f32,
    /// For how long the joint was waited for to come to rest, s.
    waited: f32,
    /// Where it stands, rad, and for how long, s.
    rests_at: f32,
    rested: f32,
    /// Where the joint stood at its first step, rad.
    from: Option<f32>,
    /// The square of the force at the tip that 1 N m of the joint is worth (N²), and for which counts.
    worth: f32,
    weighed_at: Option<Counts>,
}

impl<P, K, S> Servo<P, S>
where
    P: DerefMut<Target = Program<K, S>>,
    K: Math<f32>,
    S: Stage,
{
    pub(super) fn start_polarity_check(&mut self) -> Result<(), Refusal> {
        self.ready()?;
        self.polarity = PolarityCheck::default();
        self.polarity_known = false;
        self.watch_anew();
        self.state = State::CheckingPolarity;
        Ok(())
    }

    /// One step of the check: the torques that the motors are told; zero while it waits and when it has ended.
    #[cold]
    #[inline(never)]
    pub(super) fn check_polarity(&mut self) -> Torques {
        let none = Torques::default();
        let i = self.polarity.axis.min(MAX_JOINTS - 1);
        if self.polarity.from.is_none() && !self.at_rest(i) {
            if self.polarity.waited >= POLARITY_PATIENCE {
                self.trip(Fault::PolarityUnrest, Some(i as u8), self.now.found.at.q[i] - self.polarity.rests_at);
            }
            return none;
        }
        let Some(program) = self.program.as_ref() else { return none };
        let (joints, most) = (program.joints, self.joints[i].stage.max_torque());
        let moved = self.now.found.at.q[i] - *self.polarity.from.get_or_insert(self.now.found.at.q[i]);
        if moved > POLARITY_MOTION {
            if i + 1 >= joints {
                self.off();
                self.state = State::Disarmed;
                self.polarity_known = true;
            } else {
                let next = (i + 1).min(MAX_JOINTS - 1);
                self.polarity = PolarityCheck { axis: next, ..PolarityCheck::default() };
            }
            return none;
        }
        if moved < -POLARITY_MOTION {
            self.trip(Fault::PolarityWrong, Some(i as u8), moved);
            return none;
        }
        self.polarity.seconds += self.period;
        if self.polarity.seconds > 2.0 * POLARITY_SECONDS {
            self.trip(Fault::PolarityNoMotion, Some(i as u8), moved);
            return none;
        }
        let share = POLARITY_SHARE * (self.polarity.seconds * (1.0 / POLARITY_SECONDS)).min(1.0);
        let mut torque = Torques::default();
        // What a torque is worth at the tip is as it was while no count changes, and takes a pose to work out.
        if self.polarity.weighed_at != Some(self.now.counts) {
            torque[i] = 1.0;
            self.polarity.worth = program.mechanism.leverage::<K>(&self.now.found.at.q).force_squared(&torque);
            self.polarity.weighed_at = Some(self.now.counts);
        }
        torque[i] = share * most;
        let squared = self.polarity.worth * (torque[i] * torque[i]);
        torque[i] *= share_within(squared, self.rules.limits.tip_force);
        torque
    }

    /// Whether joint `i` has come to rest.
    fn at_rest(&mut self, i: usize) -> bool {
        let (polarity, q) = (&mut self.polarity, self.now.found.at.q[i]);
        polarity.waited += self.period;
        polarity.rested += self.period;
        if (q - polarity.rests_at).abs() > REST_MOTION {
            (polarity.rests_at, polarity.rested) = (q, 0.0);
        }
        polarity.rested >= REST_SECONDS
    }
}
