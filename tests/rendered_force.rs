//! The record contains the requested wall force, the rendered force, and marks for saturated motors.

use crate::rig::statics::{force_at_tip, tip};
use crate::rig::{COUNTS_PER_TURN, RATE_HZ, Rig, five_bar, hardware, rules, scene, wall};
use haptic_bridge::control::frame::{Motors, StepRecord};
use haptic_bridge::control::{Command, Rules};
use haptic_bridge::render::controller::Gains;
use haptic_bridge::render::scene::{FeedForward, Plane, Surface};
use haptic_bridge::render::velocity::Washout;
use haptic_bridge::safety::limits::Limits;
use nalgebra::Vector2;

/// Presses a paddle of 0.1 m `depth` (m) into a wall of 1 kN/m at -0.05 m. The motor may make 0.3 N m, which is 3 N.
fn pressed_paddle(depth: f64) -> Rig {
    let mut rig = Rig::armed_paddle();
    rig.turn(0, -(0.05 + depth) / 0.1, 2.0);
    rig.settle();
    rig
}

#[test]
fn a_wall_within_the_torque_limit_is_rendered_completely() {
    let frame = pressed_paddle(0.002).control_loop.frame();
    assert!((frame.at.walls.wall_force - 2.0).abs() < 0.02, "{frame:?}");
    assert!((frame.motors.rendered_force - frame.at.walls.wall_force).abs() < 1e-5, "{frame:?}");
    assert_eq!(frame.saturation(0), 0);
}

#[test]
fn a_wall_beyond_the_torque_limit_is_recorded_as_reduced() {
    let frame = pressed_paddle(0.008).control_loop.frame();
    assert!((frame.at.walls.wall_force - 8.0).abs() < 0.02, "the requested force is not 8 N: {frame:?}");
    assert!((frame.motors.rendered_force - 3.0).abs() < 1e-4, "0.3 N m at 0.1 m are not 3 N: {frame:?}");
    assert_eq!(frame.saturation(0), 1, "the motor is marked");
    assert_eq!((frame.saturation(1), frame.saturation(2)), (0, 0), "no other motor is marked");
}

#[test]
fn a_force_beyond_the_tip_force_limit_is_marked_too() {
    let mut rig = pressed_paddle(0.002);
    let limited = rules();
    rig.execute(Command::Rules(Rules { limits: Limits { tip_force: 1.0, ..limited.limits }, ..limited })).unwrap();
    rig.step();
    let frame = rig.control_loop.frame();
    assert!((frame.motors.rendered_force - 1.0).abs() < 1e-3, "{frame:?}");
    assert_eq!((frame.saturation(0), frame.saturation(1)), (1, 0), "{frame:?}");
}

#[test]
fn the_rendered_force_is_zero_when_off_and_reduced_in_the_ramp() {
    let mut rig = pressed_paddle(0.002);
    rig.execute(Command::Disarm).unwrap();
    rig.step();
    let off = rig.control_loop.frame();
    assert!(off.at.walls.wall_force > 1.9 && off.motors.rendered_force == 0.0, "{off:?}");

    let mut rig = Rig::homed_paddle(&scene(1, &[wall(-0.05, 1_000.0)]));
    rig.execute(Command::Arm).unwrap();
    // After 0.03 s of the 0.5 s ramp the tip is 2 mm deep.
    rig.turn(0, -0.52, 18.0);
    let ramp = rig.control_loop.frame();
    assert!(ramp.at.walls.wall_force > 1.9 && ramp.motors.rendered_force > 0.0, "{ramp:?}");
    assert!(ramp.motors.rendered_force < 0.2 * ramp.at.walls.wall_force, "{ramp:?}");
}

#[test]
fn the_rendered_force_is_the_static_force_of_the_torques() {
    for feed_forward in [FeedForward::Off, FeedForward::Full] {
        let n = [0.28, 0.96];
        let home = tip([2.4, 0.7]);
        let point = [(home[0] - 0.004 * n[0]) as f32, (home[1] - 0.004 * n[1]) as f32, 0.0];
        let mut askew = wall(0.0, 3_000.0);
        askew.surface = Surface::Plane(Plane { point, normal: [0.28, 0.96, 0.0] });
        askew.feed_forward = feed_forward;
        let mut rig = Rig::new(&five_bar(), &scene(2, &[askew]), hardware(), rules());
        rig.arm();
        let mut saturated = 0;
        for _ in 0..40 {
            // The left arm turns outwards and the right arm inwards, into the wall.
            for (i, turn) in [(0, 30), (1, -30)] {
                rig.samples.counts[i] += turn;
            }
            rig.run(0.02);
            let frame = rig.control_loop.frame();
            // The home is at 2.4 and 0.7 rad.
            let angle =
                |i: usize| f64::from(frame.counts[i]) / COUNTS_PER_TURN * core::f64::consts::TAU + [2.4, 0.7][i];
            let torque = Vector2::new(frame.motors.torque[0], frame.motors.torque[1]).map(f64::from);
            let expected = force_at_tip(&[angle(0) as f32, angle(1) as f32, 0.0], torque).dot(&Vector2::from(n));
            let rendered = f64::from(frame.motors.rendered_force);
            if frame.motors.rendered_force < 0.999 * frame.at.walls.wall_force {
                assert_eq!((frame.saturation(0), frame.saturation(1)), (1, 1), "one factor reduces both: {frame:?}");
            }
            // 1e-4 covers the f32 rounding of the step (2e-5 of the torque) and of the differences (1e-7).
            assert!(
                (rendered - expected).abs() < 1e-4 * (1.0 + expected.abs()),
                "rendered {rendered} N, expected {expected} N: {frame:?}"
            );
            if frame.saturation(0) + frame.saturation(1) > 0 {
                saturated += 1;
                // The board reduces the feed-forward before the force.
                let reduced = frame.motors.rendered_force < 0.999 * frame.at.walls.wall_force;
                assert!(reduced || feed_forward == FeedForward::Full, "{frame:?}");
            }
        }
        assert!((5..35).contains(&saturated), "{saturated} of 40 saturated with {feed_forward:?}");
    }
}

#[test]
fn a_duty_at_its_limit_has_its_own_mark() {
    let mut rig = pressed_paddle(0.001);
    assert_eq!(rig.control_loop.frame().saturation(0), 0);
    // 2 N more within one step would need 44 V across the 1 mH winding for a carrier period.
    let gains = Gains { wall: 0, stiffness: 2_900.0, damping: 0.0, feed_forward: FeedForward::Off, washout_hz: 2.0 };
    rig.execute(Command::Gains(gains, Washout::new(2.0, RATE_HZ).unwrap())).unwrap();
    rig.control_loop.control(&rig.samples);
    rig.control_loop.duties(24.0, &rig.samples.currents, false);
    let frame = rig.control_loop.frame();
    assert_eq!(frame.saturation(0), 2, "{frame:?}");
    let motors = Motors { limited: 0b101, ..frame.motors };
    assert_eq!(StepRecord { motors, ..frame }.saturation(0), 3);
}
