//! The ports of a served board: a pseudo-terminal or a TCP address.
//!
//! While a tool holds the board, a TCP port replies to a second tool that the board is occupied, and a lock refuses the
//! second tool on a pseudo-terminal. A silent holder loses the board to a second tool. A request to disarm is always
//! carried out.

use haptic_bridge::board::protocol::Disarm;
use haptic_host::link::{Deframer, OccupiedTopic, encode, should_retry};
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

pub(super) enum Event {
    Connected(OutgoingBlocks),
    Bytes(Vec<u8>),
    Gone,
}

/// A request to disarm from a tool that does not hold the board, and the queue for the reply. The queue of these
/// requests is polled first, so that the holder's traffic delays a request by at most one block.
pub(super) type DisarmRequest = (Vec<u8>, OutgoingBlocks);

/// Queue of blocks of bytes to a tool. A separate thread writes the blocks, so that a tool that does not read blocks no
/// other tool.
pub(super) type OutgoingBlocks = SyncSender<Vec<u8>>;

/// Maximum number of blocks in the queue to a tool.
const MAX_BLOCKS: usize = 8;
/// Size of a block, bytes.
pub(super) const BLOCK_BYTES: usize = 4096;
/// Maximum number of events in the queue to the board.
const MAX_EVENTS: usize = 16;
/// Maximum number of connections in addition to the holder. A further connection closes another, see [`Places`].
const MAX_PENDING_CONNECTIONS: usize = 16;
/// Maximum number of disarm requests that wait for the board.
pub(super) const MAX_DISARM_REQUESTS: usize = MAX_PENDING_CONNECTIONS;
/// Longest wait for the request of a refused connection.
const REQUEST_TIMEOUT: Duration = Duration::from_secs(10);
/// Time for which a tool that disarms the board without holding it receives the board's bytes.
pub(super) const DISARM_REPLY_TIME: Duration = Duration::from_secs(1);

/// Waiting times of a TCP port.
#[derive(Clone, Copy, Debug)]
pub struct Patience {
    /// Silence after which a holder loses the board to another tool. This project's tools send a heartbeat every 50 ms.
    pub silence: Duration,
    /// Time for which a second tool waits for the holder to disconnect, because one command may follow another quickly.
    pub handover: Duration,
}

impl Default for Patience {
    fn default() -> Self {
        Self { silence: Duration::from_secs(3), handover: Duration::from_millis(500) }
    }
}

/// A port that tools connect to.
pub struct ToolListener {
    /// The port's name for `--port`.
    pub port: String,
    pub(super) events: Receiver<Event>,
    pub(super) stops: Receiver<DisarmRequest>,
}

/// Opens a pseudo-terminal.
#[cfg(unix)]
pub fn pseudo_terminal() -> io::Result<ToolListener> {
    use serialport::{SerialPort, TTYPort};
    let (mut master, slave) = TTYPort::pair()?;
    let port = slave.name().unwrap_or_default();
    // After this drop, reads fail while no tool is connected, which detects a hang-up.
    drop(slave);
    master.set_timeout(Duration::from_millis(100))?;
    // Uses one writer for all tools, because a quick change of tools is not always detected.
    let writer = start_writer(master.try_clone_native()?, LossPolicy::Block);
    let (send, events) = sync_channel(MAX_EVENTS);
    // The queue stays empty, because the request of a disarming tool comes among the holder's bytes.
    let (_, stops) = sync_channel(MAX_DISARM_REQUESTS);
    thread::spawn(move || {
        let mut connected = false;
        let mut buffer = [0; BLOCK_BYTES];
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
                Err(error) if should_retry(&error) => {}
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

/// Listens on a TCP address; port 0 chooses a free port. Only this computer can connect unless the address allows more.
pub fn tcp(address: SocketAddr, patience: Patience) -> io::Result<ToolListener> {
    let listener = TcpListener::bind(address)?;
    let port = format!("tcp:{}", listener.local_addr()?);
    let (send, events) = sync_channel(MAX_EVENTS);
    let (stop, stops) = sync_channel(MAX_DISARM_REQUESTS);
    thread::spawn(move || {
        let holder = Holder::default();
        // One address may take all places, because several tools may connect through one relay.
        let places = Places::new(MAX_PENDING_CONNECTIONS, MAX_PENDING_CONNECTIONS);
        for stream in listener.incoming() {
            let Ok(stream) = stream else { continue };
            let Some(place) = places.enter(&stream) else { continue };
            let (send, stop, holder) = (send.clone(), stop.clone(), holder.clone());
            thread::spawn(move || {
                let request = match holder.admit(&stream, &place, patience) {
                    Admission::Holds(seat) => {
                        drop(place);
                        return forward(stream, &send, &holder, seat);
                    }
                    Admission::Stops(request) => Some(request),
                    Admission::Refused => turn_away(&stream),
                };
                if let Some(request) = request {
                    let _ = disarm_and_reply(stream, request, &stop);
                }
            });
        }
    });
    Ok(ToolListener { port, events, stops })
}

enum FirstBytes {
    Nothing,
    /// Bytes other than a request to disarm.
    Other,
    /// A request to disarm.
    Disarm(Vec<u8>),
    /// The connection is closed.
    Gone,
}

/// Waits 10 ms for the first bytes of a connection, without consuming them.
fn wait_for_first_bytes(stream: &TcpStream, place: &Place) -> FirstBytes {
    let pause = Duration::from_millis(10);
    let _ = stream.set_read_timeout(Some(pause));
    let mut bytes = [0; 64];
    match stream.peek(&mut bytes) {
        Ok(0) => FirstBytes::Gone,
        Ok(count) => {
            place.mark_active();
            if let Some(request) = disarm_request(&bytes[..count]) {
                return FirstBytes::Disarm(request);
            }
            thread::sleep(pause);
            FirstBytes::Other
        }
        Err(error) if should_retry(&error) => FirstBytes::Nothing,
        Err(_) => FirstBytes::Gone,
    }
}

/// Returns the first request, encoded again, if it is a request to disarm.
fn disarm_request(bytes: &[u8]) -> Option<Vec<u8>> {
    let mut first = None;
    Deframer::default().feed(bytes, |frame| first = first.take().or(Some(frame)));
    let request = first.filter(|frame| frame.header.key == VarKey::Key8(Disarm::REQ_KEY))?;
    Some(encode(&request.header, &request.body))
}

/// The connection that holds the board.
#[derive(Clone, Default)]
struct Holder(Arc<Mutex<Option<Connection>>>);

struct Connection {
    /// Number of this connection among all holders.
    seat: u64,
    stream: TcpStream,
    last_received: Instant,
}

/// The result of a connection's request for the board.
enum Admission {
    /// The connection holds the board under this number.
    Holds(u64),
    /// The connection only requests to disarm.
    Stops(Vec<u8>),
    /// The connection is refused.
    Refused,
}

impl Holder {
    fn lock(&self) -> MutexGuard<'_, Option<Connection>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
    /// Gives the board to this connection if the board becomes free in time. A connection that sends bytes also takes
    /// the board of a silent holder.
    fn admit(&self, stream: &TcpStream, place: &Place, patience: Patience) -> Admission {
        static NEXT_SEAT: AtomicU64 = AtomicU64::new(0);
        let began = Instant::now();
        let mut is_active = false;
        loop {
            {
                let mut holder = self.lock();
                match &*holder {
                    None => {
                        let _ = stream.set_read_timeout(None);
                        let Ok(stream) = stream.try_clone() else { return Admission::Refused };
                        let seat = NEXT_SEAT.fetch_add(1, Ordering::SeqCst);
                        *holder = Some(Connection { seat, stream, last_received: Instant::now() });
                        return Admission::Holds(seat);
                    }
                    // The reading thread of the holder detects the shutdown and frees the board.
                    Some(connection) if is_active && connection.last_received.elapsed() > patience.silence => {
                        let _ = connection.stream.shutdown(Shutdown::Both);
                    }
                    Some(_) => {}
                }
            }
            match wait_for_first_bytes(stream, place) {
                FirstBytes::Disarm(request) => return Admission::Stops(request),
                FirstBytes::Gone => return Admission::Refused,
                _ if began.elapsed() > patience.handover => return Admission::Refused,
                FirstBytes::Nothing => is_active = false,
                FirstBytes::Other => is_active = true,
            }
        }
    }

    fn mark_received(&self, seat: u64) {
        if let Some(holder) = self.lock().as_mut().filter(|holder| holder.seat == seat) {
            holder.last_received = Instant::now();
        }
    }

    fn release(&self, seat: u64) {
        self.lock().take_if(|holder| holder.seat == seat);
    }
}

/// Forwards the bytes of the connection that holds the board, until the connection ends.
fn forward(mut stream: TcpStream, send: &SyncSender<Event>, holder: &Holder, seat: u64) {
    let outgoing = start_tcp_writer(&stream);
    let mut alive = outgoing.is_ok_and(|outgoing| send.send(Event::Connected(outgoing)).is_ok());
    let mut buffer = [0; BLOCK_BYTES];
    while alive {
        alive = match stream.read(&mut buffer) {
            Ok(0) | Err(_) => false,
            Ok(count) => {
                holder.mark_received(seat);
                send.send(Event::Bytes(buffer[..count].to_vec())).is_ok()
            }
        };
    }
    let _ = send.send(Event::Gone);
    holder.release(seat);
}

fn start_tcp_writer(stream: &TcpStream) -> io::Result<OutgoingBlocks> {
    stream.set_nodelay(true)?;
    let writer = stream.try_clone()?;
    writer.set_write_timeout(Some(Duration::from_millis(100)))?;
    Ok(start_writer(writer, LossPolicy::Sink))
}

/// Reads the first request of a second tool. Returns a request to disarm; otherwise replies that the board is occupied.
/// Reads before it replies, because closing a socket with unread bytes would discard the reply.
pub fn turn_away(stream: &TcpStream) -> Option<Vec<u8>> {
    let _ = stream.set_read_timeout(Some(REQUEST_TIMEOUT));
    let mut disarm = None;
    let mut deframer = Deframer::default();
    let mut buffer = [0; BLOCK_BYTES];
    let mut reader = stream;
    let began = Instant::now();
    let mut is_complete = false;
    while !is_complete && began.elapsed() < REQUEST_TIMEOUT {
        let Ok(count @ 1..) = reader.read(&mut buffer) else { break };
        deframer.feed(&buffer[..count], |frame| {
            is_complete = true;
            if frame.header.key == VarKey::Key8(Disarm::REQ_KEY) {
                disarm = Some(encode(&frame.header, &frame.body));
            }
        });
    }
    if disarm.is_none() {
        let header = VarHeader { key: VarKey::Key8(OccupiedTopic::TOPIC_KEY), seq_no: VarSeq::Seq2(0) };
        let mut writer = stream;
        let _ = writer.write_all(&encode(&header, &[]));
        let _ = stream.shutdown(Shutdown::Write);
        let _ = reader.read(&mut buffer);
    }
    disarm
}

/// Disarms the board for a tool that does not hold the board, and sends the reply to the tool.
fn disarm_and_reply(stream: TcpStream, request: Vec<u8>, stop: &SyncSender<DisarmRequest>) -> io::Result<()> {
    let answers = start_tcp_writer(&stream)?;
    let _ = stop.send((request, answers));
    stream.set_read_timeout(Some(DISARM_REPLY_TIME))?;
    let mut reader = stream;
    // The first frame is the unread request; a second frame shows that the tool has received the reply.
    let (mut buffer, mut deframer, mut after) = ([0; BLOCK_BYTES], Deframer::default(), 0);
    while after < 2 {
        let Ok(count @ 1..) = reader.read(&mut buffer) else { break };
        deframer.feed(&buffer[..count], |_| after += 1);
    }
    Ok(())
}

/// The reaction to a sink that refuses a block.
#[derive(Clone, Copy, PartialEq)]
enum LossPolicy {
    /// Drops the block.
    Block,
    /// Closes the sink.
    Sink,
}

/// Starts a thread that writes blocks to `sink` until the sender is dropped or the sink is closed.
fn start_writer(mut sink: impl Write + Send + 'static, loss_policy: LossPolicy) -> OutgoingBlocks {
    let (send, blocks) = sync_channel::<Vec<u8>>(MAX_BLOCKS);
    thread::spawn(move || {
        for block in blocks {
            let mut rest = block.as_slice();
            while !rest.is_empty() {
                match sink.write(rest) {
                    Ok(count @ 1..) => rest = &rest[count..],
                    Err(error) if should_retry(&error) => {}
                    _ if loss_policy == LossPolicy::Block => break,
                    _ => return,
                }
            }
        }
    });
    send
}
