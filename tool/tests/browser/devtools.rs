//! Chromium without a screen, controlled by its remote debugging protocol (chromedevtools.github.io/devtools-protocol).

use serde_json::{Value, json};
use std::io::{BufRead, BufReader};
use std::net::TcpStream;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tungstenite::{Message, WebSocket};

/// Longest wait; only a page that hangs takes longer.
pub const TIMEOUT: Duration = Duration::from_secs(300);

const BROWSER_NAMES: [&str; 3] = ["chromium", "chromium-browser", "google-chrome"];
const NO_BROWSER: &str =
    "no Chromium on this computer: apt-get install -y --no-install-recommends chromium (on Debian, as root)";
/// A running browser with a new profile.
pub struct Browser {
    child: Child,
    socket: WebSocket<TcpStream>,
    _profile: tempfile::TempDir,
    count: u64,
    /// Host and port at which the browser listens.
    pub address: String,
    /// Events received so far, each with the session of its page.
    pub events: Vec<(String, Value)>,
}

/// A page, identified by its session and target.
#[derive(Clone, Debug)]
pub struct Tab {
    pub session: String,
    pub target: String,
}

/// Opens a new connection to the browser or to a page in it.
pub fn connect(address: &str, url: &str, patience: Duration) -> WebSocket<TcpStream> {
    let (socket, _) = tungstenite::client(url, TcpStream::connect(address).unwrap()).unwrap();
    socket.get_ref().set_read_timeout(Some(patience)).unwrap();
    socket
}

impl Browser {
    pub fn start() -> Self {
        let program =
            BROWSER_NAMES.iter().find(|name| Command::new(name).arg("--version").output().is_ok()).expect(NO_BROWSER);
        let profile = tempfile::tempdir().unwrap();
        let mut child = Command::new(program)
            .args(["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"])
            .args(["--disable-background-networking", "--disable-component-update", "--disable-sync"])
            .args(["--disable-dev-shm-usage", "--autoplay-policy=no-user-gesture-required"])
            .args([
                "--remote-debugging-port=0",
                &format!("--user-data-dir={}", profile.path().display()),
                "about:blank",
            ])
            .stderr(Stdio::piped())
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
        let url = loop {
            let line = lines.next().expect("Chromium ended before it printed its address").unwrap();
            if let Some(url) = line.strip_prefix("DevTools listening on ") {
                break url.to_string();
            }
        };
        // Reads all further output, so that the browser never blocks.
        std::thread::spawn(move || lines.for_each(drop));
        let address = url.trim_start_matches("ws://").split('/').next().unwrap().to_string();
        let socket = connect(&address, &url, Duration::from_millis(20));
        Self { child, socket, _profile: profile, count: 0, address, events: Vec::new() }
    }

    /// Opens a page with a window of this size.
    pub fn open(&mut self, url: &str, (width, height): (u32, u32), scale: f64) -> Tab {
        let target = self.call(None, "Target.createTarget", json!({"url": "about:blank", "newWindow": true}));
        let target = target["targetId"].as_str().unwrap().to_string();
        let attached = self.call(None, "Target.attachToTarget", json!({"targetId": target, "flatten": true}));
        let tab = Tab { session: attached["sessionId"].as_str().unwrap().into(), target };
        for domain in ["Network", "Page", "Runtime", "Log"] {
            self.call_page(&tab, &format!("{domain}.enable"), json!({}));
        }
        self.size(&tab, (width, height), scale);
        self.call_page(&tab, "Page.navigate", json!({"url": url}));
        tab
    }

    pub fn size(&mut self, tab: &Tab, (width, height): (u32, u32), scale: f64) {
        let size = json!({"width": width, "height": height, "deviceScaleFactor": scale, "mobile": width < 600});
        self.call_page(tab, "Emulation.setDeviceMetricsOverride", size);
    }

    pub fn close(&mut self, tab: &Tab) {
        self.call(None, "Target.closeTarget", json!({"targetId": tab.target}));
    }

    /// Calls a method on a page.
    pub fn call_page(&mut self, tab: &Tab, method: &str, parameters: Value) -> Value {
        self.call(Some(&tab.session), method, parameters)
    }

    fn call(&mut self, session: Option<&str>, method: &str, parameters: Value) -> Value {
        self.count += 1;
        let id = self.count;
        let mut message = json!({"id": id, "method": method, "params": parameters});
        if let Some(session) = session {
            message["sessionId"] = json!(session);
        }
        self.socket.send(Message::text(message.to_string())).unwrap();
        let start = Instant::now();
        loop {
            assert!(start.elapsed() < TIMEOUT, "no reply to {method}");
            let Some(answer) = self.read() else { continue };
            if answer["id"] == id {
                assert!(answer["error"].is_null(), "{method}: {}", answer["error"]);
                return answer["result"].clone();
            }
        }
    }

    fn read(&mut self) -> Option<Value> {
        match self.socket.read() {
            Ok(Message::Text(text)) => {
                let message: Value = serde_json::from_str(&text).unwrap();
                if message["id"].is_null() {
                    self.events.push((message["sessionId"].as_str().unwrap_or_default().into(), message.clone()));
                }
                Some(message)
            }
            Ok(_) => None,
            Err(tungstenite::Error::Io(error))
                if matches!(error.kind(), std::io::ErrorKind::WouldBlock | std::io::ErrorKind::TimedOut) =>
            {
                None
            }
            Err(error) => panic!("Chromium is gone: {error}"),
        }
    }

    /// Evaluates an expression on a page.
    pub fn evaluate(&mut self, tab: &Tab, expression: &str) -> Value {
        let answer = self.call_page(tab, "Runtime.evaluate", json!({"expression": expression, "returnByValue": true}));
        assert!(answer["exceptionDetails"].is_null(), "{expression}: {answer}");
        answer["result"]["value"].clone()
    }

    /// Waits until an expression is true on a page.
    pub fn wait_until(&mut self, tab: &Tab, expression: &str) {
        let start = Instant::now();
        while self.evaluate(tab, expression) != true {
            self.check_timeout(tab, start, expression);
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    fn check_timeout(&mut self, tab: &Tab, start: Instant, expression: &str) {
        if start.elapsed() > TIMEOUT {
            let page_state = self.evaluate(
                tab,
                "window.view && $('why').textContent + JSON.stringify({...view, trail: 0, sweep: 0, plane: 0})",
            );
            panic!("{expression} did not become true: {page_state}");
        }
    }

    /// Holds Space until an expression is true. If the page lost command because this computer was slow, takes command
    /// again, presses Space, which moves the hand out of a wall, and leads the hand back to `view.goal`.
    pub fn hold_until(&mut self, tab: &Tab, expression: &str) {
        const ARMED: &str = "document.body.dataset.state === 'Armed'";
        let start = Instant::now();
        while self.evaluate(tab, expression) != true {
            self.check_timeout(tab, start, expression);
            if self.evaluate(tab, ARMED) != true {
                self.send_space(tab, "keyUp");
                self.evaluate(tab, "if (view.last.command === null) $('take').click()");
                self.send_space(tab, "keyDown");
                let press_time = Instant::now();
                while self.evaluate(tab, ARMED) != true && press_time.elapsed() < Duration::from_secs(3) {
                    std::thread::sleep(Duration::from_millis(20));
                }
                self.evaluate(tab, "if (view.goal) say({do: 'hand', at: view.goal})");
            }
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Sends a mouse event of the type `what` at a place in CSS pixels.
    pub fn send_mouse(&mut self, tab: &Tab, what: &str, (x, y): (f64, f64)) {
        let down = u8::from(what != "mouseReleased");
        let event = json!({"type": what, "x": x, "y": y, "button": "left", "buttons": down, "clickCount": 1});
        self.call_page(tab, "Input.dispatchMouseEvent", event);
    }

    pub fn drag(&mut self, tab: &Tab, from: (f64, f64), to: (f64, f64)) {
        self.send_mouse(tab, "mousePressed", from);
        for step in 1..=10 {
            let share = f64::from(step) / 10.0;
            self.send_mouse(tab, "mouseMoved", (from.0 + share * (to.0 - from.0), from.1 + share * (to.1 - from.1)));
            std::thread::sleep(Duration::from_millis(25));
        }
        self.send_mouse(tab, "mouseReleased", to);
    }

    pub fn send_space(&mut self, tab: &Tab, what: &str) {
        let event = json!({"type": what, "key": " ", "code": "Space", "windowsVirtualKeyCode": 32});
        self.call_page(tab, "Input.dispatchKeyEvent", event);
    }

    /// Brings a page to the front, where it receives the keys.
    pub fn bring_to_front(&mut self, tab: &Tab) {
        self.call_page(tab, "Page.bringToFront", json!({}));
        self.call_page(tab, "Emulation.setFocusEmulationEnabled", json!({"enabled": true}));
    }

    /// Returns a screenshot of a page as PNG.
    pub fn save_picture(&mut self, tab: &Tab, whole: bool) -> Vec<u8> {
        let answer =
            self.call_page(tab, "Page.captureScreenshot", json!({"format": "png", "captureBeyondViewport": whole}));
        base64(answer["data"].as_str().unwrap())
    }

    /// Returns the addresses that pages have requested.
    pub fn requested_urls(&self) -> Vec<String> {
        let urls = self.events.iter().filter_map(|(_, event)| match event["method"].as_str()? {
            "Network.requestWillBeSent" => event["params"]["request"]["url"].as_str(),
            "Network.webSocketCreated" => event["params"]["url"].as_str(),
            _ => None,
        });
        urls.map(Into::into).collect()
    }

    /// Returns the exceptions and the errors on the console.
    pub fn console_errors(&self) -> Vec<String> {
        let page_errors = self.events.iter().filter(|(_, event)| match event["method"].as_str() {
            Some("Runtime.exceptionThrown") => true,
            Some("Log.entryAdded") => event["params"]["entry"]["level"] == "error",
            Some("Runtime.consoleAPICalled") => event["params"]["type"] == "error",
            _ => false,
        });
        page_errors.map(|(_, event)| event["params"].to_string()).collect()
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

pub fn base64(text: &str) -> Vec<u8> {
    let digit = |byte: u8| match byte {
        b'A'..=b'Z' => byte - b'A',
        b'a'..=b'z' => byte - b'a' + 26,
        b'0'..=b'9' => byte - b'0' + 52,
        b'+' => 62,
        _ => 63,
    };
    let mut bytes = Vec::with_capacity(text.len() * 3 / 4);
    let digits: Vec<u32> = text.bytes().filter(|byte| *byte != b'=').map(|byte| u32::from(digit(byte))).collect();
    for four in digits.chunks(4) {
        let number = four.iter().enumerate().fold(0, |number, (i, digit)| number | digit << (18 - 6 * i));
        bytes.extend(&number.to_be_bytes()[1..four.len()]);
    }
    bytes
}
