//! A running virtual board: the emulator on a thread of its own, in lockstep with whoever holds the [`VirtualBoard`].
//!
//! The board stands still unless it is told to run to an instant, so a test that writes, runs and reads sees the same
//! bytes at the same virtual instants on every machine, however fast the machine is.

use std::fmt;
use std::ops::Range;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;

use rigless::device::Level;
use rigless::emulator::{self, Driver, InterruptLine, Settled, Start, Stop, Watch};
use rigless::session::{Reset, Session};
use rigless::soc::Width;
use rigless::time::VirtualNanos;

use crate::hardware::Hardware;
use crate::image::{self, Firmware};
use crate::rtt::Rtt;
use crate::shares::Tally;
use crate::trace::{Code, Run, Tracer};
use crate::usb;

/// Nanoseconds in a microsecond and a millisecond of virtual time.
pub const MICROSECOND: u64 = 1_000;
/// Nanoseconds in a millisecond of virtual time.
pub const MILLISECOND: u64 = 1_000_000;
/// Nanoseconds in a second of virtual time.
pub const SECOND: u64 = 1_000_000_000;

/// The interrupt of the chip's supply monitor.
const SUPPLY_MONITOR: InterruptLine = InterruptLine::new(1).expect("a line of the part");

/// Why a board could not be started.
#[derive(Debug)]
pub enum Error {
    /// The image is not there or is not an image.
    Image(image::Error),
    /// The emulator refused it, or stopped.
    Emulator(String),
}

impl fmt::Display for Error {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Image(error) => write!(out, "{error}"),
            Self::Emulator(error) => write!(out, "the emulator stopped: {error}"),
        }
    }
}

impl std::error::Error for Error {}

impl From<image::Error> for Error {
    fn from(error: image::Error) -> Self {
        Self::Image(error)
    }
}

/// The board at a stop: everything on it can be looked at and changed.
pub struct StoppedBoard<'a> {
    session: &'a mut Session<Hardware>,
    memory: &'a mut dyn emulator::Host,
    /// Virtual nanoseconds since power-on.
    pub at: u64,
    /// Instructions executed since power-on.
    pub instructions: u64,
    tracer: &'a mut Option<Tracer>,
    tally: &'a mut Option<Tally>,
    rtt: &'a mut Rtt,
}

impl StoppedBoard<'_> {
    /// The board's hardware.
    pub fn hardware(&mut self) -> &mut Hardware {
        self.session.board_mut()
    }

    /// The computer at the other end of the USB cable.
    pub fn usb(&mut self) -> &mut usb::Host {
        &mut self.session.board_mut().chip.otg.host
    }

    /// Returns the word at `address` of the chip's memory, or `None` if there is no memory.
    pub fn word(&mut self, address: u64) -> Option<u32> {
        self.memory.read(address, Width::W32).ok().map(|value| value as u32)
    }

    /// Overwrites the word at `address` of the chip's RAM. Answers whether there is RAM.
    pub fn poke(&mut self, address: u64, value: u32) -> bool {
        self.memory.write(address, Width::W32, u64::from(value)).is_ok()
    }

    /// The words of a `place` of the flash.
    ///
    /// # Panics
    ///
    /// When there is no memory.
    pub fn flash(&mut self, place: Range<u64>) -> Vec<u32> {
        place.step_by(4).map(|at| self.word(at).expect("there is flash")).collect()
    }

    /// Puts `words` into the flash from `start` on, as a programming tool does. In force when the run goes on.
    ///
    /// # Panics
    ///
    /// When there is no memory.
    pub fn set_flash(&mut self, start: u64, words: &[u32]) {
        let at = VirtualNanos(self.at);
        for (address, word) in (start..).step_by(4).zip(words) {
            if self.word(address) != Some(*word) {
                self.hardware().chip.spoil_flash(at, address, *word);
            }
        }
    }

    /// Flips a bit of the first byte of the last `text` in a `place` of the flash. In force when the run goes on.
    ///
    /// # Panics
    ///
    /// When the text is not there.
    pub fn flip_in_flash(&mut self, place: Range<u64>, text: &[u8]) {
        let bytes: Vec<u8> = self.flash(place.clone()).into_iter().flat_map(u32::to_le_bytes).collect();
        let found = bytes.windows(text.len()).rposition(|window| window == text).expect("the text is in flash");
        let word = place.start + found as u64 / 4 * 4;
        let flipped = self.word(word).expect("there is flash") ^ 1 << (8 * (found % 4));
        let at = VirtualNanos(self.at);
        self.hardware().chip.spoil_flash(at, word, flipped);
    }

    /// Gives the chip so many millivolts, and its core the supply monitor's request (line 1, RM0090 table 61).
    pub fn supply(&mut self, millivolts: u32) {
        let at = VirtualNanos(self.at);
        let asks = self.hardware().chip.supply(at, millivolts);
        self.memory.set_interrupt(SUPPLY_MONITOR, Level::from(asks));
    }

    /// Holds the core: it executes nothing while time goes on. Or lets it go on.
    pub fn hold(&mut self, held: bool) {
        self.memory.hold(held);
    }

    /// Starts noting every instruction of the handler that starts at `entry`. Slow: a virtual second takes minutes.
    pub fn trace(&mut self, code: &Code, entry: u64) {
        code.addresses().for_each(|address| self.session.watch(Watch::Instruction(address)));
        *self.tracer = Some(Tracer::new(code.clone(), entry as u32));
    }

    /// Ends what [`StoppedBoard::trace`] began and takes the handler's whole runs.
    pub fn take_trace(&mut self, code: &Code) -> Vec<Run> {
        code.addresses().for_each(|address| self.session.unwatch(Watch::Instruction(address)));
        self.tracer.take().map(Tracer::finish).unwrap_or_default()
    }

    /// Starts counting every instruction beside the control interrupt that starts at `entry`. As slow as a trace.
    pub fn tally(&mut self, code: &Code, entry: u64) {
        code.addresses().for_each(|address| self.session.watch(Watch::Instruction(address)));
        *self.tally = Some(Tally::new(code.clone(), entry as u32));
    }

    /// Ends what [`StoppedBoard::tally`] began.
    pub fn take_tally(&mut self, code: &Code) -> Option<Tally> {
        code.addresses().for_each(|address| self.session.unwatch(Watch::Instruction(address)));
        self.tally.take()
    }

    /// Takes the raw log the firmware wrote since the last call (RTT up-channel 0), as a probe would.
    pub fn take_log(&mut self) -> Vec<u8> {
        self.rtt.drain(self.memory);
        self.rtt.take()
    }

    /// Every restart of the chip so far.
    #[must_use]
    pub fn resets(&self) -> &[Reset] {
        self.session.resets()
    }

    /// Pulls the reset pin.
    pub fn reset(&mut self) {
        let (at, count) = (VirtualNanos(self.at), self.instructions);
        self.session.reset_by_pin(at, count, self.memory);
    }

    /// Returns the firmware's accesses that the virtual chip has no model for, one line each: an empty list means every
    /// access was answered by a model.
    #[must_use]
    pub fn gaps(&self) -> Vec<String> {
        let unmapped = self.session.unmapped().into_iter().map(|gap| gap.to_string());
        let refused = self.session.refused().iter().map(|(at, why)| format!("refused at={at:#x} {why}"));
        let files =
            self.session.unimplemented().iter().map(|(at, gap)| {
                format!("no model at={at:#x} {}.{} writes={}", gap.instance, gap.register, gap.writes)
            });
        let unrouted = self.session.unrouted().iter().map(|(who, line)| format!("unrouted {who} {line}"));
        let told = self.session.told().map(|told| format!("told {}.{}: {}", told.instance, told.register, told.reason));
        unmapped.chain(refused).chain(files).chain(unrouted).chain(told).collect()
    }
}

type Job = Box<dyn FnOnce(&mut StoppedBoard<'_>) + Send>;

enum Command {
    With(Job),
    RunUntil(u64),
}

enum Reply {
    Done,
    Stopped { at: u64, instructions: u64 },
}

/// A board that runs when told to.
#[derive(Debug)]
pub struct VirtualBoard {
    commands: Option<Sender<Command>>,
    replies: Receiver<Reply>,
    thread: Option<JoinHandle<Result<(), String>>>,
    at: u64,
    instructions: u64,
}

impl VirtualBoard {
    /// Powers a board with `firmware` in its flash. It stands at its first instruction.
    ///
    /// # Errors
    ///
    /// An image the emulator refuses.
    pub fn start(firmware: &Firmware, hardware: Hardware) -> Result<Self, Error> {
        let emulator = |error: &dyn fmt::Display| Error::Emulator(error.to_string());
        let session = Session::new(Box::new(hardware), 0, VirtualNanos(1)).map_err(|error| emulator(&error))?;
        let image = firmware.image().map_err(|error| emulator(&error))?;
        let rtt = Rtt::new(firmware.find("_SEGGER_RTT").map(|symbol| symbol.address));
        let (commands, orders) = channel();
        let (answers, replies) = channel();
        let runner = Runner { orders, answers, until: 0, waiting: false, tracer: None, tally: None, rtt };
        let thread = std::thread::spawn(move || {
            emulator::run(session, &Start::new(&[image]), runner).map(|_| ()).map_err(|error| error.to_string())
        });
        let board = Self { commands: Some(commands), replies, thread: Some(thread), at: 0, instructions: 0 };
        Ok(board)
    }

    /// Virtual nanoseconds since power-on.
    #[must_use]
    pub fn now(&self) -> u64 {
        self.at
    }

    /// Instructions executed since power-on.
    #[must_use]
    pub fn instructions(&self) -> u64 {
        self.instructions
    }

    /// Runs for `span` nanoseconds of virtual time.
    ///
    /// # Panics
    ///
    /// When the emulator stopped, with its reason.
    pub fn run(&mut self, span: u64) {
        let until = self.at + span;
        match self.order(Command::RunUntil(until)) {
            Reply::Stopped { at, instructions } => (self.at, self.instructions) = (at, instructions),
            Reply::Done => unreachable!("a run answers where it stopped"),
        }
    }

    /// Does `job` with the board standing still, and answers what it answered.
    ///
    /// # Panics
    ///
    /// When the emulator stopped, with its reason.
    pub fn with<T: Send + 'static>(&mut self, job: impl FnOnce(&mut StoppedBoard<'_>) -> T + Send + 'static) -> T {
        let (result, taken) = channel();
        self.order(Command::With(Box::new(move |stopped| {
            // The receiver stands below, so there is someone to take it.
            let _ = result.send(job(stopped));
        })));
        taken.recv().expect("the job was done")
    }

    /// Runs until `done` says so, looking every `step` nanoseconds and for at most `span`. Answers whether it did.
    pub fn run_until(
        &mut self,
        span: u64,
        step: u64,
        mut done: impl FnMut(&mut StoppedBoard<'_>) -> bool + Send + Clone + 'static,
    ) -> bool {
        let last = self.at + span;
        while self.at < last {
            self.run(step.min(last - self.at));
            let mut look = done.clone();
            let (is_done, kept) = self.with(move |stopped| (look(stopped), look));
            done = kept;
            if is_done {
                return true;
            }
        }
        false
    }

    fn order(&mut self, command: Command) -> Reply {
        let sent = self.commands.as_ref().is_some_and(|commands| commands.send(command).is_ok());
        let reply = if sent { self.replies.recv().ok() } else { None };
        match reply {
            Some(reply) => reply,
            None => panic!("the virtual board stopped: {}", self.why()),
        }
    }

    fn why(&mut self) -> String {
        match self.thread.take().map(JoinHandle::join) {
            Some(Ok(Ok(()))) => "the run ended".to_owned(),
            Some(Ok(Err(error))) => error,
            Some(Err(_)) => "a model panicked (its message is above)".to_owned(),
            None => "it was stopped before".to_owned(),
        }
    }
}

impl Drop for VirtualBoard {
    fn drop(&mut self) {
        self.commands = None;
        if let Some(thread) = self.thread.take() {
            // A panic of the board's thread has been reported where the board was used.
            let _ = thread.join();
        }
    }
}

struct Runner {
    orders: Receiver<Command>,
    answers: Sender<Reply>,
    until: u64,
    waiting: bool,
    tracer: Option<Tracer>,
    tally: Option<Tally>,
    rtt: Rtt,
}

impl Runner {
    /// Serves orders at a stop the holder asked for, until one says where to run to; `None` when the holder is gone.
    fn serve(&mut self, session: &mut Session<Hardware>, memory: &mut dyn emulator::Host, stop: Stop) -> Option<()> {
        if std::mem::take(&mut self.waiting) {
            let (at, instructions) = (stop.at.0, stop.instruction_count);
            self.answers.send(Reply::Stopped { at, instructions }).ok()?;
        }
        loop {
            match self.orders.recv().ok()? {
                Command::With(job) => {
                    let Self { tracer, tally, rtt, .. } = self;
                    let (at, instructions) = (stop.at.0, stop.instruction_count);
                    job(&mut StoppedBoard { session, memory, at, instructions, tracer, tally, rtt });
                    self.answers.send(Reply::Done).ok()?;
                }
                Command::RunUntil(until) => {
                    self.until = until;
                    self.waiting = true;
                    if until > stop.at.0 {
                        return Some(());
                    }
                    self.waiting = false;
                    let (at, instructions) = (stop.at.0, stop.instruction_count);
                    self.answers.send(Reply::Stopped { at, instructions }).ok()?;
                }
            }
        }
    }
}

impl Driver<Hardware> for Runner {
    fn on_settled(&mut self, _: &mut Session<Hardware>, _: &mut dyn emulator::Host, settled: Settled) {
        if let Settled::Hit(hit) = settled {
            self.tracer.iter_mut().for_each(|tracer| tracer.feed(&hit));
            self.tally.iter_mut().for_each(|tally| tally.feed(&hit));
        }
    }

    fn on_stop(
        &mut self,
        session: &mut Session<Hardware>,
        stop: Stop,
        memory: &mut dyn emulator::Host,
    ) -> Option<VirtualNanos> {
        let next = session.board_mut().step(stop.at);
        if stop.at.0 >= self.until {
            self.serve(session, memory, stop)?;
        }
        Some(VirtualNanos(next.map_or(self.until, |next| next.0.min(self.until))))
    }
}
