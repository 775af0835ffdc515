//! `haptic serve --haply` as programs for Haply's service use it: one frame per message, with the keys that the
//! official client needs, and forces in both formats.

use crate::common::sim::{Sim, wait_until};
use crate::common::strict::{LossyWire, strict_board};
use crate::common::{Process, type_lines};
use haptic_bridge::safety::fault::{Fault, State};
use haptic_host::link::Session;
use haptic_show::haply::{HaplyListener, Inverse3};
use haptic_sim::SharedBoard;
use serde_json::{Value, json};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;
use tungstenite::stream::MaybeTlsStream;
use tungstenite::{Message, WebSocket};

/// Process of the server, which simulates a board or uses one at a port.
struct Server {
    _process: Process,
    address: String,
}

impl Server {
    fn start(port: &str) -> Self {
        let process = Process::start(&["serve", "--haply", "--listen", "0", "--port", port]);
        let tcp_port = process.first_line.rsplit("ws://localhost:").next().unwrap();
        Self { address: format!("127.0.0.1:{tcp_port}"), _process: process }
    }

    fn connect(&self) -> Result<Program, tungstenite::Error> {
        Ok(Program::connect(&self.address)?.0)
    }

    /// Connects as soon as the previous program has left.
    fn connect_next(&self) -> Program {
        let mut next_client = None;
        wait_until("the next program", || {
            next_client = self.connect().ok();
            next_client.is_some()
        });
        next_client.unwrap()
    }

    fn get(&self, path: &str, origin: &str) -> (String, Value) {
        http_get(&self.address, path, origin)
    }
}

/// Sends a plain HTTP request. Returns status line and JSON document.
fn http_get(address: &str, path: &str, origin: &str) -> (String, Value) {
    let mut stream = TcpStream::connect(address).unwrap();
    write!(stream, "GET {path} HTTP/1.1\r\nHost: {address}\r\n{origin}\r\n").unwrap();
    let mut text = String::new();
    stream.read_to_string(&mut text).unwrap();
    let (head, body) = text.split_once("\r\n\r\n").unwrap();
    (head.lines().next().unwrap().into(), serde_json::from_str(body).unwrap())
}

/// A server in this process with a strict board that can be armed. The board's time advances only during requests.
struct LocalServer {
    address: String,
    board: SharedBoard,
    /// Number of next messages to the board that the wire loses.
    loses: Arc<AtomicU32>,
    stop: Arc<AtomicBool>,
    server: Option<JoinHandle<()>>,
}

impl LocalServer {
    fn start() -> Self {
        Self::start_with(HaplyListener::open(0).unwrap(), |_| {})
    }

    /// Calls `prepare` on a session with the board, then starts the server with this listener.
    fn start_with(listener: HaplyListener, prepare: impl FnOnce(&mut Session)) -> Self {
        let (board, mut session) = strict_board();
        prepare(&mut session);
        drop(session);
        let (session, loses) = LossyWire::session(&board);
        let address = listener.url().unwrap().replace("ws://localhost", "127.0.0.1");
        let device = Inverse3::new(session, None, false).unwrap();
        let stop = Arc::new(AtomicBool::new(false));
        let over = Arc::clone(&stop);
        let server = std::thread::spawn(move || listener.serve(device, || Err("not lost"), &over));
        Self { address, board, loses, stop, server: Some(server) }
    }

    /// Connects as soon as the previous program has left. Returns the program, its device's id and its first frame.
    fn connect(&self) -> (Program, Value, Value) {
        let mut come = None;
        wait_until("a program", || {
            come = Program::connect(&self.address).ok();
            come.is_some()
        });
        let (program, first) = come.unwrap();
        (program, first["inverse3"][0]["device_id"].clone(), first)
    }
}

impl Drop for LocalServer {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        let ended = self.server.take().unwrap().join();
        assert!(ended.is_ok() || std::thread::panicking());
    }
}

struct Program(WebSocket<MaybeTlsStream<TcpStream>>);

impl Program {
    /// Returns a connected program and its first frame.
    fn connect(address: &str) -> Result<(Self, Value), tungstenite::Error> {
        let (socket, _) = tungstenite::connect(format!("ws://{address}/"))?;
        let mut program = Self(socket);
        let first = program.frame();
        Ok((program, first))
    }

    fn frame(&mut self) -> Value {
        match self.0.read().unwrap() {
            Message::Text(text) => serde_json::from_str(&text).unwrap(),
            other => panic!("{other:?}"),
        }
    }

    fn request(&mut self, message: &Value) -> Value {
        self.0.send(Message::text(message.to_string())).unwrap();
        self.frame()
    }
}

fn force_message(id: &Value, spelling: &str, [x, y, z]: [f64; 3]) -> Value {
    let command = json!({spelling: {"x": x, "y": y, "z": z}});
    json!({"session": {}, "inverse3": [{"device_id": id, "commands": {"set_cursor_force": command}}]})
}

fn number(frame: &Value, pointer: &str) -> f64 {
    frame.pointer(pointer).and_then(Value::as_f64).unwrap_or_else(|| panic!("{pointer} in {frame}"))
}

/// Keys that the structures of the official client need (crate `haply` 1.3.1, src/device_model/devices.rs), then other
/// keys of the first frame in the service's documentation (3.5, WebSocket Protocol).
const NEEDED_KEYS: &str = "
    device_id state/cursor_position/x state/cursor_velocity/z state/angular_position/a0
    state/angular_velocity/a2 state/body_orientation/w state/mode state/transform/rotation/w status/calibrated
    status/in_use status/power_supply status/ready status/started config/type config/device_info/id
    config/device_info/major_version config/device_info/minor_version config/device_info/device_type
    config/device_info/uuid config/port config/extended_device_id config/extended_firmware_version
    config/gravity_compensation/scaling_factor config/handedness config/torque_scaling/enabled
    config/basis/permutation config/home_return/enabled config/preset config/mount/rotation/w
    config/filters/damping/scalar state/current_cursor_position/x state/current_angular_torques/a0
    state/current_angular_position/a2";

#[test]
fn a_program_receives_all_keys_first_then_frames() {
    let server = Server::start("sim");
    let (mut program, first) = Program::connect(&server.address).unwrap();
    for key in NEEDED_KEYS.split_whitespace() {
        assert!(first.pointer(&format!("/inverse3/0/{key}")).is_some(), "{key} in {first}");
    }
    let grip = "device_id state/orientation/w state/buttons/a state/buttons/b state/buttons/c config/type";
    for key in grip.split(' ') {
        assert!(first.pointer(&format!("/wireless_verse_grip/0/{key}")).is_some(), "{key} in {first}");
    }
    let id = &first["inverse3"][0]["device_id"];
    assert_eq!((number(&first, "/session_id"), first["inverse3"][0]["status"]["started"] == true), (1.0, false));
    // A five-bar lies on the table with its base away from the operator, so its y axis points towards the operator.
    let [x, y] = ["x", "y"].map(|axis| number(&first, &format!("/inverse3/0/state/cursor_position/{axis}")));
    assert!(x.abs() < 0.1 && y < -0.05, "{first}");
    for (spelling, push, along) in
        [("values", [0.6, 0.0, 0.0], "x"), ("vector", [0.0, 0.6, 0.0], "y"), ("vector", [0.0, -0.6, 5.0], "y")]
    {
        // After the torque ramp and against friction, push until the tip moves, but stop before the arm is stretched.
        let place = format!("/inverse3/0/state/cursor_position/{along}");
        let begin = number(&program.request(&json!({})), &place);
        let sign = push[0] + push[1];
        let mut frame = Value::Null;
        for _ in 0..20_000 {
            frame = program.request(&force_message(id, spelling, push));
            if (number(&frame, &place) - begin) * sign > 0.003 * sign.abs() {
                break;
            }
        }
        assert!((number(&frame, &place) - begin) * sign > 0.003 * sign.abs(), "{spelling}: {frame}");
        assert_eq!(frame["inverse3"][0]["status"]["started"], true);
        assert!(frame["inverse3"][0]["config"].is_null(), "only the first frame has the configuration");
        // Brake until the tip almost stops.
        for _ in 0..20_000 {
            let v = |axis: &str| number(&frame, &format!("/inverse3/0/state/cursor_velocity/{axis}"));
            if v("x").hypot(v("y")) < 0.01 {
                break;
            }
            let brake = [-8.0 * v("x"), -8.0 * v("y"), 0.0];
            frame = program.request(&force_message(id, "values", brake));
        }
    }
    let full = program.request(&json!({"session": {"force_render_full_state": {}}}));
    assert_eq!(full["inverse3"][0]["config"]["device_info"]["id"], *id);
    // A message without a valid command acts like an empty request and does not end the connection.
    for nonsense in [json!(3), json!({"inverse3": [{"device_id": id, "commands": {"set_cursor_force": {}}}]})] {
        assert_eq!(program.request(&nonsense)["inverse3"][0]["device_id"], *id);
    }
}

#[test]
fn a_binary_frame_is_a_message() {
    let server = LocalServer::start();
    let (mut program, id, first) = server.connect();
    assert_eq!(first["inverse3"][0]["config"]["device_info"]["device_type"], 4);
    let push = force_message(&id, "vector", [0.3, 0.0, 0.0]).to_string();
    program.0.send(Message::binary(push.into_bytes())).unwrap();
    assert_eq!(program.frame()["inverse3"][0]["status"]["started"], true);
    assert_eq!(server.board.lock().status().state, State::Armed);
    // A quarter turn about the vertical.
    server.board.lock().device_mut().set_sensed_counts([1_000, 0, 0]);
    let frame = program.request(&json!({}));
    for (part, expected) in [("w", 0.5_f64.sqrt()), ("x", 0.0), ("y", 0.0), ("z", 0.5_f64.sqrt())] {
        let found = number(&frame, &format!("/wireless_verse_grip/0/state/orientation/{part}"));
        assert!((found - expected).abs() < 1e-6, "{part}: {frame}");
    }
}

#[test]
fn a_lost_reply_affects_only_its_message() {
    let server = LocalServer::start();
    let (mut program, id, _) = server.connect();
    let push = force_message(&id, "vector", [0.0; 3]);
    program.request(&push);
    server.loses.store(u32::MAX, Ordering::Relaxed);
    assert_eq!(program.request(&json!({}))["inverse3"][0]["status"]["ready"], false);
    server.loses.store(0, Ordering::Relaxed);
    assert_eq!(program.request(&json!({}))["inverse3"][0]["device_id"], id, "the program is no longer served");
}

#[test]
fn the_program_in_control_sees_and_clears_faults() {
    let server = LocalServer::start();
    let (mut program, id, _) = server.connect();
    let push = force_message(&id, "vector", [0.0; 3]);
    let clear = json!({"inverse3": [{"device_id": id, "commands": {"clear_fault": {}}}]});
    let probe = json!({"inverse3": [{"device_id": id, "commands": {"probe_position": {}}}]});
    let started = |frame: &Value| frame["inverse3"][0]["status"]["started"] == true;
    assert!(started(&program.request(&push)));
    // The program is silent for so long that the board reports HostLost.
    let fall_silent = || server.board.lock().run(0.6);
    fall_silent();
    let frame = program.request(&push);
    assert_eq!(frame["inverse3"][0]["fault"]["name"], "HostLost", "{frame}");
    assert!(!frame["inverse3"][0]["fault"]["remedy"].as_str().unwrap().is_empty());
    assert_eq!(frame["inverse3"][0]["status"]["ready"], false);
    assert!(!started(&program.request(&push)), "a force armed the board although the fault is not cleared");
    let cleared = program.request(&clear);
    assert!(cleared["inverse3"][0]["fault"].is_null() && cleared["inverse3"][0]["status"]["ready"] == true);
    // Forces in or directly after the clearing message do not arm, so that the motors do not go on again unnoticed.
    let both = json!({"inverse3": [{"device_id": id, "commands": {"clear_fault": {}, "set_cursor_force": {"vector": {"x": 0.0, "y": 0.0, "z": 0.0}}}}]});
    for _ in 0..3 {
        assert!(!started(&program.request(&both)) && !started(&program.request(&push)));
    }
    let a_second = || server.board.lock().run(1.0);
    a_second();
    program.request(&probe);
    assert!(started(&program.request(&push)));
    // A program that does not clear faults may connect again; the first frame names the fault.
    fall_silent();
    program.request(&push);
    drop(program);
    let (mut anew, _, first) = server.connect();
    assert_eq!((&first["inverse3"][0]["fault"]["code"], &first["session_id"]), (&json!(16), &json!(2)));
    assert!(started(&anew.request(&push)));
    // A program that falls silent and leaves does not block the next program.
    fall_silent();
    drop(anew);
    let (mut anew, _, first) = server.connect();
    assert_eq!(first["inverse3"][0]["fault"]["name"], "HostLost");
    assert!(started(&anew.request(&push)));
    drop(anew);
    // A fault that occurs without a program is cleared only on request.
    server.board.lock().inject(Fault::GateDriver, None, 0.0);
    server.board.lock().run(0.01);
    let (mut last, _, first) = server.connect();
    assert_eq!(first["inverse3"][0]["fault"]["name"], "GateDriver");
    assert!(!started(&last.request(&push)));
    last.request(&clear);
    a_second();
    last.request(&probe);
    assert!(started(&last.request(&push)));
    // A board fault that occurs during a program is not cleared for the next program.
    server.board.lock().inject(Fault::GateDriver, None, 0.0);
    server.board.lock().run(0.01);
    last.request(&push);
    drop(last);
    assert!(!started(&server.connect().0.request(&push)));
}

#[test]
fn only_a_program_and_no_plain_request_counts_as_host() {
    let server = LocalServer::start();
    let (mut program, id, _) = server.connect();
    program.request(&force_message(&id, "vector", [0.0; 3]));
    let probe = json!({"inverse3": [{"device_id": id, "commands": {"probe_position": {}}}]});
    for _ in 0..8 {
        server.board.lock().run(0.2);
        assert_eq!(program.request(&probe)["inverse3"][0]["status"]["started"], true);
    }
    for _ in 0..8 {
        server.board.lock().run(0.2);
        http_get(&server.address, "/devices", "");
    }
    assert_eq!(server.board.lock().status().fault.unwrap().fault, Fault::HostLost);
}

#[test]
fn a_device_that_is_not_homed_reports_that_it_is_not_ready() {
    let status =
        |frame: &Value| ["calibrated", "ready", "started"].map(|key| frame["inverse3"][0]["status"][key] == true);
    let homed = LocalServer::start();
    let (mut program, id, first) = homed.connect();
    let push = force_message(&id, "vector", [0.0; 3]);
    assert_eq!([status(&first), status(&program.request(&push))], [[true, true, false], [true; 3]]);
    let forget = |session: &mut Session| {
        let device = session.device().unwrap().unwrap();
        session.set_device(&device).unwrap();
    };
    let forgotten = LocalServer::start_with(HaplyListener::open(0).unwrap(), forget);
    let (mut program, _, first) = forgotten.connect();
    assert_eq!(status(&first), [false; 3]);
    let frame = program.request(&push);
    assert_eq!(status(&frame), [false; 3]);
    assert!(frame["inverse3"][0]["refusal"].as_str().unwrap().contains("not homed"), "{frame}");
}

#[test]
fn a_silent_program_gives_way_to_the_next() {
    let within = |silence| LocalServer::start_with(HaplyListener::open(0).unwrap().give_way_after(silence), |_| {});
    let server = within(Duration::MAX);
    let _program = server.connect();
    assert!(Program::connect(&server.address).is_err());
    let server = within(Duration::ZERO);
    let (mut suspended, id, _) = server.connect();
    suspended.request(&force_message(&id, "vector", [0.0; 3]));
    let (mut next, first) = Program::connect(&server.address).unwrap();
    assert_eq!(first["inverse3"][0]["status"]["started"], false);
    assert_eq!(next.request(&force_message(&id, "vector", [0.0; 3]))["inverse3"][0]["status"]["started"], true);
    assert!(matches!(suspended.0.read(), Ok(Message::Close(_))));
}

#[test]
fn the_server_sends_heartbeats_without_a_program() {
    let server = LocalServer::start();
    server.loses.store(2, Ordering::Relaxed);
    wait_until("two messages", || server.loses.load(Ordering::Relaxed) == 0);
}

#[test]
fn a_returning_board_is_served_again() {
    let board = Sim::start(&[]);
    let port = board.port.rsplit(':').next().unwrap().to_owned();
    let server = Server::start(&board.port);
    let mut program = server.connect().unwrap();
    let id = program.request(&json!({"session": {"force_render_full_state": {}}}))["inverse3"][0]["device_id"].clone();
    let push = force_message(&id, "vector", [0.0; 3]);
    program.request(&push);
    drop(board);
    // The server closes the connection when the board is lost, without waiting for a request.
    assert!(matches!(program.0.read(), Ok(Message::Close(_))));
    assert!(server.get("/devices", "").0.contains("503") && server.connect().is_err());
    let _back = Sim::start(&["--tcp", &port]);
    assert_eq!(server.connect_next().request(&push)["inverse3"][0]["status"]["started"], true);
}

#[test]
fn device_states_are_current() {
    let server = LocalServer::start();
    let (mut program, id, _) = server.connect();
    let acts = |address: &str| number(&http_get(address, "/devices", "").1, "/inverse3/0/state/current_cursor_force/x");
    program.request(&force_message(&id, "vector", [0.3, 0.0, 0.0]));
    server.board.lock().run(0.45);
    // A force computed from a state that is half a second old would be refused, so read the state again.
    program.request(&json!({}));
    let frame = program.request(&force_message(&id, "vector", [0.3, 0.0, 0.0]));
    let before = number(&frame, "/inverse3/0/state/cursor_position/x");
    server.board.lock().run(0.01);
    assert!(acts(&server.address) > 0.2);
    server.board.lock().run(0.4);
    assert_eq!(acts(&server.address), 0.0);
    let after = number(&http_get(&server.address, "/devices", "").1, "/inverse3/0/state/cursor_position/x");
    assert_ne!(before, after);
}

#[test]
fn a_program_uses_its_configured_axes() {
    let server = LocalServer::start();
    let (mut program, id, first) = server.connect();
    let place = |frame: &Value, axis: &str| number(frame, &format!("/inverse3/0/state/cursor_position/{axis}"));
    let configure =
        json!({"session": {"force_render_full_state": {}, "configure": {"basis": {"permutation": "ZX-Y"}}}});
    let turned_frame = program.request(&configure);
    assert_eq!(turned_frame["inverse3"][0]["config"]["basis"]["permutation"], "ZX-Y");
    for (own, haply, sign) in [("x", "z", 1.0), ("y", "x", 1.0), ("z", "y", -1.0)] {
        assert!((place(&turned_frame, own) - sign * place(&first, haply)).abs() < 1e-4, "{turned_frame}");
    }
    // The program's y axis is Haply's x axis.
    let push = force_message(&id, "vector", [0.0, 0.6, 0.0]);
    program.request(&push);
    // Wait until the first force has expired.
    for _ in 0..2 {
        server.board.lock().run(0.3);
        program.request(&json!({}));
    }
    program.request(&push);
    server.board.lock().run(0.01);
    let frame = program.request(&json!({}));
    assert!(number(&frame, "/inverse3/0/state/current_cursor_force/y") > 0.5, "{frame}");
    let turning = ["a0", "a1"].map(|joint| number(&frame, &format!("/inverse3/0/state/angular_velocity/{joint}")));
    assert!(turning[0].hypot(turning[1]) > 1.0, "{frame}");
    drop(program);
    // The next program starts with the default axes.
    assert_eq!(server.connect().2["inverse3"][0]["config"]["basis"]["permutation"], "XYZ");
}

#[test]
fn only_one_local_program_is_served_and_its_end_disarms() {
    let board = Sim::start(&[]);
    let server = Server::start(&board.port);
    let (status, devices) = server.get("/devices", "");
    let id = devices["inverse3"][0]["device_id"].clone();
    assert!(status.contains("200") && !devices["inverse3"][0]["config"].is_null(), "{status}");
    assert!(server.get("/version", "").0.contains("200") && server.get("/else", "").0.contains("404"));
    // Requests from web pages are refused, also if the page comes from another server on this computer.
    for page in ["http://evil.example", "null", "http://localhost:3000", "http://127.0.0.1:3000"] {
        assert!(server.get("/devices", &format!("Origin: {page}\r\n")).0.contains("403"), "{page}");
    }
    let started = || server.get("/devices", "").1["inverse3"][0]["status"]["started"].clone();
    let mut program = server.connect().unwrap();
    program.request(&force_message(&id, "vector", [0.0; 3]));
    assert_eq!(started(), true);
    drop(program);
    // When the next program connects, the motors are off.
    let mut client = server.connect_next();
    assert_eq!(client.request(&json!({}))["inverse3"][0]["status"]["started"], false);
    // A force does not arm the board again if another tool has disarmed it.
    let forces = |program: &mut Program| {
        (0..50)
            .map(|_| {
                program.request(&force_message(&id, "vector", [0.0; 3]))["inverse3"][0]["status"]["started"] == true
            })
            .last()
    };
    assert_eq!(forces(&mut client), Some(true));
    board.run(&["disarm"]).success();
    assert_eq!(forces(&mut client), Some(false), "a force armed the board again after another tool disarmed it");
    drop(client);
    let mut last_client = server.connect_next();
    assert_eq!(forces(&mut last_client), Some(true));
}

#[test]
fn impossible_servers_are_refused() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    type_lines(
        &format!(
            "2: serve --port sim
            2: serve --haply --port sim --axes x,x,0
            1: serve --haply --port sim --listen {port} => cannot listen on port"
        ),
        &[],
    );
}
