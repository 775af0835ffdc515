//! A session with a DfuSe boot loader: sets the address, erases, writes, reads and leaves.
//!
//! One request sends a command. The next status request starts the command, and a later status reports its end. Each
//! status contains the time to wait before the next status request (AN2662). The numbers of requests, states and
//! statuses are those of DFU 1.1, sections 3 and 6.1.

use std::time::Duration;

/// The requests of the DFU class.
pub mod request {
    /// Sends data or a command to the boot loader.
    pub const DNLOAD: u8 = 1;
    /// Reads memory.
    pub const UPLOAD: u8 = 2;
    /// Reads state and status.
    pub const GETSTATUS: u8 = 3;
    /// Leaves the error state.
    pub const CLRSTATUS: u8 = 4;
    /// Returns to idle.
    pub const ABORT: u8 = 6;
}

/// A failed transfer.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs)]
pub enum UsbError {
    #[error("the device refused the request")]
    Stalled,
    #[error("the device left USB")]
    Gone,
    #[error("the device does not reply")]
    Silent,
    #[error("no permission to open the device")]
    Forbidden,
    #[error("another program has the device open")]
    Busy,
    #[error("{0}")]
    Other(String),
}

/// Class requests to one DFU interface.
pub trait Transport {
    /// Sends a request with its data.
    fn send(&mut self, request: u8, value: u16, data: &[u8]) -> Result<(), UsbError>;
    /// Sends a request and reads at most `length` bytes.
    fn receive(&mut self, request: u8, value: u16, length: u16) -> Result<Vec<u8>, UsbError>;
    /// Waits.
    fn wait(&mut self, time: Duration);
    /// Returns the time since a fixed instant.
    fn now(&self) -> Duration;
}

/// A failed command of the boot loader. `doing` is the command, `status` and `state` are numbers of the DFU class.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs)]
pub enum DfuError {
    #[error("the connection to the boot loader is lost: {0}")]
    Usb(#[from] UsbError),
    #[error("the chip's flash is protected against being read")]
    Protected,
    #[error("the boot loader could not {doing}: {}", status_text(*.status))]
    Failed { doing: String, status: u8 },
    #[error("the boot loader is in state {state} after the command to {doing}, but should be ready")]
    Lost { doing: String, state: u8 },
    #[error("the boot loader does not finish the command to {0}")]
    Endless(String),
    #[error("the boot loader sent {got} bytes instead of {wanted}")]
    Short { got: usize, wanted: usize },
}

/// Describes a status (DFU 1.1, section 6.1.2).
fn status_text(status: u8) -> &'static str {
    match status {
        0x01 => "no such memory (errTARGET)",
        0x03 => "writing failed (errWRITE)",
        0x04 => "erasing failed (errERASE)",
        0x05 => "the flash is not empty after erasing (errCHECK_ERASED)",
        0x06 => "programming failed (errPROG)",
        0x07 => "the written bytes differ (errVERIFY)",
        0x08 => "the address is out of range (errADDRESS)",
        0x0A => "the firmware is corrupted (errFIRMWARE)",
        STATUS_VENDOR => "the boot loader has no permission (errVENDOR)",
        0x0F => "the request was not expected (errSTALLEDPKT)",
        _ => "the reason is unknown",
    }
}

/// Status number of a chip whose flash is protected: errVENDOR (DFU 1.1, section 6.1.2).
const STATUS_VENDOR: u8 = 0x0B;

/// State numbers (DFU 1.1, section 6.1.2).
mod state {
    pub const IDLE: u8 = 2;
    pub const DNLOAD_SYNC: u8 = 3;
    pub const DNBUSY: u8 = 4;
    pub const DNLOAD_IDLE: u8 = 5;
    pub const MANIFEST_SYNC: u8 = 6;
    pub const MANIFEST: u8 = 7;
    pub const UPLOAD_IDLE: u8 = 9;
    pub const ERROR: u8 = 10;
}

/// Number of the first memory block, because lower block numbers are commands.
const FIRST_BLOCK: u16 = 2;
/// First byte of block 0 of ST's command to set the address.
const SET_ADDRESS: u8 = 0x21;
/// First byte of block 0 of ST's command to erase a sector.
const ERASE: u8 = 0x41;

/// Timeout of a command. The longest command erases a sector of 128 KB in 4 s at the chip's lowest supply (STM32F405
/// data sheet, table "Flash memory programming").
const MAX_COMMAND_TIME: Duration = Duration::from_secs(20);
/// Shortest interval between two status requests.
const MIN_PAUSE: Duration = Duration::from_millis(2);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Status {
    status: u8,
    /// Time to wait before the next status request.
    pause: Duration,
    state: u8,
}

/// A session with a boot loader.
pub struct Dfuse<T> {
    transport: T,
    /// Maximum size of one transfer, bytes.
    transfer: u16,
}

impl<T: Transport> Dfuse<T> {
    /// Begins a session in any state of the boot loader, whose `wTransferSize` is `transfer`, bytes.
    pub fn begin(transport: T, transfer: u16) -> Result<Self, DfuError> {
        // Rounds down to whole words. The chip's boot loader reports 2048 bytes.
        let mut dfuse = Self { transport, transfer: transfer.max(4) & !3 };
        // Aborts first, because a status request would carry out a pending command of an earlier session to start the
        // program.
        match dfuse.transport.send(request::ABORT, 0, &[]) {
            Ok(()) | Err(UsbError::Stalled) => dfuse.go_to_idle()?,
            Err(error) => return Err(error.into()),
        }
        Ok(dfuse)
    }

    /// Returns the maximum number of bytes of one [`Dfuse::write`].
    pub fn transfer(&self) -> usize {
        usize::from(self.transfer)
    }
    /// Erases the sector that begins at this address.
    pub fn erase(&mut self, address: u32) -> Result<(), DfuError> {
        self.command(ERASE, address, || format!("erase the sector at {address:#010x}"))
    }
    /// Writes at most [`Dfuse::transfer`] bytes to erased flash.
    pub fn write(&mut self, address: u32, bytes: &[u8]) -> Result<(), DfuError> {
        self.set_address(address)?;
        self.transport.send(request::DNLOAD, FIRST_BLOCK, bytes).or_else(|error| self.explain_refusal(error))?;
        self.wait_for_end(|| format!("write {} bytes at {address:#010x}", bytes.len()))
    }

    /// Reads flash. Sets the address again for a shorter last block, because the offset of a block is its number times
    /// its length (AN2662).
    pub fn read(&mut self, address: u32, length: usize) -> Result<Vec<u8>, DfuError> {
        let mut bytes = Vec::with_capacity(length);
        let whole = length - length % self.transfer();
        for (from, to) in [(0, whole), (whole, length)] {
            if from == to {
                continue;
            }
            self.set_address(address + from as u32)?;
            // Returns to idle, because memory cannot be read between two writes.
            self.transport.send(request::ABORT, 0, &[])?;
            for (number, start) in (FIRST_BLOCK..=u16::MAX).zip((from..to).step_by(self.transfer())) {
                let wanted = (to - start).min(self.transfer());
                let got = self.transport.receive(request::UPLOAD, number, wanted as u16);
                let got = got.or_else(|error| self.explain_refusal(error))?;
                if got.len() != wanted {
                    return Err(DfuError::Short { got: got.len(), wanted });
                }
                bytes.extend(got);
            }
            self.transport.send(request::ABORT, 0, &[])?;
        }
        Ok(bytes)
    }

    /// Starts the program whose vectors are at this address. The boot loader leaves USB.
    pub fn leave(mut self, address: u32) -> Result<(), DfuError> {
        self.set_address(address)?;
        self.transport.send(request::DNLOAD, FIRST_BLOCK, &[])?;
        let doing = || "start the program".to_string();
        match self.status() {
            Ok(Status { state: state::MANIFEST | state::MANIFEST_SYNC, .. }) => Ok(()),
            // The boot loader has already left.
            Err(DfuError::Usb(UsbError::Gone | UsbError::Silent)) => Ok(()),
            Ok(Status { state: state::ERROR, status, .. }) => Err(status_error(status, doing)),
            Ok(Status { state, .. }) => Err(DfuError::Lost { doing: doing(), state }),
            Err(error) => Err(error),
        }
    }

    /// Brings the boot loader to idle from any state.
    fn go_to_idle(&mut self) -> Result<(), DfuError> {
        let doing = || "get ready".to_string();
        let began = self.transport.now();
        loop {
            let status = self.status()?;
            match status.state {
                state::IDLE => return Ok(()),
                state::ERROR => self.transport.send(request::CLRSTATUS, 0, &[])?,
                state::DNLOAD_IDLE | state::UPLOAD_IDLE => self.transport.send(request::ABORT, 0, &[])?,
                state::DNBUSY | state::DNLOAD_SYNC => {}
                state => return Err(DfuError::Lost { doing: doing(), state }),
            }
            self.pause(status.pause, began, doing)?;
        }
    }

    /// Sets the address of the next write, read or start.
    fn set_address(&mut self, address: u32) -> Result<(), DfuError> {
        self.command(SET_ADDRESS, address, || format!("set the address {address:#010x}"))
    }
    fn command(&mut self, command: u8, address: u32, doing: impl Fn() -> String) -> Result<(), DfuError> {
        let mut data = vec![command];
        data.extend(address.to_le_bytes());
        self.transport.send(request::DNLOAD, 0, &data).or_else(|error| self.explain_refusal(error))?;
        self.wait_for_end(doing)
    }

    /// Starts the last command and waits for its end.
    fn wait_for_end(&mut self, doing: impl Fn() -> String) -> Result<(), DfuError> {
        let began = self.transport.now();
        loop {
            let status = self.status()?;
            match status.state {
                state::DNLOAD_IDLE => return Ok(()),
                state::DNBUSY | state::DNLOAD_SYNC => self.pause(status.pause, began, &doing)?,
                state::ERROR => return Err(status_error(status.status, doing)),
                state => return Err(DfuError::Lost { doing: doing(), state }),
            }
        }
    }

    /// Waits before the next status request. Fails if the command and its replies have taken too long since `began`.
    fn pause(&mut self, requested: Duration, began: Duration, doing: impl Fn() -> String) -> Result<(), DfuError> {
        let pause = requested.max(MIN_PAUSE);
        if self.transport.now() - began + pause > MAX_COMMAND_TIME {
            return Err(DfuError::Endless(doing()));
        }
        self.transport.wait(pause);
        Ok(())
    }

    fn status(&mut self) -> Result<Status, DfuError> {
        let reply = self.transport.receive(request::GETSTATUS, 0, 6)?;
        match reply[..] {
            [status, low, middle, high, state, _] => {
                let pause = u32::from_le_bytes([low, middle, high, 0]);
                Ok(Status { status, pause: Duration::from_millis(pause.into()), state })
            }
            _ => Err(DfuError::Short { got: reply.len(), wanted: 6 }),
        }
    }

    /// Converts a stalled request to the error that the status reports, if the boot loader still replies.
    fn explain_refusal<O>(&mut self, error: UsbError) -> Result<O, DfuError> {
        if error == UsbError::Stalled
            && let Ok(Status { state: state::ERROR, status, .. }) = self.status()
        {
            return Err(status_error(status, || "accept a request".into()));
        }
        Err(error.into())
    }
}

fn status_error(status: u8, doing: impl Fn() -> String) -> DfuError {
    match status {
        STATUS_VENDOR => DfuError::Protected,
        status => DfuError::Failed { doing: doing(), status },
    }
}
