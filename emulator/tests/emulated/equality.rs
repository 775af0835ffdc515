//! The chip computes the same torques as the library on this computer, bit for bit.

use std::time::Duration;

use haptic_bridge::board::telemetry::{Field, Fields};
use haptic_bridge::control::compiled::BoardMath;
use haptic_bridge::control::frame::Samples;
use haptic_bridge::control::joints::{Counts, Currents};
use haptic_bridge::control::program::Hardware;
use haptic_bridge::control::program::Program;
use haptic_bridge::control::{Command, ControlLoop};
use haptic_bridge::drive::stage::Bridge;
use haptic_bridge::model::device::Device;
use haptic_emulator::boards::{BoardKind, Wiring};
use haptic_emulator::rig::Rig;
use haptic_emulator::run::SECOND;
use haptic_host::link::Row;
use haptic_host::scene_file::SceneFile;
use haptic_sim::{Hand, HandSettings, Intent, Waypoint};

/// Armed state, as in the first column of [`Field::State`].
const ARMED_STATE: f64 = 1.0;

fn is_armed(row: &Row) -> bool {
    row.get(Field::State).first() == Some(&ARMED_STATE)
}

#[test]
fn torques_on_the_chip_equal_the_librarys_bit_for_bit() {
    let cases = [
        (BoardKind::OdriveV3, "pantograph-mk2", [0.0, 0.004, 0.0]),
        (BoardKind::HBridgeF405, "phantom-premium-1.5", [0.0, 0.004, 0.0]),
    ];
    for (kind, name, offset) in cases {
        let mut rig = Rig::with_device(kind, name, |_| ());
        let file = rig.file.clone().expect("a device");
        let task = file.spec().task;
        let head = "rate_hz = 2000\ncutoff_hz = 200\ngravity_compensation = true\n";
        let home = rig.prepare(head);
        let tip = rig.with_simulated(|device| device.tip());
        let axes = |values: &[f64]| values.iter().take(task).map(f64::to_string).collect::<Vec<_>>().join(", ");
        let point: Vec<f64> = tip.iter().zip(offset).map(|(tip, offset)| tip + offset).collect();
        let scene = format!(
            "{head}[[wall]]\npoint = [{}]\nnormal = [{}]\nstiffness = 800.0\ndamping = 2.0\nfeed_forward = \"full\"\n",
            axes(&point),
            axes(&[0.0, -1.0, 0.0])
        );
        rig.set_scene(&scene);
        // The device comes to rest, and its estimators settle.
        rig.run(SECOND / 2);
        let fields =
            [Field::Angle, Field::Speed, Field::Tip, Field::Torque, Field::Distance, Field::WallForce, Field::Shaping];
        let traced = [Field::Counts, Field::BusVoltage, Field::Current, Field::State];
        let set = fields.iter().chain(&traced).fold(0, |set, field| set | field.bit());
        let columns = haptic_host::link::columns(Fields(set), &file.description.units(), 0);
        rig.tool.start_stream(Fields(set), 1).expect("a stream starts");
        rig.tool.arm().expect("armed");
        rig.with_simulated(move |device| {
            let to = device.tip();
            let path = vec![
                Waypoint { time: 0.0, value: to },
                Waypoint { time: 0.1, value: [to[0] + 0.002, to[1] + 0.006, to[2]] },
            ];
            device.set_hand(Hand::new(HandSettings::default(), Intent::Follow(path), to, device.time()));
        });
        let mut rows = Vec::new();
        while rows.len() < 5_000 {
            rows.extend(rig.tool.rows(Duration::from_millis(300)).expect("rows come"));
        }
        // Only rows of the time until arming may be lost. During the 35 ms that the gate drivers need, the link is not
        // served and the device is at rest.
        let arming = rows.iter().position(is_armed).expect("it arms");
        assert!(rows[arming..].windows(2).all(|pair| pair[1].step == pair[0].step + 1), "{name}: a step is missing");

        let rules = rig.tool.rules().expect("it replies");
        let bridge =
            Bridge { carrier_hz: 20_000.0, dead_time: 0.0, bandwidth_hz: 1000.0, current_sensed: true, legs: 2 };
        let hardware = Hardware {
            axes: Wiring::of_board(kind).motors.len(),
            encoders: Wiring::of_board(kind).encoders.len() as u8,
            real: true,
            bus_sensed: true,
            bridge,
            timer_hz: 168_000_000,
        };
        let device = Device::new(&file.name, &file.description).expect("a device");
        let scene = SceneFile::parse(&scene, "scene", task).expect("a scene").scene().expect("the scene fits f32");
        let program: Program<BoardMath> =
            Program::new(&hardware, &rules.limits, &device, &scene, false).expect("a program");
        let mut control_loop = ControlLoop::new(hardware, rules);
        let of = |row: &Row, field: Field| -> Vec<f64> {
            columns
                .iter()
                .zip(&row.values)
                .filter(|(column, _)| column.field == field)
                .map(|(_, value)| *value)
                .collect()
        };
        let three = |values: Vec<f64>| -> [f64; 3] { std::array::from_fn(|i| values.get(i).copied().unwrap_or(0.0)) };
        control_loop.execute(Command::Program(Box::new(program))).0.expect("loaded");
        // Homes in place, then repeats the first row (at rest) until every estimator is zero.
        control_loop.control(&Samples { counts: Counts(home), bus_voltage: 24.0, ..Samples::default() });
        control_loop.execute(Command::Home).0.expect("homed");
        control_loop.execute(Command::PolarityKnown).0.expect("known");
        let start = Counts(three(of(&rows[0], Field::Counts)).map(|count| count as i32));
        for _ in 0..20_000 {
            control_loop.control(&Samples { counts: start, bus_voltage: 24.0, ..Samples::default() });
        }
        let mut compared = 0;
        let mut touched = 0;
        for row in &rows {
            let samples = Samples {
                counts: Counts(three(of(row, Field::Counts)).map(|count| count as i32)),
                bus_voltage: of(row, Field::BusVoltage)[0] as f32,
                currents: Currents(three(of(row, Field::Current)).map(|current| current as f32)),
                ..Samples::default()
            };
            let armed = is_armed(row);
            if armed && control_loop.status().state != haptic_bridge::safety::fault::State::Armed {
                control_loop.execute(Command::Arm).0.expect("armed");
            }
            control_loop.control(&samples);
            if !armed {
                continue;
            }
            let frame = control_loop.frame();
            let library_values = |field| -> [f32; 3] {
                match field {
                    Field::Angle => frame.at.q,
                    Field::Speed => frame.at.qd,
                    Field::Tip => frame.at.tip,
                    Field::Torque => *frame.motors.torque,
                    Field::Distance => [frame.at.walls.distance, 0.0, 0.0],
                    Field::WallForce => [frame.at.walls.wall_force, 0.0, 0.0],
                    _ => [frame.at.walls.shaping, 0.0, 0.0],
                }
            };
            for field in fields {
                // The chip still has remains of motions before the trace (the polarity check). They have decayed below
                // the normal numbers and are not compared.
                let settled = |value: f32| if value.abs() < f32::MIN_POSITIVE { 0 } else { value.to_bits() };
                let chip = three(of(row, field)).map(|value| settled(value as f32));
                let pc = library_values(field).map(settled);
                assert_eq!(chip, pc, "{name}: {field:?} at step {} (PC: {:?})", row.step, library_values(field));
            }
            compared += 1;
            touched += usize::from(frame.at.walls.wall_force > 0.0);
        }
        println!("{name}: {compared} steps compared, {touched} of them in the wall");
        assert!(compared > 4_000 && touched > 500, "{name}: {compared} compared, {touched} in the wall");
    }
}
