//! A simulated board behind a port that other programs open: a pseudo-terminal or a TCP address.
//!
//! One thread runs the board and owns it; others only carry bytes. A second tool on TCP is told that the board is
//! taken; on a pseudo-terminal the operating system's lock tells it.

use super::board::SimulatedBoard;
use crate::link::{Occupied, encode};
use postcard_rpc::Topic;
use postcard_rpc::header::{VarHeader, VarKey, VarSeq};
use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{
    Receiver, RecvTimeoutError, Sender, SyncSender, TryRecvError, TrySendError, channel, sync_channel,
};
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
}

/// How simulated time passes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// With the wall clock; when the computer is too slow, later.
    RealTime,
    /// As fast as the computer can while a tool is connected and reads; no telemetry is dropped.
    AsFastAsItCan,
}

enum Event {
    Connected(Outgoing),
    Bytes(Vec<u8>),
    Gone,
}

/// Bytes to the tool, carried by a thread of their own so that a tool that does not read stops nobody.
type Outgoing = SyncSender<Vec<u8>>;

/// Blocks of bytes under way to the tool.
const BLOCKS: usize = 8;
/// Bytes in a block.
const BLOCK: usize = 4096;
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
    let (send, events) = channel();
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
    let (send, events) = channel();
    thread::spawn(move || {
        let taken = Arc::new(AtomicBool::new(false));
        for stream in listener.incoming() {
            let Ok(stream) = stream else { continue };
            if !becomes_free(&taken) {
                turn_away(stream);
            } else if admit(stream, &send, &taken).is_err() {
                taken.store(false, Ordering::SeqCst);
            }
        }
    });
    Ok(Door { port, events })
}

/// Takes the board, giving a tool that is about to leave a moment: one command after another is not two at once.
fn becomes_free(taken: &AtomicBool) -> bool {
    (0..50).any(|_| {
        let free = !taken.swap(true, Ordering::SeqCst);
        if !free {
            thread::sleep(Duration::from_millis(10));
        }
        free
    })
}

fn admit(mut stream: TcpStream, send: &Sender<Event>, taken: &Arc<AtomicBool>) -> io::Result<()> {
    stream.set_nodelay(true)?;
    let writer = stream.try_clone()?;
    writer.set_write_timeout(Some(Duration::from_millis(100)))?;
    let (send, taken) = (send.clone(), Arc::clone(taken));
    thread::spawn(move || {
        let mut buffer = [0; BLOCK];
        let mut alive = send.send(Event::Connected(outgoing(writer))).is_ok();
        while alive {
            alive = match stream.read(&mut buffer) {
                Ok(0) | Err(_) => false,
                Ok(count) => send.send(Event::Bytes(buffer[..count].to_vec())).is_ok(),
            };
        }
        let _ = send.send(Event::Gone);
        taken.store(false, Ordering::SeqCst);
    });
    Ok(())
}

/// Tells a second tool that the board is taken. It is given time to send its first request, whose bytes, unread, would
/// make the system throw away what was written.
pub fn turn_away(mut stream: TcpStream) {
    thread::spawn(move || {
        let header = VarHeader { key: VarKey::Key8(Occupied::TOPIC_KEY), seq_no: VarSeq::Seq2(0) };
        let _ = stream.set_read_timeout(Some(Duration::from_millis(500)));
        let _ = stream.write_all(&encode(&header, &[]));
        let _ = stream.shutdown(std::net::Shutdown::Write);
        let _ = io::copy(&mut stream, &mut io::sink());
    });
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
    let mut tool: Option<Outgoing> = None;
    let mut waiting: Option<Vec<u8>> = None;
    let began = Instant::now();
    let mut ran = 0.0;
    let mut skipped = 0.0;
    while !stop.load(Ordering::SeqCst) {
        let now = began.elapsed().as_secs_f64() - skipped;
        let behind = now - ran;
        let idle = match pace {
            Pace::RealTime => behind < SLICE,
            Pace::AsFastAsItCan => tool.is_none() || waiting.is_some(),
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
            Ok(Event::Connected(outgoing)) => tool = Some(outgoing),
            Ok(Event::Bytes(bytes)) => board.receive(&bytes),
            Ok(Event::Gone) => {
                tool = None;
                waiting = None;
                board.hang_up();
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
        pass_on(board, &mut tool, &mut waiting);
    }
}

/// Hands the tool what the board has for it, as far as the tool takes it.
fn pass_on(board: &mut impl Hosted, tool: &mut Option<Outgoing>, waiting: &mut Option<Vec<u8>>) {
    while let Some(outgoing) = tool {
        let block = waiting.take().unwrap_or_else(|| {
            let mut block = vec![0; BLOCK];
            let count = board.take_bytes(&mut block);
            block.truncate(count);
            block
        });
        if block.is_empty() {
            return;
        }
        match outgoing.try_send(block) {
            Ok(()) => {}
            Err(TrySendError::Full(block)) => {
                *waiting = Some(block);
                return;
            }
            // The reading side will say that the tool is gone.
            Err(TrySendError::Disconnected(_)) => *tool = None,
        }
    }
}
