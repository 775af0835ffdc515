//! Where tools come in to a board that is served: a pseudo-terminal or a TCP address.
//!
//! A second tool on TCP is told that the board is taken; on a pseudo-terminal a lock tells it. One that has held the board
//! in silence gives way to it, and a request to disarm gets through in any case.

use crate::link::{Deframer, Occupied, encode};
use haptic_bridge::board::protocol::Disarm;
use postcard_rpc::Endpoint as _;
use postcard_rpc::Topic;
use postcard_rpc::header::{VarHeader, VarKey, VarSeq};
use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// What comes in through a door.
pub(super) enum Event {
    Connected(Outgoing),
    Bytes(Vec<u8>),
    Gone,
    /// A tool that found the board taken asks it to disarm: its request, and the way back.
    Disarm(Vec<u8>, Outgoing),
}

/// Bytes to the tool, carried by a thread of their own so that a tool that does not read stops nobody.
pub(super) type Outgoing = SyncSender<Vec<u8>>;

/// Blocks of bytes under way to the tool.
const BLOCKS: usize = 8;
/// Bytes in a block.
pub(super) const BLOCK: usize = 4096;
/// Blocks from a tool that wait for the board.
const EVENTS: usize = 16;
/// Connections that are looked at while one holds the board; more are closed at once.
const KNOCKING: usize = 16;
/// How long a tool may hold the board without a byte when another one asks for it: ours say something twenty times
/// a second while they listen.
const SILENCE: Duration = Duration::from_secs(3);
/// How long a second tool waits for the first one to leave: one command after another is not two at once.
const HANDOVER: Duration = Duration::from_millis(500);
/// How long a tool that disarms past another one hears what the board says.
pub(super) const DISARM_ANSWER: Duration = Duration::from_secs(1);
/// A door that tools come through.
pub struct ToolListener {
    /// What a tool writes after `--port`.
    pub port: String,
    pub(super) events: Receiver<Event>,
}

/// Opens a pseudo-terminal.
#[cfg(unix)]
pub fn pseudo_terminal() -> io::Result<ToolListener> {
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
    Ok(ToolListener { port, events })
}

/// Listens on a TCP address; port 0 takes any that is free. Only this computer is let in unless the address says more.
pub fn tcp(address: SocketAddr) -> io::Result<ToolListener> {
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
                    carry(stream, &send, &holder, seat);
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
    Ok(ToolListener { port, events })
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
fn carry(mut stream: TcpStream, send: &SyncSender<Event>, holder: &Holder, seat: u64) {
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
