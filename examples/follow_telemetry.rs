//! Prints a board's telemetry and the number of lost rows: `cargo run -p haptic --example follow_telemetry [PORT]`.
//! PORT is a value of `haptic --port`; the default is a simulated board.

use haptic_host::haptic_bridge::board::telemetry::Field;
use haptic_host::link::fields;
use std::time::Duration;

/// Prints telemetry of the board at a port.
pub fn follow(port: &str) -> Result<(), Box<dyn std::error::Error>> {
    let mut board = haptic_sim::open(&port.parse()?)?;
    println!("{} {} on {}", board.info().board, board.info().serial, board.port());
    // Every 100th control step. If the link is too slow, the board drops complete rows and counts them.
    board.start_stream(fields("q,tip,state")?, 100)?;
    for _ in 0..10 {
        for row in board.rows(Duration::from_millis(50))? {
            println!(
                "step {:6}: angles {:.4?} rad, tip {:.5?} m",
                row.step,
                row.get(Field::Angle),
                row.get(Field::Tip)
            );
        }
    }
    board.stop_stream()?;
    println!("{}", board.losses());
    Ok(())
}

#[allow(dead_code, reason = "the tests call `follow`")]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    follow(&std::env::args().nth(1).unwrap_or_else(|| "sim".into()))
}
