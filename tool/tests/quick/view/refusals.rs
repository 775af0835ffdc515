//! Refusals of the stage: pages that are not in command, the dead man's key, gains, scenes, and access to the page.

use super::{TestView, gains_message};
use crate::common::page::Received;
use crate::common::prelude::*;
use haptic_bridge::board::protocol::Disarm;
use haptic_host::link::{Wire, encode};
use haptic_show::view::hub::Hub;
use haptic_show::view::message::FromPage;
use haptic_show::view::{PageListener, Stage, World};
use postcard_rpc::Endpoint as _;
use postcard_rpc::header::{VarHeader, VarKey, VarSeq};
use serde_json::json;
use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tungstenite::{Message, WebSocket};

#[test]
fn one_page_commands_and_the_others_watch() {
    let mut view = TestView::demo();
    let (first, second) = (0, view.add_page());
    for message in [
        json!({"do": "arm", "seen": 1}),
        json!({"do": "take"}),
        json!({"do": "clear"}),
        json!({"do": "give"}),
        json!({"do": "record", "on": true}),
        json!({"do": "hand", "at": [0.0, 0.1]}),
        json!({"do": "wall", "wall": 0, "point": [0.0, 0.1]}),
        json!({"do": "gains", "wall": 0, "stiffness": 1.0, "damping": 1.0, "feed_forward": "off"}),
    ] {
        let before = view.page(second).refused.len();
        view.send(second, message);
        assert_eq!(view.page(second).refused.len(), before + 1);
        assert!(view.page(second).refusal().contains("another page is in command"), "{}", view.page(second).refusal());
        assert_eq!(view.page(second).refused[before]["of"], "watching");
    }
    let picture = &view.page(second).picture;
    assert_eq!((&picture["command"], &picture["pages"]), (&json!(view.pages[first].id), &json!(2)));
    assert_eq!(view.state(), "Disarmed");
    assert_eq!(view.page(second).walls, view.page(first).walls);
    view.send(first, json!({"do": "give"}));
    assert!(view.page(second).picture["command"].is_null());
    view.send(first, json!({"do": "arm", "seen": 1}));
    assert_eq!(view.page(first).refusal(), "no page is in command: take command first");
    view.send(second, json!({"do": "take"}));
    assert_eq!(view.page(first).picture["command"], view.pages[second].id);
}

#[test]
fn the_motors_are_on_only_while_the_key_is_down() {
    let (_, mut view) = TestView::on_real_board();
    view.arm(0);
    view.play(2.0);
    assert_eq!(view.state(), "Armed", "{:?}", view.page(0).refused);
    view.release();
    assert_eq!(view.state(), "Disarmed");
    // Silence of almost half a second releases the key. If the page then reports the key as down, the motors stay off.
    view.arm(0);
    view.pages[0].repeated = None;
    view.play(0.3);
    assert_eq!(view.state(), "Armed");
    view.play(0.18);
    assert_eq!(view.state(), "Disarmed");
    assert!(view.page(0).refusal().contains("no message from the page in command"), "{}", view.page(0).refusal());
    view.pages[0].repeated = Some(FromPage::Hold { seen: 0 });
    view.play(0.5);
    assert_eq!(view.state(), "Disarmed");
    // After five seconds other pages may take command.
    view.pages[0].repeated = None;
    view.play(4.9);
    assert!(!view.page(0).picture["command"].is_null());
    view.play(0.2);
    assert!(view.page(0).picture["command"].is_null());
}

/// Simulated motors cannot hurt a hand, so they stay on although a busy computer delays the page's messages.
#[test]
fn simulated_motors_stay_on_while_the_page_is_there() {
    let mut view = TestView::demo();
    let seen = view.page(0).step();
    view.play(2.0);
    view.send(0, json!({"do": "arm", "seen": seen}));
    view.pages[0].repeated = None;
    view.play(4.9);
    assert_eq!((view.state(), view.page(0).refused.len()), ("Armed", 0));
    view.play(0.2);
    assert_eq!((view.state(), &view.page(0).picture["command"]), ("Disarmed", &Value::Null));
}

/// If the tip is in a wall, pressing the key moves a simulated hand out. On a real board the user must move the tip.
#[test]
fn the_key_moves_a_simulated_hand_out_of_a_wall() {
    let mut view = TestView::demo();
    let press = |view: &mut TestView, seconds: f64| {
        let seen = view.page(0).step();
        view.pages[0].repeated = Some(FromPage::Hold { seen });
        view.send(0, json!({"do": "arm", "seen": seen}));
        view.play(seconds);
    };
    let inside = view.place_by_tip(-0.03, 0.0);
    for released in [true, false] {
        view.send(0, json!({"do": "hand", "at": inside}));
        view.play(1.0);
        assert!(view.depth() > 0.01, "{} m", view.depth());
        press(&mut view, 0.05);
        assert_eq!(view.state(), "Disarmed", "armed before the hand is out of the wall");
        if released {
            view.release();
        }
        view.play(1.0);
        assert_eq!((view.state(), view.page(0).refused.len()), (if released { "Disarmed" } else { "Armed" }, 0));
        assert!(view.depth() <= 0.0, "{} m", view.depth());
    }
    view.release();
    // The tip cannot leave this wall within its reach.
    let wall = |view: &TestView| json!({"do": "wall", "wall": 0, "point": view.place_by_tip(0.5, 0.0)});
    view.send(0, wall(&view));
    press(&mut view, 1.9);
    assert_eq!((view.state(), view.page(0).refused.len()), ("Disarmed", 0));
    view.play(0.3);
    assert_eq!(view.page(0).refused.last().unwrap()["of"], "inside", "{}", view.page(0).refusal());
    let (_, mut view) = TestView::on_real_board();
    view.send(0, wall(&view));
    press(&mut view, 0.02);
    assert_eq!(view.page(0).refused.last().unwrap()["of"], "inside", "{}", view.page(0).refusal());
}

/// A hung script or a queue may still report the key as down, but with old step numbers.
#[test]
fn a_key_reported_with_old_steps_is_released() {
    let (_, mut view) = TestView::on_real_board();
    view.arm(0);
    view.pages[0].repeated = None;
    let seen = view.page(0).step();
    for _ in 0..100 {
        view.hub.queue_incoming(view.pages[0].id, Ok(FromPage::Hold { seen }));
        view.step();
    }
    assert_eq!(view.state(), "Disarmed");
    assert!(view.page(0).refusal().contains("no message from the page in command"), "{}", view.page(0).refusal());
}

/// If the stage's thread or process stops, the board itself turns the motors off, even if it ignores a silent host.
#[test]
fn a_board_releases_the_key_if_the_stage_stops_reporting_it() {
    let (simulated, mut view) = TestView::on_real_board();
    view.arm(0);
    view.play(1.0);
    assert_eq!(simulated.lock().status().state, State::Armed);
    simulated.lock().run(0.4);
    assert_eq!(simulated.lock().status().state, State::Armed);
    simulated.lock().run(0.11);
    let status = simulated.lock().status();
    assert_eq!((status.state, status.fault.map(|record| record.fault)), (State::Fault, Some(Fault::KeyReleased)));
    // After the fault is cleared, only a new press arms again.
    view.play(0.1);
    view.send(0, json!({"do": "clear"}));
    view.play(0.5);
    assert_eq!(view.state(), "Disarmed");
}

/// An emulated board is slower than real time, so the page's silence is measured in real time. After a stall the stage
/// handles waiting messages of pages first, so that the stall does not count as silence.
#[test]
fn a_silent_page_releases_a_slow_board_too() {
    let (simulated, mut view) = TestView::on_real_board();
    view.arm(0);
    for heard_at_once in [true, false] {
        view.now += Duration::from_secs(3);
        if !heard_at_once {
            view.stage.turn(view.now).unwrap();
        }
        view.play(0.3);
        assert_eq!((view.state(), view.page(0).refused.len()), ("Armed", 0));
    }
    view.pages[0].repeated = None;
    let start_s = simulated.lock().time();
    for (silent, state) in [(0.3, "Armed"), (0.15, "Disarmed")] {
        let end = view.now + Duration::from_secs_f64(silent);
        while view.now < end {
            view.now += Duration::from_millis(18);
            view.step();
        }
        assert_eq!(view.state(), state, "{:?}", view.page(0).refused);
    }
    assert!(view.page(0).refusal().contains("no message from the page in command"), "{}", view.page(0).refusal());
    assert!(simulated.lock().time() - start_s < 0.3, "the board was not slower than real time");
}

/// With a slow network or a hung page, the user sees outdated states.
#[test]
fn a_page_with_half_a_second_of_delay_does_not_arm() {
    let (_, mut view) = TestView::on_real_board();
    for (late, armed) in [(0.2, "Armed"), (0.5, "Disarmed"), (2.0, "Disarmed")] {
        let seen = view.page(0).step();
        view.play(late);
        let before = view.page(0).refused.len();
        view.send(0, json!({"do": "arm", "seen": seen}));
        assert_eq!((view.state(), view.page(0).refused.len() - before), (armed, usize::from(armed != "Armed")));
        view.send(0, json!({"do": "release"}));
    }
    assert!(view.page(0).refusal().contains("press it again"), "{}", view.page(0).refusal());
}

#[test]
fn a_repeated_press_counts_once() {
    let (_, mut view) = TestView::on_real_board();
    view.arm(0);
    view.send(0, json!({"do": "arm", "seen": view.page(0).step()}));
    view.play(1.0);
    assert_eq!((view.state(), view.page(0).refused.len()), ("Armed", 0));
    view.pages[0].repeated = None;
    view.play(0.5);
    assert_eq!(view.state(), "Disarmed");
}

/// Even if watching pages flood the stage, it handles a release at once, and only a few of the other messages.
#[test]
fn flooding_pages_do_not_delay_a_release() {
    let world = World::demo().unwrap();
    let simulated = world.simulated.clone().unwrap();
    let mut view = TestView::in_command(world, None);
    let watching = [view.add_page(), view.add_page(), view.add_page()];
    view.arm(0);
    let flood = |view: &mut TestView| {
        for page in watching {
            for _ in 0..5_000 {
                view.hub.queue_incoming(view.pages[page].id, Err("noise".into()));
                view.hub.queue_incoming(view.pages[page].id, Ok(FromPage::Take {}));
            }
        }
    };
    for _ in 0..20 {
        flood(&mut view);
        view.step();
    }
    assert_eq!(view.state(), "Armed", "{:?}", view.page(0).refused);
    let before: Vec<usize> = watching.iter().map(|page| view.page(*page).refused.len()).collect();
    flood(&mut view);
    view.pages[0].repeated = None;
    view.hub.queue_incoming(view.pages[0].id, Ok(FromPage::Release {}));
    view.step();
    assert_eq!(simulated.lock().status().state, State::Disarmed, "the release was not handled in the next turn");
    for (page, before) in watching.into_iter().zip(before) {
        let refusal_count = view.page(page).refused.len() - before;
        assert!(refusal_count <= 64, "{refusal_count} of 10,000 messages were handled in that turn");
    }
}

#[test]
fn any_page_turns_the_motors_off() {
    let mut view = TestView::demo();
    let second = view.add_page();
    view.arm(0);
    view.send(second, json!({"do": "disarm"}));
    assert_eq!(view.state(), "Disarmed");
    // The key of the first page is still down.
    view.play(0.5);
    assert_eq!(view.state(), "Disarmed");
}

#[test]
fn a_page_that_leaves_releases_the_key() {
    let mut view = TestView::demo();
    let second = view.add_page();
    view.send(0, json!({"do": "hand", "at": view.place_by_tip(0.0, 0.0)}));
    view.arm(0);
    assert!(!view.page(second).picture["hand"].is_null());
    let first = view.pages.remove(0);
    view.hub.remove_page(first.id);
    view.play(0.02);
    assert_eq!(view.state(), "Disarmed");
    let picture = &view.page(0).picture;
    assert!(picture["command"].is_null() && picture["hand"].is_null() && picture["pages"] == 1, "{picture}");
}

/// The page shows why the motors went off, and that a real board has no simulated hand.
#[test]
fn motors_turned_off_by_another_tool_are_reported() {
    let (simulated, mut view) = TestView::on_real_board();
    view.send(0, json!({"do": "hand", "at": [0.0, 0.1]}));
    assert!(view.page(0).refusal().contains("not simulated"), "{}", view.page(0).refusal());
    view.arm(0);
    let header = VarHeader { key: VarKey::Key8(Disarm::REQ_KEY), seq_no: VarSeq::Seq2(7) };
    simulated.lock().receive(&encode(&header, &[]));
    view.play(0.5);
    assert!(view.page(0).refusal().contains("another tool turned the motors off"), "{}", view.page(0).refusal());
    assert_eq!(view.state(), "Disarmed");
}

#[test]
fn gains_beyond_the_boundary_need_confirmation() {
    let mut view = TestView::demo();
    view.wait_for_boundary();
    let gains = |stiffness: f64| gains_message(stiffness, 80.0, "off", false);
    // Beyond the boundary, as after the tip slid to a less stable place, turning the feed-forward off is refused, too.
    for (stiffness, refused) in [(8_700.0, 1), (39_000.0, 2)] {
        view.send(0, gains(stiffness));
        assert_eq!(view.page(0).refused.len(), refused);
        assert!(view.page(0).refusal().contains("predicted to be unstable"), "{}", view.page(0).refusal());
        assert_eq!(view.page(0).walls[0]["feed_forward"], "washout", "refused gains took effect");
        if refused == 1 {
            view.send(0, gains_message(40e3, 80.0, "washout", true));
            assert_eq!(view.page(0).walls[0]["stiffness"], 40_000.0);
        }
    }
    let repeated_request = view.page(0).refused[1]["again"].clone();
    view.send(0, repeated_request);
    assert_eq!(view.page(0).walls[0]["feed_forward"], "off");
    // Outside the boundary, softer gains need no confirmation.
    for softer in [7_500.0, 5_000.0] {
        view.send(0, gains(softer));
        assert_eq!(view.page(0).walls[0]["stiffness"], softer);
    }
    assert_eq!(view.page(0).refused.len(), 2);
    view.send(0, gains(-1.0));
    assert_eq!(view.page(0).refused.len(), 3);
}

/// A refusal repeats the requested gains. Gains that no board can render cannot be confirmed.
#[test]
fn refusals_name_the_gains_and_gains_have_an_upper_limit() {
    let mut view = TestView::demo();
    view.wait_for_boundary();
    let before = view.page(0).walls[0].clone();
    view.send(0, gains_message(8_700.0, 80.0, "off", false));
    let refusal = view.page(0).refused.last().unwrap().clone();
    assert_eq!((&refusal["of"], &refusal["again"]["stiffness"]), (&json!("gains"), &json!(8700.0)));
    assert!(view.page(0).refusal().starts_with("8.70 kN/m with 80.0 N s/m and feed-forward off"), "{refusal}");
    for (stiffness, damping) in [(1e9, 80.0), (8_700.0, 1e9)] {
        view.send(0, gains_message(stiffness, damping, "off", true));
        let refusal = view.page(0).refused.last().unwrap();
        assert!(refusal["again"].is_null() && refusal["of"] == "gains", "{refusal}");
        assert!(view.page(0).refusal().contains("that motors and rules allow here"), "{}", view.page(0).refusal());
    }
    assert_eq!(view.page(0).walls[0], before);
    // Rules that allow half of the force allow half of the stiffness.
    let [all, half] = [18.0, 9.0].map(|tip_force| {
        let mut world = World::demo().unwrap();
        let mut rules = world.board.rules().unwrap();
        rules.limits.tip_force = tip_force;
        world.board.set_rules(&rules).unwrap();
        let mut view = TestView::in_command(world, None);
        view.send(0, gains_message(1e9, 80.0, "off", false));
        let limit = view.page(0).refusal().split("above ").nth(1).and_then(|rest| rest.split(" MN/m").next());
        limit.unwrap_or_else(|| panic!("{}", view.page(0).refusal())).parse::<f64>().unwrap()
    });
    assert!((all / half - 2.0).abs() < 0.02, "{all}, {half}");
}

/// A wire that replaces the number [`CORRUPTED_NUMBER`] by a NaN while the flag is set.
struct CorruptingWire(Box<dyn Wire>, Arc<AtomicBool>);

const CORRUPTED_NUMBER: f32 = 8_765.432;

impl Wire for CorruptingWire {
    fn send(&mut self, bytes: &[u8]) -> std::io::Result<()> {
        self.0.send(bytes)
    }
    fn receive(&mut self, buffer: &mut [u8], timeout: Duration) -> std::io::Result<usize> {
        let count = self.0.receive(buffer, timeout)?;
        let number = CORRUPTED_NUMBER.to_le_bytes();
        if self.1.load(Ordering::Relaxed)
            && let Some(at) = buffer[..count].windows(4).position(|four| four == number)
        {
            buffer[at..at + 4].copy_from_slice(&[1, 1, 0xc1, 0x7f]);
        }
        Ok(count)
    }
    fn now(&self) -> Duration {
        self.0.now()
    }
}

/// JSON cannot represent NaN, so a page could not draw the scene.
#[test]
fn a_scene_with_a_nan_is_refused_and_not_sent() {
    let simulated = World::demo().unwrap().simulated.unwrap();
    let corrupt = Arc::new(AtomicBool::new(false));
    let open = || Board::over(Box::new(CorruptingWire(simulated.wire(), Arc::clone(&corrupt))), "a board").unwrap();
    let mut view = TestView::in_command(World::of(open(), None), None);
    let gains = |damping: f64| gains_message(f64::from(CORRUPTED_NUMBER), damping, "off", true);
    view.send(0, gains(80.0));
    let before = view.page(0).walls.clone();
    assert_eq!(before[0]["stiffness"], f64::from(CORRUPTED_NUMBER));
    corrupt.store(true, Ordering::Relaxed);
    view.send(0, gains(81.0));
    assert_eq!(view.page(0).walls, before);
    let refusal = view.page(0).refusal();
    assert!(refusal.contains("wall 0: stiffness and damping must be finite"), "{refusal}");
    drop(view);
    let failure = Stage::open(World::of(open(), None), Hub::default(), None, None).err().unwrap().to_string();
    assert!(failure.contains("wall 0: stiffness and damping must be finite"), "{failure}");
}

/// Serves the pages of a hub. Returns the address that the tool prints.
fn serve_pages(address: &str, hub: &Hub) -> String {
    let door = PageListener::open(address.parse().unwrap()).unwrap();
    let url = door.url().unwrap();
    door.serve(hub.clone());
    url
}

/// Splits an address into host and query.
fn split_url(url: &str) -> (&str, &str) {
    url.trim_start_matches("http://").split_once('/').unwrap()
}

fn http_request(host: &str, request: &str) -> String {
    let mut stream = TcpStream::connect(host).unwrap();
    stream.write_all(request.as_bytes()).unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer
}

fn connect_page(url: &str) -> WebSocket<TcpStream> {
    let (host, query) = split_url(url);
    let stream = TcpStream::connect(host).unwrap();
    let (socket, _) = tungstenite::client(format!("ws://{host}/live{query}"), stream).unwrap();
    socket.get_ref().set_read_timeout(Some(Duration::from_millis(10))).unwrap();
    socket
}

#[test]
fn the_page_is_served_only_to_this_computer() {
    let url = serve_pages("127.0.0.1:0", &Hub::default());
    let (host, _) = split_url(&url);
    let get =
        |path: &str, more: &str| http_request(host, &format!("GET {path} HTTP/1.1\r\nHost: {host}\r\n{more}\r\n"));
    let page = get("/", "");
    assert!(page.starts_with("HTTP/1.1 200 ") && page.contains("<title>haptic view</title>"), "{}", &page[..200]);
    assert!(page.contains("Content-Security-Policy: default-src 'none'"));
    assert!(get("/other", "").starts_with("HTTP/1.1 404 "));
    assert!(get("/live", "").starts_with("HTTP/1.1 400 "), "/live accepts only WebSockets");
    assert!(get("/", "Origin: http://evil.example\r\n").starts_with("HTTP/1.1 403 "));
    assert!(http_request(host, "GET / HTTP/1.1\r\nHost: evil.example\r\n\r\n").starts_with("HTTP/1.1 403 "));
    assert!(http_request(host, &format!("POST / HTTP/1.1\r\nHost: {host}\r\n\r\n")).starts_with("HTTP/1.1 400 "));
    assert!(http_request(host, "\0\x01\x02 what\r\n\r\n").starts_with("HTTP/1.1 400 "));
    // A browser keeps a spare connection and would take bytes from it for the reply to the next request.
    let (mut spare, mut received_text) = (TcpStream::connect(host).unwrap(), String::new());
    spare.shutdown(Shutdown::Write).unwrap();
    spare.read_to_string(&mut received_text).unwrap();
    assert_eq!(received_text, "", "a connection without a request received bytes");
}

#[test]
fn other_computers_need_the_token() {
    let hub = Hub::default();
    let url = serve_pages("0.0.0.0:0", &hub);
    let (host, query) = split_url(&url);
    assert_eq!(query.len(), "?token=".len() + 32, "{url}");
    assert!(!host.starts_with("0.0.0.0"), "another computer cannot open {url}");
    let get = |path: &str| http_request(host, &format!("GET {path} HTTP/1.1\r\nHost: {host}\r\n\r\n"));
    assert!(get("/").starts_with("HTTP/1.1 403 ") && get("/live").starts_with("HTTP/1.1 403 "));
    assert!(get(&format!("/{query}")).starts_with("HTTP/1.1 200 "));
    let (mut page, mut received) = (connect_page(&url), Received::default());
    while received.you == 0 {
        assert!(read_message(&mut page, &mut received));
    }
}

/// Connections without the token do not count towards the largest number of pages.
#[test]
fn connections_without_token_do_not_block_pages() {
    let url = serve_pages("0.0.0.0:0", &Hub::default());
    let (host, query) = split_url(&url);
    let stranger = |_| {
        let mut stream = TcpStream::connect(host).unwrap();
        let _ = stream.write_all(b"G");
        stream
    };
    let _crowd: Vec<_> = (0..200).map(stranger).collect();
    let page = http_request(host, &format!("GET /{query} HTTP/1.1\r\nHost: {host}\r\n\r\n"));
    assert!(page.starts_with("HTTP/1.1 200 "), "{page:?}");
}

/// Reads one message if there is one. Returns false if the connection has ended.
fn read_message(socket: &mut WebSocket<TcpStream>, received: &mut Received) -> bool {
    match socket.read() {
        Ok(Message::Text(text)) => received.receive_text(&text),
        Ok(Message::Binary(bytes)) => received.receive_bytes(&bytes),
        Ok(_) => {}
        Err(tungstenite::Error::Io(error)) => {
            return matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted);
        }
        Err(_) => return false,
    }
    true
}

#[test]
fn malformed_messages_are_refused() {
    let mut view = TestView::of(World::demo().unwrap(), None);
    let url = serve_pages("127.0.0.1:0", &view.hub);
    let (mut socket, mut received) = (connect_page(&url), Received::default());
    let texts = ["", "{", "null", "[1]", r#"{"do":"fly"}"#, r#"{"do":"hold","seen":1,"x":1}"#].map(Message::text);
    for (count, message) in (1..).zip(texts.into_iter().chain([Message::binary(vec![1, 2, 3])])) {
        socket.send(message).unwrap();
        while received.refused.len() < count {
            view.step();
            assert!(read_message(&mut socket, &mut received));
        }
        assert!(received.refusal().starts_with("not a message of this page"), "{}", received.refusal());
    }
    assert!(received.refusal().contains("binary"), "{}", received.refusal());
    // A message that is far too long ends only the connection that sent it.
    let mut other_page = connect_page(&url);
    let _ = other_page.send(Message::text("x".repeat(100_000)));
    while read_message(&mut other_page, &mut Received::default()) {
        view.step();
    }
    socket.send(Message::text(r#"{"do":"take"}"#)).unwrap();
    while received.picture["command"] != received.you || received.you == 0 {
        view.step();
        assert!(read_message(&mut socket, &mut received));
    }
}
