//! A board as a Haply device: JSON over WebSocket as in Haply's inverse service (`haptic serve`, docs/haply.md).
//!
//! The exchange is lock-step, as in Haply's service: the server sends a frame with the full state, then one frame of
//! the state for each message of the program.
//!
//! Coordinates are Haply's: x to the operator's right, y away from the operator, z up, the origin at the device's base.

mod inverse3;
mod request;

pub use inverse3::Inverse3;
pub use request::{Basis, ProgramRequest};

use haptic_host::link::{BoardError, should_retry};
use haptic_host::places::{Place, Places};
use serde_json::{Value, json};
use std::fmt::Display;
use std::io::{self, Write};
use std::net::{IpAddr, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};
use tungstenite::handshake::server::{Request, create_response, write_response};
use tungstenite::protocol::frame::coding::CloseCode;
use tungstenite::protocol::{CloseFrame, Role, WebSocketConfig};
use tungstenite::{Message, WebSocket};

/// Default port of the service.
pub const DEFAULT_PORT: u16 = 10_001;

const MAX_MESSAGE_BYTES: usize = 256 * 1024;
/// Maximum number of connections whose handshake is not complete.
const MAX_HANDSHAKES: usize = 32;
/// Time for which a connection is read before the server checks if it should stop.
const READ_TIMEOUT: Duration = Duration::from_millis(20);
/// Maximum time for which a reply may stay unread, and for which a new program waits until a silent program has left.
const SEND_TIMEOUT: Duration = Duration::from_secs(2);
/// Interval between polls of an unused board, because a simulated board drops a silent tool if another one connects.
/// Also the interval between attempts to open a lost board, so that other tools can connect.
const POLL_INTERVAL: Duration = Duration::from_millis(500);
/// Time without a message after which a program loses the device to another program that requests it.
const MAX_SILENCE: Duration = Duration::from_secs(3);
/// Reply to programs while the board is lost.
const BOARD_LOST: &str = "the board is gone; it is opened again once it is back";

/// A port on which programs reach a board.
pub struct HaplyListener {
    listener: TcpListener,
    /// Token that a page in a browser must send, drawn at random.
    token: String,
    silence: Duration,
}

impl HaplyListener {
    /// Listens on a port of this computer; other computers cannot connect.
    pub fn open(port: u16) -> io::Result<Self> {
        let listener = TcpListener::bind(SocketAddr::from(([127, 0, 0, 1], port)))?;
        listener.set_nonblocking(true)?;
        Ok(Self { listener, token: crate::view::door::token()?, silence: MAX_SILENCE })
    }

    /// Sets the time without a message after which a program loses the device to another program that requests it.
    pub fn give_way_after(self, silence: Duration) -> Self {
        Self { silence, ..self }
    }

    /// Returns the address for programs.
    pub fn url(&self) -> io::Result<String> {
        Ok(format!("ws://localhost:{}", self.listener.local_addr()?.port()))
    }

    /// Returns the address for a page in a browser, with the token, because pages of any local server could connect.
    pub fn url_for_pages(&self) -> io::Result<String> {
        Ok(format!("{}/?token={}", self.url()?, self.token))
    }

    /// Serves a device until `stop`. One program at a time uses the device; any program on this computer may read its
    /// description. A lost board is reported, and `open` is called repeatedly until the board is back.
    pub fn serve<E: Display>(&self, device: Inverse3, open: impl Fn() -> Result<Inverse3, E>, stop: &AtomicBool) {
        let shared = Arc::new(Shared {
            device_slot: Mutex::new(DeviceSlot { device: Some(device), user: None }),
            is_over: AtomicBool::new(false),
            token: self.token.clone(),
            silence: self.silence,
        });
        let handshakes = Places::new(MAX_HANDSHAKES, MAX_HANDSHAKES);
        let (mut threads, mut failed) = (Vec::new(), None);
        while !stop.load(Ordering::Relaxed) {
            match self.listener.accept() {
                Ok((stream, _)) => {
                    let Some(place) = handshakes.enter(&stream) else { continue };
                    let shared = Arc::clone(&shared);
                    threads.push(thread::spawn(move || {
                        // A failed connection affects its own program only.
                        let _ = handle_connection(stream, place, &shared);
                    }));
                }
                Err(_) => thread::sleep(READ_TIMEOUT / 4),
            }
            threads.retain(|thread| !thread.is_finished());
            shared.refresh(&open, &mut failed);
        }
        shared.is_over.store(true, Ordering::Relaxed);
        for thread in threads {
            let _ = thread.join();
        }
    }
}

struct DeviceSlot {
    /// `None` while its board is lost.
    device: Option<Inverse3>,
    user: Option<DeviceUser>,
}

struct DeviceUser {
    last_message: Instant,
    /// Reason why the program must leave; `None` if it may stay.
    ejection: Option<&'static str>,
}

struct Shared {
    device_slot: Mutex<DeviceSlot>,
    is_over: AtomicBool,
    token: String,
    silence: Duration,
}

impl Shared {
    fn device_slot(&self) -> MutexGuard<'_, DeviceSlot> {
        self.device_slot.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the device's state after `work`; `None` while its board is lost.
    fn frame(&self, full: bool, work: impl FnOnce(&mut Inverse3) -> Result<(), BoardError>) -> Option<Value> {
        self.device_slot().apply(work).map(|device| device.frame(full))
    }

    /// Polls the board if no program has done so for a while, and reopens a lost board after its user has left, because
    /// a program must arm only the board that it has connected to.
    fn refresh<E: Display>(&self, open: impl Fn() -> Result<Inverse3, E>, failed: &mut Option<(Instant, String)>) {
        let mut device_slot = self.device_slot();
        if device_slot.device.as_ref().is_some_and(|device| device.idle_time() >= POLL_INTERVAL) {
            device_slot.apply(Inverse3::poll);
        }
        let is_soon = failed.as_ref().is_some_and(|(when, _)| when.elapsed() < POLL_INTERVAL);
        if device_slot.device.is_some() || device_slot.user.is_some() || is_soon {
            return;
        }
        drop(device_slot);
        let opened = open().map_err(|error| error.to_string());
        let previous = failed.take().map(|(_, why)| why);
        match opened {
            Ok(device) => {
                haptic_host::tell!("{} is back", device.id());
                self.device_slot().device = Some(device);
            }
            Err(why) => {
                if previous.as_ref() != Some(&why) {
                    haptic_host::tell!("{why}; trying again");
                }
                *failed = Some((Instant::now(), why));
            }
        }
    }

    /// Returns the reason why the program that uses the device must leave; `None` if it may stay.
    fn ejection(&self) -> Option<&'static str> {
        let shutdown = self.is_over.load(Ordering::Relaxed).then_some("the server ends");
        shutdown.or_else(|| self.device_slot().user.as_ref()?.ejection)
    }
}

impl DeviceSlot {
    /// Runs `work` on the device and returns the device. Returns `None` if the board is lost; the connection of the
    /// device's user then ends.
    fn apply(&mut self, work: impl FnOnce(&mut Inverse3) -> Result<(), BoardError>) -> Option<&Inverse3> {
        if let Err(lost) = work(self.device.as_mut()?) {
            haptic_host::tell!("{lost}; waiting for it");
            self.device = None;
            self.user.iter_mut().for_each(|user| user.ejection = Some(BOARD_LOST));
        }
        self.device.as_ref()
    }
}

/// The right to use the device, from the handshake until it is dropped, which turns the motors off.
struct DeviceUse<'s>(&'s Shared);

impl<'s> DeviceUse<'s> {
    /// Takes the device, also from a program that is silent or suspended. The error is the reason for a refusal.
    fn take(shared: &'s Shared) -> Result<Self, &'static str> {
        let began = Instant::now();
        loop {
            let mut device_slot = shared.device_slot();
            let DeviceSlot { device, user } = &mut *device_slot;
            match (device, &mut *user) {
                (None, _) => return Err(BOARD_LOST),
                (Some(device), None) => {
                    device.begin_session();
                    *user = Some(DeviceUser { last_message: Instant::now(), ejection: None });
                    return Ok(Self(shared));
                }
                (_, Some(user)) if user.last_message.elapsed() >= shared.silence && began.elapsed() < SEND_TIMEOUT => {
                    user.ejection = Some("another program requests the device, and this one was silent");
                }
                _ => return Err("another program uses the device"),
            }
            drop(device_slot);
            thread::sleep(READ_TIMEOUT / 4);
        }
    }

    fn note_message(&self) {
        self.0.device_slot().user.iter_mut().for_each(|user| user.last_message = Instant::now());
    }
}

impl Drop for DeviceUse<'_> {
    fn drop(&mut self) {
        let mut device_slot = self.0.device_slot();
        device_slot.device.iter_mut().for_each(Inverse3::release);
        device_slot.user = None;
    }
}

fn handle_connection(mut stream: TcpStream, place: Place, shared: &Shared) -> tungstenite::Result<()> {
    stream.set_nonblocking(false)?;
    stream.set_nodelay(true)?;
    stream.set_write_timeout(Some(SEND_TIMEOUT))?;
    let Some(request) = crate::view::door::read_request(&mut stream) else {
        return send_json(
            &mut stream,
            "400 Bad Request",
            &json!({"ok": false, "error": "not a request of this service"}),
        );
    };
    if !is_allowed(&request, &shared.token) {
        let error = "only for programs on this computer; a page needs the token that `haptic serve` printed";
        return send_json(&mut stream, "403 Forbidden", &json!({"ok": false, "error": error}));
    }
    drop(place);
    if let Ok(response) = create_response(&request) {
        let device_use = match DeviceUse::take(shared) {
            Ok(device_use) => device_use,
            Err(error) => {
                return send_json(&mut stream, "503 Service Unavailable", &json!({"ok": false, "error": error}));
            }
        };
        write_response(&mut stream, &response)?;
        return exchange_messages(stream, &device_use);
    }
    match request.uri().path() {
        "/devices" => {
            let Some(frame) = shared.frame(true, Inverse3::poll) else {
                let gone = json!({"ok": false, "error": BOARD_LOST});
                return send_json(&mut stream, "503 Service Unavailable", &gone);
            };
            send_json(&mut stream, "200 OK", &frame)
        }
        "/version" => {
            let version = concat!("haptic-bridge ", env!("CARGO_PKG_VERSION"));
            send_json(&mut stream, "200 OK", &json!({"version": version, "service_version": version}))
        }
        _ => send_json(&mut stream, "404 Not Found", &json!({"ok": false, "error": "not served by haptic-bridge"})),
    }
}

/// Returns true if a request is addressed to this computer and comes from a program, or from a page with the token. A
/// program sends no origin, or this server as origin; a page comes from any server on this computer.
fn is_allowed(request: &Request, token: &str) -> bool {
    let header = |name: &str| request.headers().get(name).and_then(|value| value.to_str().ok());
    let local = |authority: &str| {
        let name = authority.rsplit_once(':').map_or(authority, |(name, _)| name);
        name == "localhost" || name.trim_matches(['[', ']']).parse().is_ok_and(|ip: IpAddr| ip.is_loopback())
    };
    let host = header("host").unwrap_or_default();
    let has_token = crate::view::door::request_token(request) == Some(token);
    let allowed = |origin: &str| origin == host || has_token && local(origin);
    let origin = header("origin").is_none_or(|origin| origin.strip_prefix("http://").is_some_and(allowed));
    local(host) && origin
}

fn send_json(stream: &mut TcpStream, status: &str, document: &Value) -> tungstenite::Result<()> {
    let text = document.to_string();
    write!(
        stream,
        "HTTP/1.1 {status}\r\nContent-Type: application/json\r\nContent-Length: {}\r\nConnection: close\r\n\r\n{text}",
        text.len()
    )?;
    Ok(())
}

fn exchange_messages(stream: TcpStream, device_use: &DeviceUse<'_>) -> tungstenite::Result<()> {
    stream.set_read_timeout(Some(READ_TIMEOUT))?;
    let config =
        WebSocketConfig::default().max_message_size(Some(MAX_MESSAGE_BYTES)).max_frame_size(Some(MAX_MESSAGE_BYTES));
    let mut socket = WebSocket::from_raw_socket(stream, Role::Server, Some(config));
    let mut next = Some(ProgramRequest { full: true, ..ProgramRequest::default() });
    loop {
        if let Some(request) = next.take()
            && let Some(frame) = device_use.0.frame(request.full, |device| device.execute(&request))
        {
            socket.send(Message::text(frame.to_string()))?;
        }
        if let Some(why) = device_use.0.ejection() {
            return socket.close(Some(CloseFrame { code: CloseCode::Away, reason: why.into() }));
        }
        match socket.read() {
            // Accepts binary frames too, because Python's orjson produces bytes; replies are always text.
            Ok(message @ (Message::Text(_) | Message::Binary(_))) => {
                device_use.note_message();
                let mut device_slot = device_use.0.device_slot();
                let Some(device) = &mut device_slot.device else { continue };
                next = Some(ProgramRequest::parse(&message.into_data(), device.id()).unwrap_or_else(|error| {
                    device.notify(format!("invalid message: {error}"));
                    ProgramRequest::default()
                }));
            }
            Ok(Message::Close(_)) => return Ok(()),
            Ok(_) => {}
            Err(tungstenite::Error::Io(error)) if should_retry(&error) => {}
            Err(error) => return Err(error),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use haptic_host::link::{PortSpec, Session};
    use tungstenite::handshake::machine::TryParse;

    #[test]
    fn a_failed_handshake_frees_the_device() {
        let session = Session::of(haptic_sim::open(&PortSpec::Sim(None)).unwrap());
        let device = Inverse3::new(session, None, true).unwrap();
        let shared = Shared {
            device_slot: Mutex::new(DeviceSlot { device: Some(device), user: None }),
            is_over: AtomicBool::new(false),
            token: "abc".into(),
            silence: MAX_SILENCE,
        };
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let mut program = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        let head = "GET / HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
                    Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n";
        program.write_all(head.as_bytes()).unwrap();
        let (stream, _) = listener.accept().unwrap();
        // A program that resets its connection leaves it in this state: writing fails.
        stream.shutdown(std::net::Shutdown::Write).unwrap();
        let place = Places::new(1, 1).enter(&stream).unwrap();
        assert!(handle_connection(stream, place, &shared).is_err());
        assert!(shared.device_slot().user.is_none());
    }

    #[test]
    fn pages_need_the_token_and_programs_do_not() {
        let is_admitted = |query: &str, origin: &str| {
            let origin = if origin.is_empty() { String::new() } else { format!("Origin: {origin}\r\n") };
            let head = format!("GET /{query} HTTP/1.1\r\nHost: localhost:10001\r\n{origin}\r\n");
            is_allowed(&Request::try_parse(head.as_bytes()).unwrap().unwrap().1, "abc")
        };
        // Some libraries send the port that they connect to as origin; no page is served there.
        assert!(is_admitted("", "") && is_admitted("", "http://localhost:10001"));
        for page in ["http://localhost:3000", "http://localhost", "http://127.0.0.1:10001", "http://[::1]:80"] {
            assert!(
                is_admitted("?token=abc", page) && !is_admitted("", page) && !is_admitted("?token=abd", page),
                "{page}"
            );
        }
        for foreign in ["http://evil.example", "null", "https://localhost:3000", "file://"] {
            assert!(!is_admitted("?token=abc", foreign) && !is_admitted("", foreign), "{foreign}");
        }
    }
}
