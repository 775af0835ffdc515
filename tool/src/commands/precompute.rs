//! `haptic precompute`: computes a frozen mass matrix or a table of mass matrices, and its torque error.

use super::answer::Json;
use super::arguments::Numbers;
use super::force::ForceOption;
use clap::ValueEnum;
use haptic_bridge::model::device::Device;
use haptic_bridge::model::precomputed::{Interpolation, MassModelData, TABLE_VALUES};
use haptic_bridge::render::scene::Scene;
use haptic_host::device_file::DeviceFile;
use haptic_host::error::Failure;
use haptic_host::output;
use haptic_predict::bench::error::{Law, Terms, TorqueVariant, Trigonometry, errors};
use haptic_predict::bench::precompute::{PrecomputedModel, frozen_model, mass_table, max_grid_points, shape_range};
use haptic_predict::bench::probe::{Probe, workspace};
use std::path::PathBuf;

/// Compute a mass matrix in advance for the board, and print its torque error
///
/// A table covers the two joint angles that the mass matrix depends on; outside the table the board uses the closed
/// form. The size of the table is checked against the board's memory. `haptic scene` itself chooses the kind of mass
/// matrix; this command shows one kind.
#[derive(clap::Args)]
pub struct Args {
    /// Device file (TOML)
    device: PathBuf,
    /// Kind of mass matrix
    #[arg(long, value_enum, default_value = "bicubic")]
    kind: Kind,
    /// Points of the table along each of its two angles [default: the maximum that the board holds]
    #[arg(long, value_name = "N")]
    points: Option<u8>,
    /// Range of the two angles: lowest and highest of the first, then of the second, rad [default: the workspace]
    #[arg(long = "box", value_name = "A,B,C,D", allow_hyphen_values = true)]
    range: Option<Numbers>,
    /// Write the result to this file (JSON: points, values and errors) for your own use. No command reads the file,
    /// because `haptic scene` computes the mass matrix for a board again
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    #[command(flatten)]
    force: ForceOption,
    #[command(flatten)]
    json: Json,
}

#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
enum Kind {
    Bilinear,
    Bicubic,
    Frozen,
}

pub fn run(args: Args) -> Result<(), Failure> {
    args.force.check(&args.output)?;
    let device = DeviceFile::load(&args.device)?.device().map_err(Failure::wrong)?;
    let per_joint = [41, 25, 11][device.mechanism.kind().spec().joints.clamp(1, 3) - 1];
    let mut probes = workspace(&device, per_joint, 0.0)?;
    let box_range = match args.range {
        Some(numbers) => {
            let values = numbers.exactly(4, "--box", "lowest and highest of both angles, rad")?;
            if !(values[0] < values[1] && values[2] < values[3]) {
                return Err(Failure::wrong("--box is empty: a highest angle is not above its lowest")
                    .remedy("write LOW,HIGH,LOW,HIGH in rad"));
            }
            let range = [[values[0], values[2]], [values[1], values[3]]];
            probes.retain(|probe| is_inside(&device, probe, range));
            if probes.is_empty() {
                return Err(Failure::impossible("no pose in this box can be reached from home")
                    .remedy("choose a box in the workspace, which `haptic map` shows"));
            }
            range
        }
        None => shape_range(&device, &probes),
    };
    let points = args.points.unwrap_or(max_grid_points(&device));
    let entries = device.mechanism.mass_entries().len();
    let precomputed = match args.kind {
        Kind::Frozen => frozen_model(&device, &probes),
        Kind::Bilinear | Kind::Bicubic => {
            let cubic = args.kind == Kind::Bicubic;
            let interpolation = if cubic { Interpolation::Bicubic } else { Interpolation::Bilinear };
            mass_table(&device, interpolation, [points; 2], box_range).ok_or_else(|| {
                let values = usize::from(points).pow(2) * entries;
                Failure::impossible(format!(
                    "a table of {points} x {points} points takes {values} numbers; the board holds {TABLE_VALUES}, and a \
                     table needs {} points a side",
                    if cubic { 4 } else { 2 }
                ))
                .remedy(format!("use --points {}", max_grid_points(&device)))
            })?
        }
    };
    // Uses any law of motion, because errors are computed at rest.
    let law = Law::of(&Scene::default(), &device)?;
    let way =
        TorqueVariant { model: &precomputed, terms: Terms::FeedForward, trigonometry: Trigonometry::Tabulated, law };
    let errors = errors(&device, &probes, &way).whole;
    let document = serde_json::json!({
        "device": device.name, "kind": precomputed.name(), "model": precomputed.data, "values": precomputed.values, "errors": errors,
    });
    if let Some(path) = &args.output {
        output::write(path, format!("{document:#}\n").as_bytes(), args.force.overwrite())?;
    }
    args.json.answer(document, &readable(&device, &precomputed, &errors, probes.len()))
}

fn is_inside(device: &Device<f64>, probe: &Probe, box_: [[f64; 2]; 2]) -> bool {
    let angles = shape_range(device, std::slice::from_ref(probe));
    (0..2).all(|k| {
        let middle = 0.5 * (angles[0][k] + angles[1][k]);
        (box_[0][k]..=box_[1][k]).contains(&middle)
    })
}

fn readable(
    device: &Device<f64>,
    precomputed: &PrecomputedModel,
    errors: &haptic_predict::bench::error::Errors,
    situations: usize,
) -> String {
    let size = match &precomputed.data {
        MassModelData::Table(grid, _) => format!(
            "{} x {} points, {} bytes of the board's {}; from ({:.4}, {:.4}) rad in steps of ({:.4}, {:.4}) rad",
            grid.points[0],
            grid.points[1],
            precomputed.bytes(),
            4 * TABLE_VALUES,
            grid.low[0],
            grid.low[1],
            grid.spacing[0],
            grid.spacing[1]
        ),
        MassModelData::Frozen(triangle) => format!("lower triangle {triangle:?} kg m²"),
        MassModelData::Exact => String::new(),
    };
    let share = &errors.share;
    let error = if share.max < 1.0 {
        format!(
            "at most {:.4} % of the torque ({:.3} duty steps), 99 % below {:.4} %, RMS {:.4} %",
            100.0 * share.max,
            errors.duty.max,
            100.0 * share.most,
            100.0 * share.rms
        )
    } else {
        let elsewhere = match share.most < 1.0 {
            true => format!("in 99 % of the situations below {:.4} %", 100.0 * share.most),
            false => "and in more than 1 % of the situations".into(),
        };
        format!(
            "larger than the torque itself in the worst situation, near a singular pose; {elsewhere}\n  \
             do not use this matrix: limit it to your work area with --box, give the joints limits, or let `haptic scene` choose"
        )
    };
    format!(
        "{}: {} mass matrix\n  {size}\n  torque error over {situations} situations at rest, total motor force: {error}\n",
        device.name,
        precomputed.name(),
    )
}
