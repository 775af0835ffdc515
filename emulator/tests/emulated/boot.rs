//! A board starts from power-on to a configured serial port.

use haptic_emulator::boards::BoardKind;
use haptic_emulator::rig::{Rig, firmware};
use haptic_emulator::run::{MILLISECOND, SECOND};
use haptic_emulator::usb::Event;
use haptic_host::link::{USB_PRODUCT, USB_PRODUCT_NAME, USB_VENDOR};

#[test]
fn a_booted_board_has_usb_a_fast_flash_and_modelled_registers() {
    for kind in BoardKind::ALL {
        let rig = Rig::empty(kind);
        check_serial_port(&rig);
        check_flash_speed(&rig);
        rig.run(SECOND / 10);
        check_register_models(&rig);
    }
}

fn check_serial_port(rig: &Rig) {
    let (descriptors, log) =
        rig.while_stopped(|stopped| (stopped.usb().descriptors().clone(), stopped.usb().log().to_vec()));
    assert_eq!(descriptors.ids(), (USB_VENDOR, USB_PRODUCT));
    assert!(descriptors.strings.iter().any(|text| text == USB_PRODUCT_NAME), "{:?}", descriptors.strings);
    assert!(!log.iter().any(|(_, event)| matches!(event, Event::Stalled(_) | Event::Disconnected)), "{log:?}");
    let at = |wanted: &Event| log.iter().find(|(_, event)| event == wanted).map(|(at, _)| at.0);
    let connected = at(&Event::Connected).expect("a pull-up");
    let opened = at(&Event::Opened).expect("an open port");
    // RAM and the image are tested first, which takes 105 ms as compiled by Rust 1.95.
    assert!(connected < 150 * MILLISECOND, "the pull-up comes {connected} ns after power-on");
    assert!(opened - connected < 200 * MILLISECOND, "the enumeration takes {} ns", opened - connected);
}

fn check_register_models(rig: &Rig) {
    let gaps = rig.while_stopped(|stopped| stopped.unmodelled_accesses());
    // At the start the firmware switches the bridges off before their clocks run, and a chip ignores these writes.
    // SYSCFG and EXTI only store values that the hardware around the chip reads.
    let real: Vec<_> = gaps
        .into_iter()
        .filter(|gap| !["SYSCFG", "EXTI", "BDTR is gated", "BSRR is gated"].iter().any(|known| gap.contains(known)))
        .collect();
    assert!(real.is_empty(), "{real:#?}");
}

/// The flash has five wait states at 168 MHz (RM0090 section 3.9.1), which double the run time unless prefetch and
/// caches hide them. A reset turns prefetch and caches off.
fn check_flash_speed(rig: &Rig) {
    const ACCESS_CONTROL: u32 = 0x00;
    const WAIT_STATES: u64 = 5;
    const PREFETCH_AND_CACHES: u64 = 0b111 << 8;
    let control = rig.while_stopped(|stopped| stopped.hardware().chip.register("FLASH", ACCESS_CONTROL));
    assert_eq!(control, PREFETCH_AND_CACHES | WAIT_STATES, "FLASH_ACR is {control:#x}");
}

#[test]
fn the_tasks_clock_counts_the_time_since_its_start() {
    let rig = Rig::empty(BoardKind::OdriveV3);
    let address = firmware(rig.kind)
        .find_ending("10supervisor14LAST_REPORT_MS")
        .expect("time of a task's last sign of life")
        .address;
    let read = || rig.while_stopped(move |stopped| (stopped.word(address).expect("RAM"), stopped.at / MILLISECOND));
    let (mut before, mut signs) = (read().0, 0);
    let mut started = None;
    // The time includes several overflows of the clock's 16-bit count of microseconds.
    for _ in 0..1_000 {
        rig.run(MILLISECOND);
        let (shown, now) = read();
        if shown != before {
            // The RAM is tested before the clock runs.
            let behind = now - u64::from(shown);
            let start = *started.get_or_insert(behind);
            assert!(
                start < 50 && behind.abs_diff(start) <= 5,
                "a task's sign of life at {now} ms has the time {shown} ms"
            );
            (before, signs) = (shown, signs + 1);
        }
    }
    assert!(signs > 1, "the task gave {signs} signs of life");
}

#[test]
fn two_runs_are_equal_bit_for_bit() {
    let run = || {
        let rig = Rig::with_device(BoardKind::OdriveV3, "pantograph-mk2", |_| ());
        rig.run(SECOND / 5);
        let board = rig.shared.board();
        (board.now(), board.instructions())
    };
    assert_eq!(run(), run());
}
