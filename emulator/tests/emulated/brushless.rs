//! A three-phase motor on an ODrive: the release image aligns it in its polarity check and renders a wall with it.

use haptic_bridge::safety::fault::State;
use haptic_emulator::boards::BoardKind;
use haptic_emulator::contact::{NearWall, scene};
use haptic_emulator::hands::push;
use haptic_emulator::rig::Rig;
use haptic_emulator::run::{MILLISECOND, SECOND};

#[test]
fn the_odrive_aligns_a_three_phase_motor_and_renders_a_wall() {
    let mut rig = Rig::with_device(BoardKind::OdriveV3, "gimbal-paddle", |options| {
        options.electrical_zero[0] = 2.0;
        options.substep = 25e-6;
    });
    rig.load("");
    rig.tool.home().expect("the device can be homed");
    rig.check_polarity();
    let start = rig.with_simulated(|device| device.tip());
    let wall = NearWall { stiffness: 300.0, ..NearWall::with_normal([1.0, 0.0, 0.0]) };
    rig.set_scene(&scene("", start, 1, &[wall]));
    rig.arm();
    rig.with_simulated(|device| push(device, [-0.5, 0.0, 0.0], 0.2));
    rig.run(SECOND);
    let (tip, torque) = rig.with_simulated(|device| (device.tip(), device.torque()));
    let (depth, force) = (start[0] - 0.003 - tip[0], torque[0] / 0.08);
    // Friction holds up to 0.025 N.
    assert!((force - 0.5).abs() < 0.04, "{force} N");
    assert!((depth * 300.0 - force).abs() < 0.03, "{depth} m at {force} N");
    rig.run(100 * MILLISECOND);
    assert_eq!(rig.tool.status().expect("the board replies").state, State::Armed);
}
