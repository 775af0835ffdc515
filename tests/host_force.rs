//! Force from the host: how long it lives, what is not taken and why, that it shares the limits with the walls, and
//! that contacts move without a step of force.

use crate::rig::statics::{torques, worth};
use crate::rig::{self, RATE, Rig, five_bar, hardware, rules, scene, wall};
use haptic_bridge::board::protocol::{BadForce, ForceAnswer, ForceDone, ForceRequest, HostContact};
use haptic_bridge::control::host_force::{
    MOST_DAMPING, MOST_DISTANCE, MOST_HELD_FORCE, MOST_LEASE, MOST_STIFFNESS, MOST_TORQUE,
};
use haptic_bridge::control::joints::Torques;
use haptic_bridge::control::{Command, HostAction, Rules};
use haptic_bridge::safety::fault::{Fault, State};
use nalgebra::Vector2;

/// Rounding of a torque on its way through a current and back.
const ROUNDING: f32 = 1.0e-5;

/// A five-bar in free space, armed, standing still.
fn armed() -> Rig {
    let mut rig = Rig::with(&five_bar(), &scene(2, &[]), hardware(), rules());
    rig.arm();
    rig
}

fn request(sequence: u32) -> ForceRequest {
    ForceRequest { sequence, hold: 0.01, fade: 0.02, ..ForceRequest::default() }
}

fn torque(sequence: u32, torque: f32) -> ForceRequest {
    ForceRequest { torque: [torque, 0.0, 0.0], ..request(sequence) }
}

fn force(sequence: u32, x: f32, y: f32) -> ForceRequest {
    ForceRequest { force: [x, y, 0.0], hold: MOST_LEASE, ..request(sequence) }
}

/// Asks how the device is.
fn look(rig: &mut Rig) -> ForceAnswer {
    rig.control_loop.force(&ForceRequest::default())
}

#[test]
fn whatever_a_host_asks_for_is_cut_to_the_tips_limit_and_keeps_its_direction() {
    let gentle =
        Rules { limits: haptic_bridge::safety::limits::Limits { tip_force: 1.0, ..rules().limits }, ..rules() };
    let tip = look(&mut armed()).tip;
    // A wall 1 mm deep at the tip that pushes with 0.6 N along x.
    let bilateral = haptic_bridge::render::scene::Wall { bilateral: true, ..wall(tip[0] + 1.0e-3, 600.0) };
    for (walls, push, size) in
        [(&[][..], 0.0, 0.25), (&[], 0.0, 0.02), (&[], 0.7, 0.2), (&[bilateral], 0.0, 0.2), (&[bilateral], 0.5, 0.1)]
    {
        let mut rig = Rig::with(&five_bar(), &scene(2, walls), hardware(), gentle);
        rig.arm();
        let wall = if walls.is_empty() { 0.0 } else { 0.6 };
        for nth in 0..12_u32 {
            let (sin, cos) = (0.5 * nth as f32).sin_cos();
            let both =
                ForceRequest { torque: [size * cos, size * sin, 0.0], ..force(nth + 1, push * sin, -push * cos) };
            assert_eq!(rig.control_loop.force(&both).done, ForceDone::Taken);
            rig.step();
            let answer = look(&mut rig);
            let forces = [wall + push * sin, -push * cos].map(f64::from);
            let asked =
                worth(&answer.q, Vector2::new(both.torque[0], both.torque[1]).map(f64::from)) + Vector2::from(forces);
            let left = worth(&answer.q, Vector2::new(answer.torque[0], answer.torque[1]).map(f64::from));
            let share = (1.0 / asked.norm()).min(1.0);
            assert!((left - asked * share).norm() < 2.0e-3, "{left} of {asked}, {both:?}, {answer:?}");
            assert!((f64::from(answer.share) - share).abs() < 2.0e-3, "{share}: {answer:?}");
        }
    }
}

#[test]
fn a_tips_limit_that_is_lowered_holds_joint_torques_at_the_next_step_and_all_the_while_that_they_fade() {
    let mut rig = armed();
    let request = ForceRequest { hold: 0.02, fade: 0.02, torque: [0.2, -0.1, 0.0], ..request(1) };
    assert_eq!(rig.control_loop.force(&request).done, ForceDone::Taken);
    let force = |rig: &Rig| {
        let frame = rig.control_loop.frame();
        worth(&frame.at.q, Vector2::new(frame.motors.torque[0], frame.motors.torque[1]).map(f64::from)).norm()
    };
    rig.step();
    assert!(force(&rig) > 2.0, "{} N", force(&rig));
    for (nth, limit) in [1.5_f32, 0.5].into_iter().enumerate() {
        let mut lower = rules();
        lower.limits.tip_force = limit;
        rig.execute(Command::Rules(lower)).expect("lowered while armed");
        rig.step();
        assert!((force(&rig) - f64::from(limit)).abs() < 1.0e-3, "{nth}: {} N", force(&rig));
    }
    let mut before = force(&rig);
    for _ in 0..80 {
        rig.step();
        assert!(force(&rig) <= before + 1.0e-4, "{before} N to {} N", force(&rig));
        before = force(&rig);
    }
    assert_eq!(before, 0.0);
}

#[test]
fn a_request_is_held_then_fades_evenly_and_is_gone() {
    let mut rig = armed();
    assert_eq!(rig.control_loop.force(&torque(1, 0.2)).done, ForceDone::Taken);
    let period = 1.0 / RATE;
    let mut before = None;
    for step in 1..=80 {
        rig.step();
        let age = step as f32 * period;
        let share = ((0.03 - age) / 0.02).clamp(0.0, 1.0);
        let now = rig.control_loop.frame().motors.torque[0];
        // A step's period is rounded, and ages are sums of periods.
        assert!((now - 0.2 * share).abs() < 0.2 * 1.0e-3, "{now} at {age} s");
        let most = 0.2 * period / 0.02 * 1.001;
        assert!(before.is_none_or(|before: f32| (now - before).abs() < most), "{before:?} to {now} at {age} s");
        before = Some(now);
        let answer = look(&mut rig);
        assert!((answer.share - share).abs() < 1.0e-3);
        // At the very end rounding decides.
        let ending = (age - 0.03).abs() < 0.5 * period;
        assert!(ending || answer.age.is_some() == (age < 0.03), "{age} s: {answer:?}");
    }
    assert_eq!(rig.control_loop.frame().motors.torque, Torques::default());
    assert_eq!(rig.state(), State::Armed);
}

#[test]
fn what_comes_late_has_only_the_rest_of_its_life() {
    let mut rig = armed();
    let seen = look(&mut rig).step;
    rig.run(0.02);
    // 20 ms old of 30, half of it faded.
    let half = ForceRequest { seen: Some(seen), ..torque(1, 0.2) };
    assert_eq!(rig.control_loop.force(&half).done, ForceDone::Taken);
    rig.step();
    let now = rig.control_loop.frame().motors.torque[0];
    let share = (0.03 - 0.02 - 1.0 / RATE) / 0.02;
    assert!((now - 0.2 * share).abs() < 1.0e-4, "{now}");
    rig.run(0.02);
    let answer = rig.control_loop.force(&ForceRequest { sequence: 2, ..half });
    assert_eq!((answer.done, answer.age), (ForceDone::TooOld, None));
    rig.step();
    assert_eq!(rig.control_loop.frame().motors.torque, Torques::default());
    let future = ForceRequest { seen: Some(answer.step + 10), ..torque(3, 0.2) };
    assert_eq!(rig.control_loop.force(&future).done, ForceDone::Bad(BadForce::Seen));
}

#[test]
fn repeated_and_reordered_requests_change_nothing() {
    let mut rig = armed();
    assert_eq!(rig.control_loop.force(&torque(u32::MAX, 0.1)).done, ForceDone::Taken);
    for old in [u32::MAX, u32::MAX - 1, u32::MAX / 2 + 10] {
        let answer = rig.control_loop.force(&torque(old, 0.2));
        assert_eq!((answer.sequence, answer.done), (old, ForceDone::NotNewer));
        rig.step();
        assert!((rig.control_loop.frame().motors.torque[0] - 0.1).abs() < ROUNDING);
    }
    // It wraps.
    assert_eq!(rig.control_loop.force(&torque(0, 0.2)).done, ForceDone::Taken);
    rig.step();
    assert!((rig.control_loop.frame().motors.torque[0] - 0.2).abs() < ROUNDING);
    // Another program counts as it likes, once the last request of this one is gone.
    rig.run(0.05);
    assert_eq!(rig.control_loop.force(&torque(u32::MAX - 7, 0.1)).done, ForceDone::Taken);
}

#[test]
fn lost_requests_are_bridged_for_as_long_as_the_last_one_is_held() {
    let mut rig = armed();
    let mut sequence = 0;
    for millisecond in 0..100 {
        // At 1 kHz, seven of every eight lost: 8 ms between two, which are held for 10.
        if millisecond % 8 == 0 {
            sequence += 1;
            assert_eq!(rig.control_loop.force(&torque(sequence, 0.1)).done, ForceDone::Taken);
        }
        rig.step();
        rig.step();
        let now = rig.control_loop.frame().motors.torque[0];
        assert!((now - 0.1).abs() < ROUNDING, "{now} after {millisecond} ms");
    }
}

#[test]
fn no_absurd_number_is_taken_and_none_disturbs_what_acts() {
    let contact = HostContact { point: [0.0; 3], normal: [0.6, 0.8, 0.0], stiffness: 100.0, damping: 1.0 };
    let with = |contact: HostContact| ForceRequest { contact: Some(contact), ..request(2) };
    let mut bad: Vec<(BadForce, ForceRequest)> = Vec::new();
    let wild = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX];
    let above = |most: f32| wild.into_iter().chain([most * 1.000_01, -most * 1.000_01]);
    for value in above(MOST_HELD_FORCE) {
        bad.push((BadForce::Force, force(2, value, 0.0)));
        bad.push((BadForce::Force, force(2, 0.0, value)));
    }
    // A plane device has no third direction and no third joint.
    bad.push((BadForce::Force, ForceRequest { force: [0.0, 0.0, 1.0], ..request(2) }));
    bad.push((BadForce::Torque, ForceRequest { torque: [0.0, 0.0, 0.1], ..request(2) }));
    bad.push((BadForce::Normal, with(HostContact { normal: [0.0, 0.0, 1.0], ..contact })));
    for value in above(MOST_TORQUE) {
        bad.push((BadForce::Torque, torque(2, value)));
    }
    for value in above(MOST_LEASE).chain([-0.01]) {
        bad.push((BadForce::Lease, ForceRequest { hold: value, ..request(2) }));
        bad.push((BadForce::Lease, ForceRequest { fade: value, ..request(2) }));
    }
    for value in above(MOST_DISTANCE) {
        bad.push((BadForce::Point, with(HostContact { point: [0.0, value, 0.0], ..contact })));
    }
    for value in above(1.1).chain([0.0]) {
        bad.push((BadForce::Normal, with(HostContact { normal: [value, 0.0, 0.0], ..contact })));
    }
    for value in above(MOST_STIFFNESS).chain([-1.0]) {
        bad.push((BadForce::Gains, with(HostContact { stiffness: value, ..contact })));
    }
    for value in above(MOST_DAMPING).chain([-1.0]) {
        bad.push((BadForce::Gains, with(HostContact { damping: value, ..contact })));
    }
    for (what, request) in bad {
        let mut rig = armed();
        assert_eq!(rig.control_loop.force(&torque(1, 0.1)).done, ForceDone::Taken);
        let answer = rig.control_loop.force(&request);
        assert_eq!(answer.done, ForceDone::Bad(what), "{request:?}");
        assert!(answer.done.to_string().contains("not taken"), "{}", answer.done);
        rig.step();
        assert!((rig.control_loop.frame().motors.torque[0] - 0.1).abs() < ROUNDING, "{request:?}");
    }
}

#[test]
fn the_largest_numbers_that_are_taken_are_harmless() {
    let mut rig = armed();
    let answer = rig.control_loop.force(&ForceRequest {
        contact: Some(HostContact {
            point: [MOST_DISTANCE, 0.0, 0.0],
            normal: [1.0, 0.0, 0.0],
            stiffness: MOST_STIFFNESS,
            damping: MOST_DAMPING,
        }),
        torque: [MOST_TORQUE, -MOST_TORQUE, 0.0],
        ..force(1, MOST_HELD_FORCE, -MOST_HELD_FORCE)
    });
    assert_eq!(answer.done, ForceDone::Taken);
    for _ in 0..100 {
        rig.step();
        assert!(rig.control_loop.frame().motors.torque.iter().all(|torque| torque.abs() <= 0.3 * (1.0 + ROUNDING)));
    }
    assert_eq!(rig.state(), State::Armed);
}

#[test]
fn only_armed_motors_take_force_and_disarming_or_a_fault_forgets_it() {
    let mut rig = Rig::with(&five_bar(), &scene(2, &[]), hardware(), rules());
    let answer = rig.control_loop.force(&torque(1, 0.1));
    assert_eq!((answer.done, answer.state), (ForceDone::NotArmed, State::Disarmed));
    assert_eq!(look(&mut rig).done, ForceDone::Looked);
    assert_eq!(answer.tip, rig.control_loop.status().tip, "how the device is, it tells all the same");
    for by_fault in [false, true] {
        rig.arm();
        assert_eq!(rig.control_loop.force(&force(1, 1.0, 0.0)).done, ForceDone::Taken);
        rig.step();
        assert_ne!(rig.control_loop.frame().motors.torque, Torques::default());
        if by_fault {
            rig.control_loop.trip(Fault::GateDriver, None, 0.0);
        } else {
            rig.execute(Command::Disarm).unwrap();
        }
        let answer = look(&mut rig);
        assert_eq!((answer.age, answer.force, answer.share), (None, [0.0; 3], 0.0));
        rig.step();
        assert!(rig.motors_off());
        // Armed at once, well within what the request had left to live.
        rig.execute(Command::Clear).unwrap();
        rig.execute(Command::Arm).unwrap();
        for _ in 0..20 {
            rig.step();
            assert_eq!(rig.control_loop.frame().motors.torque, Torques::default());
        }
        rig.execute(Command::Disarm).unwrap();
    }
}

#[test]
fn a_force_grows_with_the_ramp_after_arming() {
    let mut rig = Rig::with(&five_bar(), &scene(2, &[]), hardware(), rules());
    rig.execute(Command::Arm).unwrap();
    assert_eq!(rig.control_loop.force(&force(1, 1.0, 0.0)).done, ForceDone::Taken);
    // A fifth of half a second.
    rig.run(0.1);
    let answer = look(&mut rig);
    assert!((answer.share - 0.2).abs() < 0.01, "{answer:?}");
    assert!((answer.force[0] - answer.share).abs() < 1.0e-6);
}

#[test]
fn a_force_at_the_tip_is_the_torque_of_virtual_work() {
    for (x, y) in [(1.0, 0.0), (0.0, 1.0), (-0.7, 0.4)] {
        let mut rig = armed();
        rig.control_loop.force(&force(1, x, y));
        rig.step();
        let answer = look(&mut rig);
        let expected = torques(&answer.q, [x, y].map(f64::from));
        for i in 0..2 {
            assert!((f64::from(answer.torque[i]) - expected[i]).abs() < 1.0e-6, "{answer:?}, {expected}");
        }
        assert_eq!((answer.force, answer.share), ([x, y, 0.0], 1.0));
    }
}

#[test]
fn what_the_motors_cannot_make_walls_and_host_give_up_in_the_same_share() {
    // A wall 1 mm deep at the tip, facing +x, that also pulls: 2 N. The host asks for 12 N across.
    let mut rig = armed();
    let tip = look(&mut rig).tip;
    let bilateral = haptic_bridge::render::scene::Wall { bilateral: true, ..wall(tip[0] + 1.0e-3, 2_000.0) };
    let mut rig = Rig::with(&five_bar(), &scene(2, &[bilateral]), hardware(), rules());
    rig.arm();
    rig.control_loop.force(&force(1, 0.0, 12.0));
    rig.step();
    let answer = look(&mut rig);
    assert!((rig.control_loop.frame().at.walls.wall_force - 2.0).abs() < 1.0e-3);
    let asked = torques(&answer.q, [2.0, 12.0]);
    let share = 0.3 / asked.amax();
    assert!(share < 0.9, "they ask for more than 0.3 N m: {asked}");
    for i in 0..2 {
        let left = f64::from(answer.torque[i]);
        assert!((left - share * asked[i]).abs() < 1.0e-4, "{left} of {asked}, share {share}");
    }
    assert!((f64::from(answer.share) - share).abs() < 1.0e-3);
    assert!((f64::from(answer.force[1]) - 12.0 * share).abs() < 1.0e-2);
}

#[test]
fn the_answer_tells_how_tip_and_joints_move() {
    let mut rig = armed();
    let counts = (rig::COUNTS / core::f64::consts::TAU / f64::from(RATE)).round() as i32;
    let mut turn = |steps: u32| {
        for _ in 0..steps {
            rig.samples.counts[0] += counts;
            rig.step();
        }
        look(&mut rig)
    };
    // At 1 rad/s, long enough for the filters to have caught up.
    let (before, now) = (turn(200), turn(5));
    assert_eq!(now.step, before.step + 5);
    let passed = (now.step - before.step) as f32 * now.period;
    for i in 0..2 {
        let moved = (now.tip[i] - before.tip[i]) / passed;
        assert!((now.velocity[i] - moved).abs() < 0.02 * moved.abs().max(0.02), "{now:?} {moved}");
        let turned = (now.q[i] - before.q[i]) / passed;
        assert!((now.qd[i] - turned).abs() < 0.02, "{now:?} {turned}");
    }
}

#[test]
fn a_contact_pushes_as_its_plane_says_and_never_pulls() {
    let mut rig = armed();
    let tip = look(&mut rig).tip;
    let normal = [0.6, 0.8, 0.0];
    let at = |depth: f32| core::array::from_fn(|i| tip[i] + normal[i] * depth);
    for (sequence, depth, expected) in [(1, 1.0e-3, 1.5), (2, -1.0e-3, 0.0)] {
        let contact = HostContact { point: at(depth), normal, stiffness: 1_500.0, damping: 3.0 };
        let request = ForceRequest { contact: Some(contact), hold: MOST_LEASE, ..request(sequence) };
        assert_eq!(rig.control_loop.force(&request).done, ForceDone::Taken);
        rig.run(0.05);
        let answer = look(&mut rig);
        for (force, normal) in answer.force.iter().zip(&normal) {
            assert!((force - expected * normal).abs() < 1.0e-3, "{answer:?}");
        }
    }
}

#[test]
fn a_contact_that_jumps_tilts_appears_or_goes_makes_no_step_of_force() {
    let mut rig = armed();
    let tip = look(&mut rig).tip;
    // From nothing to 2 N, then by 2 N and 0.4 rad each 5 ms, at last away.
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
    let mut before = look(&mut rig).force;
    let mut largest: f32 = 0.0;
    for (sequence, contact) in (1..).zip(planes) {
        rig.control_loop.force(&ForceRequest { contact, ..request(sequence) });
        for _ in 0..10 {
            rig.step();
            let now = look(&mut rig).force;
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
    // The first takes 1 ms for its 2 N, two steps of this rig; the others 5 ms for at most 4 N.
    assert!(largest <= 1.0 + 1.0e-3, "a step of {largest} N");
}

#[test]
fn a_contact_that_is_renewed_while_it_fades_comes_back_without_a_step_of_force() {
    let mut rig = armed();
    let tip = look(&mut rig).tip;
    let contact = |depth: f32| {
        let point = [tip[0] + depth, tip[1], 0.0];
        let contact = HostContact { point, normal: [1.0, 0.0, 0.0], stiffness: 1e3, damping: 0.0 };
        ForceRequest { contact: Some(contact), hold: 0.01, fade: 0.05, ..request(0) }
    };
    // Held for 10 ms, then for 35 of 50 ms on its way to nothing; renewed where it is and a millimetre further.
    for (sequence, depth) in [(1, 2.0e-3), (2, 2.0e-3), (3, 3.0e-3)] {
        let mut before = look(&mut rig).force[0];
        rig.control_loop.force(&ForceRequest { sequence, ..contact(depth) });
        for _ in 0..(0.045 * RATE) as usize {
            rig.step();
            let now = look(&mut rig).force[0];
            // 2 N in 1 ms, two steps of this rig, or 3 N in 20.
            assert!((now - before).abs() <= 1.0 + 1.0e-3, "{sequence}: from {before} to {now} N");
            before = now;
        }
        assert!((before - 0.3 * 1e3 * depth).abs() < 0.1 * 1e3 * depth, "{sequence}: {before} N");
    }
}

#[test]
fn a_contact_that_is_sent_again_as_it_is_goes_on_moving_to_where_it_was_going() {
    let mut rig = armed();
    let tip = look(&mut rig).tip;
    let plane = |depth: f32| {
        let contact =
            HostContact { point: [tip[0] + depth, tip[1], 0.0], normal: [1.0, 0.0, 0.0], stiffness: 1e3, damping: 0.0 };
        ForceRequest { contact: Some(contact), ..request(0) }
    };
    rig.control_loop.force(&ForceRequest { sequence: 1, ..plane(1.0e-3) });
    rig.run(0.01);
    // 10 ms since the first, so 10 ms to the second, whatever is sent meanwhile.
    for sequence in 2..22 {
        rig.control_loop.force(&ForceRequest { sequence, ..plane(3.0e-3) });
        rig.step();
    }
    assert!((look(&mut rig).force[0] - 3.0).abs() < 2.0e-3);
}

#[test]
fn forces_tell_that_the_host_is_there_and_their_end_that_it_is_not() {
    let watched = Rules { host_action: HostAction::Disarm, host_seconds: 0.1, ..rules() };
    let mut rig = Rig::with(&five_bar(), &scene(2, &[]), hardware(), watched);
    rig.arm();
    for sequence in 1..100 {
        assert_eq!(rig.control_loop.force(&torque(sequence, 0.01)).done, ForceDone::Taken);
        rig.run(0.01);
        assert_eq!(rig.state(), State::Armed);
    }
    rig.run(0.11);
    assert_eq!((rig.state(), rig.fault()), (State::Fault, Some(Fault::HostLost)));
}

/// Lets about so many control steps pass, in hops far below what the board itself looks at again.
fn let_pass(rig: &mut Rig, mut steps: u64) {
    while steps > 0 {
        let hop = steps.min(1 << 28) as u32;
        rig.control_loop.skip_steps(hop);
        rig.run(0.001);
        steps -= u64::from(hop);
    }
}

#[test]
fn a_host_pushes_on_however_long_the_rate_has_been_the_same() {
    let mut rig = armed();
    let push_now = |rig: &mut Rig, sequence: u32| {
        let seen = look(rig).step;
        rig.step();
        let answer = rig.control_loop.force(&ForceRequest { seen: Some(seen), ..torque(sequence, 0.1) });
        assert_eq!(answer.done, ForceDone::Taken, "at step {}, of one before", answer.step);
        rig.run(0.05);
        let late = ForceRequest { seen: Some(seen), ..torque(sequence + 1, 0.1) };
        assert_eq!(rig.control_loop.force(&late).done, ForceDone::TooOld, "50 ms where 30 are its life");
    };
    push_now(&mut rig, 1);
    // 29.8 h at 20 kHz, then 59.7 h, where the count of steps begins again, and as much once more.
    for sequence in [3, 5, 7, 9] {
        let left = (1 << 31) - u64::from(rig.control_loop.steps() & ((1 << 31) - 1));
        let_pass(&mut rig, left - 1_000);
        push_now(&mut rig, sequence);
        let_pass(&mut rig, 1_000);
        push_now(&mut rig, sequence + 10);
    }
    assert_eq!(rig.state(), State::Armed);
}

/// A refused request steers nothing: a program whose every request comes too late, or is wrong, has lost the device.
/// One that only looks is counted as present if it names the state that it saw before.
#[test]
fn a_request_that_is_taken_and_a_look_that_follows_another_tell_the_board_that_its_host_is_there() {
    let watched = Rules { host_action: HostAction::Disarm, host_seconds: 0.5, ..rules() };
    let scene = scene(2, &[]);
    for (refused, why) in [
        (ForceRequest { hold: 0.0, fade: 0.0, ..request(2) }, ForceDone::Looked),
        (torque(1, 0.1), ForceDone::NotNewer),
        (torque(2, f32::NAN), ForceDone::Bad(BadForce::Torque)),
        (ForceRequest { hold: 0.0, fade: 0.001, seen: Some(0), ..request(2) }, ForceDone::TooOld),
    ] {
        let mut rig = Rig::with(&five_bar(), &scene, hardware(), watched);
        rig.arm();
        for _ in 0..4 {
            assert_eq!(rig.control_loop.force(&force(1, 0.0, 0.0)).done, ForceDone::Taken);
            rig.run(0.45);
        }
        assert_eq!(rig.state(), State::Armed, "taken");
        assert_eq!(rig.control_loop.force(&force(1, 0.0, 0.0)).done, ForceDone::Taken);
        for _ in 0..6 {
            if why != ForceDone::NotNewer || look(&mut rig).age.is_some() {
                assert_eq!(rig.control_loop.force(&refused).done, why);
            }
            rig.run(0.09);
        }
        assert_eq!((rig.state(), rig.fault()), (State::Fault, Some(Fault::HostLost)), "{why:?}");
    }
    let mut rig = Rig::with(&five_bar(), &scene, hardware(), watched);
    rig.arm();
    for _ in 0..4 {
        let follows = ForceRequest { hold: 0.0, fade: 0.0, seen: Some(rig.control_loop.steps()), ..request(2) };
        assert_eq!(rig.control_loop.force(&follows).done, ForceDone::Looked);
        rig.run(0.45);
    }
    assert_eq!(rig.state(), State::Armed);
}
