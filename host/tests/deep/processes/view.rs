//! What `haptic view` says and hears, without a browser: who commands, the dead man's key, gains, walls, the
//! oscilloscope, and whom it lets in.

#[path = "../../common/page.rs"]
mod page;

use haptic::view::hub::{Event, Hub, PageId};
use haptic::view::message::FromPage;
use haptic::view::stability::Plane;
use haptic::view::{Stage, Turn, World};
use haptic_bridge::render::scene::FeedForward;
use page::{PATIENCE, Page, View};
use serde_json::{Value, json};
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};

fn simulated() -> View {
    View::start(&["--port", "sim"])
}

#[test]
fn one_page_commands_and_the_others_watch() {
    let view = simulated();
    let mut first = Page::in_command(&view);
    let mut second = Page::open(&view);
    for message in [
        json!({"do": "arm"}),
        json!({"do": "take"}),
        json!({"do": "clear"}),
        json!({"do": "give"}),
        json!({"do": "hand", "at": [0.0, 0.1]}),
        json!({"do": "wall", "wall": 0, "point": [0.0, 0.1]}),
        json!({"do": "gains", "wall": 0, "stiffness": 1.0, "damping": 1.0, "feed_forward": "off"}),
    ] {
        let before = second.refused.len();
        second.say(message.clone());
        second.until(&message.to_string(), |page| page.refused.len() > before);
        assert!(second.why().contains("another page is in command"), "{}", second.why());
    }
    second.until("the same pictures", |page| page.picture["command"] == first.you && page.picture["pages"] == 2);
    assert_eq!(second.picture["state"], "Disarmed");
    assert_eq!(second.walls, first.walls);
    first.say(json!({"do": "give"}));
    second.until("a free board", |page| page.picture["command"].is_null());
    first.say(json!({"do": "arm"}));
    first.until_refused("nobody is in command: take it first");
    second.say(json!({"do": "take"}));
    first.until("the other one in command", |page| page.picture["command"] == second.you);
}

#[test]
fn the_motors_are_on_only_while_the_key_is_down() {
    let view = simulated();
    let mut page = Page::in_command(&view);
    page.arm();
    page.play(0.6);
    assert_eq!(page.picture["state"], "Armed", "{:?}", page.refused);
    page.holding = false;
    page.say(json!({"do": "release"}));
    page.until_state("Disarmed");

    // Silence is letting go, and a key that is still down then does not arm.
    page.arm();
    page.holding = false;
    page.until_refused("was not heard");
    page.until_state("Disarmed");
    let later = page.picture["time"].as_f64().unwrap() + 0.5;
    page.holding = true;
    page.until("half a second", |page| page.picture["time"].as_f64().unwrap() > later);
    assert_eq!(page.picture["state"], "Disarmed");
}

#[test]
fn any_page_turns_the_motors_off() {
    let view = simulated();
    let mut first = Page::in_command(&view);
    let mut second = Page::open(&view);
    first.arm();
    second.say(json!({"do": "disarm"}));
    first.until_state("Disarmed");
    // The first one's key is still down.
    for _ in 0..20 {
        first.read();
    }
    assert_eq!(first.picture["state"], "Disarmed");
}

#[test]
fn a_page_that_is_gone_has_let_go() {
    let view = simulated();
    let mut first = Page::in_command(&view);
    let mut second = Page::open(&view);
    first.say(json!({"do": "hand", "at": first.picture["geometry"]["tip"]}));
    first.arm();
    second.until("a hand", |page| !page.picture["hand"].is_null());
    second.until_state("Armed");
    drop(first);
    second.until_state("Disarmed");
    second.until("nobody in command, no hand", |page| {
        page.picture["command"].is_null() && page.picture["hand"].is_null() && page.picture["pages"] == 1
    });
}

#[test]
fn gains_beyond_the_boundary_are_asked_about_first() {
    let view = simulated();
    let mut page = Page::in_command(&view);
    page.until("the boundary", |page| !page.plane.is_null());
    let gains = |stiffness: f64| json!({"do": "gains", "wall": 0, "stiffness": stiffness, "damping": 80.0, "feed_forward": "off"});
    page.say(gains(9_100.0));
    page.until_refused("predicted to be unstable");
    assert_eq!(page.walls[0]["feed_forward"], "washout", "nothing was changed");
    // Outside already, as when the tip slides to where less is stable: without the feed-forward even less would be.
    page.say(json!({"do": "gains", "wall": 0, "stiffness": 40e3, "damping": 80.0, "feed_forward": "washout", "beyond": true}));
    page.until("stiffer", |page| page.walls[0]["stiffness"] == 40_000.0);
    page.say(gains(39_000.0));
    page.until("a second refusal", |page| page.refused.len() == 2);
    assert!(page.why().contains("predicted to be unstable"), "{}", page.why());
    assert_eq!(page.walls[0]["feed_forward"], "washout", "nothing was changed");
    let again = page.refused.last().unwrap()["again"].clone();
    page.say(again);
    page.until("the gains", |page| page.walls[0]["feed_forward"] == "off");
    // Who is outside already is not asked again, and the way back is free.
    page.say(gains(7_500.0));
    page.until("softer", |page| page.walls[0]["stiffness"] == 7_500.0);
    page.say(gains(5_000.0));
    page.until("soft", |page| page.walls[0]["stiffness"] == 5_000.0);
    assert_eq!(page.refused.len(), 2);
    page.say(gains(-1.0));
    page.until("a refusal", |page| page.refused.len() == 3);
}

/// A page and its stage in this process: what time it is the test says, however busy the computer is.
struct Played {
    stage: Stage,
    events: Receiver<Event>,
    hub: Hub,
    page: PageId,
    now: Duration,
    picture: Value,
    plane: Value,
}

impl Played {
    fn demo() -> Self {
        let (hub, events) = Hub::new();
        let stage = Stage::open(World::demo().unwrap(), hub.clone(), None, None).unwrap();
        let page = hub.come().unwrap();
        let (picture, plane) = (Value::Null, Value::Null);
        let mut played = Self { stage, events, hub, page, now: Duration::ZERO, picture, plane };
        played.say(FromPage::Take {});
        played.say(FromPage::Arm {});
        played.play(0.8);
        played
    }

    fn say(&self, message: FromPage) {
        self.hub.said(self.page, Ok(message));
    }

    /// The ripple of every picture of the second half of these seconds.
    fn play(&mut self, seconds: f64) -> Vec<f64> {
        let (began, mut ripples) = (self.now, Vec::new());
        let half = began + Duration::from_secs_f64(0.5 * seconds);
        while self.now < began + Duration::from_secs_f64(seconds) {
            self.now += Duration::from_millis(6);
            self.say(FromPage::Hold {});
            while self.stage.turn(self.now, &self.events).unwrap() == Turn::Played {}
            let waiting = self.hub.take(self.page);
            for text in waiting.messages.iter().chain(&waiting.picture) {
                let message: Value = serde_json::from_str(text).unwrap();
                match message["is"].as_str().unwrap() {
                    "picture" => {
                        self.picture = message;
                        if self.now > half {
                            ripples.push(self.number("ripple"));
                        }
                    }
                    "plane" => self.plane = message["plane"].clone(),
                    "refused" => panic!("{message}"),
                    _ => {}
                }
            }
        }
        assert_eq!(self.picture["state"], "Armed", "{}", self.picture);
        ripples
    }

    fn number(&self, name: &str) -> f64 {
        self.picture["numbers"][name].as_f64().unwrap()
    }

    /// Clicks a kind of feed-forward, and means it.
    fn click(&self, (stiffness, damping): (f32, f32), feed_forward: FeedForward) {
        self.say(FromPage::Gains { wall: 0, stiffness, damping, feed_forward, beyond: true });
    }

    /// The largest stable stiffness by prediction, N/m; asked of the newest boundary, which is worked out beside the
    /// stage.
    fn stable_to(&mut self, feed_forward: FeedForward, damping: f32) -> f64 {
        let began = Instant::now();
        while self.plane.is_null() {
            assert!(began.elapsed() < PATIENCE);
            self.play(0.02);
        }
        let plane: Plane = serde_json::from_value(self.plane.clone()).unwrap();
        plane.stiffness_to(feed_forward, f64::from(damping))
    }
}

/// A page reddens a ripple above this, N.
const RED: f64 = 0.5;

/// The share of pictures that are red.
fn red(ripples: &[f64]) -> f64 {
    ripples.iter().filter(|ripple| **ripple > RED).count() as f64 / ripples.len() as f64
}

/// What the page is for: a hand presses the wall, one click takes the feed-forward away and the wall buzzes, another
/// brings it back and the wall is quiet; however deep the hand presses, and also to the side of where it began.
#[test]
fn one_click_makes_the_wall_buzz_and_another_quiets_it_while_it_is_pressed() {
    let mut page = Played::demo();
    let board = World::demo().unwrap().board.scene().unwrap().unwrap();
    let (wall, tip) = (&board.walls[0], page.picture["geometry"]["tip"].clone());
    let (gains, values) = ((wall.stiffness, wall.damping), wall.surface.values());
    let (normal, tip) = ([f64::from(values[3]), f64::from(values[4])], [0, 1].map(|i| tip[i].as_f64().unwrap()));
    let place = |depth: f64, aside: f64| {
        let along = [-normal[1], normal[0]];
        [0, 1].map(|i| tip[i] - 1e-3 * (depth * normal[i] - aside * along[i]))
    };
    let mut said = String::new();
    let mut as_it_should = true;
    let pressed =
        [(8.0, 0.0), (14.0, 0.0), (20.0, 0.0), (26.0, 0.0), (34.0, 0.0), (46.0, 0.0), (20.0, 6.0), (20.0, -6.0)];
    for (depth, aside) in pressed {
        page.say(FromPage::Hand { at: Some(tip) });
        page.play(0.8);
        page.say(FromPage::Hand { at: Some(place(depth, aside)) });
        let shares = [FeedForward::Washout, FeedForward::Off, FeedForward::Washout].map(|mode| {
            page.click(gains, mode);
            red(&page.play(1.6))
        });
        let [off, washout] = [FeedForward::Off, FeedForward::Washout].map(|mode| page.stable_to(mode, gains.1));
        let stiffness = f64::from(gains.0);
        said += &format!(
            "{depth} mm, {aside} mm aside: red {shares:.2?}, stable to {off:.0} off, {washout:.0} washed out\n"
        );
        as_it_should &= shares[0] < 0.05 && shares[1] > 0.7 && shares[2] < 0.05;
        as_it_should &= 1.1 * off < stiffness && stiffness < 0.95 * washout;
    }
    assert!(as_it_should, "a wall of {gains:?}:\n{said}");
    // Equation (4) pushes a resting hand sideways; behind the washout it does not.
    page.click(gains, FeedForward::Full);
    page.play(1.6);
    let sideways = page.number("sideways");
    assert!(sideways > 0.5, "{sideways}");
    println!("{said}");
}

#[test]
fn walls_are_moved_and_turned_while_the_motors_are_off() {
    let view = simulated();
    let mut page = Page::in_command(&view);
    page.say(json!({"do": "wall", "wall": 0, "point": [0.01, 0.125]}));
    page.until("the wall there", |page| page.walls[0]["values"][1].as_f64().is_some_and(|y| (y - 0.125).abs() < 1e-6));
    page.say(json!({"do": "wall", "wall": 0, "point": [0.01, 0.125], "normal": [3.0, 4.0]}));
    page.until("it turned", |page| page.walls[0]["values"][3].as_f64().is_some_and(|x| (x - 0.6).abs() < 1e-6));
    for (message, words) in [
        (json!({"do": "wall", "wall": 7, "point": [0.0, 0.0]}), "no wall 7"),
        (json!({"do": "wall", "wall": 0, "point": [0.0, 0.0], "normal": [0.0, 0.0]}), "points somewhere"),
        (json!({"do": "gains", "wall": 7, "stiffness": 1.0, "damping": 1.0, "feed_forward": "off"}), "no wall 7"),
    ] {
        page.say(message);
        page.until_refused(words);
    }
}

#[test]
fn the_oscilloscope_catches_the_touch_with_what_came_before() {
    let view = simulated();
    let mut page = Page::in_command(&view);
    let trigger = json!({"channel": "force_n", "level": 0.5, "rising": true, "before": 0.5, "once": true});
    page.say(json!({"do": "scope", "channels": ["force_n", "distance_m"], "seconds": 0.1, "trigger": trigger}));
    page.arm();
    page.play(0.6);
    assert!(page.sweep.is_empty(), "nothing was touched yet");
    let (tip, values) = (page.picture["geometry"]["tip"].clone(), page.walls[0]["values"].clone());
    let below = |i: usize| tip[i].as_f64().unwrap() - 0.02 * values[3 + i].as_f64().unwrap();
    page.say(json!({"do": "hand", "at": [below(0), below(1)]}));
    page.until("the sweep", |page| !page.sweep.is_empty());
    let (head, values) = page.sweep.split_at(6);
    // 0.1 s at 1 kHz: every row; the crossing stands in the middle.
    assert_eq!([head[1], head[4], head[5]], [3.0, 2.0, 100.0]);
    let force = |row: usize| values[2 * row];
    let crossing = (head[3] / head[2] * 99.0).round() as usize;
    assert!(force(crossing - 1) < 0.5 && force(crossing) >= 0.5, "{:?}", &values[..200]);
    assert!((0..40).all(|row| force(row) == 0.0), "the time before the touch is there");
    let before = page.refused.len();
    page.say(json!({"do": "scope", "channels": ["no"], "seconds": 0.1}));
    page.until("a refusal", |page| page.refused.len() > before);
    page.say(json!({"do": "sound", "on": true}));
    page.until("sound", |page| page.sound.len() > 2);
    assert_eq!(page.sound[1], 1000.0, "rows a second");
}

#[test]
fn what_is_no_message_is_refused_and_nothing_ends() {
    let view = simulated();
    let mut page = Page::in_command(&view);
    for (count, text) in ["", "{", "null", "[1]", r#"{"do":"fly"}"#, r#"{"do":"hold","x":1}"#].into_iter().enumerate() {
        page.say_text(text);
        page.until(text, |page| page.refused.len() > count);
        assert!(page.why().starts_with("not a message of this page"), "{}", page.why());
    }
    page.say_binary();
    page.until_refused("binary");
    // One that is far too long ends its own connection, and no other.
    let mut other = Page::open(&view);
    other.say_text(&"x".repeat(100_000));
    let began = Instant::now();
    while other.read() {
        assert!(began.elapsed() < PATIENCE);
    }
    page.arm();
}

#[test]
fn a_page_records_what_it_sees_and_it_plays_once_more() {
    let folder = tempfile::tempdir().unwrap();
    let view = View::start(&["--port", "sim", "--record-to", folder.path().to_str().unwrap()]);
    let mut page = Page::in_command(&view);
    let mut watcher = Page::open(&view);
    watcher.say(json!({"do": "record", "on": true}));
    watcher.until_refused("another page is in command");
    page.say(json!({"do": "record", "on": true}));
    page.until("rows", |page| page.picture["recording"]["rows"].as_u64().is_some_and(|rows| rows > 50));
    page.say(json!({"do": "record", "on": true}));
    page.until_refused("under way");
    page.arm();
    page.play(0.5);
    page.say(json!({"do": "record", "on": false}));
    page.until("its end", |page| page.recorded.is_some());
    let file = std::fs::read_dir(folder.path()).unwrap().next().unwrap().unwrap().path();
    let recording = haptic::recorder::Recording::load(&file).unwrap();
    let (words, rows) = (page.recorded.clone().unwrap(), recording.rows.len());
    assert!(!recording.torn && words.contains(&format!("{rows} rows, none lost")), "{words}");
    let armed = recording.rows.iter().filter(|row| row[recording.column("state").unwrap()] == 1.0).count();
    assert!(armed > 300, "{armed} of {rows}");
    assert!(haptic::replay::replay(&recording).unwrap().is_same());
}

#[test]
fn the_page_is_told_of_springs_and_of_where_they_hold() {
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../devices/");
    let scene = format!("{root}scenes/haply-2diy/groove.toml");
    let view = View::start(&[&format!("{root}haply-2diy.toml"), "--port", "sim", "--scene", &scene]);
    let page = Page::in_command(&view);
    assert_eq!(page.springs[0]["stiffness"], 250.0, "{}", page.springs);
    // The line y = 0.115: straight above or below the tip.
    let (tip, held) = (&page.picture["geometry"]["tip"], &page.picture["geometry"]["springs"][0]);
    let apart = (tip[0].as_f64().unwrap() - held[0].as_f64().unwrap()).abs();
    assert!(apart < 1e-6 && (held[1].as_f64().unwrap() - 0.115).abs() < 1e-6, "{tip}: {held}");
}

fn ask(view: &View, request: &str) -> String {
    let mut stream = TcpStream::connect(view.address()).unwrap();
    stream.write_all(request.as_bytes()).unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer
}

#[test]
fn the_page_is_served_to_whom_it_is_for() {
    let view = simulated();
    let host = view.address().to_string();
    let get = |path: &str, more: &str| ask(&view, &format!("GET {path} HTTP/1.1\r\nHost: {host}\r\n{more}\r\n"));
    let page = get("/", "");
    assert!(page.starts_with("HTTP/1.1 200 ") && page.contains("<title>haptic view</title>"), "{}", &page[..200]);
    assert!(page.contains("Content-Security-Policy: default-src 'none'"));
    assert!(get("/other", "").starts_with("HTTP/1.1 404 "));
    assert!(get("/live", "").starts_with("HTTP/1.1 400 "), "no WebSocket was asked for");
    assert!(get("/", "Origin: http://evil.example\r\n").starts_with("HTTP/1.1 403 "));
    assert!(ask(&view, "GET / HTTP/1.1\r\nHost: evil.example\r\n\r\n").starts_with("HTTP/1.1 403 "));
    assert!(ask(&view, &format!("POST / HTTP/1.1\r\nHost: {host}\r\n\r\n")).starts_with("HTTP/1.1 400 "));
    assert!(ask(&view, "\0\x01\x02 what\r\n\r\n").starts_with("HTTP/1.1 400 "));
}

#[test]
fn the_feed_forward_has_the_colours_of_the_pictures_of_haptic_range() {
    let folder = tempfile::tempdir().unwrap();
    let svg = folder.path().join("range.svg");
    let device = concat!(env!("CARGO_MANIFEST_DIR"), "/../devices/coupled-five-bar.toml");
    let range = ["range", device, "--normal", "0,1", "--kd", "5", "--washout", "2", "--svg", svg.to_str().unwrap()];
    assert_cmd::Command::cargo_bin("haptic").unwrap().args(range).assert().success();
    let svg = std::fs::read_to_string(svg).unwrap();
    // In a legend the line stands before its words.
    let lines: Vec<&str> = svg.lines().collect();
    let drawn = |words: &str| {
        let line = lines.windows(2).find(|pair| pair[1].contains(words)).expect(words)[0];
        line.split_once("stroke=\"").and_then(|(_, rest)| rest.split_once('"')).expect(line).0
    };
    let view = simulated();
    let page = ask(&view, &format!("GET / HTTP/1.1\r\nHost: {}\r\n\r\n", view.address()));
    for (name, words) in
        [("off", ">no feed-forward"), ("full", ">feed-forward (4)"), ("washout", ">feed-forward, washout")]
    {
        let shown = page.split_once(&format!("--{name}: ")).and_then(|(_, rest)| rest.split_once(';')).unwrap().0;
        assert_eq!(shown, drawn(words), "{name}");
    }
}

#[test]
fn other_computers_need_the_token() {
    let view = View::listen("0.0.0.0:0", &["--port", "sim"]);
    assert_eq!(view.query().len(), "token=".len() + 32, "{}", view.url);
    assert!(!view.address().starts_with("0.0.0.0"), "no browser of another computer opens {}", view.url);
    let host = view.address();
    let get = |path: &str| ask(&view, &format!("GET {path} HTTP/1.1\r\nHost: {host}\r\n\r\n"));
    assert!(get("/").starts_with("HTTP/1.1 403 ") && get("/live").starts_with("HTTP/1.1 403 "));
    assert!(get(&format!("/?{}", view.query())).starts_with("HTTP/1.1 200 "));
    Page::open(&view);
}

#[test]
fn every_shipped_device_can_be_looked_at() {
    for name in ["hapkit-paddle", "haply-2diy", "phantom-premium-1.5", "serial-3r", "fictive-five-bar-turret"] {
        let file = format!("{}/../devices/{name}.toml", env!("CARGO_MANIFEST_DIR"));
        let view = View::start(&[&file, "--port", "sim"]);
        let mut page = Page::in_command(&view);
        page.until(name, |page| {
            page.picture["geometry"]["bars"].as_array().is_some_and(|bars| !bars.is_empty()) && !page.plane.is_null()
        });
        assert_eq!(page.hello["device"], name);
        page.arm();
    }
}

struct Sim(Child);

/// A scene that ships.
fn scene() -> String {
    format!("{}/../devices/scenes/coupled-five-bar/wall.toml", env!("CARGO_MANIFEST_DIR"))
}

impl Sim {
    fn start(port: u16) -> Self {
        Self::with(port, &["--scene", &scene()])
    }

    fn with(port: u16, more: &[&str]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_haptic"));
        command.args(["sim", "--tcp", &port.to_string()]).args(more).stdout(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let mut line = [0; 1];
        child.stdout.as_mut().unwrap().read_exact(&mut line).unwrap();
        Self(child)
    }
}

impl Drop for Sim {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn a_board_that_is_lost_is_waited_for() {
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let sim = Sim::start(port);
    let view = View::start(&["--port", &format!("tcp:127.0.0.1:{port}")]);
    let mut page = Page::in_command(&view);
    page.arm();
    page.say(json!({"do": "hand", "at": [0.0, 0.1]}));
    page.until_refused("not simulated");
    drop(sim);
    page.until("its loss", |page| page.lost.is_some());
    page.holding = false;
    page.hello = serde_json::Value::Null;
    let _sim = Sim::start(port);
    page.until("its return", |page| !page.hello.is_null());
    page.until("nobody in command", |page| page.picture["command"].is_null());
    page.until_state("Disarmed");
}

/// The scene of a board that is switched off is gone, unless it was saved.
#[test]
fn a_board_that_comes_back_without_its_scene_is_waited_for_as_well() {
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let address = format!("tcp:127.0.0.1:{port}");
    let sim = Sim::start(port);
    let view = View::start(&["--port", &address]);
    let mut page = Page::open(&view);
    drop(sim);
    page.until("its loss", |page| page.lost.is_some());
    let _sim = Sim::with(port, &[]);
    page.until("what to do", |page| page.lost.as_ref().is_some_and(|why| why.contains("`haptic scene FILE`")));
    page.hello = serde_json::Value::Null;
    let scene = ["scene", &scene(), "--port", &address];
    assert_cmd::Command::cargo_bin("haptic").unwrap().args(scene).assert().success();
    page.until("its return", |page| !page.hello.is_null());
    page.until_state("Disarmed");
}

/// Whoever holds the key learns why the motors went off under it.
#[test]
fn motors_that_another_tool_turned_off_are_told() {
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let address = format!("tcp:127.0.0.1:{port}");
    let _sim = Sim::start(port);
    let view = View::start(&["--port", &address]);
    let mut page = Page::in_command(&view);
    page.arm();
    // The key stays held meanwhile.
    let mut disarm = Command::new(env!("CARGO_BIN_EXE_haptic"));
    let mut disarm = disarm.args(["disarm", "--port", &address]).stdout(Stdio::null()).spawn().unwrap();
    page.until_refused("another tool turned the motors off");
    assert!(disarm.wait().unwrap().success());
    page.until_state("Disarmed");
}

#[test]
fn a_folder_for_recordings_that_is_missing_is_told_at_the_start() {
    let view = ["view", "--port", "sim", "--listen", "127.0.0.1:0", "--record-to", "/nonexistent"];
    let refused = assert_cmd::Command::cargo_bin("haptic").unwrap().args(view).timeout(PATIENCE).assert().code(1);
    let said = String::from_utf8_lossy(&refused.get_output().stderr).into_owned();
    assert!(said.contains("/nonexistent is not there; make the folder first"), "{said}");
}
