//! Poses at a chosen conditioning of J on the way into each kind of singularity, and the routes' errors there.

use super::routes::{Errors, routes};
use super::shipped;
use super::whole::{WholeErrors, whole};
use super::{Exact, ExactMath};
use haptic_bridge::control::compiled::BoardMath;
use haptic_bridge::math::{FineTable, Libm, Real};
use haptic_bridge::model::description::Description;
use haptic_bridge::model::mechanism::Mechanism;
use haptic_bridge::render::controller::{FULL_REGULARITY, NO_REGULARITY, PARALLEL_REGULARITY};
use nalgebra::{DMatrix, SVector};

/// The part that degenerates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Singularity {
    /// An arm stretches or folds: serial.
    Elbow,
    /// The tip comes onto the turret's axis: serial.
    Axis,
    /// The closed loop stretches: parallel.
    Rods,
}

/// The distance to come to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Target {
    /// cond J.
    Condition(f64),
    /// The sine by which the board judges (`Regularity`).
    Sine(f64),
}

impl Singularity {
    /// The sine at which the board's feed-forward begins to fade, and at which it is off.
    pub fn fade(self) -> [f64; 2] {
        let scale = if self == Self::Rods { PARALLEL_REGULARITY } else { 1.0 };
        [FULL_REGULARITY, NO_REGULARITY].map(|sine| sine * scale)
    }

    /// Rows of the table: the two edges of the fade, then ever worse conditioning.
    fn targets(self) -> Vec<Target> {
        let conditions = [1e1, 1e2, 1e3, 1e4, 1e5].map(Target::Condition);
        self.fade().map(Target::Sine).into_iter().chain(conditions).collect()
    }
}

/// Poses tried per row.
const POSES: usize = 60;
/// Random paths tried to find them.
const TRIES: usize = 4_000;
/// Normals per pose.
const NORMALS: usize = 5;

/// One row of the table.
#[derive(Clone, Debug)]
pub struct Row {
    pub device: &'static str,
    pub singularity: Singularity,
    pub target: Target,
    /// Poses found.
    pub poses: usize,
    /// Smallest regularity (sine) among them.
    pub regularity: f64,
    /// Of the board's numbers: f32 with minimax sines.
    pub board: Errors,
    /// Of double precision.
    pub double: Errors,
    /// Difference of the routes in the reference.
    pub reference: f64,
    /// Of the whole of (4) in double precision.
    pub whole: WholeErrors,
}

/// A reproducible stream of numbers (Steele, Lea and Flood's SplitMix64).
pub struct Random(pub u64);

impl Random {
    /// Evenly from `low..high`.
    pub fn within(&mut self, low: f64, high: f64) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        low + (high - low) * ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Each entry from `-bound..bound`.
    pub fn vector<const N: usize>(&mut self, bound: f64) -> SVector<f64, N> {
        SVector::from_fn(|_, _| self.within(-bound, bound))
    }
}

/// Largest over smallest singular value of J; φ, where there is one, in lengths of `scale` metres.
fn condition<M: Mechanism<f64, N>, const N: usize>(m: &M, q: &SVector<f64, N>, scale: f64) -> f64 {
    let jacobian = m.jacobian(&m.pose::<Libm>(q));
    let unit = |row: usize| if row < M::SPEC.task { 1.0 } else { scale };
    let values = DMatrix::from_fn(N, N, |i, j| jacobian[(i, j)] * unit(i)).singular_values();
    values.max() / values.min()
}

/// The distance of a pose from its target: 1 there, more beyond.
fn nearness<M: Mechanism<f64, N>, const N: usize>(m: &M, q: &SVector<f64, N>, target: Target, scale: f64) -> f64 {
    match target {
        Target::Condition(most) => condition(m, q, scale) / most,
        Target::Sine(least) => {
            let r = m.regularity(&m.pose::<Libm>(q));
            least / r.serial.min(r.parallel)
        }
    }
}

/// A number whose sign changes where `singularity` is met.
fn side<M: Mechanism<f64, N>, const N: usize>(m: &M, q: &SVector<f64, N>, singularity: Singularity) -> f64 {
    let mut q = *q;
    let turret = M::SPEC.task == 3;
    if turret {
        q[0] = 0.0;
    }
    let pose = m.pose::<Libm>(&q);
    // With the turret at zero the tip's distance from its axis is the world's y or x; J's turret column is along Z.
    let radius = m.jacobian(&pose)[(N - 1, 0)];
    match singularity {
        Singularity::Axis => radius,
        Singularity::Rods => m.regularity(&pose).parallel - 1e-9,
        Singularity::Elbow => {
            let j = m.jacobian(&pose);
            let minor = |r: usize, c: usize| j[(r, c)] * j[(r + 1, c + 1)] - j[(r, c + 1)] * j[(r + 1, c)];
            match (N, turret) {
                (2, _) => minor(0, 0),
                (_, true) => minor(0, 1),
                // The redundant arm: sin q₂.
                _ => q[1].sin(),
            }
        }
    }
}

/// A pose of the given conditioning near a singularity of the given kind, and no other; `None` when the random path
/// from a random regular pose meets none.
fn pose_near<M: Mechanism<f64, N>, const N: usize>(
    m: &M,
    singularity: Singularity,
    target: Target,
    scale: f64,
    random: &mut Random,
) -> Option<SVector<f64, N>> {
    let start: SVector<f64, N> = random.vector(3.1);
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
    let before = side(m, &start, singularity);
    let step = 0.01;
    let crossing = (1..200).map(|k| step * f64::from(k)).find(|t| side(m, &at(*t), singularity) * before <= 0.0)?;
    let bisect = |mut low: f64, mut high: f64, beyond: &dyn Fn(f64) -> bool| {
        for _ in 0..80 {
            let middle = 0.5 * (low + high);
            if beyond(middle) { high = middle } else { low = middle }
        }
        low
    };
    let singular = bisect(crossing - step, crossing, &|t| side(m, &at(t), singularity) * before <= 0.0);
    let pose = bisect(0.0, singular, &|t| nearness(m, &at(t), target, scale) > 1.0);
    // One singularity at a time: whatever else there is must be far away.
    let r = m.regularity(&m.pose::<Libm>(&at(pose)));
    let clear = |other: Singularity| {
        other == singularity || side(m, &at(pose), other).abs() > 0.2 * side(m, &start, other).abs()
    };
    let alone = match singularity {
        Singularity::Rods => r.serial > 0.2,
        Singularity::Elbow => r.parallel > 0.2 && (M::SPEC.task < 3 || clear(Singularity::Axis)),
        Singularity::Axis => r.parallel > 0.2 && clear(Singularity::Elbow),
    };
    (alone && (nearness(m, &at(pose), target, scale) - 1.0).abs() < 0.01).then(|| at(pose))
}

/// Joint velocities, slowed down until the tip moves no faster than a hand does (0.5 m/s): near a parallel singularity
/// a slow joint moves the tip fast.
pub fn at_hand_speed<M: Mechanism<f64, N>, const N: usize>(
    m: &M,
    q: &SVector<f64, N>,
    qd: SVector<f64, N>,
) -> SVector<f64, N> {
    let velocity = m.velocity(&m.pose::<Libm>(q), &qd);
    let speed = velocity.iter().take(M::SPEC.task).map(|v| v * v).sum::<f64>().sqrt();
    qd * (0.5 / speed).min(1.0)
}

/// A vector in another precision.
pub fn cast<A: Real, B: Real, const N: usize>(v: &SVector<A, N>) -> SVector<B, N> {
    v.map(|x| B::from_f64(x.to_f64()))
}

/// The errors near one kind of singularity. A pose's truth is the angles as f32 holds them; poses that this rounding
/// takes elsewhere (nearer than f32 angles can say) are left out.
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
        whole: WholeErrors::default(),
    };
    for _ in 0..TRIES {
        if row.poses == POSES {
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
        for _ in 0..NORMALS {
            let mut n: SVector<f32, N> = cast(&random.vector::<N>(1.0));
            for i in A::SPEC.task..N {
                n[i] = 0.0;
            }
            let qd: SVector<f32, N> = cast(&at_hand_speed(double, &cast(&q), random.vector(1.0)));
            let exact = routes::<_, ExactMath, _, N>(reference, &cast(&q), &cast(&qd), &cast(&n));
            row.board.grow(&Errors::new(&routes::<_, BoardMath, _, N>(board, &q, &qd, &n), &exact));
            row.double.grow(&Errors::new(&routes::<_, Libm, _, N>(double, &cast(&q), &cast(&qd), &cast(&n)), &exact));
            let held = whole::<_, FineTable, _, N>(double, &cast(&q), &cast(&qd), &cast(&n));
            row.whole.grow(&held, &whole::<_, ExactMath, _, N>(reference, &cast(&q), &cast(&qd), &cast(&n)));
            row.reference = Errors::new(&exact, &exact).all().into_iter().fold(row.reference, f64::max);
        }
    }
    row
}

/// All rows of one device and singularity.
pub fn rows(name: &'static str, device: &Description, singularity: Singularity) -> Vec<Row> {
    let scale = device.geometry[..3].iter().sum::<f64>() / 3.0;
    let targets = singularity.targets().into_iter();
    in_three_precisions!(device, (a, b, c) => {
        let rows = targets.map(|target| row((&a, &b, &c), name, singularity, target, scale));
        rows.filter(|row| row.poses > 0).collect()
    })
}

/// A five-bar whose rods can stretch into one line, which the shipped ones cannot.
pub fn wide_five_bar() -> Description {
    let mut device = shipped("coupled-five-bar");
    device.geometry[0] = 0.1;
    device
}

/// Every singularity of every mechanism that has one.
pub fn all() -> Vec<Row> {
    [
        ("five-bar (haply-2diy)", shipped("haply-2diy"), Singularity::Elbow),
        ("five-bar (wide base)", wide_five_bar(), Singularity::Rods),
        ("five-bar-turret", shipped("fictive-five-bar-turret"), Singularity::Elbow),
        ("five-bar-turret", shipped("fictive-five-bar-turret"), Singularity::Axis),
        ("five-bar-turret", shipped("fictive-five-bar-turret"), Singularity::Rods),
        ("parallelogram (Phantom)", shipped("phantom-premium-1.5"), Singularity::Elbow),
        ("parallelogram (Phantom)", shipped("phantom-premium-1.5"), Singularity::Axis),
        ("serial-3r", shipped("serial-3r"), Singularity::Elbow),
    ]
    .into_iter()
    .flat_map(|(name, device, singularity)| rows(name, &device, singularity))
    .collect()
}
