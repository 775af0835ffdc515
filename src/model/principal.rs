//! Selects the rendered directions of several walls and computes the joint torques of their feed-forward.
//!
//! The rendered directions are the eigenvectors e₁, e₂, … of the walls' stiffness K = Σ kᵢ nᵢ nᵢᵀ, in the order of
//! falling eigenvalues k₁ ≥ k₂ ≥ …. Level R is equation (4) with e₁ … e_R rendered and every other direction
//! admissible. The force along e_j goes through the levels R = j, j + 1, …. Each level takes the share (1 -
//! (k_{R+1}/k_R)²) p_R of the force that the earlier levels left; the rest goes through Jᵀ. p_R is 1 if every wall has
//! the feed-forward; otherwise it is reduced by the stiffness of the other walls along e₁ … e_R. If two eigenvalues are
//! equal, their eigenvectors are arbitrary, but the level between them has no share, so torques are continuous.
//!
//! The feed-forward makes no set of walls less stable if the device is undamped, the feed-forward acts in full and all
//! walls have the same damping ratio. Proof: split Λ⁻¹ = [a b; bᵀ d] and K = [K_a 0; 0 K_d] into the first R directions
//! and the rest. With the share s of level R the map is B = [a - s b d⁻¹ bᵀ, b; (1 - s) bᵀ, d]. Scaling the second
//! block by σ = √(1 - s) makes BK similar to B_s K with B_s = [a - s b d⁻¹ bᵀ, σ b; σ bᵀ, d]. B_s is symmetric and
//! positive definite, because its Schur complement a - b d⁻¹ bᵀ does not depend on s, so all eigenvalues of the loop
//! are real and positive, like those of masses. If μ exceeds the largest eigenvalue of Λ⁻¹K, then with p = μ K_d⁻¹ - d:
//! p > 0 and μ K_a⁻¹ - a - b p⁻¹ bᵀ > 0, hence also μ K_a⁻¹ - a + s b d⁻¹ bᵀ - (1 - s) b p⁻¹ bᵀ > 0. So μ exceeds every
//! eigenvalue of BK, and the largest eigenvalue falls as s grows. The next lower level has the same form with B_s in
//! place of Λ⁻¹, because the Schur complement onto its directions is the same and the scaling does not change its
//! block. With equal damping ratios the loop separates into one mass 1/μ for each eigenvalue. A mass is stable wherever
//! a lighter mass is (checked numerically; four of 5208 rays with an unfiltered difference over 32 samples are
//! exceptions). p_R only reduces a share.
//!
//! A single wall is level 1 with its own normal.

use crate::math::{Math, Real};
use crate::model::mechanism::Shaping;
use crate::model::solve::solve_symmetric;
use nalgebra::{SMatrix, SVector};

/// Maximum number of sweeps of Jacobi rotations. Two directions need one sweep, three directions need four.
const MAX_SWEEPS: usize = 6;
/// Largest error of a normal's squared length that is ignored, to save a square root. Only the normal of a moving plane
/// of the host has a larger error.
const UNIT_TOLERANCE: f64 = 1.0e-5;

/// The stiffness of one wall or spring, as used to select the rendered directions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pull<T: Real, const N: usize> {
    /// Unit normal of a wall, normal of the host's plane (may be shorter), or line of a spring. Zeros beyond the task.
    pub normal: SVector<T, N>,
    /// True if the stiffness acts across `normal` (in every direction if `normal` is zero) instead of along it.
    pub across: bool,
    /// Stiffness in N/m or another common unit; not negative.
    pub stiffness: T,
    /// True if the wall has the feed-forward. Other stiffness reduces every level's share.
    pub feed_forward: bool,
}

impl<T: Real, const N: usize> Pull<T, N> {
    /// Returns aᵀ S b of two orthonormal directions. S is n nᵀ, or the identity less n nᵀ if the stiffness acts across.
    #[inline(always)]
    fn stiffness_between(&self, a: &SVector<T, N>, b: &SVector<T, N>) -> T {
        if self.across {
            // Projects the vectors, because a difference of products would lose the softer direction to rounding.
            self.across_part(a).dot(&self.across_part(b))
        } else {
            a.dot(&self.normal) * b.dot(&self.normal)
        }
    }

    fn across_part(&self, a: &SVector<T, N>) -> SVector<T, N> {
        a - self.normal * self.normal.dot(a)
    }
}

/// The eigenvectors and eigenvalues of K = Σ kᵢ Sᵢ, Sᵢ = nᵢ nᵢᵀ for a wall.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Principal<T: Real, const N: usize> {
    /// Orthonormal columns: e₁ … e_d, then the coordinates beyond the task.
    pub basis: SMatrix<T, N, N>,
    /// k₁ ≥ k₂ ≥ …, divided by the stiffness of the stiffest wall; zero beyond the task.
    pub stiffness: SVector<T, N>,
    /// Part of `stiffness` that springs and walls without the feed-forward contribute.
    pub plain: SVector<T, N>,
}

impl<T: Real, const N: usize> Principal<T, N> {
    /// Computes the principal directions of walls in a task of `task` dimensions. If no wall has stiffness, all walls
    /// count equally. Uses Jacobi rotations of K in a frame that begins with the stiffest wall's normal, so that
    /// rounding errors of the stiffest wall do not hide a soft wall.
    #[inline(never)]
    pub fn new<K: Math<T>>(pulls: &[Pull<T, N>], task: usize) -> Self {
        let largest = pulls.iter().fold(T::zero(), |largest, pull| pull.stiffness.greater(largest));
        // A smaller stiffness counts as zero, because its inverse would overflow.
        let inverse = (largest > T::EPSILON * T::EPSILON).then(|| T::one() / largest);
        let weight = |pull: &Pull<T, N>| inverse.map_or(T::one(), |inverse| pull.stiffness * inverse);
        let task = task.min(N);
        let mut axes = frame::<T, K, N>(pulls, weight, task);
        let mut k = SMatrix::<T, N, N>::zeros();
        for pull in pulls {
            let weight = weight(pull);
            for i in 0..task {
                for j in 0..=i {
                    k[(i, j)] += weight * pull.stiffness_between(&axes[i], &axes[j]);
                }
            }
        }
        for _ in 0..MAX_SWEEPS {
            let mut rotated = false;
            for a in 0..N {
                for b in (a + 1..N).filter(|b| *b < task) {
                    rotated |= rotate::<T, K, N>(&mut axes, &mut k, a, b, task);
                }
            }
            if !rotated || task < 3 {
                break;
            }
        }
        let (mut stiffness, mut plain) = (SVector::<T, N>::zeros(), SVector::<T, N>::zeros());
        for (i, axis) in axes.iter().enumerate().take(task) {
            stiffness[i] = k[(i, i)];
            for pull in pulls.iter().filter(|pull| !pull.feed_forward) {
                plain[i] += weight(pull) * pull.stiffness_between(axis, axis);
            }
        }
        Self { basis: SMatrix::from_columns(&axes), stiffness, plain }
    }

    /// Returns column `i` of the basis; zero beyond the last column, so that the call cannot panic.
    #[inline(always)]
    pub fn direction(&self, i: usize) -> SVector<T, N> {
        SVector::from_fn(|row, _| self.basis.get((row, i)).copied().unwrap_or_default())
    }

    /// Returns the stiffness of direction `i`, counted from 0; zero beyond the last direction.
    #[inline(always)]
    pub fn stiffness_along(&self, i: usize) -> T {
        self.stiffness.get(i).copied().unwrap_or_default()
    }

    /// Returns the share that the level with `rendered` directions takes of the remaining force. It is (1 -
    /// (k_{R+1}/k_R)²) p_R, p_R = P k_R/(P k_R + Q k₁). P and Q are the stiffnesses along e₁ … e_R with and without
    /// feed-forward.
    #[inline(always)]
    pub fn share(&self, rendered: usize) -> T {
        let (stiffer, softer) = (self.stiffness_along(rendered.wrapping_sub(1)), self.stiffness_along(rendered));
        if stiffer > T::zero() {
            let ratio = (softer / stiffer).lesser(T::one());
            let sum = |of: &SVector<T, N>| of.iter().take(rendered).fold(T::zero(), |sum, along| sum + *along);
            let without = sum(&self.plain);
            let with = (sum(&self.stiffness) - without) * stiffer;
            (T::one() - ratio) * (T::one() + ratio) * (with / (with + without * self.stiffness_along(0)))
        } else {
            T::zero()
        }
    }

    /// Computes the feed-forward for the walls' resultant `force` (N). Every level takes only `part` of its share.
    ///
    /// `shapings` holds the shaping of each column of the basis. `bias` returns b of a level, and the part of b that is
    /// subtracted from the walls' force (N m, see [`Shaping::torque`]). Returns the joint torques of all levels (N m)
    /// and the force that is left for Jᵀ (N).
    #[inline(always)]
    pub fn feed_forward(
        &self,
        shapings: &[Shaping<T, N>; N],
        force: &SVector<T, N>,
        part: T,
        bias: impl Fn(usize) -> Option<(SVector<T, N>, SVector<T, N>)>,
    ) -> (SVector<T, N>, SVector<T, N>) {
        let mut torque = SVector::zeros();
        let mut plain = *force;
        // The part of the force along each direction that no level has taken yet. The entry of e₁ also applies to b.
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
                if let Some((_, subtracted)) = &bias {
                    right[i] -= shapings[i].e.dot(subtracted) * b_share;
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

fn unit_vector<T: Real, const N: usize>(i: usize) -> SVector<T, N> {
    SVector::from_fn(|row, _| if row == i { T::one() } else { T::zero() })
}

/// Returns an orthonormal frame of the first `task` coordinates. The first axis is the normal of the wall with the
/// largest weight, the second the largest weighted part of a wall's normal across the first. Other coordinates stay.
fn frame<T: Real, K: Math<T>, const N: usize>(
    pulls: &[Pull<T, N>],
    weight: impl Fn(&Pull<T, N>) -> T,
    task: usize,
) -> [SVector<T, N>; N] {
    let mut axes: [SVector<T, N>; N] = core::array::from_fn(|i| unit_vector(i));
    let walls = || pulls.iter().filter(|pull| !pull.across);
    let mut largest = T::zero();
    for pull in walls() {
        // A wall has no normal at the centre of a ball.
        let size = weight(pull) * pull.normal.dot(&pull.normal);
        if size > largest {
            (largest, axes[0]) = (size, pull.normal);
        }
    }
    let squared = axes[0].dot(&axes[0]);
    if (squared - T::one()).abs() > T::from_f64(UNIT_TOLERANCE) {
        axes[0] /= K::sqrt(squared);
    }
    if task == 2 && N >= 2 {
        (axes[1][0], axes[1][1]) = (-axes[0][1], axes[0][0]);
    } else if task == 3 && N >= 3 {
        let (mut largest, mut second) = (T::zero(), None);
        for pull in walls() {
            let part = pull.normal - axes[0] * axes[0].dot(&pull.normal);
            let size = part.dot(&part);
            // If two normals are equal, the remainder is rounding and has no direction.
            if size > T::EPSILON && weight(pull) * size > largest {
                (largest, second) = (weight(pull) * size, Some(part / K::sqrt(size)));
            }
        }
        axes[1] = match second {
            // Orthogonalises again, because a short part is mostly rounding, and the frame must be orthogonal.
            Some(part) => {
                let part = part - axes[0] * axes[0].dot(&part);
                part / K::sqrt(part.dot(&part))
            }
            None => perpendicular_to::<T, K, N>(&axes[0]),
        };
        axes[2] = cross(&axes[0], &axes[1]);
    }
    axes
}

/// Returns a unit vector perpendicular to the unit vector `n` in space, from the coordinate axis farthest from `n`.
fn perpendicular_to<T: Real, K: Math<T>, const N: usize>(n: &SVector<T, N>) -> SVector<T, N> {
    let smallest = (1..N.min(3)).fold(0, |smallest, i| if n[i].abs() < n[smallest].abs() { i } else { smallest });
    let part = unit_vector::<T, N>(smallest) - n * n[smallest];
    part / K::sqrt(part.dot(&part))
}

/// Returns the cross product in the first three coordinates; zero if there are fewer.
fn cross<T: Real, const N: usize>(a: &SVector<T, N>, b: &SVector<T, N>) -> SVector<T, N> {
    let mut product = SVector::<T, N>::zeros();
    if N >= 3 {
        product[0] = a[1] * b[2] - a[2] * b[1];
        product[1] = a[2] * b[0] - a[0] * b[2];
        product[2] = a[0] * b[1] - a[1] * b[0];
    }
    product
}

/// Rotates axes `a` < `b` so that the lower triangle `k` of K has no entry between them and the larger diagonal entry
/// first. Returns false if no rotation is needed.
fn rotate<T: Real, K: Math<T>, const N: usize>(
    axes: &mut [SVector<T, N>; N],
    k: &mut SMatrix<T, N, N>,
    a: usize,
    b: usize,
    task: usize,
) -> bool {
    let (aa, bb, ab) = (k[(a, a)], k[(b, b)], k[(b, a)]);
    let difference = aa - bb;
    // A rotation by less than an epsilon does not change the axes.
    let small = ab.abs() <= T::EPSILON * difference || ab * ab <= T::EPSILON * T::EPSILON * aa * bb;
    if small && difference >= T::zero() {
        return false;
    }
    let half = T::from_f64(0.5);
    let hypotenuse = K::sqrt(difference * difference + (ab + ab) * (ab + ab));
    if hypotenuse <= T::zero() {
        return false;
    }
    // Cosine and sine of half the angle whose cosine is difference/hypotenuse. The larger value is computed first.
    let larger = K::sqrt(half + half * difference.abs() / hypotenuse);
    let smaller = ab.abs() / (hypotenuse * larger);
    let (cosine, sine) = if difference >= T::zero() { (larger, smaller) } else { (smaller, larger) };
    let sine = if ab < T::zero() { -sine } else { sine };
    // The softer direction loses the stiffness that the stiffer direction gains.
    let gained = ab.abs() * smaller / larger;
    k[(a, a)] = aa.greater(bb) + gained;
    k[(b, b)] = (aa.lesser(bb) - gained).greater(T::zero());
    k[(b, a)] = T::zero();
    for other in (0..N).filter(|other| *other < task && *other != a && *other != b) {
        let (to_a, to_b) = ((other.max(a), other.min(a)), (other.max(b), other.min(b)));
        let (old_a, old_b) = (k[to_a], k[to_b]);
        k[to_a] = old_a * cosine + old_b * sine;
        k[to_b] = old_b * cosine - old_a * sine;
    }
    let (old_a, old_b) = (axes[a], axes[b]);
    axes[a] = old_a * cosine + old_b * sine;
    axes[b] = old_b * cosine - old_a * sine;
    true
}
