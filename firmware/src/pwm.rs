//! The carrier: centre-aligned complementary PWM with dead time on TIM1. A second bridge uses TIM8, in step with TIM1.
//!
//! A timer counts 0 -> top -> 0. At the crest (top) all low-side switches are on: the currents are sampled, and the
//! control interrupt runs its step. A duty written then is preloaded and applies at the next valley, half a carrier
//! period later. The repetition counter stays 0, because it also gates the transfer of preloaded duties, so the control
//! interrupt divides the rate in software. STM32F405 reference manual RM0090, section 17.

use embassy_stm32::gpio::{AfType, Flex, OutputType, Speed};
use embassy_stm32::pac;
use embassy_stm32::pac::gpio::Gpio;
use embassy_stm32::pac::timer::{TimAdv, vals};

use haptic_bridge::drive::carrier::Carrier;

/// Assigns pins to a timer's outputs permanently, with fast edges.
pub fn outputs<const N: usize>(pins: [Flex<'static>; N], alternate_function: u8) {
    for mut pin in pins {
        pin.set_as_af_unchecked(alternate_function, AfType::output(OutputType::PushPull, Speed::VeryHigh));
        core::mem::forget(pin);
    }
}

/// Locks the configuration of these pins of a port until the next reset: mode, type, speed, pulls and alternate
/// function (RM0090 section 8.3.6). Call once per port. The level of a locked output can still be written.
pub fn lock(port: Gpio, pins: u16) {
    const KEY: u32 = 1 << 16;
    let pins = u32::from(pins);
    // Another write to the register would restart the sequence, but no interrupt writes to it.
    for word in [KEY | pins, pins, KEY | pins] {
        port.lckr().write(|w| w.0 = word);
    }
    // The first read ends the sequence, the second returns the result.
    let _ = port.lckr().read();
    if port.lckr().read().0 != KEY | pins {
        defmt::error!("pins {=u32:#x} of a port are not locked", pins);
    }
}

/// Settings of a bridge's timer, written once.
pub struct PwmConfig {
    /// True for each of channels 1 to 3 that drives a bridge. The other channels stay off.
    pub channels: [bool; 3],
    /// Dead time between the two switches of a half bridge, ticks of 1/168 MHz, at most 127.
    pub dead_time: u8,
    /// True if a low level on the break input cuts the outputs in hardware.
    pub break_input: bool,
}

/// Configures a timer as a stopped carrier with its outputs off. Dead time, break input, and idle levels, polarity and
/// mode of the outputs are locked until the next reset. Duties, period and the outputs' enable bit stay writable.
pub fn configure(timer: TimAdv, config: &PwmConfig, carrier: Carrier) {
    timer.cr1().write(|w| {
        w.set_cms(vals::Cms::CENTER_ALIGNED1);
        w.set_arpe(true);
        // Only overflow and underflow cause updates, not the software event below.
        w.set_urs(vals::Urs::COUNTER_ONLY);
    });
    for channel in 0..3 {
        timer.ccmr_output(channel / 2).modify(|w| {
            w.set_ocm(channel % 2, vals::Ocm::PWM_MODE1);
            w.set_ocpe(channel % 2, true);
        });
        timer.ccer().modify(|w| {
            w.set_cce(channel, config.channels[channel]);
            w.set_ccne(channel, config.channels[channel]);
        });
    }
    // Channel 4 has no pin. It is active around the crest, and its rising edge starts the analog conversions.
    timer.ccmr_output(1).modify(|w| {
        w.set_ocm(1, vals::Ocm::PWM_MODE2);
        w.set_ocpe(1, true);
    });
    timer.bdtr().write(|w| {
        w.set_dtg(config.dead_time.min(127));
        // An output that is off drives every switch low instead of floating, also for unused channels.
        w.set_ossi(vals::Ossi::IDLE_LEVEL);
        w.set_ossr(vals::Ossr::IDLE_LEVEL);
        w.set_bkp(0, vals::Bkp::ACTIVE_LOW);
        w.set_bke(0, config.break_input);
        // Only the first write of this register can set the lock (RM0090 section 17.4.18).
        w.set_lock(vals::Lock::LEVEL3);
    });
    set_carrier(timer, carrier);
    timer.egr().write(|w| w.set_ug(true));
}

/// Writes the preloaded period, and duties of one half. Both apply at the next extreme.
pub fn set_carrier(timer: TimAdv, carrier: Carrier) {
    timer.arr().write(|w| w.set_arr(carrier.top));
    timer.ccr(3).write(|w| w.set_ccr(carrier.top - 1));
    for channel in 0..3 {
        timer.ccr(channel).write(|w| w.set_ccr(carrier.top / 2));
    }
}

/// Starts the carriers on one clock edge, then connects TIM1's trigger output to the analog converters.
pub fn start(follower: Option<TimAdv>) {
    let leader = pac::TIM1;
    leader.cr2().modify(|w| w.set_mms(vals::Mms::ENABLE));
    if let Some(follower) = follower {
        follower.smcr().write(|w| {
            w.set_ts(vals::Ts::ITR0);
            w.set_sms(vals::Sms::TRIGGER_MODE);
        });
    }
    leader.smcr().write(|w| w.set_msm(vals::Msm::SYNC));
    leader.cr1().modify(|w| w.set_cen(true));
    if let Some(follower) = follower {
        while !follower.cr1().read().cen() {}
        follower.smcr().write(|w| w.set_sms(vals::Sms::DISABLED));
    }
    leader.cr2().modify(|w| w.set_mms(vals::Mms::COMPARE_OC4));
}

/// Connects (true) or cuts (false) a timer's outputs.
#[inline]
pub fn drive(timer: TimAdv, on: bool) {
    timer.bdtr().modify(|w| w.set_moe(on));
}
