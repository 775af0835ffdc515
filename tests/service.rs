//! Every request of the protocol, in every state of a board, through the dispatcher like a request from the link. Each
//! request must have its reply, or a refusal with a reason. A refused request must change nothing.
//!
//! After each request the board of tests/rig/board.rs asserts the safety invariants. There is no torque unless the
//! motors are on. While the motors are on, no limit is raised, no flash is written and no timer is set.

use crate::rig;
use crate::rig::board::{Board, frame};
use haptic_bridge::board::protocol::*;
use haptic_bridge::board::settings::{self, BoardName, Key};
use haptic_bridge::board::telemetry::{Fields, StreamRequest};
use haptic_bridge::control::compiled::BoardMath;
use haptic_bridge::control::program::Program;
use haptic_bridge::control::{Command, Rules};
use haptic_bridge::model::cogging::{Harmonic, Potentials};
use haptic_bridge::model::description::Description;
use haptic_bridge::model::units::JointUnits;
use haptic_bridge::render::controller::Gains;
use haptic_bridge::render::scene::{FeedForward, Scene};
use haptic_bridge::safety::fault::{Fault, State};
use haptic_bridge::safety::limits::{BadLimit, Limit, Limits};
use haptic_bridge::safety::refusal::Refusal;
use postcard_rpc::Endpoint;
use postcard_rpc::header::VarHeader;
use postcard_rpc::standard_icd::WireError;

#[derive(Clone, Copy, Debug, PartialEq)]
enum BoardState {
    Bare,
    /// Board with device and scene, and with motors that are not real.
    Ready,
    /// Board with real motors that is not homed yet.
    Unhomed,
    Armed,
    Checking,
    Faulty,
}

const STATES: [BoardState; 6] = [
    BoardState::Bare,
    BoardState::Ready,
    BoardState::Unhomed,
    BoardState::Armed,
    BoardState::Checking,
    BoardState::Faulty,
];

fn far_wall() -> Scene<f32> {
    rig::scene(1, &[rig::wall(-0.05, 500.0)])
}

fn board_in_state(now: BoardState) -> Board {
    let device = rig::device(&rig::paddle());
    let mut board = match now {
        BoardState::Bare => return Board::new(true),
        BoardState::Unhomed => return Board::with_device(true, &device, &far_wall()),
        _ => Board::with_device(false, &device, &far_wall()),
    };
    match now {
        BoardState::Armed => board.ask::<Arm>(&()).unwrap().unwrap(),
        BoardState::Checking => board.ask::<CheckPolarity>(&()).unwrap().unwrap(),
        BoardState::Faulty => board.reported_fault = Some((Fault::GateDriver, None, 1.0)),
        _ => {}
    }
    board.tick();
    board
}

/// Returns rules in which every limit is `share` of the board's own limit.
fn rules_with_share(share: f32) -> Rules {
    let defaults = Limits::default();
    let limits = Limits {
        torque: defaults.torque.map(|limit| share * limit),
        current: defaults.current.map(|limit| share * limit),
        continuous_current: defaults.continuous_current.map(|limit| share * limit),
        speed: defaults.speed.map(|limit| share * limit),
        power: share * defaults.power,
        tip_force: share * defaults.tip_force,
        ..defaults
    };
    Rules { limits, ..Rules::default() }
}

fn gains(wall: u8, stiffness: f32) -> GainsRequest {
    let gains = Gains { wall, stiffness, damping: 1.0, feed_forward: FeedForward::Off, washout_hz: 2.0 };
    GainsRequest { wall: Some(gains), estimator: None }
}

/// Returns a potential of motor 0 with this amplitude, J.
fn cogging(energy: f32) -> Potentials {
    let mut potentials = Potentials::default();
    potentials.0[0].push(Harmonic { order: 84, energy, phase: 0.0 }).unwrap();
    potentials
}

type Sender = fn(&mut Board) -> Result<(), Refusal>;

macro_rules! ask {
    ($Endpoint:ident) => {
        ask!($Endpoint, ())
    };
    ($Endpoint:ident, $request:expr) => {
        |board| board.ask::<$Endpoint>(&$request).expect("a reply")
    };
}

/// Name of a request, a function that sends the request, and the reply in each of [`STATES`].
type RequestCase = (&'static str, Sender, [Result<(), Refusal>; 6]);

/// Session of the tool that changes settings in these tests.
const SESSION: u32 = 4;

fn commit_request(keys: &[Key]) -> Commit {
    Commit { session: SESSION, keys: keys.iter().copied().collect() }
}

fn stage_setting<S: settings::Setting>(board: &mut Board, value: &S) -> Result<(), Refusal> {
    let entry = settings::encode(value).expect("the value fits an entry");
    board.ask::<StageEntry>(&WriteEntry { session: SESSION, key: S::KEY, entry }).expect("a reply")
}

fn restore_rules(board: &mut Board) -> Result<(), Refusal> {
    stage_setting(board, &rules_with_share(0.5))?;
    board.ask::<CommitEntries>(&commit_request(&[Key::Rules])).expect("a reply")
}

/// Returns the message of a tool whose key is pressed now.
fn press(board: &mut Board) -> Press {
    Press { holder: SESSION, seen: board.ask::<Heartbeat>(&Beat::Here).expect("a reply") }
}

fn arm_held(board: &mut Board) -> Result<(), Refusal> {
    let press = press(board);
    board.ask::<ArmHeld>(&press).expect("a reply")
}

fn find_stops(board: &mut Board) -> Result<(), Refusal> {
    let press = press(board);
    board.ask::<FindStops>(&press).expect("a reply")
}

/// Returns the refusal of [`rules_with_share`] with a share above 1. It names the first entry of the first limit.
fn too_high_refusal(share: f32) -> Refusal {
    let value = share * Limits::default().torque[0];
    Refusal::BadLimit(BadLimit { limit: Limit::Torque, joint: Some(0), value, least: 0.0, most: 5.0 })
}

fn request_cases() -> Vec<RequestCase> {
    use Refusal::{Armed as On, NoDevice, NoStops, NotHomed};
    let ok = Ok(());
    let fault = Err(Refusal::Faulted(Fault::GateDriver));
    let always = [ok; 6];
    let while_off = [ok, ok, ok, Err(On), Err(On), ok];
    vec![
        ("arm", ask!(Arm), [Err(NoDevice), ok, Err(NotHomed), Err(On), Err(On), fault]),
        ("arm with a key", arm_held, [Err(NoDevice), ok, Err(NotHomed), Err(On), Err(On), fault]),
        ("check polarity", ask!(CheckPolarity), [Err(NoDevice), ok, Err(NotHomed), Err(On), Err(On), fault]),
        ("find stops", find_stops, [Err(NoDevice), Err(NoStops), Err(NotHomed), Err(On), Err(On), fault]),
        ("home", ask!(Home), [Err(NoDevice), ok, ok, Err(On), Err(On), fault]),
        ("disarm", ask!(Disarm), always),
        ("clear", ask!(Clear), always),
        ("device", ask!(SetDevice, rig::device(&rig::paddle())), while_off),
        ("scene", ask!(SetScene, far_wall()), [Err(NoDevice), ok, ok, ok, Err(On), ok]),
        (
            "scene of another rate",
            ask!(SetScene, Scene { rate_hz: 4_000.0, ..far_wall() }),
            [Err(NoDevice), ok, ok, Err(On), Err(On), ok],
        ),
        ("gains", ask!(SetGains, gains(0, 300.0)), [Err(NoDevice), ok, ok, ok, ok, ok]),
        ("cogging", ask!(SetCogging, cogging(1.0e-4)), [Err(NoDevice), ok, ok, Err(On), Err(On), ok]),
        (
            "cogging of more than the motor's torque",
            ask!(SetCogging, cogging(1.0)),
            [NoDevice, Refusal::BadCogging(0), Refusal::BadCogging(0), On, On, Refusal::BadCogging(0)].map(Err),
        ),
        ("unchanged rules", ask!(SetRules, rules_with_share(1.0)), always),
        ("lower limits", ask!(SetRules, rules_with_share(0.5)), always),
        ("limits above the board's", ask!(SetRules, rules_with_share(1.01)), [Err(too_high_refusal(1.01)); 6]),
        ("save", ask!(Save), while_off),
        (
            "stage a setting",
            ask!(
                StageEntry,
                WriteEntry {
                    session: SESSION,
                    key: Key::Rules,
                    entry: settings::encode(&rules_with_share(0.5)).unwrap()
                }
            ),
            while_off,
        ),
        (
            "stage a damaged setting",
            ask!(StageEntry, WriteEntry { session: SESSION, key: Key::Rules, entry: [1, 2, 3].into_iter().collect() }),
            [Refusal::BadEntry, Refusal::BadEntry, Refusal::BadEntry, On, On, Refusal::BadEntry].map(Err),
        ),
        ("restore", restore_rules, while_off),
        (
            "restore a setting that was not staged",
            ask!(CommitEntries, Commit { session: SESSION + 1, ..commit_request(&[Key::Rules]) }),
            [Refusal::BadEntry, Refusal::BadEntry, Refusal::BadEntry, On, On, Refusal::BadEntry].map(Err),
        ),
        ("name", ask!(SetName, "paddle".chars().collect::<Name>()), always),
        ("stream", ask!(Stream, StreamRequest { fields: Fields::ALL, divider: 1, stream: 7 }), always),
        ("boot loader", ask!(EnterDfu), always),
        ("restart", ask!(Restart), always),
    ]
}

fn configuration(board: &mut Board) -> (Option<DeviceData>, Option<SceneData>, Rules, Vec<MaybeEntry>) {
    let entries = Key::ALL.map(|key| board.ask::<ReadEntry>(&key).unwrap()).to_vec();
    let device = board.ask::<GetDevice>(&()).unwrap();
    (device, board.ask::<GetScene>(&()).unwrap(), board.ask::<GetRules>(&()).unwrap(), entries)
}

#[test]
fn every_request_in_every_state_has_the_right_reply() {
    for (name, ask, answers) in request_cases() {
        for (now, expected) in STATES.into_iter().zip(answers) {
            let mut board = board_in_state(now);
            let before = (configuration(&mut board), board.state());
            let answer = ask(&mut board);
            assert_eq!(answer, expected, "{name} while {now:?}");
            if answer.is_err() {
                assert_eq!((configuration(&mut board), board.state()), before, "{name}, refused while {now:?}");
                assert!(!expected.unwrap_err().to_string().is_empty());
            }
            board.tick();
            assert_eq!(board.bridges, board.state().drives(), "{name} while {now:?}");
        }
    }
}

#[test]
fn reading_requests_change_no_state() {
    for now in STATES {
        let mut board = board_in_state(now);
        let before = (configuration(&mut board), board.state());
        board.ask::<GetInfo>(&()).unwrap();
        board.ask::<GetDetails>(&()).unwrap();
        board.ask::<GetFaults>(&()).unwrap();
        board.ask::<GetCogging>(&()).unwrap();
        board.ask::<Heartbeat>(&Beat::Here).unwrap();
        // A request without a force and without a lease only reads.
        board.ask::<Force>(&ForceRequest::default()).unwrap();
        assert_eq!(board.ask::<GetStatus>(&()).unwrap().state, before.1);
        assert_eq!((configuration(&mut board), board.state()), before, "{now:?}");
    }
}

/// Before a board prepares its gate drivers, it asks the control loop whether arming would be refused.
#[test]
fn asking_to_arm_has_the_reply_of_arming_and_changes_nothing() {
    fn future_press(press: Press) -> Press {
        Press { seen: press.seen + 1, ..press }
    }
    type Commands = [fn(Press) -> Command<Box<Program<BoardMath>>>; 2];
    let pairs: [Commands; 5] = [
        [|_| Command::MayArm, |_| Command::Arm],
        [Command::MayArmHeld, Command::ArmHeld],
        [|press| Command::MayArmHeld(future_press(press)), |press| Command::ArmHeld(future_press(press))],
        [|_| Command::MayCheckPolarity, |_| Command::CheckPolarity],
        [Command::MayFindStops, Command::FindStops],
    ];
    for (now, [may, does]) in STATES.into_iter().flat_map(|now| pairs.map(|pair| (now, pair))) {
        let mut board = board_in_state(now);
        let press = press(&mut board);
        let before = (configuration(&mut board), board.ask::<GetStatus>(&()).unwrap());
        let answer = board.machine.control_loop.execute(may(press)).0;
        assert_eq!((configuration(&mut board), board.ask::<GetStatus>(&()).unwrap()), before, "{now:?}");
        assert_eq!(answer, board.machine.control_loop.execute(does(press)).0, "{now:?}");
    }
}

/// Returns the board's endpoints without those of postcard-rpc, which the board does not serve.
fn own_endpoints() -> impl Iterator<Item = (&'static str, postcard_rpc::Key)> {
    ENDPOINTS.endpoints.iter().map(|(path, key, _)| (*path, *key)).filter(|(path, _)| path.starts_with("haptic/"))
}

#[test]
fn the_tests_of_requests_cover_every_endpoint() {
    // The two tests above cover 19 endpoints that change something and 11 that only read.
    assert_eq!(own_endpoints().count(), 30, "an endpoint was added: add it to the tests of this file");
}

#[test]
fn limits_beyond_the_boards_own_and_invalid_numbers_are_refused() {
    type LimitSetter = fn(&mut Limits, usize, f32);
    let sets: [(Limit, f32, LimitSetter); 6] = [
        (Limit::Torque, 5.0, |limits, axis, to| limits.torque[axis] = to),
        (Limit::Current, 10.0, |limits, axis, to| limits.current[axis] = to),
        (Limit::ContinuousCurrent, 10.0, |limits, axis, to| limits.continuous_current[axis] = to),
        (Limit::Speed, 60.0, |limits, axis, to| limits.speed[axis] = to),
        (Limit::Power, 20.0, |limits, _, to| limits.power = to),
        (Limit::TipForce, 1_000.0, |limits, _, to| limits.tip_force = to),
    ];
    fn limit_of(answer: Result<(), Refusal>) -> BadLimit {
        match answer {
            Err(Refusal::BadLimit(bad)) => bad,
            other => panic!("{other:?}"),
        }
    }
    let mut board = board_in_state(BoardState::Ready);
    for (name, most, set) in sets {
        for axis in 0..3 {
            for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, 0.0, -0.0, -1.0, 1.000_001 * most] {
                let mut invalid = rules_with_share(0.5);
                set(&mut invalid.limits, axis, bad);
                let bad_limit = limit_of(board.ask::<SetRules>(&invalid).unwrap());
                let joint = (name != Limit::Power && name != Limit::TipForce).then_some(axis as u8);
                assert_eq!((bad_limit.limit, bad_limit.joint, bad_limit.most), (name, joint, most), "{bad}");
                assert_eq!(bad_limit.value.to_bits(), bad.to_bits(), "the refusal has the number");
                let (words, unit, _) = name.words(&JointUnits::REVOLUTE);
                let text = Refusal::BadLimit(bad_limit).to_string();
                assert!(text.contains(words) && text.contains(&format!("at most {most} {unit}")), "{text}");
            }
            let mut edge = rules_with_share(0.5);
            set(&mut edge.limits, axis, most);
            assert_eq!(board.ask::<SetRules>(&edge).unwrap(), Ok(()), "{name:?} at the board's own limit");
        }
    }
    for (low, high) in [(7.9, 24.0), (10.0, 28.1), (20.0, 20.0), (f32::NAN, 24.0), (10.0, f32::NAN)] {
        let mut invalid = rules_with_share(0.5);
        (invalid.limits.bus_min, invalid.limits.bus_max) = (low, high);
        let bad_limit = limit_of(board.ask::<SetRules>(&invalid).unwrap());
        assert!(matches!(bad_limit.limit, Limit::BusMin | Limit::BusMax), "{low} to {high} V: {bad_limit}");
    }
    for host_seconds in [f32::NAN, f32::INFINITY, 0.0, -1.0, 0.009, 60.1] {
        let invalid = Rules { host_seconds, ..rules_with_share(0.5) };
        assert_eq!(limit_of(board.ask::<SetRules>(&invalid).unwrap()).limit, Limit::HostSeconds, "{host_seconds} s");
    }
}

const INVALID_NUMBERS: [f32; 7] =
    [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, f32::MIN_POSITIVE / 8.0, -1.0e-45, -0.0];

/// Sends a message to a ready board and to an armed board, with each of [`INVALID_NUMBERS`] written at every place of
/// the message's bytes. Then arms if possible and pushes through the wall, while the board asserts its invariants.
/// Returns the numbers of accepted and refused messages.
fn check_invalid_numbers<E: Endpoint>(message: &E::Request) -> (usize, usize)
where
    E::Request: serde::Serialize + Sized,
{
    let sound = postcard::to_stdvec(message).unwrap();
    let outcome = |answer: &[u8]| {
        let (_, body) = VarHeader::take_from_slice(answer).unwrap();
        postcard::from_bytes::<Outcome>(body).unwrap_or(Err(Refusal::NotSupported)).is_ok()
    };
    let (mut accepted, mut refused) = (0, 0);
    for now in [BoardState::Ready, BoardState::Armed] {
        for poison in INVALID_NUMBERS {
            for place in 0..=sound.len().saturating_sub(4) {
                let mut bytes = sound.clone();
                bytes[place..place + 4].copy_from_slice(&poison.to_le_bytes());
                let mut board = board_in_state(now);
                match outcome(&board.answer(&frame(E::REQ_KEY, &bytes)).unwrap()) {
                    true => accepted += 1,
                    false => refused += 1,
                }
                let _ = board.ask::<Arm>(&());
                for k in 0..60 {
                    board.samples.counts[0] = -150 * (k % 40);
                    board.tick();
                }
            }
        }
    }
    (accepted, refused)
}

#[test]
fn a_message_with_an_invalid_number_is_refused_or_harmless() {
    let scene = check_invalid_numbers::<SetScene>(&far_wall());
    let gains = check_invalid_numbers::<SetGains>(&gains(0, 300.0));
    let rules = check_invalid_numbers::<SetRules>(&rules_with_share(0.5));
    for (accepted, refused) in [scene, gains, rules] {
        assert!(accepted > 10 && refused > 10, "{accepted} accepted, {refused} refused");
    }
}

#[test]
fn a_force_with_an_invalid_number_is_refused_or_harmless() {
    let contact = HostContact { point: [0.01, 0.0, 0.0], normal: [1.0, 0.0, 0.0], stiffness: 500.0, damping: 1.0 };
    let request = ForceRequest {
        sequence: 1,
        seen: None,
        hold: 0.01,
        fade: 0.01,
        force: [1.0, 0.0, 0.0],
        torque: [0.1, 0.0, 0.0],
        contact: Some(contact),
    };
    let sound = postcard::to_stdvec(&request).unwrap();
    let mut seen = Vec::new();
    for poison in INVALID_NUMBERS {
        for place in 0..=sound.len() - 4 {
            let mut bytes = sound.clone();
            bytes[place..place + 4].copy_from_slice(&poison.to_le_bytes());
            let mut board = board_in_state(BoardState::Armed);
            let answer = board.answer(&frame(Force::REQ_KEY, &bytes)).unwrap();
            let (_, body) = VarHeader::take_from_slice(&answer).unwrap();
            seen.push(postcard::from_bytes::<ForceAnswer>(body).map(|answer| answer.done).ok());
            // The board asserts the limits of its own torques.
            (0..60).for_each(|_| board.tick());
            assert_eq!(board.state(), State::Armed, "{poison} at byte {place}");
        }
    }
    for done in [ForceDone::Taken, ForceDone::Bad(BadForce::Lease), ForceDone::Bad(BadForce::Gains)] {
        assert!(seen.contains(&Some(done)), "no request had the reply {done:?}");
    }
}

#[test]
fn a_frame_without_a_request_gets_an_error_or_no_reply() {
    let mut board = board_in_state(BoardState::Ready);
    let error = |answer: Option<Vec<u8>>| {
        let answer = answer.expect("a reply");
        let (_, body) = VarHeader::take_from_slice(&answer).unwrap();
        postcard::from_bytes::<WireError>(body).unwrap()
    };
    assert_eq!(board.answer(&[]), None);
    assert_eq!(board.answer(&[0xFF]), None);
    let unknown = postcard_rpc::Key::for_path::<()>("haptic/unheard-of");
    assert_eq!(error(board.answer(&frame(unknown, &[]))), WireError::UnknownKey);
    // This body is too long for a request without a body, and invalid for every other request.
    for (path, key) in own_endpoints() {
        let before = board.state();
        assert_eq!(error(board.answer(&frame(key, &[0xFF; 700]))), WireError::DeserFailed, "{path}");
        assert_eq!(board.state(), before);
    }
    // A header with a key of one byte is readable, but the key is too short.
    assert_eq!(error(board.answer(&[0x00, 0x12, 0x01])), WireError::KeyTooSmall);
}

#[test]
fn a_flash_failure_is_reported_and_changes_no_setting() {
    let mut board = board_in_state(BoardState::Ready);
    let before = configuration(&mut board);
    board.machine.flash.fails = true;
    assert_eq!(board.ask::<Save>(&()).unwrap(), Err(Refusal::Flash));
    assert_eq!(configuration(&mut board), before);
    board.machine.flash.fails = false;
    assert_eq!(board.ask::<Save>(&()).unwrap(), Ok(()));
    assert!(board.machine.flash.committed.len() >= 4);
}

#[test]
fn saved_settings_are_in_force_after_a_restart_with_motors_off() {
    let mut board = board_in_state(BoardState::Ready);
    board.ask::<SetName>(&"left hand".chars().collect::<Name>()).unwrap().unwrap();
    board.ask::<SetRules>(&rules_with_share(0.25)).unwrap().unwrap();
    board.ask::<Save>(&()).unwrap().unwrap();
    board.ask::<Arm>(&()).unwrap().unwrap();
    let before = configuration(&mut board);
    board.ask::<Restart>(&()).unwrap().unwrap();
    assert_eq!(board.state(), State::Disarmed);
    assert_eq!(configuration(&mut board), before);
    assert_eq!(board.ask::<GetDetails>(&()).unwrap().name.as_str(), "left hand");
    assert_eq!(settings::decode::<BoardName>(before.3[5].as_ref().unwrap()).unwrap().0.as_str(), "left hand");
}

/// Returns a paddle without back-EMF, because the test board lets the commanded currents flow at any speed.
fn paddle_without_back_emf() -> Description {
    let mut paddle = rig::paddle();
    paddle.joints[0].motor.as_mut().unwrap().back_emf = 0.0;
    paddle
}

/// Homes a paddle with some friction and runs the polarity check. The motor turns with its torque if `way` is 1, and
/// against its torque if `way` is -1.
fn polarity_check(board: &mut Board, way: f64) {
    board.ask::<Home>(&()).unwrap().unwrap();
    board.ask::<CheckPolarity>(&()).unwrap().unwrap();
    let from = board.samples.counts[0];
    let (mut q, mut qd, rate) = (0.0, 0.0, f64::from(rig::RATE_HZ));
    for step in 0..(20.0 * rate) as u32 {
        if !board.state().drives() {
            break;
        }
        if step % 200 == 0 {
            board.ask::<Heartbeat>(&Beat::Here).unwrap();
        }
        let torque = board.machine.control_loop.frame().motors.torque[0];
        qd += (way * f64::from(torque) - 2.0e-3 * qd) / 1.0e-4 / rate;
        q += qd / rate;
        board.samples.counts[0] = from + (q / core::f64::consts::TAU * rig::COUNTS_PER_TURN).round() as i32;
        board.tick();
    }
    let _ = board.service.poll(&mut board.machine);
}

#[test]
fn a_polarity_check_counts_for_the_checked_device_only() {
    let device = rig::device(&paddle_without_back_emf());
    let mut inverted = paddle_without_back_emf();
    if let Some(encoder) = &mut inverted.joints[0].encoder {
        encoder.inverted = true;
    }
    let mut board = Board::with_device(true, &device, &far_wall());
    polarity_check(&mut board, 1.0);
    for (loaded, known) in [(rig::device(&inverted), false), (rig::device(&rig::five_bar()), false), (device, true)] {
        board.ask::<SetDevice>(&loaded).unwrap().unwrap();
        (0..200).for_each(|_| board.tick());
        let _ = board.service.poll(&mut board.machine);
        assert_eq!(board.ask::<GetStatus>(&()).unwrap().polarity, known, "{}", loaded.name);
    }
}

fn entry_checksum(device: &DeviceData) -> u32 {
    u32::from_le_bytes(*settings::encode(device).unwrap().last_chunk().unwrap())
}

/// Returns the device with a name that gives its entry the checksum `wanted`. A CRC is linear, so the name is built
/// from letters with five free bits each, whose changes add up to the missing difference.
fn with_checksum(device: &DeviceData, wanted: u32) -> DeviceData {
    let mut free = vec![];
    let named = |letters: &[u8; 10]| DeviceData { name: letters.map(char::from).iter().collect(), ..device.clone() };
    let plain = entry_checksum(&named(&[b'@'; 10]));
    for bit in 0..50 {
        let mut letters = [0; 10];
        letters[bit / 5] = 1 << (bit % 5);
        free.push((entry_checksum(&named(&letters.map(|changed| b'@' ^ changed))) ^ plain, letters));
    }
    let (mut missing, mut chosen) = (plain ^ wanted, [b'@'; 10]);
    let add = |to: &mut [u8; 10], letters: &[u8; 10]| to.iter_mut().zip(letters).for_each(|(a, b)| *a ^= b);
    for column in 0..32 {
        let pivot = free.iter().position(|(change, _)| change >> column & 1 == 1).unwrap();
        let (change, letters) = free.swap_remove(pivot);
        for other in free.iter_mut().filter(|(other, _)| other >> column & 1 == 1) {
            other.0 ^= change;
            add(&mut other.1, &letters);
        }
        if missing >> column & 1 == 1 {
            missing ^= change;
            add(&mut chosen, &letters);
        }
    }
    named(&chosen)
}

#[test]
fn a_device_with_a_forged_checksum_does_not_count_as_checked() {
    let device = rig::device(&paddle_without_back_emf());
    let mut inverted = paddle_without_back_emf();
    if let Some(encoder) = &mut inverted.joints[0].encoder {
        encoder.inverted = true;
    }
    let inverted = with_checksum(&rig::device(&inverted), entry_checksum(&device));
    assert!(entry_checksum(&inverted) == entry_checksum(&device) && inverted.joints != device.joints);
    let known = |board: &mut Board| board.ask::<GetStatus>(&()).unwrap().polarity;

    let mut board = Board::with_device(true, &device, &far_wall());
    polarity_check(&mut board, 1.0);
    board.ask::<SetDevice>(&inverted).unwrap().unwrap();
    assert!(!known(&mut board), "the polarity is known after loading {:?}", inverted.name);
    board.ask::<SetDevice>(&device).unwrap().unwrap();
    assert!(known(&mut board));
    let restored = commit_request(&[Key::Device]);
    for (device, expected) in [(&inverted, false), (&device, true)] {
        stage_setting(&mut board, device).unwrap();
        board.ask::<CommitEntries>(&restored).unwrap().unwrap();
        assert_eq!(known(&mut board), expected, "the polarity is wrong after restoring {:?}", device.name);
    }
    board.ask::<SetDevice>(&inverted).unwrap().unwrap();
    (0..200).for_each(|_| board.tick());
    board.ask::<Home>(&()).unwrap().unwrap();
    assert_eq!(board.ask::<Arm>(&()).unwrap(), Err(Refusal::PolarityUnchecked));
}

#[test]
fn an_older_polarity_check_does_not_undo_a_failed_one() {
    let device = rig::device(&paddle_without_back_emf());
    let mut board = Board::with_device(true, &device, &far_wall());
    polarity_check(&mut board, 1.0);
    assert_eq!((board.state(), board.ask::<GetStatus>(&()).unwrap().polarity), (State::Disarmed, true));
    // The motor's wires are swapped, which the next check must find.
    (0..200).for_each(|_| board.tick());
    polarity_check(&mut board, -1.0);
    let fault = board.ask::<GetStatus>(&()).unwrap().fault.map(|record| record.fault);
    assert_eq!(fault, Some(Fault::PolarityWrong));
    board.ask::<Clear>(&()).unwrap().unwrap();
    // The polarity must stay unknown if the same device is loaded, now and after a restart.
    board.ask::<SetDevice>(&device).unwrap().unwrap();
    board.ask::<SetScene>(&far_wall()).unwrap().unwrap();
    (0..200).for_each(|_| board.tick());
    board.ask::<Home>(&()).unwrap().unwrap();
    assert_eq!(board.ask::<Arm>(&()).unwrap(), Err(Refusal::PolarityUnchecked));
    board.ask::<Save>(&()).unwrap().unwrap();
    board.ask::<Restart>(&()).unwrap().unwrap();
    (0..20).for_each(|_| board.tick());
    board.ask::<Home>(&()).unwrap().unwrap();
    assert_eq!(board.ask::<Arm>(&()).unwrap(), Err(Refusal::PolarityUnchecked));
}

#[test]
fn a_fault_with_an_invalid_value_is_published_once() {
    let mut board = board_in_state(BoardState::Ready);
    board.reported_fault = Some((Fault::NotFinite, None, f32::NAN));
    board.tick();
    let published = (0..5).filter(|_| board.service.poll(&mut board.machine).is_some()).count();
    assert_eq!((published, board.service.faults().len()), (1, 1));
}

/// Returns the board's device with twice the inertia, like a device from another board's backup.
fn heavier_device() -> DeviceData {
    let mut description = paddle_without_back_emf();
    description.joints[0].inertia *= 2.0;
    rig::device(&description)
}

#[test]
fn a_restore_changes_all_settings_or_none() {
    let (low, high) = (rules_with_share(0.2), rules_with_share(0.9));
    let board = |fails: bool| {
        let mut board = board_in_state(BoardState::Ready);
        board.ask::<SetRules>(&low).unwrap().unwrap();
        board.ask::<Save>(&()).unwrap().unwrap();
        stage_setting(&mut board, &high).unwrap();
        stage_setting(&mut board, &heavier_device()).unwrap();
        board.machine.flash.fails = fails;
        board
    };
    let both = commit_request(&[Key::Rules, Key::Device]);
    let now = |board: &mut Board| (board.ask::<GetRules>(&()).unwrap(), board.ask::<GetDevice>(&()).unwrap());

    // If the tool ends before its commit, nothing changes, now and after a restart.
    let mut uncommitted = board(false);
    let before = now(&mut uncommitted);
    assert_eq!(before.0, low);
    uncommitted.ask::<Restart>(&()).unwrap().unwrap();
    assert_eq!(now(&mut uncommitted), before);
    assert_eq!(uncommitted.ask::<CommitEntries>(&both).unwrap(), Err(Refusal::BadEntry), "staged in another run");

    // If the flash fails, neither RAM nor flash changes.
    let mut with_failing_flash = board(true);
    assert_eq!(with_failing_flash.ask::<CommitEntries>(&both).unwrap(), Err(Refusal::Flash));
    assert_eq!(now(&mut with_failing_flash), before);

    // If one setting is refused, no setting changes.
    let mut with_bad_setting = board(false);
    stage_setting(&mut with_bad_setting, &rules_with_share(1.5)).unwrap();
    assert_eq!(with_bad_setting.ask::<CommitEntries>(&both).unwrap(), Err(too_high_refusal(1.5)));
    assert_eq!(now(&mut with_bad_setting), before);

    // If all settings fit, all change together.
    let mut restored = board(false);
    restored.ask::<CommitEntries>(&both).unwrap().unwrap();
    assert_eq!(now(&mut restored), (high, Some(heavier_device())));
    assert!(!restored.ask::<GetStatus>(&()).unwrap().homed, "another device must be homed");
    restored.ask::<Restart>(&()).unwrap().unwrap();
    assert_eq!(now(&mut restored), (high, Some(heavier_device())), "after a restart");
}

/// A tool stages settings and ends. The next tool tries to commit them, with or without its own settings.
#[test]
fn a_tool_cannot_commit_the_settings_of_another_tool() {
    let mut board = board_in_state(BoardState::Ready);
    let before = board.ask::<GetRules>(&()).unwrap();
    stage_setting(&mut board, &rules_with_share(0.9)).unwrap();
    let another = |keys: &[Key]| Commit { session: SESSION + 1, ..commit_request(keys) };
    assert_eq!(board.ask::<CommitEntries>(&another(&[Key::Rules])).unwrap(), Err(Refusal::BadEntry));
    let entry = settings::encode(&heavier_device()).unwrap();
    board.ask::<StageEntry>(&WriteEntry { session: SESSION + 1, key: Key::Device, entry }).unwrap().unwrap();
    let both = another(&[Key::Rules, Key::Device]);
    assert_eq!(board.ask::<CommitEntries>(&both).unwrap(), Err(Refusal::BadEntry));
    assert_eq!(board.ask::<GetRules>(&()).unwrap(), before);
    // The first tool cannot commit either, because another tool has begun.
    assert_eq!(board.ask::<CommitEntries>(&commit_request(&[Key::Rules])).unwrap(), Err(Refusal::BadEntry));
    board.ask::<CommitEntries>(&another(&[Key::Device])).unwrap().unwrap();
    assert_eq!(board.ask::<GetDevice>(&()).unwrap(), Some(heavier_device()));
}

/// These bytes must never change, because a tool of any version must be able to stop a board of any version.
#[test]
fn the_request_to_disarm_is_the_same_in_every_version() {
    use postcard_rpc::Endpoint as _;
    assert_eq!(Disarm::REQ_KEY.to_bytes(), [50, 74, 208, 115, 197, 110, 140, 138]);
    assert_eq!(GetInfo::REQ_KEY.to_bytes(), [116, 138, 31, 26, 121, 84, 162, 73]);
    assert_eq!(postcard::to_stdvec(&Outcome::Ok(())).unwrap(), [0], "the body of its reply");
}

#[test]
fn a_board_with_real_motors_starts_with_a_limit_of_5_newtons() {
    let limits = |real| Board::new(real).ask::<GetRules>(&()).unwrap().limits;
    assert_eq!(limits(true), Limits { tip_force: 5.0, ..Limits::default() });
    assert_eq!(limits(false), Limits::default(), "without motors no limit is needed");
    // The rules can raise the limit up to the board's own limit.
    let mut board = Board::new(true);
    let stronger = Limits { tip_force: 9.0, ..limits(true) };
    let rules = Rules { limits: stronger, ..board.ask::<GetRules>(&()).unwrap() };
    board.ask::<SetRules>(&rules).unwrap().unwrap();
    assert_eq!(board.ask::<GetRules>(&()).unwrap().limits, stronger);
}

#[test]
fn a_refusal_for_a_fault_names_its_remedy_once() {
    for fault in Fault::ALL {
        let text = Refusal::Faulted(*fault).to_string();
        assert_eq!((text.matches("haptic faults --clear").count(), text.matches("clear").count()), (1, 1), "{text}");
    }
}

/// Earlier firmware saved a mass matrix under key 4, which this firmware must neither read nor report as damage.
#[test]
fn a_mass_matrix_saved_by_earlier_firmware_is_ignored() {
    let mut board = board_in_state(BoardState::Ready);
    board.ask::<Save>(&()).unwrap().unwrap();
    let before = configuration(&mut board);
    // The entry `mass-model 1` of a five-bar.
    let frozen = b"\x04\x01\x01\0\0\x80\x3f\0\0\x80\x3e\0\0\0\x40\0\0\0\x3e\0\0\0\x3f\0\0\x80\x40\x4d\x3f\x94\x05";
    board.machine.flash.committed.insert(4, frozen.iter().copied().collect());
    board.ask::<Restart>(&()).unwrap().unwrap();
    assert_eq!(configuration(&mut board), before);
    assert!(board.ask::<GetDetails>(&()).unwrap().damage.is_empty());
    assert_eq!(board.ask::<Save>(&()).unwrap(), Ok(()));
}
