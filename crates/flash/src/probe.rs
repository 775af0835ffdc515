//! Flashes through a debug probe with an installed probe-rs. The image is passed as Intel HEX, whose addresses exclude
//! the settings between the segments.

use std::io::{self, Write as _};
use std::process::{Command, Stdio};

use crate::image::Image;

/// probe-rs's name for the boards' chip.
const CHIP: &str = "STM32F405RGTx";

/// A failure to flash with a probe. `step` is the subcommand of probe-rs.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum ProbeError {
    #[error(
        "probe-rs is not installed; `cargo install probe-rs-tools --locked` installs it, or leave the probe out to flash \
         over USB"
    )]
    NotInstalled,
    #[error(
        "probe-rs {step} failed; its own message is above. A board with an incomplete image does not arm: check the \
         probe's cable and the board's power, and run this again"
    )]
    Failed { step: &'static str },
    #[error("the image cannot be written for probe-rs: {0}")]
    File(#[from] io::Error),
}

/// Formats the image as Intel HEX (Intel, "Hexadecimal Object File Format Specification", 1988).
pub fn hex(image: &Image) -> String {
    let mut text = String::new();
    let mut record = |kind: u8, offset: u16, data: &[u8]| {
        let mut bytes = vec![data.len() as u8];
        bytes.extend(offset.to_be_bytes());
        bytes.push(kind);
        bytes.extend(data);
        let sum = bytes.iter().fold(0_u8, |sum, byte| sum.wrapping_add(*byte));
        bytes.push(sum.wrapping_neg());
        text.push(':');
        bytes.iter().for_each(|byte| text.push_str(&format!("{byte:02X}")));
        text.push('\n');
    };
    let mut upper = None;
    for segment in &image.segments {
        let mut at = segment.address;
        let mut rest = &segment.bytes[..];
        while !rest.is_empty() {
            if upper != Some(at >> 16) {
                upper = Some(at >> 16);
                record(4, 0, &((at >> 16) as u16).to_be_bytes());
            }
            // A record must not cross a 64 KB boundary.
            let length = rest.len().min(16).min(0x1_0000 - (at & 0xFFFF) as usize);
            let (now, after) = rest.split_at(length);
            record(0, at as u16, now);
            (at, rest) = (at + length as u32, after);
        }
    }
    record(1, 0, &[]);
    text
}

/// Flashes, verifies and restarts a board. `program` is the probe-rs executable.
pub fn flash(program: &str, image: &Image) -> Result<(), ProbeError> {
    let mut file = tempfile::Builder::new().suffix(".hex").tempfile()?;
    file.write_all(hex(image).as_bytes())?;
    file.flush()?;
    let download = ["download", "--chip", CHIP, "--binary-format", "hex", "--verify"];
    run("download", Command::new(program).args(download).arg(file.path()))?;
    run("reset", Command::new(program).args(["reset", "--chip", CHIP]))
}

fn run(step: &'static str, command: &mut Command) -> Result<(), ProbeError> {
    match command.stdin(Stdio::null()).stdout(io::stderr()).status() {
        Ok(status) if status.success() => Ok(()),
        Ok(_) => Err(ProbeError::Failed { step }),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Err(ProbeError::NotInstalled),
        Err(error) => Err(error.into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Segment;

    fn image() -> Image {
        let segments = vec![
            Segment { address: 0x0800_0000, bytes: vec![0x02, 0x33, 0x7A] },
            Segment { address: 0x0800_FFFE, bytes: vec![1, 2, 3] },
        ];
        Image { board: "odrive-v3".into(), version: None, protocol: None, segments }
    }

    #[test]
    fn hex_records_have_addresses_and_checksums() {
        let text = hex(&image());
        let expected =
            ":020000040800F2\n:0300000002337A4E\n:02FFFE000102FE\n:020000040801F1\n:0100000003FC\n:00000001FF\n";
        assert_eq!(text, expected);
    }

    #[test]
    fn a_missing_probe_rs_is_reported() {
        let error = flash("no-such-probe-rs", &image()).unwrap_err();
        assert!(matches!(error, ProbeError::NotInstalled) && error.to_string().contains("cargo install"), "{error}");
        assert!(matches!(flash("false", &image()), Err(ProbeError::Failed { step: "download" })));
        assert!(flash("true", &image()).is_ok());
    }
}
