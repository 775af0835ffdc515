//! Requests in any order, with rates, filters and rules changed while the motors are on. The tests run the fuzzer's
//! targets (fuzz/src/requests.rs) with random scripts. After every control period tests/rig/board.rs checks that
//! bridges and duties are off unless the board is armed, that torques are within the limits, and that limits and rules
//! are never loosened while the motors are on.

#[path = "../../../tests/rig/board.rs"]
mod board;
#[path = "../../../fuzz/src/requests.rs"]
mod requests;
#[path = "../../../fuzz/src/shipped.rs"]
mod shipped;

use haptic_bridge::board::protocol::{Arm, Clear, Force, Home, SetDevice, SetGains, SetRules, SetScene};
use haptic_sim::Random;
use postcard_rpc::Endpoint;
use requests::TEMPLATES;

struct RandomNumbers(Random);

impl RandomNumbers {
    fn byte(&mut self) -> u8 {
        (256.0 * self.0.uniform()) as u8
    }

    fn number_below(&mut self, end: usize) -> usize {
        usize::from(self.byte()) % end
    }
}

/// Returns a script that arms the board again and again, with random requests. One request in eight has changed bytes.
fn script(numbers: &mut RandomNumbers) -> Vec<u8> {
    let place = |key: postcard_rpc::Key| {
        TEMPLATES.iter().position(|(known, _)| *known == key).expect("every endpoint has a template") as u8
    };
    let (arm, clear, home) = (place(Arm::REQ_KEY), place(Clear::REQ_KEY), place(Home::REQ_KEY));
    let wait = TEMPLATES.len() as u8 + 1;
    let endpoint_id = numbers.byte() & 0x7F;
    // The scene belongs to the board's device and has 200 Hz, 1 kHz, 20 kHz or its own rate.
    let own = endpoint_id % shipped::shipped_devices().len() as u8;
    let mut script = vec![endpoint_id, place(SetScene::REQ_KEY), numbers.byte() & 0xC0 | own, 0];
    for round in 0..40 {
        if round % 4 == 0 {
            // Clear faults and home, so that the board can be armed.
            for operation in [clear, home, arm] {
                script.extend([operation, 0, 0]);
            }
            // Wait until, at 200 Hz, half of the torque ramp after arming is over.
            script.extend([wait, 12]);
        }
        if numbers.number_below(3) == 0 {
            let event = numbers.number_below(9);
            script.push((TEMPLATES.len() + event) as u8);
            match event {
                0 => script.extend([numbers.byte(), numbers.byte() & 0x0F, 0]),
                2 => script.extend([24.0_f32, 9.0][numbers.number_below(2)].to_le_bytes()),
                3 => {
                    script.push(numbers.byte());
                    script.extend([0.0_f32, 8.0][numbers.number_below(2)].to_le_bytes());
                }
                4 => script.extend([numbers.byte(), numbers.byte()]),
                6 => {}
                _ => script.push(numbers.byte() & 0x0F),
            }
            continue;
        }
        // Two of three requests could loosen a protection or exceed a loosened limit.
        let pointed = [SetRules::REQ_KEY, Force::REQ_KEY, SetGains::REQ_KEY, SetScene::REQ_KEY];
        let operation = match numbers.number_below(3) {
            0 => numbers.number_below(TEMPLATES.len()) as u8,
            _ => place(pointed[numbers.number_below(4)]),
        };
        // Load another device only rarely, because it has other joints and the rest of the script would have no effect.
        if operation == place(SetDevice::REQ_KEY) && numbers.number_below(4) != 0 {
            continue;
        }
        let variant = if operation == place(SetScene::REQ_KEY) { numbers.byte() & 0xC0 | own } else { numbers.byte() };
        let spoilt = numbers.number_below(8) == 0;
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
fn no_request_sequence_enables_bridges_or_exceeds_limits() {
    let mut numbers = RandomNumbers(Random::new(0x1234_5678));
    let mut armed_count = 0;
    for _ in 0..600 {
        armed_count += requests::requests(&script(&mut numbers));
    }
    assert!(armed_count > 5_000, "the motors were on in only {armed_count} steps, too few to test anything");
}

#[test]
fn random_bytes_change_nothing() {
    let mut numbers = RandomNumbers(Random::new(0x8765_4321));
    for _ in 0..200 {
        let length = 16 * numbers.number_below(64);
        requests::bytes(&(0..length).map(|_| numbers.byte()).collect::<Vec<_>>());
    }
}
