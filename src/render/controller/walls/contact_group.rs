//! Contacts that act together, and the weight of each in the rendered directions.

use super::ShapedContact;
use crate::math::{Math, Real};
use crate::model::principal::{Principal, Pull};
use crate::render::controller::guidance::{Guidance, SharedGuidance};
use crate::render::scene::{MAX_SPRINGS, MAX_WALLS};
use heapless::Vec;
use nalgebra::SVector;

/// Depth over which a contact's stiffness fades in when the rendered directions are selected, m, so that a second wall
/// does not change the first wall's feed-forward abruptly. It is three encoder steps of a shipped device.
pub const TOUCH_DEPTH: f64 = 1.0e-4;
/// [`TOUCH_DEPTH`] as a share of the largest depth at which a contact's stiffness alone would make its shaped force.
/// While a second contact gains weight, the sideways push of the first contact changes. With this share, the change
/// is at most three times the second contact's own stiffness times the coupling; over a tenth of a millimetre it would
/// be tens of times as much (docs/model.md section 2).
pub const TOUCH_SHARE: f64 = 2.0 / 3.0;

/// Stiffnesses of contacts and springs that can act together.
pub(in super::super) type Pulls<T, const N: usize> = Vec<Pull<T, N>, { MAX_WALLS + MAX_SPRINGS + 1 }>;

/// Walls, springs and the host's plane that act together.
#[derive(Clone, Debug)]
pub(in super::super) struct ContactGroup<'a, T: Real, const N: usize> {
    first: &'a ShapedContact<T, N>,
    more: &'a [ShapedContact<T, N>],
    /// Stiffnesses of the group, with the walls first.
    pub pulls: &'a [Pull<T, N>],
    pub principal: Principal<T, N>,
}

impl<'a, T: Real, const N: usize> ContactGroup<'a, T, N> {
    /// Makes the group of contacts at the tip position `place` (m), in a task of `task` dimensions. The group fills and
    /// borrows `pulls`, which must be empty.
    #[inline(always)]
    pub fn new<K: Math<T>>(
        first: &'a ShapedContact<T, N>,
        more: &'a [ShapedContact<T, N>],
        guidance: &Guidance<T>,
        shared: &SharedGuidance<T, N>,
        place: &SVector<T, N>,
        task: usize,
        pulls: &'a mut Pulls<T, N>,
    ) -> Self {
        let mut reach = if shared.acts { guidance.shared_depth(shared) } else { T::zero() };
        for a in core::iter::once(first).chain(more) {
            reach = reach.greater(depth_of(a.shaped, a.stiffness));
        }
        let full = T::one() / (reach * T::from_f64(TOUCH_SHARE)).greater(T::from_f64(TOUCH_DEPTH));
        let share_at = |depth: T| (depth * full).lesser(T::one()).greater(T::zero());
        for a in core::iter::once(first).chain(more) {
            let stiffness = if a.bilateral { a.stiffness } else { a.stiffness * share_at(-a.distance) };
            let _ = pulls.push(Pull { normal: a.normal, across: false, stiffness, feed_forward: a.feed_forward });
        }
        if shared.acts {
            guidance.for_each_pull(place, |pull, depth| {
                let stiffness = pull.stiffness * depth.map_or(T::one(), share_at);
                let _ = pulls.push(Pull { stiffness, ..pull });
            });
        }
        let principal = Principal::new::<K>(pulls, task);
        Self { first, more, pulls, principal }
    }

    /// Returns the walls with their pulls.
    pub fn walls(&self) -> impl Iterator<Item = (&ShapedContact<T, N>, &Pull<T, N>)> {
        core::iter::once(self.first).chain(self.more).zip(self.pulls)
    }
}

/// Returns the depth (m) at which a stiffness (N/m) makes a force (N); 0 without stiffness.
pub(in super::super) fn depth_of<T: Real>(force: T, stiffness: T) -> T {
    if stiffness > T::zero() { force.abs() / stiffness } else { T::zero() }
}
