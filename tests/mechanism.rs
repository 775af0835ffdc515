//! A toy mechanism, defined in one file, renders a wall.

use crate::rig;
use haptic_bridge::control::compiled::BoardMath;
use haptic_bridge::math::{Angle, Math, Real};
use haptic_bridge::model::catalogue::Spec;
use haptic_bridge::model::description::{Description, DescriptionError};
use haptic_bridge::model::mechanism::{Mechanism, Regularity};
use haptic_bridge::render::controller::Controller;
use haptic_bridge::render::scene::FeedForward;
use nalgebra::{SMatrix, SVector};

/// Two crossed slides on screws. The tip's x and y are the joint angles times the leads.
#[derive(Clone, Copy, Debug)]
struct Gantry<T> {
    /// Lead of each screw, m/rad.
    lead: [T; 2],
    /// Inertia of screw and slide, as seen at each joint, kg m².
    inertia: [T; 2],
}

impl<T: Real> Mechanism<T, 2> for Gantry<T> {
    const SPEC: Spec = Spec {
        name: "gantry",
        label: "gantry",
        joints: 2,
        task: 2,
        links: &[],
        geometry: &[("lead", 2)],
        are_links_optional: false,
        gravity: 2,
    };
    type Pose = [T; 2];

    fn new(description: &Description) -> Result<Self, DescriptionError> {
        let [x, y, ..] = description.geometry;
        let inertia = |i: usize| T::from_f64(description.joints[i].inertia);
        Ok(Self { lead: [T::from_f64(x), T::from_f64(y)], inertia: [inertia(0), inertia(1)] })
    }
    fn pose_at<K: Math<T>>(&self, q: &[Angle<T>; 2]) -> [T; 2] {
        [self.lead[0] * q[0].radians, self.lead[1] * q[1].radians]
    }
    fn tip(&self, pose: &[T; 2]) -> SVector<T, 2> {
        SVector::from(*pose)
    }
    fn regularity(&self, _: &[T; 2]) -> Regularity<T> {
        Regularity { serial: T::one(), parallel: T::one() }
    }
    fn jacobian(&self, _: &[T; 2]) -> SMatrix<T, 2, 2> {
        SMatrix::from_diagonal(&SVector::from(self.lead))
    }
    fn jacobian_rate(&self, _: &[T; 2], _: &SVector<T, 2>) -> SMatrix<T, 2, 2> {
        SMatrix::zeros()
    }
    fn mass(&self, _: &[T; 2]) -> SMatrix<T, 2, 2> {
        SMatrix::from_diagonal(&SVector::from(self.inertia))
    }
    fn coriolis(&self, _: &[T; 2], _: &SVector<T, 2>) -> SVector<T, 2> {
        SVector::zeros()
    }
    fn gravity(&self, _: &[T; 2]) -> SVector<T, 2> {
        SVector::zeros()
    }
    fn inverse(&self, _: &[T; 2], velocity: &SVector<T, 2>) -> SVector<T, 2> {
        SVector::from([velocity[0] / self.lead[0], velocity[1] / self.lead[1]])
    }
}

#[test]
fn a_toy_mechanism_is_one_impl_and_renders_walls() {
    let device = rig::device(&Description { home: None, ..rig::five_bar() });
    let gantry = Gantry { lead: [0.01, 0.02], inertia: [1.0e-4, 3.0e-4] };
    // The wall goes through the origin with the normal (3, 4)/5. The tip is 2 mm away along -x.
    let (k, n) = (1_000.0_f32, [0.6_f32, 0.8]);
    let mut wall = rig::wall(0.0, k);
    wall.surface = haptic_bridge::render::scene::Surface::Plane(haptic_bridge::render::scene::Plane {
        point: [0.0; 3],
        normal: [n[0], n[1], 0.0],
    });
    for feed_forward in [FeedForward::Off, FeedForward::Full] {
        wall.feed_forward = feed_forward;
        let scene = rig::scene(2, &[wall]);
        let mut controller: Controller<f32, _, BoardMath, 2> =
            Controller::new(gantry, &device, &scene).expect("a sound scene");
        let counts = (-0.2 / device.joints[0].radians_per_count) as i32;
        controller.step(&[counts, 0]);
        let step = controller.step(&[counts, 0]);
        let x = f32::from(counts as i16) * device.joints[0].radians_per_count * 0.01;
        let force = -k * n[0] * x;
        assert!((step.wall_force / force - 1.0).abs() < 1e-3, "the wall force {} is not {force} N", step.wall_force);
        // The torques are Jᵀ n f, or M E f/Wrr with E = J⁻¹ n. The inertias at the tip are 1 and 0.75 kg, so Wrr is
        // 0.36 + 0.64 · 0.75 = 0.84 kg.
        let expected = match feed_forward {
            FeedForward::Off => [0.01 * n[0] * force, 0.02 * n[1] * force],
            _ => [0.01 * n[0] * force / 0.84, 0.02 * 0.75 * n[1] * force / 0.84],
        };
        for (found, expected) in step.torque.iter().zip(expected) {
            assert!((found / expected - 1.0).abs() < 1e-3, "{feed_forward:?}: torque {found} is not {expected} N m");
        }
    }
}
