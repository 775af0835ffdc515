//! The page of `haptic view` as a file that needs no tool: the library, compiled to WebAssembly, behind the page in a
//! worker of the browser. `cargo xtask playground` puts page, worker (src/worker.js), what carries messages between the
//! two (src/page.js) and this together.
//!
//! The same stage stands behind the page that the tool has: simulated board, boundary, oscilloscope, the rule of the
//! key. A browser gives it neither threads nor a clock; it says what time it is at each [`turn`]. Ports and recordings
//! are left out.
//!
//! Numbers are all that can be handed over, so text and bytes lie in one buffer: who calls [`room`] writes it,
//! everything else leaves its answer there.

use haptic_host::device_file::DeviceFile;
use haptic_host::error::Failure;
use haptic_host::scene_file::SceneFile;
use haptic_show::view::hub::{Hub, Message, PageId};
use haptic_show::view::message::FromPage;
use haptic_show::view::{Stage, Turn, World};
use std::cell::RefCell;
use std::collections::VecDeque;
use std::time::Duration;

/// A shipped device, and what is around it.
struct Choice {
    name: &'static str,
    /// The device file; the demo has its own.
    device: Option<&'static str>,
    /// The scene file; else one wall stands in front of the tip.
    scene: Option<&'static str>,
}

macro_rules! shipped {
    ($name:literal, $device:literal) => {
        Choice { name: $name, device: Some(include_str!(concat!("../../devices/", $device, ".toml"))), scene: None }
    };
    ($name:literal, $device:literal, $scene:literal) => {
        Choice {
            scene: Some(include_str!(concat!("../../devices/scenes/", $device, "/", $scene, ".toml"))),
            ..shipped!($name, $device)
        }
    };
}

/// The worlds that can be looked at; the first is what `haptic view --port sim` shows.
const CHOICES: [Choice; 7] = [
    Choice { name: "coupled-five-bar: a wall that the feed-forward quiets", device: None, scene: None },
    shipped!("haply-2diy: a disc", "haply-2diy", "disc"),
    shipped!("haply-2diy: a groove", "haply-2diy", "groove"),
    shipped!("pantograph-mk2: a corner", "pantograph-mk2", "corner"),
    shipped!("hapkit-paddle: a wall", "hapkit-paddle", "wall"),
    shipped!("woodenhaptics: a wall", "woodenhaptics"),
    shipped!("phantom-premium-1.5: a wall", "phantom-premium-1.5"),
];

impl Choice {
    fn world(&self) -> Result<World, Failure> {
        let Some(device) = self.device else { return World::demo() };
        let file = DeviceFile::parse(device, self.name)?;
        let task = file.spec().task;
        let scene = match self.scene {
            Some(text) => Some(SceneFile::parse(text, self.name, task)?.scene::<f32>().map_err(Failure::wrong)?),
            None => None,
        };
        World::simulate(file, scene)
    }
}

/// A stage with one page before it.
struct Playground {
    stage: Stage,
    hub: Hub,
    page: PageId,
    /// Messages that the page has not fetched.
    waiting: VecDeque<Message>,
}

impl Playground {
    fn open(choice: &Choice) -> Result<Self, Failure> {
        let hub = Hub::default();
        let page = hub.come().ok_or_else(|| Failure::impossible("no page is let in"))?;
        let stage = Stage::open(choice.world()?, hub.clone(), None, None)?;
        Ok(Self { stage, hub, page, waiting: VecDeque::new() })
    }
}

thread_local! {
    static PLAYED: RefCell<Option<Playground>> = const { RefCell::new(None) };
    static BUFFER: RefCell<Vec<u8>> = const { RefCell::new(Vec::new()) };
}

fn answer(bytes: impl Into<Vec<u8>>) {
    BUFFER.replace(bytes.into());
}

/// Does something to what is played, if anything is.
fn with<R>(what: impl FnOnce(&mut Playground) -> R) -> Option<R> {
    PLAYED.with_borrow_mut(|played| played.as_mut().map(what))
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
    let opened = match CHOICES.get(choice) {
        Some(choice) => Playground::open(choice),
        None => Err(Failure::wrong(format!("there is no choice {choice}"))),
    };
    match opened {
        Ok(playground) => {
            PLAYED.replace(Some(playground));
            true
        }
        Err(failure) => {
            answer(failure.to_string());
            false
        }
    }
}

/// Takes in what the page says.
#[unsafe(no_mangle)]
pub extern "C" fn said() {
    let text = String::from_utf8(BUFFER.take()).map_err(|_| "not a message of this page: it is no text".to_string());
    with(|played| played.hub.said(played.page, text.and_then(|text| FromPage::parse(&text))));
}

/// Plays a little, `milliseconds` after the beginning: 1, and there may be more to catch up; 0, and simulated time is
/// where it should be; 2, and it is over: the buffer says why.
#[unsafe(no_mangle)]
pub extern "C" fn turn(milliseconds: f64) -> u32 {
    // A time that is not finite counts as none.
    let now = Duration::try_from_secs_f64(1e-3 * milliseconds).unwrap_or_default();
    match with(|played| played.stage.turn(now)) {
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
    let message = with(|played| {
        if played.waiting.is_empty() {
            played.waiting.extend(played.hub.take(played.page).messages());
        }
        played.waiting.pop_front()
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

    fn say(text: &str) {
        answer(text);
        said();
    }

    /// Plays for so many milliseconds from `from`; the newest picture, and everything that was refused.
    fn play(from: u32, milliseconds: u32) -> (String, Vec<String>) {
        let (mut picture, mut refused) = (String::new(), Vec::new());
        for millisecond in 0..milliseconds {
            assert!(turn(f64::from(from + millisecond)) < 2);
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
            let step = picture.split(r#""step":"#).nth(1).unwrap().split(',').next().unwrap();
            say(&format!(r#"{{"do":"arm","seen":{step}}}"#));
            let (armed, refused) = play(100, 200);
            assert!(armed.contains(r#""state":"Armed""#) && refused.is_empty(), "{name}: {armed} {refused:?}");
            // The page is not heard for half a second.
            let (silent, refused) = play(300, 300);
            assert!(silent.contains(r#""state":"Disarmed""#), "{name}: {silent}");
            assert!(refused[0].contains("was not heard"), "{name}: {refused:?}");
        }
        assert!(!open(names.lines().count()));
        assert!(String::from_utf8(BUFFER.take()).unwrap().contains("there is no choice 7"));
    }

    #[test]
    fn what_cannot_be_done_here_and_what_is_no_message_is_refused_in_words() {
        assert!(open(0));
        say(r#"{"do":"take"}"#);
        say(r#"{"do":"record","on":true}"#);
        say("nonsense");
        answer([0xff]);
        said();
        let (_, refused) = play(0, 40);
        for words in ["nothing can be recorded here", "not a message of this page", "it is no text"] {
            assert!(refused.iter().any(|text| text.contains(words)), "{words}: {refused:?}");
        }
    }
}
