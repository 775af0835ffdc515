//! Which directions are rendered where several walls act at once, and the joint torques of the feed-forward for them.
//!
//! The rendered directions follow the walls' stiffness K = Σ kᵢ nᵢ nᵢᵀ: its eigenvectors e₁, e₂, … in falling order of
//! its eigenvalues k₁ ≥ k₂ ≥ …. Level R is equation (4) with e₁ … e_R rendered and every other direction admissible.
//! The force along e_j goes through the levels R = j, j + 1, …; each takes the share (1 - (k_{R+1}/k_R)²) p_R of what
//! the levels before it left, and what is left after the last goes straight through Jᵀ. p_R is 1 where every wall has the
//! feed-forward; where some are without it, it is less by their part of the stiffness along e₁ … e_R. Where two
//! eigenvalues meet, and their eigenvectors mean nothing, the level between them has no share: so torques are
//! continuous. That no set of walls, whichever of them have the feed-forward, is less stable than without is proven in
//! docs/model.md section 2.
//!
//! One wall has no use for this: it is level 1 with its own normal.

use crate::math::{Math, Real};
use crate::model::mechanism::Shaping;
use crate::model::solve::solve_symmetric;
use nalgebra::{SMatrix, SVector};

/// Rounds of rotations at most. Two directions take one; three, which converge quadratically, are exact to rounding
/// after four.
const SWEEPS: usize = 6;

/// One wall or spring as far as its stiffness decides what is rendered.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pull<T: Real, const N: usize> {
    /// A wall's unit normal, a spring's line; zeros beyond the task dimension.
    pub normal: SVector<T, N>,
    /// Whether it is stiff in all directions across `normal` instead of along it; every direction is across a normal of
    /// length zero.
    pub across: bool,
    /// Its stiffness, N/m or in any other common unit; not negative.
    pub stiffness: T,
    /// Whether it has the feed-forward. One that has not takes its part of the stiffness out of every level's share.
    pub feed_forward: bool,
}

impl<T: Real, const N: usize> Pull<T, N> {
    /// aᵀ S b of two orthonormal directions, S = n nᵀ, or the identity less that.
    #[inline(always)]
    fn between(&self, a: &SVector<T, N>, b: &SVector<T, N>) -> T {
        if self.across {
            // Of the vectors themselves: the difference of two numbers would lose the softer direction to rounding.
            self.beside(a).dot(&self.beside(b))
        } else {
            a.dot(&self.normal) * b.dot(&self.normal)
        }
    }

    fn beside(&self, a: &SVector<T, N>) -> SVector<T, N> {
        a - self.normal * self.normal.dot(a)
    }
}

/// The eigenvectors and eigenvalues of K = Σ kᵢ Sᵢ, Sᵢ = nᵢ nᵢᵀ for a wall.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Principal<T: Real, const N: usize> {
    /// Orthonormal columns: e₁ … e_d, then the coordinates beyond the task.
    pub basis: SMatrix<T, N, N>,
    /// k₁ ≥ k₂ ≥ … over the stiffness of the stiffest wall; zero beyond the task.
    pub stiffness: SVector<T, N>,
    /// The part of them that belongs to springs and to walls without the feed-forward.
    pub plain: SVector<T, N>,
}

impl<T: Real, const N: usize> Principal<T, N> {
    /// The principal directions of these walls in a task of `task` dimensions. Walls of no stiffness at all count
    /// alike.
    ///
    /// One-sided Jacobi rotations: K itself, in which the stiffness of a soft wall beside a stiff one would drown in
    /// rounding, is never formed.
    #[inline(never)]
    pub fn new<K: Math<T>>(pulls: &[Pull<T, N>], task: usize) -> Self {
        let largest = pulls.iter().fold(T::zero(), |most, pull| pull.stiffness.greater(most));
        // Less than this is none, so that its inverse is a number.
        let inverse = (largest > T::EPSILON * T::EPSILON).then(|| T::one() / largest);
        let weight = |pull: &Pull<T, N>| inverse.map_or(T::one(), |inverse| pull.stiffness * inverse);
        let mut axes: [SVector<T, N>; N] = core::array::from_fn(|i| unit(i));
        for _ in 0..SWEEPS {
            let mut turned = false;
            for a in 0..N {
                for b in a + 1..N.min(task) {
                    let (mut aa, mut bb, mut ab) = (T::zero(), T::zero(), T::zero());
                    for pull in pulls {
                        let k = weight(pull);
                        aa += k * pull.between(&axes[a], &axes[a]);
                        bb += k * pull.between(&axes[b], &axes[b]);
                        ab += k * pull.between(&axes[a], &axes[b]);
                    }
                    if let Some((cosine, sine)) = rotation::<T, K>(aa, bb, ab) {
                        let (old_a, old_b) = (axes[a], axes[b]);
                        axes[a] = old_a * cosine + old_b * sine;
                        axes[b] = old_b * cosine - old_a * sine;
                        turned = true;
                    }
                }
            }
            if !turned || task < 3 {
                break;
            }
        }
        let mut basis = SMatrix::<T, N, N>::zeros();
        let (mut stiffness, mut plain) = (SVector::<T, N>::zeros(), SVector::<T, N>::zeros());
        for i in 0..N {
            basis.set_column(i, &axes[i]);
            if i < task {
                for pull in pulls {
                    let part = weight(pull) * pull.between(&axes[i], &axes[i]);
                    stiffness[i] += part;
                    plain[i] += if pull.feed_forward { T::zero() } else { part };
                }
            }
        }
        Self { basis, stiffness, plain }
    }

    /// Column `i` of the basis; zero beyond it, so that asking cannot panic.
    #[inline(always)]
    pub fn direction(&self, i: usize) -> SVector<T, N> {
        SVector::from_fn(|row, _| self.basis.get((row, i)).copied().unwrap_or_default())
    }

    /// k of direction `i`, from 0; zero beyond the last.
    #[inline(always)]
    pub fn along(&self, i: usize) -> T {
        self.stiffness.get(i).copied().unwrap_or_default()
    }

    /// The share that the level with `rendered` directions takes of what the levels before it left:
    /// (1 - (k_{R+1}/k_R)²) p_R, p_R = P k_R/(P k_R + Q k₁) with P of the stiffness along e₁ … e_R belonging to walls with
    /// the feed-forward and Q to walls without.
    #[inline(always)]
    pub fn share(&self, rendered: usize) -> T {
        let (stiffer, softer) = (self.along(rendered.wrapping_sub(1)), self.along(rendered));
        if stiffer > T::zero() {
            let ratio = (softer / stiffer).lesser(T::one());
            let sum = |of: &SVector<T, N>| of.iter().take(rendered).fold(T::zero(), |sum, along| sum + *along);
            let without = sum(&self.plain);
            let with = (sum(&self.stiffness) - without) * stiffer;
            (T::one() - ratio) * (T::one() + ratio) * (with / (with + without * self.along(0)))
        } else {
            T::zero()
        }
    }

    /// The feed-forward for the task force `force` (N), the resultant of the walls; every level takes only the part
    /// `part` of its share.
    ///
    /// `shapings` are those of the columns of the basis; `bias` says b of a level and what of it the walls shall meet
    /// (N m, see [`crate::model::inertia::shaped_torque_beside`]).
    /// Returns the joint torques of all levels (N m) and what of the force is left for Jᵀ (N).
    #[inline(always)]
    pub fn shaped(
        &self,
        shapings: &[Shaping<T, N>; N],
        force: &SVector<T, N>,
        part: T,
        bias: impl Fn(usize) -> Option<(SVector<T, N>, SVector<T, N>)>,
    ) -> (SVector<T, N>, SVector<T, N>) {
        let mut torque = SVector::zeros();
        let mut plain = *force;
        // What of the force along each direction no level has taken yet; of b it is what is left of e₁.
        let mut left = SVector::<T, N>::repeat(T::one());
        for rendered in 1..N {
            let share = self.share(rendered) * part;
            let bias = bias(rendered);
            let b_share = left[0] * share;
            let mut w_rr = SMatrix::<T, N, N>::identity();
            let mut right = SVector::<T, N>::zeros();
            for i in 0..rendered {
                let along = self.direction(i);
                right[i] = along.dot(force) * left[i] * share;
                left[i] *= T::one() - share;
                plain -= along * right[i];
                if let Some((_, met)) = &bias {
                    right[i] -= shapings[i].e.dot(met) * b_share;
                }
                w_rr[(i, i)] = shapings[i].w_rr;
                for j in 0..i {
                    let entry = shapings[i].e.dot(&shapings[j].me);
                    w_rr[(i, j)] = entry;
                    w_rr[(j, i)] = entry;
                }
            }
            let y = solve_symmetric(&w_rr, &right);
            for i in 0..rendered {
                torque += shapings[i].me * y[i];
            }
            if let Some((b, _)) = bias {
                torque += b * b_share;
            }
        }
        (torque, plain)
    }
}

fn unit<T: Real, const N: usize>(i: usize) -> SVector<T, N> {
    SVector::from_fn(|row, _| if row == i { T::one() } else { T::zero() })
}

/// Cosine and sine of the rotation that makes [aa ab; ab bb] diagonal with the larger entry first; none where it is
/// that already, to rounding.
fn rotation<T: Real, K: Math<T>>(aa: T, bb: T, ab: T) -> Option<(T, T)> {
    let difference = aa - bb;
    if ab * ab <= T::EPSILON * T::EPSILON * aa * bb && difference >= T::zero() {
        return None;
    }
    let half = T::from_f64(0.5);
    let long = K::sqrt(difference * difference + (ab + ab) * (ab + ab));
    if long <= T::zero() {
        return None;
    }
    // Half of the angle whose cosine is difference/long, from its larger part.
    let larger = K::sqrt(half + half * difference.abs() / long);
    let smaller = ab.abs() / (long * larger);
    let (cosine, sine) = if difference >= T::zero() { (larger, smaller) } else { (smaller, larger) };
    Some((cosine, if ab < T::zero() { -sine } else { sine }))
}
