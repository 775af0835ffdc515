//! `haptic view` on a board that is unplugged and plugged in again, with a WebSocket instead of a browser.

use crate::common::page::{Received, View};
use crate::common::sim::{HANG_TIMEOUT, wait_until};
use crate::common::socket::Socket;
use crate::common::{haptic, shipped_path};
use serde_json::{Value, json};
use std::io::ErrorKind;
use std::net::TcpStream;
use std::time::{Duration, Instant};
use tungstenite::{Message, WebSocket};

struct Page {
    socket: WebSocket<TcpStream>,
    received: Received,
    /// True to report the key as down at every read.
    holding: bool,
}

impl Page {
    /// Connects a page and takes command.
    fn connect_and_take_command(view: &View) -> Self {
        let stream = TcpStream::connect(view.address()).unwrap();
        let (socket, _) = tungstenite::client(format!("ws://{}/live", view.address()), stream).unwrap();
        socket.get_ref().set_read_timeout(Some(Duration::from_millis(20))).unwrap();
        let mut page = Self { socket, received: Received::default(), holding: false };
        page.take_command();
        page
    }

    fn take_command(&mut self) {
        self.send(json!({"do": "take"}));
        self.wait_until("command", |received| received.you > 0 && received.picture["command"] == received.you);
    }

    fn send(&mut self, message: Value) {
        self.socket.send(Message::text(message.to_string())).unwrap();
    }

    /// Reads one message, if there is one.
    fn read(&mut self) {
        if self.holding {
            self.send(json!({"do": "hold", "seen": self.received.step()}));
        }
        match self.socket.read() {
            Ok(Message::Text(text)) => self.received.receive_text(&text),
            Ok(_) => {}
            Err(tungstenite::Error::Io(error))
                if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted) => {}
            Err(error) => panic!("{error}"),
        }
    }

    fn wait_until(&mut self, what: &str, is_so: impl Fn(&Received) -> bool) {
        let start = Instant::now();
        while !is_so(&self.received) {
            assert!(start.elapsed() < HANG_TIMEOUT, "{what}: {}\n{:?}", self.received.picture, self.received.refused);
            self.read();
        }
    }

    /// Presses the key and keeps it down. Presses again if this computer was too slow.
    fn arm(&mut self) {
        self.holding = true;
        let start = Instant::now();
        while self.received.state() != "Armed" {
            assert!(start.elapsed() < HANG_TIMEOUT, "{:?}", self.received.refused);
            if self.received.picture["held"] == false {
                self.send(json!({"do": "arm", "seen": self.received.step()}));
            }
            self.read();
        }
    }
}

/// A board that is switched off loses its scene unless it was saved.
#[test]
fn the_page_waits_for_a_lost_board_even_without_its_scene() {
    let wall = shipped_path("scenes/coupled-five-bar/wall.toml");
    let socket = Socket::empty();
    socket.plug(&["--scene", &wall]);
    let view = View::start(&["--port", &socket.address]);
    let mut page = Page::connect_and_take_command(&view);
    page.arm();
    for back in [&["--scene", &wall][..], &[]] {
        socket.unplug();
        page.wait_until("the loss of the board", |received| received.lost.is_some());
        page.holding = false;
        page.received.hello = Value::Null;
        socket.plug(back);
        if back.is_empty() {
            let names_remedy = |why: &String| why.contains("`haptic scene FILE`");
            page.wait_until("the remedy", |received| received.lost.as_ref().is_some_and(names_remedy));
            // Between two polls by the page the board is free for other tools.
            let scene = ["scene", &wall, "--port", &socket.address];
            wait_until("the scene", || haptic(&scene).output().unwrap().status.success());
        }
        page.wait_until("the return of the board", |received| !received.hello.is_null());
        page.received.picture = Value::Null;
        page.wait_until("no page in command", |received| {
            received.state() == "Disarmed" && received.picture["command"].is_null()
        });
        page.received.lost = None;
        page.take_command();
        page.arm();
    }
}
