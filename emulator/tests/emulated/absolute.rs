//! Absolute encoders on an ODrive: the release image reads them over the gate drivers' bus, arms without homing, and turns
//! the motors off after three disturbed frames.

use haptic_bridge::safety::fault::{Fault, State};
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
kind = "as5047"
at = "joint"
offset = -2.9
inverted = true

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
fn the_odrive_reads_an_absolute_encoder_and_arms_without_homing() {
    let file = DeviceFile::parse(PADDLE, "gimbal-paddle.toml").expect("a valid file");
    let mut rig = Rig::with_file(BoardKind::OdriveV3, file, |options| {
        options.electrical_zero[0] = 2.0;
        options.start = Some([0.3, 0.0, 0.0]);
        options.substep = 25e-6;
    });
    rig.load("");
    rig.run(2 * MILLISECOND);
    let status = rig.tool.status().expect("the board replies");
    assert!(status.homed && (status.q[0] - 0.3).abs() < 4e-4, "{status:?}");
    rig.check_polarity();
    let start = rig.with_simulated(|device| device.tip());
    let wall = NearWall { stiffness: 400.0, ..NearWall::with_normal([1.0, 0.0, 0.0]) };
    rig.set_scene(&scene("", start, 1, &[wall]));
    rig.arm();
    rig.with_simulated(|device| push(device, [-1.0, 0.0, 0.0], 0.2));
    // The tasks read the gate drivers' registers meanwhile, over the same bus.
    rig.run(SECOND);
    let (tip, torque) = rig.with_simulated(|device| (device.tip(), device.torque()));
    let (depth, force) = (start[0] - 0.003 - tip[0], torque[0] / 0.08);
    assert!((force - 1.0).abs() < 0.06, "{force} N");
    assert!((depth * 400.0 - force).abs() < 0.05, "{depth} m at {force} N");
    let details = rig.tool.details().expect("the board replies");
    assert!((details.delay_samples - 1.04).abs() < 1e-3, "{} samples", details.delay_samples);
    // Every second frame is the one of a valley, whose reply the image does not use.
    for (replies, expected) in [(4, (State::Armed, None)), (6, (State::Fault, Some(Fault::EncoderFrames)))] {
        rig.while_stopped(move |stopped| stopped.hardware().angle_encoder(0).disturb(replies));
        rig.run(10 * MILLISECOND);
        let status = rig.tool.status().expect("the board replies");
        assert_eq!((status.state, status.fault.map(|fault| fault.fault)), expected, "{replies} replies");
    }
    println!("longest crest: {} cycles", details.longest_cycles);
}
