//! One session with each release image, from power-on to a fault. Of the tests on the chip, only these are part of
//! every test run. The other modules test the same functions in detail.

use std::time::Duration;

use haptic_bridge::board::protocol::PROTOCOL;
use haptic_bridge::board::telemetry::{Field, Fields};
use haptic_bridge::safety::fault::{Fault, State};
use haptic_bridge::safety::refusal::Refusal;
use haptic_emulator::boards::{BoardKind, Wiring};
use haptic_emulator::cases::{CASES, SceneKind};
use haptic_emulator::contact::{NearWall, scene};
use haptic_emulator::hands::push;
use haptic_emulator::inject::bridges_are_off;
use haptic_emulator::results;
use haptic_emulator::rig::Rig;
use haptic_emulator::run::{MICROSECOND, MILLISECOND, SECOND};
use haptic_emulator::timing::{recorded_lengths, step_table};
use haptic_host::link::{BoardError, Row};
use haptic_sim::MotorInput;

/// Force of the hand against the wall, N.
const PUSH_N: f64 = 1.0;
/// Divider of the stream. It gives one row per millisecond, which always fits the link.
const ROW_DIVIDER: u32 = 20;

/// Runs a session with a board that latches `fault` when the fault line of its power stage is low.
pub fn session(kind: BoardKind, device: &str, fault: Fault) {
    let mut rig = Rig::with_device(kind, device, |options| {
        options.friction = false;
        options.substep = 25e-6;
    });
    assert_eq!((rig.tool.info().protocol, rig.tool.info().board.as_str()), (PROTOCOL, kind.name()));
    let details = rig.tool.details().expect("the board replies");
    assert_eq!(usize::from(details.axes), Wiring::of_board(kind).motors.len());
    assert!(details.real && details.device.is_none(), "{details:?}");

    assert_eq!(refusal_of(rig.tool.arm()), Refusal::NoDevice);
    rig.load("");
    assert_eq!(refusal_of(rig.tool.arm()), Refusal::NotHomed);
    rig.tool.home().expect("the device can be homed");
    assert_eq!(refusal_of(rig.tool.arm()), Refusal::PolarityUnchecked);

    let head = "gravity_compensation = true\n";
    rig.prepare(head);
    let fields =
        [Field::State, Field::Distance, Field::WallForce, Field::Torque].iter().fold(0, |set, field| set | field.bit());
    rig.tool.start_stream(Fields(fields), ROW_DIVIDER).expect("a stream starts");
    let start = rig.with_simulated(|device| device.tip());
    let wall = NearWall { damping: 3.0, ..NearWall::with_normal([0.0, -1.0, 0.0]) };
    rig.set_scene(&scene(head, start, rig.file.as_ref().map_or(2, |file| file.spec().task), &[wall]));
    rig.arm();
    rig.with_simulated(|device| push(device, [0.0, PUSH_N, 0.0], 0.2));
    rig.run(SECOND);
    if let Some(case) =
        CASES.iter().find(|case| (case.board, case.device, case.scene_kind) == (kind, device, SceneKind::Wall))
    {
        let mut runs: Vec<u64> = rig.trace_control(MILLISECOND).iter().map(|run| run.path.len() as u64).collect();
        runs.sort_unstable();
        // The longer half of the interrupts are crests. Their median ignores the rare crests that check the host.
        let crest = runs.get(runs.len() * 3 / 4).copied();
        let (limit, _) = recorded_lengths(&recorded_table("timing"), case).expect("the case is in the table");
        assert!(
            crest.is_some_and(|crest| is_within_record(crest, limit)),
            "a crest takes {crest:?} instructions, {limit} recorded"
        );
    }
    let depth = rig.with_simulated(|device| device.tip())[1] - start[1] - wall.gap;
    // The tolerance covers current sensors, encoder steps and a trembling hand.
    assert!((depth * wall.stiffness - PUSH_N).abs() < 0.08 * PUSH_N, "the tip is {depth} m deep in the wall");

    rig.while_stopped(|stopped| stopped.hardware().fault_line_shorted = true);
    rig.run(100 * MICROSECOND);
    assert!(rig.while_stopped(bridges_are_off), "the bridges are on");
    rig.run(10 * MILLISECOND);
    assert_eq!(rig.while_stopped(|stopped| stopped.hardware().motor_inputs()), [MotorInput::Floating; 3]);
    assert_eq!(refusal_of(rig.tool.arm()), Refusal::Faulted(fault));
    let status = rig.tool.status().expect("the board replies");
    assert_eq!((status.state, status.fault.map(|record| record.fault)), (State::Fault, Some(fault)));

    rig.tool.stop_stream().expect("the stream stops");
    let rows = rig.tool.rows(Duration::ZERO).expect("rows came");
    check_rows(&rows, wall.stiffness);
    assert!(rows.windows(2).all(|pair| pair[1].step == pair[0].step + ROW_DIVIDER), "a row is missing");
    let (losses, details) = (rig.tool.losses(), rig.tool.details().expect("the board replies"));
    assert_eq!((losses.received, losses.missing, losses.garbled), (rows.len() as u64, 0, 0), "{losses:?}");
    assert_eq!(details.overruns, 0);
    assert!(rig.while_stopped(|stopped| stopped.resets().is_empty()), "{}", rig.post_mortem());
}

/// Checks the telemetry of the entire session. The states are off, armed, off. Outside the wall there is no force, and
/// inside the wall the force is that of the stiffness.
fn check_rows(rows: &[Row], stiffness: f64) {
    let state = |row: &Row| row.get(Field::State)[0];
    let mut states: Vec<f64> = rows.iter().map(state).collect();
    states.dedup();
    assert_eq!(states, [State::Disarmed, State::Armed, State::Fault].map(|state| f64::from(state as u8)));
    let pressing = rows.iter().filter(|row| state(row) == f64::from(State::Armed as u8)).rev().take(200);
    let mean = |field| pressing.clone().map(|row| row.get(field)[0]).sum::<f64>() / 200.0;
    let (force, depth) = (mean(Field::WallForce), -mean(Field::Distance));
    assert!(
        (force - PUSH_N).abs() < 0.08 * PUSH_N && (depth * stiffness - force).abs() < 0.02 * PUSH_N,
        "a force of {force} N at a depth of {depth} m"
    );
    for row in rows {
        assert!(row.get(Field::WallForce)[0] == 0.0 || row.get(Field::Distance)[0] < 0.0, "{row:?}");
        let armed = state(row) == f64::from(State::Armed as u8);
        assert!(armed || row.get(Field::Torque).iter().all(|torque| *torque == 0.0), "{row:?}");
    }
}

/// Returns a committed table of docs/results, which `cargo xtask timing` writes.
fn recorded_table(name: &str) -> String {
    std::fs::read_to_string(results(name)).expect("the table exists")
}

/// Returns true if `now` exceeds the recorded number of instructions by at most 1 %.
fn is_within_record(now: u64, recorded: u64) -> bool {
    100 * now <= 101 * recorded
}

/// With `UPDATE_DOCS=1` this test writes the table again, like `cargo xtask timing`.
#[test]
fn control_steps_stay_within_the_recorded_instructions() {
    let now = step_table();
    if std::env::var_os("UPDATE_DOCS").is_some() {
        return std::fs::write(results("timing-steps"), now).expect("the table can be written");
    }
    let recorded = recorded_table("timing-steps");
    let number = |line: &str| line.rsplit(',').next().and_then(|cell| cell.parse::<u64>().ok());
    assert_eq!(recorded.lines().count(), now.lines().count());
    for (recorded, now) in recorded.lines().zip(now.lines()).skip(1) {
        let (before, after) = (number(recorded).expect("a number"), number(now).expect("a number"));
        assert!(is_within_record(after, before), "more than 1 % above the record: {now}, recorded: {recorded}");
    }
}

pub fn refusal_of(outcome: Result<(), BoardError>) -> Refusal {
    match outcome {
        Err(BoardError::Refused(refusal)) => refusal,
        other => panic!("a refusal was expected, not {other:?}"),
    }
}

#[test]
fn the_odrive_v3_image_renders_a_wall_and_stops_at_a_fault() {
    session(BoardKind::OdriveV3, "pantograph-mk2", Fault::GateDriver);
}

#[test]
fn the_h_bridge_f405_image_renders_with_a_delta_and_stops_at_a_fault() {
    session(BoardKind::HBridgeF405, "falcon-like", Fault::BreakInput);
}

#[test]
fn the_h_bridge_f407_disc1_image_renders_and_stops_at_a_fault() {
    session(BoardKind::HBridgeF407Disc1, "phantom-premium-1.5", Fault::BreakInput);
}
