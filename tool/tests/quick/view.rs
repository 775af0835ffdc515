//! `haptic view` without a browser: commands of the page and what it shows. Refusals are in view/refusals.rs.

mod refusals;

use crate::common::page::Received;
use crate::common::prelude::*;
use crate::common::{shipped_device, shipped_path};
use haptic_bridge::board::protocol::Arm;
use haptic_host::link::encode;
use haptic_predict::wall_ahead::wall_ahead;
use haptic_show::recorder::Recording;
use haptic_show::view::hub::{Hub, Message as Sent, PageId};
use haptic_show::view::message::FromPage;
use haptic_show::view::stability::Plane;
use haptic_show::view::world::lead_hand;
use haptic_show::view::{Stage, Turn, World};
use haptic_stability::analysis::control_loop::TorquePath;
use haptic_stability::analysis::flexible::Posture;
use haptic_stability::analysis::pose::Stance;
use haptic_stability::analysis::prediction::{Prediction, Subject};
use haptic_stability::analysis::range::BoundaryPoint;
use postcard_rpc::Endpoint as _;
use postcard_rpc::header::{VarHeader, VarKey, VarSeq};
use serde_json::json;
use std::path::Path;
use std::time::Duration;

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
    // With the hand in contact, a page shows the buzz at 73 Hz.
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

/// The page draws every wall, and every tip at the end of a link. The hand leads the tip along each of the first two task
/// coordinates, and leaves the third alone.
#[test]
fn the_page_draws_chains_deltas_and_paddles() {
    for name in ["touch", "planar-arm", "yoke", "two-paddles", "fader", "upright-hapkit", "falcon-like"] {
        let file = shipped_device(name);
        let task = file.spec().task;
        let scene = SceneFile::load(Path::new(&shipped_path(&format!("scenes/{name}/wall.toml"))), task);
        let world = World::simulate(file, Some(scene.unwrap().scene().unwrap())).unwrap();
        let simulated = world.simulated.clone().unwrap();
        let tip = || simulated.lock().device().tip();
        let mut view = TestView::in_command(world, None);
        let walls = &view.page(0).walls;
        let walls = walls.as_array().expect("a list of walls");
        assert!(!walls.is_empty() && walls.iter().all(|wall| wall["outline"].is_object()), "{name}: {walls:?}");
        let geometry = view.page(0).picture["geometry"].clone();
        let place = |value: &Value| [0, 1].map(|axis| value[axis].as_f64().unwrap());
        let ends: Vec<_> = geometry["bars"].as_array().unwrap().iter().map(|bar| place(&bar[1])).collect();
        let more = geometry["more"].as_array().unwrap().iter().map(|tip| place(&tip[0]));
        for [x, y] in [place(&geometry["tip"])].into_iter().chain(more) {
            assert!(ends.iter().any(|end| (end[0] - x).hypot(end[1] - y) < 1e-4), "{name}: {x}, {y} of {geometry}");
        }
        let before = tip();
        view.send(0, json!({"do": "hand", "at": [before[0] + 0.004, before[1] + 0.004]}));
        view.play(0.6);
        let after = tip();
        for axis in 0..task.min(2) {
            assert!(after[axis] - before[axis] > 0.001, "{name}: {before:?}, {after:?}");
        }
        assert!((after[2] - before[2]).abs() < 0.002, "{name}: {before:?}, {after:?}");
    }
}
