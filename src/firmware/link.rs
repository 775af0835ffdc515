//! The USB device: one serial port (CDC-ACM).

use embassy_stm32::interrupt::InterruptExt;
use embassy_stm32::peripherals::{PA11, PA12, USB_OTG_FS};
use embassy_stm32::usb::{self, Driver};
use embassy_stm32::{Peri, bind_interrupts, interrupt};
use embassy_usb::class::cdc_acm::{CdcAcmClass, State};
use embassy_usb::{Builder, UsbDevice};
use embedded_io_async::{Read as _, Write as _};
use static_cell::{ConstStaticCell, StaticCell};

use crate::serial::{Incoming, Outgoing, PACKET};
use crate::{board, critical};

bind_interrupts!(struct Irqs {
    OTG_FS => usb::InterruptHandler<USB_OTG_FS>;
});

/// The USB driver of this chip.
pub type UsbDriver = Driver<'static, USB_OTG_FS>;

/// The serial port.
pub type Serial = CdcAcmClass<'static, UsbDriver>;

/// STMicroelectronics' numbers for a virtual serial port on their chips. Boards are told apart by product name and serial number.
const VENDOR_ID: u16 = 0x0483;
const PRODUCT_ID: u16 = 0x5740;

/// Builds the USB device with its serial port.
pub fn device(
    (peripheral, dp, dm): (Peri<'static, USB_OTG_FS>, Peri<'static, PA12>, Peri<'static, PA11>),
) -> (UsbDevice<'static, UsbDriver>, Serial) {
    static OUT: ConstStaticCell<[u8; 256]> = ConstStaticCell::new([0; 256]);
    static CONFIG: ConstStaticCell<[u8; 128]> = ConstStaticCell::new([0; 128]);
    static BOS: ConstStaticCell<[u8; 16]> = ConstStaticCell::new([0; 16]);
    static CONTROL: ConstStaticCell<[u8; 64]> = ConstStaticCell::new([0; 64]);
    static STATE: StaticCell<State> = StaticCell::new();
    static SERIAL_NUMBER: StaticCell<[u8; 12]> = StaticCell::new();

    let mut hardware = usb::Config::default();
    // PA9, where the bus voltage would be sensed, is a gate signal on these boards.
    hardware.vbus_detection = false;
    let driver = Driver::new_fs(peripheral, Irqs, dp, dm, OUT.take(), hardware);
    interrupt::OTG_FS.set_priority(critical::OTHERS);

    let mut config = embassy_usb::Config::new(VENDOR_ID, PRODUCT_ID);
    config.manufacturer = Some("haptic-bridge");
    config.product = Some(board::NAME);
    let serial_number = SERIAL_NUMBER.init(serial_number());
    config.serial_number = core::str::from_utf8(serial_number).ok();
    config.max_power = 100;
    let mut builder = Builder::new(driver, config, CONFIG.take(), BOS.take(), &mut [], CONTROL.take());
    let serial = CdcAcmClass::new(&mut builder, STATE.init(State::new()), PACKET as u16);
    (builder.build(), serial)
}

/// The serial number that the chip's own boot loader reports as well, so that a board keeps its name while it is updated: the
/// first and third word of the unique identifier added, then the upper half of the second.
fn serial_number() -> [u8; 12] {
    let id = embassy_stm32::uid::uid();
    let word = |at: usize| u32::from_le_bytes([id[at], id[at + 1], id[at + 2], id[at + 3]]);
    let mut digits = [0; 12];
    let parts = u64::from(word(0).wrapping_add(word(8))) << 16 | u64::from(word(4) >> 16);
    for (place, digit) in digits.iter_mut().enumerate() {
        let nibble = (parts >> (44 - 4 * place)) & 0xF;
        *digit = b"0123456789ABCDEF"[nibble as usize];
    }
    digits
}

/// Runs the USB device.
#[embassy_executor::task]
pub async fn usb(mut device: UsbDevice<'static, UsbDriver>) -> ! {
    device.run().await
}

/// Sends back what comes.
#[embassy_executor::task]
pub async fn echo(serial: Serial) -> ! {
    let (sender, receiver) = serial.split();
    let (mut outgoing, mut incoming) = (Outgoing::new(sender), Incoming::new(receiver));
    let mut bytes = [0; PACKET];
    loop {
        let Ok(len) = incoming.read(&mut bytes).await;
        let Ok(()) = outgoing.write_all(&bytes[..len]).await.map_err(|_| ()) else { continue };
    }
}
