//! Where tools come in to a board that is served: a pseudo-terminal or a TCP address.
//!
//! A second tool on TCP is told that the board is taken; on a pseudo-terminal a lock tells it. One that has held the
//! board in silence gives way to it, and a request to disarm gets through in any case.

use crate::link::{Deframer, Occupied, encode, nothing_yet};
use haptic_bridge::board::protocol::Disarm;
use postcard_rpc::Endpoint as _;
use postcard_rpc::Topic;
use postcard_rpc::header::{VarHeader, VarKey, VarSeq};
use std::io::{self, Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// An event at a door.
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
/// Connections that are looked at while one holds the board; for more the oldest that says nothing is closed.
const KNOCKING: usize = 16;
/// How long a connection that is turned away may take to say what it wants. One that says nothing keeps no other out.
const REQUEST: Duration = Duration::from_secs(10);
/// How long a tool that disarms past another one hears what the board says.
pub(super) const DISARM_ANSWER: Duration = Duration::from_secs(1);

/// How long tools are waited for at a TCP door.
#[derive(Clone, Copy, Debug)]
pub struct Patience {
    /// How long a tool may hold the board without a byte when another one asks for it: ours say something twenty times
    /// a second while they listen.
    pub silence: Duration,
    /// How long a second tool waits for the first one to leave: one command after another is not two at once.
    pub handover: Duration,
}

impl Default for Patience {
    fn default() -> Self {
        Self { silence: Duration::from_secs(3), handover: Duration::from_millis(500) }
    }
}

/// A door that tools come through.
pub struct ToolListener {
    /// The word that a tool writes after `--port`.
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
    // One for all tools: it outlasts them, because a tool that comes right after another may come unnoticed.
    let writer = outgoing(master.try_clone_native()?, Lost::Block);
    let (send, events) = sync_channel(EVENTS);
    thread::spawn(move || {
        let mut connected = false;
        let mut buffer = [0; BLOCK];
        loop {
            match master.read(&mut buffer) {
                Ok(count) if count > 0 => {
                    if !connected {
                        connected = true;
                        if send.send(Event::Connected(writer.clone())).is_err() {
                            return;
                        }
                    }
                    if send.send(Event::Bytes(buffer[..count].to_vec())).is_err() {
                        return;
                    }
                }
                Err(error) if nothing_yet(&error) => {}
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
pub fn tcp(address: SocketAddr, patience: Patience) -> io::Result<ToolListener> {
    let listener = TcpListener::bind(address)?;
    let port = format!("tcp:{}", listener.local_addr()?);
    let (send, events) = sync_channel(EVENTS);
    thread::spawn(move || {
        let holder = Holder::default();
        let knocking = Knocking::default();
        for stream in listener.incoming() {
            let Ok(stream) = stream else { continue };
            let Some(seat) = knocking.enters(&stream) else { continue };
            let (send, holder, knocking) = (send.clone(), holder.clone(), knocking.clone());
            thread::spawn(move || {
                if holder.admits(&stream, seat, &knocking, patience) {
                    knocking.leaves(seat);
                    carry(stream, &send, &holder, seat);
                } else {
                    let request = turn_away(&stream);
                    knocking.leaves(seat);
                    if let Some(request) = request {
                        let _ = disarm_for(stream, request, &send);
                    }
                }
            });
        }
    });
    Ok(ToolListener { port, events })
}

/// The connections that are looked at, oldest first.
#[derive(Clone, Default)]
struct Knocking(Arc<Mutex<Vec<Knock>>>);

struct Knock {
    seat: u64,
    stream: TcpStream,
    /// A tool speaks at once; what does not keeps no tool out.
    spoke: bool,
}

impl Knocking {
    fn lock(&self) -> MutexGuard<'_, Vec<Knock>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A number for the connection that no other has, none when there is no room because all speak.
    fn enters(&self, stream: &TcpStream) -> Option<u64> {
        static SEATS: AtomicU64 = AtomicU64::new(0);
        let mut knocks = self.lock();
        if knocks.len() >= KNOCKING {
            let silent = knocks.iter().position(|knock| !knock.spoke)?;
            let _ = knocks.remove(silent).stream.shutdown(Shutdown::Both);
        }
        let (seat, stream) = (SEATS.fetch_add(1, Ordering::SeqCst), stream.try_clone().ok()?);
        knocks.push(Knock { seat, stream, spoke: false });
        Some(seat)
    }

    /// Waits for a first byte of a connection, for 10 ms, and says whether there is one; none when it is closed.
    fn hears(&self, stream: &TcpStream, seat: u64) -> Option<bool> {
        let pause = Duration::from_millis(10);
        let _ = stream.set_read_timeout(Some(pause));
        match stream.peek(&mut [0]) {
            Ok(0) => None,
            Ok(_) => {
                let mut knocks = self.lock();
                knocks.iter_mut().filter(|knock| knock.seat == seat).for_each(|knock| knock.spoke = true);
                drop(knocks);
                thread::sleep(pause);
                Some(true)
            }
            Err(error) => nothing_yet(&error).then_some(false),
        }
    }

    fn leaves(&self, seat: u64) {
        self.lock().retain(|knock| knock.seat != seat);
    }
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

    /// Gives the board to this connection if it becomes free in time; one that says something gets it as well where it
    /// is held in silence.
    fn admits(&self, stream: &TcpStream, seat: u64, knocking: &Knocking, patience: Patience) -> bool {
        let began = Instant::now();
        let mut spoke = false;
        loop {
            {
                let mut held = self.lock();
                match &*held {
                    None => {
                        let _ = stream.set_read_timeout(None);
                        let Ok(stream) = stream.try_clone() else { return false };
                        *held = Some(Held { seat, stream, heard: Instant::now() });
                        return true;
                    }
                    // Its reading thread sees the end, and frees the board.
                    Some(silent) if spoke && silent.heard.elapsed() > patience.silence => {
                        let _ = silent.stream.shutdown(Shutdown::Both);
                    }
                    Some(_) => {}
                }
            }
            match knocking.hears(stream, seat) {
                Some(heard) if began.elapsed() <= patience.handover => spoke = heard,
                _ => return false,
            }
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
    Ok(outgoing(writer, Lost::Sink))
}

/// Hears what a second tool wants: `Some` request when it is to disarm, which gets through; else it is told that the
/// board is taken. What it sends is read first: unread, it would make the system throw away what was written.
pub fn turn_away(stream: &TcpStream) -> Option<Vec<u8>> {
    let _ = stream.set_read_timeout(Some(REQUEST));
    let mut disarm = None;
    let mut deframer = Deframer::default();
    let mut buffer = [0; BLOCK];
    let mut reader = stream;
    let began = Instant::now();
    let mut asked = false;
    while !asked && began.elapsed() < REQUEST {
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
        let _ = stream.shutdown(Shutdown::Write);
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

/// What is lost where a sink refuses a block: the block alone, or the sink for good.
#[derive(Clone, Copy, PartialEq)]
enum Lost {
    Block,
    Sink,
}

/// A thread that writes blocks to `sink` until the sender is dropped or the sink is lost.
fn outgoing(mut sink: impl Write + Send + 'static, lost: Lost) -> Outgoing {
    let (send, blocks) = sync_channel::<Vec<u8>>(BLOCKS);
    thread::spawn(move || {
        for block in blocks {
            let mut rest = block.as_slice();
            while !rest.is_empty() {
                match sink.write(rest) {
                    Ok(count @ 1..) => rest = &rest[count..],
                    Err(error) if nothing_yet(&error) => {}
                    _ if lost == Lost::Block => break,
                    _ => return,
                }
            }
        }
    });
    send
}
