//! Writes files. An existing file is replaced only if the caller allows it, and no partial file remains.
//!
//! A document is written to a temporary file in the same folder and then renamed, so that a full disk or a killed tool
//! leaves the old file unchanged. A link is refused, because the user did not name its target. A device node or a pipe
//! is written directly, also through a link such as /dev/stdout.

use crate::error::{Choice, Failure};
use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use tempfile::NamedTempFile;

/// Permission to replace an existing file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Overwrite {
    /// Refuses a file that exists.
    #[default]
    Never,
    /// Replaces a file that exists.
    Replace,
}

/// The kind of a path to write to.
enum Place {
    /// A new file, or a regular file to replace.
    File,
    /// A device node or a pipe.
    Special,
}

/// Checks a path before the computation of its file. Refuses a file that may not be replaced and a path that cannot be
/// a file.
pub fn check(path: &Path, overwrite: Overwrite) -> Result<(), Failure> {
    match place(path, overwrite)? {
        Place::Special => Ok(()),
        Place::File => std::fs::metadata(folder_of(path)).map(drop).map_err(|error| write_failure(path, &error)),
    }
}

/// Checks that a path for later files is a folder.
pub fn check_folder(folder: &Path) -> Result<(), Failure> {
    let why = match std::fs::metadata(folder) {
        Ok(about) if about.is_dir() => return Ok(()),
        Ok(_) => "is not a folder".into(),
        Err(error) if error.kind() == io::ErrorKind::NotFound => "does not exist".into(),
        Err(error) => format!("cannot be used: {error}"),
    };
    Err(Failure::impossible(format!("the folder {} {why}", folder.display()))
        .remedy("make the folder first, or choose another"))
}

fn folder_of(target: &Path) -> &Path {
    target.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Formats a line of a CSV table (RFC 4180): quotes cells that contain a comma or a quote.
pub fn csv_line<C: AsRef<str>>(cells: impl IntoIterator<Item = C>) -> String {
    let quoted = |cell: C| match cell.as_ref() {
        text if text.contains([',', '"']) => format!("\"{}\"", text.replace('"', "\"\"")),
        text => text.to_owned(),
    };
    cells.into_iter().map(quoted).collect::<Vec<_>>().join(",") + "\n"
}

/// Writes a complete document.
pub fn write(path: &Path, bytes: &[u8], overwrite: Overwrite) -> Result<(), Failure> {
    match place(path, overwrite)? {
        Place::Special => {
            let written = OpenOptions::new().write(true).open(path).and_then(|mut file| {
                file.write_all(bytes)?;
                file.flush()
            });
            // A closed pipe (`--svg /dev/stdout | head`) is not an error.
            written.or_else(|error| if error.kind() == io::ErrorKind::BrokenPipe { Ok(()) } else { Err(error) })
        }
        Place::File => write_temp(path, bytes).and_then(|temporary| rename_to(temporary, path, overwrite)),
    }
    .map_err(|error| write_failure(path, &error))
}

/// Writes several documents, all or none. All are stored in temporary files before the first file is renamed.
pub fn write_together(files: &[(&Path, &[u8])], overwrite: Overwrite) -> Result<(), Failure> {
    let mut ready = Vec::new();
    for (path, bytes) in files {
        match place(path, overwrite)? {
            Place::Special => write(path, bytes, overwrite)?,
            Place::File => ready.push((path, write_temp(path, bytes).map_err(|error| write_failure(path, &error))?)),
        }
    }
    for (path, temporary) in ready {
        rename_to(temporary, path, overwrite).map_err(|error| write_failure(path, &error))?;
    }
    Ok(())
}

/// Opens a file for appending rows. Returns the file, and true if the file can be truncated to its last complete row.
pub fn open(path: &Path, overwrite: Overwrite) -> Result<(File, bool), Failure> {
    let opened = match place(path, overwrite)? {
        Place::Special => OpenOptions::new().write(true).open(path).map(|file| (file, false)),
        Place::File => {
            let mut options = OpenOptions::new();
            options.write(true);
            match overwrite {
                Overwrite::Never => options.create_new(true),
                Overwrite::Replace => options.create(true).truncate(true),
            };
            options.open(path).map(|file| (file, true))
        }
    };
    opened.map_err(|error| write_failure(path, &error))
}

/// Returns a path that does not exist yet: `name.svg`, `name-2.svg`, `name-3.svg`.
pub fn unused_path(path: &Path) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let ending = path.extension().map_or(String::new(), |ending| format!(".{}", ending.to_string_lossy()));
    let numbered = (2..10_000).map(|number| path.with_file_name(format!("{stem}-{number}{ending}")));
    let mut names = std::iter::once(path.to_path_buf()).chain(numbered);
    names.find(|name| name.symlink_metadata().is_err()).unwrap_or_else(|| path.into())
}

fn place(path: &Path, overwrite: Overwrite) -> Result<Place, Failure> {
    let shown = path.display();
    if path == Path::new("-") {
        return Err(Failure::wrong("cannot write to `-`, which is a file name here")
            .remedy("use /dev/stdout for the standard output, or ./- for the file"));
    }
    match std::fs::metadata(path) {
        Ok(about) if about.is_dir() => {
            Err(Failure::impossible(format!("{shown} is a directory")).remedy("name a file in it"))
        }
        Ok(about) if !about.is_file() => Ok(Place::Special),
        Ok(_) if overwrite == Overwrite::Never => {
            let reason = format!("{shown} already exists");
            Err(Failure::impossible(reason)
                .remedy("choose another name, or allow it to be overwritten")
                .choose(Choice::Overwriting))
        }
        _ => match std::fs::read_link(path) {
            Ok(to) => {
                let reason = format!("{shown} is a link to {}, and files are not written through links", to.display());
                Err(Failure::impossible(reason).remedy("name the file itself, or remove the link"))
            }
            Err(_) => Ok(Place::File),
        },
    }
}

/// Writes the bytes to a temporary file in the folder of `target`.
fn write_temp(target: &Path, bytes: &[u8]) -> io::Result<NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(".haptic-").suffix(".partial");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // The usual permissions of a new file, which the user's mask reduces.
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    let mut temporary = builder.tempfile_in(folder_of(target))?;
    // Writes to the inner file, because errors of `NamedTempFile` contain the temporary name.
    temporary.as_file_mut().write_all(bytes)?;
    temporary.as_file().sync_all()?;
    if let Ok(about) = std::fs::metadata(target) {
        temporary.as_file().set_permissions(about.permissions())?;
    }
    Ok(temporary)
}

fn rename_to(temporary: NamedTempFile, target: &Path, overwrite: Overwrite) -> io::Result<()> {
    match overwrite {
        Overwrite::Never => temporary.persist_noclobber(target).map_err(|error| error.error)?,
        Overwrite::Replace => temporary.persist(target).map_err(|error| error.error)?,
    };
    Ok(())
}

/// Describes why a file could not be written, with the remedy.
pub fn write_failure(path: &Path, error: &io::Error) -> Failure {
    let remedy = match error.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded | io::ErrorKind::FileTooLarge => {
            "free space, or choose another place"
        }
        io::ErrorKind::NotFound => "make the folder first, or choose another",
        _ => "check the path and its permissions",
    };
    // Shows only the kind of a wrapped error, whose text contains the temporary name.
    let why = match error.raw_os_error() {
        _ if error.kind() == io::ErrorKind::NotFound => "there is no such folder".into(),
        None if error.kind() != io::ErrorKind::Other => error.kind().to_string(),
        _ => error.to_string(),
    };
    Failure::impossible(format!("{} cannot be written: {why}", path.display())).remedy(remedy)
}

/// Returns the present date and time in UTC, in the format of recordings (RFC 3339).
pub fn date() -> String {
    humantime::format_rfc3339_seconds(std::time::SystemTime::now()).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(target_os = "linux")]
    #[test]
    fn a_closed_pipe_is_not_an_error() {
        use std::io::Read;
        use std::os::fd::AsRawFd;
        let (mut reader, writer) = io::pipe().unwrap();
        let path = format!("/proc/self/fd/{}", writer.as_raw_fd());
        // 1 MiB exceeds the buffer of a pipe, so the writer blocks until the reader has gone.
        let reader = std::thread::spawn(move || reader.read_exact(&mut [0; 300]).unwrap());
        write(Path::new(&path), &vec![b'x'; 1 << 20], Overwrite::Never).unwrap();
        reader.join().unwrap();
    }

    #[test]
    fn a_missing_folder_is_reported_before_any_work() {
        let folder = tempfile::tempdir().unwrap();
        let missing = folder.path().join("missing");
        let refused = check(&missing.join("p.json"), Overwrite::Replace).unwrap_err().to_string();
        assert!(refused.contains("there is no such folder; make the folder first"), "{refused}");
        let refused = check_folder(&missing).unwrap_err().to_string();
        assert!(refused.contains("missing does not exist; make the folder first"), "{refused}");
        check(&folder.path().join("p.json"), Overwrite::Never).unwrap();
        check(Path::new("p-that-is-not-there.json"), Overwrite::Never).unwrap();
        check_folder(folder.path()).unwrap();
    }

    #[test]
    fn an_existing_file_is_replaced_only_with_permission() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.txt");
        write(&path, b"one", Overwrite::Never).unwrap();
        let refused = write(&path, b"two", Overwrite::Never).unwrap_err().to_string();
        assert!(refused.contains("a.txt already exists") && refused.contains("overwritten"), "{refused}");
        assert!(check(&path, Overwrite::Never).is_err() && open(&path, Overwrite::Never).is_err());
        assert_eq!(std::fs::read(&path).unwrap(), b"one");
        write(&path, b"two", Overwrite::Replace).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"two");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "the temporary file is gone");
        assert_eq!(unused_path(&path), folder.path().join("a-2.txt"));
    }

    #[test]
    fn directories_and_missing_folders_are_refused_with_a_remedy() {
        let folder = tempfile::tempdir().unwrap();
        let refused = write(folder.path(), b"", Overwrite::Replace).unwrap_err().to_string();
        assert!(refused.contains("is a directory"), "{refused}");
        let refused = write(&folder.path().join("no/a.txt"), b"", Overwrite::Never).unwrap_err().to_string();
        assert!(refused.contains("make the folder first"), "{refused}");
    }

    #[cfg(unix)]
    #[test]
    fn links_are_refused_and_their_targets_stay_unchanged() {
        let folder = tempfile::tempdir().unwrap();
        let (target, link) = (folder.path().join("target"), folder.path().join("link"));
        std::os::unix::fs::symlink("target", &link).unwrap();
        for overwrite in [Overwrite::Never, Overwrite::Replace] {
            assert!(write(&link, b"new", overwrite).is_err() && open(&link, overwrite).is_err());
            assert!(!target.exists());
        }
        std::fs::write(&target, "old").unwrap();
        let refused = write(&link, b"new", Overwrite::Replace).unwrap_err().to_string();
        assert!(refused.contains("is a link to target"), "{refused}");
        assert!(open(&link, Overwrite::Replace).is_err());
        assert_eq!(std::fs::read_to_string(&target).unwrap(), "old");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn device_nodes_and_pipes_are_written_and_stay_in_place() {
        use std::os::unix::fs::FileTypeExt;
        write(Path::new("/dev/null"), b"gone", Overwrite::Never).unwrap();
        let full = write(Path::new("/dev/full"), b"no", Overwrite::Never).unwrap_err().to_string();
        assert!(full.contains("/dev/full cannot be written") && full.contains("free space"), "{full}");
        assert!(std::fs::metadata("/dev/full").unwrap().file_type().is_char_device());
        assert!(std::fs::metadata("/dev/null").unwrap().file_type().is_char_device());

        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        let reader = std::thread::spawn({
            let pipe = pipe.clone();
            move || std::fs::read(pipe).unwrap()
        });
        write(&pipe, b"through", Overwrite::Never).unwrap();
        assert_eq!(reader.join().unwrap(), b"through");
        assert!(std::fs::metadata(&pipe).unwrap().file_type().is_fifo());
    }
}
