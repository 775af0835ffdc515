//! An ELF file for the chip, with contents for the emulator's memory and addresses of symbols.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use object::{Object, ObjectSection, ObjectSymbol, SectionKind, SymbolKind};

/// Flash sectors that memory.x reserves for the settings.
pub const SETTINGS_RANGE: Range<u64> = 0x0800_4000..0x0800_C000;

/// Flash sectors of the code.
pub const CODE_RANGE: Range<u64> = 0x0800_C000..0x0806_C000;

/// Name of the control interrupt's handler in the vector table.
pub const CONTROL_INTERRUPT: &str = "TIM1_UP_TIM10";

/// A firmware image of a build, which the emulator loads without changes.
#[derive(Clone, Debug)]
pub struct Firmware {
    path: PathBuf,
    bytes: Vec<u8>,
    symbols: BTreeMap<String, Symbol>,
    text: (u64, u64),
}

/// Address and size of a symbol. The address of a function has no Thumb bit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Symbol {
    /// Address of the first byte.
    pub address: u64,
    /// Size in bytes, or 0 if the linker gave none.
    pub size: u64,
}

impl Firmware {
    /// Reads the ELF file at `path`.
    /// Returns an error if the file does not exist or is not ELF.
    pub fn read(path: impl AsRef<Path>) -> Result<Self, String> {
        let path = path.as_ref().to_owned();
        let bytes = std::fs::read(&path)
            .map_err(|error| format!("{}: {error} (build it with `cargo xtask fw`)", path.display()))?;
        let elf = object::File::parse(&*bytes).map_err(|error| format!("{}: {error}", path.display()))?;
        let symbols = elf
            .symbols()
            .filter_map(|symbol| {
                let name = symbol.name().ok().filter(|name| !name.is_empty())?;
                let thumb = u64::from(symbol.kind() == SymbolKind::Text);
                let address = symbol.address() & !thumb;
                Some((name.to_owned(), Symbol { address, size: symbol.size() }))
            })
            .collect();
        let text = elf
            .section_by_name(".text")
            .map_or((0, 0), |section| (section.address(), section.address() + section.size()));
        Ok(Self { path, symbols, text, bytes })
    }

    /// Returns the release image of the board `name`, built by `cargo xtask fw`. An up-to-date image is not built
    /// again. If `HAPTIC_FIRMWARE_DIR` is set, the image is read from that directory.
    /// Returns an error if the image cannot be built or read.
    pub fn build(name: &str) -> Result<Self, String> {
        if let Some(directory) = std::env::var_os("HAPTIC_FIRMWARE_DIR") {
            return Self::read(Path::new(&directory).join(format!("haptic-firmware-{name}.elf")));
        }
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        let built = Command::new("cargo")
            .args(["run", "--quiet", "--package", "xtask", "--", "fw", name])
            .current_dir(root)
            .stderr(Stdio::inherit())
            .output()
            .map_err(|error| format!("the firmware cannot be built: {error}"))?;
        let printed = String::from_utf8_lossy(&built.stdout);
        let path = printed.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(": "));
        match path {
            Some(path) if built.status.success() => Self::read(path),
            _ => Err(format!("the firmware cannot be built: `cargo xtask fw {name}` failed")),
        }
    }

    /// Returns the bytes of the file.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Returns the path of the file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the start address of the code and the address after its end.
    #[must_use]
    pub fn text(&self) -> (u64, u64) {
        self.text
    }

    /// Returns the symbol `name`.
    /// Returns an error if the image has no such symbol.
    pub fn symbol(&self, name: &str) -> Result<Symbol, String> {
        self.find(name).ok_or_else(|| format!("{} has no symbol {name}", self.path.display()))
    }

    /// Returns the symbol `name`, or `None` if the image does not have it.
    #[must_use]
    pub fn find(&self, name: &str) -> Option<Symbol> {
        self.symbols.get(name).copied()
    }

    /// Returns the only symbol whose name ends with `ending`, the end of a static's mangled path such as
    /// `9interrupt7CONTROL`.
    #[must_use]
    pub fn find_ending(&self, ending: &str) -> Option<Symbol> {
        // If the compiler splits a static, the number of the part follows the name.
        let plain =
            |name: &str| name.trim_end_matches(|letter: char| letter.is_ascii_digit()).ends_with(&format!("{ending}."));
        let mut matches = self.symbols.iter().filter(|(name, _)| name.ends_with(ending) || plain(name));
        matches.next().map(|(_, symbol)| *symbol).filter(|_| matches.next().is_none())
    }

    /// Returns the code of the function `symbol`, or `None` if the image has no code at this address.
    #[must_use]
    pub fn code(&self, symbol: Symbol) -> Option<Vec<u8>> {
        let elf = object::File::parse(&*self.bytes).ok()?;
        elf.sections().find_map(|section| {
            let data = section.data_range(symbol.address, symbol.size).ok()??;
            (section.kind() == SectionKind::Text).then(|| data.to_vec())
        })
    }

    /// Returns all symbols and their names, sorted by name.
    pub fn symbols(&self) -> impl Iterator<Item = (&str, Symbol)> {
        self.symbols.iter().map(|(name, &symbol)| (name.as_str(), symbol))
    }

    /// Returns the contents of the file in the form that the emulator loads into memory.
    /// Returns any error of rigless about the ELF file.
    pub fn image(&self) -> Result<rigless::image::Image, rigless::image::Error> {
        rigless::image::Image::new(&self.path, self.bytes.clone(), None)
    }
}
