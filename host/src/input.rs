//! Files that a person names: read whole, so only regular ones of a sane size are.

use std::io::{Error, Read};
use std::path::Path;

/// Largest file that is read, bytes. The largest shipped one has four thousand.
pub const LARGEST: u64 = 1 << 20;

/// Largest recording that is read, bytes: a quarter of an hour of all fields at 20 kHz.
pub const LARGEST_RECORDING: u64 = 2 << 30;

/// Reads a regular file (following links) of at most [`LARGEST`] bytes. A pipe or a device is refused before it is
/// opened: it might never end, or never begin.
pub fn read(path: &Path) -> Result<Vec<u8>, Error> {
    let bytes = read_most(path, LARGEST + 1)?;
    if bytes.len() as u64 > LARGEST {
        return Err(Error::other("it has more than 1 MiB, which no file of this kind has"));
    }
    Ok(bytes)
}

/// Reads a recording of at most [`LARGEST_RECORDING`] bytes. A larger one is refused before it is read.
pub fn read_recording(path: &Path) -> Result<Vec<u8>, Error> {
    if std::fs::metadata(path)?.len() > LARGEST_RECORDING {
        return Err(Error::other(
            "it has more than 2 GiB, and is read into memory: record fewer fields or every nth row, or plot a part of it",
        ));
    }
    read_most(path, LARGEST_RECORDING)
}

/// Reads a regular file of any size: for those that this tool wrote.
pub fn read_own(path: &Path) -> Result<Vec<u8>, Error> {
    read_most(path, u64::MAX)
}

fn read_most(path: &Path, most: u64) -> Result<Vec<u8>, Error> {
    let found = std::fs::metadata(path)?;
    if !found.is_file() && !found.is_dir() {
        return Err(Error::other("it is a pipe or a device, not a file"));
    }
    let mut bytes = Vec::new();
    // A file may grow, or hide its size as those in /proc do.
    std::fs::File::open(path)?.take(most).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// As [`read`], as text.
pub fn read_to_string(path: &Path) -> Result<String, Error> {
    String::from_utf8(read(path)?).map_err(|_| Error::other("it is not UTF-8 text"))
}
