//! Contacts that act together, and how far each counts in what is rendered.

use super::Active;
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

/// As many as can act together.
pub(in super::super) type Pulls<T, const N: usize> = Vec<Pull<T, N>, { MAX_WALLS + MAX_SPRINGS + 1 }>;

/// Walls, springs and the host's plane that act together.
#[derive(Clone, Debug)]
pub(in super::super) struct Together<'a, T: Real, const N: usize> {
    first: &'a Active<T, N>,
    more: &'a [Active<T, N>],
    /// Those of the walls first.
    pub pulls: &'a [Pull<T, N>],
    pub principal: Principal<T, N>,
}

impl<'a, T: Real, const N: usize> Together<'a, T, N> {
    /// The force of contacts that act together, at the tip position `place` (m), in a task of `task` dimensions.
    /// `pulls`: an empty list that it may keep.
    #[inline(always)]
    pub fn new<K: Math<T>>(
        first: &'a Active<T, N>,
        more: &'a [Active<T, N>],
        guidance: &Guidance<T>,
        beside: &Beside<T, N>,
        place: &SVector<T, N>,
        task: usize,
        pulls: &'a mut Pulls<T, N>,
    ) -> Self {
        let mut reach = if beside.acts { guidance.reach(beside) } else { T::zero() };
        for a in core::iter::once(first).chain(more) {
            reach = reach.greater(depth_of(a.shaped, a.stiffness));
        }
        let full = T::one() / (reach * T::from_f64(TOUCH_SHARE)).greater(T::from_f64(TOUCH_DEPTH));
        let grown = |depth: T| (depth * full).lesser(T::one()).greater(T::zero());
        for a in core::iter::once(first).chain(more) {
            let stiffness = if a.bilateral { a.stiffness } else { a.stiffness * grown(-a.distance) };
            let _ = pulls.push(Pull { normal: a.normal, across: false, stiffness, feed_forward: a.feed_forward });
        }
        if beside.acts {
            guidance.pulls(place, |pull, depth| {
                let stiffness = pull.stiffness * depth.map_or(T::one(), grown);
                let _ = pulls.push(Pull { stiffness, ..pull });
            });
        }
        let principal = Principal::new::<K>(pulls, task);
        Self { first, more, pulls, principal }
    }

    /// The walls, and what they pull with.
    pub fn walls(&self) -> impl Iterator<Item = (&Active<T, N>, &Pull<T, N>)> {
        core::iter::once(self.first).chain(self.more).zip(self.pulls)
    }
}

/// The depth (m) at which a stiffness (N/m) makes a force (N); none for no stiffness.
pub(in super::super) fn depth_of<T: Real>(force: T, stiffness: T) -> T {
    if stiffness > T::zero() { force.abs() / stiffness } else { T::zero() }
}
