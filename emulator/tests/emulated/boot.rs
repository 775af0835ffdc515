//! From power-on to a configured serial port.

use haptic_emulator::boards::BoardKind;
use haptic_emulator::rig::{Rig, firmware};
use haptic_emulator::run::{MILLISECOND, SECOND};
use haptic_emulator::usb::Event;
use haptic_host::link::{USB_PRODUCT, USB_PRODUCT_NAME, USB_VENDOR};

#[test]
fn a_board_that_started_is_a_serial_port_with_a_fast_flash_and_a_model_for_every_register() {
    for kind in BoardKind::ALL {
        let rig = Rig::empty(kind);
        is_a_serial_port_right_after_enumeration(&rig);
        has_a_flash_as_fast_as_it_can_be(&rig);
        rig.run(SECOND / 10);
        touches_only_registers_with_a_model(&rig);
    }
}

fn is_a_serial_port_right_after_enumeration(rig: &Rig) {
    let (descriptors, log) = rig.with(|stopped| (stopped.usb().descriptors().clone(), stopped.usb().log().to_vec()));
    assert_eq!(descriptors.ids(), (USB_VENDOR, USB_PRODUCT));
    assert!(descriptors.strings.iter().any(|text| text == USB_PRODUCT_NAME), "{:?}", descriptors.strings);
    assert!(!log.iter().any(|(_, event)| matches!(event, Event::Stalled(_) | Event::Left)), "{log:?}");
    let at = |wanted: &Event| log.iter().find(|(_, event)| event == wanted).map(|(at, _)| at.0);
    let connected = at(&Event::Connected).expect("a pull-up");
    let opened = at(&Event::Opened).expect("an open port");
    // RAM and the image are tested before anything else starts: 81 ms as Rust 1.95 compiles it.
    assert!(connected < 100 * MILLISECOND, "the pull-up comes {connected} ns after power-on");
    assert!(opened - connected < 200 * MILLISECOND, "enumeration takes {} ns", opened - connected);
}

fn touches_only_registers_with_a_model(rig: &Rig) {
    let gaps = rig.with(|stopped| stopped.gaps());
    // At boot the bridges are switched off before their clocks run, which a chip ignores. SYSCFG and EXTI hold
    // values that the hardware around the chip acts on.
    let real: Vec<_> = gaps
        .into_iter()
        .filter(|gap| !["SYSCFG", "EXTI", "BDTR is gated", "BSRR is gated"].iter().any(|known| gap.contains(known)))
        .collect();
    assert!(real.is_empty(), "{real:#?}");
}

/// RM0090 section 3.9.1: at 168 MHz five wait states, which take twice the time of the program unless they are hidden.
/// The chip starts with all of this off.
fn has_a_flash_as_fast_as_it_can_be(rig: &Rig) {
    const ACCESS_CONTROL: u32 = 0x00;
    const WAIT_STATES: u64 = 5;
    const PREFETCH_AND_CACHES: u64 = 0b111 << 8;
    let control = rig.with(|stopped| stopped.hardware().chip.register("FLASH", ACCESS_CONTROL));
    assert_eq!(control, PREFETCH_AND_CACHES | WAIT_STATES, "FLASH_ACR is {control:#x}");
}

#[test]
fn the_clock_of_the_tasks_tells_the_time_since_it_started() {
    let rig = Rig::empty(BoardKind::OdriveV3);
    let heard = firmware(rig.kind).find_ending("10supervisor13LAST_HEARD_MS").expect("when a task was heard").address;
    let read = || rig.with(move |stopped| (stopped.word(heard).expect("RAM"), stopped.at / MILLISECOND));
    let (mut before, mut signs) = (read().0, 0);
    let mut started = None;
    // Across some turns of its 16-bit count of microseconds.
    for _ in 0..1_000 {
        rig.run(MILLISECOND);
        let (told, now) = read();
        if told != before {
            // The RAM is tested before that clock runs.
            let behind = now - u64::from(told);
            let start = *started.get_or_insert(behind);
            assert!(start < 50 && behind.abs_diff(start) <= 5, "a task that was heard at {now} ms says {told} ms");
            (before, signs) = (told, signs + 1);
        }
    }
    assert!(signs > 1, "the task gave {signs} signs of life");
}

#[test]
fn two_runs_are_the_same_bit_for_bit() {
    let run = || {
        let rig = Rig::with_device(BoardKind::OdriveV3, "pantograph-mk2", |_| ());
        rig.run(SECOND / 5);
        let board = rig.shared.board();
        (board.now(), board.instructions())
    };
    assert_eq!(run(), run());
}
