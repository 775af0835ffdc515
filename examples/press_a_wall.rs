//! A hand presses into a wall: `cargo run -p haptic --example press_a_wall`. Board, device and hand are simulated. For
//! a real board, use `Board::open(&"SERIAL_NUMBER".parse()?)`, which has the same interface.

use haptic_host::device_file::DeviceFile;
use haptic_host::haptic_bridge::board::telemetry::Field;
use haptic_host::link::{Board, fields};
use haptic_host::scene_file::SceneFile;
use haptic_sim::{BoardOptions, Hand, HandSettings, Intent, SharedBoard, Waypoint, ready_board};
use std::time::Duration;

/// Runs the simulation and prints the distance and the force.
pub fn main() -> Result<(), Box<dyn std::error::Error>> {
    let device = DeviceFile::load(concat!(env!("CARGO_MANIFEST_DIR"), "/../devices/coupled-five-bar.toml"))?;
    let scene = concat!(env!("CARGO_MANIFEST_DIR"), "/../devices/scenes/coupled-five-bar/wall.toml");
    let scene = SceneFile::load(scene, device.spec().task)?;
    let simulated = SharedBoard::new(ready_board(&device, BoardOptions::default())?);
    let mut board = Board::over(simulated.wire(), "sim")?;
    board.set_scene(&scene.scene()?)?;
    board.arm()?;
    let tip = simulated.lock().device().tip();
    let now = simulated.lock().time();
    // The hand pushes against the wall's normal with 4 N, one second after arming.
    let push = Intent::Push(vec![Waypoint { time: 1.0, value: [-3.76, 1.36, 0.0] }]);
    simulated.lock().device_mut().set_hand(Hand::new(HandSettings::default(), push, tip, now));
    board.start_stream(fields("distance,force")?, 2000)?;
    for _ in 0..20 {
        for row in board.rows(Duration::from_millis(100))? {
            let (distance, force) = (row.get(Field::Distance)[0], row.get(Field::WallForce)[0]);
            println!("step {:6}: {:7.3} mm from the wall, wall force {force:.2} N", row.step, 1e3 * distance);
        }
    }
    Ok(board.disarm()?)
}
