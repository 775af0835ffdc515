//! Limits act at every crest of the carrier, at every control rate, whatever the step is asked for and whatever filters
//! the scene has.

use crate::rig::{self, RATE, RATES, Rig, five_bar, hardware, limits, paddle, quiet, rules, scene, wall};
use haptic_bridge::control::frame::Samples;
use haptic_bridge::control::joints::{Counts, Currents};
use haptic_bridge::control::{Command, Rules};
use haptic_bridge::drive::stage::{Duty, MAX_DUTY};
use haptic_bridge::math::Libm;
use haptic_bridge::model::description::Encoder;
use haptic_bridge::model::mechanism::AnyMechanism;
use haptic_bridge::render::scene::{Plane, Surface, Wall};
use haptic_bridge::render::velocity::{Coefficients, Estimator};
use haptic_bridge::safety::fault::{Fault, State};
use haptic_bridge::safety::limits::Limits;

#[test]
fn limits_hold_whatever_the_step_is_asked_for() {
    let mut rig = Rig::ready(&scene(1, &[wall(-0.005, 1.0e9)]));
    rig.arm();
    let bound = limits().torque[0] * 1.000_01;
    for angle in [-0.1, -0.5, -0.9, 0.2] {
        rig.turn(0, angle, 4.0);
        assert!(rig.control_loop.frame().motors.torque[0].abs() <= bound, "{:?}", rig.control_loop.frame());
        assert!(rig.duties.iter().all(|duty| duty.abs() <= MAX_DUTY));
    }
}

/// An armed paddle at a control rate.
fn armed_at(rate: f32) -> Rig {
    let mut scene = quiet();
    (scene.rate_hz, scene.cutoff_hz) = (rate, 0.2 * rate);
    let mut rig = Rig::ready(&scene);
    rig.arm();
    rig
}

/// Turns joint 0 at `speed` (rad/s), one carrier period after another, until the bridges float or `most` periods are
/// over; the periods that took.
fn crests_until_off(rig: &mut Rig, speed: f64, most: u32, shown: [f32; 3]) -> Option<u32> {
    let start = rig.samples.counts[0];
    (1..=most).find(|nth| {
        let moved = f64::from(*nth) * speed / 20_000.0 / core::f64::consts::TAU * rig::COUNTS;
        let counts = Counts([start + moved as i32, 0, 0]);
        !rig.control_loop
            .guard(&Samples { counts, bus_voltage: 24.0, currents: Currents(shown), ..Samples::default() })
            .bridges
    })
}

#[test]
fn a_current_above_its_limit_is_seen_at_the_next_crest_at_every_rate() {
    for rate in RATES {
        let mut rig = armed_at(rate);
        assert_eq!(crests_until_off(&mut rig, 0.0, 10, [6.0, 0.0, 0.0]), Some(1), "{rate} Hz");
        assert_eq!(rig.fault(), Some(Fault::OverCurrent));
        assert_eq!(rig.control_loop.duties(24.0, &[0.0; 3], false), [Duty::default(); 3]);
    }
}

#[test]
fn speed_and_joint_limits_act_within_a_control_period_at_every_rate() {
    for rate in RATES {
        // Twice the 20 rad/s allowed: a first-order filter of 200 Hz is there after ln 2 of its 0.8 ms, 11 periods.
        let mut rig = armed_at(rate);
        let seen = crests_until_off(&mut rig, 40.0, 100, [0.0; 3]);
        assert!(seen.is_some_and(|seen| (10..=14).contains(&seen)), "{rate} Hz: {seen:?}");
        assert_eq!(rig.fault(), Some(Fault::SpeedLimit));
        // 19 rad/s are allowed; the limit of 1 rad is 1053 periods away.
        let mut rig = armed_at(rate);
        let seen = crests_until_off(&mut rig, 19.0, 2_000, [0.0; 3]);
        assert!(seen.is_some_and(|seen| (1_052..=1_056).contains(&seen)), "{rate} Hz: {seen:?}");
        assert_eq!(rig.fault(), Some(Fault::JointLimit));
    }
}

#[test]
fn no_scene_filter_slows_or_blinds_the_speed_limit() {
    for (kind, cutoff) in
        [(Estimator::Butterworth, 1.0e-6), (Estimator::FirstOrder, 1.0), (Estimator::Butterworth, 900.0)]
    {
        let mut rig = Rig::armed();
        let coefficients = Coefficients::new(kind, RATE, cutoff).unwrap();
        rig.execute(Command::Coefficients(coefficients)).unwrap();
        rig.turn(0, 0.5, 30.0);
        assert_eq!(rig.fault(), Some(Fault::SpeedLimit), "{kind:?} {cutoff} Hz");
        let travel = rig.control_loop.status().q[0];
        assert!(travel < 0.1, "{kind:?} {cutoff} Hz: {travel} rad");
    }
}

#[test]
fn a_coarse_encoder_is_given_a_few_counts_before_it_is_called_fast() {
    // 400 counts a turn: one count in a carrier period is 314 rad/s. At 15 rad/s of 20 allowed one comes every 1 ms.
    let mut coarse = paddle();
    coarse.joints[0].encoder.as_mut().unwrap().counts_per_turn = 400.0;
    let run = |speed: f64| {
        let mut rig = Rig::with(&coarse, &quiet(), hardware(), rules());
        rig.arm();
        let counts =
            |nth: u32| Counts([(f64::from(nth) * speed / 20_000.0 / core::f64::consts::TAU * 400.0) as i32, 0, 0]);
        let off = (1..=1_200).find(|nth| {
            !rig.control_loop.guard(&Samples { counts: counts(*nth), bus_voltage: 24.0, ..Samples::default() }).bridges
        });
        (off.map(|nth| counts(nth)[0]), rig.fault())
    };
    assert_eq!(run(15.0), (None, None));
    let (travel, fault) = run(40.0);
    assert_eq!(fault, Some(Fault::SpeedLimit));
    assert!(travel.is_some_and(|counts| counts <= 6), "{travel:?} counts");
}

#[test]
fn a_joint_limit_holds_however_far_away_the_other_one_is() {
    for low in [-1.0, -5.0e4, -1.0e6, -1.0e30, f64::NEG_INFINITY] {
        let mut device = paddle();
        device.joints[0].limits = Some((low, 0.1));
        let mut rig = Rig::with(&device, &scene(1, &[]), hardware(), rules());
        rig.arm();
        rig.turn(0, 0.5, 1.0);
        assert_eq!(rig.fault(), Some(Fault::JointLimit), "{low}");
    }
}

#[test]
fn clearing_over_and_over_does_not_lift_a_limit() {
    let mut rig = Rig::ready(&scene(1, &[wall(0.09, 100_000.0)]));
    rig.turn(0, 0.95, 5.0);
    rig.settle();
    rig.arm();
    rig.turn(0, -0.8, 5.0);
    let mut steps = 0;
    while rig.state() == State::Armed && steps < (0.16 * RATE) as u32 {
        rig.execute(Command::Clear).unwrap();
        rig.samples.counts[0] += (10.0 / f64::from(RATE) / core::f64::consts::TAU * rig::COUNTS) as i32;
        rig.step();
        steps += 1;
    }
    assert_eq!(rig.fault(), Some(Fault::PowerLimit));
}

#[test]
fn power_is_what_the_motors_give_not_what_the_scene_asks_for() {
    // The wall asks for a thousand times the torque limit; at 3 rad/s the motor gives 0.9 W of the 2 W allowed.
    let mut rig = Rig::ready(&scene(1, &[wall(0.09, 100_000.0)]));
    rig.turn(0, 0.95, 5.0);
    rig.settle();
    rig.arm();
    rig.turn(0, -0.8, 3.0);
    rig.turn(0, 0.85, 3.0);
    assert_eq!((rig.state(), rig.fault()), (State::Armed, None));
}

/// Cranks on capstans with 706 counts per turn, towards their stretched pose, where each count makes the same torques worth
/// up to an eighth more. The tip presses a wall beside it beyond the limit meanwhile.
#[test]
fn a_count_of_a_coarse_encoder_neither_trips_the_force_limit_nor_lets_more_flow() {
    const PER_TURN: f64 = 705.882;
    let mut coarse = five_bar();
    coarse.geometry = [0.025, 0.063, 0.063, 0.075, 0.075, 1.0];
    let stands_at = [2.897_247, 0.244_346, 0.0];
    coarse.home = Some(stands_at);
    for joint in &mut coarse.joints[..2] {
        joint.encoder = Some(Encoder { counts_per_turn: PER_TURN, offset: 0.0, inverted: false });
        joint.limits = Some((-3.3, 3.3));
    }
    let beside = Wall {
        surface: Surface::Plane(Plane { point: [-2e-5, 0.0, 0.0], normal: [1.0, 0.0, 0.0] }),
        ..wall(0.0, 500_000.0)
    };
    let rules = Rules { limits: Limits { tip_force: 5.0, ..limits() }, ..rules() };
    let mut rig = Rig::with(&coarse, &scene(2, &[beside]), hardware(), rules);
    let mechanism = AnyMechanism::<f32>::new(&coarse).expect("a sound mechanism");
    let home = rig.samples.counts;
    rig.arm();
    let mut most = 0.0_f32;
    for moved in 1..=12 {
        let (before, now) = (rig.samples.counts, Counts([home[0] + moved + 1, home[1] - moved, 0]));
        // The edge where the counts change, up to which what was commanded flows.
        let edge = core::array::from_fn(|i| {
            let counts = 0.5 * f64::from(before[i] + now[i] - 2 * home[i]);
            (stands_at[i] + counts / PER_TURN * core::f64::consts::TAU) as f32
        });
        let torque = rig.currents.map(|current| 0.1 * current);
        most = most.max(mechanism.leverage::<Libm>(&edge).force_squared(&torque).sqrt());
        rig.samples.counts = now;
        rig.run(0.02);
        assert_eq!(rig.fault(), None, "after {moved} counts");
    }
    assert!(most > 4.8 && most < 5.05, "{most} N");
}

#[test]
fn currents_that_alternate_push_as_hard_as_those_that_do_not() {
    let mut scene = quiet();
    (scene.rate_hz, scene.cutoff_hz) = (20_000.0, 200.0);
    let gentle = Rules { limits: Limits { tip_force: 0.1, ..limits() }, ..rules() };
    let mut rig = Rig::with(&paddle(), &scene, hardware(), gentle);
    rig.arm();
    // 0.2 N to and fro, a sample in 50 µs, for 5 ms.
    for nth in 0..100 {
        rig.shown_current = Some(if nth / 2 % 2 == 0 { 0.2 } else { -0.2 });
        rig.step();
    }
    assert_eq!(rig.fault(), Some(Fault::ForceLimit));
}
