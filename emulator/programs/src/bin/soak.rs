//! `soak HOURS FILE`: runs this number of virtual hours of contact, and as many of random bytes, in parallel on two
//! emulated boards, and writes a report to FILE. `cargo xtask soak --chip` runs it.
//!
//! Exit code 1: something was lost, missed or drifted (with a message), or the file cannot be written; 2: the command
//! is wrong.

use std::process::ExitCode;

use haptic_emulator::{noise, soak};

/// Seed of the noise.
const SEED: u32 = 0x2F6E_2B1D;

fn main() -> ExitCode {
    let mut words = std::env::args().skip(1);
    let hours = words.next().and_then(|word| word.parse::<f64>().ok()).filter(|hours| (0.02..=1000.0).contains(hours));
    let (Some(hours), Some(path)) = (hours, words.next()) else {
        eprintln!("usage: soak HOURS FILE");
        return ExitCode::from(2);
    };
    let seconds = (hours * 3600.0) as u64;
    let (contact, noisy) = std::thread::scope(|scope| {
        let contact = scope.spawn(|| soak::contact(seconds, |minute| eprintln!("contact: {minute} minutes")));
        let noisy = scope.spawn(|| {
            let (mut rig, noise) = noise::run(SEED, seconds, |minute| eprintln!("noise: {minute} minutes"));
            noise::session_after(&mut rig);
            noise
        });
        (contact.join(), noisy.join())
    });
    let (Ok(contact), Ok(noise)) = (contact, noisy) else { return ExitCode::from(1) };
    let text = format!(
        "{contact}\n{hours:.2} virtual hours of random bytes into the USB port of a disarmed board, seed {SEED:#x}: {} bursts, {} bytes \
         (random bytes, random frames, changed and truncated requests), {} bytes received. Bursts after which a bridge \
         was on: {}. Restarts: {}. Bursts without a control step: {}. Faults, except for numbers too large to compute with: {}. The session after it armed and disarmed.\n",
        noise.bursts, noise.bytes, noise.received, noise.driven, noise.restarts, noise.stalled, noise.faults
    );
    print!("{text}");
    match std::fs::write(&path, text) {
        Ok(()) if noise.harmless() => ExitCode::SUCCESS,
        Ok(()) => ExitCode::from(1),
        Err(error) => {
            eprintln!("soak: {path}: {error}");
            ExitCode::from(1)
        }
    }
}
