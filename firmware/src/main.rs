//! The firmware of a haptic-bridge board: start-up and tasks.
//!
//! One interrupt runs the control step ([`interrupt`]); all other work runs in Embassy tasks in thread mode. Only
//! handlers that end in a reset delay the control interrupt (see [`critical`]). The control interrupt delays the rest.
#![no_std]
#![no_main]

mod adc;
#[cfg_attr(feature = "toy-board", allow(dead_code, reason = "the toy board has no absolute encoders"))]
mod angle_sensors;
mod board;
mod clock;
mod critical;
#[allow(dead_code, reason = "not every board has these gate drivers")]
mod drv8301;
mod encoder;
mod frames;
mod gate;
mod index;
mod interrupt;
mod link;
mod machine;
mod pwm;
mod reset;
mod self_test;
mod serial;
mod stack;
mod storage;
mod supervisor;
mod telemetry;
mod warmth;
mod watchdog;
mod zeros;

use defmt_rtt as _;
use embassy_executor::Spawner;
use embassy_stm32::pac;
use haptic_bridge::control::Rules;
use haptic_bridge::control::program::Hardware;
use haptic_bridge::drive::carrier::{CARRIER_MIN_HZ, Carrier};

use crate::board::{Board, This};
use crate::machine::BoardMachine;
use crate::watchdog::Watchdog;

#[embassy_executor::main]
async fn main(spawner: Spawner) {
    This::turn_bridges_off();
    reset::enter_boot_loader_if_requested();
    let start = reset::take_record();
    critical::lower_all();
    if let Some(mut core) = cortex_m::Peripherals::take() {
        // The cycle counter times the control interrupt.
        core.DCB.enable_trace();
        core.DWT.enable_cycle_counter();
    }
    clock::await_supply(This::SUPPLY_LEVEL);
    let chip = clock::start(This::SUPPLY_LEVEL);
    self_test::check_image();
    freeze_carriers_when_halted();
    defmt::info!(
        "{=str} {=str}: started by {}, before that {} at {=u32:#x} (status {=u32:#x}) {=str}; \
         brown-out level {=u8} of 3",
        This::NAME,
        env!("CARGO_PKG_VERSION"),
        start.cause,
        start.previous,
        start.pc,
        start.status,
        start.file,
        clock::brown_out_level()
    );

    let hardware = Hardware {
        axes: This::AXES,
        encoders: This::ENCODERS,
        real: true,
        bus_sensed: true,
        bridge: This::BRIDGE,
        timer_hz: clock::TIMER_HZ,
    };
    let rules = Rules { limits: This::LIMITS, ..Rules::default() };
    let carrier = Carrier::for_rate(clock::TIMER_HZ, CARRIER_MIN_HZ as f32);
    let (io, gate, common) = This::split(chip, carrier, self_test::check_board());
    let control_loop = interrupt::start(io, hardware, rules, warmth::take());
    let storage = storage::open(common.flash);
    let fault = self_test::failed_test().or_else(|| start.fault());
    let serial_number = link::serial_number();
    let machine = BoardMachine::new(control_loop, gate, storage, serial_number, carrier);
    let (usb, serial) = link::device(common.usb, serial_number);

    // Started before any task, because `watchdog::with_longest_time` needs a running watchdog.
    let watchdog = Watchdog::start(common.watchdog);
    spawner.must_spawn(supervisor::supervise(watchdog));
    spawner.must_spawn(link::usb(usb));
    spawner.must_spawn(link::serve(machine, hardware, fault, serial));
}

/// Stops the carriers and the watchdog while a debugger halts the core. The outputs then have their idle level, so that
/// no duty stays applied (RM0090 section 38.16.4).
fn freeze_carriers_when_halted() {
    pac::DBGMCU.apb2fzr().modify(|w| {
        w.set_tim1(true);
        w.set_tim8(true);
    });
    pac::DBGMCU.apb1fzr().modify(|w| w.set_iwdg(true));
}
