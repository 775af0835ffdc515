//! The text output of `haptic range`.

use super::{Args, requested_estimator};
use crate::commands::arguments::Numbers;
use crate::commands::port::counted;
use haptic_bridge::model::description::{Description, EncoderAt, Joint};
use haptic_bridge::render::velocity::Estimator;
use haptic_host::words::{joint_units, percent};
use haptic_stability::analysis::host::HostWall;
use haptic_stability::analysis::passivity::Passivity;
use haptic_stability::analysis::range::{
    BoundaryPoint, COSTLY_RATIO, Domain, Island, Range, WORTHWHILE_RATIO, lower_corner,
};
use haptic_stability::analysis::sampled::LinearEstimator;
use haptic_stability::analysis::why::{EffectShares, LimitPair, Limits};
use std::fmt::Write;

/// Returns two lines for titles: pose and walls, and the loop.
pub fn subtitle(args: &Args, description: &Description, q: &[f64], normals: &[Vec<f64>], ratio: f64) -> [String; 2] {
    let unit = joint_units(&description.units(), |joint| joint.travel);
    let joined = |values: &[f64]| values.iter().map(|v| format!("{v:.3}")).collect::<Vec<_>>().join(", ");
    [
        format!(
            "q = ({}) {unit}, n = {}",
            joined(q),
            normals.iter().map(|n| format!("({})", joined(n))).collect::<Vec<_>>().join(" + ")
        ),
        format!(
            "{} Hz, {}, delay {}, {:?} drive; area ratio {ratio:.3}",
            args.rate,
            estimator_and_cutoff(args),
            counted(args.delay(description), "sample"),
            args.drive()
        )
        .to_lowercase()
        .replace("hz", "Hz"),
    ]
}

/// Returns the estimator, unless it is the usual one, and its cutoff, if it has one.
fn estimator_and_cutoff(args: &Args) -> String {
    let kind = (args.estimator != Estimator::Butterworth).then(|| args.estimator.name().to_string());
    let cutoff =
        requested_estimator(args).ok().and_then(LinearEstimator::cutoff_hz).map(|hz| format!("cutoff {hz} Hz"));
    kind.into_iter().chain(cutoff).collect::<Vec<_>>().join(", ")
}

/// Describes the optional parts of the analysed loop.
fn optional_parts(args: &Args, description: &Description) -> Vec<String> {
    let mut parts = Vec::new();
    if description.is_flexible() {
        parts.push("with the transmissions and modes of the device file".to_string());
    }
    if let Some(Numbers(posture)) = &args.posture {
        parts.push(format!("in a posture of {} N m/rad and {} N m s/rad", posture[0], posture[1]));
    }
    if let Some(Numbers(hand)) = &args.hand {
        parts.push(format!("in a hand of {} kg, {} N s/m, {} N/m", hand[0], hand[1], hand[2]));
    }
    let joints = &description.joints[..description.kind.spec().joints];
    if joints.iter().any(|joint| joint.friction.is_some() || joint.cogging.is_some()) {
        parts.push(
            "without dry friction and cogging, which are not linear (--ripple and `haptic sim` have them)".into(),
        );
    }
    if args.difference_over > 1 {
        parts.push(format!("velocity from the difference over {} samples", args.difference_over));
    }
    parts
}

pub fn readable(
    name: &str,
    args: &Args,
    q: &[f64],
    normals: &[Vec<f64>],
    range: &Range,
    passivity: Option<&Passivity>,
    description: &Description,
) -> String {
    let mut text = String::new();
    let mut line = |content: String| {
        let _ = writeln!(text, "{content}");
    };
    let [pose, loop_line] = subtitle(args, description, q, normals, range.area_ratio);
    line(format!("{name}: {pose}"));
    line(format!("  {loop_line}"));
    for more in optional_parts(args, description) {
        line(format!("  {more}"));
    }
    line(format!("  effective inertia Weff, met without feed-forward  {:>12.6} kg", range.w_eff));
    line(format!("  rendered inertia Wrr, met with feed-forward       {:>12.6} kg", range.w_rr));
    if let Some((gain, met)) = range.feed_forward_gain.zip(range.inertia_met) {
        line(format!("  met with {gain} times the feed-forward{:>28.6} kg", met));
        line(format!("  {}", cost_of_gain(range.w_eff, range.w_rr, gain)));
    }
    if let Some(at_tip) = range.transmissions {
        line(format!(
            "  stiffness of the transmissions at the tip along n {at_tip:>12.0} N/m: a hand feels a wall behind it"
        ));
    }
    let sensed =
        |joint: &Joint| joint.transmission.is_some_and(|transmission| transmission.encoder_at == EncoderAt::Joint);
    if range.transmissions.is_none() && description.joints.iter().any(sensed) {
        line("  a hand feels the wall as stiff as it is rendered: encoders sit behind the transmissions".into());
    }
    line(String::new());
    let felt = if range.transmissions.is_some() { format!("{:>14}", "felt N/m") } else { String::new() };
    line(format!("  {:<26}{:>14}{felt}{:>10}{:>14}{:>18}", "", "max kp N/m", "buzz Hz", "kd_max N s/m", "area N²s/m²"));
    let buzz = |point: &BoundaryPoint| point.hz.map_or("-".into(), |hz| format!("{hz:.1}"));
    let mut row = |label: &str, domain: &Domain| {
        let felt = domain.top.felt.map_or(String::new(), |felt| format!("{felt:>14.2}"));
        let (top, kd_max, area) = (&domain.top, domain.kd_max, domain.area);
        line(format!("  {label:<26}{:>14.2}{felt}{:>10}{kd_max:>14.4}{area:>18.6e}", top.kp, buzz(top)));
    };
    row("no feed-forward", &range.off);
    row("feed-forward (4)", &range.full);
    if let Some(washout) = &range.washout {
        row(&format!("washout {} Hz", args.washout.unwrap_or_default()), washout);
    }
    if let Some(host) = &range.host {
        row(&format!("on a computer, {:.0} Hz", host.rate_hz), &host.domain);
    }
    if args.kd.is_some() {
        line("  max kp: largest stiffness at the requested dampings; without --kd, of the complete range".into());
    }
    line(
        "  buzz: the frequency at which a stiffer wall begins to buzz; - if nothing is stable, or if the wall creeps"
            .into(),
    );
    line(String::new());
    // Prints about a dozen rows; --json has all.
    let step = if args.kd.is_some() { 1 } else { (range.off.boundary.len() / 12).max(1) };
    let domains = [
        ("off", Some(&range.off)),
        ("full", Some(&range.full)),
        ("washed", range.washout.as_ref()),
        ("host", range.host.as_ref().map(|host| &host.domain)),
    ];
    let columns = || domains.iter().filter_map(|(name, domain)| Some((name, domain.as_ref()?)));
    line(columns().fold(" ".into(), |row, (name, _)| {
        format!("{row} {:>12}{:>14}{:>7}", format!("kd {name}"), format!("kp_max {name}"), "Hz")
    }));
    let is_unstable = args.kd.is_none() && columns().all(|(_, domain)| domain.kd_max == 0.0);
    let rows = if is_unstable { 0 } else { range.off.boundary.len() };
    for index in (0..rows).step_by(step) {
        line(
            columns()
                .filter_map(|(_, domain)| domain.boundary.get(index))
                .fold(" ".into(), |row, point| format!("{row} {:>12.4}{:>14.2}{:>7}", point.kd, point.kp, buzz(point))),
        );
    }
    line(String::new());
    let domains = [Some(&range.off), Some(&range.full), range.washout.as_ref()].into_iter().flatten();
    let islands: Vec<_> = domains.flat_map(|domain| &domain.islands).collect();
    let wide = |island: &Island| island.kp_high - island.kp_low;
    if let Some(widest) = islands.iter().max_by(|a, b| wide(a).total_cmp(&wide(b))) {
        line(format!(
            "  {} stable intervals lie above the boundary (islands), the widest at kd {:.4} from {:.0} to {:.0} N/m: listed with \
             --json, not counted.",
            islands.len(),
            widest.kd,
            widest.kp_low,
            widest.kp_high
        ));
    }
    if let Some(passivity) = passivity {
        line(format!(
            "  passive without feed-forward (Colgate and Schenkel 1997): kp < {:.2} N/m at kd = 0, kd < {:.4} N s/m",
            passivity.largest_stiffness(0.0),
            passivity.largest_damping()
        ));
        if let Some(limit) = passivity.largest_undamped_stiffness() {
            line(format!(
                "  passive with quantisation and friction (Abbott and Okamura 2005): kp <= {limit:.2} N/m at kd = 0"
            ));
        }
    }
    if let Some(host) = &range.host {
        line(format!("  {}", benefit_over_computer(range, host)));
    }
    line(feed_forward_benefit(range));
    text
}

/// Describes the cost of a feed-forward gain other than 1.
fn cost_of_gain(w_eff: f64, w_rr: f64, gain: f64) -> String {
    let coupling = 1.0 - w_eff / w_rr;
    format!(
        "its cost: {gain} times (4)'s push along the wall at rest, and a coupling off by 1 % changes the inertia met by \
         {:.2} % ({:.2} % at a gain of 1)",
        gain * coupling / (1.0 - gain * coupling),
        coupling / (1.0 - coupling)
    )
}

fn benefit_over_computer(range: &Range, host: &HostWall) -> String {
    let by = format!("a computer with {:.0} exchanges a second and forces {} ms old", host.rate_hz, 1e3 * host.delay_s);
    if host.domain.top.kp == 0.0 {
        return format!("rendered by {by}: never stable");
    }
    let times = range.off.top.kp / host.domain.top.kp;
    format!("rendered by {by}: the board's own wall is up to {times:.1} times as stiff")
}

fn feed_forward_benefit(range: &Range) -> String {
    let ratio = range.area_ratio;
    if range.off.area == 0.0 && range.full.area == 0.0 {
        "Nothing is stable here from zero stiffness up, without the feed-forward or with it: lower the delay or raise the \
         cutoff; behind a transmission put the encoder on the motor."
            .into()
    } else if range.off.area == 0.0 {
        "Nothing is stable here without the feed-forward: lower the delay or raise the cutoff.".into()
    } else if range.full.area == 0.0 {
        "With the feed-forward nothing is stable here: uneven joint damping makes it creep. Try --damping-compensation."
            .into()
    } else if ratio < WORTHWHILE_RATIO {
        format!(
            "The feed-forward has no benefit here: the stable area changes by {}. Leave it off at this pose and normal.",
            percent(ratio - 1.0, 1, true)
        )
    } else {
        format!("With the feed-forward the stable area is {ratio:.3} times as large.")
    }
}

pub fn describe_why(why: &EffectShares) -> String {
    let mut text =
        format!("\n  {:<40}{:>16}{:>9}{:>16}{:>9}\n", "largest kp without", "off N/m", "takes", "full N/m", "takes");
    let number = |limits: Option<Limits>| limits.map_or("no limit".into(), |limits| format!("{:.2}", limits.kp_max));
    let share = |share: Option<f64>| share.map_or("-".into(), |share| percent(share, 1, false));
    let mut row = |name: &str, limits: &LimitPair, takes: [String; 2]| {
        let [off, full] = takes;
        let _ = writeln!(text, "  {name:<40}{:>16}{off:>9}{:>16}{full:>9}", number(limits.off), number(limits.full));
    };
    row("(with everything)", &why.limits, [String::new(), String::new()]);
    for without in &why.effects {
        let name = format!("{} ({})", without.effect, without.instead);
        row(&name, &without.limits, [share(without.takes.off), share(without.takes.full)]);
    }
    text.push_str("  takes: reduction of the largest stiffness without the effect; negative if the effect helps; the shares do not add up\n");
    text
}

/// Returns the remaining shares of the area and of the largest stiffness if one of them is less than [`COSTLY_RATIO`].
fn remaining_shares(domain: &Domain, off: &Domain) -> Option<(f64, f64)> {
    let stiffness = domain.top.kp / off.top.kp.max(f64::MIN_POSITIVE);
    let area = domain.area / off.area.max(f64::MIN_POSITIVE);
    (off.area > 0.0 && (area < COSTLY_RATIO || stiffness < COSTLY_RATIO)).then_some((area, stiffness))
}

/// Returns warnings if the feed-forward in full, or behind a washout at this corner (Hz), costs more than it brings.
/// `with_corner` predicts the range with another corner.
pub fn costly_warnings<E>(
    range: &Range,
    corner: Option<f64>,
    with_corner: impl Fn(f64) -> Result<Range, E>,
) -> Result<Vec<String>, E> {
    let warning = |domain: &Domain, what: &str, instead: &str| {
        let (area, stiffness) = remaining_shares(domain, &range.off)?;
        if domain.area == 0.0 {
            return Some(format!("{what} leaves nothing stable here; {instead}"));
        }
        Some(format!(
            "{what} costs more than it brings here: the stable area becomes {area:.2} times as large and the stiffest \
             wall {stiffness:.2} times as stiff; {instead}"
        ))
    };
    let mut warnings: Vec<String> =
        warning(&range.full, "the feed-forward", "leave it off at this pose and normal").into_iter().collect();
    let Some((washout, corner)) = range.washout.as_ref().zip(corner) else { return Ok(warnings) };
    if remaining_shares(washout, &range.off).is_none() {
        return Ok(warnings);
    }
    let is_free =
        |hz| Ok(with_corner(hz)?.washout.is_some_and(|domain| remaining_shares(&domain, &range.off).is_none()));
    let free = lower_corner(corner, is_free)?;
    let costless = free.map_or(String::new(), |hz| format!("a corner of {hz} Hz costs nothing (--washout), or "));
    let instead = format!("{costless}leave the feed-forward off");
    warnings.extend(warning(washout, "the washout", &instead));
    Ok(warnings)
}
