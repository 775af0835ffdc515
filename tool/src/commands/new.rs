//! `haptic new`: writes a device or scene file to start from, or converts a model of a robot.

use super::force::ForceOption;
use clap::ValueEnum;
use clap::builder::PossibleValue;
use haptic_bridge::model::catalogue::Kind;
use haptic_host::device_file::DeviceFile;
use haptic_host::error::{Failure, print};
use haptic_host::output;
use haptic_host::toml_file::Document;
use haptic_import::Selection;
use haptic_predict::template::{device_file, scene_file};
use std::path::PathBuf;

/// Write a device or scene file with every key and a comment on each, to fill in
///
/// The numbers of a device are examples that run on the simulated board. docs/devices.md explains how to find your own.
/// A scene has one wall, in front of the home pose of --device: well within the range that is predicted stable there
/// and within the motors, and so soft that its force ripples by at most 0.1 N under a hand.
/// `paddles` is short for `paddles-2`, `chain` for `chain-3`: the number counts joints.
/// --from converts a model in URDF or MJCF to a device of the mechanism `chain` (docs/files.md).
#[derive(clap::Args)]
pub struct Args {
    /// Mechanism of the device, or `scene`
    #[arg(required_unless_present = "from")]
    kind: Option<FileKind>,
    /// File to write [default: standard output]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// For a scene: its device file [default: the output of `haptic new five-bar`]
    #[arg(long, value_name = "FILE")]
    device: Option<PathBuf>,
    /// Model in URDF or MJCF to convert
    #[arg(long, value_name = "FILE", conflicts_with_all = ["kind", "device"])]
    from: Option<PathBuf>,
    /// With --from: link whose origin is the tip [default: the last link of the longest path]
    #[arg(long, value_name = "LINK", requires = "from")]
    tip: Option<String>,
    /// With --from: joints that move, three at most; all others are held at zero [default: all from base to tip]
    #[arg(long, value_name = "A,B,C", value_delimiter = ',', requires = "from")]
    joints: Vec<String>,
    #[command(flatten)]
    force: ForceOption,
}

/// Kind of the file: the device of a mechanism, or a scene.
#[derive(Clone, Copy)]
enum FileKind {
    Device(Kind),
    Scene,
}

/// All kinds: the mechanisms in the order of the catalogue, then a scene.
const ALL: [FileKind; Kind::ALL.len() + 1] = {
    let mut all = [FileKind::Scene; Kind::ALL.len() + 1];
    let mut i = 0;
    while i < Kind::ALL.len() {
        all[i] = FileKind::Device(Kind::ALL[i]);
        i += 1;
    }
    all
};

impl ValueEnum for FileKind {
    fn value_variants<'a>() -> &'a [Self] {
        &ALL
    }
    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(match self {
            // The name in device files stands for the example that differs most from the other mechanisms.
            Self::Device(kind @ (Kind::Paddles2 | Kind::Chain3)) => {
                PossibleValue::new(kind.spec().label).alias(kind.spec().name)
            }
            Self::Device(kind) => PossibleValue::new(kind.spec().label),
            Self::Scene => PossibleValue::new("scene"),
        })
    }
}

pub fn run(args: Args) -> Result<(), Failure> {
    let Some(kind) = args.kind else { return convert(args) };
    let (text, what) = match kind {
        FileKind::Device(_) if args.device.is_some() => {
            return Err(Failure::wrong("--device is for a scene").remedy("write: haptic new scene --device FILE"));
        }
        FileKind::Device(kind) => (device_text(kind, &args)?, format!("an example {} to fill in", kind.spec().label)),
        FileKind::Scene => {
            let file = match &args.device {
                Some(path) => DeviceFile::load(path)?,
                None => DeviceFile::parse(&device_file(Kind::FiveBar, "my-device"), "the example five-bar")?,
            };
            (scene_file(&file)?, format!("a wall in front of {} at home", file.name))
        }
    };
    let Some(path) = args.output else { return print(&text) };
    output::write(&path, text.as_bytes(), args.force.overwrite())?;
    let path = path.display();
    let check = match (kind, &args.device) {
        (FileKind::Device(_), _) => format!("haptic check {path}"),
        (FileKind::Scene, Some(device)) => format!("haptic check {} {path}", device.display()),
        (FileKind::Scene, None) => format!("haptic check DEVICE {path}"),
    };
    print(&format!("{path}: {what}; then `{check}`\n"))
}

/// Converts a model in URDF or MJCF.
fn convert(args: Args) -> Result<(), Failure> {
    let model = args.from.ok_or_else(|| Failure::wrong("no kind and no model is named"))?;
    let document = Document::load(&model)?;
    let selection = Selection { tip: args.tip, joints: args.joints };
    let converted = haptic_import::convert(document.text(), &model, &selection)?;
    let Some(path) = args.output else { return print(&converted.device_file) };
    output::write(&path, converted.device_file.as_bytes(), args.force.overwrite())?;
    let (path, count) = (path.display(), converted.joints);
    let joints = if count == 1 { "joint" } else { "joints" };
    let remarks: String = converted.remarks.iter().map(|remark| format!("  {remark}\n")).collect();
    print(&format!("{path}: a chain of {count} {joints}; then `haptic check {path}`\n{remarks}"))
}

/// Returns the text of a device file, with the device named after the file.
fn device_text(kind: Kind, args: &Args) -> Result<String, Failure> {
    let stem = args.output.as_deref().and_then(|path| path.file_stem()).and_then(|stem| stem.to_str());
    let name = stem.unwrap_or("my-device");
    if name.trim().is_empty() || name.chars().any(char::is_control) {
        return Err(Failure::wrong("a device's name must be printable text on one line").remedy("name another file"));
    }
    Ok(device_file(kind, name))
}
