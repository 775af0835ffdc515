//! Makes the archive: one folder with the tool, licenses, documents, completions and manual pages.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context as _, Result};
use flate2::{Compression, GzBuilder};
use tar::{Builder, Header};

use super::{FILE_TIME, create_empty, licenses, output, write};
use crate::paths::root;

/// Text of the archive's README.txt.
const README: &str = "\
haptic: configure, watch, simulate and analyse boards that render hard walls on haptic devices

In this folder, without hardware:

    ./haptic demo                     a simulated hand presses into a wall; draws haptic-demo.svg
    ./haptic view --port sim          the same in the browser, until Ctrl-C

haptic-page.html is the page of `haptic view` as a file: it opens in a browser without the tool.

To run `haptic` from every folder, install it; it needs no other file:

    install -Dt ~/.local/bin haptic   (Windows: copy haptic.exe to a folder of your PATH)

On macOS, once, before the first run: xattr -d com.apple.quarantine haptic

With a board (the tool contains its firmware):

    sudo cp 70-haptic-bridge.rules /etc/udev/rules.d/ && sudo udevadm control --reload    (Linux, once)
    haptic flash                      flashes the board that is plugged in and keeps its settings
    haptic info                       shows the board
    haptic device my-device.toml      loads your device: begin with a file of devices/, and follow docs/bring-up.md
    haptic scene my-scene.toml        loads a wall
    haptic home                       homes, with the device in its home pose
    haptic polarity                   checks that each motor pushes in the direction of its encoder
    haptic arm --key                  motors on while Space is held: feel the wall

devices/      devices and scenes to start from: haptic check devices/haply-2diy.toml
docs/         the documents: describing a device, wiring and starting a board (bring-up.md), and more
completions/  for the shell: source completions/haptic.bash, or copy the file to your shell's folder
man/          the manual: man -M man haptic

Motors move. Every limit is in force before a board arms, and `haptic arm` ends with Ctrl-C. This is not a certified
safety system.
";

/// Shells, and the file name of the completions for each.
const SHELLS: [(&str, &str); 5] = [
    ("bash", "haptic.bash"),
    ("elvish", "haptic.elv"),
    ("fish", "haptic.fish"),
    ("powershell", "_haptic.ps1"),
    ("zsh", "_haptic"),
];

/// Writes the archive, which unpacks to the folder `name`. The folder also stays next to the archive.
pub fn write_archive(place: &Path, name: &str, tool: &Path, page: &Path) -> Result<PathBuf> {
    let folder = place.join(name);
    create_empty(&folder)?;
    collect_files(&folder, tool, page)?;
    let path = place.join(format!("{name}.tar.gz"));
    pack(&folder, name, &path)?;
    Ok(path)
}

fn collect_files(folder: &Path, tool: &Path, page: &Path) -> Result<()> {
    let copy = |from: &Path| {
        let to = folder.join(from.file_name().unwrap_or_default());
        fs::copy(from, &to).with_context(|| format!("cannot copy {} to {}", from.display(), to.display()))
    };
    copy(tool)?;
    copy(page)?;
    licenses::write_into(folder)?;
    write(&folder.join("README.txt"), README.as_bytes())?;
    write(&folder.join("70-haptic-bridge.rules"), output(Command::new(tool).arg("udev"))?.as_bytes())?;
    let completions = folder.join("completions");
    create_empty(&completions)?;
    for (shell, name) in SHELLS {
        write(&completions.join(name), output(Command::new(tool).args(["completions", shell]))?.as_bytes())?;
    }
    output(Command::new(tool).args(["completions", "--man"]).arg(folder.join("man/man1")))?;
    for part in ["devices", "docs"] {
        let from = root().join(part);
        for file in &files(&from)? {
            let to = folder.join(part).join(file.strip_prefix(&from)?);
            fs::create_dir_all(to.parent().unwrap_or(folder))?;
            fs::copy(file, &to).with_context(|| format!("cannot copy {}", file.display()))?;
        }
    }
    Ok(())
}

/// Returns the files below a folder, in the same order on every computer.
fn files(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = fs::read_dir(folder).with_context(|| format!("cannot read {}", folder.display()))?;
    let mut paths = entries.map(|entry| Ok(entry?.path())).collect::<Result<Vec<_>>>()?;
    paths.sort();
    let mut found = Vec::new();
    for path in paths {
        if path.is_dir() { found.extend(files(&path)?) } else { found.push(path) }
    }
    Ok(found)
}

/// Packs a folder. The same files give the same archive on every computer and day.
fn pack(folder: &Path, name: &str, path: &Path) -> Result<()> {
    let file = fs::File::create(path).with_context(|| format!("cannot write {}", path.display()))?;
    let mut tar = Builder::new(GzBuilder::new().write(file, Compression::best()));
    for file in files(folder)? {
        let inside = file.strip_prefix(folder)?;
        let bytes = fs::read(&file).with_context(|| format!("cannot read {}", file.display()))?;
        let is_program = inside.file_stem().is_some_and(|stem| stem == "haptic") && inside.components().count() == 1;
        let mut header = Header::new_gnu();
        header.set_size(bytes.len() as u64);
        header.set_mode(if is_program { 0o755 } else { 0o644 });
        header.set_mtime(FILE_TIME);
        tar.append_data(&mut header, Path::new(name).join(inside), bytes.as_slice())?;
    }
    tar.into_inner()?.finish()?;
    Ok(())
}
