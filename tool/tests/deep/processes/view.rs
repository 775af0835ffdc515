//! `haptic view` on a board that comes and goes, with a page without a browser: a WebSocket that reads and says JSON.

use crate::common::page::{Heard, View};
use crate::common::sim::{HANG, until};
use crate::common::socket::Socket;
use crate::common::{file, haptic};
use serde_json::{Value, json};
use std::io::ErrorKind;
use std::net::TcpStream;
use std::time::{Duration, Instant};
use tungstenite::{Message, WebSocket};

struct Page {
    socket: WebSocket<TcpStream>,
    heard: Heard,
    /// Says that its key is down while it reads.
    holding: bool,
}

impl Page {
    /// One that has taken command.
    fn in_command(view: &View) -> Self {
        let stream = TcpStream::connect(view.address()).unwrap();
        let (socket, _) = tungstenite::client(format!("ws://{}/live", view.address()), stream).unwrap();
        socket.get_ref().set_read_timeout(Some(Duration::from_millis(20))).unwrap();
        let mut page = Self { socket, heard: Heard::default(), holding: false };
        page.take();
        page
    }

    fn take(&mut self) {
        self.say(json!({"do": "take"}));
        self.until("command", |heard| heard.you > 0 && heard.picture["command"] == heard.you);
    }

    fn say(&mut self, message: Value) {
        self.socket.send(Message::text(message.to_string())).unwrap();
    }

    /// Reads one message, if there is one.
    fn read(&mut self) {
        if self.holding {
            self.say(json!({"do": "hold", "seen": self.heard.step()}));
        }
        match self.socket.read() {
            Ok(Message::Text(text)) => self.heard.text(&text),
            Ok(_) => {}
            Err(tungstenite::Error::Io(error))
                if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted) => {}
            Err(error) => panic!("{error}"),
        }
    }

    fn until(&mut self, what: &str, is_so: impl Fn(&Heard) -> bool) {
        let began = Instant::now();
        while !is_so(&self.heard) {
            assert!(began.elapsed() < HANG, "{what}: {}\n{:?}", self.heard.picture, self.heard.refused);
            self.read();
        }
    }

    /// Presses the key and keeps it down; anew, should this computer have been too slow to say so in time.
    fn arm(&mut self) {
        self.holding = true;
        let began = Instant::now();
        while self.heard.state() != "Armed" {
            assert!(began.elapsed() < HANG, "{:?}", self.heard.refused);
            if self.heard.picture["held"] == false {
                self.say(json!({"do": "arm", "seen": self.heard.step()}));
            }
            self.read();
        }
    }
}

/// The scene of a board that is switched off is gone, unless it was saved.
#[test]
fn a_board_that_is_lost_is_waited_for_also_where_it_comes_back_without_its_scene() {
    let wall = file("scenes/coupled-five-bar/wall.toml");
    let socket = Socket::empty();
    socket.plug(&["--scene", &wall]);
    let view = View::start(&["--port", &socket.address]);
    let mut page = Page::in_command(&view);
    page.arm();
    for back in [&["--scene", &wall][..], &[]] {
        socket.unplug();
        page.until("its loss", |heard| heard.lost.is_some());
        page.holding = false;
        page.heard.hello = Value::Null;
        socket.plug(back);
        if back.is_empty() {
            let told = |why: &String| why.contains("`haptic scene FILE`");
            page.until("what to do", |heard| heard.lost.as_ref().is_some_and(told));
            // Between two looks the board is free for others.
            let scene = ["scene", &wall, "--port", &socket.address];
            until("the scene", || haptic(&scene).output().unwrap().status.success());
        }
        page.until("its return", |heard| !heard.hello.is_null());
        page.heard.picture = Value::Null;
        page.until("nobody in command", |heard| heard.state() == "Disarmed" && heard.picture["command"].is_null());
        page.heard.lost = None;
        page.take();
        page.arm();
    }
}

/// Largest memory that a process has had, kB.
fn most_memory(process: u32) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap();
    let line = status.lines().find(|line| line.starts_with("VmHWM:")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse().unwrap()
}

/// Three pages that only watch send as much as they can, for as long as this takes.
#[test]
fn pages_that_flood_cost_little_and_keep_nobody_from_letting_go() {
    let view = View::start(&["--port", "sim"]);
    let mut page = Page::in_command(&view);
    let over = std::sync::atomic::AtomicBool::new(false);
    std::thread::scope(|scope| {
        for _ in 0..3 {
            let (view, over) = (&view, &over);
            scope.spawn(move || {
                let stream = TcpStream::connect(view.address()).unwrap();
                let (mut socket, _) = tungstenite::client(format!("ws://{}/live", view.address()), stream).unwrap();
                // Written past the library: one frame after another, of a message that is refused in words.
                let stream = socket.get_mut();
                stream.set_nonblocking(true).unwrap();
                let mut frame = vec![0x81, 0x80 | 20, 0, 0, 0, 0];
                frame.extend(br#"{"do":"take","x":12}"#);
                let block = frame.repeat(2_000);
                let (mut at, mut read) = (0, vec![0; 1 << 16]);
                while !over.load(std::sync::atomic::Ordering::SeqCst) {
                    use std::io::{Read, Write};
                    let _ = stream.read(&mut read);
                    match stream.write(&block[at..]) {
                        Ok(count) => at = (at + count) % block.len(),
                        Err(error) if error.kind() == ErrorKind::WouldBlock => std::thread::yield_now(),
                        Err(_) => return,
                    }
                }
            });
        }
        page.until("the others", |heard| heard.picture["pages"] == 4);
        page.arm();
        for _ in 0..300 {
            page.heard.picture = Value::Null;
            page.until("a picture", |heard| !heard.picture.is_null());
        }
        page.arm();
        page.holding = false;
        page.say(json!({"do": "release"}));
        page.until("the motors off", |heard| heard.state() == "Disarmed");
        over.store(true, std::sync::atomic::Ordering::SeqCst);
    });
    let memory = most_memory(view.process());
    assert!(memory < 100_000, "{memory} kB");
}

#[test]
fn a_folder_for_recordings_that_is_missing_is_told_at_the_start() {
    let view = ["view", "--port", "sim", "--listen", "127.0.0.1:0", "--record-to", "/nonexistent"];
    let refused = haptic(&view).timeout(HANG).assert().code(1);
    let said = String::from_utf8_lossy(&refused.get_output().stderr).into_owned();
    assert!(said.contains("/nonexistent is not there; make the folder first"), "{said}");
}
