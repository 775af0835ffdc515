//! Absolute encoders AS5047 and AS5048 on SPI3, a bus that the gate drivers of an ODrive share.
//!
//! A frame has 16 bits at 5.25 MHz, with the clock idle low and data sampled at the falling edge (AS5047D v1-00 and
//! AS5048 v1-06, section SPI). It takes 3.7 us with its select, and a polled wait of at most 8 us: a frame of a hung bus
//! counts as disturbed. The encoder latches its angle at the end of a read command and sends it in the next frame. The
//! control interrupt exchanges a frame with each encoder at the valley, so that the angle of the next crest is half a
//! carrier period old, and another one at the crest.
//!
//! A task exchanges frames only in a gap between two control interrupts, so no frame is interrupted by another.

use core::sync::atomic::{AtomicBool, Ordering};

use embassy_stm32::gpio::{AfType, AnyPin, Flex, Level, Output, OutputType, Pull, Speed};
use embassy_stm32::pac::gpio::Gpio;
use embassy_stm32::pac::spi::vals;
use embassy_stm32::pac::timer::TimGp16;
use embassy_stm32::pac::timer::vals::Dir;
use embassy_stm32::{Peri, pac, peripherals, rcc};
use haptic_bridge::control::absolute::ERROR_FLAG;
use haptic_bridge::control::joints::Counts;
use haptic_bridge::model::catalogue::MAX_JOINTS;

/// A chip select: port and bit.
pub type Select = (Gpio, usize);

/// Command that reads the angle: read bit, address 0x3FFF, even parity.
const READ_ANGLE: u16 = 0xFFFF;
/// Command that reads and clears the error register, address 1.
const CLEAR_ERRORS: u16 = 0x4001;
/// Number of polls of a flag, each at least four core cycles: 8 us.
const POLLS: u32 = 336;
/// Core cycles from select to the first clock edge, and of idle select between two frames: 360 ns, of which AS5047 and
/// AS5048 need 350.
const SELECT_CYCLES: u32 = 60;
/// Core cycles that a frame of a task needs until the next control interrupt, 6 us.
const FRAME_CYCLES: u32 = 1008;
/// Number of looks for a gap, at least 10 ms.
const GAP_LOOKS: u32 = 50_000;

/// True if the control interrupt uses the bus.
static IS_IN_USE: AtomicBool = AtomicBool::new(false);

/// Starts the bus on PC10 (clock), PC11 (from the encoders, pulled up so that a missing encoder shows errors) and PC12.
pub fn start_bus(clock: Peri<'static, AnyPin>, input: Peri<'static, AnyPin>, output: Peri<'static, AnyPin>) {
    rcc::enable_and_reset::<peripherals::SPI3>();
    let driven = AfType::output(OutputType::PushPull, Speed::VeryHigh);
    for (pin, kind) in [(clock, driven), (input, AfType::input(Pull::Up)), (output, driven)] {
        let mut pin = Flex::new(pin);
        pin.set_as_af_unchecked(6, kind);
        core::mem::forget(pin);
    }
    pac::SPI3.cr1().write(|w| {
        w.set_mstr(vals::Mstr::MASTER);
        w.set_cpha(vals::Cpha::SECOND_EDGE);
        w.set_br(vals::Br::DIV8);
        w.set_dff(vals::Dff::BITS16);
        w.set_ssm(true);
        w.set_ssi(true);
        w.set_spe(true);
    });
}

/// Makes a pin an idle chip select.
pub fn idle_select(pin: Peri<'static, AnyPin>) {
    core::mem::forget(Output::new(pin, Level::High, Speed::Medium));
}

/// Exchanges a frame with the chip at `select`. Returns `None` if the bus hangs.
#[inline(never)]
fn exchange((port, bit): Select, frame: u16) -> Option<u16> {
    port.bsrr().write(|w| w.set_br(bit, true));
    cortex_m::asm::delay(SELECT_CYCLES);
    // Drops the rest of a frame that timed out.
    let _ = pac::SPI3.dr().read();
    pac::SPI3.dr().write(|w| w.set_dr(frame));
    let came = (0..POLLS).any(|_| pac::SPI3.sr().read().rxne());
    // The clock falls half a period after the last bit was sampled.
    cortex_m::asm::delay(SELECT_CYCLES / 2);
    port.bsrr().write(|w| w.set_bs(bit, true));
    came.then(|| pac::SPI3.dr().read().dr())
}

/// Exchanges a frame in a task, in a gap between two control interrupts. Returns `None` if the bus hangs or no gap
/// comes.
pub fn exchange_in_task(select: Select, frame: u16) -> Option<u16> {
    let in_gap = |_| critical_section::with(|_| is_in_gap().then(|| exchange(select, frame)));
    (0..GAP_LOOKS).find_map(in_gap).flatten()
}

/// Returns true if a frame ends before the next control interrupt, or if that interrupt does not use the bus.
fn is_in_gap() -> bool {
    if !IS_IN_USE.load(Ordering::Relaxed) {
        return true;
    }
    // The interrupts are at both extremes. One between the two reads of the direction has made them different.
    let rises = || pac::TIM1.cr1().read().dir() == Dir::UP;
    let (before, count, top) = (rises(), pac::TIM1.cnt().read().0, pac::TIM1.arr().read().0);
    let left = if before { top.saturating_sub(count) } else { count };
    rises() == before && left > FRAME_CYCLES
}

/// The absolute encoders of a board, one for each axis at most.
///
/// The counter of an axis's timer stands still and holds the encoder's count, so that counts are read in one way.
pub struct AngleSensors {
    selects: &'static [Select],
    timers: [TimGp16; MAX_JOINTS],
    axes: [bool; MAX_JOINTS],
    /// True for each encoder with errors to clear.
    has_errors: [bool; MAX_JOINTS],
}

impl AngleSensors {
    /// Creates the encoders of axes with these timers, without any in use.
    pub const fn new(selects: &'static [Select], timers: [TimGp16; MAX_JOINTS]) -> Self {
        Self { selects, timers, axes: [false; MAX_JOINTS], has_errors: [true; MAX_JOINTS] }
    }

    /// Uses the absolute encoders of these axes from now on, and the timers of all others. Call while the motors are off.
    pub fn connect(&mut self, axes: [bool; MAX_JOINTS]) {
        for (timer, (_, is_absolute)) in self.timers.iter().zip(self.selects.iter().zip(axes)) {
            timer.cr1().modify(|w| w.set_cen(!is_absolute));
        }
        (self.axes, self.has_errors) = (axes, [true; MAX_JOINTS]);
        IS_IN_USE.store(axes.contains(&true), Ordering::Relaxed);
    }

    /// Lets all encoders latch their angles. Call at a valley.
    #[inline(never)]
    pub fn latch(&mut self) {
        for ((select, used), has_errors) in self.selects.iter().zip(self.axes).zip(self.has_errors) {
            if has_errors && used {
                let _ = exchange(*select, CLEAR_ERRORS);
                cortex_m::asm::delay(SELECT_CYCLES);
            }
            if used {
                let _ = exchange(*select, READ_ANGLE);
            }
        }
    }

    /// Returns the frames with the angles that the encoders latched; `None` if the bus hangs. Call at a crest.
    #[inline(never)]
    pub fn frames(&mut self) -> [Option<u16>; MAX_JOINTS] {
        let mut frames = [None; MAX_JOINTS];
        let encoders = self.selects.iter().zip(self.axes).zip(&mut self.has_errors).zip(&mut frames);
        for (((select, used), has_errors), frame) in encoders {
            if used {
                *frame = exchange(*select, READ_ANGLE);
                *has_errors = frame.is_none_or(|frame| frame & ERROR_FLAG != 0);
            }
        }
        frames
    }

    /// Shows the counts of the encoders in their timers.
    pub fn show(&self, counts: &Counts) {
        for ((timer, used), count) in self.timers.iter().zip(self.axes).zip(counts.iter()) {
            if used {
                timer.cnt().write(|w| w.set_cnt(*count as u16));
            }
        }
    }
}
