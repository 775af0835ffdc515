//! Events at the USB cable and the computer must not disturb a board.

use std::io;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use haptic_bridge::board::telemetry::Fields;
use haptic_bridge::render::controller::Gains;
use haptic_bridge::render::scene::FeedForward;
use haptic_bridge::safety::fault::{Fault, State};
use haptic_emulator::boards::BoardKind;
use haptic_emulator::contact::NearWall;
use haptic_emulator::rig::Rig;
use haptic_emulator::run::{MICROSECOND, MILLISECOND, SECOND};
use haptic_emulator::usb::Event;
use haptic_host::link::{Board, Wire};
use haptic_sim::{MotorInput, NoisyWire, Random};

use crate::session::WALL;

fn is_replying(rig: &Rig) -> bool {
    Board::over(rig.shared.wire(), "again").is_ok()
}

fn wait_until_ready(rig: &Rig) {
    let ready = rig.shared.board().run_until(2 * SECOND, MILLISECOND, |stopped| stopped.usb().is_ready());
    assert!(ready, "no port after two seconds: {:?}", rig.while_stopped(|stopped| stopped.usb().log().to_vec()));
}

#[test]
fn a_board_replies_after_each_replug() {
    let rig = Rig::empty(BoardKind::OdriveV3);
    for _ in 0..3 {
        rig.while_stopped(|stopped| stopped.usb().plug(false));
        rig.run(200 * MILLISECOND);
        rig.while_stopped(|stopped| stopped.usb().plug(true));
        wait_until_ready(&rig);
        assert!(is_replying(&rig));
    }
    let resets = rig.while_stopped(|stopped| stopped.resets().len());
    assert_eq!(resets, 0, "the chip itself never restarted");
}

#[test]
fn a_board_resumes_with_its_computer() {
    let rig = Rig::empty(BoardKind::OdriveV3);
    rig.while_stopped(|stopped| stopped.usb().suspend(true));
    rig.run(500 * MILLISECOND);
    rig.while_stopped(|stopped| stopped.usb().suspend(false));
    rig.run(100 * MILLISECOND);
    assert!(is_replying(&rig));
    let log = rig.while_stopped(|stopped| stopped.usb().log().to_vec());
    assert!(log.iter().any(|(_, event)| *event == Event::Suspended), "{log:?}");
    assert!(log.iter().any(|(_, event)| *event == Event::Resumed), "{log:?}");
}

#[test]
fn usb_requests_unknown_to_serial_ports_are_stalled() {
    let rig = Rig::empty(BoardKind::HBridgeF405);
    for setup in [[0xC0, 0x55, 0, 0, 0, 0, 64, 0], [0x80, 6, 9, 9, 0, 0, 255, 0], [0x21, 0x77, 1, 0, 0, 0, 0, 0]] {
        rig.while_stopped(move |stopped| stopped.usb().request(setup, &[]));
        rig.run(5 * MILLISECOND);
    }
    let refused = rig.while_stopped(|stopped| stopped.usb().take_replies());
    assert_eq!(refused.len(), 3);
    assert!(refused.iter().all(Result::is_err), "{refused:?}");
    assert!(is_replying(&rig));
    assert_eq!(rig.while_stopped(|stopped| stopped.resets().len()), 0);
}

#[test]
fn a_board_keeps_running_if_its_computer_stops_reading() {
    let mut rig = Rig::with_device(BoardKind::OdriveV3, "pantograph-mk2", |_| ());
    rig.load(WALL);
    rig.home_and_arm();
    rig.tool.start_stream(Fields::ALL, 1).expect("a stream starts");
    let before = rig.tool.rows(Duration::from_millis(50)).expect("rows come").last().expect("a row").step;
    rig.while_stopped(|stopped| stopped.usb().read_port(false));
    rig.run(SECOND);
    rig.while_stopped(|stopped| stopped.usb().read_port(true));
    rig.run(200 * MILLISECOND);
    let status = rig.tool.status().expect("the board replies");
    // 24,000 steps are 1.2 s at 20 kHz, so the control step did not wait.
    assert!(status.step - before > 24_000, "{} steps while the computer did not read", status.step - before);
    assert_eq!(status.fault, None);
    assert_eq!(rig.tool.details().expect("the board replies").overruns, 0);
    rig.tool.rows(Duration::from_millis(100)).expect("rows come again");
    rig.tool.stop_stream().expect("the stream stops");
    let losses = rig.tool.losses();
    assert!(losses.missing > 0, "no row was lost: {losses:?}");
}

/// The board waits at most 100 ms for an entire frame. Without this limit, a host that takes one packet every 90 ms
/// would hold the link task for a second per frame until the watchdog resets the board.
#[test]
fn a_board_keeps_running_if_its_computer_reads_slowly() {
    let mut rig = Rig::with_device(BoardKind::OdriveV3, "pantograph-mk2", |_| ());
    rig.load(WALL);
    rig.home_and_arm();
    rig.tool.start_stream(Fields::ALL, 1).expect("a stream starts");
    rig.tool.rows(Duration::from_millis(50)).expect("rows come");
    for _ in 0..40 {
        rig.while_stopped(|stopped| stopped.usb().read_port(true));
        rig.run(60 * MICROSECOND);
        rig.while_stopped(|stopped| stopped.usb().read_port(false));
        rig.run(90 * MILLISECOND);
        assert_eq!(rig.while_stopped(|stopped| stopped.resets().len()), 0, "the watchdog reset the board");
    }
    rig.while_stopped(|stopped| stopped.usb().read_port(true));
    rig.run(200 * MILLISECOND);
    let status = rig.tool.status().expect("the board replies");
    assert_eq!((status.state, status.fault), (State::Armed, None));
    assert_eq!(rig.tool.details().expect("the board replies").overruns, 0);
}

/// Requests that arrive faster than their replies leave time for the other tasks, which feed the watchdog.
#[test]
fn a_flood_of_requests_leaves_time_for_every_task() {
    let mut rig = Rig::with_device(BoardKind::OdriveV3, "pantograph-mk2", |_| ());
    rig.load(WALL);
    rig.home_and_arm();
    let frames = frames_sent_during(&mut rig, |rig| {
        rig.tool.status().expect("the board replies");
    });
    let flood = frames.last().expect("a request was sent").repeat(3000);
    rig.shared.wire().send(&flood).expect("the port accepts the bytes");
    rig.run(SECOND / 2);
    let resets = rig.while_stopped(|stopped| stopped.resets().len());
    assert_eq!(resets, 0, "the watchdog reset the board");
    rig.while_stopped(|stopped| stopped.usb().take());
    rig.tool = Board::over(rig.shared.wire(), "again").expect("the board replies again");
    let status = rig.tool.status().expect("the board replies");
    assert_eq!((status.state, status.fault), (State::Armed, None));
}

/// If a board is disarmed before a control step has connected the bridges, the next arming must still read the drivers'
/// registers and measure the sensors' zeros, which takes 34 ms.
#[test]
fn every_arming_makes_the_drivers_ready_again() {
    let mut rig = Rig::with_device(BoardKind::OdriveV3, "pantograph-mk2", |_| ());
    rig.load(&format!("rate_hz = 200\n{WALL}"));
    rig.home_and_arm();
    rig.tool.disarm().expect("the board disarms");
    let frames = frames_sent_during(&mut rig, |rig| {
        rig.tool.arm().expect("the board arms");
        rig.tool.disarm().expect("the board disarms");
    });
    let both = frames[frames.len() - 2..].concat();
    for pause in [0, 100 * MILLISECOND] {
        rig.shared.wire().send(&both).expect("the port accepts the bytes");
        rig.run(40 * MILLISECOND + pause);
        rig.while_stopped(|stopped| stopped.usb().take());
        rig.tool = Board::over(rig.shared.wire(), "again").expect("the board replies again");
        let before = rig.now();
        rig.tool.arm().expect("the board arms");
        let took = rig.now() - before;
        assert!(took > 30 * MILLISECOND, "armed after {} us", took / MICROSECOND);
        rig.tool.disarm().expect("the board disarms");
    }
    assert_eq!(rig.while_stopped(|stopped| stopped.resets().len()), 0);
}

struct RecordingWire {
    wire: Box<dyn Wire>,
    sent: Arc<Mutex<Vec<u8>>>,
}

impl Wire for RecordingWire {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.sent.lock().expect("no thread panicked").extend(bytes);
        self.wire.send(bytes)
    }

    fn receive(&mut self, buffer: &mut [u8], timeout: Duration) -> io::Result<usize> {
        self.wire.receive(buffer, timeout)
    }

    fn now(&self) -> Duration {
        self.wire.now()
    }
}

/// Returns the frames that a tool sends while it connects and during `work`.
fn frames_sent_during(rig: &mut Rig, work: impl FnOnce(&mut Rig)) -> Vec<Vec<u8>> {
    let sent = Arc::new(Mutex::new(Vec::new()));
    let wire = RecordingWire { wire: rig.shared.wire(), sent: sent.clone() };
    rig.tool = Board::over(Box::new(wire), "recorded").expect("the board replies");
    work(rig);
    let sent = sent.lock().expect("no thread panicked");
    sent.split_inclusive(|byte| *byte == 0).filter(|frame| frame.len() > 1).map(<[u8]>::to_vec).collect()
}

/// Returns a burst of one of five kinds: silence, noise, random frames, changed requests, or a mixture of requests.
fn burst(random: &mut Random, requests: &[Vec<u8>]) -> Vec<u8> {
    let mut below = |end: usize| random.bits() as usize % end;
    // The longest burst is longer than the port can transfer until the next burst.
    let length = below(3000);
    let mut bytes = Vec::new();
    match below(5) {
        0 => {}
        1 => bytes.extend((0..length).map(|_| below(256) as u8)),
        2 => bytes.extend((0..length).map(|_| if below(24) == 0 { 0 } else { below(256) as u8 })),
        kind => {
            while bytes.len() < length {
                let mut frame = requests[below(requests.len())].clone();
                if kind == 3 || below(2) == 0 {
                    // Few bits change, so the key at the front often stays valid and the board decodes the rest.
                    for _ in 0..1 + below(4) {
                        let at = below(frame.len());
                        frame[at] ^= 1 << below(8);
                    }
                    frame.truncate(1 + below(2 * frame.len()));
                }
                bytes.extend(frame);
            }
        }
    }
    bytes
}

/// Random bytes, random frames and changed requests must not make a disarmed board drive. It must work afterwards.
#[test]
fn a_minute_of_random_bytes_has_no_effect() {
    let mut rig = Rig::with_device(BoardKind::OdriveV3, "pantograph-mk2", |options| options.substep = 25e-6);
    let rules = rig.tool.rules().expect("the board replies");
    // None of these requests moves a motor or writes flash.
    let requests = frames_sent_during(&mut rig, |rig| {
        rig.load(WALL);
        rig.tool.details().expect("the board replies");
        rig.tool.status().expect("the board replies");
        let gains = Gains { wall: 0, stiffness: 500.0, damping: 1.0, feed_forward: FeedForward::Full, washout_hz: 2.0 };
        rig.tool.set_wall_gains(gains).expect("gains change");
        rig.tool.set_rules(&rules).expect("rules change");
        rig.tool.faults().expect("the board replies");
        rig.tool.start_stream(Fields::USUAL, 20).expect("a stream starts");
        rig.tool.stop_stream().expect("the stream stops");
    });
    let mut random = Random::new(0x2F6E_2B1D);
    let (mut sent, mut received, mut steps) = (0, 0, rig.steps());
    for nth in 0..6_000 {
        let burst = burst(&mut random, &requests);
        sent += burst.len();
        rig.while_stopped(move |stopped| {
            // The unsent bytes of the last burst are dropped, so a burst may also begin within a frame.
            stopped.usb().discard();
            stopped.usb().write(&burst);
        });
        rig.run(10 * MILLISECOND);
        let (replies, motor_inputs) =
            rig.while_stopped(|stopped| (stopped.usb().take().len(), stopped.hardware().motor_inputs()));
        received += replies;
        assert_eq!(motor_inputs, [MotorInput::Floating; 3], "burst {nth}");
        // A changed scene may have the lowest rate, at which a burst still lasts two steps.
        let now = rig.steps();
        assert_ne!(now, std::mem::replace(&mut steps, now), "no control step during burst {nth}");
    }
    assert!(sent > 1_000_000 && received > 10_000, "{sent} bytes sent, {received} received");
    rig.while_stopped(|stopped| stopped.usb().discard());
    rig.run(200 * MILLISECOND);
    rig.while_stopped(|stopped| stopped.usb().take());
    assert_eq!(rig.while_stopped(|stopped| stopped.resets().len()), 0);
    rig.tool = Board::over(rig.shared.wire(), "again").expect("the board replies again");
    // A changed scene may contain numbers that are too large to compute with.
    let faults = rig.tool.faults().expect("the board replies");
    assert!(faults.iter().all(|record| record.fault == Fault::NotFinite), "{faults:?}");
    assert!(!rig.tool.status().expect("the board replies").state.drives());
    // A request with a changed byte may have been valid and have lowered a limit.
    rig.tool.set_rules(&rules).expect("rules change");
    rig.load(WALL);
    rig.tool.clear().expect("a latched fault can be cleared");
    rig.home_and_arm();
    rig.tool.disarm().expect("the board disarms");
}

#[test]
fn a_board_survives_repeated_arming_and_replugging() {
    let mut rig = Rig::with_device(BoardKind::OdriveV3, "pantograph-mk2", |_| ());
    rig.load(WALL);
    rig.home_and_arm();
    for cycle in 0..24 {
        rig.tool.disarm().expect("the board disarms");
        rig.tool.arm().expect("the board arms");
        rig.run(cycle * 3 * MILLISECOND);
        if cycle % 6 == 5 {
            rig.while_stopped(|stopped| stopped.usb().plug(false));
            rig.run((1 + cycle) * 5 * MILLISECOND);
            rig.while_stopped(|stopped| stopped.usb().plug(true));
            wait_until_ready(&rig);
            rig.while_stopped(|stopped| stopped.usb().take());
            rig.tool = Board::over(rig.shared.wire(), "again").expect("the board replies again");
            // The rules ignore a silent host, so the wall is still rendered.
            assert_eq!(rig.tool.status().expect("the board replies").state, State::Armed, "cycle {cycle}");
        }
    }
    let status = rig.tool.status().expect("the board replies");
    assert_eq!((status.state, status.fault), (State::Armed, None));
    assert_eq!(rig.tool.details().expect("the board replies").overruns, 0);
    rig.tool.disarm().expect("the board disarms");
    rig.run(MILLISECOND);
    let (motor_inputs, resets) =
        rig.while_stopped(|stopped| (stopped.hardware().motor_inputs(), stopped.resets().len()));
    assert_eq!((motor_inputs, resets), ([MotorInput::Floating; 3], 0));
}

#[test]
fn damaged_frames_do_not_turn_motors_off_for_a_minute() {
    let mut rig = Rig::with_device(BoardKind::OdriveV3, "pantograph-mk2", |options| options.substep = 25e-6);
    rig.arm_near_walls("rate_hz = 1000\ncutoff_hz = 100\n", &[NearWall::with_normal([0.0, -1.0, 0.0])]);
    rig.tool.disarm().expect("it disarms");
    NoisyWire::check_telemetry(rig.shared.wire(), 60_000);
}
