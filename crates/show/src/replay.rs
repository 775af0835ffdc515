//! Replays a recording: feeds its encoder counts to the simulated board's control code and compares the torques.
//!
//! Device, scene and rules are the recording's. The control code is deterministic, so the same counts give the same
//! torques to the bit. Differences come from inputs that a recording does not hold: changed gains, forces from a host,
//! and for the first rows the state of the velocity estimators before them.

use crate::recorder::{Recording, STATES};
use haptic_bridge::board::settings::Setting;
use haptic_bridge::board::telemetry::{Field, Fields};
use haptic_bridge::control::compiled::BoardMath;
use haptic_bridge::control::frame::Samples;
use haptic_bridge::control::joints::Counts;
use haptic_bridge::control::program::{Hardware, Program};
use haptic_bridge::control::{Command, ControlLoop, HostAction, Rules};
use haptic_bridge::drive::stage::Bridge;
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::model::description::MAX_SENSED;
use haptic_bridge::model::device::Device;
use haptic_bridge::model::units::JointUnits;
use haptic_bridge::render::scene::Scene;
use haptic_bridge::safety::fault::State;
use haptic_host::backup::SavedSetting;
use haptic_host::error::{Choice, Failure};
use haptic_host::link::columns;
use haptic_host::words::counted;
use serde::Serialize;
use std::collections::BTreeMap;

/// A difference between a recorded and a replayed torque.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// Control step of the board.
    pub step: u64,
    /// Time since the recording's first row, s.
    pub time_s: f64,
    /// Joint, from 0.
    pub joint: usize,
    /// Torque in the recording.
    pub recorded: f32,
    /// Torque of the replay.
    pub replayed: f32,
    /// Unit of both: N m, or N of a slide.
    pub unit: &'static str,
    /// Number of single-precision steps between the two: 1 for neighbouring numbers.
    pub steps_of_precision: u64,
}

/// Result of a replay.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ReplayResult {
    /// Number of played rows.
    pub rows: u64,
    /// Number of played rows with the motors on.
    pub armed: u64,
    /// Number of rows in which any torque differs.
    pub differing: u64,
    /// The first difference.
    pub first: Option<Difference>,
    /// The largest difference.
    pub largest: Option<Difference>,
    /// Reason why the replay stopped early; `None` if all rows were played.
    pub stopped: Option<String>,
}

impl ReplayResult {
    /// Returns true if every row was played and every torque is the same to the bit.
    pub fn is_same(&self) -> bool {
        self.differing == 0 && self.stopped.is_none()
    }
}

fn read_setting<S: Setting>(settings: &BTreeMap<String, SavedSetting>, name: &str) -> Result<S, Failure> {
    let missing = || {
        Failure::wrong(format!("the recording does not have the board's {name}"))
            .remedy("record with a device and a scene loaded, by haptic record")
    };
    settings.get(name).ok_or_else(missing)?.read().map_err(Failure::wrong)
}

struct Columns {
    step: usize,
    time: usize,
    state: usize,
    counts: Vec<usize>,
    torque: Vec<usize>,
    q: Vec<usize>,
}

impl Columns {
    fn of(recording: &Recording, units: &[&JointUnits]) -> Result<Self, Failure> {
        let column = |name: String| {
            recording.column(&name).ok_or_else(|| {
                Failure::wrong(format!("the recording has no column {name}, which a replay needs"))
                    .remedy("record q, torque, counts and state, as haptic record does")
                    .choose(Choice::Fields)
            })
        };
        let per_joint = |field: Field| {
            let columns = columns(Fields(field.bit()), units, 0).into_iter();
            columns.map(|known| column(known.label)).collect::<Result<Vec<usize>, Failure>>()
        };
        Ok(Self {
            step: column("step".into())?,
            time: column("time_s".into())?,
            state: column("state".into())?,
            counts: per_joint(Field::Counts)?,
            torque: per_joint(Field::Torque)?,
            q: per_joint(Field::Angle)?,
        })
    }
}

/// Replays a recording.
pub fn replay(recording: &Recording) -> Result<ReplayResult, Failure> {
    let settings = recording.header_value("settings").ok_or_else(|| {
        Failure::wrong("the recording does not have the board's settings").remedy("record with haptic record")
    })?;
    let settings: BTreeMap<String, SavedSetting> = serde_json::from_str(settings).map_err(Failure::wrong)?;
    let (device, scene): (Device<f32>, Scene<f32>) =
        (read_setting(&settings, "device")?, read_setting(&settings, "scene")?);
    // A replay has no host that sends heartbeats.
    let rules = Rules { host_action: HostAction::Ignore, ..read_setting(&settings, "rules")? };
    let joints = device.axes();
    let units = device.mechanism.units();
    let columns = Columns::of(recording, &units)?;
    let rows = &recording.rows;
    let first = rows.first().ok_or_else(|| Failure::wrong("the recording has no rows"))?;
    if rows.get(1).is_some_and(|second| second[columns.step] - first[columns.step] > 1.5) {
        let every = rows[1][columns.step] - first[columns.step];
        return Err(Failure::wrong(format!(
            "the recording has one control step in {every}, and a replay needs every step"
        ))
        .remedy("record at the control rate, with fewer fields if the link cannot carry it")
        .choose(Choice::Fields));
    }
    if motors_are_on(first[columns.state] as usize) {
        return Err(Failure::wrong("the motors are on in the first row: the state of the controller is not known")
            .remedy("begin to record before arming; haptic record can arm by itself"));
    }

    let hardware = Hardware {
        axes: MAX_JOINTS,
        encoders: (MAX_JOINTS + MAX_SENSED) as u8,
        real: false,
        bus_sensed: false,
        bridge: Bridge { carrier_hz: 20e3, dead_time: 0.0, bandwidth_hz: 1e3, current_sensed: false, legs: 2 },
        timer_hz: haptic_sim::TIMER_HZ,
    };
    let mut control_loop = ControlLoop::<Box<Program<BoardMath>>>::new(hardware, rules);
    let program = Program::new(&hardware, &rules.limits, &device, &scene, false).map_err(Failure::wrong)?;
    control_loop.execute(Command::Program(Box::new(program))).0.map_err(Failure::wrong)?;

    // Counts at angle zero, as homing set them: the recorded count minus the count of the recorded angle.
    let zero: Vec<i64> = (0..joints)
        .map(|i| {
            let joint = &device.joints[i];
            let counted_angle = (first[columns.q[i]] - f64::from(joint.offset)) / f64::from(joint.radians_per_count);
            first[columns.counts[i]] as i64 - counted_angle.round() as i64
        })
        .collect();
    let mut replayed = ReplayResult::default();
    let mut expected = first[columns.step];
    for row in rows {
        let (step, time_s) = (row[columns.step], row[columns.time]);
        if step != expected {
            let lost = counted((step - expected).max(0.0), "row");
            replayed.stopped = Some(format!("{lost} missing before step {step}; played up to there"));
            break;
        }
        expected = (step + 1.0) % 4_294_967_296.0;
        let recorded = row[columns.state] as usize;
        if let Err(refusal) = enter_state(&mut control_loop, recorded) {
            replayed.stopped = Some(format!(
                "at step {step} the recorded state is {}, which the simulated board refuses: {refusal}",
                STATES.get(recorded).unwrap_or(&"unknown")
            ));
            break;
        }
        let counts = Counts::from_fn(|i| match columns.counts.get(i) {
            Some(column) => (row[*column] as i64 - zero[i]) as i32,
            None => 0,
        });
        control_loop.control(&Samples { counts, ..Samples::default() });
        let frame = control_loop.frame();
        replayed.rows += 1;
        replayed.armed += u64::from(motors_are_on(recorded));
        let mut differs = false;
        for (joint, column) in columns.torque.iter().enumerate() {
            let (recorded, torque) = (row[*column] as f32, frame.motors.torque[joint]);
            if recorded.to_bits() == torque.to_bits() {
                continue;
            }
            differs = true;
            let difference = Difference {
                step: step as u64,
                time_s,
                joint,
                recorded,
                replayed: torque,
                unit: units[joint].torque,
                steps_of_precision: precision_steps(recorded, torque),
            };
            replayed.first = replayed.first.or(Some(difference));
            let size = |d: &Difference| f64::from(d.recorded - d.replayed).abs();
            if replayed.largest.as_ref().is_none_or(|largest| size(largest) < size(&difference)) {
                replayed.largest = Some(difference);
            }
        }
        replayed.differing += u64::from(differs);
    }
    Ok(replayed)
}

fn motors_are_on(recorded: usize) -> bool {
    State::ALL.get(recorded).is_some_and(|state| state.drives())
}

/// Brings the control loop into the state of the recorded row.
fn enter_state(
    control_loop: &mut ControlLoop<Box<Program<BoardMath>>>,
    recorded: usize,
) -> Result<(), haptic_bridge::safety::refusal::Refusal> {
    let now = control_loop.frame().state;
    if now as usize == recorded || !now.drives() && !motors_are_on(recorded) {
        return Ok(());
    }
    // Waits, because a polarity check turns the motors off by itself in the step that shows the new state.
    if now == State::CheckingPolarity {
        return Ok(());
    }
    if now == State::Fault {
        control_loop.execute(Command::Clear).0?;
    }
    match recorded {
        armed if armed == State::Armed as usize => control_loop.execute(Command::Arm).0,
        check if check == State::CheckingPolarity as usize => control_loop.execute(Command::CheckPolarity).0,
        // A fault turns the motors off in the step that detects it.
        _ => control_loop.execute(Command::Disarm).0,
    }
}

/// Counts the single-precision steps between two numbers.
fn precision_steps(a: f32, b: f32) -> u64 {
    let index = |value: f32| {
        let bits = i64::from(value.to_bits() & 0x7fff_ffff);
        if value.is_sign_negative() { -bits } else { bits }
    };
    index(a).abs_diff(index(b))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn precision_steps_count_the_numbers_between() {
        assert_eq!(precision_steps(1.0, 1.0 + f32::EPSILON), 1);
        assert_eq!(precision_steps(-1.0, -1.0 - 2.0 * f32::EPSILON), 2);
        assert_eq!(precision_steps(f32::from_bits(1), -f32::from_bits(1)), 2);
        assert_eq!(precision_steps(0.0, -0.0), 0);
    }
}
