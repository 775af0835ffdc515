//! `haptic view` without a browser: pages in command, dead man's key, gains, walls, oscilloscope, and access.

use crate::common::page::Received;
use crate::common::prelude::*;
use crate::common::{shipped_device, shipped_path};
use haptic_bridge::board::protocol::{Arm, Disarm};
use haptic_host::link::{Wire, encode};
use haptic_predict::wall_ahead::wall_ahead;
use haptic_show::recorder::Recording;
use haptic_show::view::hub::{Hub, Message as Sent, PageId};
use haptic_show::view::message::FromPage;
use haptic_show::view::stability::Plane;
use haptic_show::view::world::lead_hand;
use haptic_show::view::{PageListener, Stage, Turn, World};
use haptic_stability::analysis::control_loop::TorquePath;
use haptic_stability::analysis::flexible::Posture;
use haptic_stability::analysis::pose::Stance;
use haptic_stability::analysis::prediction::{Prediction, Subject};
use haptic_stability::analysis::range::BoundaryPoint;
use postcard_rpc::Endpoint as _;
use postcard_rpc::header::{VarHeader, VarKey, VarSeq};
use serde_json::json;
use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, TcpStream};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tungstenite::{Message, WebSocket};

/// A stage and its pages in this process. The test sets their clock, so a busy computer has no effect.
struct TestView {
    stage: Stage,
    hub: Hub,
    simulated: bool,
    now: Duration,
    pages: Vec<Page>,
}

struct Page {
    id: PageId,
    received: Received,
    /// Message that the page repeats: `Hold` while the key is down, otherwise `Here`. `None` for a silent page.
    repeated: Option<FromPage>,
}

impl TestView {
    fn of(world: World, folder: Option<&Path>) -> Self {
        let hub = Hub::default();
        let simulated = world.simulated.is_some();
        let stage = Stage::open(world, hub.clone(), None, folder.map(Into::into)).unwrap();
        Self { stage, hub, simulated, now: Duration::ZERO, pages: Vec::new() }
    }

    /// Starts the demo with a page in command.
    fn demo() -> Self {
        Self::in_command(World::demo().unwrap(), None)
    }

    fn in_command(world: World, folder: Option<&Path>) -> Self {
        let mut view = Self::of(world, folder);
        let page = view.add_page();
        view.send(page, json!({"do": "take"}));
        assert_eq!(view.pages[page].received.picture["command"], view.pages[page].id);
        view
    }

    /// Returns a simulated board that the view treats as a real board, and the view with a page in command.
    fn on_real_board() -> (SharedBoard, Self) {
        let simulated = World::demo().unwrap().simulated.unwrap();
        let board = Board::over(simulated.wire(), "a board").unwrap();
        (simulated, Self::in_command(World::of(board, None), None))
    }

    /// Connects a page and returns its number.
    fn add_page(&mut self) -> usize {
        let (id, received) = (self.hub.add_page().unwrap(), Received::default());
        self.pages.push(Page { id, received, repeated: Some(FromPage::Here {}) });
        self.play(0.02);
        self.pages.len() - 1
    }

    /// Sends a message of a page and lets the stage handle it.
    fn send(&mut self, page: usize, message: Value) {
        self.hub.queue_incoming(self.pages[page].id, FromPage::parse(&message.to_string()));
        self.play(0.02);
    }

    /// Presses the key of a page, keeps it down, and waits until the board is armed.
    fn arm(&mut self, page: usize) {
        let seen = self.page(page).step();
        self.pages[page].repeated = Some(FromPage::Hold { seen });
        self.send(page, json!({"do": "arm", "seen": seen}));
        // Rows arrive in batches, so the new state is in the next picture or the one after it.
        for _ in 0..2 {
            if self.state() != "Armed" {
                self.play(0.02);
            }
        }
        assert_eq!(self.state(), "Armed", "{:?}", self.pages[page].received.refused);
    }

    /// Releases the key of the first page.
    fn release(&mut self) {
        self.pages[0].repeated = Some(FromPage::Here {});
        self.send(0, json!({"do": "release"}));
    }

    /// Returns the tip's depth in the wall as the first page shows it, m.
    fn depth(&self) -> f64 {
        self.page(0).picture["numbers"]["depth"].as_f64().unwrap()
    }

    /// Returns the messages that a page has received.
    fn page(&self, page: usize) -> &Received {
        &self.pages[page].received
    }

    /// Returns the board's state as the last page shows it.
    fn state(&self) -> &str {
        self.pages.last().unwrap().received.state()
    }

    fn play(&mut self, seconds: f64) {
        let end = self.now + Duration::from_secs_f64(seconds);
        while self.now < end {
            self.step();
        }
    }

    /// Advances the clock of the stage by 6 ms and delivers the messages of pages and stage.
    fn step(&mut self) {
        self.now += Duration::from_millis(6);
        for page in &mut self.pages {
            if let Some(FromPage::Hold { seen }) = &mut page.repeated {
                *seen = page.received.step();
            }
            page.repeated.iter().for_each(|repeated| self.hub.queue_incoming(page.id, Ok(repeated.clone())));
        }
        while self.stage.turn(self.now).unwrap() == Turn::Played && self.simulated {}
        for Page { id, received, .. } in &mut self.pages {
            for message in self.hub.take_outbox(*id).messages() {
                match message {
                    Sent::Text(text) => received.receive_text(&text),
                    Sent::Bytes(bytes) => received.receive_bytes(&bytes),
                }
            }
        }
    }

    /// Waits for the newest boundary, which another thread computes.
    fn wait_for_boundary(&mut self) -> Plane {
        while self.page(0).plane.is_null() {
            self.play(0.02);
        }
        serde_json::from_value(self.page(0).plane.clone()).unwrap()
    }

    /// Returns the place at these distances from the tip along and across the first wall's normal, m.
    fn place_by_tip(&self, along: f64, across: f64) -> Value {
        let (tip, wall) = (&self.page(0).picture["geometry"]["tip"], &self.page(0).walls[0]["values"]);
        let [x, y, nx, ny] = [&tip[0], &tip[1], &wall[3], &wall[4]].map(|value| value.as_f64().unwrap());
        json!([x + along * nx - across * ny, y + along * ny + across * nx])
    }
}

/// Returns a request for gains of the first wall; `beyond` confirms unstable gains.
fn gains_message(stiffness: f64, damping: f64, feed_forward: &str, beyond: bool) -> Value {
    json!({
        "do": "gains", "wall": 0, "stiffness": stiffness, "damping": damping, "feed_forward": feed_forward,
        "beyond": beyond
    })
}

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

/// The boundary includes the device file's compliance, the scene's posture and the board's drive, and lists them.
#[test]
fn the_boundary_includes_compliance_posture_and_drive() {
    let cases = [
        ("cable-five-bar", "wall", "Transmissions: joints 0 and 1 are compliant as in the device file"),
        ("serial-3r", "wall-held", "Posture: the last link is held by"),
        ("haply-2diy", "wall-stiff", "Drive: a current loop that lags as 6.40 kHz does."),
    ];
    for (place, (name, scene, words)) in cases.into_iter().enumerate() {
        let (device, path) = (shipped_device(name), shipped_path(&format!("scenes/{name}/{scene}.toml")));
        let scene: Scene<f32> = SceneFile::load(Path::new(&path), device.spec().task).unwrap().scene().unwrap();
        let subject = Subject::new(&device.description).unwrap();
        let mut view = TestView::in_command(World::simulate(device, Some(scene.clone())).unwrap(), None);
        let plane = view.wait_for_boundary();
        assert!(plane.assumes.iter().any(|assumption| assumption.contains(words)), "{name}: {:?}", plane.assumes);
        let (scene, wall) = (scene.cast::<f64>(), scene.walls[0]);
        let Surface::Plane(surface) = wall.surface else { panic!("{name}: the wall is no plane") };
        let estimator = LinearEstimator::of(scene.estimator, scene.cutoff_hz).unwrap();
        let mut around = Loop::with_torque_path(&TorquePath::usual(scene.rate_hz), scene.rate_hz, estimator);
        around.damping_compensation = wall.damping_compensation;
        let posture = scene.posture.map(|held| Posture { stiffness: held.stiffness, damping: held.damping });
        let with = Prediction { admissible: scene.admissible, posture, ..Prediction::new(subject, around) };
        let mut without = with.clone();
        match place {
            0 => without.subject.joints = None,
            1 => without.posture = None,
            _ => without.around.drive = Drive::Ideal,
        }
        let normal: Vec<f64> = surface.normal[..usize::from(scene.task)].iter().map(|n| f64::from(*n)).collect();
        let [with, without] = [with, without].map(|prediction| {
            prediction.range(&plane.q, &[Member::new(normal.clone(), 1.0)], None, None).unwrap().off.boundary
        });
        let furthest = |other: &[BoundaryPoint]| {
            let kp_differences = plane.off.iter().zip(other).map(|(a, b)| (a.kp - b.kp).abs());
            kp_differences.fold(0.0, f64::max) / plane.off.iter().map(|point| point.kp).fold(0.0, f64::max)
        };
        let (with, without) = (furthest(&with), furthest(&without));
        assert!(with < 1e-3 && without > 2e-3, "{name}: {with} {without}");
    }
}

#[test]
fn every_page_may_request_the_limiting_effects() {
    let mut view = TestView::demo();
    let second = view.add_page();
    assert_eq!(view.wait_for_boundary().limits, None, "not requested");
    for (kind, name) in [(FeedForward::Washout, "washout"), (FeedForward::Off, "off")] {
        view.send(0, gains_message(3000.0, 80.0, name, false));
        // A watching page may also request the effects.
        view.send(second, json!({"do": "explain"}));
        let limits = loop {
            match view.wait_for_boundary().limits {
                Some(limits) if limits.feed_forward == kind => break limits,
                _ => view.play(0.02),
            }
        };
        let top = view.wait_for_boundary().boundary(kind).iter().map(|point| point.kp).fold(0.0, f64::max);
        assert!((limits.stiffness.unwrap() / top - 1.0).abs() < 3e-3, "{limits:?} {top}");
        let names: Vec<&str> = limits.without.iter().map(|without| without.effect.as_str()).collect();
        // The device is rigid and has no posture, so compliance and posture are not listed.
        assert_eq!(names, ["sampling", "delay", "drive", "filter", "joint damping", "empty hand"]);
        assert!(limits.without.iter().all(|without| without.stiffness.is_some_and(|kp| kp > 0.9 * top)), "{limits:?}");
        assert!((1e-6..1e-4).contains(&limits.count), "{limits:?}");
    }
}

#[test]
fn gains_beyond_the_boundary_show_their_buzz_frequency() {
    let mut view = TestView::demo();
    view.wait_for_boundary();
    assert!(view.page(0).picture["buzz"].is_null(), "a stable wall must not buzz");
    // With the hand in contact, which a page shows at 73 Hz.
    view.arm(0);
    let place = view.place_by_tip(-0.03, 0.0);
    view.send(0, json!({"do": "hand", "at": place}));
    view.send(0, gains_message(8700.0, 80.0, "off", true));
    view.play(1.5);
    let buzz = &view.page(0).picture["buzz"];
    let (hz, growth) = (buzz["hz"].as_f64().unwrap(), buzz["growth_per_s"].as_f64().unwrap());
    assert!((hz - 73.5).abs() < 1.0 && growth > 0.0, "{buzz}");
}

/// A page that loses its connection shows a notice about the last known state of the motors.
#[test]
fn the_notice_for_a_lost_connection_is_sent_in_advance() {
    let if_lost = |view: &TestView| view.page(0).picture["if_lost"].as_str().unwrap_or_default().to_string();
    assert!(if_lost(&TestView::demo()).contains("simulated board is gone"));
    let (simulated, mut view) = TestView::on_real_board();
    assert_eq!(if_lost(&view), "the motors were off in the last picture");
    view.arm(0);
    view.play(0.1);
    assert!(if_lost(&view).contains("half a second after the last message about the key"), "{}", if_lost(&view));
    view.release();
    view.play(0.1);
    assert!(if_lost(&view).contains("were off"), "{}", if_lost(&view));
    // Another tool arms the board, which does not watch its host.
    let header = VarHeader { key: VarKey::Key8(Arm::REQ_KEY), seq_no: VarSeq::Seq2(7) };
    simulated.lock().receive(&encode(&header, &[]));
    view.play(0.5);
    assert_eq!(view.state(), "Armed");
    assert!(if_lost(&view).contains("MAY BE ON"), "{}", if_lost(&view));
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

/// A paddle's wall is drawn as a line across the arc of the tip, with a solid side.
#[test]
fn the_wall_of_a_paddle_is_placed_on_its_arc() {
    let view = TestView::in_command(World::simulate(shipped_device("hapkit-paddle"), None).unwrap(), None);
    let wall = &view.page(0).walls[0];
    let [at, normal] = ["at", "normal"].map(|key| [0, 1].map(|axis| wall["outline"][key][axis].as_f64().unwrap()));
    let (arc, length) = (wall["values"][0].as_f64().unwrap(), 0.07);
    let (sine, cosine) = (arc / length).sin_cos();
    assert!((at[0] - length * cosine).abs() < 1e-6 && (at[1] - length * sine).abs() < 1e-6);
    // The normal points out of the solid along the arc.
    assert!((normal[0] * at[0] + normal[1] * at[1]).abs() < 1e-6 && normal[1] > 0.9);
}

/// Ripple above which the page turns red, N.
const RED_RIPPLE_N: f64 = 0.5;

/// The linkage stays on the same side of every singularity, also if the motors go off in a displaced pose, or if the
/// hand releases the tip in a wall and the wall throws the tip out.
#[test]
fn leading_the_hand_never_folds_the_linkage() {
    let planar = ["cable-five-bar", "capstan-pantograph", "haply-2diy", "pantograph-mk2", "serial-3r"];
    let scenes = planar.map(|name| Some((name, wall_ahead(&shipped_device(name)).unwrap())));
    for scene in scenes.into_iter().chain([None]) {
        for (goal, releases, seconds) in
            [(None, true, 0.4), (Some([0.02, -0.1]), false, 0.2), (Some([0.5, 0.4]), false, 0.2)]
        {
            let mut world = match scene.clone() {
                Some((name, scene)) => World::simulate(shipped_device(name), Some(scene)).unwrap(),
                None => World::demo().unwrap(),
            };
            let mut scene = world.board.scene().unwrap().unwrap();
            scene.walls[0].feed_forward = FeedForward::Full;
            world.board.set_scene(&scene).unwrap();
            let Surface::Plane(plane) = &scene.walls[0].surface else { panic!("a wall is a plane") };
            let board = world.simulated.clone().unwrap();
            let device = world.file.as_ref().unwrap().device::<f64>().unwrap();
            let stance = || Stance::of(&device.mechanism, &board.lock().device().q()[..device.axes()]).unwrap();
            let (before, tip) = (stance(), board.lock().device().tip());
            let goal = goal.unwrap_or(core::array::from_fn(|i| tip[i] - 0.07 * f64::from(plane.normal[i])));
            world.board.arm().unwrap();
            lead_hand(&board, Some(goal));
            let plays = |seconds: f64| {
                for _ in 0..(200.0 * seconds) as usize {
                    board.lock().run(0.005);
                    let now = stance();
                    let is_same = now.is_clear(0.045) && now.positive == before.positive;
                    assert!(is_same, "{}, led to {goal:?}: {now:?}", device.name);
                }
            };
            plays(0.3);
            match releases {
                true => lead_hand(&board, None),
                false => world.board.disarm().unwrap(),
            }
            plays(seconds);
        }
    }
}

/// Starting over resets pose, walls, gains and hand. In a simulation it is also the remedy for a fault.
#[test]
fn a_simulation_starts_over_and_arms_again() {
    let world = World::demo().unwrap();
    let board = world.simulated.clone().unwrap();
    let mut view = TestView::in_command(world, None);
    let (walls, before) = (view.page(0).walls.clone(), view.depth());
    assert!((before + 0.010).abs() < 1e-4, "the wall is 10 mm away, not {before} m");
    for broken in [true, false] {
        view.arm(0);
        let (place, wall) = (view.place_by_tip(-0.03, 0.01), view.place_by_tip(0.005, 0.0));
        view.send(0, json!({"do": "hand", "at": place}));
        view.play(0.8);
        view.send(0, gains_message(3000.0, 20.0, "full", true));
        if broken {
            let far_angles = board.lock().device().start().map(|angle| angle + 0.5);
            board.lock().device_mut().place(far_angles);
            view.play(0.1);
            let words = view.page(0).picture["fault"].as_str().unwrap().to_string();
            assert!(words.contains("start over") && !words.contains("cable"), "{words}");
        } else {
            view.release();
            view.send(0, json!({"do": "wall", "wall": 0, "point": wall}));
        }
        assert_ne!(view.page(0).walls, walls);
        view.pages[0].repeated = Some(FromPage::Here {});
        view.send(0, json!({"do": "start-over"}));
        view.play(0.2);
        let picture = &view.page(0).picture;
        assert_eq!((view.state(), &picture["fault"], &picture["hand"]), ("Disarmed", &Value::Null, &Value::Null));
        assert_eq!((&view.page(0).walls, view.page(0).refused.len()), (&walls, 0));
        assert!((view.depth() - before).abs() < 1e-4, "{} m", view.depth());
    }
    for (pose, refusals) in [(json!([1.7, 1.1]), 0), (json!([1.7]), 1), (json!([1e9, -1e9]), 2)] {
        view.send(0, json!({"do": "start-over", "pose": pose}));
        view.play(0.2);
        assert_eq!(view.page(0).refused.len(), refusals, "{pose}");
        let q = [0, 1].map(|joint| view.page(0).picture["q"][joint].as_f64().unwrap());
        assert!((q[0] - 1.7).abs() < 1e-3 && (q[1] - 1.1).abs() < 1e-3, "{q:?}");
    }
    view.arm(0);
    let mut view = TestView::in_command(World::of(Board::over(board.wire(), "a board").unwrap(), None), None);
    view.send(0, json!({"do": "start-over"}));
    assert!(view.page(0).refusal().contains("not simulated"), "{}", view.page(0).refusal());
}

/// While a hand presses the wall, turning the feed-forward off makes the wall buzz, and turning the feed-forward on
/// makes the wall quiet, at every depth and also at places to the side of the start.
#[test]
fn the_feed_forward_button_makes_a_pressed_wall_buzz_or_quiet() {
    let mut view = TestView::demo();
    view.arm(0);
    view.play(0.8);
    let number = |view: &TestView, name: &str| view.page(0).picture["numbers"][name].as_f64().unwrap();
    let [stiffness, damping] = ["stiffness", "damping"].map(|gain| view.page(0).walls[0][gain].as_f64().unwrap());
    let free_place = view.place_by_tip(0.0, 0.0);
    let places = [(16, 0), (22, 0), (28, 0), (34, 0), (42, 0), (54, 0), (28, 6), (28, -6)];
    let places = places
        .map(|(depth, aside)| (view.place_by_tip(-1e-3 * f64::from(depth), 1e-3 * f64::from(aside)), depth, aside));
    // Requests a kind of feed-forward with confirmation.
    let click = |view: &mut TestView, kind: FeedForward| {
        view.send(0, json!({"do": "gains", "wall": 0, "stiffness": stiffness, "damping": damping, "feed_forward": kind, "beyond": true}));
    };
    let mut rows = String::new();
    let mut as_it_should = true;
    for (place, depth, aside) in places {
        view.send(0, json!({"do": "hand", "at": free_place}));
        view.play(0.8);
        view.send(0, json!({"do": "hand", "at": place}));
        // Share of pictures with a red ripple after the first 0.8 s.
        let shares = [FeedForward::Washout, FeedForward::Off, FeedForward::Washout].map(|kind| {
            click(&mut view, kind);
            view.play(0.8);
            let ripples = [(); 48].map(|()| {
                view.play(0.0166);
                number(&view, "ripple")
            });
            ripples.iter().filter(|ripple| **ripple > RED_RIPPLE_N).count() as f64 / 48.0
        });
        let plane = view.wait_for_boundary();
        let [off, washout] = [FeedForward::Off, FeedForward::Washout].map(|kind| plane.max_stiffness(kind, damping));
        rows += &format!("{depth} mm, {aside} mm aside: red {shares:.2?}, stable to {off:.0} or {washout:.0} N/m\n");
        as_it_should &= shares[0] < 0.05 && shares[1] > 0.7 && shares[2] < 0.05;
        as_it_should &= 1.1 * off < stiffness && stiffness < 0.95 * washout;
    }
    assert!(as_it_should, "a wall of {stiffness} N/m, {damping} N s/m:\n{rows}");
    // The full feed-forward of (4) pushes a resting hand sideways; the feed-forward with a washout does not.
    click(&mut view, FeedForward::Full);
    view.play(1.6);
    assert!(number(&view, "sideways") > 0.5, "{}", number(&view, "sideways"));
    assert_eq!((view.state(), view.page(0).refused.len()), ("Armed", 0));
}

#[test]
fn walls_are_moved_and_turned_while_the_motors_are_off() {
    let mut view = TestView::demo();
    let value = |view: &TestView, place: usize| view.page(0).walls[0]["values"][place].as_f64().unwrap();
    view.send(0, json!({"do": "wall", "wall": 0, "point": [0.01, 0.125]}));
    assert!((value(&view, 1) - 0.125).abs() < 1e-6);
    view.send(0, json!({"do": "wall", "wall": 0, "point": [0.01, 0.125], "normal": [3.0, 4.0]}));
    assert!((value(&view, 3) - 0.6).abs() < 1e-6);
    for (message, words) in [
        (json!({"do": "wall", "wall": 7, "point": [0.0, 0.0]}), "no wall 7"),
        (json!({"do": "wall", "wall": 0, "point": [0.0, 0.0], "normal": [0.0, 0.0]}), "must not be zero"),
        (json!({"do": "gains", "wall": 7, "stiffness": 1.0, "damping": 1.0, "feed_forward": "off"}), "no wall 7"),
    ] {
        view.send(0, message);
        assert!(view.page(0).refusal().contains(words), "{}", view.page(0).refusal());
    }
}

#[test]
fn the_oscilloscope_triggers_on_the_touch() {
    let mut view = TestView::demo();
    let trigger = json!({"channel": "force_n", "level": 0.5, "rising": true, "before": 0.5, "once": true});
    view.send(0, json!({"do": "scope", "channels": ["force_n", "distance_m"], "seconds": 0.1, "trigger": trigger}));
    view.arm(0);
    view.play(0.6);
    assert!(view.page(0).sweep.is_empty(), "the trigger fired before the touch");
    view.send(0, json!({"do": "hand", "at": view.place_by_tip(-0.02, 0.0)}));
    view.play(1.0);
    let (head, values) = view.page(0).sweep.split_at(6);
    // A sweep of 0.1 s at 1 kHz has all 100 rows, with the crossing in the middle.
    assert_eq!([head[1], head[4], head[5]], [3.0, 2.0, 100.0]);
    let force = |row: usize| values[2 * row];
    let crossing = (head[3] / head[2] * 99.0).round() as usize;
    assert!(force(crossing - 1) < 0.5 && force(crossing) >= 0.5, "{:?}", &values[..200]);
    assert!((0..40).all(|row| force(row) == 0.0), "the sweep lacks the time before the touch");
    view.send(0, json!({"do": "scope", "channels": ["no"], "seconds": 0.1}));
    assert_eq!(view.page(0).refused.len(), 1);
    view.send(0, json!({"do": "sound", "on": true}));
    view.play(0.02);
    let sound = &view.page(0).sound;
    assert!(sound.len() > 2 && sound[1] == 1000.0, "rows a second: {sound:?}");
}

#[test]
fn a_recording_of_a_page_can_be_replayed() {
    let folder = tempfile::tempdir().unwrap();
    let mut view = TestView::in_command(World::demo().unwrap(), Some(folder.path()));
    view.send(0, json!({"do": "record", "on": true}));
    view.play(0.1);
    assert!(view.page(0).picture["recording"]["rows"].as_u64().unwrap() > 50);
    view.send(0, json!({"do": "record", "on": true}));
    assert!(view.page(0).refusal().contains("already active"), "{}", view.page(0).refusal());
    view.arm(0);
    view.play(0.5);
    view.send(0, json!({"do": "record", "on": false}));
    let file = std::fs::read_dir(folder.path()).unwrap().next().unwrap().unwrap().path();
    let recording = Recording::load(&file).unwrap();
    let (words, rows) = (view.page(0).recorded.clone().unwrap(), recording.rows.len());
    assert!(!recording.torn && words.contains(&format!("{rows} rows, none lost")), "{words}");
    let armed = recording.rows.iter().filter(|row| row[recording.column("state").unwrap()] == 1.0).count();
    assert!(armed > 300, "{armed} of {rows}");
    assert!(haptic_show::replay::replay(&recording).unwrap().is_same());
}

#[test]
fn springs_and_their_anchors_are_sent_to_the_page() {
    let path = shipped_path("scenes/haply-2diy/groove.toml");
    let scene = SceneFile::load(Path::new(&path), 2).unwrap().scene().unwrap();
    let view = TestView::in_command(World::simulate(shipped_device("haply-2diy"), Some(scene)).unwrap(), None);
    let page = view.page(0);
    assert_eq!(page.springs[0]["stiffness"], 250.0, "{}", page.springs);
    // The nearest point of the line y = 0.115 is straight above or below the tip.
    let (tip, anchor) = (&page.picture["geometry"]["tip"], &page.picture["geometry"]["springs"][0]);
    let tip_offset = (tip[0].as_f64().unwrap() - anchor[0].as_f64().unwrap()).abs();
    assert!(tip_offset < 1e-6 && (anchor[1].as_f64().unwrap() - 0.115).abs() < 1e-6, "{tip}: {anchor}");
}

#[test]
fn every_kind_of_device_can_be_viewed() {
    for name in ["hapkit-paddle", "haply-2diy", "phantom-premium-1.5", "serial-3r", "fictive-five-bar-turret"] {
        let mut view = TestView::in_command(World::simulate(shipped_device(name), None).unwrap(), None);
        view.wait_for_boundary();
        assert!(!view.page(0).picture["geometry"]["bars"].as_array().unwrap().is_empty(), "{name}");
        assert_eq!(view.page(0).hello["device"], name);
        view.arm(0);
    }
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
