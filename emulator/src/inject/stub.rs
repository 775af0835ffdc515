//! Code in RAM that runs instead of a task of the firmware.

use crate::rig::{Rig, firmware};
use crate::run::MILLISECOND;

/// Address of the stub's code, above all RAM that the firmware uses.
const FREE_RAM: u64 = 0x2001_F000;

/// End of the mangled name of the supervisor's task, which feeds the watchdog.
pub(super) const SUPERVISOR: &str = "10supervisor9supervise4POOL";

/// Replaces the task in `pool` by `code` in free RAM, which runs at the task's next poll. `code` receives the address
/// of the task's poll function.
pub fn replace_task(rig: &Rig, pool: &str, code: impl FnOnce(u32) -> Vec<u32>) {
    let image = firmware(rig.kind);
    let pool = image.find_ending(pool).expect("the task");
    let (from, to) = image.text();
    let place = rig.while_stopped(move |stopped| {
        let is_code = |word: u32| word & 1 == 1 && (from..to).contains(&u64::from(word));
        let mut words = (0..pool.size / 4).map(|nth| pool.address + 4 * nth);
        words.find_map(|at| stopped.word(at).filter(|word| is_code(*word)).map(|word| (at, word)))
    });
    let (at, task) = place.expect("the task's poll function");
    let code = code(task);
    rig.while_stopped(move |stopped| {
        for (to, word) in (FREE_RAM..).step_by(4).zip(code) {
            assert!(stopped.poke(to, word), "there is RAM");
        }
        stopped.poke(at, FREE_RAM as u32 | 1);
    });
}

/// Address of the word that ends the stub's wait when the word is not 0.
pub(super) const NMI_FLAG: u64 = FREE_RAM + 0x100;
/// Address of the word that is 1 while the stub waits.
const NMI_WAIT_FLAG: u64 = NMI_FLAG + 4;

/// Makes a task of the board connect the clock security system to the core. The task waits until [`NMI_FLAG`] is not 0
/// and writes the value to ICSR, whose top bit pends the non-maskable interrupt.
pub(super) fn wire_to_nmi(rig: &Rig) {
    rig.while_stopped(|stopped| [NMI_FLAG, NMI_WAIT_FLAG].map(|at| assert!(stopped.poke(at, 0), "there is RAM")));
    // The code is: ldr r2, =flag; movs r3, #1; str r3, [r2, #4]; again: ldr r3, [r2]; cmp r3, #0; beq again; ldr r2,
    // =ICSR; str r3, [r2]; b .; nop. The two addresses follow.
    let stub = vec![0x2301_4A04, 0x6813_6053, 0xD0FC_2B00, 0x6013_4A02, 0xBF00_E7FE, NMI_FLAG as u32, 0xE000_ED04];
    replace_task(rig, SUPERVISOR, |_| stub);
    let waits =
        rig.shared.board().run_until(50 * MILLISECOND, MILLISECOND, |stopped| stopped.word(NMI_WAIT_FLAG) == Some(1));
    assert!(waits, "the supervisor runs every 20 ms");
}
