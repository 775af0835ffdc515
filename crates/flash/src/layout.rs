//! The sectors of a memory, as described in the name of the boot loader's interface (UM0424 section 10.3.2).
//!
//! `@Internal Flash  /0x08000000/04*016Kg,01*064Kg,07*128Kg` contains a name, and one or more pairs of an address and
//! the sectors from this address.

/// One sector.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sector {
    /// First address.
    pub start: u32,
    /// Length, bytes.
    pub length: u32,
    /// True if the sector can be read, erased and written.
    pub usable: bool,
}

impl Sector {
    /// Returns the address after the sector.
    pub fn end(&self) -> u32 {
        self.start + self.length
    }
}

/// The sectors of one memory, in the order of the description.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Layout {
    /// Name of the memory.
    pub name: String,
    /// The sectors.
    pub sectors: Vec<Sector>,
}

/// A description that cannot be parsed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the boot loader describes its memory as {0:?}, which is not a list of sectors")]
pub struct BadLayout(pub String);

/// Maximum number of sectors in a description, more than any chip has.
const MAX_SECTORS: usize = 4096;

impl Layout {
    /// Parses a description.
    pub fn parse(text: &str) -> Result<Self, BadLayout> {
        read(text).ok_or_else(|| BadLayout(text.to_string()))
    }
}

fn read(text: &str) -> Option<Layout> {
    let mut parts = text.strip_prefix('@')?.split('/');
    let name = parts.next()?.trim().to_string();
    let mut sectors = Vec::new();
    while let Some(address) = parts.next() {
        let mut start = u32::from_str_radix(address.trim().strip_prefix("0x")?, 16).ok()?;
        for group in parts.next()?.split(',') {
            let (count, of) = group.trim_start().split_once('*')?;
            let digits = of.find(|c: char| !c.is_ascii_digit())?;
            let (size, unit) = of.split_at(digits);
            let (factor, kind) = match unit.as_bytes() {
                [b'K', kind] => (1024, *kind),
                [b'M', kind] => (1024 * 1024, *kind),
                [b'B' | b' ', kind] | [kind] => (1, *kind),
                _ => return None,
            };
            let length = size.parse::<u32>().ok()?.checked_mul(factor).filter(|length| *length > 0)?;
            for _ in 0..count.parse::<u32>().ok()? {
                if sectors.len() == MAX_SECTORS {
                    return None;
                }
                // In the letters 'a' to 'g', bit 0 means readable, bit 1 erasable, bit 2 writable.
                sectors.push(Sector { start, length, usable: kind == b'g' });
                start = start.checked_add(length)?;
            }
        }
    }
    (!sectors.is_empty()).then_some(Layout { name, sectors })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_chip_has_twelve_sectors_in_one_megabyte() {
        let layout = Layout::parse("@Internal Flash  /0x08000000/04*016Kg,01*064Kg,07*128Kg").unwrap();
        assert_eq!(layout.name, "Internal Flash");
        assert_eq!(layout.sectors.len(), 12);
        assert_eq!(layout.sectors[3], Sector { start: 0x0800_C000, length: 16 * 1024, usable: true });
        assert_eq!(layout.sectors[11].end(), 0x0810_0000);
        assert!(layout.sectors.iter().all(|sector| sector.usable));
    }

    #[test]
    fn other_memories_are_parsed() {
        let bytes = Layout::parse("@Option Bytes  /0x1FFFC000/01*016 e").unwrap();
        assert_eq!(bytes.sectors, [Sector { start: 0x1FFF_C000, length: 16, usable: false }]);
        let two = Layout::parse("@Two/0x0/1*1Kg/0x08000000/2*1Ma").unwrap();
        assert_eq!(two.sectors.len(), 3);
        assert_eq!(two.sectors[2], Sector { start: 0x0810_0000, length: 1024 * 1024, usable: false });
    }

    #[test]
    fn invalid_descriptions_are_refused() {
        let bad = [
            "",
            "@",
            "Internal",
            "@X/0x0",
            "@X/0x0/",
            "@X/0x0/4",
            "@X/0x0/*Kg",
            "@X/0x0/4*Kg",
            "@X/0x0/4*16",
            "@X/zz/1*1Kg",
            "@X/0x0/1*é",
            "@X/0x0/4294967295*1Kg",
            "@X/0x0/1*0Kg",
            "@X/0xFFFFFFFF/2*1Mg",
            "@X/0x0/1*9999999Mg",
        ];
        for text in bad {
            assert_eq!(Layout::parse(text), Err(BadLayout(text.into())), "{text}");
        }
    }
}
