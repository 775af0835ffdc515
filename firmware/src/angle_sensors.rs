//! Absolute encoders AS5047 and AS5048 on SPI3, a bus that the gate drivers of an ODrive share.
//!
//! A frame has 16 bits at 5.25 MHz, with the clock idle low and data sampled at the falling edge (AS5047D v1-00 and
//! AS5048 v1-06, section SPI). It takes 3.8 us with its select. The encoder latches its angle at the end of a read command
//! and sends it in the next frame. The control interrupt starts two frames with each encoder at the valley: all encoders
//! latch, then all reply. The bus's own interrupt continues the frames, so the core waits only for the selects. The angle of
//! a crest is therefore half a carrier period old. Frames that are not complete at the crest count as disturbed.
//!
//! A task exchanges frames only in a gap between two control interrupts while no other frame is under way.

use core::cell::UnsafeCell;
use core::sync::atomic::{AtomicBool, Ordering};

use embassy_stm32::gpio::{AfType, AnyPin, Flex, Level, Output, OutputType, Pull, Speed};
use embassy_stm32::interrupt;
use embassy_stm32::interrupt::InterruptExt;
use embassy_stm32::pac::gpio::Gpio;
use embassy_stm32::pac::spi::vals;
use embassy_stm32::pac::timer::TimGp16;
use embassy_stm32::pac::timer::vals::Dir;
use embassy_stm32::{Peri, pac, peripherals, rcc};
use haptic_bridge::control::absolute::ERROR_FLAG;
use haptic_bridge::control::joints::Counts;
use haptic_bridge::model::catalogue::MAX_JOINTS;

use crate::critical;

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

/// An encoder on the bus.
#[derive(Clone, Copy)]
struct Encoder {
    select: Select,
    /// True if the encoder has errors to clear.
    has_errors: bool,
    /// Reply to the encoder's last frame of this carrier period.
    reply: Option<u16>,
}

/// The frames of a carrier period: one with each encoder, and then another one with each encoder.
struct Frames {
    /// The encoders of all axes with an absolute encoder, and the number of the axis.
    encoders: [Option<(usize, Encoder)>; MAX_JOINTS],
    /// Place of the encoder whose frame is under way.
    current: usize,
    is_second: bool,
}

impl Frames {
    /// Begins the current frame. After the last frame, turns the bus's interrupt off.
    fn begin(&mut self) {
        if !matches!(self.encoders.get(self.current), Some(Some(_))) && !self.is_second {
            (self.current, self.is_second) = (0, true);
        }
        match self.encoders.get(self.current) {
            Some(Some((_, encoder))) => {
                let clears = encoder.has_errors && !self.is_second;
                begin(encoder.select, if clears { CLEAR_ERRORS } else { READ_ANGLE });
            }
            _ => set_interrupt(false),
        }
    }

    /// Ends the current frame, whose reply has arrived, and begins the next frame.
    fn advance(&mut self) {
        if let Some(Some((_, encoder))) = self.encoders.get_mut(self.current) {
            let reply = end(encoder.select);
            encoder.reply = if self.is_second { Some(reply) } else { None };
        }
        self.current += 1;
        self.begin();
    }
}

/// The frames that the control interrupt and the bus's interrupt share.
struct SharedFrames(UnsafeCell<Frames>);

// SAFETY: while the bus's interrupt is on, only that interrupt uses the frames. While it is off, only the control
// interrupt does.
unsafe impl Sync for SharedFrames {}

static FRAMES: SharedFrames =
    SharedFrames(UnsafeCell::new(Frames { encoders: [None; MAX_JOINTS], current: 0, is_second: false }));

#[interrupt]
fn SPI3() {
    // An interrupt that was pending while it was turned off finds no reply.
    if pac::SPI3.cr2().read().rxneie() && pac::SPI3.sr().read().rxne() {
        // SAFETY: the bus's interrupt is on, and it does not nest.
        unsafe { &mut *FRAMES.0.get() }.advance();
    }
}

fn set_interrupt(on: bool) {
    pac::SPI3.cr2().write(|w| w.set_rxneie(on));
}

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
    // The frames continue while the control interrupt runs. The interrupt takes less than a microsecond.
    interrupt::SPI3.set_priority(critical::SUPPLY);
    // SAFETY: the interrupt uses only the shared frames.
    unsafe { interrupt::SPI3.enable() };
}

/// Makes a pin an idle chip select.
pub fn idle_select(pin: Peri<'static, AnyPin>) {
    core::mem::forget(Output::new(pin, Level::High, Speed::Medium));
}

/// Selects a chip and begins a frame.
fn begin((port, bit): Select, command: u16) {
    port.bsrr().write(|w| w.set_br(bit, true));
    cortex_m::asm::delay(SELECT_CYCLES);
    // Drops the rest of a frame that timed out.
    let _ = pac::SPI3.dr().read();
    pac::SPI3.dr().write(|w| w.set_dr(command));
}

/// Ends a frame whose reply has arrived, and returns the reply.
fn end((port, bit): Select) -> u16 {
    // The clock falls half a period, 16 core cycles, after the last bit was sampled.
    let reply = pac::SPI3.dr().read().dr();
    cortex_m::asm::delay(8);
    port.bsrr().write(|w| w.set_bs(bit, true));
    reply
}

/// Exchanges a frame with the chip at `select`. Returns `None` if the bus hangs.
#[inline(never)]
fn exchange(select: Select, command: u16) -> Option<u16> {
    begin(select, command);
    let came = (0..POLLS).any(|_| pac::SPI3.sr().read().rxne());
    let reply = end(select);
    came.then_some(reply)
}

/// Exchanges a frame in a task, in a gap between two control interrupts. Returns `None` if the bus hangs or no gap
/// comes.
pub fn exchange_in_task(select: Select, frame: u16) -> Option<u16> {
    let in_gap = |_| critical_section::with(|_| is_in_gap().then(|| exchange(select, frame)));
    (0..GAP_LOOKS).find_map(in_gap).flatten()
}

/// Returns true if no frame is under way and a frame ends before the next control interrupt, or if that interrupt does
/// not use the bus.
fn is_in_gap() -> bool {
    if !IS_IN_USE.load(Ordering::Relaxed) {
        return true;
    }
    // The interrupts are at both extremes. One between the two reads of the direction has made them different.
    let rises = || pac::TIM1.cr1().read().dir() == Dir::UP;
    let (before, count, top) = (rises(), pac::TIM1.cnt().read().0, pac::TIM1.arr().read().0);
    let left = if before { top.saturating_sub(count) } else { count };
    rises() == before && left > FRAME_CYCLES && !pac::SPI3.cr2().read().rxneie()
}

/// The absolute encoders of a board, one for each axis at most.
///
/// The counter of an axis's timer stands still and holds the encoder's count, so that counts are read in one way.
pub struct AngleSensors {
    selects: &'static [Select],
    timers: [TimGp16; MAX_JOINTS],
    axes: [bool; MAX_JOINTS],
}

impl AngleSensors {
    /// Creates the encoders of axes with these timers, without any in use.
    pub const fn new(selects: &'static [Select], timers: [TimGp16; MAX_JOINTS]) -> Self {
        Self { selects, timers, axes: [false; MAX_JOINTS] }
    }

    /// Uses the absolute encoders of these axes from now on, and the timers of all others. Call while the motors are off.
    pub fn connect(&mut self, axes: [bool; MAX_JOINTS]) {
        let mut encoders = [None; MAX_JOINTS];
        let mut free = encoders.iter_mut();
        for (axis, ((timer, select), is_absolute)) in self.timers.iter().zip(self.selects).zip(axes).enumerate() {
            timer.cr1().modify(|w| w.set_cen(!is_absolute));
            if is_absolute && let Some(encoder) = free.next() {
                *encoder = Some((axis, Encoder { select: *select, has_errors: true, reply: None }));
            }
        }
        self.stopped_frames().encoders = encoders;
        self.axes = axes;
        IS_IN_USE.store(axes.contains(&true), Ordering::Relaxed);
    }

    /// Begins the frames in which all encoders latch their angles and reply. Call at a valley.
    #[inline(never)]
    pub fn latch(&mut self) {
        let frames = self.stopped_frames();
        (frames.current, frames.is_second) = (0, false);
        frames.begin();
        set_interrupt(true);
    }

    /// Returns the frames with the angles that the encoders latched; `None` for a frame that has not arrived, or of an
    /// encoder whose errors were cleared. Call at a crest.
    #[inline(never)]
    pub fn frames(&mut self) -> [Option<u16>; MAX_JOINTS] {
        let mut found = [None; MAX_JOINTS];
        for (axis, encoder) in self.stopped_frames().encoders.iter_mut().flatten() {
            let (reply, has_cleared) = (encoder.reply.take(), encoder.has_errors);
            encoder.has_errors = reply.is_none_or(|reply| !has_cleared && reply & ERROR_FLAG != 0);
            if let Some(found) = found.get_mut(*axis)
                && !has_cleared
            {
                *found = reply;
            }
        }
        found
    }

    /// Ends a frame that is under way, and returns the frames.
    fn stopped_frames(&mut self) -> &mut Frames {
        if pac::SPI3.cr2().read().rxneie() {
            set_interrupt(false);
            for (port, bit) in self.selects {
                port.bsrr().write(|w| w.set_bs(*bit, true));
            }
        }
        // SAFETY: the bus's interrupt is off, and the board has one `AngleSensors`, which the control interrupt owns.
        unsafe { &mut *FRAMES.0.get() }
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
