//! The promises of docs/safety.md about the chip: motors are off until requested and without the processor, and the
//! watchdog needs all parts of the firmware.

use std::time::Duration;

use haptic_bridge::board::telemetry::{Field, Fields};
use haptic_bridge::render::velocity::{Chosen, Estimator};
use haptic_bridge::safety::fault::{Fault, State};
use haptic_bridge::safety::refusal::Refusal;
use haptic_emulator::boards::{BoardKind, Pin, Wiring};
use haptic_emulator::hardware::Hardware;
use haptic_emulator::inject::{after_crest, bridges_are_off, replace_task};
use haptic_emulator::plant::{Dummy, Peaks};
use haptic_emulator::rig::{Rig, firmware};
use haptic_emulator::run::{MICROSECOND, MILLISECOND, SECOND, VirtualBoard};

use crate::gate::refusal_of;
use crate::session::WALL;

fn armed_rig(kind: BoardKind) -> Rig {
    let mut rig = Rig::with_device(kind, "pantograph-mk2", |_| ());
    rig.load(WALL);
    rig.home_and_arm();
    rig
}

#[test]
fn a_reset_of_an_armed_board_leaves_the_bridges_off() {
    for kind in BoardKind::ALL {
        let rig = armed_rig(kind);
        assert!(!rig.while_stopped(bridges_are_off), "the bridges float before the reset");
        rig.while_stopped(|stopped| stopped.reset());
        rig.run(20 * MICROSECOND);
        assert!(rig.while_stopped(bridges_are_off), "{}", kind.name());
        rig.while_stopped(|stopped| stopped.hardware().peaks = Peaks::default());
        rig.run(40 * MILLISECOND);
        assert!(
            !rig.while_stopped(|stopped| stopped.hardware().peaks.bridge_was_on),
            "{}: within 40 ms after the reset",
            kind.name()
        );
    }
}

/// A current loop that runs while its bridge floats winds up. If bridges waited for the next control step, the loop
/// would run with a floating bridge for up to 100 carrier periods at 200 Hz.
#[test]
fn an_armed_board_drives_from_the_next_crest_at_every_rate() {
    for rate in [200, 1_000] {
        let mut rig = Rig::with_device(BoardKind::HBridgeF405, "pantograph-mk2", |_| ());
        rig.load(&format!("rate_hz = {rate}\ncutoff_hz = 50\n{WALL}"));
        rig.home_and_arm();
        for _ in 0..5 {
            rig.tool.disarm().expect("the board disarms");
            rig.run(7 * MILLISECOND + 300 * MICROSECOND);
            assert!(rig.while_stopped(bridges_are_off), "disarmed");
            rig.tool.arm().expect("the board arms");
            rig.run(60 * MICROSECOND);
            assert!(!rig.while_stopped(bridges_are_off), "{rate} Hz: the board is armed, but the bridges float");
        }
    }
}

/// Offset of DBGMCU's freeze register for peripheral bus 1 (RM0090 section 38.16.4).
const APB1_FREEZE: u32 = 0x08;
/// Offset of DBGMCU's freeze register for peripheral bus 2 (RM0090 section 38.16.5).
const APB2_FREEZE: u32 = 0x0C;
/// Bit that stops the watchdog while the core is halted.
const WATCHDOG_STOPS: u64 = 1 << 12;
/// Bits that stop TIM1 and TIM8 while the core is halted.
const CARRIERS_STOP: u64 = 0b11;

#[test]
fn a_halted_core_stops_the_carriers_and_the_watchdog() {
    for kind in BoardKind::ALL {
        let rig = Rig::empty(kind);
        let (first, second) = rig.while_stopped(|stopped| {
            let chip = &stopped.hardware().chip;
            (chip.register("DBG", APB1_FREEZE), chip.register("DBG", APB2_FREEZE))
        });
        assert_eq!(first & WATCHDOG_STOPS, WATCHDOG_STOPS, "{}", kind.name());
        assert_eq!(second & CARRIERS_STOP, CARRIERS_STOP, "{}", kind.name());
    }
}

/// Offset of TIM1's break and dead-time register.
const BREAK_AND_DEAD_TIME: u32 = 0x44;
/// Main output enable bit of the break and dead-time register.
const MAIN_OUTPUT_ENABLE: u64 = 1 << 15;

#[test]
fn the_break_input_works_without_the_processor() {
    let rig = armed_rig(BoardKind::HBridgeF405);
    let outputs = || {
        rig.while_stopped(|stopped| stopped.hardware().chip.register("TIM1", BREAK_AND_DEAD_TIME) & MAIN_OUTPUT_ENABLE)
    };
    let executed = || rig.shared.board().instructions();
    assert_eq!(outputs(), MAIN_OUTPUT_ENABLE);
    rig.while_stopped(|stopped| stopped.hold_core(true));
    rig.run(MICROSECOND);
    let before = executed();
    rig.while_stopped(|stopped| stopped.hardware().fault_line_shorted = true);
    rig.run(100 * MICROSECOND);
    assert_eq!(outputs(), 0, "the outputs are on");
    assert_eq!(executed(), before, "the processor executed instructions");
}

/// Tests each image on every other board. PB12 is EN_GATE on one board and the pulled-up break input on another. PC6 is
/// an axis's gate or the enable line. PA9 is a gate or carries the cable's 5 V. On a Discovery board with a 3.3 V
/// supply, an accelerometer may hold the pin of an ODrive's divider, and a microphone the pin of a module's divider.
#[test]
fn an_image_on_the_wrong_board_does_not_touch_its_power_stage() {
    let [odrive, module, discovery] = [BoardKind::OdriveV3, BoardKind::HBridgeF405, BoardKind::HBridgeF407Disc1];
    let [odrive_wires, module_wires, discovery_wires] = [odrive, module, discovery].map(Wiring::of_board);
    let with = |pins_held_high| -> &'static Wiring {
        Box::leak(Box::new(Wiring { pins_held_high, supply_mv: 3300, ..*discovery_wires }))
    };
    for (kind, board, strange) in [
        (odrive, module_wires, 0x06),
        (module, odrive_wires, 0x23),
        (odrive, with(discovery_wires.pins_held_high), 0x06),
        (odrive, with(&[Pin('B', 9), Pin('A', 6)]), 0x25),
        (module, with(discovery_wires.pins_held_high), 0x23),
        (module, with(&[Pin('B', 9), Pin('C', 3)]), 0x19),
        (discovery, odrive_wires, 0x24),
        (discovery, module_wires, 0x24),
    ] {
        let mut rig = Rig::on_other_board(kind, board, "pantograph-mk2");
        let untouched = |rig: &Rig| {
            rig.while_stopped(|stopped| !stopped.hardware().peaks.power_pin_was_driven && bridges_are_off(stopped))
        };
        assert!(untouched(&rig), "{} on {}", kind.name(), board.name);
        let fault_of = |rig: &mut Rig| {
            let status = rig.tool.status().expect("the board replies");
            status.fault.map(|record| (record.fault, record.value as u8))
        };
        assert_eq!(fault_of(&mut rig), Some((Fault::WrongBoard, strange)), "{} on {}", kind.name(), board.name);
        assert_eq!(rig.tool.info().board.as_str(), kind.name());
        rig.load("");
        assert_eq!(refusal_of(rig.tool.arm()), Refusal::Faulted(Fault::WrongBoard));
        // After clearing, the board is still wrong. The refusal may name the bus voltage, read from the wrong pin.
        rig.tool.clear().expect("the fault clears");
        rig.tool.home().expect("homed");
        let again = refusal_of(rig.tool.check_polarity());
        assert!(matches!(again, Refusal::Faulted(Fault::WrongBoard) | Refusal::BusVoltage), "{again}");
        rig.run(SECOND / 10);
        rig = rig.restart();
        assert_eq!(fault_of(&mut rig), Some((Fault::WrongBoard, strange)));
        assert!(untouched(&rig), "{} on {}", kind.name(), board.name);
    }
}

/// Images for 3.3 V boards wait for a higher supply voltage than the 3 V of a Discovery board.
#[test]
fn images_of_other_boards_do_not_start_at_three_volts() {
    let wires = Wiring::of_board(BoardKind::HBridgeF407Disc1);
    for kind in [BoardKind::OdriveV3, BoardKind::HBridgeF405] {
        let hardware = Hardware::new(wires, Box::new(Dummy::default())).expect("the board's description is sound");
        let mut board = VirtualBoard::start(firmware(kind), hardware).expect("the image starts");
        board.run(SECOND);
        let (ready, touched) =
            board.while_stopped(|stopped| (stopped.usb().is_ready(), stopped.hardware().peaks.power_pin_was_driven));
        assert!(!ready && !touched, "{}", kind.name());
    }
}

/// Only the supply monitor's interrupt is this fast, because the running step could last up to a period.
#[test]
fn a_falling_supply_floats_the_bridges_within_a_control_step() {
    for kind in BoardKind::ALL {
        let rig = armed_rig(kind);
        after_crest(&rig, 3);
        rig.while_stopped(|stopped| stopped.set_supply(2_600));
        let fell = rig.now();
        while !rig.while_stopped(bridges_are_off) {
            rig.run(MICROSECOND / 10);
        }
        let took = rig.now() - fell;
        assert!(took <= 2 * MICROSECOND, "{}: {took} ns after the supply fell", kind.name());
    }
}

/// A held core executes nothing while carrier and duties continue, like a locked-up core.
#[test]
fn a_halted_core_is_reset_within_twenty_milliseconds() {
    for kind in BoardKind::ALL {
        let rig = armed_rig(kind);
        rig.while_stopped(|stopped| stopped.hold_core(true));
        rig.run(20 * MILLISECOND);
        assert_eq!(rig.while_stopped(|stopped| stopped.resets().len()), 1, "{}", kind.name());
        assert!(rig.while_stopped(bridges_are_off), "{}", kind.name());
    }
}

/// Returns code that stores each value at its address and then continues with the task.
fn store_code(values: &[(u32, u32)], task: u32) -> Vec<u32> {
    let mut code = Vec::new();
    let literals = 2 * values.len() as u32 + 1;
    for nth in 0..values.len() as u32 {
        // The offset to the literals is in words, from the program counter, which is one word ahead.
        let to = literals + 2 * nth - (2 * nth + 1);
        // The code is `ldr r2, [pc, #value]; ldr r3, [pc, #address]; str r2, [r3]; nop`.
        code.extend([(0x4B00 | (to + 1)) << 16 | 0x4A00 | to, 0xBF00_601A]);
    }
    // The code is `ldr.w pc, [pc, #task]`.
    code.push((0xF000 | (8 * values.len() as u32)) << 16 | 0xF8DF);
    code.extend(values.iter().flat_map(|(value, address)| [*value, *address]));
    code.push(task);
    code
}

const TIMERS: [(&str, u32); 2] = [("TIM1", 0x4001_0000), ("TIM8", 0x4001_0400)];
const PORTS: [(&str, u32); 4] =
    [("GPIOA", 0x4002_0000), ("GPIOB", 0x4002_0400), ("GPIOC", 0x4002_0800), ("GPIOE", 0x4002_1000)];
/// Offsets of CCMR1, CCMR2, CCER and BDTR of a timer.
const TIMER_DRIVE_REGISTERS: [u32; 4] = [0x18, 0x1C, 0x20, BREAK_AND_DEAD_TIME];
/// Offsets of MODER and PUPDR of a port.
const PIN_DRIVE_REGISTERS: [u32; 2] = [0x00, 0x0C];

#[test]
fn no_code_can_change_how_gates_are_driven() {
    for kind in BoardKind::ALL {
        let mut rig = armed_rig(kind);
        rig.tool.disarm().expect("the board disarms");
        let timers = if kind == BoardKind::OdriveV3 { &TIMERS[..] } else { &TIMERS[..1] };
        let registers = timers.iter().map(|timer| (timer, &TIMER_DRIVE_REGISTERS[..]));
        let registers = registers.chain(PORTS.iter().map(|port| (port, &PIN_DRIVE_REGISTERS[..])));
        let registers: Vec<(&'static str, u32, u32)> =
            registers.flat_map(|((name, base), all)| all.iter().map(move |at| (*name, *base, *at))).collect();
        let read_registers = |rig: &Rig| {
            let registers = registers.clone();
            rig.while_stopped(move |stopped| {
                let read =
                    |(name, base, at): (&str, u32, u32)| (base + at, stopped.hardware().chip.register(name, at) as u32);
                registers.into_iter().map(read).collect::<Vec<_>>()
            })
        };
        let before = read_registers(&rig);
        let power = rig.kind.power_pins;
        let changed: Vec<(u32, u32)> = registers
            .iter()
            .zip(&before)
            .map(|((name, _, at), (address, value))| {
                let pins = power.iter().filter(|pin| name.ends_with(pin.0)).map(|pin| 0b11 << (2 * pin.1));
                let fields = pins.fold(0, |all, field| all | field);
                let value = match *at {
                    // CCER: inverted outputs. BDTR: no dead time and no break.
                    0x20 => value ^ 0xAAA,
                    BREAK_AND_DEAD_TIME => 0,
                    // CCMR: channels that are active at every count.
                    at if !name.starts_with("GPIO") => value | if at == 0x18 { 0x5050 } else { 0x0050 },
                    // MODER: outputs. PUPDR: pull-ups.
                    _ => value & !fields | fields & 0x5555_5555,
                };
                (value, *address)
            })
            .collect();
        replace_task(&rig, "10supervisor9supervise4POOL", move |task| store_code(&changed, task));
        rig.run(50 * MILLISECOND);
        assert_eq!(read_registers(&rig), before, "{}", kind.name());
    }
}

/// Replaces the task `task` of an armed board by `code`. The watchdog must reset the board after `least` to `most` ms,
/// and the board must report the reset.
fn check_watchdog(task: &'static str, code: impl FnOnce(u32) -> Vec<u32>, least: u64, most: u64) {
    check_watchdog_at(20_000, task, code, least, most);
}

/// Like [`check_watchdog`], at the control rate `rate` (Hz).
fn check_watchdog_at(rate: u32, task: &'static str, code: impl FnOnce(u32) -> Vec<u32>, least: u64, most: u64) {
    let mut rig = Rig::with_device(BoardKind::OdriveV3, "pantograph-mk2", |_| ());
    rig.load(&format!("rate_hz = {rate}\ncutoff_hz = 50\n{WALL}"));
    rig.home_and_arm();
    replace_task(&rig, task, code);
    let began = rig.now();
    let resets = rig.while_stopped(|stopped| stopped.resets().len());
    while rig.while_stopped(|stopped| stopped.resets().len()) == resets {
        rig.run(MILLISECOND);
        assert!(rig.now() < began + most * MILLISECOND, "no reset after {most} ms");
    }
    assert!(rig.now() > began + least * MILLISECOND, "a reset after {} ns", rig.now() - began);
    rig.run(MILLISECOND);
    assert!(rig.while_stopped(bridges_are_off), "bridges are on after the reset");
    let ready = rig.shared.board().run_until(2 * SECOND, MILLISECOND, |stopped| stopped.usb().is_ready());
    assert!(ready, "the USB port did not return");
    rig.tool = haptic_host::link::Board::over(rig.shared.wire(), "again").expect("the board replies");
    let status = rig.tool.status().expect("the board replies");
    assert_eq!((status.state, status.fault.map(|record| record.fault)), (State::Fault, Some(Fault::Watchdog)));
}

#[test]
fn a_stopped_control_interrupt_causes_a_watchdog_reset() {
    // The code disables interrupt 25 (TIM1's update, RM0090 table 61) and then continues with the task: ldr r2, [pc,
    // #8]; ldr r3, [pc, #12]; str r2, [r3]; nop; ldr.w pc, [pc, #8].
    let stub = |task| vec![0x4B03_4A02, 0xBF00_601A, 0xF008_F8DF, 1 << 25, 0xE000_E180, task];
    check_watchdog("10supervisor9supervise4POOL", stub, 3, 30);
}

#[test]
fn a_stopped_link_task_causes_a_watchdog_reset() {
    // The code `bx lr` returns without a sign of life. The watchdog allows this task a second without one.
    check_watchdog("4link5serve4POOL", |_| vec![0x4770_4770], 900, 2_000);
}

#[test]
fn a_fast_control_interrupt_causes_a_watchdog_reset() {
    // The code changes TIM1's carrier from 20 to 25 kHz with the auto-reload register. It also starts the converters a
    // tick before the crest with channel 4's compare register (subs r2, #1; str r2, [r3, #20]). Then it continues with
    // the task.
    let stub = |task| vec![0x4B04_4A03, 0x3A01_601A, 0xBF00_615A, 0xF008_F8DF, 3360, 0x4001_002C, task];
    check_watchdog("10supervisor9supervise4POOL", stub, 40, 300);
    // A check every 20 ms then counts 25 steps instead of 20, which is detected over 80 steps.
    check_watchdog_at(1_000, "10supervisor9supervise4POOL", stub, 40, 400);
}

#[test]
fn a_slow_control_interrupt_causes_a_watchdog_reset() {
    // The code is that of the test for 25 kHz, with a carrier of 16 kHz.
    let stub = |task| vec![0x4B04_4A03, 0x3A01_601A, 0xBF00_615A, 0xF008_F8DF, 5250, 0x4001_002C, task];
    check_watchdog("10supervisor9supervise4POOL", stub, 40, 300);
    check_watchdog_at(1_000, "10supervisor9supervise4POOL", stub, 40, 400);
}

#[test]
fn a_board_with_a_low_supply_stays_off_and_reports_it() {
    let mut rig = armed_rig(BoardKind::OdriveV3);
    rig.while_stopped(|stopped| stopped.set_supply(2700));
    rig.run(100 * MICROSECOND);
    let steps = rig.while_stopped(|stopped| stopped.resets().len());
    for _ in 0..1_000 {
        assert!(rig.while_stopped(bridges_are_off), "bridges are on after {} ns", rig.now());
        rig.run(100 * MICROSECOND);
    }
    let (resets, ready) = rig.while_stopped(|stopped| (stopped.resets().len(), stopped.usb().is_ready()));
    assert!(resets == steps && !ready, "{resets} resets; the board runs with a low supply");
    rig.while_stopped(|stopped| stopped.set_supply(3300));
    assert!(
        rig.shared.board().run_until(2 * SECOND, MILLISECOND, |stopped| stopped.usb().is_ready()),
        "the USB port did not return"
    );
    rig.tool = haptic_host::link::Board::over(rig.shared.wire(), "again").expect("the board replies");
    let status = rig.tool.status().expect("the board replies");
    assert_eq!((status.state, status.fault.map(|record| record.fault)), (State::Fault, Some(Fault::SupplyDip)));
}

#[test]
fn an_idle_board_has_no_watchdog_reset() {
    let mut rig = armed_rig(BoardKind::OdriveV3);
    let _ = rig.tool.rows(Duration::from_millis(10));
    rig.run(2 * SECOND);
    assert_eq!(rig.while_stopped(|stopped| stopped.resets().len()), 0);
    assert_eq!(rig.tool.status().expect("the board replies").state, State::Armed);
}

/// The request makes the board simulate the effect of a single count on a velocity, without feeding the watchdog.
#[test]
fn a_request_for_the_slowest_velocities_is_fast_enough() {
    let slow = |window| Estimator::Difference(Chosen { value: window, filtered: true });
    let mut rig = Rig::with_device(BoardKind::OdriveV3, "pantograph-mk2", |_| ());
    rig.load(&format!("rate_hz = 10000\nestimator = \"difference\"\ndifference_over = 32\ncutoff_hz = 1\n{WALL}"));
    rig.home_and_arm();
    rig.tool.start_stream(Fields::USUAL, 10).expect("a stream starts");
    for (estimator, cutoff) in [(slow(32), 1.0), (slow(31), 0.5), (Estimator::Butterworth, 0.5), (slow(32), 2.0)] {
        rig.tool.set_estimator(estimator, cutoff).expect("the estimator changes while armed");
        rig.run(100 * MILLISECOND);
    }
    assert_eq!(rig.while_stopped(|stopped| stopped.resets().len()), 0);
    assert_eq!(rig.tool.status().expect("the board replies").state, State::Armed);
}

#[test]
fn limits_are_raised_only_while_the_motors_are_off() {
    let mut rig = armed_rig(BoardKind::OdriveV3);
    let own = rig.tool.rules().expect("the board replies");
    let with_torque = |factor: f32| {
        let mut rules = own;
        rules.limits.torque = rules.limits.torque.map(|torque| factor * torque);
        rules
    };
    rig.tool.set_rules(&with_torque(0.5)).expect("lowered while armed");
    assert_eq!(refusal_of(rig.tool.set_rules(&own)), Refusal::Armed);
    assert_eq!(rig.tool.rules().expect("the board replies"), with_torque(0.5), "a refused request changed the rules");
    rig.tool.disarm().expect("the board disarms");
    rig.tool.set_rules(&own).expect("raised with the motors off");
    let raised = refusal_of(rig.tool.set_rules(&with_torque(1.01)));
    assert!(matches!(raised, Refusal::BadLimit(bad) if bad.joint == Some(0)), "above the board's limits: {raised}");
}

#[test]
fn torque_rises_over_half_a_second_after_arming() {
    let mut rig = Rig::with_device(BoardKind::OdriveV3, "pantograph-mk2", |_| ());
    rig.prepare("");
    // A spring to a point 2 cm away from a held tip has a constant torque except for the ramp.
    let [x, y, _] = rig.with_simulated(|device| device.tip());
    rig.set_scene(&format!("[[spring]]\npoint = [{:?}, {y:?}]\nstiffness = 20.0\ndamping = 0.0\n", x + 0.02));
    rig.tool.start_stream(Fields(Field::Torque.bit()), 20).expect("a stream starts");
    rig.tool.arm().expect("the board arms");
    let mut rows = Vec::new();
    while rows.len() < 700 {
        rows.extend(rig.tool.rows(Duration::from_millis(100)).expect("rows come"));
    }
    let torques: Vec<f64> = rows.iter().map(|row| row.values[0].abs()).collect();
    let armed = torques.iter().position(|torque| *torque > 0.0).expect("torque after arming");
    let full = torques[armed + 600];
    assert!(full > 1e-3, "the full torque is {full} N m");
    // There is one row per millisecond.
    for (after, share) in [(5, 0.01), (50, 0.1), (250, 0.5), (450, 0.9), (550, 1.0)] {
        let risen = torques[armed + after] / full;
        assert!((risen - share).abs() < 0.02, "{risen} of the torque after {after} ms");
    }
}
