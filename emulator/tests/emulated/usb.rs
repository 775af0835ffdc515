//! Events at the cable and the computer that must not disturb a board.

use std::time::Duration;

use haptic_bridge::board::telemetry::Fields;
use haptic_bridge::safety::fault::State;
use haptic_emulator::boards::BoardKind;
use haptic_emulator::contact::WallAt;
use haptic_emulator::noise;
use haptic_emulator::rig::Rig;
use haptic_emulator::run::{MICROSECOND, MILLISECOND, SECOND};
use haptic_emulator::usb::Event;
use haptic_host::link::Board;
use haptic_sim::{MotorInput, NoisyWire};

use crate::session::WALL;

fn replies(rig: &Rig) -> bool {
    Board::over(rig.shared.wire(), "again").is_ok()
}

fn wait_until_ready(rig: &Rig) {
    let ready = rig.shared.board().run_until(2 * SECOND, MILLISECOND, |stopped| stopped.usb().ready());
    assert!(ready, "no port after two seconds: {:?}", rig.with(|stopped| stopped.usb().log().to_vec()));
}

#[test]
fn a_board_replies_after_each_replug() {
    let rig = Rig::empty(BoardKind::OdriveV3);
    for _ in 0..3 {
        rig.with(|stopped| stopped.usb().plug(false));
        rig.run(200 * MILLISECOND);
        rig.with(|stopped| stopped.usb().plug(true));
        wait_until_ready(&rig);
        assert!(replies(&rig));
    }
    let resets = rig.with(|stopped| stopped.resets().len());
    assert_eq!(resets, 0, "the chip itself never restarted");
}

#[test]
fn a_board_resumes_with_its_computer() {
    let rig = Rig::empty(BoardKind::OdriveV3);
    rig.with(|stopped| stopped.usb().suspend(true));
    rig.run(500 * MILLISECOND);
    rig.with(|stopped| stopped.usb().suspend(false));
    rig.run(100 * MILLISECOND);
    assert!(replies(&rig));
    let log = rig.with(|stopped| stopped.usb().log().to_vec());
    assert!(log.iter().any(|(_, event)| *event == Event::Suspended), "{log:?}");
    assert!(log.iter().any(|(_, event)| *event == Event::Resumed), "{log:?}");
}

#[test]
fn garbage_has_no_reply_and_no_effect() {
    let rig = Rig::empty(BoardKind::HBridgeF405);
    let mut seed: u32 = 0x2F6E_2B1D;
    println!("seed {seed:#x}");
    for _ in 0..20 {
        let noise: Vec<u8> = std::iter::repeat_with(|| {
            seed ^= seed << 13;
            seed ^= seed >> 17;
            seed ^= seed << 5;
            (seed >> 24) as u8
        })
        .take(3000)
        .collect();
        rig.with(move |stopped| stopped.usb().write(&noise));
        rig.run(20 * MILLISECOND);
    }
    rig.with(|stopped| stopped.usb().take());
    // Requests unknown to serial ports are stalled, and the port keeps working.
    for setup in [[0xC0, 0x55, 0, 0, 0, 0, 64, 0], [0x80, 6, 9, 9, 0, 0, 255, 0], [0x21, 0x77, 1, 0, 0, 0, 0, 0]] {
        rig.with(move |stopped| stopped.usb().request(setup, &[]));
        rig.run(5 * MILLISECOND);
    }
    let refused = rig.with(|stopped| stopped.usb().take_replies());
    assert_eq!(refused.len(), 3);
    assert!(refused.iter().all(Result::is_err), "{refused:?}");
    assert!(replies(&rig));
    assert_eq!(rig.with(|stopped| stopped.resets().len()), 0);
}

#[test]
fn a_computer_that_stops_reading_stops_nothing_else() {
    let mut rig = Rig::with_device(BoardKind::OdriveV3, "pantograph-mk2", |_| ());
    rig.load(WALL);
    rig.ready();
    rig.tool.start_stream(Fields::ALL, 1).expect("a stream starts");
    let before = rig.tool.rows(Duration::from_millis(50)).expect("rows come").last().expect("a row").step;
    rig.with(|stopped| stopped.usb().read_port(false));
    rig.run(SECOND);
    rig.with(|stopped| stopped.usb().read_port(true));
    rig.run(200 * MILLISECOND);
    let status = rig.tool.status().expect("the board replies");
    // At least 1.2 s at 20 kHz: the control step did not wait.
    assert!(status.step - before > 24_000, "{} steps", status.step - before);
    assert_eq!(status.fault, None);
    assert_eq!(rig.tool.details().expect("it replies").overruns, 0);
    rig.tool.rows(Duration::from_millis(100)).expect("rows come again");
    rig.tool.stop_stream().expect("the stream stops");
    let losses = rig.tool.losses();
    assert!(losses.missing > 0, "something had to be lost: {losses:?}");
}

/// The board waits at most 100 ms for an entire frame. Without this limit, a host that takes one packet every 90 ms
/// would hold the link task for a second per frame, and the watchdog would bite.
#[test]
fn a_computer_that_reads_slowly_stops_nothing_else() {
    let mut rig = Rig::with_device(BoardKind::OdriveV3, "pantograph-mk2", |_| ());
    rig.load(WALL);
    rig.ready();
    rig.tool.start_stream(Fields::ALL, 1).expect("a stream starts");
    rig.tool.rows(Duration::from_millis(50)).expect("rows come");
    for _ in 0..40 {
        rig.with(|stopped| stopped.usb().read_port(true));
        rig.run(60 * MICROSECOND);
        rig.with(|stopped| stopped.usb().read_port(false));
        rig.run(90 * MILLISECOND);
        assert_eq!(rig.with(|stopped| stopped.resets().len()), 0, "the watchdog bit");
    }
    rig.with(|stopped| stopped.usb().read_port(true));
    rig.run(200 * MILLISECOND);
    let status = rig.tool.status().expect("the board replies");
    assert_eq!((status.state, status.fault), (State::Armed, None));
    assert_eq!(rig.tool.details().expect("it replies").overruns, 0);
}

/// Requests that arrive faster than their replies leave time for the other tasks, which feed the watchdog.
#[test]
fn a_flood_of_requests_starves_no_task() {
    let mut rig = Rig::with_device(BoardKind::OdriveV3, "pantograph-mk2", |_| ());
    rig.load(WALL);
    rig.ready();
    let frames = noise::recorded(&mut rig, |rig| {
        rig.tool.status().expect("it replies");
    });
    let flood = frames.last().expect("a request was sent").repeat(3000);
    rig.shared.wire().send(&flood).expect("the port takes it");
    rig.run(SECOND / 2);
    let resets = rig.with(|stopped| stopped.resets().len());
    assert_eq!(resets, 0, "the watchdog bit");
    rig.with(|stopped| stopped.usb().take());
    rig.tool = Board::over(rig.shared.wire(), "again").expect("the board replies again");
    let status = rig.tool.status().expect("it replies");
    assert_eq!((status.state, status.fault), (State::Armed, None));
}

/// If a board is disarmed before a control step has connected the bridges, the next arming trusts nothing from before:
/// it reads the drivers' registers and learns the zeros again, 34 ms.
#[test]
fn every_arming_makes_the_drivers_ready_again() {
    let mut rig = Rig::with_device(BoardKind::OdriveV3, "pantograph-mk2", |_| ());
    rig.load(&format!("rate_hz = 200\n{WALL}"));
    rig.ready();
    rig.tool.disarm().expect("the board disarms");
    let frames = noise::recorded(&mut rig, |rig| {
        rig.tool.arm().expect("the board arms");
        rig.tool.disarm().expect("the board disarms");
    });
    let both = frames[frames.len() - 2..].concat();
    for pause in [0, 100 * MILLISECOND] {
        rig.shared.wire().send(&both).expect("the port takes it");
        rig.run(40 * MILLISECOND + pause);
        rig.with(|stopped| stopped.usb().take());
        rig.tool = Board::over(rig.shared.wire(), "again").expect("the board replies again");
        let before = rig.now();
        rig.tool.arm().expect("the board arms");
        let took = rig.now() - before;
        assert!(took > 30 * MILLISECOND, "armed after {} us", took / MICROSECOND);
        rig.tool.disarm().expect("the board disarms");
    }
    assert_eq!(rig.with(|stopped| stopped.resets().len()), 0);
}

#[test]
fn a_minute_of_random_bytes_has_no_effect() {
    let seed = 0x2F6E_2B1D;
    println!("seed {seed:#x}");
    let (mut rig, noise) = noise::run(seed, 60, |_| ());
    println!("{noise:?}");
    assert!(
        noise.bytes > 1_000_000 && noise.received > 10_000,
        "the board received the bytes and replied to some: {noise:?}"
    );
    assert!(noise.harmless(), "{noise:?}");
    noise::session_after(&mut rig);
}

#[test]
fn a_board_survives_repeated_arming_and_replugging() {
    let mut rig = Rig::with_device(BoardKind::OdriveV3, "pantograph-mk2", |_| ());
    rig.load(WALL);
    rig.ready();
    for cycle in 0..24 {
        rig.tool.disarm().expect("the board disarms");
        rig.tool.arm().expect("the board arms");
        rig.run(cycle * 3 * MILLISECOND);
        if cycle % 6 == 5 {
            rig.with(|stopped| stopped.usb().plug(false));
            rig.run((1 + cycle) * 5 * MILLISECOND);
            rig.with(|stopped| stopped.usb().plug(true));
            wait_until_ready(&rig);
            rig.with(|stopped| stopped.usb().take());
            rig.tool = Board::over(rig.shared.wire(), "again").expect("the board replies again");
            // The rules ignore a silent host, so the wall is still rendered.
            assert_eq!(rig.tool.status().expect("it replies").state, State::Armed, "cycle {cycle}");
        }
    }
    let status = rig.tool.status().expect("it replies");
    assert_eq!((status.state, status.fault), (State::Armed, None));
    assert_eq!(rig.tool.details().expect("it replies").overruns, 0);
    rig.tool.disarm().expect("the board disarms");
    rig.run(MILLISECOND);
    let (drives, resets) = rig.with(|stopped| (stopped.hardware().drives(), stopped.resets().len()));
    assert_eq!((drives, resets), ([MotorInput::Floating; 3], 0));
}

#[test]
fn damaged_frames_do_not_turn_motors_off_for_a_minute() {
    let mut rig = Rig::with_device(BoardKind::OdriveV3, "pantograph-mk2", |options| options.substep = 25e-6);
    rig.arm_before("rate_hz = 1000\ncutoff_hz = 100\n", &[WallAt::facing([0.0, -1.0, 0.0])]);
    rig.tool.disarm().expect("it disarms");
    NoisyWire::follow(rig.shared.wire(), 60_000);
}
