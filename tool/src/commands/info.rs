//! `haptic info`: the board, its device and scene, and its state.

use super::port::{OnBoard, fault_without_remedy, numbers_in_words, scene_in_words, state_in_words, wall_in_words};
use haptic_bridge::safety::fault::Fault;
use haptic_host::digits::print_json;
use haptic_host::error::{Failure, on_one_line, print};
use haptic_host::words::joint_units;
use serde_json::json;

/// Show a board, its device and scene, and its state
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    on: OnBoard,
}

pub fn run(args: Args) -> Result<(), Failure> {
    let mut board = args.on.open()?;
    let info = board.info().clone();
    let details = board.details()?;
    let status = board.status()?;
    let scene = board.scene()?;
    let tip_force = board.rules()?.limits.tip_force;
    let units = board.device()?.map(|device| device.mechanism.units()).unwrap_or_default();
    let axes = units.len();
    if args.on.json.is_requested() {
        let fault = status.fault.map(|record| {
            json!({ "code": record.fault.code(), "name": record.fault.name(), "axis": record.axis,
                    "value": record.value, "step": record.step })
        });
        return print_json(json!({
            "port": board.port(), "board": info.board, "serial": info.serial, "firmware": info.firmware,
            "protocol": info.protocol, "name": details.name, "axes": details.axes, "encoders": details.encoders,
            "real": details.real,
            "device": details.device, "rate_hz": details.rate_hz, "carrier_hz": details.carrier_hz,
            "delay_samples": details.delay_samples, "walls": details.walls, "unsensed_faults": details.unsensed,
            "overruns": details.overruns, "longest_cycles": details.longest_cycles,
            "stack_free": details.stack_free, "state": format!("{:?}", status.state), "homed": status.homed,
            "polarity_checked": status.polarity, "tip_force": tip_force, "fault": fault, "step": status.step,
            "bus_voltage": status.bus_voltage, "q": &status.q[..axes], "tip": &status.tip[..axes],
        }));
    }
    let mut report = String::new();
    let mut line = |name: &str, value: String| report.push_str(&format!("{name:<12}{}\n", on_one_line(&value)));
    let name = if details.name.is_empty() { String::new() } else { format!(" \"{}\"", details.name) };
    line("board", format!("{}{name}, serial number {}, on {}", info.board, info.serial, board.port()));
    line("firmware", format!("{}, protocol {}", info.firmware, info.protocol));
    line("axes", format!("{}, and {} encoder inputs", details.axes, details.encoders));
    line(
        "control",
        format!("{} Hz, carrier {} Hz, delay {} samples", details.rate_hz, details.carrier_hz, details.delay_samples),
    );
    line("device", details.device.as_deref().unwrap_or("none; load one with `haptic device FILE`").into());
    match &scene {
        None => line("scene", "none; load one with `haptic scene FILE`".into()),
        Some(scene) => {
            line("scene", scene_in_words(scene));
            for (index, wall) in scene.walls.iter().enumerate() {
                line(&format!("  wall {index}"), wall_in_words(wall));
            }
        }
    }
    line("state", state_in_words(status.state).into());
    line("homed", if status.homed { "yes" } else { "no" }.into());
    line("polarity", if status.polarity { "checked" } else { "not checked" }.into());
    line("tip force", format!("walls, springs and fields push with at most {tip_force} N"));
    line("bus", format!("{:.2} V", status.bus_voltage));
    if axes > 0 {
        let unknown = if status.homed { "" } else { "  (not homed: relative to the pose at power-on)" };
        line("joints", numbers_in_words(&status.q[..axes], &joint_units(&units, |unit| unit.travel)) + unknown);
        line("tip", numbers_in_words(&status.tip[..axes], "m") + unknown);
    }
    if let Some(record) = &status.fault {
        line("fault", fault_without_remedy(record, details.rate_hz));
        line("", record.fault.remedy().into());
    }
    if details.overruns > 0 {
        line("overruns", details.overruns.to_string());
    }
    if details.longest_cycles > 0 {
        line("longest", format!("{} cycles", details.longest_cycles));
    }
    if details.stack_free > 0 {
        line("stack free", format!("{} bytes", details.stack_free));
    }
    let unsensed: Vec<&str> =
        Fault::ALL.iter().filter(|fault| details.unsensed.contains(&fault.code())).map(|fault| fault.what()).collect();
    if !unsensed.is_empty() {
        line("not sensed", unsensed.join("; "));
    }
    for (key, damage) in &details.damage {
        line("damaged", format!("the stored {} ({damage:?}): its default is used", key.name()));
    }
    print(&report)
}
