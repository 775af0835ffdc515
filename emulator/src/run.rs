//! A running virtual board. The emulator has its own thread, in lockstep with the owner of the [`VirtualBoard`].
//!
//! The board runs only during [`VirtualBoard::run`]. A test that writes, runs and reads therefore gets the same bytes
//! at the same virtual times on every machine, however fast the machine is.

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
use crate::image::Firmware;
use crate::rtt::Rtt;
use crate::trace::{Code, Run, Tracer};
use crate::usb;

/// Nanoseconds in a microsecond of virtual time.
pub const MICROSECOND: u64 = 1_000;
/// Nanoseconds in a millisecond of virtual time.
pub const MILLISECOND: u64 = 1_000_000;
/// Nanoseconds in a second of virtual time.
pub const SECOND: u64 = 1_000_000_000;

/// Interrupt line of the chip's supply monitor.
const SUPPLY_MONITOR: InterruptLine = InterruptLine::new(1).expect("a line of the part");

/// A board that stands still, so that everything on it can be inspected and changed.
pub struct StoppedBoard<'a> {
    session: &'a mut Session<Hardware>,
    memory: &'a mut dyn emulator::Host,
    /// Virtual time since power-on, ns.
    pub at: u64,
    /// Number of instructions executed since power-on.
    pub instructions: u64,
    tracer: &'a mut Option<Tracer>,
    rtt: &'a mut Rtt,
}

impl StoppedBoard<'_> {
    /// Returns the board's hardware.
    pub fn hardware(&mut self) -> &mut Hardware {
        self.session.board_mut()
    }

    /// Returns the computer at the other end of the USB cable.
    pub fn usb(&mut self) -> &mut usb::Host {
        &mut self.session.board_mut().chip.otg.host
    }

    /// Returns the word at `address` of the chip's memory, or `None` if there is no memory at this address.
    pub fn word(&mut self, address: u64) -> Option<u32> {
        self.memory.read(address, Width::W32).ok().map(|value| value as u32)
    }

    /// Overwrites the word at `address` of the chip's RAM. Returns true if there is RAM at this address.
    pub fn poke(&mut self, address: u64, value: u32) -> bool {
        self.memory.write(address, Width::W32, u64::from(value)).is_ok()
    }

    /// Returns the words in a range of the flash.
    pub fn flash(&mut self, place: Range<u64>) -> Vec<u32> {
        place.step_by(4).map(|at| self.word(at).expect("flash at this address")).collect()
    }

    /// Writes `words` to the flash from `start` on, like a programming tool. Takes effect when the run continues.
    pub fn set_flash(&mut self, start: u64, words: &[u32]) {
        let at = VirtualNanos(self.at);
        for (address, word) in (start..).step_by(4).zip(words) {
            if self.word(address) != Some(*word) {
                self.hardware().chip.corrupt_flash(at, address, *word);
            }
        }
    }

    /// Flips a bit in the first byte of the last `text` in a range of the flash. Takes effect when the run continues.
    pub fn flip_in_flash(&mut self, place: Range<u64>, text: &[u8]) {
        let bytes: Vec<u8> = self.flash(place.clone()).into_iter().flat_map(u32::to_le_bytes).collect();
        let offset = bytes.windows(text.len()).rposition(|window| window == text).expect("the text is in flash");
        let word = place.start + offset as u64 / 4 * 4;
        let flipped = self.word(word).expect("flash at this address") ^ 1 << (8 * (offset % 4));
        let at = VirtualNanos(self.at);
        self.hardware().chip.corrupt_flash(at, word, flipped);
    }

    /// Sets the chip's supply voltage and passes the supply monitor's request to the core (line 1, RM0090 table 61).
    pub fn set_supply(&mut self, millivolts: u32) {
        let at = VirtualNanos(self.at);
        let asks = self.hardware().chip.set_supply_voltage(at, millivolts);
        self.memory.set_interrupt(SUPPLY_MONITOR, Level::from(asks));
    }

    /// Holds the core, so that it executes nothing while time passes, or releases the core.
    pub fn hold_core(&mut self, held: bool) {
        self.memory.hold(held);
    }

    /// Starts to record every instruction of the handler at `entry`. This is slow: a virtual second takes minutes.
    pub fn trace(&mut self, code: &Code, entry: u64) {
        code.addresses().for_each(|address| self.session.watch(Watch::Instruction(address)));
        *self.tracer = Some(Tracer::new(code.clone(), entry as u32));
    }

    /// Ends the recording of [`StoppedBoard::trace`] and returns the complete runs of the handler.
    pub fn take_trace(&mut self, code: &Code) -> Vec<Run> {
        code.addresses().for_each(|address| self.session.unwatch(Watch::Instruction(address)));
        self.tracer.take().map(Tracer::finish).unwrap_or_default()
    }

    /// Returns the raw log that the firmware wrote since the last call (RTT up-channel 0), like a debug probe.
    pub fn take_log(&mut self) -> Vec<u8> {
        self.rtt.drain(self.memory);
        self.rtt.take()
    }

    /// Returns all restarts of the chip so far.
    #[must_use]
    pub fn resets(&self) -> &[Reset] {
        self.session.resets()
    }

    /// Asserts the reset pin.
    pub fn reset(&mut self) {
        let (at, count) = (VirtualNanos(self.at), self.instructions);
        self.session.reset_by_pin(at, count, self.memory);
    }

    /// Returns the firmware's accesses for which the virtual chip has no model, one per line.
    #[must_use]
    pub fn unmodelled_accesses(&self) -> Vec<String> {
        let unmapped = self.session.unmapped().into_iter().map(|gap| gap.to_string());
        let refused = self.session.refused().iter().map(|(at, why)| format!("refused at={at:#x} {why}"));
        let files =
            self.session.unimplemented().iter().map(|(at, gap)| {
                format!("no model at={at:#x} {}.{} writes={}", gap.instance, gap.register, gap.writes)
            });
        let unrouted = self.session.unrouted().iter().map(|(who, line)| format!("unrouted {who} {line}"));
        let notes =
            self.session.told().map(|note| format!("told {}.{}: {}", note.instance, note.register, note.reason));
        unmapped.chain(refused).chain(files).chain(unrouted).chain(notes).collect()
    }
}

type Job = Box<dyn FnOnce(&mut StoppedBoard<'_>) + Send>;

enum Command {
    RunJob(Job),
    RunUntil(u64),
}

enum Reply {
    Done,
    Stopped { at: u64, instructions: u64 },
}

/// A virtual board that runs only on request.
#[derive(Debug)]
pub struct VirtualBoard {
    commands: Option<Sender<Command>>,
    replies: Receiver<Reply>,
    thread: Option<JoinHandle<Result<(), String>>>,
    at: u64,
    instructions: u64,
}

impl VirtualBoard {
    /// Powers on a board with `firmware` in its flash, and stops at the first instruction.
    /// Returns an error if the emulator rejects the image.
    pub fn start(firmware: &Firmware, hardware: Hardware) -> Result<Self, String> {
        let emulator = |error: &dyn fmt::Display| format!("the emulator stopped: {error}");
        let session = Session::new(Box::new(hardware), 0, VirtualNanos(1)).map_err(|error| emulator(&error))?;
        let image = firmware.image().map_err(|error| emulator(&error))?;
        let rtt = Rtt::new(firmware.find("_SEGGER_RTT").map(|symbol| symbol.address));
        let (commands, requests) = channel();
        let (replies_out, replies) = channel();
        let runner = Runner { requests, replies_out, stop_time: 0, is_waiting: false, tracer: None, rtt };
        let thread = std::thread::spawn(move || {
            emulator::run(session, &Start::new(&[image]), runner).map(|_| ()).map_err(|error| error.to_string())
        });
        let board = Self { commands: Some(commands), replies, thread: Some(thread), at: 0, instructions: 0 };
        Ok(board)
    }

    /// Returns the virtual time since power-on, ns.
    #[must_use]
    pub fn now(&self) -> u64 {
        self.at
    }

    /// Returns the number of instructions executed since power-on.
    #[must_use]
    pub fn instructions(&self) -> u64 {
        self.instructions
    }

    /// Runs for `span` nanoseconds of virtual time.
    pub fn run(&mut self, span: u64) {
        let until = self.at + span;
        match self.send_command(Command::RunUntil(until)) {
            Reply::Stopped { at, instructions } => (self.at, self.instructions) = (at, instructions),
            Reply::Done => unreachable!("a run replies with the time of its stop"),
        }
    }

    /// Runs `job` while the board stands still, and returns its result.
    pub fn while_stopped<T: Send + 'static>(
        &mut self,
        job: impl FnOnce(&mut StoppedBoard<'_>) -> T + Send + 'static,
    ) -> T {
        let (result, outcome) = channel();
        self.send_command(Command::RunJob(Box::new(move |stopped| {
            // The receiver below outlives the job.
            let _ = result.send(job(stopped));
        })));
        outcome.recv().expect("the job was done")
    }

    /// Runs for at most `span` (ns) and calls `done` every `step` (ns) until it returns true. Returns the last result.
    pub fn run_until(
        &mut self,
        span: u64,
        step: u64,
        mut done: impl FnMut(&mut StoppedBoard<'_>) -> bool + Send + Clone + 'static,
    ) -> bool {
        let last = self.at + span;
        while self.at < last {
            self.run(step.min(last - self.at));
            let mut check = done.clone();
            let (is_done, returned) = self.while_stopped(move |stopped| (check(stopped), check));
            done = returned;
            if is_done {
                return true;
            }
        }
        false
    }

    fn send_command(&mut self, command: Command) -> Reply {
        let sent = self.commands.as_ref().is_some_and(|commands| commands.send(command).is_ok());
        let reply = if sent { self.replies.recv().ok() } else { None };
        match reply {
            Some(reply) => reply,
            None => panic!("the virtual board stopped: {}", self.stop_reason()),
        }
    }

    fn stop_reason(&mut self) -> String {
        match self.thread.take().map(JoinHandle::join) {
            Some(Ok(Ok(()))) => "the run ended".to_owned(),
            Some(Ok(Err(error))) => error,
            Some(Err(_)) => "a model panicked (its message is above)".to_owned(),
            None => "it had already been stopped".to_owned(),
        }
    }
}

impl Drop for VirtualBoard {
    fn drop(&mut self) {
        self.commands = None;
        if let Some(thread) = self.thread.take() {
            // If the board's thread panicked, the call that noticed the panic has already reported it.
            let _ = thread.join();
        }
    }
}

struct Runner {
    requests: Receiver<Command>,
    replies_out: Sender<Reply>,
    stop_time: u64,
    is_waiting: bool,
    tracer: Option<Tracer>,
    rtt: Rtt,
}

impl Runner {
    /// Serves commands at a requested stop until a command continues the run. Returns `None` if the owner is gone.
    fn serve(&mut self, session: &mut Session<Hardware>, memory: &mut dyn emulator::Host, stop: Stop) -> Option<()> {
        if std::mem::take(&mut self.is_waiting) {
            let (at, instructions) = (stop.at.0, stop.instruction_count);
            self.replies_out.send(Reply::Stopped { at, instructions }).ok()?;
        }
        loop {
            match self.requests.recv().ok()? {
                Command::RunJob(job) => {
                    let Self { tracer, rtt, .. } = self;
                    let (at, instructions) = (stop.at.0, stop.instruction_count);
                    job(&mut StoppedBoard { session, memory, at, instructions, tracer, rtt });
                    self.replies_out.send(Reply::Done).ok()?;
                }
                Command::RunUntil(until) => {
                    self.stop_time = until;
                    self.is_waiting = true;
                    if until > stop.at.0 {
                        return Some(());
                    }
                    self.is_waiting = false;
                    let (at, instructions) = (stop.at.0, stop.instruction_count);
                    self.replies_out.send(Reply::Stopped { at, instructions }).ok()?;
                }
            }
        }
    }
}

impl Driver<Hardware> for Runner {
    fn on_settled(&mut self, _: &mut Session<Hardware>, _: &mut dyn emulator::Host, settled: Settled) {
        if let Settled::Hit(hit) = settled {
            self.tracer.iter_mut().for_each(|tracer| tracer.feed(&hit));
        }
    }

    fn on_stop(
        &mut self,
        session: &mut Session<Hardware>,
        stop: Stop,
        memory: &mut dyn emulator::Host,
    ) -> Option<VirtualNanos> {
        let next = session.board_mut().step(stop.at);
        if stop.at.0 >= self.stop_time {
            self.serve(session, memory, stop)?;
        }
        Some(VirtualNanos(next.map_or(self.stop_time, |next| next.0.min(self.stop_time))))
    }
}
