//! The door through which tools reach a board that is served: a pseudo-terminal or a TCP address.
//!
//! A second tool on TCP is told that the board is taken; on a pseudo-terminal a lock tells it. One that has held the
//! board in silence gives way to it, and a request to disarm gets through in any case.

use haptic_bridge::board::protocol::Disarm;
use haptic_host::link::{Deframer, Occupied, encode, nothing_yet};
use haptic_host::places::{Place, Places};
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
}

/// A tool that found the board taken asks it to disarm: its request, and the way back. This has a queue of its own,
/// which is looked at first: what the holder says, and how much of it, keeps it waiting for no longer than one block.
pub(super) type Stop = (Vec<u8>, Outgoing);

/// Bytes to the tool, carried by a thread of their own so that a tool that does not read holds up nothing else.
pub(super) type Outgoing = SyncSender<Vec<u8>>;

/// Blocks of bytes under way to the tool.
const BLOCKS: usize = 8;
/// Bytes in a block.
pub(super) const BLOCK: usize = 4096;
/// Blocks from a tool that wait for the board.
const EVENTS: usize = 16;
/// Connections that are looked at while one holds the board; for more one is closed, see [`Places`].
const KNOCKING: usize = 16;
/// Requests to disarm that wait for the board.
pub(super) const STOPS: usize = KNOCKING;
/// Time for which a connection that is turned away may take to make its request. One that says nothing keeps no other
/// out.
const REQUEST: Duration = Duration::from_secs(10);
/// Time for which a tool that disarms past another one receives the board's answer.
pub(super) const DISARM_ANSWER: Duration = Duration::from_secs(1);

/// The times for which a TCP door waits for tools.
#[derive(Clone, Copy, Debug)]
pub struct Patience {
    /// Time for which a tool may hold the board without a byte when another one asks for it: ours say something twenty
    /// times a second while they listen.
    pub silence: Duration,
    /// Time for which a second tool waits for the first one to leave: one command after another is not two at once.
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
    pub(super) stops: Receiver<Stop>,
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
    // Who disarms past another tool opens the terminal beside it: its request comes among that one's bytes.
    let (_, stops) = sync_channel(STOPS);
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
    Ok(ToolListener { port, events, stops })
}

/// Listens on a TCP address; port 0 takes any that is free. Only this computer is let in unless the address says more.
pub fn tcp(address: SocketAddr, patience: Patience) -> io::Result<ToolListener> {
    let listener = TcpListener::bind(address)?;
    let port = format!("tcp:{}", listener.local_addr()?);
    let (send, events) = sync_channel(EVENTS);
    let (stop, stops) = sync_channel(STOPS);
    thread::spawn(move || {
        let holder = Holder::default();
        // Whom a tool on another computer comes from says nothing about it: there may be a relay between.
        let places = Places::new(KNOCKING, KNOCKING);
        for stream in listener.incoming() {
            let Ok(stream) = stream else { continue };
            let Some(place) = places.enter(&stream) else { continue };
            let (send, stop, holder) = (send.clone(), stop.clone(), holder.clone());
            thread::spawn(move || {
                let request = match holder.admits(&stream, &place, patience) {
                    Admission::Holds(seat) => {
                        drop(place);
                        return carry(stream, &send, &holder, seat);
                    }
                    Admission::Stops(request) => Some(request),
                    Admission::Refused => turn_away(&stream),
                };
                if let Some(request) = request {
                    let _ = disarm_for(stream, request, &stop);
                }
            });
        }
    });
    Ok(ToolListener { port, events, stops })
}

/// The bytes of a new connection so far, classified.
enum Heard {
    Nothing,
    /// Something, but no request to disarm.
    Something,
    /// That request.
    Disarm(Vec<u8>),
    /// It is closed.
    Gone,
}

/// Waits for the first bytes of a connection, for 10 ms, and leaves them unread.
fn hears(stream: &TcpStream, place: &Place) -> Heard {
    let pause = Duration::from_millis(10);
    let _ = stream.set_read_timeout(Some(pause));
    let mut bytes = [0; 64];
    match stream.peek(&mut bytes) {
        Ok(0) => Heard::Gone,
        Ok(count) => {
            place.spoke();
            if let Some(request) = disarm_in(&bytes[..count]) {
                return Heard::Disarm(request);
            }
            thread::sleep(pause);
            Heard::Something
        }
        Err(error) if nothing_yet(&error) => Heard::Nothing,
        Err(_) => Heard::Gone,
    }
}

/// The request to disarm, where that is the first that is asked for.
fn disarm_in(bytes: &[u8]) -> Option<Vec<u8>> {
    let mut first = None;
    Deframer::default().feed(bytes, |frame| first = first.take().or(Some(frame)));
    let asked = first.filter(|frame| frame.header.key == VarKey::Key8(Disarm::REQ_KEY))?;
    Some(encode(&asked.header, &asked.body))
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

/// The outcome of a connection's wish for the board.
enum Admission {
    /// It does, under this number.
    Holds(u64),
    /// It does not, and asks for the motors to go off.
    Stops(Vec<u8>),
    /// It does not.
    Refused,
}

impl Holder {
    fn lock(&self) -> MutexGuard<'_, Option<Held>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Gives the board to this connection if it becomes free in time; one that says something gets it as well where it
    /// is held in silence.
    fn admits(&self, stream: &TcpStream, place: &Place, patience: Patience) -> Admission {
        static SEATS: AtomicU64 = AtomicU64::new(0);
        let began = Instant::now();
        let mut spoke = false;
        loop {
            {
                let mut held = self.lock();
                match &*held {
                    None => {
                        let _ = stream.set_read_timeout(None);
                        let Ok(stream) = stream.try_clone() else { return Admission::Refused };
                        let seat = SEATS.fetch_add(1, Ordering::SeqCst);
                        *held = Some(Held { seat, stream, heard: Instant::now() });
                        return Admission::Holds(seat);
                    }
                    // Its reading thread sees the end, and frees the board.
                    Some(silent) if spoke && silent.heard.elapsed() > patience.silence => {
                        let _ = silent.stream.shutdown(Shutdown::Both);
                    }
                    Some(_) => {}
                }
            }
            match hears(stream, place) {
                Heard::Disarm(request) => return Admission::Stops(request),
                Heard::Gone => return Admission::Refused,
                _ if began.elapsed() > patience.handover => return Admission::Refused,
                Heard::Nothing => spoke = false,
                Heard::Something => spoke = true,
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
fn disarm_for(stream: TcpStream, request: Vec<u8>, stop: &SyncSender<Stop>) -> io::Result<()> {
    let answers = tcp_outgoing(&stream)?;
    let _ = stop.send((request, answers));
    stream.set_read_timeout(Some(DISARM_ANSWER))?;
    let mut reader = stream;
    // The request may still be unread: what follows it is the end.
    let (mut buffer, mut deframer, mut after) = ([0; BLOCK], Deframer::default(), 0);
    while after < 2 {
        let Ok(count @ 1..) = reader.read(&mut buffer) else { break };
        deframer.feed(&buffer[..count], |_| after += 1);
    }
    Ok(())
}

/// The loss when a sink refuses a block: the block alone, or the sink for good.
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
