//! The pins of every encoder, motor and sensor of every board, tested one at a time.

use std::f64::consts::TAU;
use std::fs::read_to_string;
use std::path::Path;
use std::time::Duration;

use haptic_bridge::board::telemetry::{Field, Fields};
use haptic_bridge::model::description::{Description, Encoder};
use haptic_bridge::model::device::Device;
use haptic_bridge::safety::fault::Fault;
use haptic_bridge::safety::refusal::Refusal;
use haptic_emulator::boards::{BoardKind, Pin, Wiring};
use haptic_emulator::plant::Dummy;
use haptic_emulator::rig::{Rig, device_file};
use haptic_emulator::run::MILLISECOND;
use haptic_host::link::BoardError;

use crate::session::WALL;

fn device_of(kind: BoardKind) -> &'static str {
    match kind {
        BoardKind::OdriveV3 => "pantograph-mk2",
        BoardKind::HBridgeF405 | BoardKind::HBridgeF407Disc1 => "fictive-five-bar-turret",
    }
}

fn latest_values(rig: &mut Rig, field: Field) -> Vec<f64> {
    rig.tool.start_stream(Fields(field.bit()), 20).expect("a stream starts");
    rig.run(5 * MILLISECOND);
    let rows = rig.tool.rows(Duration::from_millis(100)).expect("rows come");
    rig.tool.stop_stream().expect("the stream stops");
    rows.last().expect("a row").values.clone()
}

#[test]
fn each_encoder_counts_its_own_axis_up_and_down() {
    for kind in BoardKind::ALL {
        let mut rig = Rig::with_device(kind, device_of(kind), |_| ());
        rig.load(if kind == BoardKind::OdriveV3 { WALL } else { "" });
        let axes = Wiring::of_board(kind).motors.len();
        let mut expected = vec![0.0; axes];
        rig.while_stopped(|stopped| stopped.hardware().plant = Box::new(Dummy::default()));
        for (axis, moved) in (0..axes).map(|axis| (axis, 137 - 200 * (axis as i32 % 2))) {
            let counts: [i32; 3] = std::array::from_fn(|i| if i <= axis { 137 - 200 * (i as i32 % 2) } else { 0 });
            rig.while_stopped(move |stopped| {
                stopped.hardware().plant = Box::new(Dummy { counts, ..Dummy::default() });
            });
            expected[axis] = f64::from(moved);
            rig.run(MILLISECOND);
            assert_eq!(latest_values(&mut rig, Field::Counts), expected, "{} axis {axis}", kind.name());
        }
    }
}

#[test]
fn encoders_without_motors_are_read_at_the_inputs_after_the_joints() {
    let encoder = Encoder { counts_per_turn: 1_000.0, offset: 0.0, inverted: false };
    for kind in BoardKind::ALL {
        let mut file = device_file("hapkit-paddle");
        file.description.sensed = [Some(encoder), Some(Encoder { inverted: true, ..encoder }), None];
        let mut rig = Rig::with_file(kind, file, |_| ());
        rig.load("");
        rig.tool.home().expect("the device is homed");
        rig.while_stopped(|stopped| {
            stopped.hardware().plant = Box::new(Dummy { counts: [0, 137, 63], ..Dummy::default() });
        });
        rig.run(MILLISECOND);
        let counts: Vec<f64> = latest_values(&mut rig, Field::Sensed).iter().map(|q| q * 1_000.0 / TAU).collect();
        let near = counts.len() == 2 && (counts[0] - 137.0).abs() < 1e-3 && (counts[1] + 63.0).abs() < 1e-3;
        assert!(near, "{}: {counts:?}", kind.name());
        let three = device_file("hapkit-paddle").description;
        let three = Description { sensed: [Some(encoder); 3], ..three };
        let refused = rig.tool.set_device(&Device::new("three", &three).expect("a device"));
        let refusal = Refusal::TooManySensed { sensed: 3, inputs: 3, left: 2 };
        assert!(matches!(refused, Err(BoardError::Refused(found)) if found == refusal), "{refused:?}");
    }
}

#[test]
fn each_index_pulse_reaches_its_own_axis() {
    for kind in BoardKind::ALL {
        let mut rig = Rig::with_device(kind, device_of(kind), |_| ());
        rig.load(if kind == BoardKind::OdriveV3 { WALL } else { "" });
        for axis in 0..Wiring::of_board(kind).motors.len() {
            let mut rules = rig.tool.rules().expect("the board replies");
            rules.index_period = [4_096; 3];
            rig.tool.set_rules(&rules).expect("rules change");
            rig.tool.home().expect("the device is homed");
            let mut pass = |count: i32| {
                for index in [false, true] {
                    let mut dummy = Dummy::default();
                    dummy.counts[axis] = count;
                    dummy.index[axis] = index;
                    rig.while_stopped(move |stopped| stopped.hardware().plant = Box::new(dummy));
                    rig.run(MILLISECOND);
                }
                let record = rig.tool.status().expect("it replies").fault;
                record.map(|record| (record.fault, record.axis, record.value))
            };
            let place = format!("{} axis {axis}", kind.name());
            assert_eq!(pass(0), None, "{place}: the first index pulse caused a fault");
            assert_eq!(pass(40), Some((Fault::IndexMismatch, Some(axis as u8), 40.0)), "{place}");
            rig.tool.clear().expect("the fault clears");
            rig.while_stopped(|stopped| stopped.hardware().plant = Box::new(Dummy::default()));
            // The device must be at rest to be homed.
            rig.run(100 * MILLISECOND);
        }
    }
}

#[test]
fn the_bus_voltage_is_exact_within_a_converter_step() {
    for kind in BoardKind::ALL {
        let mut rig = Rig::empty(kind);
        let step = 1e-3 * f64::from(Wiring::of_board(kind).supply_mv) / 4096.0 * Wiring::of_board(kind).bus.1;
        for volts in [12.0, 24.0, 27.5] {
            rig.while_stopped(move |stopped| {
                stopped.hardware().plant = Box::new(Dummy { bus_voltage: volts, ..Dummy::default() });
            });
            rig.run(2 * MILLISECOND);
            let shown = f64::from(rig.tool.status().expect("it replies").bus_voltage);
            assert!((shown - volts).abs() <= 1.5 * step, "{}: the board reports {shown} V for {volts} V", kind.name());
        }
    }
}

/// If a page showed another pin than the tests use, users would wire a pin that no test covers.
#[test]
fn each_wiring_page_and_drawing_contains_every_pin() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs");
    let drawing = read_to_string(folder.join("drawings/h-bridge-f407-disc1.svg")).expect("a drawing");
    for kind in BoardKind::ALL {
        let wiring = Wiring::of_board(kind);
        let page = read_to_string(folder.join(format!("wiring-{}.md", wiring.name))).expect("a page");
        let table = page.lines().filter(|line| line.starts_with('|'));
        let words: Vec<&str> = table.flat_map(|line| line.split(|c: char| !c.is_alphanumeric())).collect();
        let encoders = wiring.encoders.iter().flat_map(|wires| wires.pins.into_iter().chain(wires.index));
        let motors = wiring.motors.iter().flat_map(|motor| {
            let sensors = motor.sensors.iter().map(|(channel, _)| Pin::of_channel(*channel));
            motor.gates.into_iter().chain(sensors)
        });
        let undrawn = [&[Pin('C', 10), Pin('C', 11), Pin('C', 12)], wiring.encoder_selects].concat();
        let others = [wiring.enable, wiring.fault, wiring.bus_pin()];
        for Pin(port, number) in encoders.chain(motors).chain(others).chain(undrawn.iter().copied()) {
            let pin = format!("P{port}{number}");
            assert!(words.contains(&pin.as_str()), "{}: pin {pin} is not documented", wiring.name);
            let drawn = kind != BoardKind::HBridgeF407Disc1
                || undrawn.contains(&Pin(port, number))
                || drawing.contains(&format!(">{pin}<"));
            assert!(drawn, "docs/drawings/{}.svg: {pin}", wiring.name);
        }
    }
}
