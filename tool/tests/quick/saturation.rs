//! Walls that need more torque than the motors have: the force keeps its direction and never falls with depth, gravity
//! stays compensated, and no force jumps at a limit.

use crate::common::shipped_device;
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::render::scene::FeedForward;
use haptic_bridge::safety::fault::State;
use haptic_bridge::safety::limits::Limits;
use haptic_sim::{Press, PressForces, PressedBoard, WIDE_LIMITS};

/// A wall through the tip of a device in the pose `q`, with limits of joint torques, N m, and of the tip force, N.
struct SaturationCase {
    device: &'static str,
    q: [f64; 3],
    normal: [f64; 3],
    stiffness: f64,
    feed_forward: FeedForward,
    torque: f32,
    tip_force: f32,
    /// Factor by which the largest motor currents are multiplied.
    strength: f64,
    /// Control steps at each depth; the feed-forward of a washout fades within seconds.
    steps: u32,
}

impl SaturationCase {
    /// Returns the forces at increasing depths in the wall.
    fn forces_at_depths(&self, depths: impl Iterator<Item = f64>) -> Vec<PressForces> {
        let mut device = shipped_device(self.device).description;
        for motor in device.joints.iter_mut().filter_map(|joint| joint.motor.as_mut()) {
            motor.max_current *= self.strength;
        }
        let press = Press {
            device: &device,
            q: self.q,
            normal: self.normal,
            stiffness: self.stiffness,
            feed_forward: self.feed_forward,
            limits: Limits { torque: [self.torque; MAX_JOINTS], tip_force: self.tip_force, ..WIDE_LIMITS },
        };
        let mut board = PressedBoard::new(&press).expect("nothing is in the way");
        depths
            .map(|depth| {
                let tip_state = board.forces_at(depth, self.steps);
                assert_eq!(tip_state.state, State::Armed, "{tip_state:?}");
                tip_state
            })
            .collect()
    }
}

/// Returns the demo's pose and normal with motors of 2 N m.
fn demo_case(feed_forward: FeedForward) -> SaturationCase {
    let angle = 75_f64.to_radians();
    SaturationCase {
        device: "coupled-five-bar",
        q: [2.6, 1.75, 0.0],
        normal: [angle.cos(), angle.sin(), 0.0],
        stiffness: 20_000.0,
        feed_forward,
        torque: 2.0,
        tip_force: 1.0e9,
        strength: 1.0,
        steps: 200,
    }
}

/// Returns depths up to 2 mm, where the demo's wall needs 40 N.
fn depths() -> impl Iterator<Item = f64> {
    (0..=200).map(|i| 1.0e-5 * f64::from(i))
}

#[test]
fn the_demo_uses_all_torque_and_pushes_only_along_the_normal() {
    // The motors' own limit (3 A at 0.667 N m/A) equals a torque limit of 2 N m.
    for case in [demo_case(FeedForward::Off), SaturationCase { torque: 100.0, ..demo_case(FeedForward::Off) }] {
        for point in case.forces_at_depths([1.0e-3, 1.5e-3, 2.0e-3].into_iter()) {
            // The path into the wall is straight in joint angles, so the depth is 0.3 % off at 2 mm.
            assert!((point.requested / (20_000.0 * point.depth) - 1.0).abs() < 0.005, "{point:?}");
            // 2 N m make 19.4 N at the surface, and a little more or less up to 2 mm deeper.
            assert!((point.along - 19.4).abs() < 0.4, "{point:?}");
            assert!(point.across < 1.0e-3, "{point:?}");
            assert!((point.share() - point.along / point.requested).abs() < 1.0e-3, "{point:?}");
            assert!(point.torque.iter().any(|torque| (torque.abs() - 2.0).abs() < 1.0e-5), "{point:?}");
        }
    }
}

#[test]
fn the_force_along_the_normal_never_falls_and_nothing_jumps() {
    for feed_forward in [FeedForward::Off, FeedForward::Full, FeedForward::Washout] {
        let points = demo_case(feed_forward).forces_at_depths(depths());
        let mut cut = 0;
        for pair in points.windows(2) {
            let (a, b) = (pair[0], pair[1]);
            // The tip force of 2 N m changes with the pose by 0.2 N per mm, which is 2 mN per depth step of 0.01 mm.
            assert!(b.along >= a.along - 5.0e-3, "{feed_forward:?}: {a:?} {b:?}");
            assert!((b.along - a.along).abs() < 0.21, "the wall needs only 0.2 N more: {a:?} {b:?}");
            assert!((b.across - a.across).abs() < 0.25, "{feed_forward:?}: {a:?} {b:?}");
            assert!(b.share() <= a.share() + 1.0e-4 && b.share() > 0.0, "{feed_forward:?}: {a:?} {b:?}");
            cut += u32::from(b.share() < 0.999);
        }
        assert!(cut > 50, "the motors are at their limit in only {cut} depths");
        let last = points[points.len() - 1];
        match feed_forward {
            FeedForward::Off => assert!(last.across < 1.0e-3, "{last:?}"),
            // The feed-forward's sideways force grows in proportion to the rendered force.
            _ => {
                let before = points.iter().rev().find(|p| p.share() > 0.9999).expect("small forces are not cut");
                let per_newton = before.across / before.along;
                assert!(last.across <= per_newton * last.along * 1.02 + 1.0e-3, "{before:?} {last:?}");
            }
        }
    }
}

#[test]
fn with_a_washout_a_resting_hand_feels_no_sideways_force() {
    let case = SaturationCase { steps: 3_000, ..demo_case(FeedForward::Washout) };
    let points = case.forces_at_depths([2.0e-3].into_iter());
    assert!(points[0].across < 1.0e-3 && (points[0].along - 19.4).abs() < 0.4, "{points:?}");
}

#[test]
fn gravity_stays_compensated_at_every_depth() {
    for device in ["phantom-premium-1.5", "woodenhaptics"] {
        let (q, normal) = ([0.3, 0.9, -0.3], [0.6, 0.0, 0.8]);
        let weak = SaturationCase { stiffness: 5_000.0, torque: 0.6, steps: 50, ..demo_case(FeedForward::Off) };
        let case = SaturationCase { device, q, normal, ..weak };
        let points = case.forces_at_depths((0..=40).map(|i| 1.0e-4 * f64::from(i)));
        let last = points[points.len() - 1];
        assert!(last.share() < 0.9, "{device} is not at its limit: {last:?}");
        for pair in points.windows(2) {
            assert!(pair[1].along >= pair[0].along - 2.0e-2, "{device}: {pair:?}");
            // Without the torque against gravity there is no sideways force.
            assert!(pair[1].across < 5.0e-3, "{device}: {pair:?}");
        }
    }
}

#[test]
fn walls_push_with_at_most_the_tip_force_limit_in_every_pose() {
    let press_points = |device, q, normal, feed_forward| {
        // Motors and torque limits are so strong that only the tip force limit of 5 N acts.
        let strong = SaturationCase { torque: 1.0e3, strength: 100.0, ..demo_case(feed_forward) };
        let case = SaturationCase { device, q, normal, tip_force: 5.0, steps: 300, ..strong };
        let points = case.forces_at_depths((0..=20).map(|i| 5.0e-5 * f64::from(i)));
        for point in &points {
            assert!(point.along <= 5.005, "{device} at {q:?}: {point:?}");
            let share = point.along / point.requested.max(1.0e-9);
            assert!((point.share() - share).abs() < 2.0e-3 || point.requested < 0.1, "{point:?}");
        }
        let last = points[points.len() - 1];
        assert!(last.requested > 19.0 && (last.along - 5.0).abs() < 5.0e-3, "{device} at {q:?}: {last:?}");
        last.across
    };
    for angle in [0.3_f64, 1.3, 2.9] {
        let (sin, cos) = angle.sin_cos();
        for feed_forward in [FeedForward::Off, FeedForward::Full, FeedForward::Washout] {
            for q in [[2.6, 1.75, 0.0], [2.4, 1.6, 0.0], [2.8, 1.9, 0.0]] {
                let across = press_points("coupled-five-bar", q, [cos, sin, 0.0], feed_forward);
                // Only the feed-forward pushes sideways.
                assert!(feed_forward != FeedForward::Off || across < 1.0e-3, "{across} N sideways");
            }
        }
        for device in ["phantom-premium-1.5", "woodenhaptics"] {
            for q in [[0.3, 0.9, -0.3], [-0.2, 0.7, -0.5]] {
                let across = press_points(device, q, [cos * 0.6, sin * 0.6, 0.8], FeedForward::Off);
                assert!(across < 5.0e-3, "{device}: {across} N sideways");
            }
        }
    }
}
