//! The page as a file with a board at a serial port of the browser. A fake of `navigator.serial` sends its bytes to a
//! simulated or an emulated board over the browser's debugging protocol, because the page has no network.

use super::LAPTOP;
use super::as_a_file::path;
use super::common::sim::{Sim, wait_until};
use super::common::{root, shipped_path};
use super::devtools::{Browser, TIMEOUT, Tab, base64, connect};
use haptic_bridge::safety::fault::{Fault, State};
use haptic_host::link::{Board, TcpWire};
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, ErrorKind, Read, Write};
use std::net::TcpStream;
use std::process::{Child, Command, Stdio};
use std::thread::{JoinHandle, spawn};
use std::time::{Duration, Instant};
use tungstenite::Message;

/// Fake serial port that behaves like Chromium's. `arrive` delivers bytes to the page, `toBoard` sends bytes to the
/// board, and `pull` unplugs the port.
const FAKE_PORT_SCRIPT: &str = r#"
    window.test = { asked: [], refuses: null };
    let incoming = null;
    const port = {
        readable: null, writable: null, setSignals: async () => {},
        open: async options => {
            if (test.refuses) throw new DOMException(test.refuses, "NetworkError");
            if (port.readable) throw new DOMException("The port is already open.", "InvalidStateError");
            test.options = options;
            port.readable = new ReadableStream({ start: control => { incoming = control; } });
            port.writable = new WritableStream({ write: bytes => toBoard(btoa(String.fromCharCode(...bytes))) });
        },
        close: async () => {
            if (port.readable.locked || port.writable.locked) throw new TypeError("Cannot close a locked stream");
            port.readable = port.writable = incoming = null;
        },
    };
    window.arrive = text => { try { incoming?.enqueue(Uint8Array.from(atob(text), c => c.charCodeAt(0))); } catch {} };
    window.pull = () => {
        incoming.error(new DOMException("The device has been lost.", "NetworkError"));
        port.readable = port.writable = incoming = null;
    };
    window.open_port = () => port.readable !== null;
    const requestPort = async what => { test.asked.push(what); return port; };
    Object.defineProperty(navigator, "serial", { configurable: true, value: { requestPort } });
"#;

const ARMED: &str = "document.body.dataset.state === 'Armed'";

/// Thread that connects the page's serial port with a board behind TCP. It returns the connection to the board.
struct Cable(JoinHandle<TcpStream>);

impl Cable {
    /// Connects the next page that this tab opens.
    fn plug(browser: &mut Browser, tab: &Tab, board: &str) -> Self {
        let url = format!("ws://{}/devtools/page/{}", browser.address, tab.target);
        let mut page = connect(&browser.address, &url, Duration::from_millis(2));
        let mut board = TcpStream::connect(board.trim_start_matches("tcp:")).unwrap();
        board.set_nodelay(true).unwrap();
        board.set_read_timeout(Some(Duration::from_millis(2))).unwrap();
        browser.call_page(
            tab,
            "Page.addScriptToEvaluateOnNewDocument",
            json!({"source": format!("{{{FAKE_PORT_SCRIPT}}}")}),
        );
        let call_page = |method: &str, parameters: Value| {
            Message::text(json!({"id": 1, "method": method, "params": parameters}).to_string())
        };
        for (method, parameters) in [("Runtime.enable", json!({})), ("Runtime.addBinding", json!({"name": "toBoard"}))]
        {
            page.send(call_page(method, parameters)).unwrap();
            // Wait for the reply, so that the method takes effect before the page loads.
            wait_until(method, || matches!(page.read(), Ok(Message::Text(text)) if text.contains(r#""id":1"#)));
        }
        Self(spawn(move || {
            let mut bytes = vec![0; 65_536];
            loop {
                match board.read(&mut bytes) {
                    Ok(0) => return board,
                    Ok(count) => {
                        let arrive = format!("window.arrive && arrive('{}')", to_base64(&bytes[..count]));
                        if page.send(call_page("Runtime.evaluate", json!({"expression": arrive}))).is_err() {
                            return board;
                        }
                    }
                    Err(_) => {}
                }
                loop {
                    match page.read() {
                        Ok(Message::Text(text)) => {
                            let event: Value = serde_json::from_str(&text).unwrap();
                            if event["method"] == "Runtime.bindingCalled" {
                                board.write_all(&base64(event["params"]["payload"].as_str().unwrap())).unwrap();
                            }
                        }
                        Ok(_) => {}
                        Err(tungstenite::Error::Io(error))
                            if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) =>
                        {
                            break;
                        }
                        // The browser or its page is gone.
                        Err(_) => return board,
                    }
                }
            }
        }))
    }

    /// Waits until the page is gone and returns the board.
    fn board(self) -> Board {
        Board::over(Box::new(TcpWire::new(self.0.join().unwrap()).unwrap()), "the cable's").unwrap()
    }
}

fn to_base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let four = |three: &[u8]| {
        let number = three.iter().enumerate().fold(0, |number, (i, byte)| number | usize::from(*byte) << (16 - 8 * i));
        [0, 1, 2, 3].map(|i| if i > three.len() { '=' } else { char::from(DIGITS[number >> (18 - 6 * i) & 63]) })
    };
    bytes.chunks(3).flat_map(four).collect()
}

/// Opens the page with a board plugged into its port. The page shows the simulation at first.
fn page(board: &str) -> (Browser, Tab, Cable) {
    let mut browser = Browser::start();
    let tab = browser.open("about:blank", LAPTOP, 1.0);
    let cable = Cable::plug(&mut browser, &tab, board);
    load_page(&mut browser, &tab);
    (browser, tab, cable)
}

fn load_page(browser: &mut Browser, tab: &Tab) {
    browser.call_page(tab, "Page.navigate", json!({"url": format!("file://{}", path())}));
    browser.wait_until(tab, "Boolean(window.view && view.hello?.simulated && view.pictures > 3)");
    browser.bring_to_front(tab);
}

/// Opens the board that is plugged in.
fn open(browser: &mut Browser, tab: &Tab) {
    browser.evaluate(tab, "view.pictures = 0; $('open').click()");
    let there = "view.hello?.simulated === false && view.pictures > 3 && document.body.dataset.role === 'command'";
    browser.wait_until(tab, there);
    assert_eq!(browser.evaluate(tab, "$('open').textContent"), "Close the board");
}

/// Holds Space until the motors are on. Presses Space again if page or board released the key on a slow computer.
fn hold_space(browser: &mut Browser, tab: &Tab) {
    let start = Instant::now();
    while browser.evaluate(tab, ARMED) != true {
        let notice = browser.evaluate(tab, "$('why').textContent");
        assert!(start.elapsed() < TIMEOUT, "the motors stay off: {notice}");
        browser.send_space(tab, "keyUp");
        browser.evaluate(tab, "if (view.last.command === null) $('take').click()");
        browser.evaluate(tab, "if (!$('clear').hidden) $('clear').click()");
        browser.wait_until(tab, "document.body.dataset.state === 'Disarmed'");
        browser.send_space(tab, "keyDown");
        for _ in 0..50 {
            if browser.evaluate(tab, ARMED) == true {
                break;
            }
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

/// Opens a board that can be armed, uses its gains and its key, and kills the browser with the motors on.
fn use_until_browser_dies(board: &str, device: &str, name: &str) {
    let (mut browser, tab, cable) = page(board);
    open(&mut browser, &tab);
    assert_eq!(browser.evaluate(&tab, "$('device').textContent"), device);
    let place_on = browser.evaluate(&tab, "$('board').textContent").as_str().unwrap().to_string();
    assert!(place_on.starts_with(name) && place_on.contains("on USB"), "{place_on}");
    browser.wait_until(&tab, "$('why').textContent.includes('real motors')");
    assert_eq!(browser.evaluate(&tab, "test.asked[0].filters[0].usbVendorId"), 0x1209);
    assert_eq!(browser.evaluate(&tab, "$('let-go').hidden && $('record').hidden"), true);
    // Scope and boundary are shown for this board.
    browser.wait_until(&tab, "view.sweeps > 5 && view.plane !== null");
    // New gains take effect on the board.
    browser.evaluate(&tab, "$('stiffness').value = '123'; $('stiffness').onchange()");
    browser.wait_until(&tab, "view.walls[0].stiffness === 123");
    // The motors go off if the key is released, if the page is hidden, and if the page hangs.
    hold_space(&mut browser, &tab);
    browser.send_space(&tab, "keyUp");
    browser.wait_until(&tab, "document.body.dataset.state === 'Disarmed'");
    hold_space(&mut browser, &tab);
    browser.evaluate(
        &tab,
        "Object.defineProperty(document, 'hidden', { value: true, configurable: true }); \
         document.dispatchEvent(new Event('visibilitychange')); delete document.hidden;",
    );
    browser.wait_until(&tab, "document.body.dataset.state === 'Disarmed' && !view.down");
    hold_space(&mut browser, &tab);
    // Block the page for 1.5 s of its own clock, because an emulated board is slow on a busy computer.
    browser.evaluate(&tab, "(() => { const until = performance.now() + 1500; while (performance.now() < until); })()");
    browser.wait_until(&tab, &format!("!({ARMED}) && !view.last.held"));
    browser.evaluate(&tab, "window.then = view.pictures");
    browser.wait_until(&tab, "view.pictures > then + 10");
    assert_eq!(browser.evaluate(&tab, ARMED), false, "a key that stayed down must not arm again");
    println!("{device}: {}", browser.evaluate(&tab, "view.last.losses"));
    if let Ok(folder) = std::env::var("HAPTIC_PICTURES") {
        std::fs::write(format!("{folder}/serial-{device}.png"), browser.save_picture(&tab, false)).unwrap();
    }
    hold_space(&mut browser, &tab);
    assert_eq!(browser.console_errors(), [""; 0]);
    drop(browser);
    let mut board = cable.board();
    wait_until("the motors off", || board.status().unwrap().state != State::Armed);
    // A page that had to wait may have released the key before the browser died.
    let fault = board.status().unwrap().fault.map(|record| record.fault);
    assert!(fault.is_none_or(|fault| fault == Fault::KeyReleased), "{fault:?}");
    assert_eq!(board.scene().unwrap().unwrap().walls[0].stiffness, 123.0);
}

fn simulated_board() -> Sim {
    Sim::start(&[&shipped_path("haply-2diy.toml"), "--scene", &shipped_path("scenes/haply-2diy/disc.toml")])
}

#[test]
fn a_simulated_board_disarms_when_the_browser_dies() {
    let sim = simulated_board();
    use_until_browser_dies(&sim.port, "haply-2diy", "simulated SIM");
}

/// Process of the emulated board.
struct Emulated(Child);

impl Drop for Emulated {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn the_emulated_board_disarms_when_the_browser_dies() {
    let default = root().join("target/debug/board").display().to_string();
    let program = std::env::var("HAPTIC_VIRTUAL_BOARD").unwrap_or(default);
    let board = Command::new(&program).stdout(Stdio::piped()).spawn();
    let mut board =
        board.unwrap_or_else(|error| panic!("{program}: {error}; `cargo xtask test --deep browser` makes it"));
    let mut lines = BufReader::new(board.stdout.take().unwrap()).lines().map(Result::unwrap);
    let _board = Emulated(board);
    let port = lines.find_map(|line| line.strip_prefix("port: ").map(String::from)).unwrap();
    let device = lines
        .find_map(|line| Some(line.split_whitespace().nth(2)?.to_string()).filter(|_| line.contains("haptic device")));
    // Reads all further output, so that the board never blocks.
    spawn(move || lines.for_each(drop));
    let tool = |arguments: &[&str]| drop(super::common::haptic(arguments).args(["--port", &port]).assert().success());
    tool(&["device", &device.unwrap()]);
    tool(&["scene", &shipped_path("scenes/pantograph-mk2/corner.toml")]);
    tool(&["home"]);
    tool(&["polarity", "--yes"]);
    use_until_browser_dies(&port, "pantograph-mk2", "odrive-v3");
}

#[test]
fn an_unplugged_board_is_reported_and_opened_again() {
    let sim = simulated_board();
    let (mut browser, tab, cable) = page(&sim.port);
    open(&mut browser, &tab);
    hold_space(&mut browser, &tab);
    browser.evaluate(&tab, "pull()");
    browser.wait_until(&tab, "document.body.dataset.state === 'Lost' && !view.down");
    let why = browser.evaluate(&tab, "$('why').textContent").as_str().unwrap().to_string();
    assert!(why.contains("The device has been lost") && why.contains("motors"), "{why}");
    browser.send_space(&tab, "keyUp");
    assert_eq!(browser.evaluate(&tab, "$('open').textContent"), "Open a board");
    // The simulation returns only on request.
    browser.evaluate(&tab, "window.then = view.pictures");
    std::thread::sleep(Duration::from_millis(1500));
    assert_eq!(browser.evaluate(&tab, "view.pictures === then && document.body.dataset.state === 'Lost'"), true);
    open(&mut browser, &tab);
    let mut board = close_armed_board(browser, &tab, cable);
    // If the page had to wait for half a second, the board has released the key by itself; then try again.
    let start = Instant::now();
    while board.status().unwrap().fault.is_some_and(|record| record.fault == Fault::KeyReleased) {
        assert!(start.elapsed() < TIMEOUT, "closing does not turn the motors off");
        board.clear().unwrap();
        drop(board);
        let (mut browser, tab, cable) = page(&sim.port);
        open(&mut browser, &tab);
        board = close_armed_board(browser, &tab, cable);
    }
    let status = board.status().unwrap();
    assert_eq!((status.state, status.fault), (State::Disarmed, None));
}

/// Closes the board in the page while its motors are on, and returns the board.
fn close_armed_board(mut browser: Browser, tab: &Tab, cable: Cable) -> Board {
    hold_space(&mut browser, tab);
    browser.evaluate(tab, "$('open').click()");
    let simulation = "view.hello?.simulated && view.pictures > 10";
    browser.wait_until(tab, &format!("{simulation} && !open_port()"));
    let name = "$('open').textContent === 'Open a board' && $('choice').selectedIndex === 0";
    assert_eq!(browser.evaluate(tab, name), true);
    assert_eq!(browser.console_errors(), [""; 0]);
    drop(browser);
    cable.board()
}

#[test]
fn a_refused_board_is_explained_and_the_simulation_continues() {
    let sim = Sim::start(&[&shipped_path("haply-2diy.toml")]);
    let (mut browser, tab, _cable) = page(&sim.port);
    let check_refusal = |browser: &mut Browser, words: &str| {
        browser.evaluate(&tab, "notice(''); view.pictures = 0; $('open').click()");
        let shows_cause = format!(
            "$('why').textContent.includes('{words}') && $('why').textContent.includes('The simulation continues')"
        );
        browser.wait_until(&tab, &format!("{shows_cause} && view.hello?.simulated && view.pictures > 10"));
        assert_eq!(
            browser
                .evaluate(&tab, "$('notice').classList.contains('shown') && $('open').textContent === 'Open a board'"),
            true
        );
    };
    browser.evaluate(&tab, "test.refuses = 'Failed to open serial port.'");
    check_refusal(&mut browser, "Failed to open serial port.");
    browser.evaluate(&tab, "test.refuses = null");
    check_refusal(&mut browser, "haptic scene");
    browser.wait_until(&tab, "!open_port()");
    // Closing the browser's list of ports changes nothing.
    browser.evaluate(
        &tab,
        "navigator.serial.requestPort = () => Promise.reject(new DOMException('', 'NotFoundError')); \
         notice(''); $('open').click(); view.pictures = 0",
    );
    browser.wait_until(&tab, "view.pictures > 10 && view.hello.simulated && !$('notice').classList.contains('shown')");
    // Some browsers have no serial ports or cannot suspend WebAssembly calls.
    for missing in ["navigator.serial", "WebAssembly.Suspending"] {
        let (of, name) = missing.split_once('.').unwrap();
        browser.evaluate(
            &tab,
            &format!(
                "delete {of}.{name}; Object.defineProperty({of}, '{name}', {{ value: undefined, configurable: true }})"
            ),
        );
        check_refusal(&mut browser, "Chrome or Edge on a desktop can");
        browser.evaluate(&tab, &format!("delete {of}.{name}"));
    }
    assert_eq!(browser.console_errors(), [""; 0]);
}
