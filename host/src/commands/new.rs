//! `haptic new`: a device file to start from.

use clap::ValueEnum;
use clap::builder::PossibleValue;
use haptic::error::{Failure, print};
use haptic::template::device_file;
use haptic_bridge::model::catalogue::Kind;
use std::io::Write;
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
    /// Write over a file that is there
    #[arg(long)]
    force: bool,
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
    let mut options = std::fs::OpenOptions::new();
    options.write(true);
    if args.force {
        options.create(true).truncate(true)
    } else {
        options.create_new(true)
    };
    let opened = options.open(&path);
    if let Err(error) = &opened
        && error.kind() == std::io::ErrorKind::AlreadyExists
    {
        return Err(
            Failure::wrong(format!("{} is there already", path.display())).remedy("name another file, or add --force")
        );
    }
    opened
        .and_then(|mut file| file.write_all(text.as_bytes()))
        .map_err(|error| Failure::impossible(format!("{} cannot be written: {error}", path.display())))?;
    let path = path.display();
    print(&format!("{path}: an example {} to fill in; then `haptic check {path}`\n", args.kind.0.spec().name))
}
