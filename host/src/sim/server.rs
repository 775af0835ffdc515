//! A simulated board behind a port that other programs open: a pseudo-terminal or a TCP address.
//!
//! One thread runs the board and owns it; others only carry bytes, through queues of a bounded length, so that a tool
//! that floods or does not read costs no memory. A second tool on TCP is told that the board is taken; on a
//! pseudo-terminal a lock tells it. One that has held the board in silence gives way to it, and a request to disarm
//! gets through in any case.

use super::board::SimulatedBoard;
use crate::link::{Deframer, Occupied, encode};
use haptic_bridge::board::protocol::Disarm;
use postcard_rpc::Endpoint as _;
use postcard_rpc::Topic;
use postcard_rpc::header::{VarHeader, VarKey, VarSeq};
use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TryRecvError, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// A board as its server needs it; the emulated chip is another.
pub trait Hosted {
    /// Takes bytes from the tool.
    fn receive(&mut self, bytes: &[u8]);
    /// Bytes for the tool, as many as fit; returns how many.
    fn take_bytes(&mut self, buffer: &mut [u8]) -> usize;
    /// The tool is gone.
    fn hang_up(&mut self);
    /// Lets seconds pass.
    fn run(&mut self, seconds: f64);
    /// For how long the host has sent no heartbeat, and for how long it may, s; none where the board does not mind.
    fn host_silence(&self) -> Option<(f64, f64)> {
        None
    }
}

impl Hosted for SimulatedBoard {
    fn receive(&mut self, bytes: &[u8]) {
        Self::receive(self, bytes);
    }
    fn take_bytes(&mut self, buffer: &mut [u8]) -> usize {
        Self::take_bytes(self, buffer)
    }
    fn hang_up(&mut self) {
        Self::hang_up(self);
    }
    fn run(&mut self, seconds: f64) {
        Self::run(self, seconds);
    }
    fn host_silence(&self) -> Option<(f64, f64)> {
        Self::host_silence(self)
    }
}

/// How simulated time passes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// With the wall clock; when the computer is too slow, later.
    RealTime,
    /// As fast as the computer can while a tool is connected and reads; no telemetry is dropped. Where the board turns
    /// its motors off when the tool is silent, simulated time does not run away from the tool: from a quarter of that
    /// silence on it passes no faster than the wall clock, so that only a silence that is one is taken for one.
    AsFastAsItCan,
}

enum Event {
    Connected(Outgoing),
    Bytes(Vec<u8>),
    Gone,
    /// A tool that found the board taken asks it to disarm: its request, and the way back.
    Disarm(Vec<u8>, Outgoing),
}

/// Bytes to the tool, carried by a thread of their own so that a tool that does not read stops nobody.
type Outgoing = SyncSender<Vec<u8>>;

/// Blocks of bytes under way to the tool.
const BLOCKS: usize = 8;
/// Bytes in a block.
const BLOCK: usize = 4096;
/// Blocks from a tool that wait for the board.
const EVENTS: usize = 16;
/// Connections that are looked at while one holds the board; more are closed at once.
const KNOCKING: usize = 16;
/// How long a tool may hold the board without a byte when another one asks for it: ours say something ten times a
/// second while they listen.
const SILENCE: Duration = Duration::from_secs(3);
/// How long a second tool waits for the first one to leave: one command after another is not two at once.
const HANDOVER: Duration = Duration::from_millis(500);
/// How long a tool that disarms past another one hears what the board says.
const DISARM_ANSWER: Duration = Duration::from_secs(1);
/// Simulated time between two looks at the link, s.
const SLICE: f64 = 1e-3;
/// The most that a board in real time catches up after the computer was busy, s.
const CATCH_UP: f64 = 0.1;

/// A door that tools come through.
pub struct Door {
    /// What a tool writes after `--port`.
    pub port: String,
    events: Receiver<Event>,
}

/// Opens a pseudo-terminal.
#[cfg(unix)]
pub fn pseudo_terminal() -> io::Result<Door> {
    use serialport::{SerialPort, TTYPort};
    let (mut master, slave) = TTYPort::pair()?;
    let port = slave.name().unwrap_or_default();
    // With no end of our own open, reads fail while no tool is connected: that is how a hang-up shows.
    drop(slave);
    master.set_timeout(Duration::from_millis(100))?;
    let writer = master.try_clone_native()?;
    let (send, events) = sync_channel(EVENTS);
    thread::spawn(move || {
        let mut connected = false;
        let mut buffer = [0; BLOCK];
        loop {
            match master.read(&mut buffer) {
                Ok(count) if count > 0 => {
                    if !connected {
                        connected = true;
                        let Ok(copy) = writer.try_clone_native() else { return };
                        if send.send(Event::Connected(outgoing(copy))).is_err() {
                            return;
                        }
                    }
                    if send.send(Event::Bytes(buffer[..count].to_vec())).is_err() {
                        return;
                    }
                }
                Err(error) if error.kind() == io::ErrorKind::TimedOut => {}
                _ => {
                    if std::mem::take(&mut connected) && send.send(Event::Gone).is_err() {
                        return;
                    }
                    thread::sleep(Duration::from_millis(2));
                }
            }
        }
    });
    Ok(Door { port, events })
}

/// Listens on a TCP address; port 0 takes any that is free. Only this computer is let in unless the address says more.
pub fn tcp(address: SocketAddr) -> io::Result<Door> {
    let listener = TcpListener::bind(address)?;
    let port = format!("tcp:{}", listener.local_addr()?);
    let (send, events) = sync_channel(EVENTS);
    thread::spawn(move || {
        let holder = Holder::default();
        let knocking = Arc::new(AtomicUsize::new(0));
        for stream in listener.incoming() {
            let Ok(stream) = stream else { continue };
            if knocking.fetch_add(1, Ordering::SeqCst) >= KNOCKING {
                knocking.fetch_sub(1, Ordering::SeqCst);
                continue;
            }
            let (send, holder, knocking) = (send.clone(), holder.clone(), Arc::clone(&knocking));
            thread::spawn(move || match holder.admits(&stream) {
                Some(seat) => {
                    knocking.fetch_sub(1, Ordering::SeqCst);
                    let _ = carry(stream, &send, &holder, seat);
                }
                None => {
                    let request = turn_away(&stream);
                    knocking.fetch_sub(1, Ordering::SeqCst);
                    if let Some(request) = request {
                        let _ = disarm_for(stream, request, &send);
                    }
                }
            });
        }
    });
    Ok(Door { port, events })
}

/// The connection that holds the board.
#[derive(Clone, Default)]
struct Holder(Arc<Mutex<Option<Held>>>);

struct Held {
    /// Tells this connection from the ones before and after it.
    seat: u64,
    stream: TcpStream,
    heard: Instant,
}

impl Holder {
    fn lock(&self) -> MutexGuard<'_, Option<Held>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Gives the board to this connection if it is free within [`HANDOVER`], or held in silence; its seat.
    fn admits(&self, stream: &TcpStream) -> Option<u64> {
        let began = Instant::now();
        loop {
            {
                let mut held = self.lock();
                match &*held {
                    None => {
                        let seat = held_seats();
                        let stream = stream.try_clone().ok()?;
                        *held = Some(Held { seat, stream, heard: Instant::now() });
                        return Some(seat);
                    }
                    // Its reading thread sees the end, and frees the board.
                    Some(silent) if silent.heard.elapsed() > SILENCE => {
                        let _ = silent.stream.shutdown(std::net::Shutdown::Both);
                    }
                    Some(_) => {}
                }
            }
            if began.elapsed() > HANDOVER {
                return None;
            }
            thread::sleep(Duration::from_millis(10));
        }
    }

    fn heard(&self, seat: u64) {
        if let Some(held) = self.lock().as_mut().filter(|held| held.seat == seat) {
            held.heard = Instant::now();
        }
    }

    fn leaves(&self, seat: u64) {
        self.lock().take_if(|held| held.seat == seat);
    }
}

/// A number that no connection before had.
fn held_seats() -> u64 {
    static SEATS: AtomicUsize = AtomicUsize::new(0);
    SEATS.fetch_add(1, Ordering::SeqCst) as u64
}

/// Carries the bytes of the connection that holds the board, until it ends.
fn carry(mut stream: TcpStream, send: &SyncSender<Event>, holder: &Holder, seat: u64) -> io::Result<()> {
    let outgoing = tcp_outgoing(&stream);
    let mut alive = outgoing.is_ok_and(|outgoing| send.send(Event::Connected(outgoing)).is_ok());
    let mut buffer = [0; BLOCK];
    while alive {
        alive = match stream.read(&mut buffer) {
            Ok(0) | Err(_) => false,
            Ok(count) => {
                holder.heard(seat);
                send.send(Event::Bytes(buffer[..count].to_vec())).is_ok()
            }
        };
    }
    let _ = send.send(Event::Gone);
    holder.leaves(seat);
    Ok(())
}

fn tcp_outgoing(stream: &TcpStream) -> io::Result<Outgoing> {
    stream.set_nodelay(true)?;
    let writer = stream.try_clone()?;
    writer.set_write_timeout(Some(Duration::from_millis(100)))?;
    Ok(outgoing(writer))
}

/// Hears what a second tool wants: `Some` request when it is to disarm, which gets through; else it is told that the
/// board is taken. What it sends is read first: unread, it would make the system throw away what was written.
pub fn turn_away(stream: &TcpStream) -> Option<Vec<u8>> {
    let _ = stream.set_read_timeout(Some(HANDOVER));
    let mut disarm = None;
    let mut deframer = Deframer::default();
    let mut buffer = [0; BLOCK];
    let mut reader = stream;
    let began = Instant::now();
    let mut asked = false;
    while !asked && began.elapsed() < HANDOVER {
        let Ok(count @ 1..) = reader.read(&mut buffer) else { break };
        deframer.feed(&buffer[..count], |frame| {
            asked = true;
            if frame.header.key == VarKey::Key8(Disarm::REQ_KEY) {
                disarm = Some(encode(&frame.header, &frame.body));
            }
        });
    }
    if disarm.is_none() {
        let header = VarHeader { key: VarKey::Key8(Occupied::TOPIC_KEY), seq_no: VarSeq::Seq2(0) };
        let mut writer = stream;
        let _ = writer.write_all(&encode(&header, &[]));
        let _ = stream.shutdown(std::net::Shutdown::Write);
        let _ = reader.read(&mut buffer);
    }
    disarm
}

/// Has the board disarm for a tool that does not hold it, and lets that tool hear the answer.
fn disarm_for(stream: TcpStream, request: Vec<u8>, send: &SyncSender<Event>) -> io::Result<()> {
    let answers = tcp_outgoing(&stream)?;
    let _ = send.send(Event::Disarm(request, answers));
    stream.set_read_timeout(Some(DISARM_ANSWER))?;
    let mut reader = stream;
    let _ = reader.read(&mut [0; BLOCK]);
    Ok(())
}

/// A thread that writes blocks to `sink` until the sender is dropped or the sink is gone.
fn outgoing(mut sink: impl Write + Send + 'static) -> Outgoing {
    let (send, blocks) = sync_channel::<Vec<u8>>(BLOCKS);
    thread::spawn(move || {
        for block in blocks {
            let mut rest = block.as_slice();
            while !rest.is_empty() {
                match sink.write(rest) {
                    Ok(0) => return,
                    Ok(count) => rest = &rest[count..],
                    Err(error) => match error.kind() {
                        io::ErrorKind::TimedOut | io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted => {}
                        _ => return,
                    },
                }
            }
        }
    });
    send
}

/// Runs `board` behind `door` until `stop` is set.
pub fn serve(board: &mut impl Hosted, door: &Door, pace: Pace, stop: &AtomicBool) {
    let mut tools = Tools::default();
    let began = Instant::now();
    let mut ran = 0.0;
    let mut skipped = 0.0;
    // Since when the host is silent on the wall clock, and for how long it was by the board's.
    let mut heard = (Instant::now(), 0.0);
    while !stop.load(Ordering::SeqCst) {
        let now = began.elapsed().as_secs_f64() - skipped;
        let behind = now - ran;
        let idle = match pace {
            Pace::RealTime => behind < SLICE,
            Pace::AsFastAsItCan => {
                let runs_away = board.host_silence().is_some_and(|(silent, allowed)| {
                    if silent < heard.1 {
                        heard.0 = Instant::now();
                    }
                    heard.1 = silent;
                    silent > (0.25 * allowed).max(heard.0.elapsed().as_secs_f64())
                });
                tools.none_reads() || runs_away
            }
        };
        let event = if idle {
            door.events.recv_timeout(Duration::from_secs_f64(SLICE))
        } else {
            door.events.try_recv().map_err(|error| match error {
                TryRecvError::Empty => RecvTimeoutError::Timeout,
                TryRecvError::Disconnected => RecvTimeoutError::Disconnected,
            })
        };
        match event {
            Ok(Event::Connected(outgoing)) => {
                tools.holder = Some(outgoing);
                heard = (Instant::now(), 0.0);
            }
            Ok(Event::Bytes(bytes)) => board.receive(&bytes),
            Ok(Event::Gone) => {
                tools.holder = None;
                tools.waiting = None;
                board.hang_up();
            }
            Ok(Event::Disarm(request, answers)) => {
                // Ends whatever the holder was in the middle of.
                board.receive(&[0]);
                board.receive(&request);
                tools.guests.push((answers, Instant::now()));
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return,
        }
        if !idle {
            if pace == Pace::RealTime && behind > CATCH_UP {
                skipped += behind - CATCH_UP;
            }
            board.run(SLICE);
            ran += SLICE;
        }
        tools.pass_on(board);
    }
}

/// Who hears what the board says.
#[derive(Default)]
struct Tools {
    holder: Option<Outgoing>,
    /// A block that the holder has not taken yet.
    waiting: Option<Vec<u8>>,
    /// Tools that disarmed past the holder, and since when they listen.
    guests: Vec<(Outgoing, Instant)>,
}

impl Tools {
    fn none_reads(&self) -> bool {
        self.guests.is_empty() && (self.holder.is_none() || self.waiting.is_some())
    }

    /// Hands the tools what the board has for them, as far as the holder takes it. While a guest listens nothing waits
    /// for a holder that does not read.
    fn pass_on(&mut self, board: &mut impl Hosted) {
        self.guests.retain(|(_, since)| since.elapsed() < DISARM_ANSWER);
        while self.holder.is_some() || !self.guests.is_empty() {
            let block = self.waiting.take().unwrap_or_else(|| {
                let mut block = vec![0; BLOCK];
                let count = board.take_bytes(&mut block);
                block.truncate(count);
                for (guest, _) in &self.guests {
                    let _ = guest.try_send(block.clone());
                }
                block
            });
            if block.is_empty() {
                return;
            }
            let Some(holder) = &self.holder else { continue };
            match holder.try_send(block) {
                Ok(()) => {}
                Err(TrySendError::Full(_)) if !self.guests.is_empty() => {}
                Err(TrySendError::Full(block)) => {
                    self.waiting = Some(block);
                    return;
                }
                // The reading side will say that the tool is gone.
                Err(TrySendError::Disconnected(_)) => self.holder = None,
            }
        }
    }
}
