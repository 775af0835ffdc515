//! Stability of sampled loops with several walls, built from M and J alone and checked by eigenvalues.

use super::continuity::lever_of_the_board;
use super::{Linkage, Precision, Random, device, largest_norm, normalized, torque_with_flags, unit_vector};
use haptic_bridge::math::Libm;
use haptic_bridge::model::mechanism::Mechanism;
use haptic_bridge::with_mechanism;
use nalgebra::{DMatrix, DVector, SVector};

const PERIOD_SECONDS: f64 = 1.0e-3;
/// Cutoff of the Butterworth low-pass for velocities, Hz.
const CUTOFF_HZ: f64 = 100.0;
const DAMPING_SECONDS: f64 = 3.0e-3;

/// Computes M and the tip rows of J at a pose. Returns `None` near a singularity.
pub fn matrices(device: &Linkage, q: &[f64]) -> Option<(DMatrix<f64>, DMatrix<f64>)> {
    fn compute<const N: usize, M: Mechanism<f64, N>>(m: &M, q: &[f64]) -> Option<(DMatrix<f64>, DMatrix<f64>)> {
        let pose = m.pose::<Libm>(&SVector::from_column_slice(q));
        let regularity = m.regularity(&pose);
        let (mass, jacobian) = (m.mass(&pose), m.jacobian(&pose));
        (regularity.serial > 0.2 && regularity.parallel > 0.2).then(|| {
            (DMatrix::from_fn(N, N, |i, j| mass[(i, j)]), DMatrix::from_fn(M::SPEC.task, N, |i, j| jacobian[(i, j)]))
        })
    }
    with_mechanism!(&device.mechanism, m => compute(m, q))
}

/// A set of walls on a device without friction.
#[derive(Clone)]
pub struct Case {
    mass: DMatrix<f64>,
    /// Derivative of each wall's distance with respect to the joint angles, m/rad.
    rows: DMatrix<f64>,
    /// Torques per newton of each wall's force, m.
    pub levers: DMatrix<f64>,
    /// Share of each wall in the total stiffness.
    share: Vec<f64>,
}

impl Case {
    /// Creates a case of walls (normal, stiffness) that all have the feed-forward, or all act through Jᵀ.
    pub fn new(device: &Linkage, q: &[f64], walls: &[(Vec<f64>, f64)], feed_forward: bool) -> Option<Self> {
        Self::with_flags(device, q, walls, &vec![feed_forward; walls.len()])
    }

    /// Like [`Case::new`]. Only walls whose flag in `with` is true have the feed-forward.
    pub fn with_flags(device: &Linkage, q: &[f64], walls: &[(Vec<f64>, f64)], with: &[bool]) -> Option<Self> {
        let (mass, jacobian) = matrices(device, q)?;
        let task = jacobian.nrows();
        let normals = DMatrix::from_fn(walls.len(), task, |i, j| walls[i].0[j]);
        let rows = normals * jacobian;
        let total: f64 = walls.iter().map(|wall| wall.1).sum();
        let share: Vec<f64> = walls.iter().map(|wall| wall.1 / total).collect();
        let levers = if with.contains(&true) {
            let column = |pushing: usize| {
                let set: Vec<_> = walls
                    .iter()
                    .enumerate()
                    .map(|(i, (normal, stiffness))| (normal.clone(), *stiffness, f64::from(u8::from(i == pushing))))
                    .collect();
                DVector::from_vec(torque_with_flags(device, q, &set, with, Precision::F64))
            };
            DMatrix::from_columns(&(0..walls.len()).map(column).collect::<Vec<_>>())
        } else {
            rows.transpose()
        };
        Some(Self { mass, rows, levers, share })
    }

    /// Returns the inverse mass of each mode, 1/kg: the eigenvalues of the walls' mobility times their shares.
    pub fn modes(&self) -> Vec<nalgebra::Complex<f64>> {
        let inverse = self.mass.clone().try_inverse().expect("a mass matrix");
        let mobility =
            &self.rows * inverse * &self.levers * DMatrix::from_diagonal(&DVector::from_vec(self.share.clone()));
        mobility.complex_eigenvalues().iter().copied().collect()
    }

    /// Returns the largest |z| of the sampled loop at a total stiffness (N/m). Ignores motions along all walls (z = 1).
    pub fn spectral_radius(&self, stiffness: f64) -> f64 {
        let (walls, joints) = self.rows.shape();
        // The states are q, q̇ T, and for every wall the last distance and two filter states.
        let size = 2 * joints + 3 * walls;
        let inverse = self.mass.clone().try_inverse().expect("a mass matrix");
        // The filter has the usual design: prewarped bilinear transform, transposed direct form II.
        let warped = (std::f64::consts::PI * CUTOFF_HZ * PERIOD_SECONDS).tan();
        let scale = 1.0 / (1.0 + std::f64::consts::SQRT_2 * warped + warped * warped);
        let b0 = warped * warped * scale;
        let (a1, a2) = (
            2.0 * (warped * warped - 1.0) * scale,
            (1.0 - std::f64::consts::SQRT_2 * warped + warped * warped) * scale,
        );
        let mut matrix = DMatrix::zeros(size, size);
        for column in 0..size {
            let mut s = DVector::zeros(size);
            s[column] = 1.0;
            let q = s.rows(0, joints).into_owned();
            let moved = s.rows(joints, joints).into_owned();
            let x = &self.rows * &q;
            let mut next = DVector::zeros(size);
            let mut force = DVector::zeros(walls);
            for i in 0..walls {
                let at = 2 * joints + 3 * i;
                let difference = x[i] - s[at];
                let y = b0 * difference + s[at + 1];
                next[at] = x[i];
                next[at + 1] = 2.0 * b0 * difference - a1 * y + s[at + 2];
                next[at + 2] = b0 * difference - a2 * y;
                force[i] = -self.share[i] * stiffness * (x[i] + DAMPING_SECONDS / PERIOD_SECONDS * y);
            }
            let acceleration = &inverse * (&self.levers * force) * (PERIOD_SECONDS * PERIOD_SECONDS);
            next.rows_mut(0, joints).copy_from(&(&q + &moved + &acceleration * 0.5));
            next.rows_mut(joints, joints).copy_from(&(&moved + &acceleration));
            matrix.set_column(column, &next);
        }
        let far = |z: &nalgebra::Complex<f64>| (z - 1.0).norm() > 1.0e-5;
        matrix.complex_eigenvalues().iter().filter(|z| far(z)).map(|z| z.norm()).fold(0.0, f64::max)
    }
}

/// Returns the total stiffness (N/m) above which a mode with a mass of 1 kg is unstable.
fn critical_stiffness() -> f64 {
    let one = Case {
        mass: DMatrix::from_element(1, 1, 1.0),
        rows: DMatrix::from_element(1, 1, 1.0),
        levers: DMatrix::from_element(1, 1, 1.0),
        share: vec![1.0],
    };
    let (mut low, mut high) = (1.0, 1.0e8);
    assert!(one.spectral_radius(low) < 1.0 && one.spectral_radius(high) > 1.0);
    while high - low > 1.0e-9 * high {
        let middle = (low + high) / 2.0;
        if one.spectral_radius(middle) < 1.0 { low = middle } else { high = middle }
    }
    low
}

/// Returns the largest stable total stiffness (N/m) from the modes. Asserts that the sampled loop has the same limit.
pub fn stability_limit(case: &Case, critical: f64) -> f64 {
    let found = critical / largest_norm(&case.modes());
    assert!(
        case.spectral_radius(found * 0.995) < 1.0 + 1.0e-9 && case.spectral_radius(found * 1.005) > 1.0,
        "the sampled loop has another limit"
    );
    found
}

pub fn devices() -> Vec<Linkage> {
    [
        "coupled-five-bar",
        "haply-2diy",
        "pantograph-mk2",
        "phantom-premium-1.5",
        "fictive-five-bar-turret",
        "woodenhaptics",
        "serial-3r",
    ]
    .map(device)
    .into()
}

/// Draws a regular pose near home.
pub fn pose(device: &Linkage, random: &mut Random) -> Vec<f64> {
    let home = device.description.home.expect("a shipped device has a home");
    loop {
        let q: Vec<f64> = (0..device.spec().joints).map(|i| home[i] + random.uniform(-0.5, 0.5)).collect();
        if matrices(device, &q).is_some() {
            return q;
        }
    }
}

#[test]
fn the_feed_forward_makes_no_set_of_walls_less_stable() {
    let mut random = Random(3);
    let critical = critical_stiffness();
    let (mut largest_ratio, mut cases) = (0.0_f64, 0);
    for device in devices() {
        let task = device.spec().task;
        for set in 0..60 {
            let q = pose(&device, &mut random);
            let walls = random.walls(task, set, 4.0);
            let plain = Case::new(&device, &q, &walls, false).expect("a regular pose");
            let shaped = Case::new(&device, &q, &walls, true).expect("a regular pose");
            let bound = largest_norm(&plain.modes());
            for mode in shaped.modes() {
                assert!(
                    mode.im.abs() <= 1.0e-7 * bound,
                    "{} {q:?} {walls:?}: {mode} is not the inverse of a mass",
                    device.name
                );
                assert!(mode.re <= bound * (1.0 + 1.0e-9), "{} {q:?} {walls:?}: {mode} > {bound}", device.name);
            }
            let (without, with) = (stability_limit(&plain, critical), stability_limit(&shaped, critical));
            assert!(with >= without * (1.0 - 1.0e-9), "{} {q:?} {walls:?}: limit {without} to {with}", device.name);
            largest_ratio = largest_ratio.max(with / without);
            cases += 1;
        }
    }
    assert!(cases == 420 && largest_ratio > 1.5, "the feed-forward has too little effect: {largest_ratio}");
}

#[test]
fn the_feed_forward_of_some_walls_makes_no_set_less_stable() {
    let mut random = Random(9);
    let (mut largest_ratio, mut cases) = (0.0_f64, 0);
    for device in devices() {
        let task = device.spec().task;
        for set in 0..120 {
            let q = pose(&device, &mut random);
            let walls = random.walls(task, set, if set % 4 < 2 { 1.0 } else { 4.0 });
            // At least one wall has the feed-forward, and at least one wall has none.
            let mut with: Vec<bool> = walls.iter().map(|_| random.uniform(0.0, 1.0) < 0.5).collect();
            with[0] = !with[1];
            let plain = Case::new(&device, &q, &walls, false).expect("a regular pose");
            let some = Case::with_flags(&device, &q, &walls, &with).expect("a regular pose");
            let (without, with_some) = (largest_norm(&plain.modes()), largest_norm(&some.modes()));
            for mode in some.modes() {
                let real = mode.im.abs() <= 1.0e-7 * without && mode.re >= -1.0e-9 * without;
                assert!(real, "{} {q:?} {walls:?} {with:?}: {mode} is not the inverse of a mass", device.name);
            }
            let name = &device.name;
            assert!(with_some <= without * (1.0 + 1.0e-9), "{name} {q:?} {walls:?} {with:?}: {without}, {with_some}");
            largest_ratio = largest_ratio.max(without / with_some);
            cases += 1;
        }
    }
    assert!(cases == 840 && largest_ratio > 1.5, "the feed-forward has too little effect: {largest_ratio}");
}

#[test]
fn facets_within_ten_degrees_are_as_stable_as_one_wall() {
    let mut random = Random(5);
    let critical = critical_stiffness();
    for device in devices() {
        let task = device.spec().task;
        for set in 0..24 {
            let q = pose(&device, &mut random);
            let n = random.direction(task);
            let shares: Vec<f64> = (0..2 + set % 2).map(|_| random.uniform(0.2, 1.0)).collect();
            let facets: Vec<(Vec<f64>, f64)> =
                shares.iter().map(|share| (random.direction_near(&n, 5_f64.to_radians()), *share)).collect();
            // The single wall has the total stiffness along the facets' mean normal.
            let mean = (0..task).map(|j| facets.iter().map(|(n, k)| n[j] * k).sum()).collect::<Vec<f64>>();
            let one_wall = [(normalized(&mean), shares.iter().sum())];
            let cut = stability_limit(&Case::new(&device, &q, &facets, true).expect("a regular pose"), critical);
            let uncut = stability_limit(&Case::new(&device, &q, &one_wall, true).expect("a regular pose"), critical);
            assert!(cut >= 0.97 * uncut, "{} {q:?} {facets:?}: {uncut} as one wall, {cut} as facets", device.name);
        }
    }
}

#[test]
fn facets_two_degrees_apart_have_the_range_of_one_wall() {
    // Two walls of 10 kN/m near the demo's normal once oscillated with 48 N.
    let critical = critical_stiffness();
    let (device, q) = (device("coupled-five-bar"), [2.6, 1.75]);
    let middle = 75_f64.to_radians();
    let range = |walls: &[(Vec<f64>, f64)], feed_forward| {
        stability_limit(&Case::new(&device, &q, walls, feed_forward).expect("a regular pose"), critical)
    };
    let facet = |degrees: f64| (unit_vector(middle + degrees.to_radians()), 1.0);
    let (whole, off) = (range(&[facet(0.0)], true), range(&[facet(0.0)], false));
    let cut = range(&[facet(-1.0), facet(1.0)], true);
    assert!(
        whole > 1.2 * off && (cut / whole - 1.0).abs() < 1.0e-3,
        "{off} without feed-forward, {whole} as one wall, {cut} as facets"
    );
}

/// Only the first of two walls has the feed-forward, and the torques are the board's. If the second wall acted through
/// Jᵀ alone, the mass of the stiffest mode would fall to 1/1.0566 of the mass without any feed-forward. This pair is
/// the worst of 3,000 random pairs in an independent computation.
#[test]
fn one_wall_with_feed_forward_does_not_destabilise_the_other() {
    let (device, q) = (device("coupled-five-bar"), [2.6, 1.75]);
    let walls = [(normalized(&[-0.194_558, -0.980_891]), 5_967.2), (normalized(&[0.706_391, -0.707_822]), 10_000.0)];
    let plain = Case::new(&device, &q, &walls, false).expect("a regular pose");
    let ratio = |case: &Case| largest_norm(&case.modes()) / largest_norm(&plain.modes());
    let mut previous = f64::INFINITY;
    for with in [[false, false], [true, false], [true, true]] {
        let mut board = plain.clone();
        for pushing in 0..2 {
            let lever = lever_of_the_board(&device, &q, &walls, &with, pushing);
            board.levers.set_column(pushing, &DVector::from_vec(lever));
        }
        let mode = ratio(&board);
        assert!(mode <= 1.0 + 1.0e-6, "feed-forward {with:?}: ratio {mode}");
        // Every further wall with the feed-forward adds mass.
        assert!(mode <= previous * (1.0 + 1.0e-6), "{with:?}: ratio {mode}, {previous} with fewer feed-forwards");
        previous = mode;
    }
    assert!(previous < 0.9995, "the feed-forward has too little effect: {previous}");
    let mut through_jacobian = plain.clone();
    let first = Case::new(&device, &q, &walls[..1], true).expect("a regular pose");
    through_jacobian.levers.set_column(0, &first.levers.column(0));
    assert!((ratio(&through_jacobian) - 1.0566).abs() < 1.0e-3, "{}", ratio(&through_jacobian));
}

/// Checks a statement of docs/model.md about a second wall, in the plane, with full stiffness and the weight `w`.
/// Returns the share of random pairs that the feed-forward makes more than 1 % less stable, and the worst ratio.
fn share_of_less_stable_pairs(w: f64) -> (f64, f64) {
    let mut random = Random(21);
    let (sets, mut worse, mut worst) = (20_000, 0, 0.0_f64);
    for _ in 0..sets {
        let column = |angle: f64| DVector::from_vec(unit_vector(angle));
        let (turn, light) = (random.uniform(0.0, 3.2), 4_f64.powf(-random.uniform(0.0, 1.0)));
        let (u, v) = (column(turn), column(turn + std::f64::consts::FRAC_PI_2));
        let inertia = &u * u.transpose() + &v * v.transpose() * light;
        let mobility = inertia.clone().try_inverse().expect("a mass matrix");
        let [n1, n2] = [0, 1].map(|_| column(random.uniform(0.0, std::f64::consts::TAU)));
        let (first, second) = (&n1 * n1.transpose(), &n2 * n2.transpose() * 10_f64.powf(random.uniform(-2.0, 2.0)));
        let counted = (&first + &second * w).symmetric_eigen();
        let stiff = counted.eigenvalues.imax();
        let (e, k1) = (counted.eigenvectors.column(stiff).into_owned(), counted.eigenvalues[stiff]);
        let share = 1.0 - (counted.eigenvalues[1 - stiff] / k1).powi(2);
        let along = &e * e.transpose();
        let inertia_along = (e.transpose() * &inertia * &e)[(0, 0)];
        let shaped = &mobility - &mobility * &along * share + &along * (share / inertia_along);
        let size = |map: &DMatrix<f64>| largest_norm((map * (&first + &second)).complex_eigenvalues().as_slice());
        let ratio = size(&shaped) / size(&mobility);
        worse += u32::from(ratio > 1.01);
        worst = worst.max(ratio);
    }
    (f64::from(worse) / f64::from(sets), worst)
}

#[test]
fn half_the_weight_costs_little_stability_and_full_weight_none() {
    let (share, worst_ratio) = share_of_less_stable_pairs(0.0);
    assert!((0.12..0.20).contains(&share) && worst_ratio < 1.4, "weight 0: {share} of the pairs, ratio {worst_ratio}");
    let (share, worst_ratio) = share_of_less_stable_pairs(0.5);
    assert!(share < 0.01 && worst_ratio < 1.09, "weight 0.5: {share} of the pairs, ratio {worst_ratio}");
    let (share, worst_ratio) = share_of_less_stable_pairs(1.0);
    assert!(share == 0.0 && worst_ratio < 1.0 + 1.0e-9, "weight 1: {share} of the pairs, ratio {worst_ratio}");
}
