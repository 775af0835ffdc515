//! `--port`, an option of every command that uses a board, and the messages that these commands share.

use super::answer::Json;
use haptic_bridge::control::{HostAction, Rules};
use haptic_bridge::model::units::JointUnits;
use haptic_bridge::render::scene::Scene;
use haptic_bridge::safety::fault::{FaultRecord, State};
use haptic_host::error::Failure;
use haptic_host::link::{Board, PortSpec};
pub use haptic_host::words::counted;
pub use haptic_host::words::{feed_forward_in_words, short, wall_in_words};
use serde::Serialize;
use std::io::{BufRead, IsTerminal};
use std::net::{SocketAddr, ToSocketAddrs};

#[derive(clap::Args)]
pub struct Port {
    /// The board: a serial port or a board's serial number, tcp:HOST:PORT, sim, or sim:DEVICE.toml [default:
    /// HAPTIC_PORT if it is set, else the only connected board]
    #[arg(long, value_name = "PORT", env = "HAPTIC_PORT")]
    port: Option<PortSpec>,
}

impl Port {
    pub fn open(&self) -> Result<Board, Failure> {
        Ok(haptic_sim::open(self.spec())?)
    }

    pub fn spec(&self) -> &PortSpec {
        self.port.as_ref().unwrap_or(&PortSpec::Find)
    }

    /// Opens the board for a command that changes its state. Refuses a board that exists only during this command.
    pub fn open_to_stay(&self) -> Result<Board, Failure> {
        match &self.port {
            Some(PortSpec::Sim(_)) => Err(Failure::wrong("a board on --port sim exists only during this command")
                .remedy("run `haptic sim` in another terminal and use the port that it prints")),
            _ => self.open(),
        }
    }
}

/// `--port` and `--json`: options of a command that requests something from a board and prints the reply.
#[derive(clap::Args)]
pub struct OnBoard {
    #[command(flatten)]
    port: Port,
    #[command(flatten)]
    pub json: Json,
}

impl OnBoard {
    pub fn open(&self) -> Result<Board, Failure> {
        self.port.open()
    }

    /// Opens the board for a command that changes its state, as [`Port::open_to_stay`] does.
    pub fn open_to_stay(&self) -> Result<Board, Failure> {
        self.port.open_to_stay()
    }

    pub fn spec(&self) -> &PortSpec {
        self.port.spec()
    }

    /// Returns a warning if the board exists only during this command; empty for every other board.
    pub fn warn_if_temporary(&self) -> &'static str {
        match self.spec() {
            PortSpec::Sim(_) => {
                "a board on --port sim exists only during this command: run `haptic sim` in another terminal and use the \
                 port that it prints\n"
            }
            _ => "",
        }
    }

    /// Prints the document with `--json`, otherwise the text `words`.
    pub fn answer(&self, document: impl Serialize, words: &str) -> Result<(), Failure> {
        self.json.answer(document, words)
    }
}

/// Returns the address to listen on, from the value of `option`: PORT on this computer, or HOST:PORT.
pub fn parse_address(text: &str, option: &str) -> Result<SocketAddr, Failure> {
    let full = if text.contains(':') { text.to_string() } else { format!("127.0.0.1:{text}") };
    let address = full.to_socket_addrs().ok().and_then(|mut addresses| addresses.next());
    address.ok_or_else(|| {
        Failure::wrong(format!("{option} {text} is not PORT or HOST:PORT")).remedy(format!("try {option} 7710"))
    })
}

pub fn state_in_words(state: State) -> &'static str {
    match state {
        State::Disarmed => "disarmed (motors off, the device moves freely)",
        State::Armed => "armed",
        State::CheckingPolarity => "checking motor polarity",
        State::Homing => "homing: pushing a joint to its stop",
        State::Fault => "fault (motors off until it is cleared)",
    }
}

/// Warning that is shown before a command switches motors off.
pub const MOTORS_GO_OFF: &str = "the motors are on and will go off: a device with weight falls";

/// Asks for confirmation on the terminal, unless `yes` is true; `what` describes the effect.
pub fn confirm(yes: bool, what: &str) -> Result<(), Failure> {
    if yes {
        return Ok(());
    }
    if !std::io::stdin().is_terminal() {
        return Err(
            Failure::impossible(format!("{what}, and there is no terminal to ask on")).remedy("repeat with --yes")
        );
    }
    haptic_host::error::say(format_args!("{what}; go on? [y/N] "));
    let mut answer = String::new();
    let read = std::io::stdin().lock().read_line(&mut answer);
    match read {
        Ok(_) if ["y", "yes"].contains(&answer.trim().to_ascii_lowercase().as_str()) => Ok(()),
        _ => Err(Failure::impossible("not confirmed, so nothing was done")
            .remedy("repeat the command and type y, or use --yes")),
    }
}

pub fn scene_in_words(scene: &Scene<f32>) -> String {
    let mut parts = vec![counted(scene.walls.len(), "wall")];
    if !scene.springs.is_empty() {
        parts.push(counted(scene.springs.len(), "spring"));
    }
    if scene.field_damping > 0.0 {
        parts.push(format!("a field of {} N s/m", short(scene.field_damping)));
    }
    parts.join(", ")
}

/// Describes a fault, with its remedy on a line of its own.
pub fn fault_in_words(record: &FaultRecord, rate_hz: f32) -> String {
    format!("{}\n    {}", fault_without_remedy(record, rate_hz), record.fault.remedy())
}

pub fn fault_without_remedy(record: &FaultRecord, rate_hz: f32) -> String {
    let axis = record.axis.map_or(String::new(), |axis| format!(", joint {axis}"));
    let seconds = f64::from(record.step) / f64::from(rate_hz.max(1.0));
    format!("{}{axis}, value {}, {seconds:.3} s after boot", record.fault, record.value)
}

/// Warns on standard error if the present rules protect less than those before; `units` are the device's.
pub fn warn_of_weaker_rules(before: &Rules, now: &Rules, units: &[&JointUnits]) {
    if now.host_action != HostAction::Disarm && before.host_action == HostAction::Disarm {
        haptic_host::tell!(
            "the board no longer watches its host: if this tool is killed or its cable pulled, the motors stay on"
        );
    }
    let (was, is) = (before.limits.tip_force, now.limits.tip_force);
    if is > was {
        haptic_host::tell!(
            "walls, springs and fields may now push at the tip with {} N, before with {}",
            short(is),
            short(was)
        );
    }
    let [was, is] = [before, now].map(|rules| rules.limits.in_units(units).torque);
    for (joint, (was, is)) in was.into_iter().zip(is).enumerate() {
        if is > was {
            let unit = units.get(joint).map_or("N m", |units| units.torque);
            haptic_host::tell!("the torque limit of joint {joint} is now {} {unit}, before {}", short(is), short(was));
        }
    }
}

/// Returns the failure of a command after a fault turned the motors off.
pub fn motors_off_failure(record: &FaultRecord, rate_hz: f32) -> Failure {
    Failure::impossible(format!("the motors are off: {}", fault_without_remedy(record, rate_hz)))
        .remedy(record.fault.remedy())
}

/// Formats numbers in parentheses with their unit; a number that rounds to zero has no sign.
pub fn numbers_in_words(values: &[f32], unit: &str) -> String {
    let numbers: Vec<String> = values.iter().map(|value| format!("{:.4}", (1e4 * value).round() / 1e4 + 0.0)).collect();
    format!("({}) {unit}", numbers.join(", "))
}
