//! `--port`, which every command that talks to a board takes, and how they talk about what they found.

use haptic::error::Failure;
use haptic::link::{Board, PortSpec};
use haptic_bridge::safety::fault::{FaultRecord, State};

/// Which board.
#[derive(clap::Args)]
pub struct Port {
    /// The board: a serial port or a board's serial number, tcp:HOST:PORT, sim, or sim:DEVICE.toml [default: HAPTIC_PORT
    /// where that is set, else the only board connected]
    #[arg(long, value_name = "PORT", env = "HAPTIC_PORT")]
    port: Option<PortSpec>,
}

impl Port {
    /// Opens the board.
    pub fn open(&self) -> Result<Board, Failure> {
        Ok(Board::open(self.spec())?)
    }

    /// What was asked for.
    pub fn spec(&self) -> &PortSpec {
        self.port.as_ref().unwrap_or(&PortSpec::Find)
    }

    /// Opens the board for a command that leaves something in it: not one that ends with the command.
    pub fn open_to_stay(&self) -> Result<Board, Failure> {
        match &self.port {
            Some(PortSpec::Sim(_)) => {
                Err(Failure::wrong("a board on --port sim ends with this command, and nothing of it is left")
                    .remedy("run `haptic sim` in another terminal and use the port that it prints"))
            }
            _ => self.open(),
        }
    }
}

/// A state in words.
pub fn state_in_words(state: State) -> &'static str {
    match state {
        State::Disarmed => "disarmed (motors off, the device moves freely)",
        State::Armed => "armed",
        State::CheckingPolarity => "checking motor polarity",
        State::Fault => "fault (motors off until it is cleared)",
    }
}

/// A fault in words, with its remedy.
pub fn fault_in_words(record: &FaultRecord, rate_hz: f32) -> String {
    let axis = record.axis.map_or(String::new(), |axis| format!(", joint {axis}"));
    let seconds = f64::from(record.step) / f64::from(rate_hz.max(1.0));
    format!("{}{axis}, value {}, {seconds:.3} s after boot\n    {}", record.fault, record.value, record.fault.remedy())
}

/// Numbers in a row, for people.
pub fn numbers(values: &[f32], unit: &str) -> String {
    let numbers: Vec<String> = values.iter().map(|value| format!("{value:.4}")).collect();
    format!("({}) {unit}", numbers.join(", "))
}
