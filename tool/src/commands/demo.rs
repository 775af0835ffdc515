//! `haptic demo`: the benefit of the feed-forward, in a few seconds, without hardware.

use super::answer::Json;
use super::force::ForceOption;
use haptic_bridge::render::scene::FeedForward;
use haptic_host::error::Failure;
use haptic_host::output;
use haptic_show::demo::comparison::Comparison;
use haptic_show::demo::crossing::{Crossing, run as cross};
use haptic_show::demo::picture::draw;
use haptic_show::demo::stiffness::{StiffnessLimit, stiffness_limit};
use haptic_show::demo::{Demo, Inertia};
use haptic_show::view::world::press_while_switching;
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::json;
use std::path::PathBuf;

/// Let a simulated hand press on a wall, without and with the feed-forward, and see the benefit
///
/// Runs a simulated board with the firmware's own control code over the real protocol: no hardware needed, a few
/// seconds. Prints a table and draws a moving picture into an SVG file, for a browser.
#[derive(clap::Args)]
pub struct Args {
    /// File for the picture [default: haptic-demo.svg, or with a number if that exists]
    #[arg(long, value_name = "FILE")]
    svg: Option<PathBuf>,
    #[command(flatten)]
    force: ForceOption,
    #[command(flatten)]
    json: Json,
}

/// Seed of the hand's tremor, the same for both runs.
const TREMOR_SEED: u64 = 1;

/// Units of the progress bar for one of the four parts of the work.
const UNITS_PER_PART: u64 = 100;

/// A progress bar on standard error, which is drawn only on a terminal.
struct PartsBar {
    bar: ProgressBar,
    /// Number of finished parts.
    done: u64,
}

impl PartsBar {
    fn new(parts: u64) -> Self {
        let bar = ProgressBar::new(parts * UNITS_PER_PART);
        if let Ok(style) = ProgressStyle::with_template("{bar:32} {percent:3} %  {msg}") {
            bar.set_style(style);
        }
        Self { bar, done: 0 }
    }

    /// Shows the progress in the present part, as a share, and the activity `doing`.
    fn show(&self, share: f64, doing: &'static str) {
        self.bar.set_message(doing);
        self.bar.set_position(self.done * UNITS_PER_PART + (share * UNITS_PER_PART as f64) as u64);
    }

    fn next(&mut self) {
        self.done += 1;
    }

    fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

struct Results {
    inertia: Inertia,
    crossings: [Crossing; 2],
    limits: [StiffnessLimit; 2],
}

pub fn run(args: Args) -> Result<(), Failure> {
    args.force.check_pictures(args.svg.as_ref(), None)?;
    let demo = Demo::shipped(TREMOR_SEED)?;
    let mut bar = PartsBar::new(4);
    let mut crossing = |feed_forward, doing: &'static str| {
        let result = cross(&demo, feed_forward, &mut |share| bar.show(share, doing));
        bar.next();
        result
    };
    let crossings = [
        crossing(FeedForward::Off, "the hand crosses the wall without feed-forward")?,
        crossing(FeedForward::Washout, "the hand crosses the wall with feed-forward")?,
    ];
    let mut search = |feed_forward, doing: &'static str| {
        bar.show(0.0, doing);
        let result = stiffness_limit(&demo, feed_forward);
        bar.next();
        result
    };
    let limits = [
        search(FeedForward::Off, "raising the stiffness without feed-forward")?,
        search(FeedForward::Washout, "raising the stiffness with feed-forward")?,
    ];
    bar.finish();
    let results = Results { inertia: demo.inertia()?, crossings, limits };
    let svg = args.svg.unwrap_or_else(|| output::unused_path("haptic-demo.svg".as_ref()));
    let [without, with] = &results.crossings;
    let (shown, moments) = press_while_switching()?;
    draw(&shown, &moments, without, with).save_svg(&svg)?;
    let place = std::path::absolute(&svg).unwrap_or(svg);
    let place = place.display().to_string();
    let words = format!("{}picture: {place}\n", format_report(&demo, &results));
    args.json.answer(json_document(&demo, &results, &place), &words)
}

/// Returns the contents of `format_report` as JSON in SI units, `without` and `with` the feed-forward.
fn json_document(demo: &Demo, results: &Results, picture: &str) -> serde_json::Value {
    let run = |crossing: &Crossing, inertia: f64, limit: &StiffnessLimit| {
        json!({
            "penetration_m": crossing.penetration,
            "peak_force_n": crossing.peak_force,
            "ripple_n_rms": crossing.ripple,
            "bounces": crossing.bounces,
            "rows_lost": crossing.lost,
            "fault": crossing.fault,
            "inertia_kg": inertia,
            "highest_stable_stiffness_n_per_m": { "measured": limit.measured, "predicted": limit.predicted },
        })
    };
    let Results { inertia, crossings: [without, with], limits: [low, high] } = results;
    json!({
        "device": demo.file.name,
        "seed": demo.seed,
        "rate_hz": demo.rate_hz,
        "stiffness_n_per_m": demo.stiffness,
        "damping_n_s_per_m": demo.damping,
        "washout_hz": demo.washout_hz,
        "without": run(without, inertia.effective, low),
        "with": run(with, inertia.rendered, high),
        "model": demo.model_command(),
        "range": demo.range_command(low.delay_samples),
        "picture": picture,
    })
}

fn format_report(demo: &Demo, results: &Results) -> String {
    let Results { inertia, crossings: [without, with], limits: [low, high] } = results;
    let mut text = format!(
        "{}: a simulated board at {:.0} Hz, over the board's own protocol.\n\
         A hand presses onto a wall of {:.1} kN/m and {:.0} N s/m, slides {:.0} mm along it and lifts off; twice, with the same\n\
         tremor (seed {}). The feed-forward is the paper's equation (4) behind a {} Hz washout.\n\n",
        demo.file.name,
        demo.rate_hz,
        demo.stiffness / 1000.0,
        demo.damping,
        1e3 * haptic_show::demo::crossing::SLIDE_DISTANCE,
        demo.seed,
        demo.washout_hz
    );
    let mut row = |name: &str, off: String, on: String| text.push_str(&format!("  {name:<46}{off:>12}{on:>12}\n"));
    row("feed-forward", "without".into(), "with".into());
    row("penetration, mm", format!("{:.3}", 1e3 * without.penetration), format!("{:.3}", 1e3 * with.penetration));
    row("peak force, N", format!("{:.2}", without.peak_force), format!("{:.2}", with.peak_force));
    row("vibration under the resting hand, N rms", format!("{:.2}", without.ripple), format!("{:.2}", with.ripple));
    let grams = |kilograms: f64| format!("{:.1}", 1e3 * kilograms);
    row("inertia that the wall meets, g", grams(inertia.effective), grams(inertia.rendered));
    let stiffness = |newtons: f64| format!("{:.2}", newtons / 1000.0);
    row("highest stable stiffness, kN/m: measured", stiffness(low.measured), stiffness(high.measured));
    row("                                predicted", stiffness(low.predicted), stiffness(high.predicted));
    row("losses of contact while pressed", without.bounces.to_string(), with.bounces.to_string());
    row("rows of telemetry lost", without.lost.to_string(), with.lost.to_string());
    text.push_str(&format!(
        "\n  Weff = {:.1} g, Wrr = {:.1} g, coupling Wrr - Weff = {:.1} g\n\n",
        1e3 * inertia.effective,
        1e3 * inertia.rendered,
        1e3 * (inertia.rendered - inertia.effective)
    ));
    text.push_str(&describe_benefit(demo, results));
    for crossing in [without, with] {
        if let Some(fault) = &crossing.fault {
            text.push_str(&format!("The board stopped a run: {fault}.\n"));
        }
    }
    text.push_str(&format!(
        "Weff, Wrr and the predictions are also printed by (run next to the folder devices/)\n    {}\n    {}\n",
        demo.model_command(),
        demo.range_command(low.delay_samples)
    ));
    text.push_str(
        "The stable stiffness is measured without friction, hand and encoder steps, as in the theory; with them the\n\
         limit lies higher, several times with a hand (docs/results.md).\n\n",
    );
    text
}

/// Describes the benefit of the feed-forward in this run.
fn describe_benefit(demo: &Demo, results: &Results) -> String {
    let Results { inertia, crossings: [without, with], limits: [low, high] } = results;
    let gain = 100.0 * (high.measured / low.measured - 1.0);
    let mut text = format!(
        "Benefit of the feed-forward: the wall meets {:.0} % more inertia, and stays stable up to a {gain:.0} % higher stiffness.\n",
        100.0 * (inertia.rendered / inertia.effective - 1.0)
    );
    if low.measured < demo.stiffness && demo.stiffness < high.measured {
        text.push_str("The wall that was pressed lies between the two limits: only with the feed-forward is it stable by itself.\n");
    }
    for sentence in Comparison::of(without, with).sentences() {
        text.push_str(&format!("{sentence}\n"));
    }
    text
}
