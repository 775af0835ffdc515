//! The USB device, one serial port (CDC-ACM), and the task that serves the protocol over it.

use embassy_futures::select::{Either, select};
use embassy_futures::yield_now;
use embassy_stm32::peripherals::{PA11, PA12, USB_OTG_FS};
use embassy_stm32::usb::{self, Driver};
use embassy_stm32::{Peri, bind_interrupts};
use embassy_time::{Duration, Instant, Timer};
use embassy_usb::class::cdc_acm::{CdcAcmClass, State};
use embassy_usb::{Builder, UsbDevice};
use haptic_bridge::board::dispatch::{self, AfterReply};
use haptic_bridge::board::machine::Machine as _;
use haptic_bridge::board::protocol::FaultSeen;
use haptic_bridge::board::service::Service;
use haptic_bridge::control::Command;
use haptic_bridge::control::program::Hardware;
use haptic_bridge::safety::fault::FaultRecord;
use static_cell::{ConstStaticCell, StaticCell};

use crate::board::{Board, This};
use crate::machine::BoardMachine;
use crate::serial::{Aligned, Event, Incoming, Outgoing, PACKET, SendNextPacket, Serial, UsbDriver};
use crate::telemetry::TelemetryStream;
use crate::{reset, supervisor};

bind_interrupts!(struct Irqs {
    OTG_FS => usb::InterruptHandler<USB_OTG_FS>, SendNextPacket;
});

// The tool searches for these values (host/src/link/ports.rs). A test on the emulated chip compares both.
/// USB vendor identifier: pid.codes, for open hardware and firmware.
const USB_VENDOR: u16 = 0x1209;
/// USB product identifier: pid.codes' shared test id. A maker who sells boards needs an own identifier.
const USB_PRODUCT: u16 = 0x0001;
/// The product string, which separates these boards from other projects with the shared test id.
const USB_PRODUCT_NAME: &str = "haptic-bridge";

/// Builds the USB device with its serial port.
pub fn device(
    (peripheral, dp, dm): (Peri<'static, USB_OTG_FS>, Peri<'static, PA12>, Peri<'static, PA11>),
    serial_number: &'static str,
) -> (UsbDevice<'static, UsbDriver>, Serial) {
    static OUT: ConstStaticCell<Aligned<256>> = ConstStaticCell::new(Aligned([0; 256]));
    static CONFIG: ConstStaticCell<[u8; 128]> = ConstStaticCell::new([0; 128]);
    static BOS: ConstStaticCell<[u8; 16]> = ConstStaticCell::new([0; 16]);
    static CONTROL: ConstStaticCell<[u8; 64]> = ConstStaticCell::new([0; 64]);
    static STATE: StaticCell<State> = StaticCell::new();

    let mut hardware = usb::Config::default();
    // PA9 cannot sense the USB voltage, because PA9 is a gate signal on these boards.
    hardware.vbus_detection = false;
    let driver = Driver::new_fs(peripheral, Irqs, dp, dm, &mut OUT.take().0, hardware);

    let mut config = embassy_usb::Config::new(USB_VENDOR, USB_PRODUCT);
    config.manufacturer = Some(This::NAME);
    config.product = Some(USB_PRODUCT_NAME);
    config.serial_number = Some(serial_number);
    config.max_power = 100;
    let mut builder = Builder::new(driver, config, CONFIG.take(), BOS.take(), &mut [], CONTROL.take());
    let serial = CdcAcmClass::new(&mut builder, STATE.init(State::new()), PACKET as u16);
    (builder.build(), serial)
}

/// Returns the serial number: the sum of the first and third word of the unique identifier, then the upper half of the
/// second word. The chip's boot loader reports the same number, so a board keeps its name during an update. Call once.
pub fn serial_number() -> &'static str {
    static SERIAL_NUMBER: StaticCell<[u8; 12]> = StaticCell::new();
    let id = embassy_stm32::uid::uid();
    let word = |at: usize| u32::from_le_bytes([id[at], id[at + 1], id[at + 2], id[at + 3]]);
    let mut digits = [0; 12];
    let parts = u64::from(word(0).wrapping_add(word(8))) << 16 | u64::from(word(4) >> 16);
    for (place, digit) in digits.iter_mut().enumerate() {
        let nibble = (parts >> (44 - 4 * place)) & 0xF;
        *digit = b"0123456789ABCDEF"[nibble as usize];
    }
    core::str::from_utf8(SERIAL_NUMBER.init(digits)).unwrap_or("")
}

#[embassy_executor::task]
pub async fn usb(mut device: UsbDevice<'static, UsbDriver>) -> ! {
    device.run().await
}

/// Interval at which the control loop is checked for new faults.
const FAULT_CHECK_INTERVAL: Duration = Duration::from_millis(20);
/// Interval at which the telemetry ring is emptied. The ring holds 5 ms of frames at 20 kHz.
const TELEMETRY_INTERVAL: Duration = Duration::from_millis(1);

/// Replies to the host, and sends telemetry and new faults. `previous` is the fault that ended the last run.
#[embassy_executor::task]
pub async fn serve(mut machine: BoardMachine, hardware: Hardware, previous: Option<FaultRecord>, serial: Serial) -> ! {
    let (sender, receiver) = serial.split();
    let (mut outgoing, mut incoming) = (Outgoing::new(sender), Incoming::new(receiver));
    let mut service = Service::new(hardware, This::LIMITS);
    machine.boot(&mut service);
    if let Some(record) = previous {
        let _ = machine.execute(Command::Fault(record));
    }
    let mut stream = TelemetryStream::default();
    let mut sequence = 0;
    let mut watch = Instant::now();
    let mut more = false;
    loop {
        supervisor::report_alive(supervisor::Task::Link);
        // Each turn handles one request or one batch. The yield lets the other tasks run even if requests or rows
        // arrive so fast that no other `await` waits.
        yield_now().await;
        let wake = match (more, stream.is_running()) {
            (true, _) => Instant::now(),
            (false, true) => Instant::now() + TELEMETRY_INTERVAL,
            (false, false) => watch,
        };
        match select(incoming.next(), Timer::at(wake)).await {
            Either::First(Event::Frame(request)) => {
                let (answer, after) = dispatch::answer(&mut service, &mut machine, request, outgoing.buffer());
                if let Some(length) = answer.map(<[u8]>::len) {
                    outgoing.send(length).await;
                }
                match after {
                    AfterReply::Nothing => {}
                    AfterReply::Stream(request, shape) => stream.start(&request, shape, &mut machine),
                    AfterReply::BootLoader => restart(reset::reboot_to_boot_loader).await,
                    AfterReply::Restart => restart(reset::reboot).await,
                }
            }
            Either::First(Event::Disconnected) => {
                stream.stop();
                outgoing.discard();
            }
            Either::Second(()) => {}
        }
        more = false;
        if let Some(batch) = stream.batch(&mut machine) {
            more = true;
            if let Some(length) = dispatch::telemetry(sequence, batch, outgoing.buffer()).map(<[u8]>::len) {
                sequence = sequence.wrapping_add(1);
                outgoing.send(length).await;
            }
        }
        if Instant::now() >= watch {
            watch = Instant::now() + FAULT_CHECK_INTERVAL;
            machine.watch_gate();
            if let Some(record) = service.poll(&mut machine)
                && let Some(length) =
                    dispatch::publish::<FaultSeen>(sequence, &record, outgoing.buffer()).map(<[u8]>::len)
            {
                sequence = sequence.wrapping_add(1);
                outgoing.send(length).await;
            }
        }
    }
}

/// Waits until the reply has left, then restarts.
async fn restart(how: fn() -> !) {
    Timer::after_millis(100).await;
    how()
}
