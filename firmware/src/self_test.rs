//! Self-tests before the motors can be armed: RAM before its first use, image in flash, and the board's identity before
//! any pin is driven.
//!
//! After a failed test the board still runs and reports the failure, but never arms, because arming and polarity check
//! call [`failed_test`].

use core::arch::global_asm;
use core::ptr::addr_of;
use core::sync::atomic::{AtomicBool, AtomicU8, AtomicU32, Ordering};

use haptic_bridge::checksum::Crc32;
use haptic_bridge::safety::fault::{Fault, FaultRecord};

use crate::board::{Board, IdentityPins, Pin, This};

/// Address of the first word that failed the RAM test; 0 if the test passed. Start-up does not initialise it.
#[unsafe(link_section = ".uninit.RAM_FAILED")]
static RAM_FAILED: AtomicU32 = AtomicU32::new(0);
/// True if the image in flash matches its checksum.
static IS_IMAGE_SOUND: AtomicBool = AtomicBool::new(false);

// The RAM test: march C- over stack and statics, word by word, with all bits 0 and all bits 1 (van de Goor 1993): write
// 0; up: read 0, write 1; up: read 1, write 0; down: read 0, write 1; down: read 1, write 0; read 0. It detects stuck
// bits, bits that do not change or that change with another word, and wrong address decoding, but not bits of one word
// that change together. Start-up calls the test with an empty stack and before any static has its value. It is
// therefore assembly, uses only registers, and skips memory that survives a reset (.uninit). It takes 30 ms at 16 MHz.
global_asm!(
    ".section .text.__pre_init, \"ax\"",
    ".global __pre_init",
    ".type __pre_init, %function",
    ".thumb_func",
    "__pre_init:",
    "ldr r0, =_stack_end",
    "ldr r1, =__ebss",
    "movs r2, #0",
    "mvn r3, r2",
    "mov r4, r0",
    "0: str r2, [r4], #4",
    "cmp r4, r1",
    "blo 0b",
    "mov r4, r0",
    "1: ldr r5, [r4]",
    "cmp r5, r2",
    "bne 6f",
    "str r3, [r4], #4",
    "cmp r4, r1",
    "blo 1b",
    "mov r4, r0",
    "2: ldr r5, [r4]",
    "cmp r5, r3",
    "bne 6f",
    "str r2, [r4], #4",
    "cmp r4, r1",
    "blo 2b",
    "mov r4, r1",
    "3: ldr r5, [r4, #-4]!",
    "cmp r5, r2",
    "bne 6f",
    "str r3, [r4]",
    "cmp r4, r0",
    "bhi 3b",
    "mov r4, r1",
    "4: ldr r5, [r4, #-4]!",
    "cmp r5, r3",
    "bne 6f",
    "str r2, [r4]",
    "cmp r4, r0",
    "bhi 4b",
    "mov r4, r0",
    "5: ldr r5, [r4]",
    "cmp r5, r2",
    "bne 6f",
    "adds r4, r4, #4",
    "cmp r4, r1",
    "blo 5b",
    "movs r4, #0",
    "6: ldr r5, ={failed}",
    "str r4, [r5]",
    "bx lr",
    ".size __pre_init, . - __pre_init",
    failed = sym RAM_FAILED,
);

unsafe extern "C" {
    static __vector_table: u8;
    static _image_check: u32;
    static __stext: u8;
    static __sidata: u8;
    static __sdata: u8;
    static __edata: u8;
}

/// Compares the image's checksum with the checksum that `cargo fw` wrote. Both cover the vectors, then everything from
/// the first instruction to the last initial value of a static. Call once, before the watchdog runs.
pub fn check_image() {
    let initial = addr_of!(__edata) as usize - addr_of!(__sdata) as usize;
    let parts = [
        (addr_of!(__vector_table), addr_of!(_image_check) as usize),
        (addr_of!(__stext), addr_of!(__sidata) as usize + initial),
    ];
    let mut sum = Crc32::new();
    for (start, end) in parts {
        // SAFETY: the linker places both ends in flash, which is not written before the settings are opened.
        sum.take(unsafe { core::slice::from_raw_parts(start, end - start as usize) });
    }
    // SAFETY: the linker placed this word in flash.
    let written = unsafe { addr_of!(_image_check).read_volatile() };
    IS_IMAGE_SOUND.store(sum.sum() == written, Ordering::Relaxed);
}

/// Number of the pin that differs from this image's board, [`NOT_CHECKED`], or [`NO_PIN`] if all pins match.
static WRONG_PIN: AtomicU8 = AtomicU8::new(NOT_CHECKED);
const NOT_CHECKED: u8 = 0xFF;
const NO_PIN: u8 = 0xFE;

/// Returns true if the chip is on the board of this image. Call once, while all pins are in their reset state and the
/// tasks' clock runs. Takes at most 4 ms.
pub fn check_board() -> bool {
    let IdentityPins { held_pins, open_pins } = This::IDENTITY;
    let wrong = held_pins.iter().find(|pin| pin.is_open()).or_else(|| open_pins.iter().find(|pin| !pin.is_open()));
    WRONG_PIN.store(wrong.map_or(NO_PIN, |pin| pin.0), Ordering::Relaxed);
    if let Some(Pin(pin)) = wrong {
        let port = char::from(b'A' + (pin >> 4));
        defmt::error!(
            "this image is for {=str}, but pin P{=char}{=u8} is not as on that board",
            This::NAME,
            port,
            pin & 15
        );
    }
    wrong.is_none()
}

/// Returns the fault of the test that failed; `None` if all passed.
pub fn failed_test() -> Option<FaultRecord> {
    let address = RAM_FAILED.load(Ordering::Relaxed);
    let pin = WRONG_PIN.load(Ordering::Relaxed);
    let (fault, value) = match IS_IMAGE_SOUND.load(Ordering::Relaxed) {
        _ if address != 0 => (Fault::RamDamaged, address as f32),
        false => (Fault::ImageDamaged, 0.0),
        true if pin != NO_PIN => (Fault::WrongBoard, f32::from(pin)),
        true => return None,
    };
    Some(FaultRecord { fault, axis: None, value, step: 0 })
}
