//! Resets and their causes. A panic, a hard fault, a stopped crystal or a falling supply turns the bridges off, records
//! the cause in memory that survives a reset, and resets. The next start reports the cause ([`RunEnd`]). A request for
//! the USB boot loader is passed on in the same memory.

use core::mem::MaybeUninit;
use core::panic::PanicInfo;
use core::ptr::{addr_of, addr_of_mut};

use cortex_m::peripheral::SCB;
use embassy_stm32::interrupt;
use embassy_stm32::pac;
use haptic_bridge::safety::fault::{Fault, FaultRecord};

use crate::board::{Board, This};

/// Mark of a written record, as opposed to random contents of the SRAM.
const RECORD_MARK: u32 = 0x4C41_5354;
const BOOT_LOADER_MARK: u32 = 0x4446_5521;

/// The record of a run's end. It consists of words only, so that any bit pattern is valid.
#[repr(C)]
#[derive(Clone, Copy)]
struct EndRecord {
    mark: u32,
    /// 1 panic, 2 hard fault, 3 unexpected interrupt, 4 stack overflow, 5 stopped crystal, 6 falling supply.
    kind: u32,
    /// Program counter at a fault, line of a panic, or number of an interrupt.
    pc: u32,
    /// Link register at a fault.
    lr: u32,
    /// Configurable fault status register (RM0090 / ARMv7-M B3.2.15).
    status: u32,
    /// Bus fault address register.
    address: u32,
    /// Address in flash of the file name of a panic.
    file: u32,
    /// Length of the file name of a panic, bytes.
    file_len: u32,
    check: u32,
}

#[unsafe(link_section = ".uninit.END_RECORD")]
static mut END_RECORD: MaybeUninit<EndRecord> = MaybeUninit::uninit();

#[unsafe(link_section = ".uninit.BOOT_REQUEST")]
static mut BOOT_REQUEST: MaybeUninit<u32> = MaybeUninit::uninit();

/// Cause of the last reset, from the chip's reset flags (RM0090 section 7.3.21).
#[derive(Clone, Copy, PartialEq, Eq, Debug, defmt::Format)]
pub enum ResetCause {
    /// The supply was switched on, or dipped.
    Power,
    /// The independent watchdog was not fed.
    Watchdog,
    /// The program reset itself (after a fault, for the boot loader, or on request).
    Software,
    /// The reset pin, or a debugger.
    Pin,
}

/// The end of the previous run.
#[derive(Clone, Copy, PartialEq, Eq, Debug, defmt::Format)]
pub enum RunEnd {
    /// No record was left.
    Clean,
    /// A panic in the file `file`, at the line `pc`.
    Panic,
    /// A hard fault at `pc`.
    HardFault,
    /// A fault while the stack pointer was outside the stack.
    StackOverflow,
    /// An interrupt without a handler.
    UnexpectedInterrupt,
    /// The crystal stopped.
    ClockFailure,
    /// The chip's supply fell.
    SupplyDip,
}

/// Facts about the start of this run.
#[derive(Clone, Copy)]
pub struct Start {
    pub cause: ResetCause,
    /// The end of the previous run.
    pub previous: RunEnd,
    /// Program counter of a fault, line of a panic, or 0 if unknown.
    pub pc: u32,
    /// Fault status register of a hard fault.
    pub status: u32,
    /// File of a panic; "" without a panic.
    pub file: &'static str,
}

impl Start {
    /// Returns the fault that the end of the previous run leaves latched for this run.
    pub fn fault(&self) -> Option<FaultRecord> {
        let (fault, value) = match (self.previous, self.cause) {
            (RunEnd::Panic, _) => (Fault::Panic, self.pc as f32),
            (RunEnd::StackOverflow, _) => (Fault::StackOverflow, 0.0),
            (RunEnd::HardFault | RunEnd::UnexpectedInterrupt, _) => (Fault::HardFault, self.pc as f32),
            (RunEnd::ClockFailure, _) => (Fault::ClockFailure, 0.0),
            (RunEnd::SupplyDip, _) => (Fault::SupplyDip, 0.0),
            (RunEnd::Clean, ResetCause::Watchdog) => (Fault::Watchdog, 0.0),
            (RunEnd::Clean, _) => return None,
        };
        Some(FaultRecord { fault, axis: None, value, step: 0 })
    }
}

impl EndRecord {
    fn sum(&self) -> u32 {
        let words = [self.mark, self.kind, self.pc, self.lr, self.status, self.address, self.file, self.file_len];
        words.iter().fold(0x811C_9DC5_u32, |sum, word| (sum ^ word).wrapping_mul(0x0100_0193))
    }

    /// Returns the name of the panic's file, or "" if the address or length is not plausible.
    fn file(&self) -> &'static str {
        const FLASH: core::ops::Range<u32> = 0x0800_0000..0x0810_0000;
        const MAX_LENGTH: u32 = 128;
        if self.file_len > MAX_LENGTH || !FLASH.contains(&self.file) || !FLASH.contains(&(self.file + self.file_len)) {
            return "";
        }
        // SAFETY: the bytes lie in flash, which is not written meanwhile. `from_utf8` checks that they are text.
        let bytes = unsafe { core::slice::from_raw_parts(self.file as *const u8, self.file_len as usize) };
        core::str::from_utf8(bytes).unwrap_or("")
    }
}

/// Reads and clears the record of the previous run. Call once, before anything else.
pub fn take_record() -> Start {
    // SAFETY: runs once, before interrupts and tasks, so no other code uses the record. All bit patterns are valid.
    let words = unsafe {
        let words = addr_of!(END_RECORD).cast::<EndRecord>().read_volatile();
        addr_of_mut!(END_RECORD).cast::<u32>().write_volatile(0);
        words
    };
    let flags = pac::RCC.csr().read();
    pac::RCC.csr().modify(|w| w.set_rmvf(true));
    let cause = if flags.wdgrstf() || flags.wwdgrstf() {
        ResetCause::Watchdog
    } else if flags.sftrstf() {
        ResetCause::Software
    } else if flags.porrstf() || flags.borrstf() {
        ResetCause::Power
    } else {
        ResetCause::Pin
    };
    let valid = words.mark == RECORD_MARK && words.check == words.sum() && cause != ResetCause::Power;
    let previous = match (valid, words.kind) {
        (true, 1) => RunEnd::Panic,
        (true, 2) => RunEnd::HardFault,
        (true, 3) => RunEnd::UnexpectedInterrupt,
        (true, 4) => RunEnd::StackOverflow,
        (true, 5) => RunEnd::ClockFailure,
        (true, 6) => RunEnd::SupplyDip,
        _ => RunEnd::Clean,
    };
    let known = previous != RunEnd::Clean;
    Start {
        cause,
        previous,
        pc: if known { words.pc } else { 0 },
        status: if known { words.status } else { 0 },
        file: if previous == RunEnd::Panic { words.file() } else { "" },
    }
}

/// Turns the bridges off and resets into the chip's USB boot loader.
pub fn reboot_to_boot_loader() -> ! {
    This::turn_bridges_off();
    // SAFETY: a single aligned word that only the start-up code reads.
    unsafe { addr_of_mut!(BOOT_REQUEST).cast::<u32>().write_volatile(BOOT_LOADER_MARK) };
    SCB::sys_reset()
}

/// Turns the bridges off and restarts the program.
pub fn reboot() -> ! {
    This::turn_bridges_off();
    SCB::sys_reset()
}

/// Jumps to the ROM's boot loader if the previous run requested it. Call before any clock or peripheral is set up.
pub fn enter_boot_loader_if_requested() {
    /// System memory of the STM32F405 (application note AN2606).
    const SYSTEM_MEMORY: u32 = 0x1FFF_0000;
    // SAFETY: no other code runs yet at start-up, which does not initialise the word. The ROM begins with a vector
    // table and expects the chip in its state after a reset.
    unsafe {
        let request = addr_of_mut!(BOOT_REQUEST).cast::<u32>();
        if request.read_volatile() != BOOT_LOADER_MARK {
            return;
        }
        request.write_volatile(0);
        pac::RCC.apb2enr().modify(|w| w.set_syscfgen(true));
        // Maps the system memory to address 0, where the boot loader reads its own vectors.
        pac::SYSCFG.memrm().modify(|w| w.set_mem_mode(1));
        cortex_m::asm::bootload(SYSTEM_MEMORY as *const u32)
    }
}

fn write_down_and_reset(kind: u32, pc: u32, lr: u32, file: (u32, u32)) -> ! {
    let mut words = EndRecord {
        mark: RECORD_MARK,
        kind,
        pc,
        lr,
        // SAFETY: the system control block always exists, and these registers are only read.
        status: unsafe { (*SCB::PTR).cfsr.read() },
        address: unsafe { (*SCB::PTR).bfar.read() },
        file: file.0,
        file_len: file.1,
        check: 0,
    };
    words.check = words.sum();
    // SAFETY: interrupts are off and this function does not return, so no other code uses the record.
    unsafe { addr_of_mut!(END_RECORD).cast::<EndRecord>().write_volatile(words) };
    cortex_m::asm::dsb();
    SCB::sys_reset()
}

/// Records the location of a panic but not its message. The optimiser then removes messages and their formatting from
/// the image, as long as this function is small enough to be inlined.
#[panic_handler]
fn panic(info: &PanicInfo) -> ! {
    // The file's name is part of the image, so its address stays valid.
    match info.location() {
        Some(place) => record_panic(place.line(), place.file().as_ptr() as u32, place.file().len() as u32),
        None => record_panic(0, 0, 0),
    }
}

#[inline(never)]
fn record_panic(line: u32, file: u32, len: u32) -> ! {
    This::turn_bridges_off();
    cortex_m::interrupt::disable();
    write_down_and_reset(1, line, 0, (file, len))
}

/// The entry of every hard fault. It passes the stack pointer of the fault to the handler and gives the handler an
/// empty stack, because an overflow may be the cause. It also cancels the lazy save of the floating-point registers to
/// the old stack (FPCCR.LSPACT, ARMv7-M B3.2.21), because the handler's first floating-point instruction would
/// otherwise fault again, and a fault in this handler locks the core up.
#[unsafe(naked)]
#[unsafe(export_name = "HardFault")]
unsafe extern "C" fn hard_fault_entry() -> ! {
    core::arch::naked_asm!(
        "mrs r0, MSP",
        "ldr r1, =_stack_start",
        "msr MSP, r1",
        "ldr r1, =0xE000EF34",
        "ldr r2, [r1]",
        "bic r2, r2, #1",
        "str r2, [r1]",
        "b {handler}",
        handler = sym hard_fault,
    )
}

unsafe extern "C" {
    static _stack_start: u32;
    static _stack_end: u32;
}

extern "C" fn hard_fault(frame: *const u32) -> ! {
    This::turn_bridges_off();
    cortex_m::interrupt::disable();
    let (bottom, top) = (addr_of!(_stack_end) as usize, addr_of!(_stack_start) as usize);
    let at = frame as usize;
    let inside = at >= bottom && at + 32 <= top && at.is_multiple_of(4);
    let (pc, lr) = if inside {
        // SAFETY: the exception frame lies inside the stack: r0-r3, r12, lr, pc, xPSR (ARMv7-M B1.5.6).
        unsafe { (frame.add(6).read_volatile(), frame.add(5).read_volatile()) }
    } else {
        (0, 0)
    };
    write_down_and_reset(if inside { 2 } else { 4 }, pc, lr, (0, 0))
}

/// Handles a stopped crystal (clock security system). Core and carriers continue at 16 MHz from the chip's own
/// oscillator. A start without a crystal waits for the crystal, with the bridges off.
#[cortex_m_rt::exception]
unsafe fn NonMaskableInt() -> ! {
    record_end(5, 0)
}

/// Handles a falling supply, while the processor is reliable for a few more microseconds. The next start waits for the
/// supply ([`crate::clock::await_supply`]).
#[interrupt]
fn PVD() -> ! {
    record_end(6, 0)
}

/// Turns the bridges off, records the cause and resets. `pc` is the program counter, or the number of an interrupt.
#[inline(never)]
fn record_end(kind: u32, pc: u32) -> ! {
    This::turn_bridges_off();
    cortex_m::interrupt::disable();
    write_down_and_reset(kind, pc, 0, (0, 0))
}

#[cortex_m_rt::exception]
unsafe fn DefaultHandler(number: i16) {
    record_end(3, number as u32)
}
