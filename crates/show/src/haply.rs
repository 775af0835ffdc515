//! A board as a device of Haply's: the JSON over WebSocket that programs speak with Haply's inverse service
//! (`haptic serve --haply`, docs/haply.md).
//!
//! Lock-step, as the service does it: the first frame tells everything, and then each message of the program is
//! answered with one frame of how the device is.
//!
//! The frame is Haply's: x to the operator's right, y away from the operator, z up, the origin at the device's base.

mod inverse3;
mod wish;

pub use inverse3::Inverse3;
pub use wish::{Basis, Wish};

use haptic_host::link::{BoardError, nothing_yet};
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

/// Port at which programs look for the service.
pub const USUAL_PORT: u16 = 10_001;

/// Longest message of a program, bytes.
const MESSAGE: usize = 256 * 1024;
/// Connections at once that have not yet said what they want.
const HANDSHAKES: usize = 32;
/// Time for which a connection is listened to before the server checks if it should stop.
const LISTEN: Duration = Duration::from_millis(20);
/// Longest time for which an answer may be left unread, and for which a program waits for a silent one to leave.
const SEND: Duration = Duration::from_secs(2);
/// Time without an exchange after which the board is asked something, because a silent connection to a simulated board
/// gives way to another tool; and time between two tries to open a lost board, for other tools to come in between.
const TEND: Duration = Duration::from_millis(500);
/// Time without a message after which a program gives way to another one.
const SILENCE: Duration = Duration::from_secs(3);
/// The answer while the board is lost.
const GONE: &str = "the board is gone; it is opened again once it is back";

/// A port at which programs find a board.
pub struct HaplyListener {
    listener: TcpListener,
    /// The token that a page in a browser shows to be let in.
    token: String,
    silence: Duration,
}

impl HaplyListener {
    /// Listens at a port of this computer; other computers are not let in.
    pub fn open(port: u16) -> io::Result<Self> {
        let listener = TcpListener::bind(SocketAddr::from(([127, 0, 0, 1], port)))?;
        listener.set_nonblocking(true)?;
        Ok(Self { listener, token: crate::view::door::token()?, silence: SILENCE })
    }

    /// Changes the time without a message after which a program gives way to another one.
    pub fn give_way_after(self, silence: Duration) -> Self {
        Self { silence, ..self }
    }

    /// The address at which programs find it.
    pub fn url(&self) -> io::Result<String> {
        Ok(format!("ws://localhost:{}", self.listener.local_addr()?.port()))
    }

    /// The address at which a page in a browser on this computer finds it. Any other program that listens on this
    /// computer could send its pages here, so pages have to show a token, which each listener draws at random.
    pub fn url_for_pages(&self) -> io::Result<String> {
        Ok(format!("{}/?token={}", self.url()?, self.token))
    }

    /// Serves a device until `stop`. One program at a time uses the device; anybody on this computer may ask what it is.
    /// A board that is lost is told, and tried to `open` again.
    pub fn serve<E: Display>(&self, device: Inverse3, open: impl Fn() -> Result<Inverse3, E>, stop: &AtomicBool) {
        let shared = Arc::new(Shared {
            served: Mutex::new(Served { device: Some(device), user: None }),
            over: AtomicBool::new(false),
            token: self.token.clone(),
            silence: self.silence,
        });
        let handshakes = Places::new(HANDSHAKES, HANDSHAKES);
        let (mut threads, mut tried) = (Vec::new(), None);
        while !stop.load(Ordering::Relaxed) {
            match self.listener.accept() {
                Ok((stream, _)) => {
                    let Some(place) = handshakes.enter(&stream) else { continue };
                    let shared = Arc::clone(&shared);
                    threads.push(thread::spawn(move || {
                        // A connection that fails is its program's business.
                        let _ = greet(stream, place, &shared);
                    }));
                }
                Err(_) => thread::sleep(LISTEN / 4),
            }
            threads.retain(|thread| !thread.is_finished());
            shared.tend(&open, &mut tried);
        }
        shared.over.store(true, Ordering::Relaxed);
        for thread in threads {
            let _ = thread.join();
        }
    }
}

/// The device and the program that uses it.
struct Served {
    /// `None` while its board is lost.
    device: Option<Inverse3>,
    user: Option<User>,
}

/// A program that uses the device.
struct User {
    heard: Instant,
    /// Why it has to leave.
    leaves: Option<&'static str>,
}

/// State that the connections share.
struct Shared {
    served: Mutex<Served>,
    over: AtomicBool,
    token: String,
    silence: Duration,
}

impl Shared {
    fn served(&self) -> MutexGuard<'_, Served> {
        self.served.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The device's state after `work`; `None` while its board is lost.
    fn frame(&self, full: bool, work: impl FnOnce(&mut Inverse3) -> Result<(), BoardError>) -> Option<Value> {
        self.served().work(work).map(|device| device.frame(full))
    }

    /// Asks the board something where no program has for a while, and opens a lost one again once its user has left: a
    /// program arms only what it has connected to.
    fn tend<E: Display>(&self, open: impl Fn() -> Result<Inverse3, E>, tried: &mut Option<(Instant, String)>) {
        let mut served = self.served();
        if served.device.as_ref().is_some_and(|device| device.idle() >= TEND) {
            served.work(Inverse3::glance);
        }
        let soon = tried.as_ref().is_some_and(|(when, _)| when.elapsed() < TEND);
        if served.device.is_some() || served.user.is_some() || soon {
            return;
        }
        drop(served);
        let opened = open().map_err(|error| error.to_string());
        let before = tried.take().map(|(_, why)| why);
        match opened {
            Ok(device) => {
                haptic_host::tell!("{} is there again", device.id());
                self.served().device = Some(device);
            }
            Err(why) => {
                if before.as_ref() != Some(&why) {
                    haptic_host::tell!("{why}; trying again");
                }
                *tried = Some((Instant::now(), why));
            }
        }
    }

    /// Why the program that uses the device has to leave.
    fn leaves(&self) -> Option<&'static str> {
        let over = self.over.load(Ordering::Relaxed).then_some("the server ends");
        over.or_else(|| self.served().user.as_ref()?.leaves)
    }
}

impl Served {
    /// The device after `work`; `None` where its board is lost, which ends its user's connection.
    fn work(&mut self, work: impl FnOnce(&mut Inverse3) -> Result<(), BoardError>) -> Option<&Inverse3> {
        if let Err(lost) = work(self.device.as_mut()?) {
            haptic_host::tell!("{lost}; waiting for it");
            self.device = None;
            self.user.iter_mut().for_each(|user| user.leaves = Some(GONE));
        }
        self.device.as_ref()
    }
}

/// The device is a program's from its handshake until this is dropped, however the two end; the motors are off then.
struct Used<'s>(&'s Shared);

impl<'s> Used<'s> {
    /// Takes the device; a program that is silent gives way, also one that is suspended. The error is who has it.
    fn take(shared: &'s Shared) -> Result<Self, &'static str> {
        let began = Instant::now();
        loop {
            let mut served = shared.served();
            let Served { device, user } = &mut *served;
            match (device, &mut *user) {
                (None, _) => return Err(GONE),
                (Some(device), None) => {
                    device.begin();
                    *user = Some(User { heard: Instant::now(), leaves: None });
                    return Ok(Self(shared));
                }
                (_, Some(user)) if user.heard.elapsed() >= shared.silence && began.elapsed() < SEND => {
                    user.leaves = Some("another program asks for the device, and this one was silent");
                }
                _ => return Err("another program uses the device"),
            }
            drop(served);
            thread::sleep(LISTEN / 4);
        }
    }

    fn heard(&self) {
        self.0.served().user.iter_mut().for_each(|user| user.heard = Instant::now());
    }
}

impl Drop for Used<'_> {
    fn drop(&mut self) {
        let mut served = self.0.served();
        served.device.iter_mut().for_each(Inverse3::let_go);
        served.user = None;
    }
}

fn greet(mut stream: TcpStream, place: Place, shared: &Shared) -> tungstenite::Result<()> {
    stream.set_nonblocking(false)?;
    stream.set_nodelay(true)?;
    stream.set_write_timeout(Some(SEND))?;
    let Some(request) = crate::view::door::head(&mut stream) else {
        return answer(&mut stream, "400 Bad Request", &json!({"ok": false, "error": "not a request of this service"}));
    };
    if !from_here(&request, &shared.token) {
        let error = "only for programs on this computer; a page needs the token that `haptic serve` printed";
        return answer(&mut stream, "403 Forbidden", &json!({"ok": false, "error": error}));
    }
    drop(place);
    if let Ok(response) = create_response(&request) {
        let used = match Used::take(shared) {
            Ok(used) => used,
            Err(error) => {
                return answer(&mut stream, "503 Service Unavailable", &json!({"ok": false, "error": error}));
            }
        };
        write_response(&mut stream, &response)?;
        return converse(stream, &used);
    }
    match request.uri().path() {
        "/devices" => {
            let Some(frame) = shared.frame(true, Inverse3::glance) else {
                let gone = json!({"ok": false, "error": GONE});
                return answer(&mut stream, "503 Service Unavailable", &gone);
            };
            answer(&mut stream, "200 OK", &frame)
        }
        "/version" => {
            let version = concat!("haptic-bridge ", env!("CARGO_PKG_VERSION"));
            answer(&mut stream, "200 OK", &json!({"version": version, "service_version": version}))
        }
        _ => answer(&mut stream, "404 Not Found", &json!({"ok": false, "error": "not served by haptic-bridge"})),
    }
}

/// Returns true if a request names this computer and comes from a program, which names no origin or this very port, or
/// from a page of this computer that shows the token. A page is of this computer whichever program serves it here.
fn from_here(request: &Request, token: &str) -> bool {
    let header = |name: &str| request.headers().get(name).and_then(|value| value.to_str().ok());
    let local = |authority: &str| {
        let name = authority.rsplit_once(':').map_or(authority, |(name, _)| name);
        name == "localhost" || name.trim_matches(['[', ']']).parse().is_ok_and(|ip: IpAddr| ip.is_loopback())
    };
    let host = header("host").unwrap_or_default();
    let shown = crate::view::door::shown_token(request) == Some(token);
    let may = |origin: &str| origin == host || shown && local(origin);
    let origin = header("origin").is_none_or(|origin| origin.strip_prefix("http://").is_some_and(may));
    local(host) && origin
}

fn answer(stream: &mut TcpStream, status: &str, document: &Value) -> tungstenite::Result<()> {
    let text = document.to_string();
    write!(
        stream,
        "HTTP/1.1 {status}\r\nContent-Type: application/json\r\nContent-Length: {}\r\nConnection: close\r\n\r\n{text}",
        text.len()
    )?;
    Ok(())
}

fn converse(stream: TcpStream, used: &Used<'_>) -> tungstenite::Result<()> {
    stream.set_read_timeout(Some(LISTEN))?;
    let config = WebSocketConfig::default().max_message_size(Some(MESSAGE)).max_frame_size(Some(MESSAGE));
    let mut socket = WebSocket::from_raw_socket(stream, Role::Server, Some(config));
    let mut next = Some(Wish { full: true, ..Wish::default() });
    loop {
        if let Some(wish) = next.take()
            && let Some(frame) = used.0.frame(wish.full, |device| device.obey(&wish))
        {
            socket.send(Message::text(frame.to_string()))?;
        }
        if let Some(why) = used.0.leaves() {
            return socket.close(Some(CloseFrame { code: CloseCode::Away, reason: why.into() }));
        }
        match socket.read() {
            // Python's orjson makes bytes, which become binary frames; the service answers either with text.
            Ok(message @ (Message::Text(_) | Message::Binary(_))) => {
                used.heard();
                let mut served = used.0.served();
                let Some(device) = &mut served.device else { continue };
                next = Some(Wish::parse(&message.into_data(), device.id()).unwrap_or_else(|error| {
                    device.tell(format!("a message that makes no sense: {error}"));
                    Wish::default()
                }));
            }
            Ok(Message::Close(_)) => return Ok(()),
            Ok(_) => {}
            Err(tungstenite::Error::Io(error)) if nothing_yet(&error) => {}
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
    fn a_handshake_that_fails_leaves_the_device_to_the_next_program() {
        let session = Session::of(haptic_sim::open(&PortSpec::Sim(None)).unwrap());
        let device = Inverse3::new(session, None, true).unwrap();
        let shared = Shared {
            served: Mutex::new(Served { device: Some(device), user: None }),
            over: AtomicBool::new(false),
            token: "abc".into(),
            silence: SILENCE,
        };
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let mut program = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        let head = "GET / HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
                    Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n";
        program.write_all(head.as_bytes()).unwrap();
        let (stream, _) = listener.accept().unwrap();
        // A program that resets its connection leaves it like this: nothing can be written to it.
        stream.shutdown(std::net::Shutdown::Write).unwrap();
        let place = Places::new(1, 1).enter(&stream).unwrap();
        assert!(greet(stream, place, &shared).is_err());
        assert!(shared.served().user.is_none());
    }

    #[test]
    fn a_page_shows_the_token_wherever_on_this_computer_it_comes_from_and_a_program_does_not() {
        let let_in = |query: &str, origin: &str| {
            let origin = if origin.is_empty() { String::new() } else { format!("Origin: {origin}\r\n") };
            let head = format!("GET /{query} HTTP/1.1\r\nHost: localhost:10001\r\n{origin}\r\n");
            from_here(&Request::try_parse(head.as_bytes()).unwrap().unwrap().1, "abc")
        };
        // Some libraries name the port that they connect to; no page is served there.
        assert!(let_in("", "") && let_in("", "http://localhost:10001"));
        for page in ["http://localhost:3000", "http://localhost", "http://127.0.0.1:10001", "http://[::1]:80"] {
            assert!(let_in("?token=abc", page) && !let_in("", page) && !let_in("?token=abd", page), "{page}");
        }
        for elsewhere in ["http://evil.example", "null", "https://localhost:3000", "file://"] {
            assert!(!let_in("?token=abc", elsewhere) && !let_in("", elsewhere), "{elsewhere}");
        }
    }
}
