//! Errors of the routes at poses with a chosen condition number of J near each kind of singularity.

use super::routes::{Errors, QuantityErrors, all_quantities, routes};
use super::{Exact, ExactMath};
use super::{mean_length, polar_arm, shipped_device, single_arm};
use haptic_bridge::control::compiled::BoardMath;
use haptic_bridge::math::{FineTable, Libm, Real};
use haptic_bridge::model::description::Description;
use haptic_bridge::model::mechanism::Mechanism;
use haptic_bridge::render::controller::{FULL_REGULARITY, NO_REGULARITY, PARALLEL_REGULARITY};
use nalgebra::{DMatrix, SVector};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Singularity {
    /// Serial singularity in which an arm is stretched or folded.
    Elbow,
    /// Serial singularity in which the tip is on the turret's axis.
    Axis,
    /// Serial singularity of a chain or a delta, in which det J changes its sign.
    Serial,
    /// Parallel singularity in which the distal rods of a closed loop lie in one line.
    Rods,
}

/// Target of the search for poses near a singularity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Target {
    Condition(f64),
    /// Sine of the angle to the singularity, as in `Regularity`.
    Sine(f64),
}

impl Singularity {
    /// Returns the sines at which the feed-forward begins to fade and is off.
    pub fn fade_sines(self) -> [f64; 2] {
        let scale = if self == Self::Rods { PARALLEL_REGULARITY } else { 1.0 };
        [FULL_REGULARITY, NO_REGULARITY].map(|sine| sine * scale)
    }

    /// Returns the targets of the table's rows: the two sines of the fade, then growing condition numbers.
    fn targets(self) -> Vec<Target> {
        let conditions = [1e1, 1e2, 1e3, 1e4, 1e5].map(Target::Condition);
        self.fade_sines().map(Target::Sine).into_iter().chain(conditions).collect()
    }
}

/// Maximum number of poses per row.
const MAX_POSES: usize = 60;
/// Maximum number of random paths per row.
const MAX_PATHS: usize = 4_000;
const NORMALS_PER_POSE: usize = 5;

#[derive(Clone, Debug)]
pub struct Row {
    pub device: &'static str,
    pub singularity: Singularity,
    pub target: Target,
    pub poses: usize,
    /// Smallest regularity (sine) of the poses.
    pub regularity: f64,
    /// Errors of the board's numbers (f32 with minimax sines).
    pub board: Errors,
    pub double: Errors,
    /// Largest difference between routes in the reference's numbers.
    pub reference: f64,
    /// Errors of all quantities of equation (4) in f64.
    pub quantities: QuantityErrors,
}

/// A reproducible stream of random numbers (SplitMix64 by Steele, Lea and Flood).
pub struct Random(pub u64);

impl Random {
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        low + (high - low) * ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    pub fn vector<const N: usize>(&mut self, bound: f64) -> SVector<f64, N> {
        SVector::from_fn(|_, _| self.uniform(-bound, bound))
    }

    /// Draws a task-space vector with entries from -1 to 1.
    pub fn normal<const N: usize>(&mut self, task: usize) -> SVector<f64, N> {
        let n = self.vector::<N>(1.0);
        SVector::from_fn(|i, _| if i < task { n[i] } else { 0.0 })
    }

    /// Draws joint angles of up to half a turn, and travels of up to 0.31 m.
    pub fn pose<M: Mechanism<f64, N>, const N: usize>(&mut self, m: &M) -> SVector<f64, N> {
        let q = self.vector::<N>(3.1);
        SVector::from_fn(|i, _| if m.is_prismatic(i) { 0.1 * q[i] } else { q[i] })
    }

    pub fn regular_pose<M: Mechanism<f64, N>, const N: usize>(&mut self, m: &M) -> SVector<f64, N> {
        loop {
            let q = self.pose(m);
            let r = m.regularity(&m.pose::<Libm>(&q));
            if r.serial.min(r.parallel) >= 0.2 {
                return q;
            }
        }
    }
}

/// Computes the ratio of J's largest to its smallest singular value. A row for φ is multiplied by `scale` (m).
fn jacobian_condition<M: Mechanism<f64, N>, const N: usize>(m: &M, q: &SVector<f64, N>, scale: f64) -> f64 {
    let jacobian = m.jacobian(&m.pose::<Libm>(q));
    let unit = |row: usize| if row < M::SPEC.task { 1.0 } else { scale };
    let values = DMatrix::from_fn(N, N, |i, j| jacobian[(i, j)] * unit(i)).singular_values();
    values.max() / values.min()
}

/// Returns a number that is 1 at the target and grows towards the singularity.
fn nearness<M: Mechanism<f64, N>, const N: usize>(m: &M, q: &SVector<f64, N>, target: Target, scale: f64) -> f64 {
    match target {
        Target::Condition(most) => jacobian_condition(m, q, scale) / most,
        Target::Sine(least) => {
            let r = m.regularity(&m.pose::<Libm>(q));
            least / r.serial.min(r.parallel)
        }
    }
}

/// Returns a number whose sign changes at the singularity.
fn signed_gap<M: Mechanism<f64, N>, const N: usize>(m: &M, q: &SVector<f64, N>, singularity: Singularity) -> f64 {
    let mut q = *q;
    let turret = matches!(M::SPEC.name, "five-bar-turret" | "parallelogram");
    if turret {
        q[0] = 0.0;
    }
    let pose = m.pose::<Libm>(&q);
    // With the turret at zero, J's turret column is along z and contains the tip's distance from the axis.
    let radius = m.jacobian(&pose)[(N - 1, 0)];
    match singularity {
        Singularity::Axis => radius,
        Singularity::Rods => m.regularity(&pose).parallel - 1e-9,
        Singularity::Serial => {
            let jacobian = m.jacobian(&pose);
            DMatrix::from_fn(N, N, |i, j| jacobian[(i, j)]).determinant()
        }
        Singularity::Elbow => {
            let j = m.jacobian(&pose);
            let minor = |r: usize, c: usize| j[(r, c)] * j[(r + 1, c + 1)] - j[(r, c + 1)] * j[(r + 1, c)];
            match (N, turret) {
                (2, _) => minor(0, 0),
                (_, true) => minor(0, 1),
                // The elbow of the redundant arm is stretched or folded where sin q₂ = 0.
                _ => q[1].sin(),
            }
        }
    }
}

/// Searches along a random path from a regular pose for a pose at the target and near this kind of singularity only.
fn pose_near<M: Mechanism<f64, N>, const N: usize>(
    m: &M,
    singularity: Singularity,
    target: Target,
    scale: f64,
    random: &mut Random,
) -> Option<SVector<f64, N>> {
    let start: SVector<f64, N> = random.pose(m);
    let direction: SVector<f64, N> = random.vector(1.0);
    let at = |t: f64| start + direction * t;
    let regular = |t: f64| {
        let r = m.regularity(&m.pose::<Libm>(&at(t)));
        (r.serial, r.parallel)
    };
    let (serial, parallel) = regular(0.0);
    if serial.min(parallel) < 0.2 || nearness(m, &start, target, scale) > 0.7 {
        return None;
    }
    let before = signed_gap(m, &start, singularity);
    let step = 0.01;
    let crossing =
        (1..200).map(|k| step * f64::from(k)).find(|t| signed_gap(m, &at(*t), singularity) * before <= 0.0)?;
    let bisect = |mut low: f64, mut high: f64, beyond: &dyn Fn(f64) -> bool| {
        for _ in 0..80 {
            let middle = 0.5 * (low + high);
            if beyond(middle) { high = middle } else { low = middle }
        }
        low
    };
    let singular = bisect(crossing - step, crossing, &|t| signed_gap(m, &at(t), singularity) * before <= 0.0);
    let pose = bisect(0.0, singular, &|t| nearness(m, &at(t), target, scale) > 1.0);
    // The pose must be far from all other singularities.
    let r = m.regularity(&m.pose::<Libm>(&at(pose)));
    let clear = |other: Singularity| {
        other == singularity || signed_gap(m, &at(pose), other).abs() > 0.2 * signed_gap(m, &start, other).abs()
    };
    let alone = match singularity {
        Singularity::Rods => r.serial > 0.2,
        Singularity::Elbow => r.parallel > 0.2 && (M::SPEC.task < 3 || clear(Singularity::Axis)),
        Singularity::Axis => r.parallel > 0.2 && clear(Singularity::Elbow),
        Singularity::Serial => r.parallel > 0.2,
    };
    (alone && (nearness(m, &at(pose), target, scale) - 1.0).abs() < 0.01).then(|| at(pose))
}

/// Scales joint velocities down to a tip speed of at most 0.5 m/s (a hand), because a slow joint moves the tip fast
/// near a parallel singularity.
pub fn at_hand_speed<M: Mechanism<f64, N>, const N: usize>(
    m: &M,
    q: &SVector<f64, N>,
    qd: SVector<f64, N>,
) -> SVector<f64, N> {
    let velocity = m.velocity(&m.pose::<Libm>(q), &qd);
    let speed = velocity.iter().take(M::SPEC.task).map(|v| v * v).sum::<f64>().sqrt();
    qd * (0.5 / speed).min(1.0)
}

pub fn cast<A: Real, B: Real, const N: usize>(v: &SVector<A, N>) -> SVector<B, N> {
    v.map(|x| B::from_f64(x.to_f64()))
}

/// Computes the errors near one kind of singularity, at poses with angles rounded to f32. Skips poses that this
/// rounding moves too far from the target.
fn row<A, B, C, const N: usize>(
    (double, board, reference): (&A, &B, &C),
    device: &'static str,
    singularity: Singularity,
    target: Target,
    scale: f64,
) -> Row
where
    A: Mechanism<f64, N>,
    B: Mechanism<f32, N>,
    C: Mechanism<Exact, N>,
{
    let mut random = Random(7);
    let mut row = Row {
        device,
        singularity,
        target,
        poses: 0,
        regularity: f64::INFINITY,
        board: Errors::default(),
        double: Errors::default(),
        reference: 0.0,
        quantities: QuantityErrors::default(),
    };
    for _ in 0..MAX_PATHS {
        if row.poses == MAX_POSES {
            break;
        }
        let Some(q) = pose_near(double, singularity, target, scale, &mut random) else { continue };
        let q: SVector<f32, N> = cast(&q);
        if !(0.5..2.0).contains(&nearness(double, &cast(&q), target, scale)) {
            continue;
        }
        row.poses += 1;
        let r = double.regularity(&double.pose::<Libm>(&cast(&q)));
        row.regularity = row.regularity.min(r.serial).min(r.parallel);
        for _ in 0..NORMALS_PER_POSE {
            let n: SVector<f32, N> = cast(&random.normal::<N>(A::SPEC.task));
            let qd: SVector<f32, N> = cast(&at_hand_speed(double, &cast(&q), random.vector(1.0)));
            let exact = routes::<_, ExactMath, _, N>(reference, &cast(&q), &cast(&qd), &cast(&n));
            row.board.grow(&Errors::new(&routes::<_, BoardMath, _, N>(board, &q, &qd, &n), &exact));
            row.double.grow(&Errors::new(&routes::<_, Libm, _, N>(double, &cast(&q), &cast(&qd), &cast(&n)), &exact));
            let found = all_quantities::<_, FineTable, _, N>(double, &cast(&q), &cast(&qd), &cast(&n));
            let exact_whole = all_quantities::<_, ExactMath, _, N>(reference, &cast(&q), &cast(&qd), &cast(&n));
            row.quantities.grow(&QuantityErrors::new(&found, &exact_whole));
            row.reference = Errors::new(&exact, &exact).all().fold(row.reference, f64::max);
        }
    }
    row
}

pub fn rows(name: &'static str, device: &Description, singularity: Singularity) -> Vec<Row> {
    let scale = mean_length(device);
    let targets = singularity.targets().into_iter();
    in_three_precisions!(device, (a, b, c) => {
        let rows = targets.map(|target| row((&a, &b, &c), name, singularity, target, scale));
        rows.filter(|row| row.poses > 0).collect()
    })
}

/// Returns a five-bar whose rods can stretch into one line, unlike those of the shipped devices.
pub fn wide_five_bar() -> Description {
    let mut device = shipped_device("coupled-five-bar");
    device.geometry[0] = 0.1;
    device
}

pub fn all_rows() -> Vec<Row> {
    [
        ("five-bar (haply-2diy)", shipped_device("haply-2diy"), Singularity::Elbow),
        ("five-bar (wide base)", wide_five_bar(), Singularity::Rods),
        ("five-bar-turret", shipped_device("fictive-five-bar-turret"), Singularity::Elbow),
        ("five-bar-turret", shipped_device("fictive-five-bar-turret"), Singularity::Axis),
        ("five-bar-turret", shipped_device("fictive-five-bar-turret"), Singularity::Rods),
        ("parallelogram (Phantom)", shipped_device("phantom-premium-1.5"), Singularity::Elbow),
        ("parallelogram (Phantom)", shipped_device("phantom-premium-1.5"), Singularity::Axis),
        ("serial-3r", shipped_device("serial-3r"), Singularity::Elbow),
        ("chain-1", single_arm(), Singularity::Serial),
        ("chain-2", shipped_device("planar-arm"), Singularity::Serial),
        ("chain-2 (slide)", polar_arm(), Singularity::Serial),
        ("chain-3", shipped_device("touch"), Singularity::Serial),
        ("delta", shipped_device("falcon-like"), Singularity::Serial),
        ("delta", shipped_device("falcon-like"), Singularity::Rods),
    ]
    .into_iter()
    .flat_map(|(name, device, singularity)| rows(name, &device, singularity))
    .collect()
}
