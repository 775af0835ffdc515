//! `haptic view` in another process, and the messages that a page receives.

use super::Process;
use serde_json::Value;

/// Process of `haptic view`.
pub struct View {
    process: Process,
    /// Address of the page, as printed.
    pub url: String,
}

impl View {
    /// Starts `haptic view` on this computer at a free port.
    pub fn start(arguments: &[&str]) -> Self {
        let process = Process::start(&[&["view", "--listen", "127.0.0.1:0"], arguments].concat());
        let line = &process.first_line;
        let url = line.split_whitespace().nth(1).unwrap_or_else(|| panic!("{line:?}")).to_string();
        Self { process, url }
    }

    /// Returns host and port.
    pub fn address(&self) -> &str {
        self.url.trim_start_matches("http://").split('/').next().unwrap()
    }
}

/// Newest message of each kind that a page has received.
#[derive(Default)]
pub struct Received {
    pub you: u64,
    pub hello: Value,
    pub walls: Value,
    pub springs: Value,
    pub plane: Value,
    pub picture: Value,
    pub recorded: Option<String>,
    pub lost: Option<String>,
    pub refused: Vec<Value>,
    pub sweep: Vec<f32>,
    pub sound: Vec<f32>,
}

impl Received {
    pub fn receive_text(&mut self, text: &str) {
        let message: Value = serde_json::from_str(text).unwrap();
        let words = |key: &str| Some(message[key].as_str().unwrap().to_string());
        match message["is"].as_str().unwrap() {
            "you" => self.you = message["you"].as_u64().unwrap(),
            "hello" => self.hello = message,
            "walls" => (self.walls, self.springs) = (message["walls"].clone(), message["springs"].clone()),
            "plane" => self.plane = message["plane"].clone(),
            "picture" => self.picture = message,
            "recorded" => self.recorded = words("words"),
            "lost" => self.lost = words("why"),
            "refused" => self.refused.push(message),
            other => panic!("{other}"),
        }
    }

    pub fn receive_bytes(&mut self, bytes: &[u8]) {
        let number = |four: &[u8]| f32::from_le_bytes(four.try_into().unwrap());
        let numbers: Vec<f32> = bytes.chunks_exact(4).map(number).collect();
        match numbers[0] {
            1.0 => self.sweep = numbers,
            2.0 => self.sound = numbers,
            other => panic!("{other}"),
        }
    }

    pub fn refusal(&self) -> &str {
        self.refused.last().map_or("", |refused| refused["why"].as_str().unwrap())
    }

    pub fn state(&self) -> &str {
        self.picture["state"].as_str().unwrap_or_default()
    }

    pub fn step(&self) -> u32 {
        self.picture["step"].as_u64().unwrap_or(0) as u32
    }
}
