//! A fade stays within the tip-force limit between the steps in which the limit is checked.

use crate::rig::{Rig, at_rate, five_bar, hardware, limits, rules, scene, spring_scene};
use haptic_bridge::control::{Command, Rules};
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::safety::fault::State;
use haptic_bridge::safety::limits::Limits;

fn force_limited_rules(tip_force: f32) -> Rules {
    Rules {
        limits: Limits {
            torque: [3.0; MAX_JOINTS],
            current: [30.0; MAX_JOINTS],
            speed: [60.0; MAX_JOINTS],
            power: 1e3,
            tip_force,
            ..limits()
        },
        ..rules()
    }
}

/// Creates an armed five-bar at home whose tip a spring pulls with the force (x, y), N.
fn rig_with_pull(rate: f32, [x, y]: [f32; 2], rules: Rules) -> Rig {
    let tip = Rig::new(&five_bar(), &at_rate(rate, scene(2, &[])), hardware(), rules).control_loop.frame().at.tip;
    let pulling_scene = spring_scene(2, [tip[0] + x / 10.0, tip[1] + y / 10.0, 0.0], 10.0);
    let mut rig = Rig::new(&five_bar(), &at_rate(rate, pulling_scene), hardware(), rules);
    rig.arm();
    rig
}

/// Returns the largest tip force (N) while a hand stretches the elbows at `speed` (rad/s). A new scene is loaded after
/// `begin` (rad) of motion, and again at intervals of `every` steps (0: not again).
fn largest_force(rate: f32, speed: f32, begin: f32, every: u32) -> f64 {
    let free_scene = at_rate(rate, scene(2, &[]));
    let mut rig = rig_with_pull(rate, [1.9, 0.3], force_limited_rules(2.0));
    let (mut turned, mut worst) = (0.0_f32, 0.0_f64);
    let from = rig.samples.counts;
    let steps = (0.8 / speed * rate) as u32;
    for step in 0..steps {
        let first = (begin / speed * rate) as u32;
        if step == first || (every > 0 && step > first && (step - first).is_multiple_of(every)) {
            let _ = rig.load(&five_bar(), &free_scene, true);
        }
        turned += speed / rate * 60_000.0 / std::f32::consts::TAU;
        rig.samples.counts[0] = from[0] + turned as i32;
        rig.samples.counts[1] = from[1] - turned as i32;
        rig.step();
        if rig.state() != State::Armed {
            break;
        }
        worst = worst.max(rig.tip_force().norm());
    }
    worst
}

const RATES_HZ: [f32; 7] = [200.0, 1_000.0, 5_000.0, 7_000.0, 10_000.0, 20_000.0, 50_000.0];

/// Asserts the tip-force limit at every rate (Hz) and speed. `begins` (in steps of 0.06 rad) and `every` are arguments
/// of [`largest_force`].
fn assert_limit(rates: &[f32], begins: impl IntoIterator<Item = u8> + Clone, every: &[u32]) {
    for (rate, every) in rates.iter().flat_map(|rate| every.iter().map(move |every| (*rate, *every))) {
        for speed in [2.0, 5.0, 10.0, 20.0, 50.0] {
            for begin in begins.clone() {
                let force = largest_force(rate, speed, 0.06 * f32::from(begin), every);
                assert!(force <= 2.02, "{force} N of 2 N: {rate} Hz, {speed} rad/s, begin {begin}, every {every}");
            }
        }
    }
}

#[test]
fn a_fade_is_within_the_limit_at_every_rate() {
    assert_limit(&RATES_HZ, [0, 5, 10], &[0, 3]);
    assert_limit(&RATES_HZ[..2], 0..12, &[0]);
}

#[test]
#[ignore = "takes ten times as long"]
fn a_fade_is_within_the_limit_from_every_pose() {
    assert_limit(&RATES_HZ, 0..12, &[0, 1, 2, 3, 5]);
}

#[test]
fn a_limit_lowered_just_before_a_scene_holds_at_every_rate() {
    for (rate, scenes) in [1_000.0, 2_000.0, 10_000.0, 20_000.0, 50_000.0].map(|rate| [(rate, 1), (rate, 2)]).concat() {
        let mut rig = rig_with_pull(rate, [3.9, 0.0], force_limited_rules(5.0));
        rig.execute(Command::Rules(force_limited_rules(1.0))).expect("limits are lowered while armed");
        for _ in 0..scenes {
            rig.load(&five_bar(), &at_rate(rate, scene(2, &[])), true).expect("free space");
        }
        for step in 0..500 {
            rig.step();
            let force = rig.tip_force().norm();
            assert!(force <= 1.01, "{force} N of 1 N at {rate} Hz, step {step} after {scenes} scenes");
        }
    }
}
