//! Velocity terms that the board fades out count as an error of the rendered force.

use crate::common::prelude::*;
use crate::common::{plane_wall, shipped_device, shipped_path};
use haptic_bridge::render::controller::Controller;
use haptic_predict::bench::error::{Law, Terms, TorqueVariant, Trigonometry, error_sources, errors};
use haptic_predict::bench::probe::Probe;
use haptic_predict::plan::{Budget, plan};
use nalgebra::{Matrix2, Vector2};
use std::f64::consts::TAU;

/// Control rates and cutoffs, Hz.
const RATES_AND_CUTOFFS_HZ: [(f64, f64); 2] = [(1_000.0, 100.0), (20_000.0, 500.0)];

/// A pose near a singularity, rad, and the direction of a wall's normal, degrees.
struct Slide {
    device: &'static str,
    q: [f64; 2],
    normal: f64,
    /// Force of motion at the tip in a slide at 0.5 m/s, from an independent plant, N.
    known: f64,
}

/// Counts per turn at which encoder steps have no effect.
const FINE_COUNTS_PER_TURN: f64 = 16_777_216.0;

fn with_fine_encoders(file: &DeviceFile) -> Description {
    let mut description = file.description;
    for joint in &mut description.joints[..2] {
        joint.encoder.as_mut().unwrap().counts_per_turn = FINE_COUNTS_PER_TURN;
    }
    description
}

fn unit_vector(degrees: f64) -> Vector2<f64> {
    Vector2::new(degrees.to_radians().cos(), degrees.to_radians().sin())
}

/// A five-bar computed only from the positions of its links, by intersecting circles and by numerical differences.
struct FiveBarOracle {
    base: f64,
    proximal: f64,
    distal: f64,
    /// Proximal link: mass, distance of the centre of mass as a share of the length, inertia about the centre of mass.
    arm: [f64; 3],
    /// Distal link, with the same quantities as `arm`.
    rod: [f64; 3],
    rotor: [f64; 2],
    handle: f64,
}

impl FiveBarOracle {
    fn new(file: &DeviceFile) -> Self {
        let d = &file.description;
        let [base, proximal, _, distal, ..] = d.geometry;
        let of = |i: usize, length: f64| [d.links[i].mass, d.links[i].com / length, d.links[i].inertia];
        let rotor = [d.joints[0].inertia, d.joints[1].inertia];
        Self { base, proximal, distal, arm: of(0, proximal), rod: of(2, distal), rotor, handle: d.handle_mass }
    }

    /// Returns the positions of motors, elbows and tip.
    fn points(&self, q: &Vector2<f64>) -> [Vector2<f64>; 5] {
        let motors = [-0.5, 0.5].map(|side| Vector2::new(side * self.base, 0.0));
        let elbow = |i: usize| motors[i] + Vector2::new(q[i].cos(), q[i].sin()) * self.proximal;
        let (c, d) = (elbow(0), elbow(1));
        let across = d - c;
        let height = (self.distal.powi(2) - across.norm_squared() / 4.0).sqrt();
        let tip = (c + d) / 2.0 + Vector2::new(-across.y, across.x) * (height / across.norm());
        [motors[0], motors[1], c, d, tip]
    }

    fn tip(&self, q: &Vector2<f64>) -> Vector2<f64> {
        self.points(q)[4]
    }

    /// Returns the change of a point per joint angle, by differences.
    fn derivative(&self, q: &Vector2<f64>, point: impl Fn(&[Vector2<f64>; 5]) -> Vector2<f64>) -> Matrix2<f64> {
        const STEP: f64 = 1.0e-5;
        let column = |h: Vector2<f64>| (point(&self.points(&(q + h))) - point(&self.points(&(q - h)))) / (2.0 * STEP);
        Matrix2::from_columns(&[column(Vector2::new(STEP, 0.0)), column(Vector2::new(0.0, STEP))])
    }

    fn jacobian(&self, q: &Vector2<f64>) -> Matrix2<f64> {
        self.derivative(q, |points| points[4])
    }

    fn mass(&self, q: &Vector2<f64>) -> Matrix2<f64> {
        let mut mass = Matrix2::from_diagonal(&Vector2::from(self.rotor));
        let tip = self.jacobian(q);
        mass += tip.transpose() * tip * self.handle;
        for (from, to, [weight, along, inertia], length) in [
            (0, 2, self.arm, self.proximal),
            (1, 3, self.arm, self.proximal),
            (2, 4, self.rod, self.distal),
            (3, 4, self.rod, self.distal),
        ] {
            let centre = self.derivative(q, |points| points[from] + (points[to] - points[from]) * along);
            // The change of a link's unit direction is perpendicular to it and as large as the change of its angle.
            let normal_rate = self.derivative(q, |points| (points[to] - points[from]) / length);
            mass += centre.transpose() * centre * weight + normal_rate.transpose() * normal_rate * inertia;
        }
        mass
    }

    /// Returns the torques b = c - M J⁻¹ J̇ q̇ at a constant tip velocity, with c from Christoffel symbols, N m.
    fn forces_of_motion(&self, q: &Vector2<f64>, velocity: &Vector2<f64>) -> Vector2<f64> {
        const STEP: f64 = 1.0e-4;
        let inverse = self.jacobian(q).try_inverse().unwrap();
        let qd = inverse * velocity;
        let [by0, by1] = [Vector2::new(STEP, 0.0), Vector2::new(0.0, STEP)]
            .map(|h| (self.mass(&(q + h)) - self.mass(&(q - h))) / (2.0 * STEP));
        let energy = Vector2::new(qd.dot(&(by0 * qd)), qd.dot(&(by1 * qd))) / 2.0;
        let c = (by0 * qd.x + by1 * qd.y) * qd - energy;
        let t = STEP / qd.norm();
        let bent = (self.tip(&(q + qd * t)) - self.tip(q) * 2.0 + self.tip(&(q - qd * t))) / (t * t);
        c - self.mass(q) * inverse * bent
    }

    fn tip_force(&self, q: &Vector2<f64>, torque: &Vector2<f64>) -> Vector2<f64> {
        self.jacobian(q).transpose().try_inverse().unwrap() * torque
    }
}

const SLIDES: [Slide; 2] = [
    Slide { device: "haply-2diy", q: [3.4709, 0.2329], normal: 34.28, known: 17.6 },
    Slide { device: "coupled-five-bar", q: [1.3788, 1.8792], normal: 223.02, known: 256.0 },
];

/// Returns the state of a tip that slides along a wall at 0.5 m/s.
fn sliding_probe(links: &FiveBarOracle, q: [f64; 2], normal: f64) -> Probe {
    let (q, n, velocity) = (Vector2::from(q), unit_vector(normal), unit_vector(normal + 90.0) * 0.5);
    let qd = links.jacobian(&q).try_inverse().unwrap() * velocity;
    let padded = |v: Vector2<f64>| [v.x, v.y, 0.0];
    let [q, qd, normal, velocity] = [q, qd, n, velocity].map(padded);
    Probe { q, qd, normal, normal_rate: [0.0; 3], velocity, force: 1.0 }
}

fn law(device: &Device<f64>, terms: VelocityTerms, (rate_hz, cutoff_hz): (f64, f64)) -> Law {
    Law::of(&Scene { velocity_terms: terms, rate_hz, cutoff_hz, ..Scene::default() }, device).unwrap()
}

#[test]
fn faded_velocity_terms_count_as_an_error() {
    for Slide { device: name, q, normal, known } in SLIDES {
        let (file, device) = (shipped_device(name), shipped_device(name).device().unwrap());
        let links = FiveBarOracle::new(&file);
        let probes = [sliding_probe(&links, q, normal)];
        let b = links.forces_of_motion(&Vector2::from(q), &(unit_vector(normal + 90.0) * 0.5));
        let left = links.tip_force(&Vector2::from(q), &b).norm();
        assert!((left / known - 1.0).abs() < 2e-3, "{name}: {left} N");
        let motor = |i: usize| device.joints[i].motor.unwrap();
        assert!((0..2).all(|i| b[i].abs() < motor(i).torque_constant * motor(i).max_current), "{name}: {b}");
        for rate in RATES_AND_CUTOFFS_HZ {
            let law = law(&device, VelocityTerms::Rendered, rate);
            let way = TorqueVariant { terms: Terms::FeedForwardZ, trigonometry: Trigonometry::Tabulated, law };
            let found = errors(&device, &probes, &way);
            assert!((found.whole.force.max / left - 1.0).abs() < 1e-3, "{name} {rate:?}: {found:?}, left {left} N");
            // The error of faded terms does not count against the planner's choice.
            assert!(found.unfaded_errors.force.max < 1e-3, "{name} {rate:?}: {found:?}");
            let parts = error_sources(&device, &probes, &way);
            assert!((parts.dropped / left - 1.0).abs() < 1e-3, "{name} {rate:?}: {parts:?}, left {left} N");
        }
    }
}

/// Returns the torque of the board's control step at the end of a slide.
fn torque_after_slide(name: &str, q: [f64; 2], normal: f64, terms: VelocityTerms) -> Vector2<f64> {
    let file = shipped_device(name);
    let (links, device) = (FiveBarOracle::new(&file), Device::<f64>::new("fine", &with_fine_encoders(&file)).unwrap());
    let AnyMechanism::FiveBar(mechanism) = device.mechanism else { panic!("a five-bar") };
    let (n, along) = (unit_vector(normal), unit_vector(normal + 90.0));
    let end = links.tip(&Vector2::from(q));
    let mut scene = Scene { task: 2, rate_hz: 1_000.0, cutoff_hz: 100.0, velocity_terms: terms, ..Scene::default() };
    let plane = plane_wall([end.x + 0.001 * n.x, end.y + 0.001 * n.y, 0.0], [n.x, n.y, 0.0], 1_000.0, 0.0);
    scene.walls.push(Wall { feed_forward: FeedForward::Full, bilateral: true, ..plane }).unwrap();
    let mut controller = Controller::<f64, _, Libm, 2>::new(mechanism, &device, &scene).unwrap();
    // Compute the poses backwards from the end, one per millisecond.
    let mut angles = vec![Vector2::from(q)];
    for k in 1..=12 {
        let place = end - along * (0.5e-3 * f64::from(k));
        let mut q = angles[angles.len() - 1];
        for _ in 0..8 {
            q += links.jacobian(&q).try_inverse().unwrap() * (place - links.tip(&q));
        }
        angles.push(q);
    }
    let counts = |q: &Vector2<f64>| [q.x, q.y].map(|angle| (angle / TAU * FINE_COUNTS_PER_TURN).round() as i32);
    angles.iter().rev().map(|q| controller.step(&counts(q)).torque).last().unwrap()
}

#[test]
fn the_board_adds_no_terms_where_its_estimates_lag_too_far() {
    for Slide { device, q, normal, .. } in SLIDES {
        let torque = |terms| torque_after_slide(device, q, normal, terms);
        let off = torque(VelocityTerms::Off);
        assert!(off.norm() > 1e-3, "the wall is not touched");
        assert_eq!(torque(VelocityTerms::Rendered), off, "{device}");
        assert_eq!(torque(VelocityTerms::Paper), off, "{device}");
    }
    // In the demo's pose the board adds the terms.
    let torque = |terms| torque_after_slide("coupled-five-bar", [2.6, 1.75], 75.0, terms);
    assert!((torque(VelocityTerms::Rendered) - torque(VelocityTerms::Off)).norm() > 0.01);
}

#[test]
fn omitted_velocity_terms_cost_their_force() {
    let file = shipped_device("coupled-five-bar");
    let (links, device) = (FiveBarOracle::new(&file), file.device().unwrap());
    let (q, normal) = ([2.6, 1.75], 75.0);
    let probes = [sliding_probe(&links, q, normal)];
    let q = Vector2::from(q);
    let b = links.forces_of_motion(&q, &(unit_vector(normal + 90.0) * 0.5));
    let e = links.jacobian(&q).try_inverse().unwrap() * unit_vector(normal);
    let me = links.mass(&q) * e;
    for (terms, added) in [(VelocityTerms::Rendered, b), (VelocityTerms::Paper, b - me * (e.dot(&b) / e.dot(&me)))] {
        // Leave out the error of single counts.
        let law = Law { one_count: [0.0; 3], ..law(&device, terms, RATES_AND_CUTOFFS_HZ[1]) };
        let found = |terms| {
            let way = TorqueVariant { terms, trigonometry: Trigonometry::Tabulated, law };
            errors(&device, &probes, &way).whole.force.max
        };
        let left = links.tip_force(&q, &added).norm();
        assert!((found(Terms::FeedForward) / left - 1.0).abs() < 1e-3, "{terms:?}: {left} N");
        assert!(found(Terms::FeedForwardZ) < 1e-3 * left, "{terms:?}: {left} N");
    }
}

#[test]
fn a_plan_names_the_remaining_forces_of_motion() {
    let device = shipped_device("coupled-five-bar").device().unwrap();
    let mut scene = SceneFile::load(shipped_path("scenes/coupled-five-bar/wall.toml"), 2).unwrap().scene;
    (scene.rate_hz, scene.cutoff_hz) = RATES_AND_CUTOFFS_HZ[0];
    let rendered = plan(&device, &scene, Budget::Percent(1.0), 0.5).unwrap();
    assert!(rendered.errors.force.max > 1.0, "{:?}", rendered.errors);
    assert!(rendered.reasons.iter().any(|reason| reason.contains("the velocity terms fade")), "{:?}", rendered.reasons);
    scene.velocity_terms = VelocityTerms::Paper;
    let paper = plan(&device, &scene, Budget::Percent(1.0), 0.5).unwrap();
    assert_ne!(paper.reasons, rendered.reasons);
}
