//! Limits act at every crest of the carrier, at every control rate, for any commanded torque and any velocity filter.

use crate::rig::{
    self, RATE_HZ, RATES_HZ, Rig, at_rate, far_wall, five_bar, hardware, limits, paddle, rules, scene, wall,
};
use haptic_bridge::control::frame::Samples;
use haptic_bridge::control::joints::{Counts, Currents};
use haptic_bridge::control::{Command, Rules};
use haptic_bridge::drive::motor_stage::MotorDrive;
use haptic_bridge::drive::stage::MAX_DUTY;
use haptic_bridge::math::Libm;
use haptic_bridge::model::description::Encoder;
use haptic_bridge::model::mechanism::AnyMechanism;
use haptic_bridge::render::scene::{Plane, Surface, Wall};
use haptic_bridge::render::velocity::{Coefficients, Estimator};
use haptic_bridge::safety::fault::{Fault, State};
use haptic_bridge::safety::limits::Limits;

#[test]
fn limits_hold_for_any_commanded_torque() {
    let mut rig = Rig::homed_paddle(&scene(1, &[wall(-0.005, 1.0e9)]));
    rig.arm();
    let bound = limits().torque[0] * 1.000_01;
    for angle in [-0.1, -0.5, -0.9, 0.2] {
        rig.turn(0, angle, 4.0);
        assert!(rig.torques()[0].abs() <= bound, "{:?}", rig.control_loop.frame());
        assert!(rig.duties.iter().all(|duty| duty.abs() <= MAX_DUTY));
    }
}

fn armed_paddle_at(rate: f32) -> Rig {
    let mut rig = Rig::homed_paddle(&at_rate(rate, far_wall()));
    rig.arm();
    rig
}

/// Turns joint 0 at `speed` (rad/s) for at most `max_periods` carrier periods. Returns the period in which the
/// bridges float, or `None` if they stay on. `shown` holds the measured currents, A.
fn crests_until_off(rig: &mut Rig, speed: f64, max_periods: u32, shown: [f32; 3]) -> Option<u32> {
    let start = rig.samples.counts[0];
    (1..=max_periods).find(|nth| {
        let moved = f64::from(*nth) * speed / 20_000.0 / core::f64::consts::TAU * rig::COUNTS_PER_TURN;
        let counts = Counts([start + moved as i32, 0, 0]);
        !rig.control_loop
            .guard(&Samples { counts, bus_voltage: 24.0, currents: Currents(shown), ..Samples::default() })
            .bridges
    })
}

#[test]
fn an_over_current_is_found_at_the_next_crest_at_every_rate() {
    for rate in RATES_HZ {
        let mut rig = armed_paddle_at(rate);
        assert_eq!(crests_until_off(&mut rig, 0.0, 10, [6.0, 0.0, 0.0]), Some(1), "{rate} Hz");
        assert_eq!(rig.fault(), Some(Fault::OverCurrent));
        assert_eq!(rig.control_loop.duties(24.0, &[0.0; 3], false), [MotorDrive::default(); 3]);
    }
}

#[test]
fn speed_and_joint_limits_act_in_time_at_every_rate() {
    for rate in RATES_HZ {
        // 40 rad/s is twice the limit. The first-order filter of 200 Hz (0.8 ms) needs 0.8 ms · ln 2, or 11 periods.
        let mut rig = armed_paddle_at(rate);
        let seen = crests_until_off(&mut rig, 40.0, 100, [0.0; 3]);
        assert!(seen.is_some_and(|seen| (10..=14).contains(&seen)), "{rate} Hz: {seen:?}");
        assert_eq!(rig.fault(), Some(Fault::SpeedLimit));
        // 19 rad/s is within the speed limit, and the joint limit of 1 rad is 1053 periods away.
        let mut rig = armed_paddle_at(rate);
        let seen = crests_until_off(&mut rig, 19.0, 2_000, [0.0; 3]);
        assert!(seen.is_some_and(|seen| (1_052..=1_056).contains(&seen)), "{rate} Hz: {seen:?}");
        assert_eq!(rig.fault(), Some(Fault::JointLimit));
    }
}

#[test]
fn no_scene_filter_delays_or_disables_the_speed_limit() {
    for (kind, cutoff) in
        [(Estimator::Butterworth, 1.0e-6), (Estimator::FirstOrder, 1.0), (Estimator::Butterworth, 900.0)]
    {
        let mut rig = Rig::armed_paddle();
        let coefficients = Coefficients::new(kind, RATE_HZ, cutoff).unwrap();
        rig.execute(Command::Coefficients(coefficients)).unwrap();
        rig.turn(0, 0.5, 30.0);
        assert_eq!(rig.fault(), Some(Fault::SpeedLimit), "{kind:?} {cutoff} Hz");
        let travel = rig.control_loop.status().q[0];
        assert!(travel < 0.1, "{kind:?} {cutoff} Hz: a travel of {travel} rad");
    }
}

#[test]
fn a_coarse_encoder_moves_a_few_counts_before_a_speed_limit() {
    // At 400 counts per turn, one count in a carrier period is 314 rad/s. At 15 rad/s, below the limit, a count takes 1
    // ms.
    let mut coarse = paddle();
    coarse.joints[0].encoder.as_mut().unwrap().counts_per_turn = 400.0;
    let run = |speed: f64| {
        let mut rig = Rig::new(&coarse, &far_wall(), hardware(), rules());
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
    assert!(travel.is_some_and(|counts| counts <= 6), "a travel of {travel:?} counts");
}

#[test]
fn a_joint_limit_holds_at_any_distance_of_the_other_limit() {
    for low in [-1.0, -5.0e4, -1.0e6, -1.0e30, f64::NEG_INFINITY] {
        let mut device = paddle();
        device.joints[0].limits = Some((low, 0.1));
        let mut rig = Rig::new(&device, &scene(1, &[]), hardware(), rules());
        rig.arm();
        rig.turn(0, 0.5, 1.0);
        assert_eq!(rig.fault(), Some(Fault::JointLimit), "{low}");
    }
}

#[test]
fn repeated_clearing_does_not_lift_a_limit() {
    let mut rig = Rig::homed_paddle(&scene(1, &[wall(0.09, 100_000.0)]));
    rig.turn(0, 0.95, 5.0);
    rig.settle();
    rig.arm();
    rig.turn(0, -0.8, 5.0);
    let mut steps = 0;
    while rig.state() == State::Armed && steps < (0.16 * RATE_HZ) as u32 {
        rig.execute(Command::Clear).unwrap();
        rig.samples.counts[0] += (10.0 / f64::from(RATE_HZ) / core::f64::consts::TAU * rig::COUNTS_PER_TURN) as i32;
        rig.step();
        steps += 1;
    }
    assert_eq!(rig.fault(), Some(Fault::PowerLimit));
}

#[test]
fn the_power_limit_counts_the_motors_power_not_the_scenes() {
    // The wall requests a thousand times the torque limit. At 3 rad/s the motor's power is 0.9 W of the allowed 2 W.
    let mut rig = Rig::homed_paddle(&scene(1, &[wall(0.09, 100_000.0)]));
    rig.turn(0, 0.95, 5.0);
    rig.settle();
    rig.arm();
    rig.turn(0, -0.8, 3.0);
    rig.turn(0, 0.85, 3.0);
    assert_eq!((rig.state(), rig.fault()), (State::Armed, None));
}

/// Two cranks with 706 counts per turn move towards the stretched pose of a five-bar. Near that pose each count raises
/// the tip force of the same torques by up to an eighth. The tip presses into a wall beyond the limit.
#[test]
fn a_coarse_count_neither_trips_nor_exceeds_the_force_limit() {
    const COARSE_COUNTS_PER_TURN: f64 = 705.882;
    let mut coarse = five_bar();
    coarse.geometry = [0.025, 0.063, 0.063, 0.075, 0.075, 1.0, 0.0, 0.0];
    let stands_at = [2.897_247, 0.244_346, 0.0];
    coarse.home = Some(stands_at);
    for joint in &mut coarse.joints[..2] {
        joint.encoder = Some(Encoder { counts_per_turn: COARSE_COUNTS_PER_TURN, offset: 0.0, inverted: false });
        joint.limits = Some((-3.3, 3.3));
    }
    let beside = Wall {
        surface: Surface::Plane(Plane { point: [-2e-5, 0.0, 0.0], normal: [1.0, 0.0, 0.0] }),
        ..wall(0.0, 500_000.0)
    };
    let rules = Rules { limits: Limits { tip_force: 5.0, ..limits() }, ..rules() };
    let mut rig = Rig::new(&coarse, &scene(2, &[beside]), hardware(), rules);
    let mechanism = AnyMechanism::<f32>::new(&coarse).expect("a sound mechanism");
    let home = rig.samples.counts;
    rig.arm();
    let mut largest_force = 0.0_f32;
    for moved in 1..=12 {
        let (before, now) = (rig.samples.counts, Counts([home[0] + moved + 1, home[1] - moved, 0]));
        // The commanded torques flow until the counts change, which happens at this pose.
        let edge = core::array::from_fn(|i| {
            let counts = 0.5 * f64::from(before[i] + now[i] - 2 * home[i]);
            (stands_at[i] + counts / COARSE_COUNTS_PER_TURN * core::f64::consts::TAU) as f32
        });
        let torque = rig.currents.map(|current| 0.1 * current);
        largest_force = largest_force.max(mechanism.leverage::<Libm>(&edge).force_squared(&torque).sqrt());
        rig.samples.counts = now;
        rig.run(0.02);
        assert_eq!(rig.fault(), None, "a fault after {moved} counts");
    }
    assert!(largest_force > 4.8 && largest_force < 5.05, "the largest force is {largest_force} N");
}

#[test]
fn the_force_limit_counts_alternating_currents_in_full() {
    let gentle = Rules { limits: Limits { tip_force: 0.1, ..limits() }, ..rules() };
    let mut rig = Rig::new(&paddle(), &at_rate(20_000.0, far_wall()), hardware(), gentle);
    rig.arm();
    // A force of 0.2 N alternates for 5 ms, sampled every 50 µs.
    for nth in 0..100 {
        rig.shown_current = Some(if nth / 2 % 2 == 0 { 0.2 } else { -0.2 });
        rig.step();
    }
    assert_eq!(rig.fault(), Some(Fault::ForceLimit));
}
