//! A program on the host pushes the tip: `cargo run -p haptic --example push_from_the_host [PORT]`. The default is a
//! simulated board. The program computes a spring between the tip and its first position, and sends a floor 5 mm below
//! that position to the board, which renders the floor at its own rate.

use haptic_host::device_file::DeviceFile;
use haptic_host::haptic_bridge::board::protocol::HostContact;
use haptic_host::haptic_bridge::render::scene::Scene;
use haptic_host::link::Session;
use haptic_sim::SHIPPED_DEVICE;

/// Pushes the tip of the board at a port for half a second of the board's time. Returns the tip before and after.
pub fn push(port: &str) -> Result<([f32; 3], [f32; 3]), Box<dyn std::error::Error>> {
    let device = DeviceFile::parse(SHIPPED_DEVICE, "coupled-five-bar.toml")?;
    let mut session = Session::of(haptic_sim::open(&port.parse()?)?);
    session.set_device(&device.device()?)?;
    session.set_scene(&Scene { task: 2, ..Scene::default() })?;
    session.arm()?;
    let began = session.read_state()?;
    let home = began.tip;
    let floor = HostContact {
        point: [home[0], home[1] - 0.005, 0.0],
        normal: [0.0, 1.0, 0.0],
        stiffness: 2000.0,
        damping: 5.0,
    };
    let mut state = began;
    while state.step.wrapping_sub(began.step) < 10_000 {
        // A spring of 50 N/m towards the first position, and 1 N down.
        let spring = [50.0 * (home[0] - state.tip[0]), 50.0 * (home[1] - state.tip[1]) - 1.0, 0.0];
        state = session.push(spring, Some(floor))?;
    }
    println!("tip from {:.4?} to {:.4?} m, {:.3?} N applied: {}", home, state.tip, state.force, state.done);
    // The end of the session turns the motors off.
    Ok((home, state.tip))
}

#[allow(dead_code, reason = "the tests call `push`")]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    push(&std::env::args().nth(1).unwrap_or_else(|| "sim".into())).map(drop)
}
