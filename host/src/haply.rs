//! A board as a device of Haply's: the JSON over WebSocket that programs speak with Haply's inverse service
//! (`haptic serve --haply`, docs/haply.md).
//!
//! Lock-step, as the service does it: the first frame tells everything, and then each message of the program is
//! answered with one frame of how the device is. Forces come in both of the service's spellings, `values` (3.1) and
//! `vector` (3.5).
//!
//! The frame is Haply's: x to the operator's right, y away from the operator, z up, the origin at the device's base.

use crate::frame::Axes;
use crate::link::{BoardError, Session, nothing_yet};
use crate::places::{Place, Places};
use haptic_bridge::board::protocol::{ForceAnswer, ForceDone};
use haptic_bridge::render::scene::Scene;
use haptic_bridge::safety::fault::State;
use haptic_bridge::safety::refusal::Refusal;
use serde_json::{Value, json};
use std::io::{self, Write};
use std::net::{IpAddr, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};
use tungstenite::handshake::server::{Request, create_response, write_response};
use tungstenite::protocol::{Role, WebSocketConfig};
use tungstenite::{Message, WebSocket};

/// Where programs look for the service.
pub const USUAL_PORT: u16 = 10_001;

/// The handle that programs ask for: it does not turn, and its buttons are not pressed.
const GRIP: &str = "HB00";
/// Longest message of a program, bytes.
const MESSAGE: usize = 256 * 1024;
/// Connections at once that have not yet said what they want.
const HANDSHAKES: usize = 32;
/// How long a connection is listened to before it is looked whether to stop.
const LISTEN: Duration = Duration::from_millis(20);
/// How long an answer may be left unread.
const SEND: Duration = Duration::from_secs(2);
/// Most simulated time that passes at once.
const MOST_AT_ONCE: Duration = Duration::from_millis(100);

/// What a program asks for with one message.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Wish {
    /// Force, N, in Haply's axes; `None` if there is none or it is marked as not to be executed.
    pub force: Option<[f64; 3]>,
    /// It asks for the full state once.
    pub full: bool,
    /// Commands that a board has nothing for.
    pub others: Vec<String>,
}

impl Wish {
    /// Reads a message for the device with this id; anything for other devices is ignored.
    pub fn parse(text: &str, id: &str) -> Result<Self, String> {
        let message: Value = serde_json::from_str(text).map_err(|error| format!("not JSON: {error}"))?;
        let mut wish = Self { full: !message["session"]["force_render_full_state"].is_null(), ..Self::default() };
        for device in message["inverse3"].as_array().into_iter().flatten().filter(|device| device["device_id"] == id) {
            for (name, command) in device["commands"].as_object().into_iter().flatten() {
                match name.as_str() {
                    "set_cursor_force" => {
                        let vector = if command["vector"].is_null() { &command["values"] } else { &command["vector"] };
                        let entry = |axis: &str| vector[axis].as_f64().filter(|newtons| newtons.is_finite());
                        let (Some(x), Some(y), Some(z)) = (entry("x"), entry("y"), entry("z")) else {
                            return Err("set_cursor_force without the numbers x, y and z in vector or values".into());
                        };
                        wish.force = (command["execute"] != false).then_some([x, y, z]);
                    }
                    "probe_position" => {}
                    other => wish.others.push(other.into()),
                }
            }
        }
        Ok(wish)
    }
}

/// A board that programs take for a device of Haply's.
pub struct Inverse3 {
    session: Session,
    axes: Axes,
    id: String,
    simulated: bool,
    looked: Instant,
    last: ForceAnswer,
    armed: bool,
    /// Whether the next force arms: the first of a program. Who turned the motors off meanwhile meant it.
    may_arm: bool,
    told: Vec<String>,
}

impl Inverse3 {
    /// Of a board that is open and has a device; a board without a scene gets free space. `axes` are CHAI3D's, as
    /// [`Axes::of`] knows them.
    pub fn new(mut session: Session, axes: Option<Axes>, simulated: bool) -> Result<Self, BoardError> {
        let device = session.device()?.ok_or(Refusal::NoDevice)?;
        let task = device.mechanism.kind().spec().task;
        if session.scene()?.is_none() {
            session.set_scene(&Scene { task: task as u8, ..Scene::default() })?;
        }
        let axes = axes.unwrap_or_else(|| Axes::of(device.mechanism.kind(), device.weight));
        let id = session.info().serial.to_string();
        let last = session.look()?;
        Ok(Self {
            session,
            axes,
            id,
            simulated,
            looked: Instant::now(),
            last,
            armed: false,
            may_arm: true,
            told: Vec::new(),
        })
    }

    /// The device's id in messages: the board's serial number.
    pub fn id(&self) -> &str {
        &self.id
    }

    /// Says something to whoever runs the server, once.
    fn tell(&mut self, words: String) {
        if !self.told.contains(&words) {
            crate::tell!("{words}");
            self.told.push(words);
        }
    }

    /// Does what a message asks for, and reads how the device is then.
    fn obey(&mut self, wish: &Wish) -> Result<(), BoardError> {
        for other in &wish.others {
            self.tell(format!("`{other}` is left alone: a board takes forces at the tip"));
        }
        if self.simulated {
            let passed = self.looked.elapsed().min(MOST_AT_ONCE);
            self.session.rows(passed)?;
        }
        self.looked = Instant::now();
        let Some(force) = wish.force else {
            self.last = self.session.look()?;
            return Ok(());
        };
        if !self.armed && self.may_arm {
            match self.session.arm() {
                Ok(()) => (self.armed, self.may_arm) = (true, false),
                Err(BoardError::Refused(refusal)) => self.tell(format!("the motors stay off: {refusal}")),
                Err(error) => return Err(error),
            }
        }
        let [right, away, up] = force;
        let force = self.axes.to_task([-away, right, up]);
        self.last = self.session.force(force.map(|newtons| newtons as f32))?;
        if let ForceDone::Bad(_) = self.last.done {
            self.tell(format!("a force of ({right:e}, {away:e}, {up:e}) N is {}", self.last.done));
        }
        if self.armed && self.last.state != State::Armed {
            self.armed = false;
            self.tell(
                "the motors are off, by the board or another tool (`haptic faults`); a program that connects anew arms them"
                    .into(),
            );
        }
        Ok(())
    }

    /// Motors off.
    fn let_go(&mut self) {
        (self.armed, self.may_arm) = (false, true);
        self.told.clear();
        let _ = self.session.disarm();
    }

    /// A frame; `full` with what does not change.
    fn frame(&self, full: bool) -> Value {
        let vector = |task: [f32; 3]| {
            let [toward, right, up] = self.axes.to_chai3d(task.map(f64::from));
            json!({"x": right, "y": 0.0 - toward, "z": up})
        };
        let angles = |radians: [f32; 3]| {
            let [a0, a1, a2] = radians.map(|angle| f64::from(angle).to_degrees());
            json!({"a0": a0, "a1": a1, "a2": a2})
        };
        let upright = json!({"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0});
        let zero = json!({"x": 0.0, "y": 0.0, "z": 0.0});
        let armed = self.last.state == State::Armed;
        let mut device = json!({
            "device_id": self.id,
            "state": {
                "cursor_position": vector(self.last.tip),
                "cursor_velocity": vector(self.last.velocity),
                "angular_position": angles(self.last.q),
                "angular_velocity": {"a0": 0.0, "a1": 0.0, "a2": 0.0},
                "body_orientation": upright,
                "current_cursor_force": vector(self.last.force),
                "mode": "idle",
                "control_domain": "cartesian",
                "control_mode": if armed { "force" } else { "idle" },
                "transform": {"position": zero, "rotation": upright, "scale": {"x": 1.0, "y": 1.0, "z": 1.0}},
            },
            "status": {
                "calibrated": true,
                "in_use": armed,
                "power_supply": true,
                "ready": self.last.state != State::Fault,
                "started": armed,
            },
        });
        let mut grip = json!({
            "device_id": GRIP,
            "state": {
                "battery_level": 1.0,
                "battery_voltage": 3.7,
                "buttons": {"a": false, "b": false, "c": false},
                "hall": 0,
                "orientation": upright,
            },
            "status": {"ready": true, "connected": true, "awake": true},
        });
        if full {
            device["config"] = json!({
                "id": self.id,
                "type": "inverse3",
                "device_info": {
                    "id": self.id, "major_version": 0, "minor_version": 1, "device_type": "inverse3", "uuid": self.id,
                },
                "port": self.session.port(),
                "extended_device_id": self.id,
                "extended_firmware_version": self.session.info().firmware.as_str(),
                "gravity_compensation": {"enabled": true, "scaling_factor": 1.0},
                "handedness": "right",
                "torque_scaling": {"enabled": false},
                "coordinate_origin": "device_base",
                "basis": {"permutation": "XYZ"},
                "streaming_mode": "USB",
            });
            grip["config"] = json!({
                "id": GRIP,
                "type": "wireless_verse_grip",
                "port": "",
                "major_version": 0,
                "minor_version": 0,
                "hardware_version": 0,
                "streaming_mode": "Radio",
                "basis": {"permutation": "XYZ"},
            });
        }
        json!({"session_id": 1, "inverse3": [device], "verse_grip": [], "wireless_verse_grip": [grip]})
    }
}

/// A port at which programs find a board.
pub struct HaplyListener {
    listener: TcpListener,
    /// What a page in a browser shows to be let in.
    token: String,
}

impl HaplyListener {
    /// Listens at a port of this computer; nobody else is let in.
    pub fn open(port: u16) -> io::Result<Self> {
        let listener = TcpListener::bind(SocketAddr::from(([127, 0, 0, 1], port)))?;
        listener.set_nonblocking(true)?;
        Ok(Self { listener, token: crate::view::door::token()? })
    }

    /// Where programs find it.
    pub fn url(&self) -> io::Result<String> {
        Ok(format!("ws://localhost:{}", self.listener.local_addr()?.port()))
    }

    /// Where a page in a browser on this computer finds it. Whatever else listens on this computer could send its pages
    /// here, so they show a token, drawn anew each time.
    pub fn url_for_pages(&self) -> io::Result<String> {
        Ok(format!("{}/?token={}", self.url()?, self.token))
    }

    /// Serves a device until `stop`, or until its board is gone, which is the error. One program at a time uses the
    /// device; anybody on this computer may ask what it is.
    pub fn serve(&self, device: Inverse3, stop: &AtomicBool) -> Result<(), BoardError> {
        let shared = Arc::new(Shared {
            device: Mutex::new(device),
            lost: Mutex::new(None),
            taken: AtomicBool::new(false),
            over: AtomicBool::new(false),
            token: self.token.clone(),
        });
        let handshakes = Places::new(HANDSHAKES, HANDSHAKES);
        let mut threads = Vec::new();
        let ended = loop {
            if let Some(lost) = shared.lost.lock().unwrap_or_else(PoisonError::into_inner).take() {
                break Err(lost);
            }
            if stop.load(Ordering::Relaxed) {
                break Ok(());
            }
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
        };
        shared.over.store(true, Ordering::Relaxed);
        for thread in threads {
            let _ = thread.join();
        }
        shared.device().let_go();
        ended
    }
}

/// What the connections share.
struct Shared {
    device: Mutex<Inverse3>,
    lost: Mutex<Option<BoardError>>,
    /// A program uses the device.
    taken: AtomicBool,
    over: AtomicBool,
    token: String,
}

impl Shared {
    fn device(&self) -> MutexGuard<'_, Inverse3> {
        self.device.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The device is a program's from its handshake until this is dropped, however the two end; the motors are off then.
struct Used<'s>(&'s Shared);

impl<'s> Used<'s> {
    fn take(shared: &'s Shared) -> Option<Self> {
        (!shared.taken.swap(true, Ordering::SeqCst)).then_some(Self(shared))
    }
}

impl Drop for Used<'_> {
    fn drop(&mut self) {
        self.0.device().let_go();
        self.0.taken.store(false, Ordering::SeqCst);
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
        let Some(_used) = Used::take(shared) else {
            let taken = json!({"ok": false, "error": "another program uses the device"});
            return answer(&mut stream, "503 Service Unavailable", &taken);
        };
        write_response(&mut stream, &response)?;
        return converse(stream, shared);
    }
    match request.uri().path() {
        "/devices" => {
            let frame = shared.device().frame(true);
            answer(&mut stream, "200 OK", &frame)
        }
        "/version" => {
            let version = concat!("haptic-bridge ", env!("CARGO_PKG_VERSION"));
            answer(&mut stream, "200 OK", &json!({"version": version, "service_version": version}))
        }
        _ => answer(&mut stream, "404 Not Found", &json!({"ok": false, "error": "not served by haptic-bridge"})),
    }
}

/// Whether a request names this computer and comes from a program, which names no origin or this very port, or from a
/// page of this computer that shows the token. Any page that some program serves on this computer is one of it.
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

fn converse(stream: TcpStream, shared: &Shared) -> tungstenite::Result<()> {
    stream.set_read_timeout(Some(LISTEN))?;
    let config = WebSocketConfig::default().max_message_size(Some(MESSAGE)).max_frame_size(Some(MESSAGE));
    let mut socket = WebSocket::from_raw_socket(stream, Role::Server, Some(config));
    let mut next = Some(Wish { full: true, ..Wish::default() });
    while !shared.over.load(Ordering::Relaxed) {
        if let Some(wish) = next.take() {
            let mut device = shared.device();
            if let Err(lost) = device.obey(&wish) {
                *shared.lost.lock().unwrap_or_else(PoisonError::into_inner) = Some(lost);
                return Ok(());
            }
            let frame = device.frame(wish.full);
            drop(device);
            socket.send(Message::text(frame.to_string()))?;
        }
        match socket.read() {
            Ok(Message::Text(text)) => {
                let mut device = shared.device();
                next = Some(Wish::parse(&text, device.id()).unwrap_or_else(|error| {
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
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::PortSpec;
    use tungstenite::handshake::machine::TryParse;

    #[test]
    fn a_handshake_that_fails_leaves_the_device_to_the_next_program() {
        let session = Session::open(&PortSpec::Sim(None)).unwrap();
        let shared = Shared {
            device: Mutex::new(Inverse3::new(session, None, true).unwrap()),
            lost: Mutex::new(None),
            taken: AtomicBool::new(false),
            over: AtomicBool::new(false),
            token: "abc".into(),
        };
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let mut program = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        let head = "GET / HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
                    Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n";
        program.write_all(head.as_bytes()).unwrap();
        let (stream, _) = listener.accept().unwrap();
        // What a program that resets its connection leaves: nothing can be written to it.
        stream.shutdown(std::net::Shutdown::Write).unwrap();
        let place = Places::new(1, 1).enter(&stream).unwrap();
        assert!(greet(stream, place, &shared).is_err());
        assert!(!shared.taken.load(Ordering::SeqCst));
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

    #[test]
    fn forces_are_read_in_both_spellings_and_only_for_this_device() {
        let wish = |commands: &str| {
            Wish::parse(
                &format!("{{\"session\":{{}},\"inverse3\":[{{\"device_id\":\"A\",\"commands\":{commands}}}]}}"),
                "A",
            )
        };
        let force = Some([1.0, -2.0, 0.5]);
        let vector = "{\"x\":1.0,\"y\":-2,\"z\":0.5}";
        assert_eq!(wish(&format!("{{\"set_cursor_force\":{{\"values\":{vector}}}}}")).unwrap().force, force);
        let new = format!("{{\"set_cursor_force\":{{\"vector\":{vector},\"execute\":true}}}}");
        assert_eq!(wish(&new).unwrap().force, force);
        assert_eq!(Wish::parse(&new.replace("set", "get"), "A"), Ok(Wish::default()));
        assert_eq!(wish(&new.replace("true", "false")).unwrap(), Wish::default());
        assert_eq!(wish("{\"probe_position\":{}}").unwrap(), Wish::default());
        assert_eq!(wish("{\"set_cursor_position\":{}}").unwrap().others, ["set_cursor_position"]);
        assert!(wish("{\"set_cursor_force\":{\"values\":{\"x\":1}}}").is_err());
        assert!(Wish::parse("{", "A").is_err());
        let other = format!("{{\"inverse3\":[{{\"device_id\":\"B\",\"commands\":{new}}}]}}");
        assert_eq!(Wish::parse(&other, "A"), Ok(Wish::default()));
        assert!(Wish::parse("{\"session\":{\"force_render_full_state\":{}}}", "A").unwrap().full);
    }
}
