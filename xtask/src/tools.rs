//! The programs that the tests need on this computer: checks that each runs, and installs missing ones or explains how.
//! The check comes before the first compile.
//!
//! The check runs the program itself and does not look for its package: a linker is present if it runs.

use std::env;
use std::fs;
use std::path::Path;
use std::process::Command;

use anyhow::{Result, bail};
use semver::Version;

use crate::toolchain::{
    BROWSERS, DEBIAN_CARGO, DEBIAN_CLIPPY, DEBIAN_CORE, DEBIAN_LINKER, DEBIAN_RUSTC, TARGET, Toolchain, Use, run,
};

/// A program or file that a stage needs.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Tool {
    Compiler,
    Cargo,
    Core,
    Linker,
    Clippy,
    Cpp,
    Browser,
    Python,
}

impl Tool {
    const ALL: [Self; 8] =
        [Self::Compiler, Self::Cargo, Self::Core, Self::Linker, Self::Clippy, Self::Cpp, Self::Browser, Self::Python];

    fn name(self) -> &'static str {
        match self {
            Self::Compiler => {
                concat!("a Rust compiler for the chip and for browsers, ", env!("CARGO_PKG_RUST_VERSION"), " or newer")
            }
            Self::Cargo => "its cargo",
            Self::Core => "the source of its core library",
            Self::Linker => "a linker for the chip (rust-lld)",
            Self::Clippy => "its clippy",
            Self::Cpp => "a C++ compiler (c++, or what CXX names) for libFuzzer",
            Self::Browser => "a browser without a screen (chromium) for the tests of `haptic view`",
            Self::Python => "Python 3.11 or newer with venv and pip (python3)",
        }
    }

    /// Returns Debian's package. The linker needs two packages: this package has a link to the linker of the other
    /// package.
    fn package(self) -> &'static str {
        match self {
            Self::Compiler => "rustc-web",
            Self::Cargo => "cargo-web",
            Self::Core => "rust-web-src",
            Self::Linker => "rust-web-llvm",
            Self::Clippy => "rust-web-clippy",
            Self::Cpp => "g++",
            Self::Browser => "chromium",
            Self::Python => "python3-venv",
        }
    }

    fn runs(self) -> bool {
        let version = |program: &str| succeeds(program, &["--version"]);
        match self {
            Self::Compiler => compiler_is_new_enough(DEBIAN_RUSTC),
            Self::Cargo => version(DEBIAN_CARGO),
            Self::Core => Path::new(DEBIAN_CORE).exists(),
            Self::Linker => linker_runs(DEBIAN_LINKER),
            Self::Clippy => version(DEBIAN_CLIPPY),
            Self::Cpp => version(&env::var("CXX").unwrap_or_else(|_| "c++".into())),
            // The names that tool/tests/browser tries.
            Self::Browser => ["chromium", "chromium-browser", "google-chrome"].into_iter().any(version),
            Self::Python => {
                succeeds("python3", &["-c", "import ensurepip, sys, venv; sys.exit(sys.version_info < (3, 11))"])
            }
        }
    }
}

/// The tools on a computer.
#[derive(Clone, PartialEq, Eq, Debug)]
struct Installed {
    /// True if rustup's toolchain compiles and links for the chip.
    chip: bool,
    /// True if rustup's toolchain compiles and links for browsers.
    browsers: bool,
    /// Other tools that run.
    runs: Vec<Tool>,
    /// Package to whose linker /usr/bin/rust-lld links, even if the linker is missing.
    linker: Option<String>,
}

impl Installed {
    fn now() -> Self {
        let target = fs::read_link(DEBIAN_LINKER).ok();
        Self {
            chip: rustup_has(TARGET),
            browsers: rustup_has(BROWSERS),
            runs: Tool::ALL.into_iter().filter(|tool| tool.runs()).collect(),
            linker: target.and_then(|to| Some(to.file_name()?.to_string_lossy().into_owned())),
        }
    }

    /// Returns the tools that these uses need and that do not run.
    fn missing(&self, uses: &[Use]) -> Vec<Tool> {
        let compiles = [Tool::Compiler, Tool::Cargo, Tool::Core, Tool::Linker];
        let needed = Tool::ALL.into_iter().filter(|tool| match tool {
            Tool::Cpp => uses.contains(&Use::Fuzz),
            Tool::Browser => uses.contains(&Use::Page),
            Tool::Python => uses.contains(&Use::Python),
            Tool::Clippy => uses.contains(&Use::Clippy) && !self.chip,
            tool => compiles.contains(tool) && !self.targets(uses).is_empty(),
        });
        needed.filter(|tool| !self.runs.contains(tool)).collect()
    }

    /// Returns the targets of these uses that rustup's toolchain does not have.
    fn targets(&self, uses: &[Use]) -> Vec<&'static str> {
        let mut targets = Vec::new();
        if !self.chip && (uses.contains(&Use::Build) || uses.contains(&Use::Clippy)) {
            targets.push(TARGET);
        }
        if !self.browsers && uses.contains(&Use::Playground) {
            targets.push(BROWSERS);
        }
        targets
    }

    /// Returns the toolchain for these uses, or an error that lists the missing tools.
    fn toolchain(&self, uses: &[Use]) -> Result<Toolchain> {
        let missing = self.missing(uses);
        if !missing.is_empty() {
            bail!("{}", self.missing_message(uses, &missing));
        }
        Ok(if self.targets(uses).is_empty() { Toolchain::Rustup } else { Toolchain::Debian })
    }

    /// Returns the packages of these tools. The linker's second package is known only once the link exists.
    fn packages(&self, missing: &[Tool]) -> Vec<String> {
        let package = |tool: &Tool| match (&self.linker, tool) {
            (Some(linker), Tool::Linker) => linker.clone(),
            _ => tool.package().into(),
        };
        missing.iter().map(package).collect()
    }

    /// Returns a shell command that installs these tools.
    fn install_line(&self, missing: &[Tool]) -> String {
        let apt = "apt-get install -y --no-install-recommends";
        let mut line = format!("apt-get update && {apt} {}", self.packages(missing).join(" "));
        if missing.contains(&Tool::Linker) && self.linker.is_none() {
            line += &format!(" && {apt} \"$(basename \"$(readlink {DEBIAN_LINKER})\")\"");
        }
        line
    }

    /// Returns a message with the missing tools and the commands that install them.
    fn missing_message(&self, uses: &[Use], missing: &[Tool]) -> String {
        let mut text = String::from("missing on this computer:\n");
        for tool in missing {
            text += &format!("    {}\n", tool.name());
        }
        text += &format!("On Debian, as root:\n    {}\n", self.install_line(missing));
        let by_hand = |tool: &&Tool| matches!(tool, Tool::Cpp | Tool::Browser | Tool::Python);
        let rest: Vec<&str> = missing.iter().filter(by_hand).map(|tool| tool.name()).collect();
        if rest.len() < missing.len() {
            text += &format!("On other systems:\n    rustup target add {}", self.targets(uses).join(" "));
            rest.iter().for_each(|name| text += &format!("\nand {name}"));
        }
        text.trim_end().into()
    }
}

/// Checks that all tools for these uses are present. As root on Debian it installs missing ones: targets with rustup if
/// possible, everything else from Debian's packages. Returns the toolchain for the chip.
pub fn provide(uses: &[Use]) -> Result<Toolchain> {
    let install = Path::new("/etc/debian_version").exists() && is_root();
    let mut found = Installed::now();
    if install && !found.targets(uses).is_empty() && !found.missing(uses).is_empty() {
        let targets = found.targets(uses);
        eprintln!("installing {} with rustup", targets.join(" "));
        if succeeds("rustup", &[&["target", "add"], &targets[..]].concat()) {
            found = Installed::now();
        }
    }
    // Two rounds, because the link of the first package names the package of the linker itself.
    for _ in 0..2 {
        let missing = found.missing(uses);
        if missing.is_empty() || !install {
            break;
        }
        let packages = found.packages(&missing);
        eprintln!("installing {}", packages.join(" "));
        run(Command::new("apt-get").args(["update", "-q"]))?;
        let flags = ["install", "-y", "-q", "--no-install-recommends"];
        run(Command::new("apt-get").env("DEBIAN_FRONTEND", "noninteractive").args(flags).args(&packages))?;
        found = Installed::now();
    }
    found.toolchain(uses)
}

/// The uses of `cargo xtask test`.
pub const TEST: [Use; 1] = [Use::Build];
/// The uses of `cargo xtask test --deep`.
pub const DEEP: [Use; 5] = [Use::Build, Use::Fuzz, Use::Page, Use::Playground, Use::Python];

fn succeeds(program: &str, arguments: &[&str]) -> bool {
    Command::new(program).args(arguments).output().is_ok_and(|output| output.status.success())
}

/// Returns true if this lld runs. It contains several linkers, and the flavor selects one, as the compiler does.
fn linker_runs(program: &str) -> bool {
    succeeds(program, &["-flavor", "gnu", "--version"])
}

fn compiler_is_new_enough(program: &str) -> bool {
    let output = Command::new(program).arg("--version").output();
    output.is_ok_and(|output| output.status.success() && new_enough(&String::from_utf8_lossy(&output.stdout)))
}

fn new_enough(version: &str) -> bool {
    let least = Version::parse(concat!(env!("CARGO_PKG_RUST_VERSION"), ".0"));
    let found = version.split_whitespace().nth(1).and_then(|number| Version::parse(number).ok());
    found.zip(least.ok()).is_some_and(|(found, least)| found >= least)
}

/// Returns true if the toolchain that runs this program has a target's core library and a linker.
fn rustup_has(target: &str) -> bool {
    let rustc = env::var("RUSTC").unwrap_or_else(|_| "rustc".into());
    let directory = |arguments: &[&str]| -> Result<String> {
        let output = Command::new(&rustc).args(["--print", "target-libdir"]).args(arguments).output()?;
        Ok(String::from_utf8_lossy(&output.stdout).trim().to_string())
    };
    let core = directory(&["--target", target]).ok().and_then(|path| fs::read_dir(path).ok()).is_some_and(|entries| {
        entries.flatten().any(|entry| entry.file_name().to_string_lossy().starts_with("libcore-"))
    });
    let own = || directory(&[]).is_ok_and(|libraries| linker_runs(&format!("{libraries}/../bin/rust-lld")));
    core && (own() || linker_runs("rust-lld"))
}

fn is_root() -> bool {
    Command::new("id").arg("-u").output().is_ok_and(|output| output.stdout == b"0\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn installed(runs: &[Tool], linker: Option<&str>) -> Installed {
        Installed { chip: false, browsers: false, runs: runs.to_vec(), linker: linker.map(Into::into) }
    }

    /// A new Debian after the first packages: no package depends on the linker, which is missing.
    #[test]
    fn a_missing_linker_is_found_before_the_first_compile() {
        let after = installed(&[Tool::Compiler, Tool::Cargo, Tool::Core, Tool::Cpp, Tool::Browser, Tool::Python], None);
        let missing = after.missing(&DEEP);
        assert_eq!(missing, [Tool::Linker]);
        assert_eq!(after.packages(&missing), ["rust-web-llvm"]);
        // This package has the link, and the link's target is missing.
        let then = installed(&after.runs, Some("lld-22"));
        assert_eq!(then.packages(&then.missing(&DEEP)), ["lld-22"]);
        let complete = installed(&[&after.runs[..], &[Tool::Linker]].concat(), Some("lld-22"));
        assert!(complete.missing(&DEEP).is_empty());
        // Lints need one more tool.
        assert_eq!(complete.missing(&[Use::Clippy]), [Tool::Clippy]);
    }

    #[test]
    fn all_missing_tools_are_named_with_one_install_command() {
        let bare = installed(&[], None);
        let missing = bare.missing(&DEEP);
        let text = bare.missing_message(&DEEP, &missing);
        for tool in &missing {
            assert!(text.contains(tool.name()), "{tool:?} in\n{text}");
        }
        let line = "rustc-web cargo-web rust-web-src rust-web-llvm g++ chromium python3-venv && apt-get install -y --no-install-recommends \
                    \"$(basename \"$(readlink /usr/bin/rust-lld)\")\"";
        assert!(text.contains(line) && text.contains("rustup target add"), "{text}");
    }

    #[test]
    fn only_needed_tools_that_rustup_lacks_are_installed() {
        let rustup = Installed { chip: true, ..installed(&[], None) };
        assert!(rustup.missing(&[Use::Build, Use::Clippy]).is_empty());
        assert!(rustup.missing(&TEST).is_empty());
        let both = Installed { browsers: true, ..rustup.clone() };
        assert_eq!(both.missing(&DEEP), [Tool::Cpp, Tool::Browser, Tool::Python]);
        assert!(!both.missing_message(&DEEP, &[Tool::Cpp, Tool::Browser]).contains("rustup"));
        // The page as a file needs another target.
        let complaint = rustup.toolchain(&[Use::Playground]).unwrap_err().to_string();
        assert!(complaint.contains("rust-web-src") && complaint.ends_with("rustup target add wasm32-unknown-unknown"));
        let browsers = Installed { browsers: true, ..installed(&[], None) };
        assert!(matches!(browsers.toolchain(&[Use::Playground]), Ok(Toolchain::Rustup)));
        assert_eq!(installed(&[], None).missing(&[Use::Fuzz]), [Tool::Cpp]);
    }

    #[test]
    fn an_old_compiler_is_rejected() {
        assert!(new_enough("rustc 1.95.0 (abc 2026-01-01)") && new_enough("rustc 1.96.0 (def) (built from a source)"));
        assert!(!new_enough("rustc 1.85.0 (Debian)") && !new_enough("rustc 1.63.0") && !new_enough(""));
    }

    #[test]
    fn a_broken_link_is_not_a_linker() {
        let directory = env::temp_dir().join(format!("haptic-xtask-{}", std::process::id()));
        fs::create_dir_all(&directory).unwrap();
        let link = directory.join("rust-lld");
        #[cfg(unix)]
        std::os::unix::fs::symlink("missing-lld", &link).unwrap();
        assert!(!linker_runs(&link.to_string_lossy()));
        fs::remove_dir_all(&directory).unwrap();
    }
}
