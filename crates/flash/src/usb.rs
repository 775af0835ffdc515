//! Access to boot loaders on USB by `nusb`. Linux and macOS need no library and no driver; Windows needs WinUSB.

use std::time::{Duration, Instant};

use nusb::transfer::{ControlIn, ControlOut, ControlType, Recipient, TransferError};
use nusb::{DeviceInfo, ErrorKind, Interface, MaybeFuture as _};

use crate::dfuse::{Transport, UsbError};
use crate::flashing::{BootLoader, OpenBootLoader};
use crate::udev::BOOT_LOADER;

/// Number of the boot loader's only interface.
const INTERFACE: u8 = 0;
/// Alternate setting of the internal flash.
const FLASH_SETTING: u8 = 0;
/// Timeout of one request. In some versions of the boot loader the first reply to an erase is late.
const REQUEST_TIMEOUT: Duration = Duration::from_secs(5);
/// Type of the functional descriptor, which contains the transfer size (DFU 1.1, section 4.1.3).
const FUNCTIONAL_DESCRIPTOR: u8 = 0x21;
/// Transfer size of ST's boot loaders, bytes, if the descriptor is missing.
const DEFAULT_TRANSFER_BYTES: u16 = 2048;

/// Lists the boot loaders on USB.
pub fn boot_loaders() -> Result<Vec<BootLoader>, UsbError> {
    Ok(devices()?.map(|device| BootLoader { serial: serial(&device) }).collect())
}

/// Opens a boot loader.
pub fn open(which: &BootLoader) -> Result<OpenBootLoader<UsbBootLoader>, UsbError> {
    let device = devices()?.find(|device| serial(device) == which.serial).ok_or(UsbError::Gone)?;
    let device = device.open().wait().map_err(from_system)?;
    let interface = device.claim_interface(INTERFACE).wait().map_err(from_system)?;
    interface.set_alt_setting(FLASH_SETTING).wait().map_err(from_system)?;
    let descriptor =
        interface.descriptor().ok_or_else(|| UsbError::Other("the boot loader describes no interface".into()))?;
    let name = descriptor
        .string_index()
        .ok_or_else(|| UsbError::Other("the boot loader does not describe its flash".into()))?;
    let english = nusb::descriptors::language_id::US_ENGLISH;
    let memory = device.get_string_descriptor(name, english, REQUEST_TIMEOUT).wait();
    let memory = memory.map_err(|error| UsbError::Other(error.to_string()))?;
    // Searches all alternate settings, because the descriptor follows only the last.
    let functional = interface.descriptors().find_map(|setting| {
        setting.descriptors().find(|it| it.descriptor_type() == FUNCTIONAL_DESCRIPTOR).map(|it| it.as_bytes().to_vec())
    });
    let transfer = match functional.as_deref() {
        Some([_, _, _, _, _, low, high, ..]) => u16::from_le_bytes([*low, *high]),
        _ => DEFAULT_TRANSFER_BYTES,
    };
    Ok(OpenBootLoader { loader: UsbBootLoader { interface, began: Instant::now() }, memory, transfer })
}

fn devices() -> Result<impl Iterator<Item = DeviceInfo>, UsbError> {
    let all = nusb::list_devices().wait().map_err(from_system)?;
    Ok(all.filter(|device| (device.vendor_id(), device.product_id()) == BOOT_LOADER))
}

fn serial(device: &DeviceInfo) -> String {
    device.serial_number().unwrap_or_default().to_string()
}

fn from_system(error: nusb::Error) -> UsbError {
    match error.kind() {
        ErrorKind::Disconnected | ErrorKind::NotFound => UsbError::Gone,
        ErrorKind::Busy => UsbError::Busy,
        ErrorKind::PermissionDenied => UsbError::Forbidden,
        _ => UsbError::Other(error.to_string()),
    }
}

fn from_transfer(error: TransferError) -> UsbError {
    match error {
        TransferError::Stall => UsbError::Stalled,
        TransferError::Disconnected => UsbError::Gone,
        TransferError::Cancelled => UsbError::Silent,
        error => UsbError::Other(error.to_string()),
    }
}

/// An open boot loader.
pub struct UsbBootLoader {
    interface: Interface,
    began: Instant,
}

impl Transport for UsbBootLoader {
    fn send(&mut self, request: u8, value: u16, data: &[u8]) -> Result<(), UsbError> {
        let (control_type, recipient, index) = (ControlType::Class, Recipient::Interface, INTERFACE.into());
        let out = ControlOut { control_type, recipient, request, value, index, data };
        self.interface.control_out(out, REQUEST_TIMEOUT).wait().map_err(from_transfer)
    }

    fn receive(&mut self, request: u8, value: u16, length: u16) -> Result<Vec<u8>, UsbError> {
        let (control_type, recipient, index) = (ControlType::Class, Recipient::Interface, INTERFACE.into());
        let request = ControlIn { control_type, recipient, request, value, index, length };
        self.interface.control_in(request, REQUEST_TIMEOUT).wait().map_err(from_transfer)
    }

    fn wait(&mut self, time: Duration) {
        std::thread::sleep(time);
    }
    fn now(&self) -> Duration {
        self.began.elapsed()
    }
}
