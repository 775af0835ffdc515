//! `haptic new`: a device file to start from.

use super::force::Force;
use clap::ValueEnum;
use clap::builder::PossibleValue;
use haptic::error::{Failure, print};
use haptic::output;
use haptic::template::device_file;
use haptic_bridge::model::catalogue::Kind;
use std::path::PathBuf;

/// Write a device file with every key and a comment on each, to fill in
///
/// The numbers are examples that run on the simulated board. docs/devices.md says where your own come from.
#[derive(clap::Args)]
pub struct Args {
    /// Mechanism
    kind: Mechanism,
    /// File to write [default: standard output]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Name of the device [default: the file's, or "my-device"]
    #[arg(long, value_name = "NAME")]
    name: Option<String>,
    #[command(flatten)]
    force: Force,
}

/// A mechanism by its name in device files.
#[derive(Clone, Copy)]
struct Mechanism(Kind);

/// Every mechanism, in the order of the catalogue.
const ALL: [Mechanism; Kind::ALL.len()] = {
    let mut all = [Mechanism(Kind::ALL[0]); Kind::ALL.len()];
    let mut i = 0;
    while i < all.len() {
        all[i] = Mechanism(Kind::ALL[i]);
        i += 1;
    }
    all
};

impl ValueEnum for Mechanism {
    fn value_variants<'a>() -> &'a [Self] {
        &ALL
    }
    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(PossibleValue::new(self.0.spec().name))
    }
}

/// Writes the file.
pub fn run(args: Args) -> Result<(), Failure> {
    let stem = args.output.as_deref().and_then(|path| path.file_stem()).and_then(|stem| stem.to_str());
    let name = args.name.as_deref().or(stem).unwrap_or("my-device");
    if name.trim().is_empty() || name.chars().any(char::is_control) {
        return Err(Failure::wrong("a device's name must be printable text on one line").remedy("give another --name"));
    }
    let text = device_file(args.kind.0, name);
    let Some(path) = args.output else { return print(&text) };
    output::write(&path, text.as_bytes(), args.force.overwrite())?;
    let path = path.display();
    print(&format!("{path}: an example {} to fill in; then `haptic check {path}`\n", args.kind.0.spec().name))
}
