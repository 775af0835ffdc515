//! Sequences of valid requests that once had dangerous effects, on the complete service or on the control loop.

use crate::rig::board::Board;
use crate::rig::{self, Rig, at_rate, five_bar, hardware, rules, scene};
use haptic_bridge::board::protocol::*;
use haptic_bridge::board::settings::{self, Key};
use haptic_bridge::control::{Command, Rules};
use haptic_bridge::render::scene::{Posture, Scene};
use haptic_bridge::safety::fault::Fault;
use haptic_bridge::safety::limits::Limits;

fn stage<S: settings::Setting>(board: &mut Board, value: &S) {
    let entry = settings::encode(value).unwrap();
    board.ask::<StageEntry>(&WriteEntry { session: 1, key: S::KEY, entry }).unwrap().unwrap();
}
fn commit(board: &mut Board, keys: &[Key]) {
    board.ask::<CommitEntries>(&Commit { session: 1, keys: keys.iter().copied().collect() }).unwrap().unwrap();
}
fn restart(board: &mut Board) -> Board {
    Board::with_flash(false, core::mem::take(&mut board.machine.flash.committed))
}

#[test]
fn limits_restored_alone_do_not_move_to_another_device() {
    let mut board = Board::with_device(false, &rig::device(&five_bar()), &scene(2, &[]));
    board
        .ask::<SetRules>(&Rules {
            limits: Limits { torque: [0.1; 3], tip_force: 5.0, ..Limits::default() },
            ..Rules::default()
        })
        .unwrap()
        .unwrap();
    board.ask::<Save>(&()).unwrap().unwrap();
    // Loads another device without saving it, and sends limits for that device.
    board
        .ask::<SetDevice>(&haptic_bridge::model::device::Device::new("strong", &rig::paddle()).unwrap())
        .unwrap()
        .unwrap();
    stage(
        &mut board,
        &Rules { limits: Limits { torque: [4.9; 3], tip_force: 100.0, ..Limits::default() }, ..Rules::default() },
    );
    commit(&mut board, &[Key::Rules]);
    let name = |board: &Board| board.service.device().map(|device| device.name.clone());
    let before = (name(&board), board.service.rules().limits.torque[0]);
    let after = restart(&mut board);
    assert_eq!((name(&after), after.service.rules().limits.torque[0]), before);
}

/// Creates an armed five-bar in free space, with a control rate in Hz and a tip-force limit in N.
fn armed_rig(rate: f32, tip_force: f32) -> Rig {
    let mut rules = rules();
    rules.limits.tip_force = tip_force;
    let mut rig = Rig::new(&five_bar(), &at_rate(rate, scene(2, &[])), hardware(), rules);
    rig.arm();
    rig
}

/// Returns a request for a contact with a plane that faces +x. The tip is `depth` m inside the plane.
fn contact_request(rig: &Rig, sequence: u32, depth: f32, stiffness: f32, [hold, fade]: [f32; 2]) -> ForceRequest {
    let tip = rig.control_loop.status().tip;
    let point = [tip[0] + depth, tip[1], 0.0];
    let contact = Some(HostContact { point, normal: [1.0, 0.0, 0.0], stiffness, damping: 0.0 });
    ForceRequest { sequence, contact, hold, fade, ..ForceRequest::default() }
}

/// Returns the host's force along x, N.
fn force_x(rig: &mut Rig) -> f32 {
    rig.control_loop.force(&ForceRequest::default()).force[0]
}

#[test]
fn a_contact_renewed_twice_between_two_steps_returns_smoothly() {
    let mut rig = armed_rig(5_000.0, 1.0e3);
    let renewed = contact_request(&rig, 1, 4.0e-3, 1e3, [0.01, 0.05]);
    rig.control_loop.force(&renewed);
    rig.run(0.03);
    let before = force_x(&mut rig);
    rig.control_loop.force(&ForceRequest { sequence: 2, ..renewed });
    rig.control_loop.force(&ForceRequest { sequence: 3, ..renewed });
    rig.step();
    let now = force_x(&mut rig);
    assert!(now >= before && now - before <= 0.4, "the force jumps from {before} to {now} N");
}

#[test]
fn a_contact_sent_again_while_its_lease_fades_moves_evenly() {
    let mut rig = armed_rig(20_000.0, 1.0e3);
    let first = contact_request(&rig, 1, 1.0e-3, 1e3, [0.0, 0.2]);
    let second = contact_request(&rig, 2, 5.0e-3, 1e3, [0.0, 0.2]);
    rig.control_loop.force(&first);
    rig.run(0.01);
    // The 4 N are spread over 10 ms, the time since the last request: 0.02 N per step.
    let (mut before, mut largest_jump) = (force_x(&mut rig), 0.0_f32);
    for step in 0..200 {
        if step % 10 == 0 {
            rig.control_loop.force(&ForceRequest { sequence: 2 + step, ..second });
        }
        rig.step();
        let now = force_x(&mut rig);
        largest_jump = largest_jump.max((now - before).abs());
        before = now;
    }
    assert!(largest_jump < 0.03, "the force jumps by {largest_jump} N");
}

#[test]
fn a_late_renewal_causes_no_jump_of_a_contact_force() {
    let mut rig = armed_rig(20_000.0, 1.0e3);
    let request = contact_request(&rig, 1, 4.0e-3, 1e3, [0.01, 0.05]);
    rig.control_loop.force(&request);
    rig.run(0.005);
    let before = force_x(&mut rig);
    let seen = Some(rig.control_loop.steps().wrapping_sub(1_000));
    assert_eq!(rig.control_loop.force(&ForceRequest { sequence: 2, seen, ..request }).done, ForceDone::Taken);
    rig.step();
    let now = force_x(&mut rig);
    assert!((now - before).abs() < 0.3, "the force jumps from {before} to {now} N in 50 us");
}

#[test]
fn a_contact_between_two_planes_pushes_no_more_than_either() {
    let mut rig = armed_rig(20_000.0, 5.0);
    // The tip is 1 mm outside a stiff plane (0 N), then 100 mm inside a soft plane (1 N).
    let stiff = contact_request(&rig, 1, -1.0e-3, 1.0e4, [0.1, 0.1]);
    let soft = contact_request(&rig, 2, 0.1, 10.0, [0.1, 0.1]);
    rig.control_loop.force(&stiff);
    rig.run(0.02);
    rig.control_loop.force(&soft);
    for step in 0..600 {
        rig.step();
        let now = force_x(&mut rig);
        assert!(now <= 1.05, "a force of {now} N at step {step}");
    }
}

#[test]
fn the_age_of_a_force_is_right_after_a_change_of_rate() {
    let mut rig = armed_rig(200.0, 1.0e3);
    let seen = rig.control_loop.steps();
    rig.run(1.0);
    rig.execute(Command::Disarm).unwrap();
    rig.load(&five_bar(), &at_rate(20_000.0, scene(2, &[])), true).unwrap();
    rig.run(0.001);
    rig.execute(Command::Arm).unwrap();
    let request = ForceRequest {
        sequence: 1,
        seen: Some(seen),
        hold: 0.02,
        fade: 0.02,
        force: [1.0, 0.0, 0.0],
        ..ForceRequest::default()
    };
    let answer = rig.control_loop.force(&request);
    assert_eq!(answer.done, ForceDone::TooOld, "the force is one second old, but its age is {:?} s", answer.age);
}

#[test]
fn a_device_loads_although_the_present_scene_does_not_fit_it() {
    use haptic_bridge::model::catalogue::{Kind, MAX_GEOMETRY};
    use haptic_bridge::model::description::Description;
    let mut geometry = [0.0; MAX_GEOMETRY];
    geometry[..3].copy_from_slice(&[0.1, 0.1, 0.05]);
    let joints = [five_bar().joints[0]; 3];
    let arm = Description { kind: Kind::Serial3r, geometry, joints, home: Some([0.3, 0.6, 0.5]), ..five_bar() };
    let posture = Some(Posture { orientation: 0.5, stiffness: 0.1, damping: 0.0 });
    let mut board = Board::with_device(false, &rig::device(&arm), &Scene { posture, ..scene(2, &[]) });
    assert_eq!(board.ask::<SetDevice>(&rig::device(&five_bar())).unwrap(), Ok(()));
}

#[test]
fn a_fault_is_published_although_a_save_precedes_the_next_poll() {
    let mut board = Board::with_device(false, &rig::device(&five_bar()), &scene(2, &[]));
    board.reported_fault = Some((Fault::GateDriver, None, 1.0));
    board.tick();
    board.ask::<Save>(&()).unwrap().unwrap();
    assert!(board.service.poll(&mut board.machine).is_some());
}
