//! A three-phase motor on an ODrive: the release image aligns it in its polarity check and renders a wall with it.

use haptic_bridge::safety::fault::State;
use haptic_emulator::boards::BoardKind;
use haptic_emulator::contact::{NearWall, scene};
use haptic_emulator::hands::push;
use haptic_emulator::rig::Rig;
use haptic_emulator::run::{MILLISECOND, SECOND};
use haptic_host::device_file::DeviceFile;

const PADDLE: &str = r#"
name = "gimbal-paddle"
mechanism = "paddle"
gravity = [0.0, 0.0]

[geometry]
length = 0.08

[[joint]]
inertia = 6.0e-5
viscous = 0.0002
coulomb = 0.003
limits = [-0.8, 0.8]
transmission = "rigid"

[joint.encoder]
counts_per_turn = 16384

[joint.motor]
kind = "brushless"
pole_pairs = 7
torque_constant = 0.0827
resistance = 5.0
inductance = 0.002
max_current = 1.5
verified = true

[home]
q = [0.0]
"#;

#[test]
fn the_odrive_aligns_a_three_phase_motor_and_renders_a_wall() {
    let file = DeviceFile::parse(PADDLE, "gimbal-paddle.toml").expect("a valid file");
    let mut rig = Rig::with_file(BoardKind::OdriveV3, file, |options| {
        options.electrical_zero[0] = 2.0;
        options.substep = 25e-6;
    });
    rig.load("");
    rig.tool.home().expect("the device can be homed");
    rig.check_polarity();
    let start = rig.with_simulated(|device| device.tip());
    let wall = NearWall { stiffness: 400.0, ..NearWall::with_normal([1.0, 0.0, 0.0]) };
    rig.set_scene(&scene("", start, 1, &[wall]));
    rig.arm();
    rig.with_simulated(|device| push(device, [-1.0, 0.0, 0.0], 0.2));
    rig.run(SECOND);
    let (tip, torque) = rig.with_simulated(|device| (device.tip(), device.torque()));
    let (depth, force) = (start[0] - 0.003 - tip[0], torque[0] / 0.08);
    // Friction holds up to 0.04 N.
    assert!((force - 1.0).abs() < 0.06, "{force} N");
    assert!((depth * 400.0 - force).abs() < 0.05, "{depth} m at {force} N");
    rig.run(100 * MILLISECOND);
    assert_eq!(rig.tool.status().expect("the board replies").state, State::Armed);
}
