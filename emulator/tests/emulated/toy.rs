//! The firmware runs on a board that is not shipped: `toy_board.rs`, with the wiring in this file.

use haptic_emulator::boards::{EncoderWires, HalfBridge, MotorWires, Pin, Wiring};
use haptic_emulator::contact::NearWall;
use haptic_emulator::rig::Rig;

static TOY: Wiring = Wiring {
    name: "toy-board",
    encoders: &[EncoderWires { timer: 4, pins: [Pin('B', 6), Pin('B', 7)], function: 2, index: Some(Pin('C', 9)) }],
    motors: &[MotorWires {
        timer: 1,
        ends: [HalfBridge::Channel(1), HalfBridge::Complement(1)],
        gates: [Pin('A', 8), Pin('B', 13), Pin('A', 8), Pin('B', 13)],
        third: None,
        function: 1,
        sensors: &[(10, 0.2)],
    }],
    enable: Pin('C', 6),
    power_pins: &[Pin('A', 8), Pin('B', 13), Pin('C', 6)],
    brakes_when_idle: true,
    fault: Pin('B', 12),
    fault_is_break_input: false,
    bus: (13, 11.0),
    pins_held_high: &[],
    supply_mv: 3300,
    driver_selects: &[],
    encoder_selects: &[],
    bus_voltage: 24.0,
    sensor_offsets: [0.0; 4],
    dead_time: 0.0,
};

#[test]
fn a_toy_board_is_one_file_and_renders_a_wall() {
    let wall = NearWall { feed_forward: "off", ..NearWall::with_normal([-1.0, 0.0, 0.0]) };
    let pressed = 2.0;
    let mut rig = Rig::in_contact(&TOY, "hapkit-paddle", "", &[wall], pressed);
    assert_eq!(rig.tool.info().board.as_str(), TOY.name);
    assert_eq!(rig.tool.details().expect("the board replies").axes, 1);
    assert_eq!(rig.tool.status().expect("the board replies").fault, None);
    // The motor's force at the tip equals the hand's force, except for dry friction of 4 mN m at 70 mm.
    let motor = rig.file.as_ref().and_then(|file| file.description.joints[0].motor).expect("a motor");
    let force = rig.with_simulated(|device| device.currents()[0]) * motor.torque_constant / 0.07;
    assert!((force.abs() - pressed).abs() < 0.06, "the motor holds {force} N");
}
