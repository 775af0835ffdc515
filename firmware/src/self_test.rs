//! Tests that run before motors may arm: RAM before any of it is used, the image in flash, and, before any pin is
//! driven, that the board is the one that the image is for.
//!
//! A board that fails goes on as far as it can and says so, but never arms: [`failed`] is asked at every arming and
//! every check of polarity.

use core::arch::global_asm;
use core::ptr::addr_of;
use core::sync::atomic::{AtomicBool, AtomicU8, AtomicU32, Ordering};

use haptic_bridge::checksum::Crc32;
use haptic_bridge::safety::fault::{Fault, FaultRecord};

use crate::board::{Board, Pin, Signs, This};

/// The first word that failed the RAM test, 0 where none did. The test writes it, start-up leaves it alone.
#[unsafe(link_section = ".uninit.RAM_FAILED")]
static RAM_FAILED: AtomicU32 = AtomicU32::new(0);

/// The image is as it was built.
static IMAGE_SOUND: AtomicBool = AtomicBool::new(false);

// The RAM test: march C- over stack and statics, word by word, with all bits 0 and all bits 1 (van de Goor 1993): write
// 0; up: read 0, write 1; up: read 1, write 0; down: read 0, write 1; down: read 1, write 0; read 0. It finds bits that
// are stuck, do not change, or change with another word, and addresses that are taken for each other; not bits of one
// word that change together. Start-up calls it with the stack still empty and before any static has its value, so it is
// assembly, uses registers alone, and leaves out what lives through a reset (.uninit). 30 ms at the 16 MHz of a start.
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

/// Compares the image's checksum with the one that `cargo fw` wrote into it: over the vectors, then over everything
/// from the first instruction to the last initial value of a static. Call once, before the watchdog runs.
pub fn image() {
    let initial = addr_of!(__edata) as usize - addr_of!(__sdata) as usize;
    let parts = [
        (addr_of!(__vector_table), addr_of!(_image_check) as usize),
        (addr_of!(__stext), addr_of!(__sidata) as usize + initial),
    ];
    let mut sum = Crc32::new();
    for (start, end) in parts {
        // SAFETY: the linker puts both ends into flash, which nothing writes before the settings are opened.
        sum.take(unsafe { core::slice::from_raw_parts(start, end - start as usize) });
    }
    // SAFETY: a word of flash that the linker placed.
    let written = unsafe { addr_of!(_image_check).read_volatile() };
    IMAGE_SOUND.store(sum.sum() == written, Ordering::Relaxed);
}

/// The pin that is not as on this image's board, [`UNTOLD`] before anybody looked, [`NONE`] where all are.
static STRANGE_PIN: AtomicU8 = AtomicU8::new(UNTOLD);
const UNTOLD: u8 = 0xFF;
const NONE: u8 = 0xFE;

/// Returns true if the chip is on the board that this image is for. Call once, while all pins are as a reset leaves
/// them and the clock of the tasks runs; takes at most 4 ms.
pub fn board() -> bool {
    let Signs { held, open } = This::SIGNS;
    let strange = held.iter().find(|pin| pin.is_open()).or_else(|| open.iter().find(|pin| !pin.is_open()));
    STRANGE_PIN.store(strange.map_or(NONE, |pin| pin.0), Ordering::Relaxed);
    if let Some(Pin(pin)) = strange {
        let port = char::from(b'A' + (pin >> 4));
        defmt::error!(
            "this image is for {=str}, and this board is another: see pin P{=char}{=u8}",
            This::NAME,
            port,
            pin & 15
        );
    }
    strange.is_none()
}

/// The test that failed, if any did.
pub fn failed() -> Option<FaultRecord> {
    let address = RAM_FAILED.load(Ordering::Relaxed);
    let strange = STRANGE_PIN.load(Ordering::Relaxed);
    let (fault, value) = match IMAGE_SOUND.load(Ordering::Relaxed) {
        _ if address != 0 => (Fault::RamDamaged, address as f32),
        false => (Fault::ImageDamaged, 0.0),
        true if strange != NONE => (Fault::WrongBoard, f32::from(strange)),
        true => return None,
    };
    Some(FaultRecord { fault, axis: None, value, step: 0 })
}
