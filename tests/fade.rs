//! A scene replaces another while the motors are on. The old torques fade without a jump and stay within the tip-force
//! limit wherever the tip moves.

use crate::rig::statics::force_at_tip;
use crate::rig::{Rig, five_bar, hardware, limits, rules, scene, spring_scene, wall};
use haptic_bridge::board::protocol::{ForceDone, ForceRequest};
use haptic_bridge::control::{Command, Rules};
use haptic_bridge::math::Libm;
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::model::description::Description;
use haptic_bridge::model::mechanism::{AnyMechanism, Mechanism};
use haptic_bridge::render::scene::{FeedForward, Plane, Scene, Surface, Wall};
use haptic_bridge::safety::fault::State;
use haptic_bridge::safety::limits::Limits;
use nalgebra::Vector2;

/// Rounding error of a tip force after its torque was converted to a current and back, N.
const ROUNDING_N: f64 = 1.0e-3;

fn torques(rig: &Rig) -> [f32; MAX_JOINTS] {
    *rig.torques()
}

/// Returns rules in which the tip force (N) is the only effective limit.
fn force_limited_rules(tip_force: f32) -> Rules {
    Rules {
        limits: Limits { torque: [3.0; MAX_JOINTS], current: [30.0; MAX_JOINTS], tip_force, ..limits() },
        ..rules()
    }
}

/// Returns a scene with a spring that pulls the tip at home with the force (x, y), N.
fn spring_pull_scene(tip: [f32; 3], [x, y]: [f32; 2]) -> Scene<f32> {
    spring_scene(2, [tip[0] + x / 10.0, tip[1] + y / 10.0, 0.0], 10.0)
}

/// Creates an armed five-bar at home whose tip a spring pulls with the force `pull`, N.
fn rig_with_pull(rules: Rules, pull: [f32; 2]) -> Rig {
    let tip = Rig::new(&five_bar(), &scene(2, &[]), hardware(), rules).control_loop.frame().at.tip;
    let mut rig = Rig::new(&five_bar(), &spring_pull_scene(tip, pull), hardware(), rules);
    rig.arm();
    rig
}

#[test]
fn the_limit_holds_for_a_fade_while_the_elbow_stretches() {
    for pull in [[1.9, 0.0], [-1.3, 1.3], [1.3, 1.3]] {
        let mut rig = rig_with_pull(force_limited_rules(2.0), pull);
        assert!((rig.tip_force().norm() - 1.9).abs() < 0.1, "a tip force of {} N", rig.tip_force().norm());
        rig.load(&five_bar(), &scene(2, &[]), true).expect("free space");
        let before = torques(&rig);
        let mut alone = 0.0_f64;
        for step in 0..600 {
            rig.samples.counts[0] += 30;
            rig.samples.counts[1] -= 30;
            rig.step();
            if rig.state() != State::Armed {
                break;
            }
            let remaining_share = 1.0 - (step + 1) as f32 / 1_000.0;
            let old = force_at_tip(
                &rig.control_loop.frame().at.q,
                Vector2::new(before[0], before[1]).map(|torque| (torque * remaining_share).into()),
            );
            alone = alone.max(old.norm());
            assert!(
                rig.tip_force().norm() <= 2.0 + 5.0 * ROUNDING_N,
                "a tip force of {} N, {:?}",
                rig.tip_force().norm(),
                rig.control_loop.frame()
            );
        }
        assert!(alone > 3.0, "the same torques would be {alone} N");
    }
}

#[test]
fn a_lowered_torque_limit_scales_a_fading_force() {
    let mut rig = rig_with_pull(force_limited_rules(5.0), [4.0, 2.0]);
    let before = rig.tip_force();
    rig.load(&five_bar(), &scene(2, &[]), true).expect("free space");
    rig.step();
    for joint in 0..2 {
        let mut lower = force_limited_rules(5.0);
        lower.limits.torque[joint] = 0.1 * torques(&rig)[joint].abs();
        rig.execute(Command::Rules(lower)).expect("limits are lowered while armed");
        rig.step();
        let remaining_force = rig.tip_force();
        assert!(remaining_force.norm() < 0.11 * before.norm(), "a force of {remaining_force} N is left of {before} N");
        let aside = (remaining_force.x * before.y - remaining_force.y * before.x).abs() / before.norm();
        assert!(aside < 0.01 * before.norm(), "the direction changed: {remaining_force} of {before}");
        let mut raised = rig_with_pull(force_limited_rules(5.0), [4.0, 2.0]);
        raised.load(&five_bar(), &scene(2, &[]), true).expect("free space");
        raised.step();
        rig = raised;
    }
}

#[test]
fn torques_do_not_jump_when_a_wall_at_the_limit_is_replaced() {
    let tip = Rig::new(&five_bar(), &scene(2, &[]), hardware(), force_limited_rules(2.0)).control_loop.frame().at.tip;
    let normal = [0.8, 0.6, 0.0];
    let surface = Surface::Plane(Plane { point: [tip[0] + 1.0e-3, tip[1], 0.0], normal });
    let bilateral = Wall { surface, bilateral: true, feed_forward: FeedForward::Full, ..wall(0.0, 2_480.0) };
    let mut rig = Rig::new(&five_bar(), &scene(2, &[bilateral]), hardware(), force_limited_rules(2.0));
    rig.arm();
    let before = torques(&rig);
    assert!(
        (rig.tip_force().norm() - 2.0).abs() < 1.0e-3,
        "with its feed-forward the wall is not at the limit: {} N",
        rig.tip_force().norm()
    );
    rig.load(&five_bar(), &scene(2, &[]), true).expect("free space");
    let mut last = before;
    for step in 0..=1_000 {
        rig.step();
        let now = torques(&rig);
        let remaining_share = 1.0 - (step + 1) as f32 / 1_000.0;
        for i in 0..2 {
            assert!((now[i] - last[i]).abs() < 3.0e-3 * before[i].abs() + 1.0e-6, "step {step}: {last:?} to {now:?}");
            assert!(
                (now[i] - remaining_share.max(0.0) * before[i]).abs() < 2.0e-3 * before[i].abs() + 1.0e-6,
                "step {step}"
            );
        }
        last = now;
    }
    assert_eq!(last, [0.0; MAX_JOINTS]);
}

#[test]
fn a_host_force_ends_with_its_lease_after_a_new_scene() {
    for (torque, push) in [([0.1, -0.05, 0.0], [0.0; 3]), ([0.0; 3], [1.0, -0.5, 0.0])] {
        let mut rig = rig_with_pull(force_limited_rules(5.0), [0.6, 0.8]);
        let spring = torques(&rig);
        let request =
            ForceRequest { sequence: 1, hold: 0.02, fade: 0.02, torque, force: push, ..ForceRequest::default() };
        assert_eq!(rig.control_loop.force(&request).done, ForceDone::Taken);
        rig.step();
        let both = torques(&rig);
        assert!((0..2).all(|i| (both[i] - spring[i]).abs() > 0.005), "{spring:?}, with the request {both:?}");
        rig.load(&five_bar(), &scene(2, &[]), true).expect("free space");
        rig.step();
        assert!(
            (0..2).all(|i| (torques(&rig)[i] - both[i]).abs() < 0.05 * both[i].abs()),
            "the torque jumps where the fade begins"
        );
        rig.run(0.04);
        let remaining_torques = torques(&rig);
        // 0.041 s of the 0.5 s fade have passed.
        for i in 0..2 {
            let expected = (1.0 - 0.041 / 0.5) * spring[i];
            assert!(
                (remaining_torques[i] - expected).abs() < 0.01 * spring[i].abs(),
                "{remaining_torques:?}, the spring's torques {spring:?}"
            );
        }
    }
}

#[test]
fn no_force_outlives_its_lease_or_reverses_after_a_new_scene() {
    let push = |sequence, torque: f32| ForceRequest {
        sequence,
        hold: 0.02,
        fade: 0.02,
        torque: [torque, 0.0, 0.0],
        ..ForceRequest::default()
    };
    let free_scene = scene(2, &[]);
    for (first, second) in [(0.005, 1.0), (0.1, 0.0), (0.0, 0.1)] {
        let mut rig = Rig::new(&five_bar(), &free_scene, hardware(), force_limited_rules(5.0));
        rig.arm();
        assert_eq!(rig.control_loop.force(&push(1, first)).done, ForceDone::Taken);
        rig.step();
        let before = torques(&rig)[0];
        assert_eq!(rig.control_loop.force(&push(2, second)).done, ForceDone::Taken);
        rig.load(&five_bar(), &free_scene, true).expect("free space");
        for _ in 0..80 {
            rig.step();
            let now = torques(&rig)[0];
            assert!(now >= -1.0e-6 && now <= before.max(0.2), "{first} and {second} N m: torque {before} to {now}");
        }
        assert!(torques(&rig)[0].abs() < 1.0e-6, "{first} and {second} N m: {:?} after both leases", torques(&rig));
    }
}

#[test]
fn further_scenes_do_not_prolong_a_host_force() {
    for steps_between in [0, 1, 20] {
        for (torque, push) in [([0.1, -0.05, 0.0], [0.0; 3]), ([0.0; 3], [4.0, 0.0, 0.0])] {
            let free_scene = scene(2, &[]);
            let mut rig = Rig::new(&five_bar(), &free_scene, hardware(), force_limited_rules(5.0));
            rig.arm();
            let request =
                ForceRequest { sequence: 1, hold: 0.02, fade: 0.02, torque, force: push, ..ForceRequest::default() };
            assert_eq!(rig.control_loop.force(&request).done, ForceDone::Taken);
            rig.step();
            for _ in 0..3 {
                rig.load(&five_bar(), &free_scene, true).expect("free space");
                (0..steps_between).for_each(|_| rig.step());
            }
            rig.run(0.04);
            assert!(rig.tip_force().norm() < 1.0e-3, "{steps_between}: {} N after its lease", rig.tip_force().norm());
        }
    }
}

#[test]
fn compensated_weight_does_not_count_against_the_limit() {
    let mut heavy = five_bar();
    heavy.gravity = [0.0, -9.81, 0.0];
    for link in &mut heavy.links {
        link.mass = 0.2;
    }
    let Ok(AnyMechanism::FiveBar(mechanism)) = AnyMechanism::<f64>::new(&heavy) else { panic!("a five-bar") };
    let weight = |q: &[f32; 3]| mechanism.gravity(&mechanism.pose::<Libm>(&Vector2::new(q[0], q[1]).map(f64::from)));
    let tip = Rig::new(&heavy, &scene(2, &[]), hardware(), force_limited_rules(2.0)).control_loop.frame().at.tip;
    for (before, after) in [(false, true), (true, false), (true, true)] {
        let with = |scene: Scene<f32>, on| Scene { gravity_compensation: on, ..scene };
        let mut rig =
            Rig::new(&heavy, &with(spring_pull_scene(tip, [1.9, 0.0]), before), hardware(), force_limited_rules(2.0));
        rig.arm();
        rig.load(&heavy, &with(scene(2, &[]), after), true).expect("free space");
        for step in 1..=900 {
            rig.samples.counts[0] += 3;
            rig.samples.counts[1] -= 3;
            rig.step();
            if rig.state() != State::Armed {
                break;
            }
            let frame = rig.control_loop.frame();
            let ramp = f64::from(step) / 1_000.0;
            let share = if before { 1.0 - ramp } else { 0.0 } + if after { ramp } else { 0.0 };
            let held = weight(&frame.at.q) * share;
            let rest = Vector2::new(frame.motors.torque[0], frame.motors.torque[1]).map(f64::from) - held;
            let force = force_at_tip(&frame.at.q, rest).norm();
            assert!(force <= 2.0 + 0.02, "force {force} N at step {step}, {before} to {after}: {frame:?}");
        }
    }
}

#[test]
fn a_new_scene_at_the_end_of_the_ramp_reverses_no_force() {
    for steps in 998..=1_003 {
        let free_scene = scene(2, &[]);
        let mut rig = Rig::new(&five_bar(), &free_scene, hardware(), force_limited_rules(5.0));
        rig.execute(Command::Arm).expect("ready");
        for step in 0..steps {
            // The requested force is four times the tip-force limit.
            let force = [20.0, 0.0, 0.0];
            let request = ForceRequest { sequence: step + 1, hold: 0.02, fade: 0.05, force, ..ForceRequest::default() };
            assert_eq!(rig.control_loop.force(&request).done, ForceDone::Taken);
            rig.step();
        }
        rig.load(&five_bar(), &free_scene, true).expect("free space");
        for _ in 0..600 {
            rig.step();
            assert!(rig.tip_force().x > -ROUNDING_N, "a scene after {steps} steps: {} N", rig.tip_force().x);
        }
        assert!(rig.tip_force().norm() < ROUNDING_N, "a scene after {steps} steps: {}", rig.tip_force());
    }
}

/// Dragging a wall replaces the scene many times per second. The compensated weight must follow the pose, because
/// torques of another pose would push outside every limit.
#[test]
fn compensated_weight_follows_the_pose_through_many_scenes() {
    let mut heavy = Description { gravity: [0.0, -9.81, 0.0], ..five_bar() };
    heavy.links.iter_mut().for_each(|link| link.mass = 0.2);
    let scene = Scene { gravity_compensation: true, ..scene(2, &[]) };
    let armed = || {
        let mut rig = Rig::new(&heavy, &scene, hardware(), force_limited_rules(2.0));
        rig.arm();
        rig
    };
    let (mut replaced, mut unchanged) = (armed(), armed());
    let began = torques(&replaced);
    for _ in 0..12 {
        replaced.load(&heavy, &scene, true).expect("the same scene");
        for rig in [&mut replaced, &mut unchanged] {
            let counts = rig.samples.counts[0];
            for step in 1..=20 {
                rig.samples.counts[0] = counts - step;
                rig.step();
            }
        }
        for (one, other) in torques(&replaced).iter().zip(torques(&unchanged)) {
            assert!((one - other).abs() < 1e-6, "the torques differ: {one}, {other}");
        }
    }
    let moved = (0..2).map(|i| (torques(&replaced)[i] - began[i]).abs()).fold(0.0, f32::max);
    assert!(moved > 1e-3, "the weight's torque must change: {moved}");
}
