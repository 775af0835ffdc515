//! Forces from the host: their leases, refusals with reasons, limits shared with the walls, and contacts that move
//! without force jumps.

use crate::rig::statics::{force_at_tip, torques};
use crate::rig::{self, RATE_HZ, Rig, five_bar, hardware, rules, scene, wall};
use haptic_bridge::board::protocol::{BadForce, ForceAnswer, ForceDone, ForceRequest, HostContact};
use haptic_bridge::control::host_force::{
    MAX_CONTACT_DAMPING, MAX_CONTACT_DISTANCE, MAX_CONTACT_STIFFNESS, MAX_HELD_FORCE, MAX_HELD_TORQUE, MAX_LEASE,
};
use haptic_bridge::control::joints::Torques;
use haptic_bridge::control::{Command, HostAction, Rules};
use haptic_bridge::render::scene::Wall;
use haptic_bridge::safety::fault::{Fault, State};
use haptic_bridge::safety::limits::Limits;
use nalgebra::Vector2;

/// Rounding error of a torque after its conversion to a current and back, N m.
const ROUNDING_NM: f32 = 1.0e-5;

fn armed_rig() -> Rig {
    let mut rig = Rig::new(&five_bar(), &scene(2, &[]), hardware(), rules());
    rig.arm();
    rig
}

fn request(sequence: u32) -> ForceRequest {
    ForceRequest { sequence, hold: 0.01, fade: 0.02, ..ForceRequest::default() }
}

fn torque_request(sequence: u32, torque: f32) -> ForceRequest {
    ForceRequest { torque: [torque, 0.0, 0.0], ..request(sequence) }
}

fn force_request(sequence: u32, x: f32, y: f32) -> ForceRequest {
    ForceRequest { force: [x, y, 0.0], hold: MAX_LEASE, ..request(sequence) }
}

fn poll(rig: &mut Rig) -> ForceAnswer {
    rig.control_loop.force(&ForceRequest::default())
}

#[test]
fn a_host_force_is_scaled_to_the_tip_force_limit() {
    let gentle = Rules { limits: Limits { tip_force: 1.0, ..rules().limits }, ..rules() };
    let tip = poll(&mut armed_rig()).tip;
    // The tip is 1 mm deep in a wall that pushes with 0.6 N along x.
    let bilateral = Wall { bilateral: true, ..wall(tip[0] + 1.0e-3, 600.0) };
    for (walls, push, size) in
        [(&[][..], 0.0, 0.25), (&[], 0.0, 0.02), (&[], 0.7, 0.2), (&[bilateral], 0.0, 0.2), (&[bilateral], 0.5, 0.1)]
    {
        let mut rig = Rig::new(&five_bar(), &scene(2, walls), hardware(), gentle);
        rig.arm();
        let wall = if walls.is_empty() { 0.0 } else { 0.6 };
        for nth in 0..12_u32 {
            let (sin, cos) = (0.5 * nth as f32).sin_cos();
            let both = ForceRequest {
                torque: [size * cos, size * sin, 0.0],
                ..force_request(nth + 1, push * sin, -push * cos)
            };
            assert_eq!(rig.control_loop.force(&both).done, ForceDone::Taken);
            rig.step();
            let answer = poll(&mut rig);
            let forces = [wall + push * sin, -push * cos].map(f64::from);
            let requested = force_at_tip(&answer.q, Vector2::new(both.torque[0], both.torque[1]).map(f64::from))
                + Vector2::from(forces);
            let left = force_at_tip(&answer.q, Vector2::new(answer.torque[0], answer.torque[1]).map(f64::from));
            let share = (1.0 / requested.norm()).min(1.0);
            assert!((left - requested * share).norm() < 2.0e-3, "{left} left of {requested}, {both:?}, {answer:?}");
            assert!((f64::from(answer.share) - share).abs() < 2.0e-3, "share {share}: {answer:?}");
        }
    }
}

#[test]
fn a_lowered_tip_force_limit_acts_at_the_next_step_and_in_fades() {
    let mut rig = armed_rig();
    let request = ForceRequest { hold: 0.02, fade: 0.02, torque: [0.2, -0.1, 0.0], ..request(1) };
    assert_eq!(rig.control_loop.force(&request).done, ForceDone::Taken);
    let force = |rig: &Rig| rig.tip_force().norm();
    rig.step();
    assert!(force(&rig) > 2.0, "a tip force of {} N", force(&rig));
    for (nth, limit) in [1.5_f32, 0.5].into_iter().enumerate() {
        let mut lower = rules();
        lower.limits.tip_force = limit;
        rig.execute(Command::Rules(lower)).expect("limits are lowered while armed");
        rig.step();
        assert!((force(&rig) - f64::from(limit)).abs() < 1.0e-3, "limit {nth}: a tip force of {} N", force(&rig));
    }
    let mut before = force(&rig);
    for _ in 0..80 {
        rig.step();
        assert!(force(&rig) <= before + 1.0e-4, "the force rises from {before} N to {} N", force(&rig));
        before = force(&rig);
    }
    assert_eq!(before, 0.0);
}

#[test]
fn a_request_is_held_then_fades_evenly_and_ends() {
    let mut rig = armed_rig();
    assert_eq!(rig.control_loop.force(&torque_request(1, 0.2)).done, ForceDone::Taken);
    let period = 1.0 / RATE_HZ;
    let mut before = None;
    for step in 1..=80 {
        rig.step();
        let age = step as f32 * period;
        let share = ((0.03 - age) / 0.02).clamp(0.0, 1.0);
        let now = rig.torques()[0];
        // The period of a step is rounded, and an age is a sum of periods.
        assert!((now - 0.2 * share).abs() < 0.2 * 1.0e-3, "a torque of {now} N m at {age} s");
        let max_change = 0.2 * period / 0.02 * 1.001;
        assert!(before.is_none_or(|before: f32| (now - before).abs() < max_change), "{before:?} to {now} at {age} s");
        before = Some(now);
        let answer = poll(&mut rig);
        assert!((answer.share - share).abs() < 1.0e-3);
        // Rounding decides on which step the lease ends.
        let ending = (age - 0.03).abs() < 0.5 * period;
        assert!(ending || answer.age.is_some() == (age < 0.03), "{age} s: {answer:?}");
    }
    assert_eq!(rig.torques(), Torques::default());
    assert_eq!(rig.state(), State::Armed);
}

#[test]
fn a_late_request_has_only_the_rest_of_its_lease() {
    let mut rig = armed_rig();
    let seen = poll(&mut rig).step;
    rig.run(0.02);
    // 20 ms of the 30 ms lease have passed, which is half of the fade.
    let half = ForceRequest { seen: Some(seen), ..torque_request(1, 0.2) };
    assert_eq!(rig.control_loop.force(&half).done, ForceDone::Taken);
    rig.step();
    let now = rig.torques()[0];
    let share = (0.03 - 0.02 - 1.0 / RATE_HZ) / 0.02;
    assert!((now - 0.2 * share).abs() < 1.0e-4, "{now}");
    rig.run(0.02);
    let answer = rig.control_loop.force(&ForceRequest { sequence: 2, ..half });
    assert_eq!((answer.done, answer.age), (ForceDone::TooOld, None));
    rig.step();
    assert_eq!(rig.torques(), Torques::default());
    let future = ForceRequest { seen: Some(answer.step + 10), ..torque_request(3, 0.2) };
    assert_eq!(rig.control_loop.force(&future).done, ForceDone::Bad(BadForce::Seen));
}

#[test]
fn repeated_and_reordered_requests_change_nothing() {
    let mut rig = armed_rig();
    assert_eq!(rig.control_loop.force(&torque_request(u32::MAX, 0.1)).done, ForceDone::Taken);
    for old in [u32::MAX, u32::MAX - 1, u32::MAX / 2 + 10] {
        let answer = rig.control_loop.force(&torque_request(old, 0.2));
        assert_eq!((answer.sequence, answer.done), (old, ForceDone::NotNewer));
        rig.step();
        assert!((rig.torques()[0] - 0.1).abs() < ROUNDING_NM);
    }
    // The sequence number wraps.
    assert_eq!(rig.control_loop.force(&torque_request(0, 0.2)).done, ForceDone::Taken);
    rig.step();
    assert!((rig.torques()[0] - 0.2).abs() < ROUNDING_NM);
    // After the last lease has ended, another host program may start with any sequence number.
    rig.run(0.05);
    assert_eq!(rig.control_loop.force(&torque_request(u32::MAX - 7, 0.1)).done, ForceDone::Taken);
}

#[test]
fn lost_requests_are_bridged_while_the_last_one_is_held() {
    let mut rig = armed_rig();
    let mut sequence = 0;
    for millisecond in 0..100 {
        // At 1 kHz seven of eight requests are lost, so 8 ms pass between requests that are held for 10 ms.
        if millisecond % 8 == 0 {
            sequence += 1;
            assert_eq!(rig.control_loop.force(&torque_request(sequence, 0.1)).done, ForceDone::Taken);
        }
        rig.step();
        rig.step();
        let now = rig.torques()[0];
        assert!((now - 0.1).abs() < ROUNDING_NM, "a torque of {now} N m after {millisecond} ms");
    }
}

#[test]
fn invalid_numbers_are_refused_and_leave_the_present_force() {
    let contact = HostContact { point: [0.0; 3], normal: [0.6, 0.8, 0.0], stiffness: 100.0, damping: 1.0 };
    let with = |contact: HostContact| ForceRequest { contact: Some(contact), ..request(2) };
    let mut bad: Vec<(BadForce, ForceRequest)> = Vec::new();
    let invalid = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX];
    let above = |limit: f32| invalid.into_iter().chain([limit * 1.000_01, -limit * 1.000_01]);
    for value in above(MAX_HELD_FORCE) {
        bad.push((BadForce::Force, force_request(2, value, 0.0)));
        bad.push((BadForce::Force, force_request(2, 0.0, value)));
    }
    // A planar device has no third direction and no third joint.
    bad.push((BadForce::Force, ForceRequest { force: [0.0, 0.0, 1.0], ..request(2) }));
    bad.push((BadForce::Torque, ForceRequest { torque: [0.0, 0.0, 0.1], ..request(2) }));
    bad.push((BadForce::Normal, with(HostContact { normal: [0.0, 0.0, 1.0], ..contact })));
    for value in above(MAX_HELD_TORQUE) {
        bad.push((BadForce::Torque, torque_request(2, value)));
    }
    for value in above(MAX_LEASE).chain([-0.01]) {
        bad.push((BadForce::Lease, ForceRequest { hold: value, ..request(2) }));
        bad.push((BadForce::Lease, ForceRequest { fade: value, ..request(2) }));
    }
    for value in above(MAX_CONTACT_DISTANCE) {
        bad.push((BadForce::Point, with(HostContact { point: [0.0, value, 0.0], ..contact })));
    }
    for value in above(1.1).chain([0.0]) {
        bad.push((BadForce::Normal, with(HostContact { normal: [value, 0.0, 0.0], ..contact })));
    }
    for value in above(MAX_CONTACT_STIFFNESS).chain([-1.0]) {
        bad.push((BadForce::Gains, with(HostContact { stiffness: value, ..contact })));
    }
    for value in above(MAX_CONTACT_DAMPING).chain([-1.0]) {
        bad.push((BadForce::Gains, with(HostContact { damping: value, ..contact })));
    }
    for (reason, request) in bad {
        let mut rig = armed_rig();
        assert_eq!(rig.control_loop.force(&torque_request(1, 0.1)).done, ForceDone::Taken);
        let answer = rig.control_loop.force(&request);
        assert_eq!(answer.done, ForceDone::Bad(reason), "{request:?}");
        assert!(answer.done.to_string().contains("not taken"), "{}", answer.done);
        rig.step();
        assert!((rig.torques()[0] - 0.1).abs() < ROUNDING_NM, "{request:?}");
    }
}

#[test]
fn the_largest_accepted_numbers_are_harmless() {
    let mut rig = armed_rig();
    let answer = rig.control_loop.force(&ForceRequest {
        contact: Some(HostContact {
            point: [MAX_CONTACT_DISTANCE, 0.0, 0.0],
            normal: [1.0, 0.0, 0.0],
            stiffness: MAX_CONTACT_STIFFNESS,
            damping: MAX_CONTACT_DAMPING,
        }),
        torque: [MAX_HELD_TORQUE, -MAX_HELD_TORQUE, 0.0],
        ..force_request(1, MAX_HELD_FORCE, -MAX_HELD_FORCE)
    });
    assert_eq!(answer.done, ForceDone::Taken);
    for _ in 0..100 {
        rig.step();
        assert!(rig.torques().iter().all(|torque| torque.abs() <= 0.3 * (1.0 + ROUNDING_NM)));
    }
    assert_eq!(rig.state(), State::Armed);
}

#[test]
fn only_armed_motors_accept_force_and_disarming_ends_it() {
    let mut rig = Rig::new(&five_bar(), &scene(2, &[]), hardware(), rules());
    let answer = rig.control_loop.force(&torque_request(1, 0.1));
    assert_eq!((answer.done, answer.state), (ForceDone::NotArmed, State::Disarmed));
    assert_eq!(poll(&mut rig).done, ForceDone::Looked);
    assert_eq!(answer.tip, rig.control_loop.status().tip, "a disarmed board reports its state too");
    for by_fault in [false, true] {
        rig.arm();
        assert_eq!(rig.control_loop.force(&force_request(1, 1.0, 0.0)).done, ForceDone::Taken);
        rig.step();
        assert_ne!(rig.torques(), Torques::default());
        if by_fault {
            rig.control_loop.trip(Fault::GateDriver, None, 0.0);
        } else {
            rig.execute(Command::Disarm).unwrap();
        }
        let answer = poll(&mut rig);
        assert_eq!((answer.age, answer.force, answer.share), (None, [0.0; 3], 0.0));
        rig.step();
        assert!(rig.motors_are_off());
        // The motors are armed again at once, within the lease of the request.
        rig.execute(Command::Clear).unwrap();
        rig.execute(Command::Arm).unwrap();
        for _ in 0..20 {
            rig.step();
            assert_eq!(rig.torques(), Torques::default());
        }
        rig.execute(Command::Disarm).unwrap();
    }
}

#[test]
fn a_force_grows_with_the_ramp_after_arming() {
    let mut rig = Rig::new(&five_bar(), &scene(2, &[]), hardware(), rules());
    rig.execute(Command::Arm).unwrap();
    assert_eq!(rig.control_loop.force(&force_request(1, 1.0, 0.0)).done, ForceDone::Taken);
    // 0.1 s are a fifth of the 0.5 s ramp.
    rig.run(0.1);
    let answer = poll(&mut rig);
    assert!((answer.share - 0.2).abs() < 0.01, "{answer:?}");
    assert!((answer.force[0] - answer.share).abs() < 1.0e-6);
}

#[test]
fn the_torques_of_a_tip_force_do_the_same_virtual_work() {
    for (x, y) in [(1.0, 0.0), (0.0, 1.0), (-0.7, 0.4)] {
        let mut rig = armed_rig();
        rig.control_loop.force(&force_request(1, x, y));
        rig.step();
        let answer = poll(&mut rig);
        let expected = torques(&answer.q, [x, y].map(f64::from));
        for i in 0..2 {
            assert!((f64::from(answer.torque[i]) - expected[i]).abs() < 1.0e-6, "{answer:?}, expected {expected}");
        }
        assert_eq!((answer.force, answer.share), ([x, y, 0.0], 1.0));
    }
}

#[test]
fn walls_and_host_are_scaled_by_the_same_share_at_a_limit() {
    // The tip is 1 mm deep in a bilateral wall that pushes with 2 N along x. The host requests 12 N along y.
    let mut rig = armed_rig();
    let tip = poll(&mut rig).tip;
    let bilateral = Wall { bilateral: true, ..wall(tip[0] + 1.0e-3, 2_000.0) };
    let mut rig = Rig::new(&five_bar(), &scene(2, &[bilateral]), hardware(), rules());
    rig.arm();
    rig.control_loop.force(&force_request(1, 0.0, 12.0));
    rig.step();
    let answer = poll(&mut rig);
    assert!((rig.control_loop.frame().at.walls.wall_force - 2.0).abs() < 1.0e-3);
    let requested = torques(&answer.q, [2.0, 12.0]);
    let share = 0.3 / requested.amax();
    assert!(share < 0.9, "the requested torques must exceed 0.3 N m: {requested}");
    for i in 0..2 {
        let left = f64::from(answer.torque[i]);
        assert!((left - share * requested[i]).abs() < 1.0e-4, "{left} is rendered of {requested}, share {share}");
    }
    assert!((f64::from(answer.share) - share).abs() < 1.0e-3);
    assert!((f64::from(answer.force[1]) - 12.0 * share).abs() < 1.0e-2);
}

#[test]
fn the_reply_reports_the_motion_of_tip_and_joints() {
    let mut rig = armed_rig();
    let counts = (rig::COUNTS_PER_TURN / core::f64::consts::TAU / f64::from(RATE_HZ)).round() as i32;
    let mut turn = |steps: u32| {
        for _ in 0..steps {
            rig.samples.counts[0] += counts;
            rig.step();
        }
        poll(&mut rig)
    };
    // Joint 0 turns at 1 rad/s, first until the filters have settled.
    let (before, now) = (turn(200), turn(5));
    assert_eq!(now.step, before.step + 5);
    let passed = (now.step - before.step) as f32 * now.period;
    for i in 0..2 {
        let moved = (now.tip[i] - before.tip[i]) / passed;
        assert!((now.velocity[i] - moved).abs() < 0.02 * moved.abs().max(0.02), "{now:?} for a tip at {moved} m/s");
        let turned = (now.q[i] - before.q[i]) / passed;
        assert!((now.qd[i] - turned).abs() < 0.02, "{now:?}, the joint turns at {turned} rad/s");
    }
}

#[test]
fn a_contact_pushes_along_its_normal_and_never_pulls() {
    let mut rig = armed_rig();
    let tip = poll(&mut rig).tip;
    let normal = [0.6, 0.8, 0.0];
    let at = |depth: f32| core::array::from_fn(|i| tip[i] + normal[i] * depth);
    for (sequence, depth, expected) in [(1, 1.0e-3, 1.5), (2, -1.0e-3, 0.0)] {
        let contact = HostContact { point: at(depth), normal, stiffness: 1_500.0, damping: 3.0 };
        let request = ForceRequest { contact: Some(contact), hold: MAX_LEASE, ..request(sequence) };
        assert_eq!(rig.control_loop.force(&request).done, ForceDone::Taken);
        rig.run(0.05);
        let answer = poll(&mut rig);
        for (force, normal) in answer.force.iter().zip(&normal) {
            assert!((force - expected * normal).abs() < 1.0e-3, "{answer:?}");
        }
    }
}

#[test]
fn a_contact_that_jumps_tilts_or_appears_causes_no_force_jump() {
    let mut rig = armed_rig();
    let tip = poll(&mut rig).tip;
    // The contact appears with 2 N, changes by up to 4 N and 0.4 rad every 5 ms, and is removed.
    let plane = |depth: f32, angle: f32| {
        let normal = [angle.cos(), angle.sin(), 0.0];
        let point = core::array::from_fn(|i| tip[i] + normal[i] * depth);
        Some(HostContact { point, normal, stiffness: 1_000.0, damping: 2.0 })
    };
    let planes = [
        plane(2.0e-3, 0.0),
        plane(4.0e-3, 0.0),
        plane(2.0e-3, 0.4),
        plane(-2.0e-3, 0.8),
        plane(2.0e-3, 0.8),
        None,
        None,
    ];
    let mut before = poll(&mut rig).force;
    let mut largest: f32 = 0.0;
    for (sequence, contact) in (1..).zip(planes) {
        rig.control_loop.force(&ForceRequest { contact, ..request(sequence) });
        for _ in 0..10 {
            rig.step();
            let now = poll(&mut rig).force;
            let moved = (now[0] - before[0]).hypot(now[1] - before[1]);
            largest = largest.max(moved);
            before = now;
        }
        if let Some(contact) = contact {
            let depth: f32 = (0..3).map(|i| contact.normal[i] * (contact.point[i] - tip[i])).sum();
            let force = (1_000.0 * depth).max(0.0);
            assert!((before[0].hypot(before[1]) - force).abs() < 2.0e-3, "{before:?}, {contact:?}");
        }
    }
    assert_eq!(before, [0.0; 3]);
    // The first 2 N rise within 1 ms (two steps of this rig), and later changes of at most 4 N take 5 ms.
    assert!(largest <= 1.0 + 1.0e-3, "the force jumps by {largest} N");
}

#[test]
fn a_contact_renewed_while_it_fades_returns_smoothly() {
    let mut rig = armed_rig();
    let tip = poll(&mut rig).tip;
    let contact = |depth: f32| {
        let point = [tip[0] + depth, tip[1], 0.0];
        let contact = HostContact { point, normal: [1.0, 0.0, 0.0], stiffness: 1e3, damping: 0.0 };
        ForceRequest { contact: Some(contact), hold: 0.01, fade: 0.05, ..request(0) }
    };
    // Each request is held for 10 ms and fades for 35 of 50 ms. It is renewed at the same place, then 1 mm further.
    for (sequence, depth) in [(1, 2.0e-3), (2, 2.0e-3), (3, 3.0e-3)] {
        let mut before = poll(&mut rig).force[0];
        rig.control_loop.force(&ForceRequest { sequence, ..contact(depth) });
        for _ in 0..(0.045 * RATE_HZ) as usize {
            rig.step();
            let now = poll(&mut rig).force[0];
            // The force changes by 2 N in 1 ms (two steps of this rig) or by 3 N in 20 ms.
            assert!((now - before).abs() <= 1.0 + 1.0e-3, "{sequence}: the force jumps from {before} to {now} N");
            before = now;
        }
        assert!((before - 0.3 * 1e3 * depth).abs() < 0.1 * 1e3 * depth, "request {sequence}: a force of {before} N");
    }
}

#[test]
fn a_repeated_contact_continues_its_move() {
    let mut rig = armed_rig();
    let tip = poll(&mut rig).tip;
    let plane = |depth: f32| {
        let contact =
            HostContact { point: [tip[0] + depth, tip[1], 0.0], normal: [1.0, 0.0, 0.0], stiffness: 1e3, damping: 0.0 };
        ForceRequest { contact: Some(contact), ..request(0) }
    };
    rig.control_loop.force(&ForceRequest { sequence: 1, ..plane(1.0e-3) });
    rig.run(0.01);
    // The second contact comes 10 ms after the first, so the move takes 10 ms. Repeated requests must not restart it.
    for sequence in 2..22 {
        rig.control_loop.force(&ForceRequest { sequence, ..plane(3.0e-3) });
        rig.step();
    }
    assert!((poll(&mut rig).force[0] - 3.0).abs() < 2.0e-3);
}

#[test]
fn force_requests_count_as_signs_of_life() {
    let watched = Rules { host_action: HostAction::Disarm, host_seconds: 0.1, ..rules() };
    let mut rig = Rig::new(&five_bar(), &scene(2, &[]), hardware(), watched);
    rig.arm();
    for sequence in 1..100 {
        assert_eq!(rig.control_loop.force(&torque_request(sequence, 0.01)).done, ForceDone::Taken);
        rig.run(0.01);
        assert_eq!(rig.state(), State::Armed);
    }
    rig.run(0.11);
    assert_eq!((rig.state(), rig.fault()), (State::Fault, Some(Fault::HostLost)));
}

/// Advances the step count by about `steps`, in parts that are too small to expire anything.
fn skip_steps(rig: &mut Rig, mut steps: u64) {
    while steps > 0 {
        let hop = steps.min(1 << 28) as u32;
        rig.control_loop.skip_steps(hop);
        rig.run(0.001);
        steps -= u64::from(hop);
    }
}

#[test]
fn a_host_can_push_after_the_count_of_steps_wraps() {
    let mut rig = armed_rig();
    let push_now = |rig: &mut Rig, sequence: u32| {
        let seen = poll(rig).step;
        rig.step();
        let answer = rig.control_loop.force(&ForceRequest { seen: Some(seen), ..torque_request(sequence, 0.1) });
        assert_eq!(answer.done, ForceDone::Taken, "not taken at step {}", answer.step);
        rig.run(0.05);
        let late = ForceRequest { seen: Some(seen), ..torque_request(sequence + 1, 0.1) };
        assert_eq!(rig.control_loop.force(&late).done, ForceDone::TooOld, "50 ms is more than the lease of 30 ms");
    };
    push_now(&mut rig, 1);
    // Half of the 32-bit range is 29.8 h at 20 kHz. The count wraps after 59.7 h, and again after another 59.7 h.
    for sequence in [3, 5, 7, 9] {
        let left = (1 << 31) - u64::from(rig.control_loop.steps() & ((1 << 31) - 1));
        skip_steps(&mut rig, left - 1_000);
        push_now(&mut rig, sequence);
        skip_steps(&mut rig, 1_000);
        push_now(&mut rig, sequence + 10);
    }
    assert_eq!(rig.state(), State::Armed);
}

/// A refused request is no sign of life, because a host with only late or wrong requests has lost the device. A poll is
/// a sign of life if it names the step of an earlier reply.
#[test]
fn only_taken_requests_and_following_polls_are_signs_of_life() {
    let watched = Rules { host_action: HostAction::Disarm, host_seconds: 0.5, ..rules() };
    let scene = scene(2, &[]);
    for (refused, why) in [
        (ForceRequest { hold: 0.0, fade: 0.0, ..request(2) }, ForceDone::Looked),
        (torque_request(1, 0.1), ForceDone::NotNewer),
        (torque_request(2, f32::NAN), ForceDone::Bad(BadForce::Torque)),
        (ForceRequest { hold: 0.0, fade: 0.001, seen: Some(0), ..request(2) }, ForceDone::TooOld),
    ] {
        let mut rig = Rig::new(&five_bar(), &scene, hardware(), watched);
        rig.arm();
        for _ in 0..4 {
            assert_eq!(rig.control_loop.force(&force_request(1, 0.0, 0.0)).done, ForceDone::Taken);
            rig.run(0.45);
        }
        assert_eq!(rig.state(), State::Armed, "taken");
        assert_eq!(rig.control_loop.force(&force_request(1, 0.0, 0.0)).done, ForceDone::Taken);
        for _ in 0..6 {
            if why != ForceDone::NotNewer || poll(&mut rig).age.is_some() {
                assert_eq!(rig.control_loop.force(&refused).done, why);
            }
            rig.run(0.09);
        }
        assert_eq!((rig.state(), rig.fault()), (State::Fault, Some(Fault::HostLost)), "{why:?}");
    }
    let mut rig = Rig::new(&five_bar(), &scene, hardware(), watched);
    rig.arm();
    for _ in 0..4 {
        let follows = ForceRequest { hold: 0.0, fade: 0.0, seen: Some(rig.control_loop.steps()), ..request(2) };
        assert_eq!(rig.control_loop.force(&follows).done, ForceDone::Looked);
        rig.run(0.45);
    }
    assert_eq!(rig.state(), State::Armed);
}
