//! The half second ([`ARM_SECONDS`]) from what acted to what the scene asks for: from nothing after arming, and from the
//! torques of the scene before where one replaces another with the motors on.
//!
//! Those torques are fixed, and the tip is not: towards a stretched elbow the same torques are a larger force. So what
//! rendered forces is held, in every step, to the limit of the force at the tip, and the feed-forward beside it to the
//! force that it began with. What a host had a part in also ends with its lease.
//!
//! Requests come between two steps, so everything here is what the last step left.

use super::{ARM_SECONDS, ControlLoop};
use crate::control::joints::Torques;
use crate::control::program::Program;
use crate::control::saturation::share_within;
use crate::drive::stage::Stage;
use crate::math::Math;
use crate::model::catalogue::MAX_JOINTS;
use crate::render::step_result::TorqueDemand;
use core::ops::DerefMut;

/// The torques that a step commanded, by purpose.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Acted {
    /// The part that carried the device's weight.
    pub gravity: Torques,
    /// The part that rendered forces, N m: all but the weight and the feed-forward.
    pub rendered: Torques,
    /// The share of the forces asked for that the limits left.
    pub share: f32,
}

/// Torques that a host asked for, on their way out.
#[derive(Clone, Copy, Debug, Default)]
struct Lease {
    /// N m when `life` (s) were left; they fall as `left`, what is left now, does.
    torque: Torques,
    life: f32,
    remaining: f32,
}

impl Lease {
    /// The torques that still act.
    fn acts(&self) -> Torques {
        let part = if self.remaining > 0.0 { self.remaining / self.life } else { 0.0 };
        Torques(self.torque.map(|torque| part * torque))
    }
}

/// The torques that acted before, on their way out. The default is zero.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Fade {
    /// The scene's progress from 0 to 1.
    pub ramp: f32,
    /// By what the last step multiplied the forces asked for, before torques were limited: the ramp times the share that
    /// the limit of the force at the tip left.
    pub share: f32,
    /// True if a step of the fade has passed.
    begun: bool,
    /// True if anything acted before.
    from_something: bool,
    /// The share of the device's weight that was carried: what carries it is of the pose now, or torques of another would
    /// push beside all limits.
    carried: f32,
    /// Torques that rendered the scene before.
    scene: Torques,
    host: Lease,
    /// Torques of the feed-forward, and the square of the force at the tip that they were worth in the first step, N².
    aside: Torques,
    aside_squared: Option<f32>,
}

impl Fade {
    /// Begins from nothing. What an earlier fade left besides is not looked at then.
    pub fn start_from_nothing(&mut self) {
        (self.ramp, self.share, self.host.remaining) = (0.0, 0.0, 0.0);
        (self.begun, self.from_something) = (false, false);
    }

    /// The torques that render forces before the ramp.
    fn rendered(&self) -> Torques {
        let host = self.host.acts();
        Torques::from_fn(|i| self.scene[i] + host[i])
    }

    /// `from` on its way to `to`.
    fn part(&self, from: f32, to: f32) -> f32 {
        from + (to - from) * self.ramp
    }
}

impl<P, K, S> ControlLoop<P, S>
where
    P: DerefMut<Target = Program<K, S>>,
    K: Math<f32>,
    S: Stage,
{
    /// Lets what the last step commanded fade into what a new program asks for. Call before that takes the old one's place.
    pub(super) fn begin_fade(&mut self) {
        // If no step came between two programs, the earlier torques fade already.
        if !self.fade.begun {
            return;
        }
        let asked = &self.now.found.asked;
        let Acted { gravity, rendered, share } = if self.was_cut() {
            self.cut
        } else {
            Acted { gravity: Torques(asked.gravity), rendered: Torques(asked.rendered), share: 1.0 }
        };
        let (torque, life) = self.host_torque();
        let mut host = Lease { torque, life, remaining: life };
        if self.fade.host.remaining > 0.0 {
            // Of an earlier scene: both end with the one that ends first.
            host.life = if torque == Torques::default() {
                self.fade.host.remaining
            } else {
                life.min(self.fade.host.remaining)
            };
            host.remaining = host.life;
            let part = (1.0 - self.fade.ramp) * share;
            for (host, earlier) in host.torque.iter_mut().zip(self.fade.host.acts().iter()) {
                *host += part * earlier;
            }
        }
        let aside = Torques::from_fn(|i| self.now.motors.torque[i] - gravity[i] - rendered[i]);
        let carried = self.carries();
        self.fade = Fade {
            ramp: 0.0,
            share: 0.0,
            begun: false,
            from_something: true,
            carried,
            scene: Torques::from_fn(|i| rendered[i] - host.torque[i]),
            host,
            aside,
            aside_squared: None,
        };
    }

    /// One step of the fade: what is to be commanded instead of what is asked, and what that would be without the limit of
    /// the force at the tip.
    #[inline(never)]
    pub(super) fn fade_in(&mut self) -> (TorqueDemand<f32>, [f32; MAX_JOINTS]) {
        let asked = &{ self.now.found.asked };
        self.fade.begun = true;
        self.fade.ramp = (self.fade.ramp + self.period * (1.0 / ARM_SECONDS)).min(1.0);
        // The limit of the force at the tip holds the present demand by itself, as it does the fading part below.
        let share = share_within(asked.force_squared, self.most_force);
        self.fade.share = self.fade.ramp * share;
        if !self.fade.from_something {
            return self.rise(asked, share);
        }
        self.fade.host.remaining -= self.period;
        self.hold_what_fades();
        let (fade, before, weight) = (&self.fade, self.fade.rendered(), self.weight(asked));
        let faded = TorqueDemand {
            total: self.between(asked, &weight, share),
            gravity: weight,
            rendered: core::array::from_fn(|i| fade.part(before[i], share * asked.rendered[i])),
            force_squared: 0.0,
        };
        (faded, self.between(asked, &weight, 1.0))
    }

    /// The share of the device's weight that this step carries.
    fn carries(&self) -> f32 {
        let before = if self.fade.from_something { self.fade.carried } else { 0.0 };
        self.fade.part(before, if self.weighs { 1.0 } else { 0.0 })
    }

    /// The torques that carry the weight now, N m. A scene that does not carry it cannot tell them.
    fn weight(&self, asked: &TorqueDemand<f32>) -> [f32; MAX_JOINTS] {
        let carries = self.carries();
        let whole = match &self.program {
            Some(program) if !self.weighs && carries > 0.0 => program.mechanism.gravity::<K>(&self.now.found.at.q),
            _ => asked.gravity,
        };
        whole.map(|torque| carries * torque)
    }

    /// [`ControlLoop::fade_in`] from nothing: with a `share` of what is asked beyond what carries the device.
    #[inline(always)]
    fn rise(&self, asked: &TorqueDemand<f32>, share: f32) -> (TorqueDemand<f32>, [f32; MAX_JOINTS]) {
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

    /// Holds what fades to the forces that it may make where the tip is now.
    #[inline(never)]
    fn hold_what_fades(&mut self) {
        let fade = &mut self.fade;
        let Some(program) = self.program.as_ref() else { return };
        let rendered = fade.rendered();
        if rendered == Torques::default() && fade.aside == Torques::default() {
            return;
        }
        // That of half a millisecond ago would let 4 % too much through: what fades is fixed, and not asked for again here.
        let leverage = program.mechanism.leverage::<K>(&self.now.found.at.q);
        let share = share_within(leverage.force_squared(&rendered), self.most_force);
        for part in fade.scene.iter_mut().chain(fade.host.torque.iter_mut()).chain(fade.aside.iter_mut()) {
            *part *= share;
        }
        let aside = leverage.force_squared(&fade.aside);
        let most = *fade.aside_squared.get_or_insert(aside);
        if aside > most {
            let share = K::sqrt(most / aside);
            fade.aside = Torques(fade.aside.map(|torque| share * torque));
        }
    }

    /// The `weight`, and a `share` of the rest of the demand.
    fn between(&self, asked: &TorqueDemand<f32>, weight: &[f32; MAX_JOINTS], share: f32) -> [f32; MAX_JOINTS] {
        let (fade, rendered) = (&self.fade, self.fade.rendered());
        core::array::from_fn(|i| {
            let beyond = share * (asked.total[i] - asked.gravity[i]);
            weight[i] + fade.part(rendered[i] + fade.aside[i], beyond)
        })
    }
}
