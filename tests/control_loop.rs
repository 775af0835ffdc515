//! The control loop refuses unsafe commands, keeps its state, and turns the motors on and off without jumps.

use crate::rig::{
    self, RATE_HZ, Rig, five_bar, hardware, limits, paddle, rules, scene, sensing_paddle, spring_scene, wall,
};
use core::f64::consts::TAU;
use haptic_bridge::control::host_force::ForceRequest;
use haptic_bridge::control::joints::{Counts, Torques};
use haptic_bridge::control::{ARM_SECONDS, Beat, Command, HostAction, Press, Rules};
use haptic_bridge::drive::motor_stage::MotorDrive;
use haptic_bridge::model::description::Description;
use haptic_bridge::render::controller::Gains;
use haptic_bridge::render::scene::FeedForward;
use haptic_bridge::render::velocity::Washout;
use haptic_bridge::safety::fault::{Fault, FaultRecord, State};
use haptic_bridge::safety::limits::Limits;
use haptic_bridge::safety::refusal::Refusal;

fn gains_command(stiffness: f32, damping: f32, feed_forward: FeedForward) -> Command<rig::BoxedProgram> {
    let washout = Washout::new(2.0, RATE_HZ).unwrap();
    Command::Gains(Gains { wall: 0, stiffness, damping, feed_forward, washout_hz: 2.0 }, washout)
}

#[test]
fn motors_stay_off_without_a_device() {
    let mut rig = Rig::without_device(hardware(), rules());
    rig.step();
    assert!(rig.motors_are_off());
    for command in [Command::Arm, Command::CheckPolarity, Command::Home, gains_command(1.0, 0.0, FeedForward::Off)] {
        assert_eq!(rig.execute(command), Err(Refusal::NoDevice));
    }
    rig.run(0.1);
    assert!(rig.motors_are_off());
}

#[test]
fn a_device_that_is_not_homed_is_not_armed() {
    let mut rig = Rig::without_device(hardware(), rules());
    rig.load(&paddle(), &scene(1, &[]), false).unwrap();
    rig.settle();
    rig.execute(Command::PolarityKnown).unwrap();
    assert_eq!(rig.execute(Command::Arm), Err(Refusal::NotHomed));
    assert_eq!(rig.execute(Command::CheckPolarity), Err(Refusal::NotHomed));
    assert_eq!(rig.state(), State::Disarmed);
}

#[test]
fn a_motor_without_an_inductance_is_not_armed() {
    let mut description = paddle();
    description.joints[0].motor.as_mut().unwrap().inductance = 0.0;
    let mut rig = Rig::new(&description, &scene(1, &[]), hardware(), rules());
    assert_eq!(rig.execute(Command::Arm), Err(Refusal::MotorNotVerified(0)));
}

#[test]
fn a_device_whose_polarity_is_unknown_is_not_armed() {
    let mut rig = Rig::without_device(hardware(), rules());
    rig.load(&paddle(), &scene(1, &[]), false).unwrap();
    rig.settle();
    rig.execute(Command::Home).unwrap();
    rig.settle();
    assert_eq!(rig.execute(Command::Arm), Err(Refusal::PolarityUnchecked));
}

#[test]
fn a_device_with_an_incomplete_file_is_not_armed() {
    let mut unverified = paddle();
    unverified.joints[0].motor.as_mut().unwrap().verified = false;
    let mut unlimited = paddle();
    unlimited.joints[0].limits = None;
    let mut unmotored = paddle();
    unmotored.joints[0].motor = None;
    let mut homeless = paddle();
    homeless.home = None;
    let cases = [
        (unverified, Refusal::MotorNotVerified(0)),
        (unlimited, Refusal::NoJointLimits(0)),
        (unmotored, Refusal::NoMotor(0)),
        (homeless, Refusal::NoHome),
    ];
    for (description, refusal) in cases {
        let mut rig = Rig::without_device(hardware(), rules());
        rig.load(&description, &scene(1, &[]), false).unwrap();
        rig.settle();
        let _ = rig.execute(Command::Home);
        rig.execute(Command::PolarityKnown).unwrap();
        assert_eq!(rig.execute(Command::Arm), Err(refusal));
        assert_eq!(rig.execute(Command::CheckPolarity), Err(refusal));
    }
}

#[test]
fn a_device_without_encoder_or_with_too_many_joints_is_refused() {
    let mut blind = paddle();
    blind.joints[0].encoder = None;
    let mut rig = Rig::without_device(hardware(), rules());
    assert_eq!(rig.load(&blind, &scene(1, &[]), false), Err(Refusal::BadDevice));
    let mut one_axis = hardware();
    one_axis.axes = 1;
    let mut rig = Rig::without_device(one_axis, rules());
    let refusal = Refusal::TooManyJoints { joints: 2, axes: 1 };
    assert_eq!(rig.load(&five_bar(), &scene(2, &[]), false), Err(refusal));
}

#[test]
fn encoders_without_motors_follow_the_joints_inputs_and_start_at_home() {
    let mut rig = Rig::new(&sensing_paddle(), &scene(1, &[]), hardware(), rules());
    let count = (TAU / 1_000.0) as f32;
    let mut sensed = |inputs: [i32; 3], home: bool| {
        rig.control_loop.sense(&inputs);
        if home {
            rig.execute(Command::Home).expect("a device at rest can be homed");
            rig.control_loop.sense(&inputs);
        }
        let frame = rig.control_loop.frame();
        assert_eq!(rig.control_loop.force(&ForceRequest::default()).sensed, frame.sensed);
        frame.sensed
    };
    assert_eq!(sensed([7, 40, -20], true), [0.0, 0.5, 0.0]);
    assert_eq!(sensed([9, 50, -10], false), [10.0 * count, 0.5 - 10.0 * count, 0.0]);
    // A scene keeps the home of the same device, another device starts anew.
    rig.load(&sensing_paddle(), &scene(1, &[]), true).unwrap();
    rig.control_loop.sense(&[9, 41, -20]);
    assert_eq!(rig.control_loop.frame().sensed, [count, 0.5, 0.0]);
    rig.load(&sensing_paddle(), &scene(1, &[]), false).unwrap();
    rig.control_loop.sense(&[9, 1, 0]);
    assert_eq!(rig.control_loop.frame().sensed, [count, 0.5, 0.0]);
    rig.load(&paddle(), &scene(1, &[]), false).unwrap();
    assert!(!rig.control_loop.has_sensed());
    assert_eq!(rig.control_loop.frame().sensed, [0.0; 3]);
}

#[test]
fn a_device_with_more_encoders_than_inputs_is_refused() {
    let refusal = Refusal::TooManySensed { sensed: 2, inputs: 3, left: 1 };
    let two_joints = Description { sensed: sensing_paddle().sensed, ..five_bar() };
    let mut rig = Rig::without_device(hardware(), rules());
    assert_eq!(rig.load(&two_joints, &scene(2, &[]), false), Err(refusal));
    assert!(refusal.to_string().starts_with("the board has 3 encoder inputs, of which the device's joints leave 1"));
}

#[test]
fn arming_is_refused_in_walls_outside_limits_and_without_supply() {
    let mut rig = Rig::homed_paddle(&scene(1, &[wall(-0.05, 1_000.0)]));
    rig.turn(0, -0.6, 5.0);
    assert_eq!(rig.execute(Command::Arm), Err(Refusal::InsideWall));
    rig.turn(0, 1.1, 5.0);
    assert_eq!(rig.execute(Command::Arm), Err(Refusal::OutsideLimits(0)));
    rig.turn(0, 0.0, 5.0);
    for voltage in [0.0, 9.9, 28.1, f32::INFINITY] {
        rig.samples.bus_voltage = voltage;
        rig.control_loop.control(&rig.samples);
        let refusal = rig.execute(Command::Arm).unwrap_err();
        assert!(matches!(refusal, Refusal::BusVoltage | Refusal::Faulted(Fault::NotFinite)), "{voltage} V: {refusal}");
    }
}

#[test]
fn a_bilateral_wall_does_not_prevent_arming() {
    let mut both = wall(0.05, 100.0);
    both.bilateral = true;
    let mut rig = Rig::homed_paddle(&scene(1, &[both]));
    assert_eq!(rig.execute(Command::Arm), Ok(()));
}

#[test]
fn arming_is_refused_at_a_singular_pose() {
    let mut rig = Rig::new(&five_bar(), &scene(2, &[]), hardware(), rules());
    let mut angle = 0.0;
    while rig.execute(Command::Arm).is_ok() && angle < 1.0 {
        rig.execute(Command::Disarm).unwrap();
        angle += 0.001;
        let counts = (angle / core::f64::consts::TAU * rig::COUNTS_PER_TURN) as i32;
        rig.samples.counts = Counts([counts, -counts, 0]);
        rig.step();
    }
    assert_eq!(rig.execute(Command::Arm), Err(Refusal::Singular));
    assert_eq!(rig.fault(), None);
}

#[test]
fn a_device_in_motion_is_not_homed() {
    let mut rig = Rig::homed_paddle(&scene(1, &[]));
    rig.turn(0, 0.1, 2.0);
    assert_eq!(rig.execute(Command::Home), Err(Refusal::Moving));
    rig.settle();
    assert_eq!(rig.execute(Command::Home), Ok(()));
}

#[test]
fn homing_declares_the_pose_of_the_device_file() {
    let mut rig = Rig::without_device(hardware(), rules());
    rig.load(&five_bar(), &scene(2, &[]), false).unwrap();
    rig.samples.counts = Counts([12_345, -54_321, 0]);
    rig.settle();
    rig.execute(Command::Home).unwrap();
    rig.step();
    let q = rig.control_loop.status().q;
    let count = core::f32::consts::TAU / rig::COUNTS_PER_TURN as f32;
    assert!((q[0] - 2.4).abs() <= count && (q[1] - 0.7).abs() <= count, "{q:?}");
}

#[test]
fn torque_rises_from_zero_after_arming() {
    // The spring makes its full torque from the first step on.
    let mut rig = Rig::homed_paddle(&spring_scene(1, [0.02, 0.0, 0.0], 100.0));
    rig.execute(Command::Arm).unwrap();
    let full_torque = 100.0 * 0.02 * 0.1;
    let mut last = 0.0;
    for step in 1..=(ARM_SECONDS * RATE_HZ) as u32 {
        rig.step();
        let torque = rig.torques()[0];
        let expected = full_torque * step as f32 / (ARM_SECONDS * RATE_HZ);
        assert!((torque - expected).abs() < 1.0e-3 * full_torque, "step {step}: torque {torque}, not {expected}");
        assert!(torque >= last);
        last = torque;
    }
    rig.step();
    assert!((rig.torques()[0] - full_torque).abs() < 1.0e-5);
}

#[test]
fn a_new_scene_while_armed_fades_in_and_keeps_homing() {
    let spring_at = |x: f32| spring_scene(1, [x, 0.0, 0.0], 100.0);
    let mut rig = Rig::homed_paddle(&spring_at(0.02));
    rig.arm();
    let before = rig.torques()[0];
    rig.load(&paddle(), &spring_at(-0.02), true).unwrap();
    rig.step();
    let after = rig.torques()[0];
    assert!((after - before).abs() < 0.01 * before.abs(), "the torque jumps from {before} to {after} N m");
    rig.run(0.6);
    let settled = rig.torques()[0];
    assert!((settled + before).abs() < 1.0e-4, "the settled torque is {settled} N m");
    let status = rig.control_loop.status();
    assert_eq!((status.state, status.homed, status.polarity), (State::Armed, true, true));
}

#[test]
fn a_touched_scene_or_another_rate_is_refused_while_armed() {
    let mut rig = Rig::armed_paddle();
    assert_eq!(rig.load(&paddle(), &scene(1, &[wall(0.01, 10.0)]), true), Err(Refusal::InsideWall));
    let mut faster = scene(1, &[]);
    faster.rate_hz = 2.0 * RATE_HZ;
    assert_eq!(rig.load(&paddle(), &faster, true), Err(Refusal::Armed));
    assert_eq!(rig.load(&paddle(), &scene(1, &[]), false), Err(Refusal::Armed), "another device");
    assert_eq!(rig.state(), State::Armed);
}

#[test]
fn another_device_loses_homing_and_polarity() {
    let mut rig = Rig::homed_paddle(&scene(1, &[]));
    rig.load(&five_bar(), &scene(2, &[]), false).unwrap();
    let status = rig.control_loop.status();
    assert!(!status.homed && !status.polarity);
}

#[test]
fn limits_are_raised_only_while_off_and_lowered_at_any_time() {
    type Change = fn(&mut Limits, f32);
    let changes: [(&str, Change); 6] = [
        ("torque", |limits, by| limits.torque[0] *= by),
        ("current", |limits, by| limits.current[0] *= by),
        ("continuous current", |limits, by| limits.continuous_current[0] *= by),
        ("speed", |limits, by| limits.speed[0] *= by),
        ("power", |limits, by| limits.power *= by),
        ("tip force", |limits, by| limits.tip_force *= by),
    ];
    for (name, change) in changes {
        let changed = |by| {
            let mut limits = limits();
            change(&mut limits, by);
            Command::Rules(Rules { limits, ..rules() })
        };
        let mut rig = Rig::armed_paddle();
        assert_eq!(rig.execute(changed(1.01)), Err(Refusal::Armed), "{name}");
        assert_eq!(rig.execute(changed(0.99)), Ok(()), "{name}");
        assert_eq!(rig.execute(changed(1.0)), Err(Refusal::Armed), "{name}: the limit was raised again");
        rig.execute(Command::Disarm).unwrap();
        assert_eq!(rig.execute(changed(1.0)), Ok(()), "{name}");
    }
}

#[test]
fn protections_can_only_be_tightened_while_the_motors_are_on() {
    let watched = Rules {
        host_action: HostAction::Disarm,
        host_seconds: 0.5,
        passivity: true,
        index_period: [60_000, 0, 0],
        ..rules()
    };
    type Change = fn(&mut Rules);
    let looser: [(&str, Change); 6] = [
        ("no host watch", |rules| rules.host_action = HostAction::Ignore),
        ("a host whose silence is only recorded", |rules| rules.host_action = HostAction::Hold),
        ("a longer host time", |rules| rules.host_seconds = 0.6),
        ("no passivity", |rules| rules.passivity = false),
        ("no index", |rules| rules.index_period[0] = 0),
        ("another index", |rules| rules.index_period[0] = 30_000),
    ];
    let tighter: [(&str, Change); 3] = [
        ("a shorter host time", |rules| rules.host_seconds = 0.4),
        ("another joint's index", |rules| rules.index_period[1] = 60_000),
        ("unchanged rules", |_| ()),
    ];
    let changed = |change: Change| {
        let mut rules = watched;
        change(&mut rules);
        Command::Rules(rules)
    };
    let mut rig = Rig::new(&paddle(), &scene(1, &[]), hardware(), watched);
    rig.arm();
    for (name, change) in looser {
        assert_eq!(rig.execute(changed(change)), Err(Refusal::Armed), "{name}");
    }
    rig.run(0.4);
    assert_eq!(rig.state(), State::Armed);
    rig.run(0.2);
    assert_eq!(rig.fault(), Some(Fault::HostLost), "the refused rules are not in force");
    rig.execute(Command::Clear).unwrap();
    rig.arm();
    for (name, change) in tighter {
        assert_eq!(rig.execute(changed(change)), Ok(()), "{name}");
        rig.execute(Command::Disarm).unwrap();
        rig.execute(Command::Rules(watched)).unwrap();
        rig.arm();
    }
}

#[test]
fn limits_can_be_lowered_below_the_continuous_current() {
    let mut rig = Rig::armed_paddle();
    let mut lower = rules();
    lower.limits.current[0] = 0.5 * lower.limits.continuous_current[0];
    rig.execute(Command::Rules(lower)).unwrap();
    assert_eq!(rig.execute(Command::Rules(lower)), Ok(()), "the same rules are refused");
    lower.limits.power *= 0.5;
    assert_eq!(rig.execute(Command::Rules(lower)), Ok(()));
    lower.limits.continuous_current[0] *= 1.01;
    assert_eq!(rig.execute(Command::Rules(lower)), Err(Refusal::Armed));
}

#[test]
fn a_lowered_limit_acts_at_the_next_step() {
    type Change = fn(&mut Limits);
    // The wall makes 2.5 N at an arm of 0.1 m, so 0.25 N m.
    let changes: [(&str, Change, f32); 4] = [
        ("tip force", |limits| limits.tip_force = 2.0, 0.2),
        ("current", |limits| limits.current[0] = 1.5, 0.15),
        ("torque", |limits| limits.torque[0] = 0.15, 0.15),
        ("the smallest torque", |limits| limits.torque[0] = f32::MIN_POSITIVE, 0.0),
    ];
    for (name, change, expected) in changes {
        let mut rig = Rig::pressed_paddle(250.0);
        assert!((rig.torques()[0] - 0.25).abs() < 0.01);
        let mut lower = rules();
        change(&mut lower.limits);
        rig.execute(Command::Rules(lower)).unwrap();
        rig.step();
        assert!((rig.torques()[0] - expected).abs() < 1.0e-6, "{name}: {:?}", rig.torques());
    }
}

#[test]
fn a_lowered_tip_force_limits_the_fade_of_the_last_scene() {
    let mut rig = Rig::homed_paddle(&spring_scene(1, [0.02, 0.0, 0.0], 100.0));
    rig.arm();
    // The spring makes 2 N at an arm of 0.1 m, so 0.2 N m.
    assert!((rig.torques()[0].abs() - 0.2).abs() < 1.0e-3, "{:?}", rig.torques());
    rig.load(&paddle(), &scene(1, &[]), true).unwrap();
    rig.step();
    let mut lower = rules();
    lower.limits.tip_force = 0.5;
    rig.execute(Command::Rules(lower)).unwrap();
    for _ in 0..100 {
        rig.step();
        let force = rig.torques()[0].abs() / 0.1;
        assert!(force <= 0.5 * 1.001, "{force} N");
        // The earlier 2 N fade over half a second, so the force stays near its limit.
        assert!(force > 0.4, "{force} N");
    }
    assert_eq!(rig.state(), State::Armed);
}

#[test]
fn gains_changed_in_contact_cause_no_other_change_of_torque() {
    let mut rig = Rig::homed_paddle(&scene(1, &[wall(-0.005, 100.0)]));
    rig.arm();
    rig.turn(0, -0.1, 1.0);
    rig.settle();
    // The tip is 5 mm deep, so 100 N/m make 0.5 N or 0.05 N m.
    for stiffness in [100.0, 200.0, 150.0, 0.0, 400.0] {
        rig.execute(gains_command(stiffness, 0.0, FeedForward::Off)).unwrap();
        rig.step();
        let expected = stiffness * 0.005 * 0.1;
        let torque = rig.torques()[0];
        assert!((torque - expected).abs() < 2.0e-3 * expected.max(0.01), "{stiffness}: {torque}, not {expected} N m");
    }
    // Damping makes no force at rest.
    let before = rig.torques()[0];
    rig.execute(gains_command(400.0, 50.0, FeedForward::Off)).unwrap();
    rig.step();
    assert!((rig.torques()[0] - before).abs() < 1.0e-3 * before);
}

#[test]
fn invalid_gains_turn_the_motors_off() {
    for stiffness in [f32::NAN, f32::INFINITY] {
        let mut rig = Rig::homed_paddle(&scene(1, &[wall(-0.005, 100.0)]));
        rig.arm();
        rig.turn(0, -0.1, 1.0);
        rig.execute(gains_command(stiffness, 0.0, FeedForward::Off)).unwrap();
        rig.step();
        assert!(rig.motors_are_off());
        assert_eq!(rig.fault(), Some(Fault::NotFinite));
    }
}

#[test]
fn disarming_acts_before_the_next_duty() {
    let mut rig = Rig::pressed_paddle(250.0);
    assert!(rig.duties[0] != 0.0);
    rig.execute(Command::Disarm).unwrap();
    assert_eq!(rig.control_loop.duties(24.0, &[0.0; 3], false), [MotorDrive::default(); 3]);
    rig.step();
    assert!(rig.motors_are_off());
    assert_eq!(rig.state(), State::Disarmed);
}

#[test]
fn a_reported_fault_acts_before_the_next_duty() {
    let mut rig = Rig::pressed_paddle(250.0);
    rig.execute(Command::Fault(FaultRecord { fault: Fault::BreakInput, axis: None, value: 0.0, step: 0 })).unwrap();
    assert_eq!(rig.control_loop.duties(24.0, &[0.0; 3], false), [MotorDrive::default(); 3]);
    assert_eq!(rig.state(), State::Fault);
}

#[test]
fn the_polarity_check_moves_each_joint_and_ends_disarmed() {
    let mut rig = Rig::new(&five_bar(), &scene(2, &[]), hardware(), rules());
    rig.execute(Command::CheckPolarity).unwrap();
    let mut body = rig::Body::new(&five_bar());
    let mut pushed = [false; 2];
    while rig.state() == State::CheckingPolarity {
        body.step(&mut rig, 1.0);
        let torque = rig.torques();
        assert!(torque[0] == 0.0 || torque[1] == 0.0, "two joints have a torque: {torque:?}");
        assert!(torque[0].max(torque[1]) <= 0.5 * 0.3, "the torque is too large: {torque:?}");
        pushed[usize::from(torque[1] != 0.0)] = true;
    }
    assert_eq!((rig.state(), rig.fault(), pushed), (State::Disarmed, None, [true; 2]));
    assert!(rig.motors_are_off() && rig.control_loop.status().polarity);
}

#[test]
fn the_polarity_check_waits_for_a_gliding_joint() {
    let mut rig = Rig::new(&five_bar(), &scene(2, &[]), hardware(), rules());
    rig.execute(Command::CheckPolarity).unwrap();
    let mut body = rig::Body::new(&five_bar());
    body.run_first_joint_check(&mut rig);
    // The joint glides backwards for 1.5 s, like a device almost without friction.
    for _ in 0..(1.5 * rig.rate) as u32 {
        body.qd = [0.0, -0.05, 0.0];
        body.step(&mut rig, 1.0);
    }
    assert_eq!(rig.state(), State::CheckingPolarity, "{:?}", rig.fault());
    body.qd = [0.0; 3];
    body.run_check(&mut rig, 1.0);
    assert!(rig.control_loop.status().polarity, "{:?}", rig.fault());
}

/// A hand moves the joint, whose motor has no effect or is wired backwards.
#[test]
fn a_joint_that_a_hand_moves_fails_the_polarity_check() {
    for (joint, speed) in [(0, 0.012), (0, 0.15), (1, 0.012), (1, 0.15)] {
        let mut rig = Rig::new(&five_bar(), &scene(2, &[]), hardware(), rules());
        rig.execute(Command::CheckPolarity).unwrap();
        if joint == 1 {
            rig::Body::new(&five_bar()).run_first_joint_check(&mut rig);
        }
        let counts = rig.samples.counts[joint];
        let per_step = speed / f64::from(rig.rate) / TAU * rig::COUNTS_PER_TURN;
        for step in 0..(8.0 * rig.rate) as u32 {
            rig.samples.counts[joint] = counts + (f64::from(step) * per_step) as i32;
            rig.step();
            assert_eq!(rig.torques(), Torques::default(), "a joint that a hand moves must get no torque");
        }
        assert_eq!(rig.fault(), Some(Fault::PolarityUnrest), "joint {joint} at {speed} rad/s");
        assert!(!rig.control_loop.status().polarity && rig.motors_are_off());
    }
}

#[test]
fn the_polarity_check_keeps_the_tip_force_limit_after_homing() {
    let gentle = Rules { limits: Limits { tip_force: 0.2, ..limits() }, ..rules() };
    let mut rig = Rig::new(&paddle(), &scene(1, &[]), hardware(), gentle);
    rig.turn(0, 0.5, 1.0);
    rig.settle();
    // Homing changes the angle by 0.5 rad before the next step.
    rig.execute(Command::Home).expect("at rest");
    rig.execute(Command::CheckPolarity).expect("ready");
    for step in 0..1_200 {
        rig.step();
        assert_eq!(rig.state(), State::CheckingPolarity, "step {step}");
        let force = rig.torques()[0] / 0.1;
        assert!(force <= 0.2 * 1.001, "{force} N");
    }
}

#[test]
fn homing_elsewhere_requires_the_polarity_check_again() {
    let mut rig = Rig::homed_paddle(&scene(1, &[]));
    let at_home = rig.samples.counts;
    let mut home_at = |angle: f64| {
        rig.turn(0, angle, 1.0);
        rig.settle();
        rig.execute(Command::Home).expect("at rest");
        rig.control_loop.status().polarity
    };
    // A person returns the device to its home by hand, several times.
    assert!(home_at(0.015) && home_at(-0.015) && home_at(0.015));
    assert!(!home_at(0.03), "too far from the home of the check, although near the last home");
    assert!(!home_at(0.0), "the polarity is unknown after another home");
    assert_eq!(rig.samples.counts, at_home);
    assert_eq!(rig.execute(Command::Arm), Err(Refusal::PolarityUnchecked));
}

#[test]
fn a_joint_that_turns_back_or_not_at_all_fails_the_check() {
    let mut rig = Rig::homed_paddle(&scene(1, &[]));
    rig.execute(Command::CheckPolarity).unwrap();
    assert!(!rig.control_loop.status().polarity, "a new check discards the earlier result");
    let mut body = rig::Body::new(&paddle());
    body.run_check(&mut rig, -1.0);
    assert_eq!(rig.fault(), Some(Fault::PolarityWrong));
    rig.execute(Command::Clear).unwrap();
    rig.execute(Command::CheckPolarity).unwrap();
    rig.run(2.4);
    assert_eq!(rig.fault(), Some(Fault::PolarityNoMotion));
    rig.execute(Command::Clear).unwrap();
    assert_eq!(rig.execute(Command::Arm), Err(Refusal::PolarityUnchecked));
}

#[test]
fn the_polarity_check_starts_with_a_cleared_power_mean() {
    // The mean power of the earlier run must not count in the check.
    let mut rig = Rig::homed_paddle(&scene(1, &[wall(0.09, 100_000.0)]));
    rig.turn(0, 0.95, 5.0);
    rig.settle();
    rig.arm();
    rig.turn(0, -0.8, 5.0);
    rig.turn(0, 0.85, 6.0);
    rig.execute(Command::Disarm).unwrap();
    rig.settle();
    rig.execute(Command::CheckPolarity).unwrap();
    rig.run(0.5);
    assert_eq!(rig.state(), State::CheckingPolarity, "{:?}", rig.control_loop.status().fault);
}

#[test]
fn commands_in_any_order_never_move_a_disarmed_device() {
    use proptest::prelude::*;
    let scripts = proptest::collection::vec(((0_u8..10, any::<f32>()), -50_i32..50), 1..60);
    proptest!(crate::common::property_config(200), |(script in scripts)| {
        let mut rig = Rig::homed_paddle(&scene(1, &[wall(-0.005, 250.0)]));
        let mut armed = false;
        for ((which, number), moved) in script {
            let press = Press { holder: number.to_bits() & 1, seen: rig.control_loop.steps().wrapping_sub(number.to_bits() >> 22) };
            let command = match which {
                0 if moved > 0 => Command::ArmHeld(press),
                0 => Command::Arm,
                1 => Command::Disarm,
                2 => Command::Clear,
                3 => Command::Home,
                4 => Command::Beat([Beat::Here, Beat::Held(press), Beat::Released][moved.unsigned_abs() as usize % 3]),
                5 => gains_command(number, number, FeedForward::Full),
                6 => gains_command(number, 0.0, FeedForward::Washout),
                7 => Command::Fault(FaultRecord { fault: Fault::GateDriver, axis: None, value: number, step: 0 }),
                8 => Command::Rules(Rules { passivity: number > 0.0, ..rules() }),
                _ => Command::PolarityKnown,
            };
            let arming = matches!(command, Command::Arm | Command::ArmHeld(_));
            let outcome = rig.execute(command);
            armed = (arming && outcome.is_ok()) || (armed && rig.state() == State::Armed);
            rig.samples.counts[0] += moved;
            rig.step();
            armed &= rig.state() == State::Armed;
            prop_assert!(armed || rig.motors_are_off());
            prop_assert!(rig.duties.iter().all(|duty| duty.abs() <= 0.92));
            prop_assert!(rig.torques()[0].abs() <= 0.3 * 1.000_01);
        }
    });
}
