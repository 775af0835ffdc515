//! The half second ([`ARM_SECONDS`]) of transition to the scene's torques. The transition starts from zero after
//! arming, and from the previous scene's torques if a scene is replaced while the motors are on.
//!
//! The previous torques stay constant while the tip moves, but the same torques are a larger force near a stretched
//! elbow. Every step therefore cuts the torques of rendered forces to the force limit at the tip, and the feed-forward
//! to its initial force. Torques of a host also end with the host's lease.
//!
//! Requests arrive between two steps, so all state here comes from the last step.

use super::{ARM_SECONDS, ControlLoop};
use crate::control::joints::Torques;
use crate::control::program::Program;
use crate::control::saturation::share_within;
use crate::drive::stage::Stage;
use crate::math::Math;
use crate::model::catalogue::MAX_JOINTS;
use crate::render::step_result::TorqueDemand;
use core::ops::DerefMut;

/// Torques that a step commanded, by purpose.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct CommandedTorques {
    /// Torques that carry the device's weight.
    pub gravity: Torques,
    /// Torques that render forces: everything except weight and feed-forward.
    pub rendered: Torques,
    /// Share of the requested forces that the limits left.
    pub share: f32,
}

/// Torques of a host, which fade out.
#[derive(Clone, Copy, Debug, Default)]
struct Lease {
    /// Torques at the lease's start, N m. The torques fall in proportion to the remaining time.
    torque: Torques,
    /// Time from the lease's start to its end, s.
    duration: f32,
    remaining: f32,
}

impl Lease {
    fn remaining_torques(&self) -> Torques {
        let part = if self.remaining > 0.0 { self.remaining / self.duration } else { 0.0 };
        Torques(self.torque.map(|torque| part * torque))
    }
}

/// Torques of the previous scene, which fade out. The default is zero.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Fade {
    /// Progress of the new scene from 0 to 1.
    pub ramp: f32,
    /// Share of the requested forces in the last step after the ramp and the force limit at the tip.
    pub share: f32,
    /// True after the first step of the fade.
    has_begun: bool,
    /// True if torques acted before the fade.
    has_previous_torques: bool,
    /// Share of the device's weight that the motors carried before the fade.
    carried_weight: f32,
    scene_torques: Torques,
    host: Lease,
    /// Feed-forward torques, N m.
    feed_forward: Torques,
    /// Square of the feed-forward's tip force in the first step, N².
    initial_force_squared: Option<f32>,
}

impl Fade {
    /// Starts from zero and drops the rest of an earlier fade.
    pub fn start_from_zero(&mut self) {
        (self.ramp, self.share, self.host.remaining) = (0.0, 0.0, 0.0);
        (self.has_begun, self.has_previous_torques) = (false, false);
    }

    /// Returns the previous torques that rendered forces, before the ramp.
    fn rendered(&self) -> Torques {
        let host = self.host.remaining_torques();
        Torques::from_fn(|i| self.scene_torques[i] + host[i])
    }

    fn interpolate(&self, from: f32, to: f32) -> f32 {
        from + (to - from) * self.ramp
    }
}

impl<P, K, S> ControlLoop<P, S>
where
    P: DerefMut<Target = Program<K, S>>,
    K: Math<f32>,
    S: Stage,
{
    /// Starts to fade from the last step's torques to a new program's torques. Call before installing the new program.
    pub(super) fn begin_fade(&mut self) {
        // If no step ran between two programs, the earlier torques already fade.
        if !self.fade.has_begun {
            return;
        }
        let asked = &self.now.result.asked;
        let CommandedTorques { gravity, rendered, share } = if self.was_cut() {
            self.cut_torques
        } else {
            CommandedTorques { gravity: Torques(asked.gravity), rendered: Torques(asked.rendered), share: 1.0 }
        };
        let (torque, life) = self.host_torque();
        let mut host = Lease { torque, duration: life, remaining: life };
        if self.fade.host.remaining > 0.0 {
            // If host torques of an earlier scene still fade, both fades end at the earlier end.
            host.duration = if torque == Torques::default() {
                self.fade.host.remaining
            } else {
                life.min(self.fade.host.remaining)
            };
            host.remaining = host.duration;
            let part = (1.0 - self.fade.ramp) * share;
            for (host, earlier) in host.torque.iter_mut().zip(self.fade.host.remaining_torques().iter()) {
                *host += part * earlier;
            }
        }
        let feed_forward = Torques::from_fn(|i| self.now.motors.torque[i] - gravity[i] - rendered[i]);
        let carried_weight = self.carried_share();
        self.fade = Fade {
            ramp: 0.0,
            share: 0.0,
            has_begun: false,
            has_previous_torques: true,
            carried_weight,
            scene_torques: Torques::from_fn(|i| rendered[i] - host.torque[i]),
            host,
            feed_forward,
            initial_force_squared: None,
        };
    }

    /// Runs one step of the fade. Returns the demand to command, and its total torques without the tip's force limit.
    #[inline(never)]
    pub(super) fn fade_in(&mut self) -> (TorqueDemand<f32>, [f32; MAX_JOINTS]) {
        let asked = &{ self.now.result.asked };
        self.fade.has_begun = true;
        self.fade.ramp = (self.fade.ramp + self.period * (1.0 / ARM_SECONDS)).min(1.0);
        // The force limit at the tip applies separately to the present demand and to the fading torques.
        let share = share_within(asked.force_squared, self.max_tip_force);
        self.fade.share = self.fade.ramp * share;
        if !self.fade.has_previous_torques {
            return self.fade_in_from_zero(asked, share);
        }
        self.fade.host.remaining -= self.period;
        self.limit_fading_torques();
        let (fade, before, weight) = (&self.fade, self.fade.rendered(), self.weight(asked));
        let faded = TorqueDemand {
            total: self.blend_demand(asked, &weight, share),
            gravity: weight,
            rendered: core::array::from_fn(|i| fade.interpolate(before[i], share * asked.rendered[i])),
            force_squared: 0.0,
        };
        (faded, self.blend_demand(asked, &weight, 1.0))
    }

    /// Returns the share of the device's weight that this step carries.
    fn carried_share(&self) -> f32 {
        let before = if self.fade.has_previous_torques { self.fade.carried_weight } else { 0.0 };
        self.fade.interpolate(before, if self.compensates_weight { 1.0 } else { 0.0 })
    }

    /// Returns the torques that carry the weight now, N m. A scene without gravity compensation does not compute them.
    fn weight(&self, asked: &TorqueDemand<f32>) -> [f32; MAX_JOINTS] {
        let share = self.carried_share();
        let full_weight = match &self.program {
            Some(program) if !self.compensates_weight && share > 0.0 => {
                program.mechanism.gravity::<K>(&self.now.result.at.q)
            }
            _ => asked.gravity,
        };
        full_weight.map(|torque| share * torque)
    }

    /// Runs [`ControlLoop::fade_in`] from zero, with a `share` of the demand beyond gravity.
    #[inline(always)]
    fn fade_in_from_zero(&self, asked: &TorqueDemand<f32>, share: f32) -> (TorqueDemand<f32>, [f32; MAX_JOINTS]) {
        let ramp = self.fade.ramp;
        let between = |share: f32| -> [f32; MAX_JOINTS] {
            core::array::from_fn(|i| (asked.gravity[i] + share * (asked.total[i] - asked.gravity[i])) * ramp)
        };
        let risen = TorqueDemand {
            total: between(share),
            gravity: asked.gravity.map(|gravity| gravity * ramp),
            rendered: asked.rendered.map(|rendered| share * rendered * ramp),
            force_squared: 0.0,
        };
        (risen, between(1.0))
    }

    /// Cuts the fading torques to their force limits at the present tip position.
    #[inline(never)]
    fn limit_fading_torques(&mut self) {
        let fade = &mut self.fade;
        let Some(program) = self.program.as_ref() else { return };
        let rendered = fade.rendered();
        if rendered == Torques::default() && fade.feed_forward == Torques::default() {
            return;
        }
        // Leverage from half a millisecond ago would allow 4 % too much, because fading torques do not follow the pose.
        let leverage = program.mechanism.leverage::<K>(&self.now.result.at.q);
        let share = share_within(leverage.force_squared(&rendered), self.max_tip_force);
        for part in fade.scene_torques.iter_mut().chain(fade.host.torque.iter_mut()).chain(fade.feed_forward.iter_mut())
        {
            *part *= share;
        }
        let force_squared = leverage.force_squared(&fade.feed_forward);
        let max_squared = *fade.initial_force_squared.get_or_insert(force_squared);
        if force_squared > max_squared {
            let share = K::sqrt(max_squared / force_squared);
            fade.feed_forward = Torques(fade.feed_forward.map(|torque| share * torque));
        }
    }

    /// Returns `weight` plus the interpolation between fading torques and a `share` of the demand beyond gravity.
    fn blend_demand(&self, asked: &TorqueDemand<f32>, weight: &[f32; MAX_JOINTS], share: f32) -> [f32; MAX_JOINTS] {
        let (fade, rendered) = (&self.fade, self.fade.rendered());
        core::array::from_fn(|i| {
            let beyond = share * (asked.total[i] - asked.gravity[i]);
            weight[i] + fade.interpolate(rendered[i] + fade.feed_forward[i], beyond)
        })
    }
}
