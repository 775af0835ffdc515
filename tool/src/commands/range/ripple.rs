//! The effect of encoder steps on pressed walls: `haptic range --ripple` and `--wall`.

use super::Args;
use crate::commands::arguments::Numbers;
use haptic_host::device_file::DeviceFile;
use haptic_host::error::Failure;
use haptic_predict::ripple::{LIGHT_HAND, PUSH_N, PressedWall, Ripple, RippleLine};
use haptic_stability::analysis::line::DampingRule;
use haptic_stability::analysis::oscillation::Oscillation;
use haptic_stability::analysis::prediction::Prediction;
use haptic_stability::analysis::sampled::Mode;
use haptic_stability::analysis::several::Member;
use haptic_stability::sweep::Sweep;
use std::fmt::Write;

#[derive(serde::Serialize)]
pub struct EncoderRipple {
    /// Motion along the normal for one count of the coarsest joint's encoder, m.
    count_m: f64,
    push_n: f64,
    /// Mass (kg), damping (N s/m) and stiffness (N/m) of the hand.
    hand: [f64; 3],
    /// One entry for each damping rule.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    lines: Vec<RippleAlong>,
    #[serde(skip_serializing_if = "Option::is_none")]
    wall: Option<RippleOfWall>,
}

#[derive(serde::Serialize)]
struct RippleAlong {
    bound_n: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    damping_ratio: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    kd: Option<f64>,
    off: RippleLine,
    full: RippleLine,
    #[serde(skip_serializing_if = "Option::is_none")]
    washout: Option<RippleLine>,
}

#[derive(serde::Serialize)]
struct RippleOfWall {
    /// Largest change of force by one count, N.
    step_n: f64,
    off: Ripple,
    full: Ripple,
    #[serde(skip_serializing_if = "Option::is_none")]
    washout: Option<Ripple>,
    /// Oscillations in the loop of the printed range, which has no light hand.
    swings: Oscillations,
}

/// Slowest decaying, or growing, oscillation in each mode.
#[derive(serde::Serialize)]
struct Oscillations {
    off: Option<Oscillation>,
    full: Option<Oscillation>,
    #[serde(skip_serializing_if = "Option::is_none")]
    washout: Option<Oscillation>,
}

/// Simulates the effect of encoder steps on the requested walls.
pub fn simulate_ripple(
    args: &Args,
    file: &DeviceFile,
    q: &[f64],
    normals: &[Vec<f64>],
    prediction: &Prediction,
    sweep: &Sweep,
) -> Result<Option<EncoderRipple>, Failure> {
    if args.ripple.is_none() && args.wall.is_none() {
        return Ok(None);
    }
    let [normal] = normals else {
        let reason = "--ripple and --wall apply to one wall, and there are several --normal";
        return Err(Failure::wrong(reason).remedy("give one --normal"));
    };
    let positive = |value: f64, what: &str| match value.is_finite() && value > 0.0 {
        true => Ok(value),
        false => Err(Failure::wrong(format!("{what} {value} is not more than zero")).remedy("write a positive number")),
    };
    let device = prediction.linearise(q, normal)?;
    let mut description = file.description;
    if args.undamped {
        description.joints.iter_mut().for_each(|joint| joint.viscous = 0.0);
    }
    let hand = if args.hand.is_some() { args.hand()? } else { LIGHT_HAND };
    let (q, normal) = (q.to_vec(), normal.clone());
    let pressed =
        PressedWall { device: &device, description, q, normal, around: &prediction.around, hand, push_n: PUSH_N };
    let no_encoders = || {
        Failure::wrong(format!("{} has joints without [joint.encoder]", args.at.device.display()))
            .remedy("ripple comes from encoder steps: add the encoders")
    };
    let count_m = pressed.count_m().ok_or_else(no_encoders)?;
    let washout = args.washout.map(Mode::Washout);
    let mut lines = Vec::new();
    if let Some(bound) = args.ripple {
        let bound_n = positive(bound, "--ripple")?;
        let ratio = positive(args.damping_ratio, "--damping-ratio")?;
        let dampings: Vec<DampingRule> = match &args.kd {
            Some(Numbers(dampings)) => dampings.iter().map(|kd| DampingRule::Damping(*kd)).collect(),
            None => vec![DampingRule::Ratio(ratio)],
        };
        for line in dampings {
            let along = |mode| pressed.ripple_line(mode, line, bound_n, sweep)?.ok_or_else(no_encoders);
            let (damping_ratio, kd) = match line {
                DampingRule::Ratio(ratio) => (Some(ratio), None),
                DampingRule::Damping(kd) => (None, Some(kd)),
            };
            lines.push(RippleAlong {
                bound_n,
                damping_ratio,
                kd,
                off: along(Mode::Off)?,
                full: along(Mode::Full)?,
                washout: washout.map(along).transpose()?,
            });
        }
    }
    let wall = match args.wall.clone() {
        None => None,
        Some(wall) => {
            let wall = wall.exactly(2, "--wall", "numbers, stiffness and damping")?;
            if wall[0].is_nan() || wall[0] <= 0.0 || wall[1].is_nan() || wall[1] < 0.0 {
                return Err(Failure::wrong("--wall needs a stiffness above zero and a damping that is not negative")
                    .remedy("write N/m and N s/m, such as 5000,150"));
            }
            let ripple = |mode| pressed.ripple(mode, wall[0], wall[1]).ok_or_else(no_encoders);
            let alone = [Member::new(pressed.normal.clone(), 1.0)];
            let oscillation = |mode| prediction.buzz(&pressed.q, &alone, mode, wall[0], wall[1]);
            let swings = Oscillations {
                off: oscillation(Mode::Off)?,
                full: oscillation(Mode::Full)?,
                washout: washout.map_or(Ok(None), oscillation)?,
            };
            Some(RippleOfWall {
                swings,
                step_n: pressed.step_n(wall[0], wall[1]).ok_or_else(no_encoders)?,
                off: ripple(Mode::Off)?,
                full: ripple(Mode::Full)?,
                washout: washout.map(ripple).transpose()?,
            })
        }
    };
    Ok(Some(EncoderRipple { count_m, push_n: PUSH_N, hand: [hand.mass, hand.damping, hand.stiffness], lines, wall }))
}

impl EncoderRipple {
    pub fn describe(&self) -> String {
        let mut text = String::new();
        let [mass, damping, stiffness] = self.hand;
        let _ = writeln!(
            text,
            "\n  encoder steps, simulated: one count is {:.4} mm here; a hand of {mass} kg, {damping} N s/m, {stiffness} \
             N/m presses with {} N",
            1e3 * self.count_m,
            self.push_n
        );
        for line in &self.lines {
            let damping = match (line.damping_ratio, line.kd) {
                (Some(ratio), _) => format!("{ratio} of critical damping"),
                (_, kd) => format!("kd = {} N s/m", kd.unwrap_or_default()),
            };
            let mut row = |label: &str, along: &RippleLine| {
                let from = match along.kp_from {
                    Some(kp) => format!("from {kp:.1} N/m on"),
                    None => "on no wall that was simulated".into(),
                };
                let _ = writeln!(
                    text,
                    "  {label:<18} force ripple above {} N rms {from}; stable to {:.1} N/m ({damping})",
                    line.bound_n, along.kp_stable
                );
            };
            row("no feed-forward", &line.off);
            row("feed-forward (4)", &line.full);
            if let Some(washout) = &line.washout {
                row("washout", washout);
            }
        }
        if let Some(wall) = &self.wall {
            let mut row = |label: &str, ripple: &Ripple, oscillation: &Option<Oscillation>| {
                let _ = match (ripple.rms_n, ripple.peak_n, ripple.motion_m) {
                    (Some(rms), Some(peak), Some(motion)) => writeln!(
                        text,
                        "  {label:<18} {} N/m, {} N s/m: ripple {rms:.3} N rms, {peak:.3} N peak; the tip moves {:.4} mm",
                        ripple.kp,
                        ripple.kd,
                        1e3 * motion
                    ),
                    _ => writeln!(text, "  {label:<18} {} N/m, {} N s/m: the tip flies off", ripple.kp, ripple.kd),
                };
                if let Some(Oscillation { hz, growth_per_s }) = oscillation.filter(Oscillation::grows) {
                    let _ =
                        writeln!(text, "  {:18} predicted to buzz at {hz:.1} Hz, growing by {growth_per_s:.1}/s", "");
                }
            };
            row("no feed-forward", &wall.off, &wall.swings.off);
            row("feed-forward (4)", &wall.full, &wall.swings.full);
            if let Some(washout) = &wall.washout {
                row("washout", washout, &wall.swings.washout);
            }
            let _ = writeln!(text, "  one count alone changes that wall's force by up to {:.3} N", wall.step_n);
        }
        text
    }
}
