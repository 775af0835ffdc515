//! The tables in docs/claims/: the paper's claims in numbers, computed with the board's own control step.
//!
//! The loop consists of the library's `Controller` in f32 with the firmware's trigonometry and the simulator's
//! nonlinear linkage without friction. Torques act without delay.

use crate::common::prelude::*;
use crate::common::{csv, ideal_loop, plane_wall, shipped_device};
use haptic_bridge::control::compiled::BoardMath;
use haptic_bridge::model::mechanism::FiveBar;
use haptic_bridge::render::controller::{Controller, FULL_REGULARITY, PARALLEL_REGULARITY};
use haptic_sim::{Load, Plant};
use haptic_stability::analysis::pose::TaskPose;
use haptic_stability::analysis::range::predict;
use haptic_stability::model::{Precision, WallForce, evaluate};
use haptic_stability::perception::{AlongWall, Perception};
use nalgebra::Vector2;

#[path = "moving.rs"]
mod moving;

pub const RATE_HZ: f64 = 1_000.0;
const CUTOFF_HZ: f64 = 100.0;
/// Stiffness of the wall in all runs, N/m: far below the limit with or without the feed-forward.
const STIFFNESS: f64 = 10_000.0;
/// Damping of the wall in all runs, N s/m.
const DAMPING: f64 = 40.0;
/// Counts per turn at which encoder steps have no effect.
pub const FINE_COUNTS_PER_TURN: f64 = 16_777_216.0;
/// Joint angles of the demo's device at home, rad.
const HOME: [f64; 2] = [2.3, 0.841_592_653_589_79];
/// Joint angles in the demo's pose, rad, and the direction of the normal of the demo's wall, degrees.
pub const DEMO_POSE: ([f64; 2], f64) = ([2.6, 1.75], 75.0);

pub fn five_bar() -> Description {
    shipped_device("coupled-five-bar").description
}

fn five_bar_mechanism() -> FiveBar<f64> {
    let mechanism = AnyMechanism::new(&five_bar()).expect("a shipped device");
    let AnyMechanism::FiveBar(mechanism) = mechanism else { panic!("a five-bar") };
    mechanism
}

fn unit_vector(degrees: f64) -> Vector2<f64> {
    Vector2::new(degrees.to_radians().cos(), degrees.to_radians().sin())
}

/// One run at a bilateral wall through the tip.
pub struct WallRun {
    pub q: [f64; 2],
    /// Direction of the normal, degrees.
    pub normal: f64,
    /// Speed along the wall at the start, m/s.
    pub speed: f64,
    /// External push along the wall, N, and its duration, s.
    pub push: (f64, f64),
    pub counts_per_turn: f64,
    pub feed_forward: FeedForward,
    pub velocity_terms: VelocityTerms,
}

impl WallRun {
    pub fn new((q, normal): ([f64; 2], f64)) -> Self {
        Self {
            q,
            normal,
            speed: 0.0,
            push: (0.0, 0.0),
            counts_per_turn: FINE_COUNTS_PER_TURN,
            feed_forward: FeedForward::Full,
            velocity_terms: VelocityTerms::Rendered,
        }
    }

    /// Returns the largest distance of the tip from the wall's surface within `seconds`, m.
    pub fn largest_distance(&self, seconds: f64) -> f64 {
        let description = five_bar();
        let mut plant =
            Plant::new(&description, [self.q[0], self.q[1], 0.0], false, [(f64::NEG_INFINITY, f64::INFINITY); 3])
                .expect("a shipped device");
        let (n, t) = (unit_vector(self.normal), unit_vector(self.normal + 90.0));
        let start = Vector2::new(plant.tip()[0], plant.tip()[1]);
        let mut scene = Scene::<f32> {
            task: 2,
            rate_hz: RATE_HZ as f32,
            cutoff_hz: CUTOFF_HZ as f32,
            velocity_terms: self.velocity_terms,
            ..Scene::default()
        };
        let place = |v: &Vector2<f64>| [v.x as f32, v.y as f32, 0.0];
        let plane = plane_wall(place(&start), place(&n), STIFFNESS as f32, DAMPING as f32);
        scene.walls.push(Wall { feed_forward: self.feed_forward, bilateral: true, ..plane }).expect("room for a wall");
        let mut known = description;
        for joint in &mut known.joints[..2] {
            joint.encoder.as_mut().expect("a shipped device has encoders").counts_per_turn = self.counts_per_turn;
        }
        let device = Device::<f32>::new("claims", &known).expect("a shipped device");
        let AnyMechanism::FiveBar(mechanism) = device.mechanism else { panic!("a five-bar") };
        let mut controller =
            Controller::<f32, FiveBar<f32>, BoardMath, 2>::new(mechanism, &device, &scene).expect("a sound scene");
        let per_rad = self.counts_per_turn / std::f64::consts::TAU;
        let counts = |q: [f64; 3]| [(q[0] * per_rad).round() as i32, (q[1] * per_rad).round() as i32];
        plant.push([self.speed * t.x, self.speed * t.y, 0.0]);
        // Before the start the estimators receive a motion of the tip along the wall.
        for k in -60..0 {
            let before = start + t * (self.speed * f64::from(k) / RATE_HZ);
            controller.step(&counts(joints_at(&description, self.q, &before)));
        }
        const STEPS_PER_SAMPLE: u32 = 10;
        let mut farthest = 0.0_f64;
        for k in 0..(seconds * RATE_HZ) as u32 {
            let step = controller.step(&counts(plant.q()));
            let pushing = if f64::from(k) < self.push.1 * RATE_HZ { self.push.0 } else { 0.0 };
            let load = Load {
                torque: [f64::from(step.torque[0]), f64::from(step.torque[1]), 0.0],
                damping: [0.0; 3],
                force: [pushing * t.x, pushing * t.y, 0.0],
            };
            for _ in 0..STEPS_PER_SAMPLE {
                plant.step(&load, 1.0 / RATE_HZ / f64::from(STEPS_PER_SAMPLE));
            }
            let off = n.dot(&(Vector2::new(plant.tip()[0], plant.tip()[1]) - start));
            farthest = farthest.max(off.abs());
        }
        farthest
    }
}

/// Returns the joint angles near `q` that bring the tip to `place`, by Newton's method.
fn joints_at(description: &Description, q: [f64; 2], place: &Vector2<f64>) -> [f64; 3] {
    let mut q = Vector2::from(q);
    for _ in 0..8 {
        let pose = TaskPose::at(description, q.as_slice()).expect("angles");
        let left = nalgebra::DVector::from_fn(2, |i, _| place[i] - pose.position[i]);
        let by = &pose.inverse * left;
        q += Vector2::new(by[0], by[1]);
    }
    [q[0], q[1], 0.0]
}

pub const VELOCITY_TERMS: [VelocityTerms; 3] = [VelocityTerms::Off, VelocityTerms::Paper, VelocityTerms::Rendered];
/// Slides along a wall: joint angles, rad, direction of the normal, degrees, and speed, m/s.
pub const SLIDES: [([f64; 2], f64, f64); 3] =
    [([2.3, 0.841_592_653_589_79], 90.0, 0.5), ([2.3, 0.841_592_653_589_79], 37.0, 0.5), ([2.6, 1.75], 75.0, -0.5)];

/// Returns the largest distance of a sliding tip from its wall, m.
pub fn slide_distance((q, normal, speed): ([f64; 2], f64, f64), terms: VelocityTerms, counts_per_turn: f64) -> f64 {
    WallRun { speed, velocity_terms: terms, counts_per_turn, ..WallRun::new((q, normal)) }.largest_distance(0.04)
}

/// Largest distances of sliding tips from their walls, µm, in [`RANDOM_SLIDES`] slides. The slides have random normals
/// and directions and start in random poses within 0.6 rad of home and away from singular poses.
pub struct SlideStatistics {
    /// Medians of "off", "paper" and "rendered".
    pub medians: [f64; 3],
    /// Number of slides in which "rendered" is worse than "off".
    pub worse: usize,
}

/// Number of slides of a [`SlideStatistics`].
const RANDOM_SLIDES: usize = 120;

pub fn random_slides(counts_per_turn: f64) -> SlideStatistics {
    let description = five_bar();
    let mut random = Random::new(15);
    let mut between = |low, high| random.between(low, high);
    let mut found: [Vec<f64>; 3] = Default::default();
    while found[0].len() < RANDOM_SLIDES {
        let q = HOME.map(|angle| angle + between(-0.6, 0.6));
        let (normal, speed) = (between(0.0, 360.0), if between(-1.0, 1.0) < 0.0 { -0.5 } else { 0.5 });
        if !is_regular(q) {
            continue;
        }
        let start = TaskPose::at(&description, &q).expect("angles").position;
        let along = unit_vector(normal + 90.0) * speed;
        let clear_at = |seconds: f64| {
            let place = Vector2::new(start[0], start[1]) + along * seconds;
            let [a, b, _] = joints_at(&description, q, &place);
            let there = TaskPose::at(&description, &[a, b]).map(|pose| (pose.position[0], pose.position[1]));
            is_regular([a, b]) && there.is_ok_and(|(x, y)| (place - Vector2::new(x, y)).norm() < 1e-9)
        };
        if ![-0.06, -0.03, 0.02, 0.04].into_iter().all(clear_at) {
            continue;
        }
        for (found, terms) in found.iter_mut().zip(VELOCITY_TERMS) {
            found.push(1e6 * slide_distance((q, normal, speed), terms, counts_per_turn));
        }
    }
    let worse = found[0].iter().zip(&found[2]).filter(|(off, rendered)| rendered > off).count();
    let median = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        0.5 * (values[RANDOM_SLIDES / 2 - 1] + values[RANDOM_SLIDES / 2])
    };
    SlideStatistics { medians: found.map(median), worse }
}

/// Returns true if the feed-forward acts in full at a pose of the demo's device.
fn is_regular(q: [f64; 2]) -> bool {
    let mechanism = five_bar_mechanism();
    let regularity = mechanism.regularity(&mechanism.pose::<Libm>(&Vector2::from(q)));
    regularity.serial.min(regularity.parallel / PARALLEL_REGULARITY) >= FULL_REGULARITY
}

pub fn demo_device() -> Linearised {
    linearise(&five_bar(), DEMO_POSE).undamped()
}

/// Linearises a device at a pose along a normal.
fn linearise(description: &Description, (q, normal): ([f64; 2], f64)) -> Linearised {
    let n = unit_vector(normal);
    Linearised::at(description, &q, &[n.x, n.y]).expect("a regular pose")
}

/// Returns kp_max (N/m) at 40 N s/m, without and with the feed-forward of this device.
pub fn max_stiffness(device: &Linearised) -> (f64, f64) {
    let around = ideal_loop(RATE_HZ, 0.025, LinearEstimator::Butterworth(CUTOFF_HZ));
    let range = predict(device, &around, Some(&[DAMPING]), None).expect("an analysable pose");
    (range.off.boundary[0].kp, range.full.boundary[0].kp)
}

/// Returns kp_max (N/m) of the demo's wall while the tip slides at `speed` (m/s). The law `None` renders Jᵀ f.
pub fn max_stiffness_while_sliding(speed: f64, law: Option<VelocityTerms>) -> f64 {
    let mechanism = five_bar_mechanism();
    let sliding = moving::SlidingLoop { mechanism, q: DEMO_POSE.0, normal: DEMO_POSE.1, law };
    sliding.stability_limit(speed, DAMPING, (8_000.0, 60_000.0), RATE_HZ, CUTOFF_HZ)
}

/// Returns the largest distance from the wall within 60 ms, m, after a push of 2 N along the wall for 30 ms.
pub fn push_distance(feed_forward: FeedForward) -> f64 {
    WallRun { push: (2.0, 0.03), feed_forward, ..WallRun::new(DEMO_POSE) }.largest_distance(0.06)
}

/// A board's model of the demo's device.
pub struct AssumedModel {
    pub description: Description,
    /// Assumed minus true joint angles, rad.
    pub homed_off: [f64; 2],
}

impl AssumedModel {
    /// Returns a model with rotor inertias and handle mass multiplied by these factors.
    pub fn scaled_inertias(rotors: [f64; 2], handle: f64) -> Self {
        let mut description = five_bar();
        description.joints.iter_mut().zip(rotors).for_each(|(joint, factor)| joint.inertia *= factor);
        description.handle_mass *= handle;
        Self { description, homed_off: [0.0; 2] }
    }

    /// Returns the share of the gained inertia that remains when a board with this model controls the real device.
    pub fn gain_kept(&self, (q, normal): ([f64; 2], f64)) -> f64 {
        let model = linearise(&self.description, (self.assumed_angles(q), normal));
        let real = linearise(&five_bar(), (q, normal));
        let mass = real.mass.clone().cholesky().expect("positive definite");
        let inertia = |torque| 1.0 / model.row.dot(&mass.solve(torque));
        (inertia(&model.shaped_torque()) - inertia(&model.row)) / (real.w_rr() - real.w_eff().expect("a regular pose"))
    }

    fn assumed_angles(&self, q: [f64; 2]) -> [f64; 2] {
        [q[0] + self.homed_off[0], q[1] + self.homed_off[1]]
    }
}

/// Returns possible errors in the model of the demo's device, with all combinations of signs.
pub fn wrong_models() -> Vec<(String, Vec<AssumedModel>)> {
    let half = [0.5, 1.5];
    let both = || half.into_iter().flat_map(move |first| half.map(|second| [first, second]));
    let one = half.into_iter().flat_map(|by| [[by, 1.0], [1.0, by]]);
    let mut all = vec![
        ("one rotor, by a half".into(), one.map(|rotors| AssumedModel::scaled_inertias(rotors, 1.0)).collect()),
        ("both rotors, by a half".into(), both().map(|rotors| AssumedModel::scaled_inertias(rotors, 1.0)).collect()),
        (
            "both rotors and the handle, by a half".into(),
            both().flat_map(|rotors| half.map(|handle| AssumedModel::scaled_inertias(rotors, handle))).collect(),
        ),
    ];
    for off in [0.02, 0.05, 0.1] {
        let sides = [[off, off], [off, -off], [-off, off], [-off, -off]];
        let homed = sides.map(|homed_off| AssumedModel { homed_off, ..AssumedModel::scaled_inertias([1.0; 2], 1.0) });
        all.push((format!("home, by {off} rad in both joints"), homed.into()));
    }
    all
}

/// Shares of the inertia gain that wrong models keep, at poses where the feed-forward has a clear benefit.
pub struct GainRetained {
    pub cases: usize,
    /// Number of cases that keep less than seven eighths of the gain.
    pub below: usize,
    pub least: f64,
    pub most: f64,
}

/// Evaluates poses within 0.6 rad of home in steps of 0.05 rad and normals in steps of 15°, if Wrr/Weff is above 1.3.
pub fn gain_kept_around_home(wrong_models: &[AssumedModel]) -> GainRetained {
    let description = five_bar();
    let mut gain = GainRetained { cases: 0, below: 0, least: f64::INFINITY, most: f64::NEG_INFINITY };
    let steps = |i: i32| 0.05 * f64::from(i);
    for (a, b) in (-12..=12).flat_map(|a| (-12..=12).map(move |b| (a, b))) {
        let q = [HOME[0] + steps(a), HOME[1] + steps(b)];
        if !is_regular(q) {
            continue;
        }
        for normal in (0..12).map(|i| 15.0 * f64::from(i)) {
            let device = linearise(&description, (q, normal));
            if device.w_rr() / device.w_eff().expect("a regular pose") <= 1.3 {
                continue;
            }
            let models = wrong_models.iter().filter(|model| is_regular(model.assumed_angles(q)));
            for share in models.map(|model| model.gain_kept((q, normal))) {
                gain.cases += 1;
                gain.below += usize::from(share < 0.875);
                (gain.least, gain.most) = (gain.least.min(share), gain.most.max(share));
            }
        }
    }
    gain
}

/// Returns the angle between a push on the free tip along the demo's normal and the motion of the tip, degrees.
pub fn free_deflection() -> f64 {
    let device = demo_device();
    let t = unit_vector(DEMO_POSE.1 + 90.0);
    let along = Linearised::at(&five_bar(), &DEMO_POSE.0, &[t.x, t.y]).expect("a regular pose");
    let answer = device.mass.clone().cholesky().expect("positive definite").solve(&device.row);
    (along.row.dot(&answer)).atan2(device.row.dot(&answer)).to_degrees()
}

/// Returns the inertias that a hand feels in the air and along the demo's wall.
fn felt_inertias() -> Perception {
    let normal = unit_vector(DEMO_POSE.1).as_slice().to_vec();
    let wall = WallForce { normal, force: 0.0, stiffness: 1.0, feed_forward: true };
    evaluate(&shipped_device("coupled-five-bar"), &DEMO_POSE.0, &[0.0; 2], &[wall], Precision::F64)
        .expect("a regular pose")
        .perception
}

/// Returns Wrr/Weff of the serial-3r in the pose (0.5, 0.8, 0.7) along the normal (0.6, 0.8) for an admissible set.
pub fn inertia_ratio(admissible: Admissible) -> f64 {
    let arm = Linearised::holding(&shipped_device("serial-3r").description, &[0.5, 0.8, 0.7], &[0.6, 0.8], admissible)
        .expect("regular");
    arm.w_rr() / arm.w_eff().expect("regular")
}

/// Returns the names and contents of the CSV files in docs/claims/.
pub fn tables() -> [(&'static str, String); 7] {
    let table = |head: &str, rows: Vec<String>| csv([head.to_string()].into_iter().chain(rows));
    let encoders = [("ideal", FINE_COUNTS_PER_TURN), ("20 000 counts", 20_000.0)];
    let mut device = demo_device();
    let gains = [0.0, 0.5, 1.0, 1.5, 2.0, 2.5].map(|gain| {
        device.gain = gain;
        let coupling = 1.0 - device.w_eff().unwrap_or(0.0) / device.w_rr();
        let sensitivity = gain * coupling / (1.0 - gain * coupling);
        let inertia_met = device.inertia_met().unwrap_or(f64::NAN);
        format!("{gain} | {inertia_met:.3} | {:.1} | {sensitivity:.2}", max_stiffness(&device).1 / 1e3)
    });
    let [off, full] = [FeedForward::Off, FeedForward::Full].map(push_distance);
    let push = [("off", 1e6 * off, 0), ("full", 1e6 * full, 0), ("ratio", full / off, 2)];
    let push = push.map(|(name, far, digits)| format!("{name} | {far:.digits$}"));
    let rotor_head = "the model's rotor inertia | rotor 0: gain kept, % | rotor 1: gain kept, %";
    let rotors = [-50, -25, -10, 10, 25, 50].map(|percent| {
        let by = 1.0 + f64::from(percent) / 100.0;
        let [first, second] = [[by, 1.0], [1.0, by]]
            .map(|rotors| 100.0 * AssumedModel::scaled_inertias(rotors, 1.0).gain_kept(DEMO_POSE));
        format!("{percent:+} % | {first:.1} | {second:.1}")
    });
    let home_head = "wrong around home | cases | keep less than 87.5 %, % of them | least and most kept, %";
    let around_home = wrong_models().into_iter().map(|(name, wrong_models)| {
        let GainRetained { cases, below, least, most } = gain_kept_around_home(&wrong_models);
        let share = 100.0 * below as f64 / cases as f64;
        format!("{name} | {cases} | {share:.1} | {:.1} to {:.1}", 100.0 * least, 100.0 * most)
    });
    let slides = SLIDES.into_iter().flat_map(|case| {
        let (q, normal, speed) = case;
        encoders.map(|(name, counts)| {
            let [off, paper, rendered] = VELOCITY_TERMS.map(|terms| 1e6 * slide_distance(case, terms, counts));
            let case = format!("({:.2}, {:.2}), {normal}°, {speed} m/s", q[0], q[1]);
            format!("{case} | {name} | {off:.1} | {paper:.1} | {rendered:.1}")
        })
    });
    let columns = "off, µm | paper, µm | rendered, µm | rendered worse than off";
    let slides_head = format!("{RANDOM_SLIDES} slides, medians | {columns}");
    let medians = encoders.map(|(name, counts)| {
        let SlideStatistics { medians: [off, paper, rendered], worse } = random_slides(counts);
        format!("{name} | {off:.0} | {paper:.0} | {rendered:.2} | {worse}")
    });
    let redundant = Admissible::ALL.map(|(name, admissible)| {
        let ratio = inertia_ratio(admissible);
        format!("{name} | {ratio:.2} | x {:.2}", ratio * ratio)
    });
    [
        ("gain", table("gain | inertia met, kg | kp_max, kN/m | 1 % of coupling changes it by, %", gains.into())),
        ("push", table("feed-forward | farthest in or out of the wall within 60 ms, µm", push.into())),
        ("wrong-rotor", table(rotor_head, rotors.into())),
        ("wrong-around-home", table(home_head, around_home.collect())),
        ("sliding", table("q, normal, speed | encoder | off, µm | paper, µm | rendered, µm", slides.collect())),
        ("many-slides", table(&slides_head, medians.into())),
        ("redundant", table("held | Wrr/Weff | area gained", redundant.into())),
    ]
}

/// Returns computed sentences that docs/claims.md must contain.
pub fn sentences() -> [String; 2] {
    let Perception { tip, ratio, along_wall } = felt_inertias();
    let AlongWall { off, full } = along_wall.expect("a wall");
    [
        format!("A push along the normal moves the free tip {:.1}° off it.", free_deflection().abs()),
        format!(
            "A hand feels {:.3} to {:.3} kg in the air, by direction ({ratio:.1} times), and along the wall {:.3} kg \
             off, {:.3} full.",
            tip[0], tip[1], off[0], full[0]
        ),
    ]
}
