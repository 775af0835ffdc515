//! The one place that decides how code for the chip is compiled.
//!
//! 1. The rustup target `thumbv7em-none-eabihf`, when the running toolchain has it.
//! 2. Else Debian's own packages: a compiler in /usr/bin with the source of the core library, which is then built along
//!    (`-Zbuild-std`), and the linker that /usr/bin/rust-lld points to.
//! 3. Else, with `--install`, or as root on Debian where `CI` is set, those packages are installed.
//! 4. Else it says both install lines.

use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context as _, Result, bail};

use crate::firmware::target_directory;

/// The target triple of the chip.
pub const TARGET: &str = "thumbv7em-none-eabihf";

const DEBIAN_PACKAGES: [&str; 3] = ["rustc-web", "cargo-web", "rust-web-src"];
const DEBIAN_CORE: &str = "/usr/lib/rustlib/src/rust/library/core/Cargo.toml";
const DEBIAN_LINKER: &str = "/usr/bin/rust-lld";
const DEBIAN_CLIPPY: &str = "/usr/bin/cargo-clippy";

/// How to compile for the chip on this computer.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Toolchain {
    /// The toolchain that runs this program, which has the target.
    Rustup,
    /// Debian's compiler, building the core library along.
    Debian,
}

/// What a cargo call is for.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Use {
    /// Build.
    Build,
    /// Lint.
    Clippy,
}

impl Toolchain {
    /// Finds a way, installing Debian's packages when that is wanted.
    pub fn find(purpose: Use, install: bool) -> Result<Self> {
        if rustup_has_target() {
            return Ok(Self::Rustup);
        }
        let missing = missing_debian_packages(purpose);
        if missing.is_empty() {
            return Ok(Self::Debian);
        }
        let unattended = env::var_os("CI").is_some() && is_root();
        if Path::new("/etc/debian_version").exists() && (install || unattended) {
            apt_install(&missing)?;
            // The linker's package is known only once the compiler is there, so there may be a second round.
            let still = missing_debian_packages(purpose);
            if !still.is_empty() {
                apt_install(&still)?;
            }
            let still = missing_debian_packages(purpose);
            if still.is_empty() {
                return Ok(Self::Debian);
            }
            bail!("apt-get installed {}, but {} is still missing", missing.join(" "), still.join(" "));
        }
        bail!(
            "no compiler for {TARGET}. Either\n    rustup target add {TARGET}\nor, where rustup cannot download, on Debian\n    \
             apt-get install -y {}\n(`--install` does the latter as root)",
            install_line(&missing)
        )
    }

    /// A cargo call for the chip: `cargo SUBCOMMAND …` with the target and, where needed, the core library's source.
    pub fn cargo(self, purpose: Use) -> Command {
        let subcommand = match purpose {
            Use::Build => "rustc",
            Use::Clippy => "clippy",
        };
        let mut command = match self {
            Self::Rustup => {
                let mut command = cargo();
                command.arg(subcommand);
                command
            }
            Self::Debian => {
                let mut command = Command::new(if purpose == Use::Clippy { DEBIAN_CLIPPY } else { "/usr/bin/cargo" });
                command.arg(subcommand).arg("-Zbuild-std=core,alloc");
                command.env("CARGO", "/usr/bin/cargo").env("RUSTC", "/usr/bin/rustc").env("RUSTC_BOOTSTRAP", "1");
                command.env("PATH", format!("/usr/bin:{}", env::var("PATH").unwrap_or_default()));
                for name in ["RUSTUP_TOOLCHAIN", "RUSTC_WRAPPER", "RUSTC_WORKSPACE_WRAPPER", "RUSTDOC"] {
                    command.env_remove(name);
                }
                command
            }
        };
        command.args(["--target", TARGET]);
        command.env("CARGO_ENCODED_RUSTFLAGS", rust_flags().join("\x1f"));
        command
    }
}

/// Flags of the caller, and paths of dependencies without the part that differs between computers: an image names the
/// file of a panic, and shall be the same wherever it is built.
fn rust_flags() -> Vec<String> {
    let mut flags: Vec<String> = match env::var("CARGO_ENCODED_RUSTFLAGS") {
        Ok(flags) => flags.split('\x1f').map(String::from).collect(),
        Err(_) => env::var("RUSTFLAGS").unwrap_or_default().split_whitespace().map(String::from).collect(),
    };
    flags.retain(|flag| !flag.is_empty());
    let home = env::var_os("CARGO_HOME")
        .map(PathBuf::from)
        .or_else(|| env::var_os("HOME").map(|home| PathBuf::from(home).join(".cargo")));
    let indices = home.map(|home| home.join("registry/src")).and_then(|sources| fs::read_dir(sources).ok());
    for index in indices.into_iter().flatten().flatten() {
        flags.push(format!("--remap-path-prefix={}=", index.path().join("").display()));
    }
    flags.push("--remap-path-prefix=/usr/lib/rustlib/src/rust/library/=".into());
    // Code that build scripts write lies below the target directory.
    flags.push(format!("--remap-path-prefix={}=target", target_directory().display()));
    flags
}

fn rustup_has_target() -> bool {
    let rustc = env::var_os("RUSTC").unwrap_or_else(|| "rustc".into());
    let output = Command::new(rustc).args(["--print", "target-libdir", "--target", TARGET]).output();
    let Ok(output) = output else { return false };
    let directory = String::from_utf8_lossy(&output.stdout);
    fs::read_dir(directory.trim()).is_ok_and(|mut entries| {
        entries.any(|entry| entry.is_ok_and(|e| e.file_name().to_string_lossy().starts_with("libcore-")))
    })
}

fn missing_debian_packages(purpose: Use) -> Vec<String> {
    let there = ["/usr/bin/rustc", "/usr/bin/cargo", DEBIAN_CORE].map(|path| Path::new(path).exists());
    let mut missing: Vec<String> =
        DEBIAN_PACKAGES.iter().zip(there).filter(|(_, there)| !there).map(|(name, _)| (*name).into()).collect();
    if purpose == Use::Clippy && !Path::new(DEBIAN_CLIPPY).exists() {
        missing.push("rust-web-clippy".into());
    }
    // A link to lld-22 that leads nowhere names the package that would make it lead somewhere.
    if fs::symlink_metadata(DEBIAN_LINKER).is_ok() && !Path::new(DEBIAN_LINKER).exists() {
        let package =
            fs::read_link(DEBIAN_LINKER).ok().and_then(|to| Some(to.file_name()?.to_string_lossy().into_owned()));
        missing.push(package.unwrap_or_else(|| "lld".into()));
    }
    missing
}

fn install_line(missing: &[String]) -> String {
    let mut line = missing.join(" ");
    if !missing.iter().any(|name| name.starts_with("lld")) && !Path::new(DEBIAN_LINKER).exists() {
        line += "    # and the lld-NN that /usr/bin/rust-lld then points to";
    }
    line
}

fn is_root() -> bool {
    Command::new("id").arg("-u").output().is_ok_and(|output| output.stdout == b"0\n")
}

fn apt_install(packages: &[String]) -> Result<()> {
    eprintln!("installing {}", packages.join(" "));
    run(Command::new("apt-get").args(["update", "-q"]))?;
    run(Command::new("apt-get").args(["install", "-y", "-q", "--no-install-recommends"]).args(packages))
}

/// The cargo that runs this program.
pub fn cargo() -> Command {
    Command::new(env::var_os("CARGO").unwrap_or_else(|| "cargo".into()))
}

/// Runs a command to its end, naming it when it fails.
pub fn run(command: &mut Command) -> Result<()> {
    let name = format!("{} {}", command.get_program().display(), join(command));
    let status = command.status().with_context(|| format!("cannot run {name}"))?;
    if !status.success() {
        bail!("{name} failed ({status})");
    }
    Ok(())
}

fn join(command: &Command) -> String {
    command.get_args().map(|a| a.to_string_lossy().into_owned()).collect::<Vec<_>>().join(" ")
}

/// Sees to it that a program of Debian's package of the same name is there, installing it where that is wanted.
pub fn need_program(name: &str, install: bool) -> Result<()> {
    let there = || Command::new(name).arg("--version").output().is_ok_and(|output| output.status.success());
    let unattended = env::var_os("CI").is_some() && is_root();
    if !there() && Path::new("/etc/debian_version").exists() && (install || unattended) {
        apt_install(&[name.into()])?;
    }
    if there() { Ok(()) } else { bail!("{name} is missing; on Debian: apt-get install -y {name}") }
}

/// The triple of this computer.
pub fn host() -> Result<String> {
    let rustc = env::var_os("RUSTC").unwrap_or_else(|| "rustc".into());
    let output = Command::new(rustc).arg("-vV").output().context("cannot run rustc")?;
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let line = text.lines().find_map(|line| line.strip_prefix("host: "));
    Ok(line.context("rustc does not say what it runs on")?.to_string())
}
