//! Fuzzes the board's end of the link by random bytes, and by random requests with random events at encoders, supply
//! and motors. tests/rig/board.rs asserts the invariants.

use super::board::{Board, frame};
use super::shipped::shipped_devices;
use haptic_bridge::board::framing::Decoder;
use haptic_bridge::board::protocol::*;
use haptic_bridge::board::settings::{BoardName, Key, Polarity, encode};
use haptic_bridge::board::telemetry::{Fields, StreamRequest};
use haptic_bridge::control::{HostAction, Rules};
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::model::cogging::{Harmonic, Potentials};
use haptic_bridge::safety::fault::{Fault, State};
use haptic_host::link::Deframer;
use postcard_rpc::Endpoint;
use serde::Serialize;

/// Number of control steps after which an input ends, so that long inputs stay fast.
const MAX_TICKS: u32 = 2_000;

/// Passes bytes to a board and to the tool's decoder, which must find the same frames. The first byte selects a device.
pub fn bytes(data: &[u8]) {
    let [which, data @ ..] = data else { return };
    let mut board = board_with_device(*which);
    let (mut decoder, mut deframer) = (Decoder::default(), Deframer::default());
    for packet in data.chunks(64) {
        let mut frames = completed_frames(&mut decoder, packet);
        for frame in &frames {
            board.answer(frame);
            board.tick();
        }
        // Ignores frames near the maximum length, which the tool may decode or skip.
        frames.retain(|frame| frame.len() <= MAX_FRAME - 8);
        deframer.feed_plain(packet, |frame| assert!(frame.len() > MAX_FRAME - 8 || frame == frames.remove(0)));
        assert!(frames.is_empty(), "the tool missed frames: {frames:?}");
    }
    // After a zero byte the board must decode the next request, regardless of the bytes before.
    completed_frames(&mut decoder, &[0]);
    let request = completed_frames(&mut decoder, &haptic_host::link::encode_plain(&frame(GetStatus::REQ_KEY, &[])));
    assert!(matches!(&request[..], [frame] if board.answer(frame).is_some()), "the board does not reply");
}

fn completed_frames(decoder: &mut Decoder, mut packet: &[u8]) -> Vec<Vec<u8>> {
    let mut frames = Vec::new();
    while !packet.is_empty() {
        let (taken, completed) = decoder.take(packet);
        if completed {
            frames.push(decoder.frame().to_vec());
        }
        packet = &packet[taken..];
    }
    frames
}

/// Runs the operations that the input encodes. Returns the number of operations after which the motors were on.
pub fn requests(data: &[u8]) -> u32 {
    let mut input = Input(data);
    let mut board = board_with_device(input.byte());
    let (mut ticks, mut driven) = (0, 0);
    while !input.0.is_empty() && ticks < MAX_TICKS {
        ticks += run_operation(&mut board, &mut input);
        driven += u32::from(board.state().drives());
    }
    // After any operations, the board must disarm at once and report its state.
    board.ask::<Disarm>(&()).expect("a reply").expect("disarming is never refused");
    assert!(!board.state().drives());
    board.tick();
    assert!(!board.bridges);
    board.ask::<GetStatus>(&()).expect("a status");
    board.ask::<GetDetails>(&()).expect("a description");
    driven
}

fn board_with_device(which: u8) -> Board {
    let all = shipped_devices();
    let shipped = &all[usize::from(which & 0x7F) % all.len()];
    Board::with_device(which & 0x80 != 0, &shipped.device, &shipped.scenes[0])
}

/// Reads and runs one operation. Returns the number of its control steps.
fn run_operation(board: &mut Board, input: &mut Input) -> u32 {
    let operation = usize::from(input.byte());
    let Some(extra) = operation.checked_sub(TEMPLATES.len()) else {
        let body = patch(TEMPLATES[operation].1(input.byte()), input);
        return send(board, TEMPLATES[operation].0, &body);
    };
    match extra % 9 {
        0 => {
            let axis = usize::from(input.byte()) % MAX_JOINTS;
            let moved = i32::from(i16::from_le_bytes([input.byte(), input.byte()]));
            board.samples.counts[axis] = board.samples.counts[axis].wrapping_add(moved);
            board.tick();
            1
        }
        1 => {
            let count = 1 + 4 * u32::from(input.byte());
            (0..count).for_each(|_| board.tick());
            count
        }
        2 => {
            board.samples.bus_voltage = input.float();
            0
        }
        3 => {
            board.samples.currents[usize::from(input.byte()) % MAX_JOINTS] = input.float();
            0
        }
        4 => {
            let fault = Fault::ALL[usize::from(input.byte()) % Fault::ALL.len()];
            board.reported_fault = Some((fault, Some(input.byte()), 1.0));
            board.tick();
            assert!(!board.bridges, "bridges drive after {fault:?}");
            1
        }
        5 => {
            let marks = board.marks.get_or_insert_default();
            marks[usize::from(input.byte()) % MAX_JOINTS] = Some(i32::from(input.byte()));
            board.tick();
            1
        }
        6 => {
            let _ = board.service.poll(&mut board.machine);
            0
        }
        7 => {
            board.machine.flash.fails = input.byte() & 1 == 1;
            0
        }
        _ => spin(board, usize::from(input.byte())),
    }
}

/// Turns a joint of an armed board at twice the speed limit, for at least 500 control steps and 12 counts. The board
/// must turn its motors off. Returns the number of control steps.
fn spin(board: &mut Board, which: usize) -> u32 {
    let Some(device) = board.service.device() else { return 0 };
    let axis = which % device.axes().max(1);
    let limits = board.service.rules().limits.in_units(&device.mechanism.units());
    let (step, limit) = (device.joints[axis].radians_per_count.abs(), limits.speed[axis]);
    // The board checks the limits at every crest of a carrier of at least 20 kHz.
    let counts = 2.0 * limit / step / 20_000.0;
    let ticks = (12.0 / counts).max(500.0);
    if board.state() != State::Armed || !ticks.is_finite() || ticks >= 2_000.0 {
        return 0;
    }
    let from = board.samples.counts[axis];
    for tick in 1..=ticks as u32 {
        board.samples.counts[axis] = from.wrapping_add((counts * tick as f32) as i32);
        board.tick();
    }
    assert!(!board.state().drives(), "joint {axis} moves at twice its limit of {limit} rad/s or m/s");
    ticks as u32
}

fn send(board: &mut Board, key: postcard_rpc::Key, body: &[u8]) -> u32 {
    let before = board.state().drives();
    let answer = board.answer(&frame(key, body));
    assert!(answer.is_some(), "every frame with a header has a reply");
    let may_drive = [Arm::REQ_KEY, ArmHeld::REQ_KEY, CheckPolarity::REQ_KEY, FindStops::REQ_KEY].contains(&key);
    assert!(before || may_drive || !board.state().drives(), "motors on without a request");
    // With 0 ticks, the next request arrives before the next control step.
    let ticks = body.first().map_or(2, |byte| byte % 3);
    (0..ticks).for_each(|_| board.tick());
    ticks.into()
}

/// Changes some bytes of a message, and may cut the message or append bytes. One input byte selects the changes.
fn patch(mut body: Vec<u8>, input: &mut Input) -> Vec<u8> {
    let changes = input.byte();
    for _ in 0..changes & 0x0F {
        let at = usize::from(u16::from_le_bytes([input.byte(), input.byte()]));
        let to = input.byte();
        let length = body.len().max(1);
        if let Some(byte) = body.get_mut(at % length) {
            *byte = to;
        }
    }
    if changes & 0x10 != 0 {
        body.truncate(usize::from(input.byte()));
    }
    if changes & 0x20 != 0 {
        let length = usize::from(input.byte());
        body.extend((0..length).map(|_| input.byte()));
    }
    body
}

/// The unread rest of the input, which returns zeros after its end.
struct Input<'d>(&'d [u8]);

impl Input<'_> {
    fn byte(&mut self) -> u8 {
        let Some((first, rest)) = self.0.split_first() else { return 0 };
        self.0 = rest;
        *first
    }

    fn float(&mut self) -> f32 {
        f32::from_le_bytes([self.byte(), self.byte(), self.byte(), self.byte()])
    }
}

pub type Template = (postcard_rpc::Key, fn(u8) -> Vec<u8>);

fn bytes_of(message: &impl Serialize) -> Vec<u8> {
    postcard::to_stdvec(message).unwrap_or_default()
}

fn empty_body(_: u8) -> Vec<u8> {
    Vec::new()
}

fn scene(which: u8) -> haptic_bridge::render::scene::Scene<f32> {
    let shipped = &shipped_devices()[usize::from(which) % shipped_devices().len()];
    shipped.scenes[usize::from(which / 8) % shipped.scenes.len()].clone()
}

fn device(which: u8) -> DeviceData {
    shipped_devices()[usize::from(which) % shipped_devices().len()].device.clone()
}

/// Returns a potential of the first motor, which is too strong for most devices if `which` is odd.
fn potentials(which: u8) -> Potentials {
    let energy = if which & 1 == 0 { 1e-6 } else { 1.0 };
    let harmonic = Harmonic { order: u16::from(which), energy, phase: f32::from(which) };
    let mut potentials = Potentials::default();
    let _ = potentials.0[0].push(harmonic);
    potentials
}

fn press(which: u8) -> Press {
    Press { holder: u32::from(which & 4), seen: u32::from(which) }
}

/// A valid message for every endpoint, in several variants.
pub const TEMPLATES: &[Template] = &[
    (Arm::REQ_KEY, empty_body),
    (Disarm::REQ_KEY, empty_body),
    (Home::REQ_KEY, empty_body),
    (CheckPolarity::REQ_KEY, empty_body),
    (Clear::REQ_KEY, empty_body),
    (Save::REQ_KEY, empty_body),
    (Restart::REQ_KEY, empty_body),
    (EnterDfu::REQ_KEY, empty_body),
    (GetInfo::REQ_KEY, empty_body),
    (GetDetails::REQ_KEY, empty_body),
    (GetStatus::REQ_KEY, empty_body),
    (GetDevice::REQ_KEY, empty_body),
    (GetScene::REQ_KEY, empty_body),
    (GetRules::REQ_KEY, empty_body),
    (GetCogging::REQ_KEY, empty_body),
    (GetFaults::REQ_KEY, empty_body),
    (SetDevice::REQ_KEY, |which| bytes_of(&device(which))),
    (SetScene::REQ_KEY, |which| {
        let mut scene = scene(which & 0x3F);
        if let Some(rate) = [200.0, 1_000.0, 20_000.0].get(usize::from(which >> 6)) {
            scene.rate_hz = *rate;
            scene.cutoff_hz = scene.cutoff_hz.min(0.4 * rate);
        }
        bytes_of(&scene)
    }),
    (SetGains::REQ_KEY, |which| {
        let wall = scene(which).walls.first().map(|wall| haptic_bridge::render::controller::Gains {
            wall: which % 4,
            stiffness: wall.stiffness,
            damping: wall.damping,
            feed_forward: wall.feed_forward,
            washout_hz: wall.washout_hz,
        });
        let cutoff = [200.0, 1e-6, 1.0, 50.0, 99.0, 900.0, 9_999.0, 0.0][usize::from(which >> 5)];
        bytes_of(&GainsRequest { wall, estimator: Some((scene(which).estimator, cutoff)) })
    }),
    // Each variant tightens another rule, so that a later variant loosens the rule of the previous variant.
    (SetRules::REQ_KEY, |which| {
        let mut rules = Rules::default();
        let share = 1.0 / f32::from(2 + (which >> 3) % 8);
        let tighter = |limit: [f32; MAX_JOINTS]| limit.map(|limit| limit * share);
        let limits = &mut rules.limits;
        match which % 8 {
            0 => limits.torque = tighter(limits.torque),
            1 => limits.current = tighter(limits.current),
            2 => limits.speed = tighter(limits.speed),
            3 => limits.tip_force = share,
            4 => limits.power *= share,
            5 => rules.passivity = true,
            6 => rules.index_period = [i32::from(which >> 4) * 1000; MAX_JOINTS],
            _ if which >> 7 == 0 => rules.host_seconds *= share,
            _ => (rules.host_action, rules.host_seconds) = (HostAction::Ignore, 60.0),
        }
        bytes_of(&rules)
    }),
    (Stream::REQ_KEY, |which| {
        let fields = if which & 1 == 0 { Fields::ALL } else { Fields(u32::from(which)) };
        bytes_of(&StreamRequest { fields, divider: u32::from(which >> 4), stream: u32::from(which) })
    }),
    (ArmHeld::REQ_KEY, |which| bytes_of(&press(which))),
    (SetCogging::REQ_KEY, |which| bytes_of(&potentials(which))),
    (FindStops::REQ_KEY, |which| bytes_of(&press(which))),
    (Heartbeat::REQ_KEY, |which| {
        let held = Beat::Held(press(which));
        bytes_of(&[Beat::Here, held, held, Beat::Released][usize::from(which) % 4])
    }),
    (ReadEntry::REQ_KEY, |which| bytes_of(&Key::ALL[usize::from(which) % Key::ALL.len()])),
    (StageEntry::REQ_KEY, |which| {
        let key = Key::ALL[usize::from(which) % Key::ALL.len()];
        let entry = match key {
            Key::Device => encode(&device(which)),
            Key::Scene => encode(&scene(which)),
            Key::Rules => encode(&Rules::default()),
            Key::Cogging => encode(&potentials(which)),
            Key::Polarity => encode(&Polarity(u32::from(which))),
            Key::Name => encode(&BoardName("bench".chars().collect())),
        };
        bytes_of(&WriteEntry { session: u32::from(which & 1), key, entry: entry.unwrap_or_default() })
    }),
    (CommitEntries::REQ_KEY, |which| {
        let named = Key::ALL.into_iter().enumerate().filter(|(at, _)| which >> at & 1 == 1);
        bytes_of(&Commit { session: u32::from(which & 1), keys: named.map(|(_, key)| key).collect() })
    }),
    (Force::REQ_KEY, |which| {
        let contact = HostContact { point: [0.0; 3], normal: [1.0, 0.0, 0.0], stiffness: 500.0, damping: 1.0 };
        bytes_of(&ForceRequest {
            sequence: u32::from(which),
            seen: (which & 1 == 1).then_some(u32::from(which)),
            hold: 0.01 * f32::from(1 + which % 20),
            fade: 0.01,
            force: [f32::from(which), 0.0, 0.0],
            torque: [0.01 * f32::from(which), 0.0, 0.0],
            contact: (which & 2 == 2).then_some(contact),
        })
    }),
    (SetName::REQ_KEY, |which| bytes_of(&Name::from_iter(std::iter::repeat_n('n', usize::from(which % 33))))),
];
