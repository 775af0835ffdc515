//! Draws a board's wires from the table that wires the emulated board ([`crate::boards`]), so that the wiring page and
//! the tests use the same pins.

use haptic_show::plot::Picture;
use haptic_show::plot::canvas::{Anchor, Canvas, Stroke};
use haptic_show::plot::colour::{FAINT, FULL, INK, OFF, WASHOUT};

use crate::boards::{Pin, Wiring};

/// Distance between two wires, and between two parts, pixels.
const ROW: f64 = 19.0;
const GAP: f64 = 12.0;
/// Column at which the board ends, and column at which the parts begin.
const BOARD: f64 = 240.0;
const PARTS: f64 = 470.0;
const WIDTH: f64 = 720.0;

/// A part with its wires.
struct Part {
    name: String,
    colour: &'static str,
    /// The chip's pin, the part's pin, and the label of the wire.
    wires: Vec<(Pin, &'static str, &'static str)>,
}

/// Draws a board of H-bridges; `current` and `bus` describe the resistors of the dividers.
#[must_use]
pub fn draw(wiring: &Wiring, title: &str, [current, bus]: [&'static str; 2]) -> Picture {
    let parts = parts(wiring, current, bus);
    let rows: usize = parts.iter().map(|part| part.wires.len()).sum();
    let height = 96.0 + ROW * rows as f64 + GAP * parts.len() as f64;
    let mut canvas = Canvas::new(WIDTH, height);
    canvas.text((24.0, 30.0), 15.0, Anchor::Start, false, title);
    canvas.rectangle((24.0, 48.0), (BOARD - 24.0, height - 72.0), "#f4f4f4", Stroke::solid(INK, 1.4));
    let mut y = 64.0;
    for part in &parts {
        let tall = ROW * part.wires.len() as f64;
        canvas.rectangle((PARTS, y - 4.0), (WIDTH - 24.0 - PARTS, tall), "white", Stroke::solid(part.colour, 1.4));
        let name = (WIDTH - 34.0, y - 4.0 + 0.5 * tall + 4.0);
        canvas.coloured_text(name, 12.0, Anchor::End, part.colour, &part.name);
        for (pin, end, note) in &part.wires {
            let wire = y + 0.5 * ROW - 4.0;
            canvas.line((BOARD, wire), (PARTS, wire), Stroke::solid(part.colour, 1.6));
            canvas.text((BOARD - 8.0, wire + 4.0), 12.0, Anchor::End, false, &format!("P{}{}", pin.0, pin.1));
            canvas.text((PARTS + 8.0, wire + 4.0), 12.0, Anchor::Start, false, end);
            canvas.text((0.5 * (BOARD + PARTS), wire - 2.0), 9.0, Anchor::Middle, false, note);
            y += ROW;
        }
        y += GAP;
    }
    let (from, to) = ((BOARD, height - 34.0), (PARTS, height - 34.0));
    canvas.line(from, to, Stroke { colour: FAINT, width: 1.6, dash: "4 3" });
    canvas.text((BOARD - 8.0, from.1 + 4.0), 12.0, Anchor::End, false, "GND");
    canvas.text((PARTS + 8.0, from.1 + 4.0), 12.0, Anchor::Start, false, "ground of every part and of the supply");
    canvas.finish(wiring.name, "The chip's pins, and what each is wired to.")
}

fn parts(wiring: &Wiring, current: &'static str, bus: &'static str) -> Vec<Part> {
    let mut parts = vec![Part {
        name: "all bridges".into(),
        colour: FULL,
        wires: vec![(wiring.enable, "enable", "10 kΩ to ground at the bridges"), (wiring.fault, "stop", "low = off")],
    }];
    for (axis, (motor, encoder)) in wiring.motors.iter().zip(wiring.encoders).enumerate() {
        parts.push(Part {
            name: format!("bridge and motor {axis}"),
            colour: OFF,
            wires: vec![(motor.gates[0], "IN1", ""), (motor.gates[1], "IN2", "")],
        });
        parts.push(Part {
            name: format!("current sensor {axis}"),
            colour: FULL,
            wires: motor.sensors.iter().map(|(channel, _)| (Pin::of_channel(*channel), "out", current)).collect(),
        });
        parts.push(Part {
            name: format!("encoder {axis}"),
            colour: WASHOUT,
            wires: vec![
                (encoder.pins[0], "A", ""),
                (encoder.pins[1], "B", ""),
                (encoder.index, "Z", "if there is one"),
            ],
        });
    }
    parts.push(Part { name: "motors' supply".into(), colour: INK, wires: vec![(wiring.bus_pin(), "+", bus)] });
    parts
}
