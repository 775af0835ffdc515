//! Embeds the images in images/. An image is an update file `BOARD.dfu` with its description `BOARD.toml`. The crate
//! also builds without images.

use std::path::{Path, PathBuf};
use std::{env, fs};

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    let directory =
        Path::new(&env::var_os("CARGO_MANIFEST_DIR").expect("cargo names the package's folder")).join("images");
    // Does not watch a missing folder, because Cargo would then run this script at every build.
    let watched = if directory.is_dir() { directory.as_path() } else { Path::new(".") };
    println!("cargo::rerun-if-changed={}", watched.display());
    let mut files: Vec<PathBuf> = match fs::read_dir(&directory) {
        Ok(entries) => entries.flatten().map(|entry| entry.path()).collect(),
        Err(_) => Vec::new(),
    };
    files.retain(|file| file.extension().is_some_and(|end| end == "dfu") && file.with_extension("toml").is_file());
    files.sort();
    let mut list = String::from("const IMAGES: &[EmbeddedImage] = &[\n");
    for file in &files {
        let board = file.file_stem().and_then(|stem| stem.to_str()).expect("an image is named after its board");
        let about = file.with_extension("toml");
        list += &format!(
            "    EmbeddedImage {{ board: {board:?}, file: include_bytes!({file:?}), about: include_str!({about:?}) }},\n"
        );
    }
    list += "];\n";
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR")).join("images.rs");
    fs::write(out, list).expect("OUT_DIR can be written");
}
