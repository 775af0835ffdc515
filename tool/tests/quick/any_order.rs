//! Requests in any order, with rates, filters and rules changed while the motors are on: the fuzzer's own targets
//! (fuzz/src/requests.rs), here with scripts from a generator, so that every run of the tests has them. What must hold
//! after every control period stands in tests/rig/board.rs: bridges and duties off unless armed, torques within the
//! limits, limits and rules never loosened while the motors are on.

#[path = "../../../tests/rig/board.rs"]
mod board;
#[path = "../../../fuzz/src/requests.rs"]
mod requests;
#[path = "../../../fuzz/src/shipped.rs"]
mod shipped;

use haptic_bridge::board::protocol::{Arm, Clear, Force, Home, SetDevice, SetGains, SetRules, SetScene};
use postcard_rpc::Endpoint;
use requests::TEMPLATES;

/// Numbers that look random (Marsaglia's xorshift).
struct Numbers(u32);

impl Numbers {
    fn byte(&mut self) -> u8 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 17;
        self.0 ^= self.0 << 5;
        (self.0 >> 24) as u8
    }

    fn below(&mut self, end: usize) -> usize {
        usize::from(self.byte()) % end
    }
}

/// A script that comes back to an armed board again and again, and does anything in between; every eighth request has
/// bytes changed.
fn script(numbers: &mut Numbers) -> Vec<u8> {
    let place = |key: postcard_rpc::Key| {
        TEMPLATES.iter().position(|(known, _)| *known == key).expect("every endpoint has a template") as u8
    };
    let (arm, clear, home) = (place(Arm::REQ_KEY), place(Clear::REQ_KEY), place(Home::REQ_KEY));
    let wait = TEMPLATES.len() as u8 + 1;
    let which = numbers.byte() & 0x7F;
    // A scene of the board's device, at 200 Hz, 1 kHz, 20 kHz or its own rate.
    let own = which % shipped::shipped().len() as u8;
    let mut script = vec![which, place(SetScene::REQ_KEY), numbers.byte() & 0xC0 | own, 0];
    for round in 0..40 {
        if round % 4 == 0 {
            // Faults cleared, the device at rest, and its encoders still: a board that may be armed.
            for operation in [clear, home, arm] {
                script.extend([operation, 0, 0]);
            }
            // At 200 Hz the ramp after arming is half over then.
            script.extend([wait, 12]);
        }
        if numbers.below(3) == 0 {
            let event = numbers.below(9);
            script.push((TEMPLATES.len() + event) as u8);
            match event {
                0 => script.extend([numbers.byte(), numbers.byte() & 0x0F, 0]),
                2 => script.extend([24.0_f32, 9.0][numbers.below(2)].to_le_bytes()),
                3 => {
                    script.push(numbers.byte());
                    script.extend([0.0_f32, 8.0][numbers.below(2)].to_le_bytes());
                }
                4 => script.extend([numbers.byte(), numbers.byte()]),
                6 => {}
                _ => script.push(numbers.byte() & 0x0F),
            }
            continue;
        }
        // What could loosen a protection, and what would then exceed it, most often.
        let pointed = [SetRules::REQ_KEY, Force::REQ_KEY, SetGains::REQ_KEY, SetScene::REQ_KEY];
        let operation = match numbers.below(3) {
            0 => numbers.below(TEMPLATES.len()) as u8,
            _ => place(pointed[numbers.below(4)]),
        };
        // Another device has other joints: what follows would be of no account.
        if operation == place(SetDevice::REQ_KEY) && numbers.below(4) != 0 {
            continue;
        }
        let variant = if operation == place(SetScene::REQ_KEY) { numbers.byte() & 0xC0 | own } else { numbers.byte() };
        let spoilt = numbers.below(8) == 0;
        script.extend([operation, variant, u8::from(spoilt)]);
        if spoilt {
            script.extend([numbers.byte(), 0, numbers.byte()]);
        }
        if operation == place(Force::REQ_KEY) {
            script.extend([wait, 2]);
        }
    }
    script
}

#[test]
fn no_sequence_of_requests_turns_bridges_on_unasked_or_exceeds_a_limit() {
    let mut numbers = Numbers(0x1234_5678);
    let mut driven = 0;
    for _ in 0..600 {
        driven += requests::requests(&script(&mut numbers));
    }
    assert!(driven > 5_000, "motors were on after {driven} steps only: the scripts reach nothing");
}

#[test]
fn bytes_that_are_no_requests_change_nothing_either() {
    let mut numbers = Numbers(0x8765_4321);
    for _ in 0..200 {
        let length = 16 * numbers.below(64);
        requests::bytes(&(0..length).map(|_| numbers.byte()).collect::<Vec<_>>());
    }
}
