//! One conversation with a DfuSe boot loader: point, erase, write, read, leave.
//!
//! A command is sent with one request, carried out at the first question for the status that follows it, and done when
//! a later answer says so; in between the boot loader says how long not to ask again (AN2662). Numbers of
//! requests, states and statuses: DFU 1.1, sections 3 and 6.1.

use std::time::Duration;

/// The requests of the DFU class.
pub mod request {
    /// Data or a command to the boot loader.
    pub const DNLOAD: u8 = 1;
    /// Memory from it.
    pub const UPLOAD: u8 = 2;
    /// What it does, and whether that went well.
    pub const GETSTATUS: u8 = 3;
    /// Out of the error.
    pub const CLRSTATUS: u8 = 4;
    /// Back to idle.
    pub const ABORT: u8 = 6;
}

/// What went wrong with a transfer.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum UsbError {
    /// The other side refused this request.
    #[error("it refused the request")]
    Stalled,
    /// It is no longer there.
    #[error("it left USB")]
    Gone,
    /// It did not answer in time.
    #[error("it does not answer")]
    Silent,
    /// The operating system does not let this user open it.
    #[error("this user may not open it")]
    Forbidden,
    /// Another program has it open.
    #[error("another program has it open")]
    Busy,
    /// Anything else that the operating system says.
    #[error("{0}")]
    Other(String),
}

/// Class requests to one DFU interface.
pub trait Transport {
    /// Sends a request with its data.
    fn send(&mut self, request: u8, value: u16, data: &[u8]) -> Result<(), UsbError>;
    /// Sends a request and reads at most `length` bytes.
    fn receive(&mut self, request: u8, value: u16, length: u16) -> Result<Vec<u8>, UsbError>;
    /// Lets time pass.
    fn wait(&mut self, time: Duration);
    /// Time since some moment.
    fn now(&self) -> Duration;
}

/// Why a boot loader did not do what it was told.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DfuError {
    /// A transfer failed.
    #[error("the boot loader is lost: {0}")]
    Usb(#[from] UsbError),
    /// It has no access to its flash.
    #[error("the chip's flash is protected against being read")]
    Protected,
    /// It could not do it.
    #[error("the boot loader could not {doing}: {}", status_text(*.status))]
    Failed {
        /// What it was told to do.
        doing: String,
        /// The class's number of what went wrong.
        status: u8,
    },
    /// It is in a state where it has no business to be.
    #[error("the boot loader is in state {state} and should be ready after it was told to {doing}")]
    Lost {
        /// What it was told to do.
        doing: String,
        /// The class's number of its state.
        state: u8,
    },
    /// It works longer than anything can take.
    #[error("the boot loader does not finish: it was told to {0}")]
    Endless(String),
    /// An answer that is too short.
    #[error("the boot loader sent {got} bytes instead of {wanted}")]
    Short {
        /// What came.
        got: usize,
        /// What should have.
        wanted: usize,
    },
}

/// The words of DFU 1.1, section 6.1.2, for its numbers.
fn status_text(status: u8) -> &'static str {
    match status {
        0x01 => "it has no such memory (errTARGET)",
        0x03 => "writing failed (errWRITE)",
        0x04 => "erasing failed (errERASE)",
        0x05 => "it is not empty after being erased (errCHECK_ERASED)",
        0x06 => "programming failed (errPROG)",
        0x07 => "what was written is not there (errVERIFY)",
        0x08 => "the address is out of range (errADDRESS)",
        0x0A => "its firmware is broken (errFIRMWARE)",
        VENDOR => "it may not (errVENDOR)",
        0x0F => "it did not expect that (errSTALLEDPKT)",
        _ => "it does not say why",
    }
}

/// The status of a chip whose flash is protected, errVENDOR of DFU 1.1, section 6.1.2.
const VENDOR: u8 = 0x0B;

/// States, DFU 1.1, section 6.1.2.
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

/// The block number at which memory begins: the ones before it are commands.
const FIRST_BLOCK: u16 = 2;
/// ST's commands, as the first byte of block 0.
const SET_ADDRESS: u8 = 0x21;
const ERASE: u8 = 0x41;

/// More than any command takes: a sector of 128 KB is erased in 4 s at the chip's lowest supply (STM32F405 data sheet,
/// table "Flash memory programming").
const LONGEST: Duration = Duration::from_secs(20);
/// What is waited between two questions where the boot loader asks for nothing.
const PAUSE: Duration = Duration::from_millis(2);

/// The answer to a question for the status.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Status {
    status: u8,
    /// How long not to ask again.
    pause: Duration,
    state: u8,
}

/// A boot loader that is being talked to.
pub struct Dfuse<T> {
    transport: T,
    /// Most bytes of one transfer.
    transfer: u16,
}

impl<T: Transport> Dfuse<T> {
    /// Begins a conversation, whatever an earlier one left; `transfer` is the boot loader's `wTransferSize`.
    pub fn begin(transport: T, transfer: u16) -> Result<Self, DfuError> {
        // The chip's own has 2048. Two is the smallest piece that it takes.
        let mut it = Self { transport, transfer: transfer.max(4) & !3 };
        // One that was told to start its program would do so at the first question for its status.
        match it.transport.send(request::ABORT, 0, &[]) {
            Ok(()) | Err(UsbError::Stalled) => it.settle()?,
            Err(error) => return Err(error.into()),
        }
        Ok(it)
    }

    /// Most bytes of one [`Dfuse::write`].
    pub fn transfer(&self) -> usize {
        usize::from(self.transfer)
    }

    /// Erases the sector that begins at this address.
    pub fn erase(&mut self, address: u32) -> Result<(), DfuError> {
        self.command(ERASE, address, || format!("erase the sector at {address:#010x}"))
    }

    /// Writes erased flash, at most [`Dfuse::transfer`] bytes.
    pub fn write(&mut self, address: u32, bytes: &[u8]) -> Result<(), DfuError> {
        self.point(address)?;
        self.transport.send(request::DNLOAD, FIRST_BLOCK, bytes).or_else(|error| self.explain(error))?;
        self.finish(|| format!("write {} bytes at {address:#010x}", bytes.len()))
    }

    /// Reads flash. The address of a block is its number times the length that is asked for (AN2662), so
    /// that a shorter last block is pointed at by itself.
    pub fn read(&mut self, address: u32, length: usize) -> Result<Vec<u8>, DfuError> {
        let mut bytes = Vec::with_capacity(length);
        let whole = length - length % self.transfer();
        for (from, to) in [(0, whole), (whole, length)] {
            if from == to {
                continue;
            }
            self.point(address + from as u32)?;
            // Memory is read from idle, not from between two writes.
            self.transport.send(request::ABORT, 0, &[])?;
            for (number, start) in (FIRST_BLOCK..=u16::MAX).zip((from..to).step_by(self.transfer())) {
                let wanted = (to - start).min(self.transfer());
                let got = self.transport.receive(request::UPLOAD, number, wanted as u16);
                let got = got.or_else(|error| self.explain(error))?;
                if got.len() != wanted {
                    return Err(DfuError::Short { got: got.len(), wanted });
                }
                bytes.extend(got);
            }
            self.transport.send(request::ABORT, 0, &[])?;
        }
        Ok(bytes)
    }

    /// Leaves the boot loader for the program whose vectors are at this address. The boot loader goes from USB.
    pub fn leave(mut self, address: u32) -> Result<(), DfuError> {
        self.point(address)?;
        self.transport.send(request::DNLOAD, FIRST_BLOCK, &[])?;
        let doing = || "start the program".to_string();
        match self.status() {
            Ok(Status { state: state::MANIFEST | state::MANIFEST_SYNC, .. }) => Ok(()),
            // It is off already.
            Err(DfuError::Usb(UsbError::Gone | UsbError::Silent)) => Ok(()),
            Ok(Status { state: state::ERROR, status, .. }) => Err(failed(status, doing)),
            Ok(Status { state, .. }) => Err(DfuError::Lost { doing: doing(), state }),
            Err(error) => Err(error),
        }
    }

    /// To idle from wherever it is.
    fn settle(&mut self) -> Result<(), DfuError> {
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

    /// Where the next write, read or start is.
    fn point(&mut self, address: u32) -> Result<(), DfuError> {
        self.command(SET_ADDRESS, address, || format!("go to address {address:#010x}"))
    }

    fn command(&mut self, command: u8, address: u32, doing: impl Fn() -> String) -> Result<(), DfuError> {
        let mut data = vec![command];
        data.extend(address.to_le_bytes());
        self.transport.send(request::DNLOAD, 0, &data).or_else(|error| self.explain(error))?;
        self.finish(doing)
    }

    /// Has what was sent last carried out, and waits for its end.
    fn finish(&mut self, doing: impl Fn() -> String) -> Result<(), DfuError> {
        let began = self.transport.now();
        loop {
            let status = self.status()?;
            match status.state {
                state::DNLOAD_IDLE => return Ok(()),
                state::DNBUSY | state::DNLOAD_SYNC => self.pause(status.pause, began, &doing)?,
                state::ERROR => return Err(failed(status.status, doing)),
                state => return Err(DfuError::Lost { doing: doing(), state }),
            }
        }
    }

    /// Waits before the next question, if the command has not taken too long since it `began`, answers included.
    fn pause(&mut self, asked: Duration, began: Duration, doing: impl Fn() -> String) -> Result<(), DfuError> {
        let pause = asked.max(PAUSE);
        if self.transport.now() - began + pause > LONGEST {
            return Err(DfuError::Endless(doing()));
        }
        self.transport.wait(pause);
        Ok(())
    }

    fn status(&mut self) -> Result<Status, DfuError> {
        let answer = self.transport.receive(request::GETSTATUS, 0, 6)?;
        match answer[..] {
            [status, low, middle, high, state, _] => {
                let pause = u32::from_le_bytes([low, middle, high, 0]);
                Ok(Status { status, pause: Duration::from_millis(pause.into()), state })
            }
            _ => Err(DfuError::Short { got: answer.len(), wanted: 6 }),
        }
    }

    /// The reason why a request was refused, which the status tells where the boot loader still answers.
    fn explain<O>(&mut self, error: UsbError) -> Result<O, DfuError> {
        if error == UsbError::Stalled
            && let Ok(Status { state: state::ERROR, status, .. }) = self.status()
        {
            return Err(failed(status, || "take a request".into()));
        }
        Err(error.into())
    }
}

fn failed(status: u8, doing: impl Fn() -> String) -> DfuError {
    match status {
        VENDOR => DfuError::Protected,
        status => DfuError::Failed { doing: doing(), status },
    }
}
