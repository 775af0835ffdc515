//! The page of `haptic view` as a file that needs no tool: the library, compiled to WebAssembly, behind the page in a
//! worker of the browser. `cargo xtask playground` puts page, worker (src/worker.js), what carries messages between the
//! two (src/page.js) and this together.
//!
//! The same stage stands behind the page that the tool has: board, boundary, oscilloscope, the rule of the key. A
//! browser gives it neither threads nor a clock; it says what time it is at each [`turn`]. Recordings are left out.
//!
//! A board behind a serial port of the browser is spoken to by the tool's own client, which waits for answers. Where it
//! waits, the browser suspends this library until bytes have come (JavaScript Promise Integration). Until then nothing
//! that may wait is called again ([`open_board`], [`turn`], [`finish`]); [`said`] and [`room`] may be, and what the
//! page says goes to the hub meanwhile, as it does in the tool. A page that stands still carries no bytes either, so the
//! stage waits as long as the page is silent, and cannot know: [`said`] sees it by the page's own clock.
//!
//! Numbers are all that can be handed over, so text and bytes lie in one buffer: who calls [`room`] writes it,
//! everything else leaves its answer there.

mod port;

use haptic_host::device_file::DeviceFile;
use haptic_host::error::Failure;
use haptic_host::link::Board;
use haptic_host::scene_file::SceneFile;
use haptic_show::view::hub::{Hub, Message, PageId};
use haptic_show::view::message::FromPage;
use haptic_show::view::stage::SILENCE;
use haptic_show::view::{Stage, Turn, World};
use std::cell::RefCell;
use std::collections::VecDeque;
use std::thread::LocalKey;
use std::time::Duration;

/// A shipped device, and what is around it.
struct Choice {
    name: &'static str,
    /// The device file; the demo has its own.
    device: Option<&'static str>,
    /// The scene file and its name; else one wall stands in front of the tip.
    scene: Option<(&'static str, &'static str)>,
}

macro_rules! shipped {
    ($device:literal: $words:literal) => {
        Choice {
            name: concat!($device, ": ", $words),
            device: Some(include_str!(concat!("../../../devices/", $device, ".toml"))),
            scene: None,
        }
    };
    ($device:literal / $scene:literal: $words:literal) => {
        Choice {
            name: concat!($device, "/", $scene, ": ", $words),
            scene: Some(($scene, include_str!(concat!("../../../devices/scenes/", $device, "/", $scene, ".toml")))),
            ..shipped!($device: $words)
        }
    };
}

/// The worlds that can be looked at; the first is what `haptic view --port sim` shows. Links name them by what stands
/// before the colon.
const CHOICES: [Choice; 8] = [
    Choice { name: "coupled-five-bar: a wall that the feed-forward quiets", device: None, scene: None },
    shipped!("haply-2diy" / "disc": "a disc"),
    shipped!("haply-2diy" / "groove": "a groove"),
    shipped!("pantograph-mk2" / "corner": "a corner"),
    shipped!("hapkit-paddle" / "wall": "a wall"),
    shipped!("hapkit-paddle" / "slow": "a wall at 1 kHz"),
    shipped!("woodenhaptics": "a wall"),
    shipped!("phantom-premium-1.5": "a wall"),
];

impl Choice {
    fn file(&self) -> Result<Option<DeviceFile>, Failure> {
        Ok(self.device.map(|device| DeviceFile::parse(device, self.name)).transpose()?)
    }

    fn world(&self) -> Result<World, Failure> {
        let Some(file) = self.file()? else { return World::demo() };
        let task = file.spec().task;
        let scene = match self.scene {
            Some((_, text)) => Some(SceneFile::parse(text, self.name, task)?.scene::<f32>().map_err(Failure::wrong)?),
            None => None,
        };
        Ok(World { scene_name: self.scene.map(|(name, _)| name.into()), ..World::simulate(file, scene)? })
    }
}

/// The board that the page has opened. Its links are drawn where it has the device of a file that ships.
fn connected() -> Result<World, Failure> {
    let mut board = Board::over(Box::new(port::PagePort), "USB")?;
    let loaded = board.device()?;
    let is_loaded =
        |file: &DeviceFile| matches!((file.device(), &loaded), (Ok(device), Some(loaded)) if device == *loaded);
    let files = CHOICES.iter().filter_map(|choice| choice.file().ok().flatten());
    Ok(World::of(board, files.into_iter().find(is_loaded)))
}

/// The one page, before the stage.
struct Page {
    hub: Hub,
    id: PageId,
    /// Messages that it has not fetched.
    waiting: VecDeque<Message>,
    /// It carries the bytes of a board.
    carries: bool,
    /// When it last said that its key is down, by its own clock.
    held: Duration,
}

impl Page {
    /// Takes in what it says at a time of its own clock.
    fn says(&mut self, at: Duration, mut message: Result<FromPage, String>) {
        let before = match message {
            Ok(FromPage::Arm { .. } | FromPage::Hold { .. }) => std::mem::replace(&mut self.held, at),
            _ => at,
        };
        if matches!(message, Ok(FromPage::Hold { .. })) && self.carries && at.saturating_sub(before) > SILENCE {
            message = Ok(FromPage::Release {});
        }
        self.hub.said(self.id, message);
    }
}

thread_local! {
    // Two cells: the page is heard while the stage waits for a board.
    static STAGE: RefCell<Option<Stage>> = const { RefCell::new(None) };
    static PAGE: RefCell<Option<Page>> = const { RefCell::new(None) };
    static BUFFER: RefCell<Vec<u8>> = const { RefCell::new(Vec::new()) };
}

fn answer(bytes: impl Into<Vec<u8>>) {
    BUFFER.replace(bytes.into());
}

/// Does something to a cell's content, if it has any.
fn with<T, R>(cell: &'static LocalKey<RefCell<Option<T>>>, what: impl FnOnce(&mut T) -> R) -> Option<R> {
    cell.with_borrow_mut(|content| content.as_mut().map(what))
}

/// Begins with a world; where that fails, the buffer says why.
fn begin(world: Result<World, Failure>) -> bool {
    let begun = world.and_then(|world| {
        let hub = Hub::default();
        let id = hub.come().ok_or_else(|| Failure::impossible("no page is let in"))?;
        let carries = world.simulated.is_none();
        STAGE.replace(Some(Stage::open(world, hub.clone(), None, None)?));
        PAGE.replace(Some(Page { hub, id, waiting: VecDeque::new(), carries, held: Duration::ZERO }));
        Ok(())
    });
    begun.map_err(|failure| answer(failure.to_string())).is_ok()
}

/// Makes room for so many bytes, and says where.
#[unsafe(no_mangle)]
pub extern "C" fn room(bytes: usize) -> *mut u8 {
    answer(vec![0; bytes]);
    BUFFER.with_borrow_mut(|buffer| buffer.as_mut_ptr())
}

/// The address of the buffer.
#[unsafe(no_mangle)]
pub extern "C" fn address() -> *const u8 {
    BUFFER.with_borrow(|buffer| buffer.as_ptr())
}

/// Number of bytes in the buffer.
#[unsafe(no_mangle)]
pub extern "C" fn length() -> usize {
    BUFFER.with_borrow(Vec::len)
}

/// Writes the names of the worlds that can be looked at into the buffer, a line each.
#[unsafe(no_mangle)]
pub extern "C" fn choices() {
    answer(CHOICES.map(|choice| choice.name).join("\n"));
}

/// Begins, with one of these by its number; where that fails, the buffer says why.
#[unsafe(no_mangle)]
pub extern "C" fn open(choice: usize) -> bool {
    let choice = CHOICES.get(choice).ok_or_else(|| Failure::wrong(format!("there is no choice {choice}")));
    begin(choice.and_then(Choice::world))
}

/// Begins with the board behind the port that the page has opened; where that fails, the buffer says why.
#[unsafe(no_mangle)]
pub extern "C" fn open_board() -> bool {
    begin(connected())
}

/// Ends: the motors are off, unless the board was `lost`, which then turns them off itself.
#[unsafe(no_mangle)]
pub extern "C" fn finish(lost: bool) {
    if let Some(mut stage) = STAGE.take() {
        // A board that does not hear of this hears of no key either.
        let _ = stage.end(lost);
    }
}

/// Takes in what the page says, by its clock at so many milliseconds.
#[unsafe(no_mangle)]
pub extern "C" fn said(milliseconds: f64) {
    let text = String::from_utf8(BUFFER.take()).map_err(|_| "not a message of this page: it is no text".to_string());
    with(&PAGE, |page| page.says(time(milliseconds), text.and_then(|text| FromPage::parse(&text))));
}

/// A time that is not finite counts as none.
fn time(milliseconds: f64) -> Duration {
    Duration::try_from_secs_f64(1e-3 * milliseconds).unwrap_or_default()
}

/// Plays a little, `milliseconds` after the beginning: 1, and there may be more to catch up; 0, and simulated time is
/// where it should be; 2, and it is over: the buffer says why.
#[unsafe(no_mangle)]
pub extern "C" fn turn(milliseconds: f64) -> u32 {
    match with(&STAGE, |stage| stage.turn(time(milliseconds))) {
        Some(Ok(Turn::Played)) => 1,
        Some(Ok(Turn::Ahead)) | None => 0,
        Some(Err(error)) => {
            answer(error.to_string());
            2
        }
    }
}

/// Puts the next message for the page into the buffer: 1, a text; 2, numbers; 0, no message waits.
#[unsafe(no_mangle)]
pub extern "C" fn next() -> u32 {
    let message = with(&PAGE, |page| {
        if page.waiting.is_empty() {
            page.waiting.extend(page.hub.take(page.id).messages());
        }
        page.waiting.pop_front()
    });
    match message.flatten() {
        Some(Message::Text(text)) => {
            answer(text);
            1
        }
        Some(Message::Bytes(bytes)) => {
            answer(bytes);
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
    use haptic_sim::{BoardOptions, SharedBoard, ready_board};

    fn say(text: &str) {
        say_at(0.0, text);
    }

    fn say_at(milliseconds: f64, text: &str) {
        answer(text);
        said(milliseconds);
    }

    /// Plays for so many milliseconds from `from`; the newest picture, and everything that was refused.
    fn play(from: u32, milliseconds: u32) -> (String, Vec<String>) {
        let (mut picture, mut refused) = (String::new(), Vec::new());
        for millisecond in 0..milliseconds {
            // As the worker does: until simulated time is where it should be. A board has its own.
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
    fn every_choice_opens_and_its_motors_go_on_and_off() {
        choices();
        let names = String::from_utf8(BUFFER.take()).unwrap();
        for (index, name) in names.lines().enumerate() {
            assert!(open(index), "{name}: {}", String::from_utf8_lossy(&BUFFER.take()));
            say(r#"{"do":"take"}"#);
            let (picture, _) = play(0, 100);
            arm(&picture);
            let (armed, refused) = play(100, 200);
            assert!(armed.contains(r#""state":"Armed""#) && refused.is_empty(), "{name}: {armed} {refused:?}");
            say(r#"{"do":"release"}"#);
            let (released, _) = play(300, 50);
            assert!(released.contains(r#""state":"Disarmed""#), "{name}: {released}");
        }
        assert!(!open(names.lines().count()));
        assert!(String::from_utf8(BUFFER.take()).unwrap().contains("there is no choice 8"));
    }

    /// A simulated board with a device of the list and a wall, plugged in where the page's port is.
    fn plugged() -> SharedBoard {
        let file = CHOICES[1].file().unwrap().unwrap();
        let board = SharedBoard::new(ready_board(&file, BoardOptions::default()).unwrap());
        let scene = SceneFile::parse(CHOICES[1].scene.unwrap().1, "scene", 2).unwrap().scene().unwrap();
        Board::over(board.wire(), "test").unwrap().set_scene(&scene).unwrap();
        port::worker::PLUGGED.replace(Some(board.wire()));
        board
    }

    fn arm(picture: &str) {
        let step = picture.split(r#""step":"#).nth(1).unwrap().split(',').next().unwrap();
        say(&format!(r#"{{"do":"arm","seen":{step}}}"#));
    }

    #[test]
    fn a_board_is_opened_told_gains_and_armed_and_lets_go_when_the_page_is_gone() {
        let board = plugged();
        assert!(open_board(), "{}", String::from_utf8_lossy(&BUFFER.take()));
        turn(0.0);
        let mut texts = std::iter::from_fn(|| (next() == 1).then(|| String::from_utf8(BUFFER.take()).unwrap()));
        let hello = texts.find(|text| text.contains(r#""is":"hello""#)).unwrap();
        for part in [r#""simulated":false"#, r#""port":"USB""#, r#""device":"haply-2diy""#] {
            assert!(hello.contains(part), "{hello}");
        }
        say(r#"{"do":"take"}"#);
        let (picture, _) = play(0, 100);
        assert!(!picture.contains(r#""bars":[]"#), "the links of a device that ships are drawn: {picture}");
        say(r#"{"do":"gains","wall":0,"stiffness":123,"damping":1,"feed_forward":"off"}"#);
        arm(&picture);
        let (armed, refused) = play(100, 100);
        assert!(armed.contains(r#""state":"Armed""#) && refused.is_empty(), "{armed} {refused:?}");
        // The page is gone, and its worker with it: nothing of it is called any more.
        board.lock().run(1.0);
        let status = board.lock().status();
        assert_eq!(status.fault.map(|record| record.fault), Some(Fault::KeyReleased));
        let mut other = Board::over(board.wire(), "test").unwrap();
        assert_eq!(other.scene().unwrap().unwrap().walls[0].stiffness, 123.0);
    }

    /// The stage waits for bytes all the while, and of the board it hears of no step: no turn is called in between.
    #[test]
    fn a_page_that_stood_still_and_carried_nothing_has_let_go_whatever_it_says_next() {
        let board = plugged();
        assert!(open_board());
        say(r#"{"do":"take"}"#);
        let (picture, _) = play(0, 100);
        arm(&picture);
        play(100, 50);
        for (milliseconds, state) in [(350.0, State::Armed), (800.0, State::Disarmed), (900.0, State::Disarmed)] {
            say_at(milliseconds, r#"{"do":"hold","seen":1}"#);
            turn(150.0);
            assert_eq!(board.lock().status().state, state, "{milliseconds} ms");
        }
    }

    #[test]
    fn a_board_is_left_with_its_motors_off_and_one_that_is_pulled_ends_it_in_words() {
        for pulled in [false, true] {
            let board = plugged();
            assert!(open_board());
            say(r#"{"do":"take"}"#);
            let (picture, _) = play(0, 100);
            arm(&picture);
            play(100, 100);
            assert_eq!(board.lock().status().state, State::Armed);
            if pulled {
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
    fn a_board_without_a_scene_is_refused_and_says_what_to_do() {
        let file = CHOICES[1].file().unwrap().unwrap();
        let board = SharedBoard::new(ready_board(&file, BoardOptions::default()).unwrap());
        port::worker::PLUGGED.replace(Some(board.wire()));
        assert!(!open_board());
        let words = String::from_utf8(BUFFER.take()).unwrap();
        assert!(words.contains("haptic scene"), "{words}");
    }

    /// A browser lists the ports by these numbers alone.
    #[test]
    fn the_page_asks_for_the_boards_by_their_numbers_on_usb() {
        let filter = format!("usbVendorId: {USB_VENDOR:#06x}, usbProductId: {USB_PRODUCT:#06x}");
        assert!(include_str!("page.js").contains(&filter), "{filter}");
    }

    #[test]
    fn what_cannot_be_done_here_and_what_is_no_message_is_refused_in_words() {
        assert!(open(0));
        say(r#"{"do":"take"}"#);
        say(r#"{"do":"record","on":true}"#);
        say("nonsense");
        answer([0xff]);
        said(0.0);
        let (_, refused) = play(0, 40);
        for words in ["nothing can be recorded here", "not a message of this page", "it is no text"] {
            assert!(refused.iter().any(|text| text.contains(words)), "{words}: {refused:?}");
        }
    }
}
