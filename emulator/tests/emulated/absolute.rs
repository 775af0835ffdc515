//! Absolute encoders on an ODrive: the release image reads them over the gate drivers' bus, arms without homing, and turns
//! the motors off after three disturbed frames.

use haptic_bridge::model::description::{ANGLE_COUNTS, AngleChip, AngleSensor, Encoder, EncoderAt};
use haptic_bridge::safety::fault::{Fault, State};
use haptic_emulator::boards::BoardKind;
use haptic_emulator::contact::{NearWall, scene};
use haptic_emulator::hands::push;
use haptic_emulator::rig::{Rig, device_file};
use haptic_emulator::run::{MILLISECOND, SECOND};

#[test]
fn the_odrive_reads_an_absolute_encoder_and_arms_without_homing() {
    let mut file = device_file("gimbal-paddle");
    let joint = &mut file.description.joints[0];
    joint.absolute = Some(AngleSensor { chip: AngleChip::As5047, at: EncoderAt::Joint });
    joint.encoder = Some(Encoder { counts_per_turn: ANGLE_COUNTS.into(), offset: -2.9, inverted: true });
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
    let wall = NearWall { stiffness: 300.0, ..NearWall::with_normal([1.0, 0.0, 0.0]) };
    rig.set_scene(&scene("", start, 1, &[wall]));
    rig.arm();
    rig.with_simulated(|device| push(device, [-0.5, 0.0, 0.0], 0.2));
    // The tasks read the gate drivers' registers meanwhile, over the same bus.
    rig.run(SECOND);
    let (tip, torque) = rig.with_simulated(|device| (device.tip(), device.torque()));
    let (depth, force) = (start[0] - 0.003 - tip[0], torque[0] / 0.08);
    // Friction holds up to 0.025 N.
    assert!((force - 0.5).abs() < 0.04, "{force} N");
    assert!((depth * 300.0 - force).abs() < 0.03, "{depth} m at {force} N");
    let details = rig.tool.details().expect("the board replies");
    // The angle is 27 us old, and the duties apply half a carrier period later.
    assert!((details.delay_samples - 1.04).abs() < 1e-3, "{} samples", details.delay_samples);
    assert_eq!(details.overruns, 0);
    // The image does not use the first of a period's two replies.
    for (replies, expected) in [(4, (State::Armed, None)), (6, (State::Fault, Some(Fault::EncoderFrames)))] {
        rig.while_stopped(move |stopped| stopped.hardware().angle_encoder(0).disturb(replies));
        rig.run(10 * MILLISECOND);
        let status = rig.tool.status().expect("the board replies");
        assert_eq!((status.state, status.fault.map(|fault| fault.fault)), expected, "{replies} replies");
    }
}
