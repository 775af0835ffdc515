//! Chooses and opens the port: the port that the user named, or the only board among the serial ports.

use super::error::LinkError;
use super::wire::{SerialWire, TcpWire, Wire};
use serialport::{ErrorKind, SerialPortType};
use std::io;
use std::net::{TcpStream, ToSocketAddrs};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// USB vendor identifier: pid.codes, for open hardware and firmware.
pub const USB_VENDOR: u16 = 0x1209;
/// USB product identifier: pid.codes' identifier for tests. A manufacturer of boards needs its own identifier.
pub const USB_PRODUCT: u16 = 0x0001;
/// The product string, which distinguishes these boards from other devices with the test identifier.
pub const USB_PRODUCT_NAME: &str = "haptic-bridge";

/// A port in the syntax of `--port`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PortSpec {
    /// The port of the only connected board.
    Find,
    /// A serial port, named by its path or by the board's serial number.
    Serial(String),
    /// A TCP address, `tcp:HOST:PORT`.
    Tcp(String),
    /// `sim` or `sim:DEVICE.toml`: a simulated board in this process.
    Sim(Option<PathBuf>),
}

impl std::str::FromStr for PortSpec {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if let Some(address) = text.strip_prefix("tcp:") {
            let port =
                address.rsplit_once(':').and_then(|(host, port)| (!host.is_empty()).then(|| port.parse::<u16>()));
            return match port {
                Some(Ok(_)) => Ok(Self::Tcp(address.into())),
                _ => Err(format!("`{text}` is not tcp:HOST:PORT, such as tcp:localhost:7710")),
            };
        }
        match text.strip_prefix("sim") {
            Some("") => Ok(Self::Sim(None)),
            Some(file) if file.len() > 1 && file.starts_with(':') => Ok(Self::Sim(Some(file[1..].into()))),
            _ if text.is_empty() => Err("an empty port; write a serial port, tcp:HOST:PORT, or sim".into()),
            _ => Ok(Self::Serial(text.into())),
        }
    }
}

/// A board found among the serial ports.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BoardPort {
    /// The serial port.
    pub path: String,
    /// The board's serial number.
    pub serial: String,
    /// The kind of board that it reports.
    pub kind: String,
}

/// Returns the connected boards, and the paths of the other serial ports.
pub fn boards() -> (Vec<BoardPort>, Vec<String>) {
    separate_boards(serial_ports(Path::new(SERIAL_PORT_FOLDER)))
}

/// The directory in which Linux lists its serial ports.
const SERIAL_PORT_FOLDER: &str = "/sys/class/tty";

/// Returns the serial ports, or none if the system cannot list them. Checks first that the directory `place` exists,
/// because the listing panics without it, as in a container without /sys.
fn serial_ports(place: &Path) -> Vec<serialport::SerialPortInfo> {
    if cfg!(target_os = "linux") && !place.is_dir() {
        return Vec::new();
    }
    serialport::available_ports().unwrap_or_default()
}

/// Returns true if a USB product string is the string of these boards, or if the system reports no string.
fn is_board_product(product: Option<&str>) -> bool {
    product.is_none_or(|name| name.to_lowercase().replace([' ', '_'], "-").contains(USB_PRODUCT_NAME))
}

fn separate_boards(ports: Vec<serialport::SerialPortInfo>) -> (Vec<BoardPort>, Vec<String>) {
    let (mut boards, mut others) = (Vec::new(), Vec::new());
    for port in ports {
        match port.port_type {
            SerialPortType::UsbPort(usb)
                if usb.vid == USB_VENDOR && usb.pid == USB_PRODUCT && is_board_product(usb.product.as_deref()) =>
            {
                boards.push(BoardPort {
                    path: port.port_name,
                    serial: usb.serial_number.unwrap_or_default(),
                    // All boards have the same product string; the manufacturer string names the kind.
                    kind: usb.manufacturer.unwrap_or_default(),
                });
            }
            _ => others.push(port.port_name),
        }
    }
    (boards, others)
}

/// Returns the path of the requested port (a path or a serial number), or of the only board.
fn choose_port(requested: Option<&str>, boards: &[BoardPort], others: Vec<String>) -> Result<String, LinkError> {
    match (requested, boards) {
        (Some(name), _) => {
            Ok(boards.iter().find(|board| board.serial == name).map_or(name, |board| &board.path).into())
        }
        (None, [only]) => Ok(only.path.clone()),
        (None, []) => Err(LinkError::NoBoard { others }),
        (None, several) => Err(LinkError::SeveralBoards(
            several
                .iter()
                .map(|board| format!("{} ({}, serial number {})", board.path, board.kind, board.serial))
                .collect(),
        )),
    }
}

/// Opens the requested serial port (a path or a serial number), or the only board. Returns the wire and the path.
pub(super) fn open_serial(requested: Option<&str>) -> Result<(Box<dyn Wire>, String), LinkError> {
    let (boards, others) = boards();
    let path = choose_port(requested, &boards, others)?;
    match SerialWire::open(&path) {
        Ok(wire) => Ok((Box::new(wire), path)),
        Err(error) => Err(open_error(path, &error)),
    }
}

/// Opens a port that another tool holds, which only a pseudo-terminal allows.
pub(super) fn open_shared(requested: Option<&str>) -> Result<Box<dyn Wire>, LinkError> {
    let (boards, others) = boards();
    let path = choose_port(requested, &boards, others)?;
    #[cfg(unix)]
    if super::wire::is_pseudo_terminal(&path) {
        let opened = super::wire::SharedWire::open(&path);
        return match opened {
            Ok(wire) => Ok(Box::new(wire)),
            Err(error) => Err(LinkError::NoSuchPort { name: path, reason: error.to_string() }),
        };
    }
    Err(LinkError::PortBusy(path))
}

fn open_error(path: String, error: &serialport::Error) -> LinkError {
    let busy = ["busy", "exclusive lock", "Resource temporarily unavailable", "locked", "Access is denied"];
    match error.kind() {
        ErrorKind::Io(io::ErrorKind::PermissionDenied) => LinkError::Forbidden(path),
        _ if busy.iter().any(|word| error.description.contains(word)) => LinkError::PortBusy(path),
        _ => LinkError::NoSuchPort { name: path, reason: error.description.clone() },
    }
}

pub(super) fn open_tcp(address: &str) -> Result<Box<dyn Wire>, LinkError> {
    let not_listening = |error| LinkError::NotListening { address: address.into(), error };
    let mut last = io::Error::new(io::ErrorKind::NotFound, "the host has no address");
    for candidate in address.to_socket_addrs().map_err(not_listening)? {
        match TcpStream::connect_timeout(&candidate, Duration::from_secs(3)).and_then(TcpWire::new) {
            Ok(wire) => return Ok(Box::new(wire)),
            Err(error) => last = error,
        }
    }
    Err(not_listening(last))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serialport::{SerialPortInfo, UsbPortInfo};

    fn usb(name: &str, vid: u16, product: &str, serial: &str) -> SerialPortInfo {
        SerialPortInfo {
            port_name: name.into(),
            port_type: SerialPortType::UsbPort(UsbPortInfo {
                vid,
                pid: USB_PRODUCT,
                serial_number: Some(serial.into()),
                manufacturer: Some("odrive-v3".into()),
                product: Some(product.into()),
            }),
        }
    }

    #[test]
    fn port_names_are_parsed_by_their_form() {
        assert_eq!("sim".parse(), Ok(PortSpec::Sim(None)));
        assert_eq!("sim:a/b.toml".parse(), Ok(PortSpec::Sim(Some("a/b.toml".into()))));
        assert_eq!("tcp:localhost:7710".parse(), Ok(PortSpec::Tcp("localhost:7710".into())));
        assert_eq!("tcp:[::1]:7710".parse(), Ok(PortSpec::Tcp("[::1]:7710".into())));
        assert_eq!("/dev/ttyACM0".parse(), Ok(PortSpec::Serial("/dev/ttyACM0".into())));
        assert_eq!("COM3".parse(), Ok(PortSpec::Serial("COM3".into())));
        for bad in ["", "tcp:", "tcp:host", "tcp:host:port", "tcp::7710"] {
            assert!(bad.parse::<PortSpec>().is_err(), "{bad}");
        }
    }

    #[test]
    fn a_system_without_a_port_list_has_no_ports() {
        assert_eq!(serial_ports(Path::new("/no/such/place")), []);
    }

    #[test]
    fn boards_are_separated_from_other_serial_ports() {
        let ports = vec![
            usb("/dev/ttyACM0", USB_VENDOR, USB_PRODUCT_NAME, "A1"),
            usb("/dev/ttyACM1", USB_VENDOR, "Arduino", "B2"),
            usb("/dev/ttyUSB0", 0x1234, "FTDI", "C3"),
        ];
        let (boards, others) = separate_boards(ports);
        assert_eq!(boards.iter().map(|board| board.path.as_str()).collect::<Vec<_>>(), ["/dev/ttyACM0"]);
        assert_eq!(others, ["/dev/ttyACM1", "/dev/ttyUSB0"]);
    }

    #[test]
    fn a_serial_number_chooses_among_several_boards() {
        let board =
            |path: &str, serial: &str| BoardPort { path: path.into(), serial: serial.into(), kind: "odrive-v3".into() };
        let one = [board("/dev/ttyACM0", "A1")];
        let two = [board("/dev/ttyACM0", "A1"), board("/dev/ttyACM1", "B2")];
        assert_eq!(choose_port(None, &one, vec![]).unwrap(), "/dev/ttyACM0");
        assert_eq!(choose_port(Some("B2"), &two, vec![]).unwrap(), "/dev/ttyACM1");
        assert_eq!(choose_port(Some("/dev/pts/7"), &two, vec![]).unwrap(), "/dev/pts/7");
        let several = choose_port(None, &two, vec![]).unwrap_err().to_string();
        assert!(several.contains("serial number A1") && several.contains("/dev/ttyACM1"), "{several}");
        let none = choose_port(None, &[], vec!["/dev/ttyS0".into()]).unwrap_err().to_string();
        assert!(none.contains("no board found") && none.contains("/dev/ttyS0") && none.contains("sim"), "{none}");
    }
}
