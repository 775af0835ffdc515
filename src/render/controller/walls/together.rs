//! Contacts that act together, and how far each counts in what is rendered.

use super::{Active, Walls};
use crate::math::{Math, Real};
use crate::model::principal::{Principal, Pull};
use crate::render::controller::guidance::{Beside, Guidance};
use crate::render::scene::{MAX_SPRINGS, MAX_WALLS};
use heapless::Vec;
use nalgebra::SVector;

/// Depth in which a contact's stiffness grows to its own in deciding what is rendered, m: touching a second wall then
/// does not step the feed-forward of the first. Three steps of a shipped encoder, and the depth of a few newtons in the
/// stiffest walls that these devices render.
pub const TOUCH_DEPTH: f64 = 1.0e-4;

/// The same depth as a share of the depth at which a contact's own stiffness would make the force that is shaped for it,
/// of the contact where that is the most.
///
/// While a second contact comes to count, the sideways push made of the first one's force changes. Over so much of the
/// first one's depth, that adds to the second, or takes from it, at most three times its own stiffness times the
/// coupling; over a tenth of a millimetre it is tens of times as much (docs/model.md section 2).
pub const TOUCH_SHARE: f64 = 2.0 / 3.0;

/// Walls, springs and the host's plane that act together.
#[derive(Clone, Debug)]
pub(in super::super) struct Together<'a, T: Real, const N: usize> {
    first: &'a Active<T, N>,
    more: &'a [Active<T, N>],
    /// Those of the walls first.
    pub pulls: Vec<Pull<T, N>, { MAX_WALLS + MAX_SPRINGS + 1 }>,
    pub principal: Principal<T, N>,
}

impl<T: Real, const N: usize> Together<'_, T, N> {
    /// The walls, and what they pull with.
    pub fn walls(&self) -> impl Iterator<Item = (&Active<T, N>, &Pull<T, N>)> {
        core::iter::once(self.first).chain(self.more).zip(&self.pulls)
    }
}

impl<T: Real> Walls<T> {
    /// What contacts that act together render, at the tip position `place` (m).
    #[inline(always)]
    pub fn together<'a, K: Math<T>, const N: usize>(
        &self,
        first: &'a Active<T, N>,
        more: &'a [Active<T, N>],
        guidance: &Guidance<T>,
        beside: &Beside<T, N>,
        place: &SVector<T, N>,
        task: usize,
    ) -> Together<'a, T, N> {
        let mut pulls = Vec::new();
        let mut reach = if beside.acts { guidance.reach(beside) } else { T::zero() };
        for a in core::iter::once(first).chain(more) {
            let stiffness = self.running.get(a.wall).map_or(T::zero(), |running| running.wall.stiffness);
            reach = reach.greater(depth_of(a.shaped, stiffness));
        }
        let full = T::one() / (reach * T::from_f64(TOUCH_SHARE)).greater(T::from_f64(TOUCH_DEPTH));
        let grown = |depth: T| (depth * full).lesser(T::one()).greater(T::zero());
        for a in core::iter::once(first).chain(more) {
            let stiffness = self.running.get(a.wall).map_or(T::zero(), |running| {
                let wall = &running.wall;
                let depth = -wall.surface.contact::<K, N>(place).distance;
                if wall.bilateral { wall.stiffness } else { wall.stiffness * grown(depth) }
            });
            let feed_forward = self.has_feed_forward(a);
            let _ = pulls.push(Pull { normal: a.normal, across: false, stiffness, feed_forward });
        }
        if beside.acts {
            guidance.pulls(place, |pull, depth| {
                let stiffness = pull.stiffness * depth.map_or(T::one(), grown);
                let _ = pulls.push(Pull { stiffness, ..pull });
            });
        }
        let principal = Principal::new::<K>(&pulls, task);
        Together { first, more, pulls, principal }
    }
}

/// The depth (m) at which a stiffness (N/m) makes a force (N); none for no stiffness.
pub(in super::super) fn depth_of<T: Real>(force: T, stiffness: T) -> T {
    if stiffness > T::zero() { force.abs() / stiffness } else { T::zero() }
}
