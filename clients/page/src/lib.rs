//! The page of `haptic view` as a file that needs no tool. This library, compiled to WebAssembly, runs in a worker of
//! the browser. `cargo xtask playground` combines the page, the worker (src/worker.js), the code that carries messages
//! between the two (src/page.js) and this library.
//!
//! The page has the same stage as in the tool, without recordings. The worker passes the time to each [`turn`], because
//! a WebAssembly library has neither threads nor a clock.
//!
//! The tool's client talks to a board behind a serial port of the browser. While the client waits for a reply, the
//! browser suspends this library until bytes arrive (JavaScript Promise Integration). Meanwhile the worker must not
//! call functions that may wait ([`open_board`], [`turn`], [`finish`]), but may call [`said`] and [`room`], which pass
//! the page's messages to the hub. A page that hangs carries no bytes, so that the stage waits and cannot detect the
//! silence of the page; [`said`] detects it by the page's clock.
//!
//! Because functions can pass only numbers, text and bytes are in one buffer. The caller of [`room`] writes the buffer,
//! and every other function writes its result into the buffer.

mod port;

use haptic_host::device_file::DeviceFile;
use haptic_host::error::Failure;
use haptic_host::link::Board;
use haptic_show::view::hub::{Hub, Message, PageId};
use haptic_show::view::message::FromPage;
use haptic_show::view::stage::KEY_TIMEOUT;
use haptic_show::view::world::WORLDS;
use haptic_show::view::{Stage, Turn, World};
use std::cell::RefCell;
use std::collections::VecDeque;
use std::thread::LocalKey;
use std::time::Duration;

/// Returns the world of the board that the page has opened. Its links are drawn if it has the device of a shipped file.
fn connected_world() -> Result<World, Failure> {
    let mut board = Board::over(Box::new(port::PagePort), "USB")?;
    let loaded = board.device()?;
    let is_loaded =
        |file: &DeviceFile| matches!((file.device(), &loaded), (Ok(device), Some(loaded)) if device == *loaded);
    let mut files = WORLDS.iter().filter_map(|world| DeviceFile::parse(world.device, world.name).ok());
    Ok(World::of(board, files.find(is_loaded)))
}

/// The page's connection to the stage.
struct Page {
    hub: Hub,
    id: PageId,
    /// Messages that the page has not fetched yet.
    waiting: VecDeque<Message>,
    /// True if the page carries the bytes of a real board.
    has_board: bool,
    /// Time of the page's last message about its key, by the page's clock.
    key_time: Duration,
}

impl Page {
    /// Queues a message of the page that was sent at the time `at` of the page's clock.
    fn receive(&mut self, at: Duration, mut message: Result<FromPage, String>) {
        let before = match message {
            Ok(FromPage::Arm { .. } | FromPage::Hold { .. }) => std::mem::replace(&mut self.key_time, at),
            _ => at,
        };
        if matches!(message, Ok(FromPage::Hold { .. })) && self.has_board && at.saturating_sub(before) > KEY_TIMEOUT {
            message = Ok(FromPage::Release {});
        }
        self.hub.queue_incoming(self.id, message);
    }
}

thread_local! {
    // Separate cells, because the page sends messages while the stage waits for a board.
    static STAGE: RefCell<Option<Stage>> = const { RefCell::new(None) };
    static PAGE: RefCell<Option<Page>> = const { RefCell::new(None) };
    static BUFFER: RefCell<Vec<u8>> = const { RefCell::new(Vec::new()) };
}

fn set_buffer(bytes: impl Into<Vec<u8>>) {
    BUFFER.replace(bytes.into());
}

/// Applies `apply` to the content of a cell. Returns `None` if the cell is empty.
fn with_cell<T, R>(cell: &'static LocalKey<RefCell<Option<T>>>, apply: impl FnOnce(&mut T) -> R) -> Option<R> {
    cell.with_borrow_mut(|content| content.as_mut().map(apply))
}

/// Starts with a world. Returns false after a failure, with the reason in the buffer.
fn start(world: Result<World, Failure>) -> bool {
    let result = world.and_then(|world| {
        let hub = Hub::default();
        let id = hub.add_page().ok_or_else(|| Failure::impossible("no page can connect"))?;
        let has_board = world.simulated.is_none();
        STAGE.replace(Some(Stage::open(world, hub.clone(), None, None)?));
        PAGE.replace(Some(Page { hub, id, waiting: VecDeque::new(), has_board, key_time: Duration::ZERO }));
        Ok(())
    });
    result.map_err(|failure| set_buffer(failure.to_string())).is_ok()
}

/// Replaces the buffer by a buffer of `bytes` bytes and returns its address.
#[unsafe(no_mangle)]
pub extern "C" fn room(bytes: usize) -> *mut u8 {
    set_buffer(vec![0; bytes]);
    BUFFER.with_borrow_mut(|buffer| buffer.as_mut_ptr())
}

/// Returns the address of the buffer.
#[unsafe(no_mangle)]
pub extern "C" fn address() -> *const u8 {
    BUFFER.with_borrow(|buffer| buffer.as_ptr())
}

/// Returns the number of bytes in the buffer.
#[unsafe(no_mangle)]
pub extern "C" fn length() -> usize {
    BUFFER.with_borrow(Vec::len)
}

/// Starts with the simulated device of the demo; after a failure the buffer has the reason.
#[unsafe(no_mangle)]
pub extern "C" fn open() -> bool {
    start(World::demo())
}

/// Starts with the board behind the port that the page has opened. Returns false after a failure, with the reason in
/// the buffer.
#[unsafe(no_mangle)]
pub extern "C" fn open_board() -> bool {
    start(connected_world())
}

/// Ends the session with the motors off. A `lost` board turns its motors off by itself.
#[unsafe(no_mangle)]
pub extern "C" fn finish(lost: bool) {
    if let Some(mut stage) = STAGE.take() {
        // Ignores an error, because a board without a connection receives no key messages and turns its motors off.
        let _ = stage.end(lost);
    }
}

/// Queues the page's message in the buffer, which was sent at this time of the page's clock.
#[unsafe(no_mangle)]
pub extern "C" fn said(milliseconds: f64) {
    let text = String::from_utf8(BUFFER.take()).map_err(|_| "not a message of this page: it is not text".to_string());
    with_cell(&PAGE, |page| page.receive(duration(milliseconds), text.and_then(|text| FromPage::parse(&text))));
}

/// Converts milliseconds to a duration, and a time that is not finite to zero.
fn duration(milliseconds: f64) -> Duration {
    Duration::try_from_secs_f64(1e-3 * milliseconds).unwrap_or_default()
}

/// Runs one turn of the stage, `milliseconds` after the start. Returns 1 if simulated time may be late, 0 if it is up
/// to date, and 2 if the board is lost, with the reason in the buffer.
#[unsafe(no_mangle)]
pub extern "C" fn turn(milliseconds: f64) -> u32 {
    match with_cell(&STAGE, |stage| stage.turn(duration(milliseconds))) {
        Some(Ok(Turn::Played)) => 1,
        Some(Ok(Turn::Ahead)) | None => 0,
        Some(Err(error)) => {
            set_buffer(error.to_string());
            2
        }
    }
}

/// Puts the next message for the page into the buffer. Returns 1 for text, 2 for numbers, and 0 if there is no message.
#[unsafe(no_mangle)]
pub extern "C" fn next() -> u32 {
    let message = with_cell(&PAGE, |page| {
        if page.waiting.is_empty() {
            page.waiting.extend(page.hub.take_outbox(page.id).messages());
        }
        page.waiting.pop_front()
    });
    match message.flatten() {
        Some(Message::Text(text)) => {
            set_buffer(text);
            1
        }
        Some(Message::Bytes(bytes)) => {
            set_buffer(bytes);
            2
        }
        None => 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use haptic_host::haptic_bridge::safety::fault::{Fault, State};
    use haptic_host::link::{USB_PRODUCT, USB_VENDOR};
    use haptic_host::scene_file::SceneFile;
    use haptic_sim::{BoardOptions, SharedBoard, ready_board};

    fn send(text: &str) {
        send_at(0.0, text);
    }

    fn send_at(milliseconds: f64, text: &str) {
        set_buffer(text);
        said(milliseconds);
    }

    /// Runs the stage for `milliseconds` after the time `from`, ms. Returns the newest picture, and all refusals.
    fn play(from: u32, milliseconds: u32) -> (String, Vec<String>) {
        let (mut picture, mut refused) = (String::new(), Vec::new());
        for millisecond in 0..milliseconds {
            // Like the worker, repeats until simulated time is up to date, except for a board, which has its own time.
            let mut turned = 1;
            while turned == 1 {
                turned = turn(f64::from(from + millisecond));
                assert!(turned < 2);
                turned = if port::worker::PLUGGED.with_borrow(Option::is_some) { 0 } else { turned };
            }
            loop {
                match next() {
                    0 => break,
                    1 => {
                        let text = String::from_utf8(BUFFER.take()).unwrap();
                        if text.starts_with(r#"{"is":"picture""#) {
                            picture = text;
                        } else if text.contains(r#""is":"refused""#) {
                            refused.push(text);
                        }
                    }
                    _ => assert_eq!(length() % 4, 0),
                }
            }
        }
        (picture, refused)
    }

    #[test]
    fn every_world_opens_and_its_motors_go_on_and_off() {
        assert!(open(), "{}", String::from_utf8_lossy(&BUFFER.take()));
        send(r#"{"do":"take"}"#);
        for (world, name) in World::names().enumerate() {
            let from = 1000 * world as u32;
            send(&format!(r#"{{"do":"world","world":{world}}}"#));
            let (picture, refused) = play(from, 100);
            assert!(refused.is_empty(), "{name}: {refused:?}");
            arm(&picture);
            let (armed, refused) = play(from + 100, 200);
            assert!(armed.contains(r#""state":"Armed""#) && refused.is_empty(), "{name}: {armed} {refused:?}");
            send(r#"{"do":"release"}"#);
            let (released, _) = play(from + 300, 50);
            assert!(released.contains(r#""state":"Disarmed""#), "{name}: {released}");
        }
        send(r#"{"do":"world","world":8}"#);
        assert!(play(9000, 20).1[0].contains("there is no world 8"));
    }

    fn file() -> DeviceFile {
        DeviceFile::parse(WORLDS[0].device, WORLDS[0].name).unwrap()
    }

    /// Plugs a simulated board with a shipped device and a wall into the page's port.
    fn plug_in() -> SharedBoard {
        let file = file();
        let board = SharedBoard::new(ready_board(&file, BoardOptions::default()).unwrap());
        let scene = SceneFile::parse(WORLDS[0].scene.unwrap(), "scene", 2).unwrap().scene().unwrap();
        Board::over(board.wire(), "test").unwrap().set_scene(&scene).unwrap();
        port::worker::PLUGGED.replace(Some(board.wire()));
        board
    }

    fn arm(picture: &str) {
        let step = picture.split(r#""step":"#).nth(1).unwrap().split(',').next().unwrap();
        send(&format!(r#"{{"do":"arm","seen":{step}}}"#));
    }

    #[test]
    fn a_board_stops_its_motors_when_the_page_is_gone() {
        let board = plug_in();
        assert!(open_board(), "{}", String::from_utf8_lossy(&BUFFER.take()));
        turn(0.0);
        let mut texts = std::iter::from_fn(|| (next() == 1).then(|| String::from_utf8(BUFFER.take()).unwrap()));
        let hello = texts.find(|text| text.contains(r#""is":"hello""#)).unwrap();
        for part in [r#""simulated":false"#, r#""port":"USB""#, r#""device":"haply-2diy""#] {
            assert!(hello.contains(part), "{hello}");
        }
        send(r#"{"do":"take"}"#);
        let (picture, _) = play(0, 100);
        assert!(!picture.contains(r#""bars":[]"#), "the links of a shipped device are drawn: {picture}");
        send(r#"{"do":"gains","wall":0,"stiffness":123,"damping":1,"feed_forward":"off"}"#);
        arm(&picture);
        let (armed, refused) = play(100, 100);
        assert!(armed.contains(r#""state":"Armed""#) && refused.is_empty(), "{armed} {refused:?}");
        // The page and its worker end, so that no function is called any more.
        board.lock().run(1.0);
        let status = board.lock().status();
        assert_eq!(status.fault.map(|record| record.fault), Some(Fault::KeyReleased));
        let mut other = Board::over(board.wire(), "test").unwrap();
        assert_eq!(other.scene().unwrap().unwrap().walls[0].stiffness, 123.0);
    }

    /// While the page hangs, the stage receives no step of the board.
    #[test]
    fn a_page_that_hung_has_released_its_key() {
        let board = plug_in();
        assert!(open_board());
        send(r#"{"do":"take"}"#);
        let (picture, _) = play(0, 100);
        arm(&picture);
        play(100, 50);
        for (milliseconds, state) in [(350.0, State::Armed), (800.0, State::Disarmed), (900.0, State::Disarmed)] {
            send_at(milliseconds, r#"{"do":"hold","seen":1}"#);
            turn(150.0);
            assert_eq!(board.lock().status().state, state, "{milliseconds} ms");
        }
    }

    #[test]
    fn motors_are_off_at_the_end_and_an_unplugged_board_is_reported() {
        for is_unplugged in [false, true] {
            let board = plug_in();
            assert!(open_board());
            send(r#"{"do":"take"}"#);
            let (picture, _) = play(0, 100);
            arm(&picture);
            play(100, 100);
            assert_eq!(board.lock().status().state, State::Armed);
            if is_unplugged {
                port::worker::PLUGGED.replace(None);
                assert_eq!(turn(300.0), 2);
                let words = String::from_utf8(BUFFER.take()).unwrap();
                assert!(words.contains("unplugged") && words.contains("nothing is plugged in"), "{words}");
                assert!(!open_board());
            } else {
                finish(false);
                assert_eq!(board.lock().status().state, State::Disarmed);
            }
        }
    }

    #[test]
    fn a_board_without_a_scene_is_refused_with_a_remedy() {
        let board = SharedBoard::new(ready_board(&file(), BoardOptions::default()).unwrap());
        port::worker::PLUGGED.replace(Some(board.wire()));
        assert!(!open_board());
        let words = String::from_utf8(BUFFER.take()).unwrap();
        assert!(words.contains("haptic scene"), "{words}");
    }

    /// A browser lists only ports with the numbers that the page requests.
    #[test]
    fn the_page_requests_boards_by_their_usb_numbers() {
        let filter = format!("usbVendorId: {USB_VENDOR:#06x}, usbProductId: {USB_PRODUCT:#06x}");
        assert!(include_str!("page.js").contains(&filter), "{filter}");
    }

    #[test]
    fn recordings_and_invalid_messages_are_refused() {
        assert!(open());
        send(r#"{"do":"take"}"#);
        send(r#"{"do":"record","on":true}"#);
        send("nonsense");
        set_buffer([0xff]);
        said(0.0);
        let (_, refused) = play(0, 40);
        for words in ["recording is not available here", "not a message of this page", "it is not text"] {
            assert!(refused.iter().any(|text| text.contains(words)), "{words}: {refused:?}");
        }
    }
}
