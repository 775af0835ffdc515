//! Reads files that the user names. Accepts only regular files up to a size limit, because they are read into memory.

use std::io::{Error, Read};
use std::path::Path;

/// Size limit of a file, bytes. The largest shipped file has 4000 bytes.
pub const MAX_FILE_BYTES: u64 = 1 << 20;

/// Size limit of a recording, bytes: 15 minutes of all fields at 20 kHz.
pub const MAX_RECORDING_BYTES: u64 = 2 << 30;

/// Reads a regular file (following links) of at most [`MAX_FILE_BYTES`] bytes. Refuses a pipe or a device before
/// opening it, because reading it might block or never end.
pub fn read(path: &Path) -> Result<Vec<u8>, Error> {
    let bytes = read_limited(path, MAX_FILE_BYTES + 1)?;
    if bytes.len() as u64 > MAX_FILE_BYTES {
        return Err(Error::other("the file has more than 1 MiB, too much for a file of this kind"));
    }
    Ok(bytes)
}

/// Reads a recording of at most [`MAX_RECORDING_BYTES`] bytes. Refuses a larger file before reading it.
pub fn read_recording(path: &Path) -> Result<Vec<u8>, Error> {
    if std::fs::metadata(path)?.len() > MAX_RECORDING_BYTES {
        return Err(Error::other(
            "more than 2 GiB, too much to read into memory: record fewer fields or every nth row, or plot a part of the file",
        ));
    }
    read_limited(path, MAX_RECORDING_BYTES)
}

/// Reads a regular file of any size that this tool wrote.
pub fn read_any_size(path: &Path) -> Result<Vec<u8>, Error> {
    read_limited(path, u64::MAX)
}

fn read_limited(path: &Path, limit: u64) -> Result<Vec<u8>, Error> {
    let about = std::fs::metadata(path)?;
    if !about.is_file() && !about.is_dir() {
        return Err(Error::other("the path is a pipe or a device, not a file"));
    }
    let mut bytes = Vec::new();
    // A file may grow during the read, or report no size, like the files in /proc.
    std::fs::File::open(path)?.take(limit).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// Like [`read`], but returns text.
pub fn read_to_string(path: &Path) -> Result<String, Error> {
    String::from_utf8(read(path)?).map_err(|_| Error::other("the file is not UTF-8 text"))
}
