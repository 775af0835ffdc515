//! The wiring pages agree with the wiring of the emulated boards.

use std::path::{Path, PathBuf};

use haptic_emulator::boards::{BoardKind, Pin, Wiring};
use haptic_emulator::drawing::draw;

fn documents() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs")
}

#[test]
fn the_drawing_agrees_with_the_wiring() {
    let title = "STM32F407G-DISC1 with three H-bridges: the chip's pins";
    let dividers = ["10 kΩ over 15 kΩ", "11 kΩ over 1 kΩ"];
    let picture = draw(Wiring::of(BoardKind::HBridgeF407Disc1), title, dividers);
    let drawn = picture.svg();
    let path = documents().join("drawings/h-bridge-f407-disc1.svg");
    if std::env::var_os("UPDATE_DOCS").is_some() {
        std::fs::write(&path, drawn).expect("the drawing can be written");
    }
    let recorded = std::fs::read_to_string(&path).expect("the drawing exists");
    assert_eq!(recorded, drawn, "run UPDATE_DOCS=1 cargo test -p haptic-emulator --test emulated drawing::");
}

/// A pin on a page that differs from the tests would be wired without being tested.
#[test]
fn each_page_contains_every_pin_in_its_table() {
    for kind in BoardKind::ALL {
        let wiring = Wiring::of(kind);
        let page = std::fs::read_to_string(documents().join(format!("wiring-{}.md", wiring.name))).expect("a page");
        let table = page.lines().filter(|line| line.starts_with('|'));
        let words: Vec<&str> = table.flat_map(|line| line.split(|c: char| !c.is_alphanumeric())).collect();
        let encoders = wiring.encoders.iter().flat_map(|wires| [wires.pins[0], wires.pins[1], wires.index]);
        let motors = wiring.motors.iter().flat_map(|motor| {
            let sensors = motor.sensors.iter().map(|(channel, _)| Pin::of_channel(*channel));
            motor.gates.into_iter().chain(sensors)
        });
        for Pin(port, number) in encoders.chain(motors).chain([wiring.enable, wiring.fault, wiring.bus_pin()]) {
            let pin = format!("P{port}{number}");
            assert!(words.contains(&pin.as_str()), "{}: {pin}", wiring.name);
        }
    }
}
