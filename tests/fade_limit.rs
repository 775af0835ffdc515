//! A fade stays within the tip-force limit between the steps that check it.

use crate::rig::statics::force_at_tip;
use crate::rig::{Rig, five_bar, hardware, limits, rules, scene};
use haptic_bridge::control::{Command, Rules};
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::render::scene::{Scene, Spring};
use haptic_bridge::safety::fault::State;
use haptic_bridge::safety::limits::Limits;
use nalgebra::Vector2;

fn force(rig: &Rig) -> f64 {
    let frame = rig.control_loop.frame();
    force_at_tip(&frame.at.q, Vector2::new(frame.motors.torque[0], frame.motors.torque[1]).map(f64::from)).norm()
}

fn limited(tip_force: f32) -> Rules {
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

fn at_rate(rate_hz: f32, scene: Scene<f32>) -> Scene<f32> {
    Scene { rate_hz, cutoff_hz: 0.1 * rate_hz, ..scene }
}

/// Returns the largest tip force (N) while a hand stretches the elbows at `speed` (rad/s). A new scene comes after
/// `begin` (rad) of motion, and then every `every` steps (0: never).
fn largest_force(rate: f32, speed: f32, begin: f32, every: u32) -> f64 {
    let free = at_rate(rate, scene(2, &[]));
    let tip = Rig::with(&five_bar(), &free, hardware(), limited(2.0)).control_loop.frame().at.tip;
    let mut pulled = free.clone();
    let point = [tip[0] + 0.19, tip[1] + 0.03, 0.0];
    pulled.springs.push(Spring { point, direction: [0.0; 3], stiffness: 10.0, damping: 0.0 }).expect("room");
    let mut rig = Rig::with(&five_bar(), &pulled, hardware(), limited(2.0));
    rig.arm();
    let (mut turned, mut worst) = (0.0_f32, 0.0_f64);
    let from = rig.samples.counts;
    let steps = (0.8 / speed * rate) as u32;
    for step in 0..steps {
        let first = (begin / speed * rate) as u32;
        if step == first || (every > 0 && step > first && (step - first).is_multiple_of(every)) {
            let _ = rig.load(&five_bar(), &free, true);
        }
        turned += speed / rate * 60_000.0 / std::f32::consts::TAU;
        rig.samples.counts[0] = from[0] + turned as i32;
        rig.samples.counts[1] = from[1] - turned as i32;
        rig.step();
        if rig.state() != State::Armed {
            break;
        }
        worst = worst.max(force(&rig));
    }
    worst
}

/// Asserts the limit at every rate and speed, for every `begin` (in 0.06 rad) and `every` of [`largest_force`].
fn assert_limit(begins: &[u32], every: &[u32]) {
    let mut above = Vec::new();
    for rate in [200.0, 1_000.0, 5_000.0, 7_000.0, 10_000.0, 20_000.0, 50_000.0] {
        for speed in [2.0, 5.0, 10.0, 20.0, 50.0] {
            for every in every {
                let now =
                    begins.iter().map(|nth| largest_force(rate, speed, 0.06 * *nth as f32, *every)).fold(0.0, f64::max);
                if now > 2.02 {
                    above.push((rate, speed, *every, now));
                }
            }
        }
    }
    above.sort_by(|a, b| b.3.total_cmp(&a.3));
    for (rate, speed, every, now) in above.iter().take(40) {
        println!("{rate} Hz, {speed} rad/s, scene every {every}: {now:.3} N of 2 N");
    }
    assert!(above.is_empty(), "{} of {} cases", above.len(), 35 * every.len());
}

#[test]
fn a_fade_is_within_the_limit_at_every_rate() {
    assert_limit(&[0, 5, 10], &[0, 3]);
}

#[test]
#[ignore = "takes ten times as long"]
fn a_fade_is_within_the_limit_from_every_pose() {
    assert_limit(&[0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11], &[0, 1, 2, 3, 5]);
}

#[test]
fn a_limit_lowered_just_before_a_scene_holds_at_every_rate() {
    let mut above = Vec::new();
    for rate in [1_000.0, 10_000.0, 20_000.0, 50_000.0] {
        let free = at_rate(rate, scene(2, &[]));
        let tip = Rig::with(&five_bar(), &free, hardware(), limited(5.0)).control_loop.frame().at.tip;
        let mut pulled = free.clone();
        let point = [tip[0] + 0.39, tip[1], 0.0];
        pulled.springs.push(Spring { point, direction: [0.0; 3], stiffness: 10.0, damping: 0.0 }).expect("room");
        let mut rig = Rig::with(&five_bar(), &pulled, hardware(), limited(5.0));
        rig.arm();
        rig.execute(Command::Rules(limited(1.0))).expect("lowered while armed");
        rig.load(&five_bar(), &free, true).expect("free space");
        let (mut count, mut worst) = (0, 0.0_f64);
        for _ in 0..500 {
            rig.step();
            count += u32::from(force(&rig) > 1.01);
            worst = worst.max(force(&rig));
        }
        println!("{rate} Hz: {worst:.3} N of 1 N, {count} steps above");
        if count > 0 {
            above.push(rate);
        }
    }
    assert!(above.is_empty(), "{above:?}");
}
