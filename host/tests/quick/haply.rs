//! `haptic serve --haply` as programs made for Haply's service see it: frames with the keys that its official client
//! needs, in lock-step, forces in both spellings.

use crate::common::haptic;
use crate::common::sim::{Sim, until};
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, Stdio};
use tungstenite::stream::MaybeTlsStream;
use tungstenite::{Message, WebSocket};

/// The server, on a board in its own process or at a port.
struct Server {
    child: Child,
    address: String,
}

impl Server {
    fn start(port: &str) -> Self {
        use assert_cmd::cargo::CommandCargoExt;
        let mut command = std::process::Command::cargo_bin("haptic").unwrap();
        let arguments = ["serve", "--haply", "--listen", "0", "--port", port];
        let mut child = command.args(arguments).stdout(Stdio::piped()).spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let address = line.trim().rsplit("ws://localhost:").next().unwrap();
        Self { address: format!("127.0.0.1:{address}"), child }
    }

    fn connect(&self) -> Result<Program, tungstenite::Error> {
        let (socket, _) = tungstenite::connect(format!("ws://{}/", self.address))?;
        let mut program = Program(socket);
        program.frame();
        Ok(program)
    }

    /// The next program, let in once the one before has left.
    fn next(&self) -> Program {
        let mut next = None;
        until("the next program", || {
            next = self.connect().ok();
            next.is_some()
        });
        next.unwrap()
    }

    /// What a plain request is answered with: status line and document.
    fn get(&self, path: &str, origin: &str) -> (String, Value) {
        let mut stream = TcpStream::connect(&self.address).unwrap();
        write!(stream, "GET {path} HTTP/1.1\r\nHost: {}\r\n{origin}\r\n", self.address).unwrap();
        let mut text = String::new();
        stream.read_to_string(&mut text).unwrap();
        let (head, body) = text.split_once("\r\n\r\n").unwrap();
        (head.lines().next().unwrap().into(), serde_json::from_str(body).unwrap())
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

struct Program(WebSocket<MaybeTlsStream<TcpStream>>);

impl Program {
    fn frame(&mut self) -> Value {
        match self.0.read().unwrap() {
            Message::Text(text) => serde_json::from_str(&text).unwrap(),
            other => panic!("{other:?}"),
        }
    }

    fn ask(&mut self, message: &Value) -> Value {
        self.0.send(Message::text(message.to_string())).unwrap();
        self.frame()
    }
}

fn force(id: &Value, spelling: &str, [x, y, z]: [f64; 3]) -> Value {
    let command = json!({spelling: {"x": x, "y": y, "z": z}});
    json!({"session": {}, "inverse3": [{"device_id": id, "commands": {"set_cursor_force": command}}]})
}

fn number(frame: &Value, pointer: &str) -> f64 {
    frame.pointer(pointer).and_then(Value::as_f64).unwrap_or_else(|| panic!("{pointer} in {frame}"))
}

/// What the structures of the official client (crate `haply` 1.3.1, src/device_model/devices.rs) cannot do without.
const NEEDED: [&str; 26] = [
    "device_id",
    "state/cursor_position/x",
    "state/cursor_velocity/z",
    "state/angular_position/a0",
    "state/angular_velocity/a2",
    "state/body_orientation/w",
    "state/mode",
    "state/transform/rotation/w",
    "status/calibrated",
    "status/in_use",
    "status/power_supply",
    "status/ready",
    "status/started",
    "config/type",
    "config/device_info/id",
    "config/device_info/major_version",
    "config/device_info/minor_version",
    "config/device_info/device_type",
    "config/device_info/uuid",
    "config/port",
    "config/extended_device_id",
    "config/extended_firmware_version",
    "config/gravity_compensation/scaling_factor",
    "config/handedness",
    "config/torque_scaling/enabled",
    "config/basis/permutation",
];

#[test]
fn a_program_gets_everything_first_and_then_a_frame_for_each_message() {
    let server = Server::start("sim");
    let (socket, _) = tungstenite::connect(format!("ws://{}/", server.address)).unwrap();
    let mut program = Program(socket);
    let first = program.frame();
    for key in NEEDED {
        assert!(first.pointer(&format!("/inverse3/0/{key}")).is_some(), "{key} in {first}");
    }
    for key in
        ["device_id", "state/orientation/w", "state/buttons/a", "state/buttons/b", "state/buttons/c", "config/type"]
    {
        assert!(first.pointer(&format!("/wireless_verse_grip/0/{key}")).is_some(), "{key} in {first}");
    }
    let id = &first["inverse3"][0]["device_id"];
    assert_eq!((number(&first, "/session_id"), first["inverse3"][0]["status"]["started"] == true), (1.0, false));
    // A five-bar lies on the table, its base away from the operator: its y is towards them.
    let (x, y) =
        (number(&first, "/inverse3/0/state/cursor_position/x"), number(&first, "/inverse3/0/state/cursor_position/y"));
    assert!(x.abs() < 0.1 && y < -0.05, "{first}");

    for (spelling, push, along) in
        [("values", [0.6, 0.0, 0.0], "x"), ("vector", [0.0, 0.6, 0.0], "y"), ("vector", [0.0, -0.6, 5.0], "y")]
    {
        // Out of the ramp and the friction, and stopped before the arm is stretched.
        let place = format!("/inverse3/0/state/cursor_position/{along}");
        let begin = number(&program.ask(&json!({})), &place);
        let sign = push[0] + push[1];
        let mut frame = Value::Null;
        for _ in 0..20_000 {
            frame = program.ask(&force(id, spelling, push));
            if (number(&frame, &place) - begin) * sign > 0.003 * sign.abs() {
                break;
            }
        }
        assert!((number(&frame, &place) - begin) * sign > 0.003 * sign.abs(), "{spelling}: {frame}");
        assert_eq!(frame["inverse3"][0]["status"]["started"], true);
        assert!(frame["inverse3"][0]["config"].is_null(), "only the first frame tells all");
        // Against the motion, until it turns.
        for _ in 0..20_000 {
            let v = |axis: &str| number(&frame, &format!("/inverse3/0/state/cursor_velocity/{axis}"));
            if v("x").hypot(v("y")) < 0.01 {
                break;
            }
            let brake = [-8.0 * v("x"), -8.0 * v("y"), 0.0];
            frame = program.ask(&force(id, "values", brake));
        }
    }
    let full = program.ask(&json!({"session": {"force_render_full_state": {}}}));
    assert_eq!(full["inverse3"][0]["config"]["device_info"]["id"], *id);
    // Nonsense is answered as if it asked for nothing, and the connection stays.
    for nonsense in [json!(3), json!({"inverse3": [{"device_id": id, "commands": {"set_cursor_force": {}}}]})] {
        assert_eq!(program.ask(&nonsense)["inverse3"][0]["device_id"], *id);
    }
}

#[test]
fn one_program_at_a_time_of_this_computer_and_the_motors_go_off_with_it() {
    let board = Sim::start(&[]);
    let server = Server::start(&board.port);
    let (status, devices) = server.get("/devices", "");
    let id = devices["inverse3"][0]["device_id"].clone();
    assert!(status.contains("200") && !devices["inverse3"][0]["config"].is_null(), "{status}");
    assert!(server.get("/version", "").0.contains("200") && server.get("/else", "").0.contains("404"));
    // Pages in a browser, of another site or of whatever else listens on this computer.
    for page in ["http://evil.example", "null", "http://localhost:3000", "http://127.0.0.1:3000"] {
        assert!(server.get("/devices", &format!("Origin: {page}\r\n")).0.contains("403"), "{page}");
    }
    let started = || server.get("/devices", "").1["inverse3"][0]["status"]["started"].clone();
    let mut program = server.connect().unwrap();
    assert!(server.connect().is_err(), "another program");
    program.ask(&force(&id, "vector", [0.0; 3]));
    assert_eq!(started(), true);
    drop(program);
    // The server's own end: the next program finds the motors off.
    let mut again = server.next();
    assert_eq!(again.ask(&json!({}))["inverse3"][0]["status"]["started"], false);
    // Who disarms the board meanwhile is not overruled by the program's next force.
    let forces = |program: &mut Program| {
        (0..50).map(|_| program.ask(&force(&id, "vector", [0.0; 3]))["inverse3"][0]["status"]["started"] == true).last()
    };
    assert_eq!(forces(&mut again), Some(true));
    board.run(&["disarm"]).success();
    assert_eq!(forces(&mut again), Some(false), "armed again behind the back of whoever disarmed");
    drop(again);
    let mut anew = server.next();
    assert_eq!(forces(&mut anew), Some(true));
}

#[test]
fn what_cannot_be_served_says_so() {
    haptic(&["serve", "--port", "sim"]).assert().code(2);
    haptic(&["serve", "--haply", "--port", "sim", "--axes", "x,x,0"]).assert().code(2);
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port().to_string();
    let said = haptic(&["serve", "--haply", "--port", "sim", "--listen", &port]).assert().code(1);
    assert!(String::from_utf8_lossy(&said.get_output().stderr).contains("cannot listen on port"));
}
