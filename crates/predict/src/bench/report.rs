//! Tables of the cost and error of all variants of all mechanisms.

use crate::bench::counts;
use crate::bench::error::{
    ErrorSources, Errors, Law, TIP_ERROR_STIFFNESS, Terms, TorqueVariant, Trigonometry, encoder_step, error_sources,
    errors, with_trigonometry,
};
use crate::bench::probe::{HAND_SPEED, Probe, workspace};
use haptic_bridge::control::compiled::BoardMath;
use haptic_bridge::math::Math;
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::model::device::Device;
use haptic_bridge::model::mechanism::Mechanism;
use haptic_bridge::model::shipped;
use haptic_bridge::render::scene::Scene;
use haptic_bridge::render::velocity::Estimator;
use haptic_bridge::with_mechanism;
use haptic_host::device_file::DeviceFile;
use haptic_host::error::Failure;
use haptic_host::output::csv_line;
use serde::Serialize;
use std::hint::black_box;
use std::time::Instant;

/// Devices of the report, one for each mechanism whose control step is counted. The image that counts instructions uses
/// the same devices.
const EXAMPLES: [&str; 10] = [
    shipped::HAPKIT_PADDLE,
    shipped::HAPLY_2DIY,
    shipped::FICTIVE_FIVE_BAR_TURRET,
    shipped::PHANTOM_PREMIUM,
    shipped::SERIAL_3R,
    shipped::FALCON_LIKE,
    shipped::TWO_PADDLES,
    shipped::FADER,
    shipped::PLANAR_ARM,
    shipped::TOUCH,
];

/// Returns the devices of the report.
pub fn devices() -> Result<Vec<Device<f64>>, Failure> {
    let read = |text| DeviceFile::parse(text, "a shipped device")?.device().map_err(Failure::wrong);
    EXAMPLES.into_iter().map(read).collect()
}

/// Cost and error of one variant on one target.
#[derive(Clone, Debug, Serialize)]
pub struct Variant {
    /// `mechanism/trigonometry/exact/terms`
    pub name: String,
    /// Name of the mechanism.
    pub mechanism: &'static str,
    /// `cortex-m4f` or `host`.
    pub target: &'static str,
    /// Instructions of a complete control step with one wall, counted on the emulated chip; null for the host.
    pub instructions: Option<u32>,
    /// Time to compute the torque on this computer, ns; null for the chip.
    pub nanoseconds: Option<f64>,
    /// Largest torque error, N m.
    pub error_max: f64,
    /// Root mean square of the torque error, N m.
    pub error_rms: f64,
    /// Errors of torque, force, share and duty steps.
    pub errors: Errors,
    /// Errors without the fading that is common to all variants.
    #[serde(skip)]
    pub unfaded_errors: Errors,
    /// Sources of the errors.
    pub parts: ErrorSources,
    /// True if no other variant of the mechanism has both fewer instructions and a smaller tip force error.
    pub pareto: bool,
}

fn angles_per_joint(joints: usize) -> usize {
    match joints {
        1 => 41,
        2 => 25,
        _ => 9,
    }
}

/// Returns the situations of a device; empty if the device cannot be analysed.
fn probes(device: &Device<f64>) -> Vec<Probe> {
    workspace(device, angles_per_joint(device.mechanism.kind().spec().joints), HAND_SPEED).unwrap_or_default()
}

fn law(device: &Device<f64>) -> Result<Law, Failure> {
    Law::of(&Scene::default(), device)
}

/// Computes all variants of `device`. `timed` adds times on this computer.
pub fn variants(device: &Device<f64>, timed: bool) -> Result<Vec<Variant>, Failure> {
    let spec = device.mechanism.kind().spec();
    let (probes, law) = (probes(device), law(device)?);
    let mut results = Vec::new();
    let trigonometries = [
        (Trigonometry::Tabulated, "table"),
        (Trigonometry::Minimax, "minimax"),
        (Trigonometry::Micromath, "micromath"),
    ];
    for (trigonometry, name) in trigonometries {
        for terms in Terms::ALL {
            let way = TorqueVariant { terms, trigonometry, law };
            let (errors, parts) = (errors(device, &probes, &way), error_sources(device, &probes, &way));
            let variant = |target, instructions, nanoseconds| Variant {
                name: format!("{}/{name}/exact/{}", spec.label, terms.name()),
                mechanism: spec.label,
                target,
                instructions,
                nanoseconds,
                error_max: errors.whole.torque.max,
                error_rms: errors.whole.torque.rms,
                errors: errors.whole,
                unfaded_errors: errors.unfaded_errors,
                parts,
                pareto: false,
            };
            let count = counts::instructions(spec.label, name, terms.name());
            results.push(variant("cortex-m4f", count, None));
            if timed {
                results.push(variant("host", None, Some(torque_time_ns(device, &probes, &way))));
            }
        }
    }
    mark_pareto_front(&mut results);
    Ok(results)
}

impl Variant {
    /// Returns the tip force error without common fading, plus the error of the tip's position at 20 kN/m, N.
    pub fn tip_force_error(&self) -> f64 {
        self.unfaded_errors.force.max + self.parts.tip
    }
}

fn mark_pareto_front(variants: &mut [Variant]) {
    let cost: Vec<Option<(u32, f64)>> =
        variants.iter().map(|variant| variant.instructions.map(|count| (count, variant.tip_force_error()))).collect();
    for (index, variant) in variants.iter_mut().enumerate() {
        let Some((count, error)) = cost[index] else { continue };
        variant.pareto = !cost
            .iter()
            .flatten()
            .any(|(other, with)| (*other < count && *with <= error) || (*other <= count && *with < error));
    }
}

/// Returns the time of one torque computation on this computer, ns: the best of five runs over up to 1000 probes.
fn torque_time_ns(device: &Device<f64>, probes: &[Probe], way: &TorqueVariant) -> f64 {
    with_mechanism!(device.mechanism.cast::<f32>(), m => {
        with_trigonometry!(way.trigonometry, K => time::<K, _, _>(&m, probes, way))
    })
}

fn time<K: Math<f32>, M: Mechanism<f32, N>, const N: usize>(
    m: &M,
    probes: &[Probe],
    &TorqueVariant { terms, law, .. }: &TorqueVariant,
) -> f64 {
    let some = &probes[..probes.len().min(1000)];
    let run = || {
        let start = Instant::now();
        for probe in some {
            let torque: [f64; MAX_JOINTS] =
                crate::bench::error::torque::<f32, K, M, N>(m, terms, law, black_box(probe));
            black_box(torque);
        }
        start.elapsed().as_secs_f64() * 1.0e9 / some.len() as f64
    };
    (0..5).map(|_| run()).fold(f64::INFINITY, f64::min)
}

/// Writes docs/results/speed-against-error.csv: all variants on the chip by mechanism, in ascending order of cost.
pub fn variant_table(every: &[(Device<f64>, Vec<Variant>)]) -> String {
    let head = "mechanism,device,trigonometry,mass matrix,terms,instructions,terms left out (N),left out in 90 % (N),\
                rounding (N),tip (N),area (%),duty (steps),front";
    let mut text = csv_line(head.split(','));
    for (device, variants) in every {
        let mut rows: Vec<&Variant> = variants.iter().filter(|variant| variant.target == "cortex-m4f").collect();
        rows.sort_by_key(|variant| variant.instructions);
        for variant in rows {
            let mut cells = vec![variant.mechanism.to_owned(), device.name.to_string()];
            cells.extend(variant.name.split('/').skip(1).map(String::from));
            cells.push(format_count(variant.instructions));
            let ErrorSources { dropped, dropped_mostly, rounding, tip, area } = variant.parts;
            cells.extend([dropped, dropped_mostly, rounding, tip].map(|newtons| format!("{newtons:.1e}")));
            let front = if variant.pareto { "F" } else { "" };
            cells.extend([format!("{:.1}", 100.0 * area), format_steps(variant.errors.duty.max), front.into()]);
            text += &csv_line(cells);
        }
    }
    text
}

/// Writes docs/results/speed-by-mechanism.csv, the numbers that do not depend on the variant: the tip motion per
/// encoder count, the shares of situations in which the velocity terms fade or are off, and the instructions of a step
/// with a wall and feed-forward for each velocity estimator with its longest window.
pub fn mechanism_table(every: &[(Device<f64>, Vec<Variant>)]) -> Result<String, Failure> {
    let head = ["mechanism", "device", "encoder step (µm)", "encoder step (N)", "terms fade (%)", "terms off (%)"];
    let mut text = csv_line(head.into_iter().chain(Estimator::ALL.iter().map(|(name, _)| *name)));
    for (device, _) in every {
        let (probes, spec) = (probes(device), device.mechanism.kind().spec());
        let (step, [faded, off]) = (encoder_step(device, &probes), law(device)?.fading_shares(device, &probes));
        let mut cells = vec![
            spec.label.to_owned(),
            device.name.to_string(),
            format!("{:.1}", 1.0e6 * step),
            format!("{:.1e}", TIP_ERROR_STIFFNESS * step),
        ];
        cells.extend([faded, off].map(|share| format!("{:.1}", 100.0 * share)));
        cells.extend(Estimator::ALL.iter().map(|(estimator, _)| {
            let terms = format!("feed-forward, {estimator}");
            format_count(counts::instructions(spec.label, BoardMath::NAME, &terms))
        }));
        text += &csv_line(cells);
    }
    Ok(text)
}

fn format_count(instructions: Option<u32>) -> String {
    instructions.map_or("-".into(), |count| count.to_string())
}

fn format_steps(value: f64) -> String {
    if value < 0.1 { format!("{value:.1e}") } else { format!("{value:.1}") }
}
