//! `haptic rules`: shows or changes the rules that the board enforces for all tools.

use super::arguments::words_parser;
use super::port::{OnBoard, counted, short, warn_of_weaker_rules};
use clap::builder::TypedValueParser;
use haptic_bridge::control::{HostAction, Rules};
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::model::device::Device;
use haptic_bridge::model::units::JointUnits;
use haptic_bridge::safety::limits::Limits;
use haptic_bridge::safety::refusal::Refusal;
use haptic_host::error::Failure;
use haptic_host::link::{Board, BoardError};
use haptic_host::words::joint_units;
use serde_json::json;

/// Show or change the limits and rules that the board enforces
///
/// Rules without an option stay as they are. Rules can become stricter at any time, but looser only with the motors off
/// and never beyond the board's own limits. `haptic board save` keeps them over a power cycle.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    on: OnBoard,
    /// Joint torques in N m, of a slide its force in N, one per joint
    #[arg(long, value_name = "N M,..", value_delimiter = ',', value_parser = parse_limit, allow_hyphen_values = true)]
    torque: Vec<f32>,
    /// Motor currents in A, one per joint
    #[arg(long, value_name = "A,..", value_delimiter = ',', value_parser = parse_limit, allow_hyphen_values = true)]
    current: Vec<f32>,
    /// Motor currents that may flow without a time limit, in A, one per joint
    #[arg(long, value_name = "A,..", value_delimiter = ',', value_parser = parse_limit, allow_hyphen_values = true)]
    continuous_current: Vec<f32>,
    /// Joint speeds in rad/s, of a slide in m/s, one per joint
    #[arg(long, value_name = "RAD/S,..", value_delimiter = ',', value_parser = parse_limit, allow_hyphen_values = true)]
    speed: Vec<f32>,
    /// Mean power into the hand in W
    #[arg(long, value_name = "W", value_parser = parse_limit)]
    power: Option<f32>,
    /// Force of walls, springs and fields together at the tip in N
    #[arg(long, value_name = "N", value_parser = parse_limit)]
    tip_force: Option<f32>,
    /// Lowest supply voltage in V
    #[arg(long, value_name = "V", value_parser = parse_limit)]
    bus_min: Option<f32>,
    /// Highest supply voltage in V
    #[arg(long, value_name = "V", value_parser = parse_limit)]
    bus_max: Option<f32>,
    /// Action of the board when the host has been silent
    #[arg(long, value_name = "ACTION", value_parser = action_parser())]
    host: Option<HostAction>,
    #[arg(long, value_name = "S", value_parser = parse_seconds, help = host_seconds_help())]
    host_seconds: Option<f32>,
    /// Dissipate the energy that walls generate, by damping and less feed-forward (passivity controller)
    #[arg(long, value_name = "BOOL", action = clap::ArgAction::Set)]
    passivity: Option<bool>,
    /// Counts between two index pulses of each encoder, one per joint; 0 without index pulses
    #[arg(long, value_name = "COUNTS,..", value_delimiter = ',', value_parser = clap::value_parser!(i32).range(0..), allow_hyphen_values = true)]
    index_period: Vec<i32>,
}

fn action_parser() -> impl TypedValueParser<Value = HostAction> {
    let what = |action| match action {
        HostAction::Ignore => "Nothing",
        HostAction::Hold => "The scene continues, and the fault is listed",
        HostAction::Disarm => "Motors off",
    };
    words_parser(HostAction::ALL.map(|(name, action)| (name, what(action), action)))
}

fn parse_limit(text: &str) -> Result<f32, String> {
    match text.trim().parse::<f32>() {
        Ok(value) if value.is_finite() && value > 0.0 => Ok(value),
        Ok(_) => Err("must be finite and greater than zero".into()),
        Err(_) => Err("not a number".into()),
    }
}

fn host_seconds_help() -> String {
    let (min, max) = Rules::HOST_SECONDS;
    format!("Longest silence of the host, in s: {min} to {max}")
}

fn parse_seconds(text: &str) -> Result<f32, String> {
    parse_limit(text).and_then(|value| {
        let (min, max) = Rules::HOST_SECONDS;
        if (min..=max).contains(&value) { Ok(value) } else { Err(format!("must be between {min} and {max}")) }
    })
}

pub fn run(args: Args) -> Result<(), Failure> {
    let mut board = args.on.open()?;
    let before = board.rules()?;
    let device = board.device()?;
    let joints = match &device {
        Some(device) => device.axes(),
        None => usize::from(board.details()?.axes).min(before.limits.torque.len()),
    };
    let turning = [JointUnits::of(false); MAX_JOINTS];
    let own = device.as_ref().map(|device| device.mechanism.units());
    let units = own.as_deref().unwrap_or(&turning[..joints]);
    let owner = device.as_ref().map_or("the board", |device| device.name.as_str()).to_string();
    let owner = (owner.as_str(), joints);
    let mut rules = before;
    let limits = &mut rules.limits;
    let scaled = |given: &[f32], by: fn(&JointUnits) -> f32| -> Vec<f32> {
        given.iter().enumerate().map(|(i, value)| value * units.get(i).map_or(1.0, |units| by(units))).collect()
    };
    set_per_joint(owner, "torque", &scaled(&args.torque, |units| units.lever), &mut limits.torque)?;
    set_per_joint(owner, "current", &args.current, &mut limits.current)?;
    set_per_joint(owner, "continuous-current", &args.continuous_current, &mut limits.continuous_current)?;
    set_per_joint(owner, "speed", &scaled(&args.speed, |units| 1.0 / units.lever), &mut limits.speed)?;
    set_per_joint(owner, "index-period", &args.index_period, &mut rules.index_period)?;
    limits.power = args.power.unwrap_or(limits.power);
    limits.tip_force = args.tip_force.unwrap_or(limits.tip_force);
    limits.bus_min = args.bus_min.unwrap_or(limits.bus_min);
    limits.bus_max = args.bus_max.unwrap_or(limits.bus_max);
    rules.host_action = args.host.unwrap_or(rules.host_action);
    rules.host_seconds = args.host_seconds.unwrap_or(rules.host_seconds);
    rules.passivity = args.passivity.unwrap_or(rules.passivity);
    if rules != before {
        set_rules(&mut board, &rules, units)?;
    }
    let now = board.rules()?;
    warn_of_weaker_rules(&before, &now, units);
    if !args.torque.is_empty() {
        device.iter().for_each(|device| warn_of_useless_limits(device, &now.limits.in_units(units)));
    }
    let now = Rules { limits: now.limits.in_units(units), ..now };
    args.on.answer(as_json(&now, joints), &rules_in_words(&now, units))
}

/// Sets the rules, and describes a refused limit in the units of its joint.
fn set_rules(board: &mut Board, rules: &Rules, units: &[&JointUnits]) -> Result<(), Failure> {
    match board.set_rules(rules) {
        Err(BoardError::Refused(Refusal::BadLimit(bad))) => {
            let units = bad.joint.and_then(|joint| units.get(usize::from(joint)));
            let mut words = String::from("the board refuses: ");
            bad.write(units.copied().unwrap_or(&JointUnits::REVOLUTE), &mut words).map_err(Failure::impossible)?;
            Err(Failure::impossible(words))
        }
        other => Ok(other?),
    }
}

/// Warns about torque limits, in the joints' units, that have no effect, because they are above the motor's own limit.
fn warn_of_useless_limits(device: &Device<f32>, limits: &Limits) {
    for (index, (joint, limit)) in device.joints.iter().zip(limits.torque).enumerate().take(device.axes()) {
        let Some(motor) = joint.motor else { continue };
        let max = motor.torque_constant * motor.max_current.min(limits.current[index]);
        if limit > max {
            let unit = JointUnits::of(device.mechanism.is_prismatic(index)).torque;
            haptic_host::tell!(
                "the motor of joint {index} gives at most {} {unit}, so its limit of {} {unit} has no effect",
                short(max),
                short(limit)
            );
        }
    }
}

/// Sets `place` to the given values, which are none or one per joint.
fn set_per_joint<T: Copy>(
    (owner, joints): (&str, usize),
    name: &str,
    given: &[T],
    place: &mut [T],
) -> Result<(), Failure> {
    if !given.is_empty() && given.len() != joints {
        let numbers = counted(given.len(), "number");
        let reason = format!("--{name} has {numbers}, and {owner} has {}", counted(joints, "joint"));
        return Err(Failure::wrong(reason).remedy("give one number per joint, joint 0 first, separated by commas"));
    }
    for (place, given) in place.iter_mut().zip(given) {
        *place = *given;
    }
    Ok(())
}

fn join_values<T: std::fmt::Display>(values: &[T], joints: usize) -> String {
    values.iter().take(joints).map(ToString::to_string).collect::<Vec<_>>().join(", ")
}

fn as_json(rules: &Rules, joints: usize) -> serde_json::Value {
    let Limits { torque, current, continuous_current, speed, power, bus_min, bus_max, tip_force } = &rules.limits;
    json!({
        "torque": &torque[..joints], "current": &current[..joints],
        "continuous_current": &continuous_current[..joints], "speed": &speed[..joints], "power": power,
        "bus_min": bus_min, "bus_max": bus_max, "tip_force": tip_force, "host_action": rules.host_action, "host_seconds": rules.host_seconds,
        "passivity": rules.passivity, "index_period": &rules.index_period[..joints],
    })
}

fn rules_in_words(rules: &Rules, units: &[&JointUnits]) -> String {
    let joints = units.len();
    let torque_unit = joint_units(units, |joint| joint.torque);
    let speed_unit = joint_units(units, |joint| joint.speed);
    let Limits { torque, current, continuous_current, speed, power, bus_min, bus_max, tip_force } = &rules.limits;
    let host = match rules.host_action {
        HostAction::Ignore => "a silent host is ignored".into(),
        HostAction::Hold => {
            format!("a host silent for {} s is listed as a fault, and the scene continues", rules.host_seconds)
        }
        HostAction::Disarm => format!("a host silent for {} s turns the motors off", rules.host_seconds),
    };
    let passivity = if rules.passivity { "on" } else { "off" };
    let index = match rules.index_period {
        [0, 0, 0] => "not watched".into(),
        periods => format!("every {} counts, 0 without index pulses", join_values(&periods, joints)),
    };
    let [torque, current, continuous_current, speed] = [torque, current, continuous_current, speed].map(|values| {
        // Limits of slides are products with a lever, which are not round.
        let text =
            values.iter().zip(units).map(|(value, of)| if of.lever == 1.0 { value.to_string() } else { short(*value) });
        text.collect::<Vec<_>>().join(", ")
    });
    format!(
        "torque              {torque} {torque_unit}\n\
         current             {current} A\n\
         continuous current  {continuous_current} A\n\
         speed               {speed} {speed_unit}\n\
         power into the hand {power} W\n\
         force at the tip    {tip_force} N of walls, springs and fields\n\
         supply              {bus_min} to {bus_max} V\n\
         host                {host}\n\
         passivity control   {passivity}\n\
         index pulses        {index}\n"
    )
}
