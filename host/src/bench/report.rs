//! Every variant of every mechanism with its cost and its error; the page and the picture made of them.

use crate::bench::counts;
use crate::bench::error::{
    Errors, Law, Parts, STIFFNESS, Terms, Trigonometry, Way, encoder_step, errors, parts, with_trigonometry,
};
use crate::bench::precompute::{Precomputed, frozen, most_points, range, table};
use crate::bench::probe::{HAND_SPEED, Probe, workspace};
use crate::device_file::DeviceFile;
use crate::error::Failure;
use crate::plot::Picture;
use crate::plot::axes::{Axis, Mark, PlotArea};
use crate::plot::canvas::{Anchor, Canvas, Stroke};
use haptic_bridge::math::Math;
use haptic_bridge::model::catalogue::{Kind, MAX_JOINTS};
use haptic_bridge::model::device::Device;
use haptic_bridge::model::mechanism::Mechanism;
use haptic_bridge::model::precomputed::{Interpolation, MassModel};
use haptic_bridge::render::scene::Scene;
use haptic_bridge::render::velocity::Estimator;
use haptic_bridge::servo::compiled::BoardMath;
use haptic_bridge::with_mechanism;
use serde::Serialize;
use std::fmt::Write;
use std::hint::black_box;
use std::time::Instant;

/// The device file of each mechanism that the figures are of, the same that the counting image steps, and its colour.
fn example_of(kind: Kind) -> (&'static str, &'static str) {
    match kind {
        Kind::Paddle => (include_str!("../../../devices/hapkit-paddle.toml"), "#7f7f7f"),
        Kind::FiveBar => (include_str!("../../../devices/haply-2diy.toml"), "#0072b2"),
        Kind::FiveBarTurret => (include_str!("../../../devices/fictive-five-bar-turret.toml"), "#d55e00"),
        Kind::Parallelogram => (include_str!("../../../devices/phantom-premium-1.5.toml"), "#009e73"),
        Kind::Serial3r => (include_str!("../../../devices/serial-3r.toml"), "#cc79a7"),
    }
}

/// The devices of the report.
pub fn devices() -> Result<Vec<Device<f64>>, Failure> {
    let read = |text| DeviceFile::parse(text, "a shipped device")?.device().map_err(Failure::wrong);
    Kind::ALL.iter().map(|kind| read(example_of(*kind).0)).collect()
}

/// One variant on one target.
#[derive(Clone, Debug, Serialize)]
pub struct Variant {
    /// `mechanism/trigonometry/mass model/terms`
    pub name: String,
    /// Its mechanism.
    pub mechanism: &'static str,
    /// `cortex-m4f` or `host`.
    pub target: &'static str,
    /// Of a whole control step in contact with one wall; counted on the emulated chip, null elsewhere.
    pub instructions: Option<u32>,
    /// Of the torque alone; measured on this computer, null elsewhere.
    pub nanoseconds: Option<f64>,
    /// Largest torque error, N m.
    pub error_max: f64,
    /// Root mean square of the torque error, N m.
    pub error_rms: f64,
    /// All errors.
    pub errors: Errors,
    /// The same beside what fades whatever is chosen.
    #[serde(skip)]
    pub given: Errors,
    /// Where they come from.
    pub parts: Parts,
    /// Nothing of the same mechanism is both cheaper and better: instructions against what is wrong with the force at
    /// the tip, the wall's own error of the tip's position included.
    pub pareto: bool,
}

/// Angles per joint of the grid over the workspace.
fn density(joints: usize) -> usize {
    match joints {
        1 => 41,
        2 => 25,
        _ => 9,
    }
}

/// The situations of a device's variants; none where it cannot be analysed.
fn probes(device: &Device<f64>) -> Vec<Probe> {
    workspace(device, density(device.mechanism.kind().spec().joints), HAND_SPEED).unwrap_or_default()
}

/// As a scene has it that says nothing.
fn law(device: &Device<f64>) -> Result<Law, Failure> {
    Law::of(&Scene::default(), device)
}

/// Every variant of `device`; `timed` adds what this computer takes.
pub fn variants(device: &Device<f64>, timed: bool) -> Result<Vec<Variant>, Failure> {
    let spec = device.mechanism.kind().spec();
    let (probes, law) = (probes(device), law(device)?);
    let (points, range) = (most_points(device), range(device, &probes));
    let mut models = vec![Precomputed::default(), frozen(device, &probes)];
    models.extend(table(device, Interpolation::Bilinear, [points; 2], range));
    models.extend(table(device, Interpolation::Bicubic, [points; 2], range));
    let back_ends = [
        (Trigonometry::Tabulated, "table"),
        (Trigonometry::Minimax, "minimax"),
        (Trigonometry::Micromath, "micromath"),
        (Trigonometry::Libm, "libm"),
    ];
    let mut found = Vec::new();
    for (trigonometry, name) in back_ends {
        for model in &models {
            for terms in Terms::ALL {
                if terms == Terms::None && model.name() != "exact" {
                    continue;
                }
                let way = Way { model, terms, trigonometry, law };
                let (errors, parts) = (errors(device, &probes, &way), parts(device, &probes, &way));
                let variant = |target, instructions, nanoseconds| Variant {
                    name: format!("{}/{name}/{}/{}", spec.name, model.name(), terms.name()),
                    mechanism: spec.name,
                    target,
                    instructions,
                    nanoseconds,
                    error_max: errors.whole.torque.max,
                    error_rms: errors.whole.torque.rms,
                    errors: errors.whole,
                    given: errors.given,
                    parts,
                    pareto: false,
                };
                let count = counts::instructions(spec.name, name, model.name(), terms.name());
                found.push(variant("cortex-m4f", count, None));
                if timed {
                    found.push(variant("host", None, Some(nanoseconds(device, &probes, &way))));
                }
            }
        }
    }
    mark_front(&mut found);
    Ok(found)
}

impl Variant {
    /// What is wrong with the force at the tip, N: of the torque beside what fades in every variant, and of the wall's
    /// force at 20 kN/m.
    pub fn felt(&self) -> f64 {
        self.given.force.max + self.parts.tip
    }
}

fn mark_front(variants: &mut [Variant]) {
    let cost: Vec<Option<(u32, f64)>> =
        variants.iter().map(|variant| variant.instructions.map(|count| (count, variant.felt()))).collect();
    for (index, variant) in variants.iter_mut().enumerate() {
        let Some((count, error)) = cost[index] else { continue };
        variant.pareto = !cost
            .iter()
            .flatten()
            .any(|(other, with)| (*other < count && *with <= error) || (*other <= count && *with < error));
    }
}

/// What one torque takes on this computer, ns: the best of several runs over the probes.
fn nanoseconds(device: &Device<f64>, probes: &[Probe], way: &Way<'_>) -> f64 {
    with_mechanism!(device.mechanism.cast::<f32>(), m => {
        with_trigonometry!(way.trigonometry, K => time::<K, _, _>(&m, probes, way))
    })
}

fn time<K: Math<f32>, M: Mechanism<f32, N>, const N: usize>(
    m: &M,
    probes: &[Probe],
    &Way { model, terms, law, .. }: &Way<'_>,
) -> f64 {
    let Some(mass) = MassModel::<f32, N>::new::<M>(&model.data, &model.values) else { return f64::NAN };
    let some = &probes[..probes.len().min(1000)];
    let run = || {
        let start = Instant::now();
        for probe in some {
            let torque: [f64; MAX_JOINTS] =
                crate::bench::error::torque::<f32, K, M, N>(m, &mass, terms, law, black_box(probe));
            black_box(torque);
        }
        start.elapsed().as_secs_f64() * 1.0e9 / some.len() as f64
    };
    (0..5).map(|_| run()).fold(f64::INFINITY, f64::min)
}

/// The page: one table per mechanism, of the variants on the chip.
pub fn page(every: &[(Device<f64>, Vec<Variant>)]) -> Result<String, Failure> {
    let mut text = String::from(
        "# Speed against error\n\n\
         Made by `cargo xtask bench`; do not edit. What each way of computing the control step costs on the chip, and what error\n\
         it leaves in the rendered torque.\n\n\
         - **Cost**: executed instructions of one whole `Controller::step` on the Cortex-M4F (slowest of six poses in contact with\n\
         \x20 one wall): counts to angles, joint and wall filters, kinematics, contact, feed-forward, gravity where the device has\n\
         \x20 weight. Counted on the emulated chip, the same on every run; benches/counts.json holds the figures and CI fails when\n\
         \x20 one grows by more than 5 %.\n\
         - **Error**: against the law that renders the wall's force whatever moves (docs/model.md section 2) in f64, over the reachable\n\
         \x20 workspace, normals in every direction, the hand moving at 0.5 m/s, wherever the device's own motors can make that motion, with\n\
         \x20 the largest force that they give beside it. In newtons at the tip, the largest of all situations, each cause by itself: *terms left\n\
         \x20 out* (computed exactly; also what it is below *in 90 %* of the situations), the *mass matrix* instead of the closed form, *rounding* in f32 with\n\
         \x20 the trigonometry's error, and what these do to the *tip*'s position times a wall of 20 kN/m.\n\
         - **Fade**: what the velocity terms lack near singular poses counts as left out, as estimates of velocities lag (docs/model.md\n\
         \x20 section 2): here as a scene has them that says nothing, 20 kHz and a cutoff of 500 Hz. A slower rate or cutoff leaves\n\
         \x20 more. Where they are off, a variant with them is one without. What they lack because single encoder counts are no motion\n\
         \x20 counts as left out, too.\n\
         - **Area**: the stable area of stiffness and damping that is left of that with the exact feed-forward, at the worst situation.\n\
         - **Duty**: all of the torque's error in steps of the duty (4200 at 20 kHz, 24 V bus, the device's own motors): below one is free.\n\
         - **F** marks the Pareto front of each mechanism: nothing there is both cheaper and nearer to the force that\n\
         \x20 should be felt, the tip's part included and beside the fade, which no variant changes.\n\n\
         `table` is what the firmware runs. ![Instructions over error](speed-against-error.svg)\n",
    );
    for (device, variants) in every {
        let _ = writeln!(text, "\n## {} ({})\n", device.mechanism.kind().spec().name, device.name);
        let probes = probes(device);
        let (step, [faded, off]) = (encoder_step(device, &probes), law(device)?.fading(device, &probes));
        let _ = writeln!(
            text,
            "One encoder step moves the tip by up to {:.1} µm: {:.1e} N at 20 kN/m. The velocity terms fade in {:.1} % of the \
             situations, and in {:.1} % they are off.\n",
            1.0e6 * step,
            STIFFNESS * step,
            100.0 * faded,
            100.0 * off
        );
        let _ = writeln!(
            text,
            "| trigonometry | mass matrix | terms | instructions | terms left out, N | in 90 %, N | mass matrix, N | rounding, N | tip, N | area, % | \
             duty steps | |"
        );
        let _ = writeln!(text, "|---|---|---|---:|---:|---:|---:|---:|---:|---:|---:|---|");
        let mut rows: Vec<&Variant> = variants.iter().filter(|variant| variant.target == "cortex-m4f").collect();
        rows.sort_by_key(|variant| variant.instructions);
        for variant in rows {
            let mut parts = variant.name.split('/').skip(1);
            let mut part = || parts.next().unwrap_or_default();
            let (trigonometry, model, terms) = (part(), part(), part());
            let count = variant.instructions.map_or("-".into(), |count| count.to_string());
            let Parts { dropped, dropped_mostly, model: matrix, rounding, tip, area } = variant.parts;
            let _ = writeln!(
                text,
                "| {trigonometry} | {model} | {terms} | {count} | {dropped:.1e} | {dropped_mostly:.1e} | {matrix:.1e} | {rounding:.1e} | {tip:.1e} | {:.1} | {} | {} |",
                100.0 * area,
                steps(variant.errors.duty.max),
                if variant.pareto { "F" } else { "" }
            );
        }
    }
    text += &estimators(every);
    Ok(text)
}

/// What the estimators of a wall's velocity cost.
fn estimators(every: &[(Device<f64>, Vec<Variant>)]) -> String {
    let mut text = String::from(
        "\n## Velocity estimators\n\n\
         Instructions of the step with a wall and its feed-forward (docs/model.md section 3); windows at their longest.\n\n| estimator |",
    );
    let mechanisms: Vec<&str> = every.iter().map(|(device, _)| device.mechanism.kind().spec().name).collect();
    let _ = writeln!(text, " {} |\n|---|{}", mechanisms.join(" | "), "---:|".repeat(mechanisms.len()));
    for (estimator, _) in Estimator::ALL {
        let count = |mechanism: &&str| {
            counts::instructions(mechanism, BoardMath::NAME, "exact", &format!("feed-forward, {estimator}"))
                .map_or("-".into(), |count| count.to_string())
        };
        let cells: Vec<String> = mechanisms.iter().map(count).collect();
        let _ = writeln!(text, "| {estimator} | {} |", cells.join(" | "));
    }
    text
}

fn steps(value: f64) -> String {
    if value < 0.1 { format!("{value:.1e}") } else { format!("{value:.1}") }
}

/// The picture: instructions over what is wrong with the force at the tip, each mechanism's Pareto front as a line.
pub fn picture(every: &[(Device<f64>, Vec<Variant>)]) -> Picture {
    // Beyond these lies libm alone, whose thousands of instructions would press the rest together.
    const MOST: u32 = 1800;
    let shown = |variant: &&Variant| variant.instructions.is_some_and(|count| count <= MOST);
    let (low, high) = (-6.0, 4.0);
    let decades = |variant: &Variant| variant.felt().max(1.0e-12).log10().clamp(low, high);
    let mut canvas = Canvas::new(760.0, 540.0);
    let frame = PlotArea {
        at: (80.0, 110.0),
        size: (660.0, 370.0),
        x: Axis {
            name: "largest error of the force at the tip beside the fade, 10ˣ".into(),
            unit: "N".into(),
            low,
            high,
        },
        y: Axis { name: "instructions".into(), unit: String::new(), low: 0.0, high: f64::from(MOST) },
    };
    let (mut entries, mut drawn) = (Vec::new(), Vec::new());
    frame.clipped(&mut canvas, |canvas| {
        for (device, variants) in every {
            let (_, colour) = example_of(device.mechanism.kind());
            let all: Vec<&Variant> = variants.iter().filter(shown).collect();
            let mut front: Vec<(f64, f64)> = all
                .iter()
                .filter(|variant| variant.pareto)
                .map(|variant| (decades(variant), f64::from(variant.instructions.unwrap_or(0))))
                .collect();
            front.sort_by(|a, b| a.0.total_cmp(&b.0));
            let stroke = Stroke { colour, width: 1.8, dash: "" };
            frame.curve(canvas, &front, stroke);
            drawn.push(front);
            // A mechanism without a point in the frame has no place in its legend.
            if !all.is_empty() {
                entries.push((Mark::Line(stroke), device.mechanism.kind().spec().name.to_string()));
            }
            for variant in all {
                let y = f64::from(variant.instructions.unwrap_or(0));
                frame.dot(canvas, decades(variant), y, y, y, colour);
                drawn.push(vec![(decades(variant), y)]);
            }
        }
    });
    frame.draw(&mut canvas, "");
    let title = "Speed against error: every variant of the control step, fronts as lines";
    canvas.text((frame.at.0, 28.0), 15.0, Anchor::Start, false, title);
    let counts = every.iter().flat_map(|(_, variants)| variants).filter_map(|variant| variant.instructions);
    let beyond = counts.filter(|count| *count > MOST).min();
    let beyond = beyond.map_or(String::new(), |least| {
        format!(" What takes more instructions than fit here, {least} and up, is not drawn.")
    });
    for (line, text) in [
        "Instructions on the Cortex-M4F. Error: torque as a force at the tip, plus the tip's error times 20 kN/m;",
        "below 10⁻⁶ N drawn there. What the velocity terms lack where they fade is the same in all, and left out here.",
        beyond.trim_start(),
    ]
    .into_iter()
    .enumerate()
    {
        canvas.text((frame.at.0, 48.0 + 16.0 * line as f64), 12.0, Anchor::Start, false, text);
    }
    frame.clear_legend(&mut canvas, &drawn, &entries);
    canvas.finish(title, "Instructions of each variant over its largest error of the force at the tip.")
}
