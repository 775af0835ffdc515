//! A refused request changes nothing. The firmware gets every request that its state refuses, and the bridges' pins and
//! the board's data are checked. tests/service.rs checks the text of each refusal.

use haptic_bridge::board::settings::{self, Key};
use haptic_bridge::control::Rules;
use haptic_bridge::render::controller::Gains;
use haptic_bridge::render::scene::FeedForward;
use haptic_bridge::safety::fault::State;
use haptic_emulator::boards::BoardKind;
use haptic_emulator::inject::bridges_are_off;
use haptic_emulator::rig::Rig;
use haptic_emulator::run::{MICROSECOND, MILLISECOND};
use haptic_host::link::{Board, BoardError};

use crate::session::WALL;

/// Name of a request, and a function that sends the request.
type Request = (&'static str, fn(&mut Board) -> Result<(), BoardError>);

fn gains(wall: u8, stiffness: f32) -> Gains<f32> {
    Gains { wall, stiffness, damping: 1.0, feed_forward: FeedForward::Full, washout_hz: 2.0 }
}

fn rules_with(board: &mut Board, change: impl Fn(&mut Rules)) -> Result<(), BoardError> {
    let mut rules = board.rules()?;
    change(&mut rules);
    board.set_rules(&rules)
}

/// Sends the present scene with half the control rate.
fn set_half_rate(board: &mut Board) -> Result<(), BoardError> {
    let mut scene = board.scene()?.expect("a scene");
    scene.rate_hz *= 0.5;
    board.set_scene(&scene)
}

fn stage_rules(board: &mut Board) -> Result<(), BoardError> {
    let rules = board.rules()?;
    board.stage_entry(Key::Rules, settings::encode(&rules).expect("rules fit an entry"))
}

/// Requests that every state refuses.
const ALWAYS_REFUSED: &[Request] = &[
    ("limits above the board's", |board| rules_with(board, |rules| rules.limits.torque = [1.0e6; 3])),
    ("rules that are not numbers", |board| rules_with(board, |rules| rules.limits.power = f32::NAN)),
    ("gains of a wall that does not exist", |board| board.set_wall_gains(gains(9, 300.0))),
    ("gains that are not numbers", |board| board.set_wall_gains(gains(0, f32::NAN))),
    ("entries that were not staged", |board| board.commit_entries(&[Key::Rules].into_iter().collect())),
    ("a damaged entry", |board| board.stage_entry(Key::Rules, [1, 2, 3].into_iter().collect())),
];

/// Requests that turn the motors on or prepare for that. They require motors off, no fault, and a device.
const NEED_READINESS: &[Request] =
    &[("arm", Board::arm), ("check polarity", Board::check_polarity), ("home", Board::home)];

/// Other requests that require motors off.
const NEED_MOTORS_OFF: &[Request] = &[
    ("save", Board::save),
    ("device", |board| {
        let device = board.device()?.expect("a device");
        board.set_device(&device)
    }),
    ("stage", stage_rules),
    ("scene of another rate", set_half_rate),
    ("more power", |board| rules_with(board, |rules| rules.limits.power *= 2.0)),
    ("more speed", |board| rules_with(board, |rules| rules.limits.speed = rules.limits.speed.map(|speed| 2.0 * speed))),
    ("more current", |board| {
        rules_with(board, |rules| rules.limits.current = rules.limits.current.map(|current| 2.0 * current))
    }),
];

/// Returns everything that a tool can read from a board, except times.
fn contents(board: &mut Board) -> String {
    let status = board.status().expect("the board replies");
    let state = (status.state, status.homed, status.polarity, status.fault);
    let entries = Key::ALL.map(|key| board.read_entry(key).expect("the board replies"));
    let device = board.device().expect("the board replies");
    let scene = board.scene().expect("the board replies");
    let rules = board.rules().expect("the board replies");
    format!("{state:?} {device:?} {scene:?} {rules:?} {entries:?}")
}

/// Sends requests that the board must refuse, and checks the board's pins and data after each request.
fn check_refused(rig: &mut Rig, state: State, requests: &[Request]) {
    assert_eq!(rig.tool.status().expect("the board replies").state, state);
    let driving = state.drives();
    for (name, request) in requests {
        let before = contents(&mut rig.tool);
        let outcome = request(&mut rig.tool);
        for _ in 0..40 {
            assert_eq!(!rig.while_stopped(bridges_are_off), driving, "{name} while {state:?}");
            rig.run(25 * MICROSECOND);
        }
        assert!(matches!(outcome, Err(BoardError::Refused(_))), "{name} while {state:?}: {outcome:?}");
        assert_eq!(contents(&mut rig.tool), before, "{name} while {state:?}");
    }
}

fn homed_rig(kind: BoardKind) -> Rig {
    let mut rig = Rig::with_device(kind, "pantograph-mk2", |_| ());
    rig.load(WALL);
    rig.tool.home().expect("the device can be homed");
    rig
}

#[test]
fn refused_requests_change_neither_pins_nor_data() {
    for kind in BoardKind::ALL {
        let mut bare = Rig::empty(kind);
        check_refused(&mut bare, State::Disarmed, ALWAYS_REFUSED);
        check_refused(&mut bare, State::Disarmed, NEED_READINESS);
        check_refused(&mut bare, State::Disarmed, &[("gains", |board| board.set_wall_gains(gains(0, 300.0)))]);

        let mut rig = Rig::with_device(kind, "pantograph-mk2", |_| ());
        rig.load(WALL);
        check_refused(&mut rig, State::Disarmed, &[("arm, not homed", Board::arm)]);

        let mut rig = homed_rig(kind);
        check_refused(&mut rig, State::Disarmed, ALWAYS_REFUSED);
        rig.tool.check_polarity().expect("the polarity check starts");
        rig.run(20 * MILLISECOND);
        check_refused(&mut rig, State::CheckingPolarity, NEED_READINESS);
        check_refused(&mut rig, State::CheckingPolarity, NEED_MOTORS_OFF);

        let mut rig = homed_rig(kind);
        rig.check_polarity();
        rig.arm();
        check_refused(&mut rig, State::Armed, ALWAYS_REFUSED);
        check_refused(&mut rig, State::Armed, NEED_READINESS);
        check_refused(&mut rig, State::Armed, NEED_MOTORS_OFF);

        rig.while_stopped(|stopped| stopped.hardware().plant.device().expect("a device").set_bus_voltage(58.0));
        rig.run(20 * MILLISECOND);
        rig.while_stopped(|stopped| stopped.hardware().plant.device().expect("a device").set_bus_voltage(24.0));
        check_refused(&mut rig, State::Fault, NEED_READINESS);
        check_refused(&mut rig, State::Fault, ALWAYS_REFUSED);
    }
}
