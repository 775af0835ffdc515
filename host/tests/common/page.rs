//! `haptic view` in a process of its own, and a page without a browser: a WebSocket that reads and says JSON.
#![allow(dead_code, reason = "every test file uses its own part")]

use assert_cmd::cargo::CommandCargoExt;
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, ErrorKind};
use std::net::TcpStream;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tungstenite::{Message, WebSocket};

/// How long anything may take that is bound to happen, on a computer that is busy with other tests.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// The tool, serving its page.
pub struct View {
    child: Child,
    /// What it says to open.
    pub url: String,
}

impl View {
    /// On this computer, at a port that is free.
    pub fn start(arguments: &[&str]) -> Self {
        Self::listen("127.0.0.1:0", arguments)
    }

    pub fn listen(address: &str, arguments: &[&str]) -> Self {
        let mut command = Command::cargo_bin("haptic").unwrap();
        command.args(["view", "--listen", address]).args(arguments).stdout(Stdio::piped()).env_remove("HAPTIC_PORT");
        let mut child = command.spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let url = line.split_whitespace().nth(1).unwrap_or_else(|| panic!("{line:?}")).to_string();
        Self { child, url }
    }

    /// Its process.
    pub fn process(&self) -> u32 {
        self.child.id()
    }

    /// Address and port.
    pub fn address(&self) -> &str {
        self.url.trim_start_matches("http://").split('/').next().unwrap()
    }

    /// What follows the address: a token.
    pub fn query(&self) -> &str {
        self.url.split_once('?').map_or("", |(_, query)| query)
    }
}

impl Drop for View {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A page.
pub struct Page {
    socket: WebSocket<TcpStream>,
    pub you: u64,
    /// The newest of each kind of message.
    pub hello: Value,
    pub walls: Value,
    pub springs: Value,
    pub recorded: Option<String>,
    pub plane: Value,
    pub picture: Value,
    /// Every refusal so far.
    pub refused: Vec<Value>,
    pub lost: Option<String>,
    /// The newest sweep and sound.
    pub sweep: Vec<f32>,
    pub sound: Vec<f32>,
    /// Says that its key is down while it reads.
    pub holding: bool,
    said: Instant,
}

impl Page {
    pub fn open(view: &View) -> Self {
        let stream = TcpStream::connect(view.address()).unwrap();
        stream.set_read_timeout(Some(Duration::from_millis(20))).unwrap();
        let query = view.query();
        let url = format!("ws://{}/live?{query}", view.address());
        let mut waiting = tungstenite::client(url, stream);
        let socket = loop {
            match waiting {
                Ok((socket, _)) => break socket,
                Err(tungstenite::HandshakeError::Interrupted(later)) => waiting = later.handshake(),
                Err(error) => panic!("{error}"),
            }
        };
        let mut page = Self {
            socket,
            you: 0,
            hello: Value::Null,
            walls: Value::Null,
            springs: Value::Null,
            recorded: None,
            plane: Value::Null,
            picture: Value::Null,
            refused: Vec::new(),
            lost: None,
            sweep: Vec::new(),
            sound: Vec::new(),
            holding: false,
            said: Instant::now(),
        };
        page.until("the first picture", |page| page.you > 0 && !page.hello.is_null() && !page.picture.is_null());
        page
    }

    /// One that has taken command.
    pub fn in_command(view: &View) -> Self {
        let mut page = Self::open(view);
        page.say(json!({"do": "take"}));
        page.until("command", |page| page.picture["command"] == page.you);
        page
    }

    pub fn say(&mut self, message: Value) {
        self.say_text(&message.to_string());
    }

    pub fn say_text(&mut self, text: &str) {
        self.socket.send(Message::text(text)).unwrap();
    }

    pub fn say_binary(&mut self) {
        self.socket.send(Message::binary(vec![1, 2, 3])).unwrap();
    }

    /// Reads one message, if there is one; false when the connection has ended.
    pub fn read(&mut self) -> bool {
        if self.holding && self.said.elapsed() > Duration::from_millis(60) {
            self.said = Instant::now();
            self.say(json!({"do": "hold"}));
        }
        match self.socket.read() {
            Ok(Message::Text(text)) => {
                let message: Value = serde_json::from_str(&text).unwrap();
                match message["is"].as_str().unwrap() {
                    "you" => self.you = message["you"].as_u64().unwrap(),
                    "hello" => self.hello = message,
                    "walls" => {
                        (self.walls, self.springs) = (message["walls"].clone(), message["springs"].clone());
                    }
                    "recorded" => self.recorded = Some(message["words"].as_str().unwrap().into()),
                    "plane" => self.plane = message["plane"].clone(),
                    "picture" => self.picture = message,
                    "refused" => self.refused.push(message),
                    "lost" => self.lost = Some(message["why"].as_str().unwrap().into()),
                    other => panic!("{other}"),
                }
                true
            }
            Ok(Message::Binary(bytes)) => {
                let numbers: Vec<f32> =
                    bytes.chunks_exact(4).map(|four| f32::from_le_bytes(four.try_into().unwrap())).collect();
                match numbers[0] {
                    1.0 => self.sweep = numbers,
                    2.0 => self.sound = numbers,
                    other => panic!("{other}"),
                }
                true
            }
            Ok(Message::Close(_)) => false,
            Ok(_) => true,
            Err(tungstenite::Error::Io(error))
                if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted) =>
            {
                true
            }
            Err(_) => false,
        }
    }

    /// Reads until something is so.
    pub fn until(&mut self, what: &str, is_so: impl Fn(&Self) -> bool) {
        let began = Instant::now();
        while !is_so(self) {
            assert!(began.elapsed() < PATIENCE, "{what}: {}\n{:?}", self.picture, self.refused);
            assert!(self.read(), "{what}: the connection has ended");
        }
    }

    /// Reads until the state is this one.
    pub fn until_state(&mut self, state: &str) {
        self.until(state, |page| page.picture["state"] == state);
    }

    /// Presses the key and keeps it down.
    pub fn arm(&mut self) {
        self.say(json!({"do": "arm"}));
        (self.holding, self.said) = (true, Instant::now());
        self.until_state("Armed");
    }

    /// Reads for so many seconds of the board's time; the key, where it is down, is pressed again should this process
    /// have been too slow to hold it.
    pub fn play(&mut self, seconds: f64) {
        let end = self.picture["time"].as_f64().unwrap() + seconds;
        while self.picture["time"].as_f64().unwrap() < end {
            assert!(self.read());
            if self.holding && self.picture["held"] == false {
                self.arm();
            }
        }
    }

    /// The newest refusal's words.
    pub fn why(&self) -> &str {
        self.refused.last().map_or("", |refused| refused["why"].as_str().unwrap())
    }

    /// Reads until there is a refusal that says this.
    pub fn until_refused(&mut self, words: &str) {
        self.until(words, |page| page.why().contains(words));
    }
}
