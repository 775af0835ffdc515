//! A hand pushes on a wall. The board's force must agree with the wall's stiffness and with the simulation on the PC.

use std::time::Duration;

use crate::gate::session;
use haptic_bridge::board::telemetry::{Field, Fields};
use haptic_bridge::control::Rules;
use haptic_bridge::render::controller::Gains;
use haptic_bridge::render::scene::FeedForward;
use haptic_bridge::safety::fault::Fault;
use haptic_bridge::safety::limits::Limits;
use haptic_emulator::boards::BoardKind;
use haptic_emulator::contact::{NearWall, scene};
use haptic_emulator::hands::{firm_settings, hold, push as push_into, suspend_device};
use haptic_emulator::rig::Rig;
use haptic_emulator::run::{MILLISECOND, SECOND};
use haptic_host::link::Board;
use haptic_host::scene_file::SceneFile;
use haptic_sim::{BoardOptions, Options, SharedBoard, SimulatedBoard};
use haptic_sim::{Hand, HandSettings, Intent, Waypoint};
use haptic_stability::analysis::plant::Linearised;

/// Returns an armed rig without friction, `distance` (m) in front of a wall, and the wall's y coordinate (m).
fn armed_near_wall(feed_forward: &str, distance: f64) -> (Rig, f64) {
    let mut rig = Rig::with_device(BoardKind::OdriveV3, "pantograph-mk2", |options| options.friction = false);
    let tip = rig.with_simulated(|device| device.tip());
    let height = tip[1] + distance;
    rig.load(&format!(
        "[[wall]]\npoint = [0.0, {height}]\nnormal = [0.0, -1.0]\nstiffness = 2000.0\ndamping = 6.0\nfeed_forward = \"{feed_forward}\"\n"
    ));
    rig.with_simulated(suspend_device);
    rig.home_and_arm();
    (rig, height)
}

/// Makes a hand push the tip along +y with a force that rises to `newtons` within 0.5 s.
fn push(rig: &Rig, newtons: f64) {
    rig.with_simulated(move |device| {
        let path = vec![Waypoint { time: 0.0, value: [0.0; 3] }, Waypoint { time: 0.5, value: [0.0, newtons, 0.0] }];
        let hand = Hand::new(HandSettings::default(), Intent::Push(path), device.tip(), device.time());
        device.set_hand(hand);
    });
}

fn gains(feed_forward: FeedForward, stiffness: f32, damping: f32) -> Gains<f32> {
    Gains { wall: 0, stiffness, damping, feed_forward, washout_hz: 2.0 }
}

#[test]
fn a_wall_holds_a_hand_at_the_depth_of_its_stiffness() {
    let (mut rig, height) = armed_near_wall("off", 0.005);
    push(&rig, 2.0);
    rig.run(3 * SECOND);
    for feed_forward in [FeedForward::Off, FeedForward::Washout, FeedForward::Full] {
        rig.tool.set_wall_gains(gains(feed_forward, 2000.0, 6.0)).expect("gains change in contact");
        rig.run(SECOND);
        let (tip, tip_velocity) = rig.with_simulated(|device| (device.tip(), device.tip_velocity()));
        let status = rig.tool.status().expect("the board replies");
        assert_eq!(status.fault, None, "{feed_forward:?}");
        let depth = tip[1] - height;
        // 2 N at 2000 N/m are 1 mm. The tolerance of 8 % covers current sensors and encoder steps.
        assert!((depth - 0.001).abs() < 8e-5, "{feed_forward:?}: {depth} m deep, tip {tip:?} at {tip_velocity:?}");
    }
}

#[test]
fn a_wall_never_pulls() {
    let (mut rig, height) = armed_near_wall("washout", 0.003);
    rig.tool.start_stream(Fields(Field::WallForce.bit() | Field::Distance.bit()), 1).expect("a stream starts");
    push(&rig, 3.0);
    rig.run(SECOND);
    push(&rig, -3.0);
    let mut rows = Vec::new();
    while rows.len() < 25_000 {
        rows.extend(rig.tool.rows(Duration::from_millis(200)).expect("rows come"));
    }
    // The columns are distance and force.
    assert!(rows.iter().any(|row| row.values[1] > 1.0), "the wall was not touched");
    assert!(rows.iter().all(|row| row.values[1] >= 0.0), "a force pulls");
    assert!(rows.iter().all(|row| row.values[0] < 0.0 || row.values[1] == 0.0), "a force outside the wall");
    let tip = rig.with_simulated(|device| device.tip());
    assert!(tip[1] < height, "the hand is held back: {tip:?}");
}

/// Returns the depth of the tip in each wall, m. The tip started at `start`.
fn depths(walls: &[NearWall], start: [f64; 3], tip: [f64; 3]) -> Vec<f64> {
    let depth =
        |wall: &NearWall| -> f64 { (0..3).map(|i| -wall.normal[i] * (tip[i] - start[i])).sum::<f64>() - wall.gap };
    walls.iter().map(depth).collect()
}

/// Returns the depths every 10 ms while a hand pushes a device into walls, on the emulated chip and in the simulation.
fn depths_when_pushed(kind: BoardKind, name: &str, walls: &[NearWall], newtons: f64) -> [Vec<Vec<f64>>; 2] {
    const SAMPLES: usize = 120;
    let force: [f64; 3] = std::array::from_fn(|i| walls.iter().map(|wall| -newtons * wall.normal[i]).sum());
    let mut rig = Rig::with_device(kind, name, |options| options.friction = false);
    let scene = rig.arm_near_walls("gravity_compensation = true\n", walls);
    let (start, q) = rig.with_simulated(move |device| (device.tip(), device.q()));
    // A firm hand still holds the tip where it was when the walls were placed.
    rig.with_simulated(move |device| push_into(device, force, 0.3));
    let mut chip = Vec::new();
    for _ in 0..SAMPLES {
        rig.run(10 * MILLISECOND);
        chip.push(depths(walls, start, rig.with_simulated(|device| device.tip())));
    }
    let status = rig.tool.status().expect("the board replies");
    assert_eq!(status.fault, None, "{name}");

    let file = rig.file.as_ref().expect("a device");
    let device = Options { friction: false, start: Some(q), absolute_encoders: true, ..Options::default() };
    let mut board = SimulatedBoard::new(&file.description, BoardOptions { device, ..BoardOptions::default() })
        .expect("the device can be simulated");
    let scene =
        SceneFile::parse(&scene, "scene", file.spec().task).expect("a scene").scene().expect("the scene fits f32");
    board.load(&file.name, &file.description, Some(scene)).expect("loaded");
    hold(board.device_mut());
    let shared = SharedBoard::new(board);
    Board::over(shared.wire(), "simulated").expect("it replies").arm().expect("it arms");
    let mut board = shared.lock();
    board.run(1.0);
    push_into(board.device_mut(), force, 0.3);
    let mut pc = Vec::new();
    for _ in 0..SAMPLES {
        board.run(0.01);
        pc.push(depths(walls, start, board.device().tip()));
    }
    [chip, pc]
}

/// Checks that the chip's depths agree with the PC's depths within `share` of the largest depth.
fn check_depths(kind: BoardKind, name: &str, walls: &[NearWall], newtons: f64, share: f64) {
    let [chip, pc] = depths_when_pushed(kind, name, walls, newtons);
    for wall in 0..walls.len() {
        let deepest = pc.iter().map(|sample| sample[wall]).fold(0.0, f64::max);
        let difference = chip.iter().zip(&pc).map(|(chip, pc)| (chip[wall] - pc[wall]).abs()).fold(0.0, f64::max);
        println!("{name}, wall {wall}: {deepest:.6} m deep on the PC, the chip differs by at most {difference:.6} m");
        // The final depth is the hand's force over the stiffness.
        assert!(deepest > 0.5 * newtons / walls[wall].stiffness, "{name}: {deepest} m is no contact");
        assert!(difference < share * deepest, "{name}, wall {wall}: depths differ by {difference} m at {deepest} m");
    }
}

#[test]
fn a_wall_before_three_joints_has_the_simulated_depth() {
    for feed_forward in ["off", "full"] {
        let wall = NearWall { feed_forward, damping: 3.0, ..NearWall::with_normal([0.0, -1.0, 0.0]) };
        check_depths(BoardKind::HBridgeF405, "phantom-premium-1.5", &[wall], 0.8, 0.05);
    }
}

#[test]
fn a_corner_with_feed_forward_has_the_simulated_depth() {
    let walls =
        [[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0]].map(|normal| NearWall { damping: 3.0, ..NearWall::with_normal(normal) });
    check_depths(BoardKind::OdriveV3, "pantograph-mk2", &walls, 0.8, 0.08);
}

#[test]
fn gains_changed_in_contact_change_the_torque_in_proportion() {
    let wall = NearWall { feed_forward: "full", ..NearWall::with_normal([0.0, -1.0, 0.0]) };
    let mut rig = Rig::in_contact(BoardKind::OdriveV3, "pantograph-mk2", "", &[wall], 0.8);
    let fields =
        Fields(Field::Torque.bit() | Field::Distance.bit() | Field::NormalVelocity.bit() | Field::WallForce.bit());
    rig.tool.start_stream(fields, 4).expect("a stream starts");
    let mut rows = Vec::new();
    for stiffness in [500.0, 800.0, 400.0, 600.0] {
        rig.tool.set_wall_gains(gains(FeedForward::Full, stiffness, 1.0)).expect("gains change in contact");
        let until = rows.len() + 400;
        while rows.len() < until {
            rows.extend(rig.tool.rows(Duration::from_millis(20)).expect("rows come"));
        }
    }
    assert_eq!(rig.tool.losses().missing, 0);
    // The columns are torques, distance, velocity and force. Each jump of the force comes from a change of the
    // stiffness, and the torque changes in proportion.
    let mut steps = 0;
    for pair in rows.windows(2) {
        let [a, b] = [&pair[0].values, &pair[1].values];
        let (before, after) = (a[4], b[4]);
        steps += usize::from((after - before).abs() > 0.1);
        for joint in 0..2 {
            let explained = a[joint] * after / before;
            let error = (b[joint] - explained).abs();
            assert!(error < 0.02 * b[joint].abs() + 2e-5, "torques at step {}: {a:?} then {b:?}", pair[1].step);
        }
    }
    assert_eq!(steps, 3, "the force does not show three changes of the gains");
}

#[test]
fn the_chips_feed_forward_equals_the_analysis() {
    for (kind, name) in [(BoardKind::OdriveV3, "pantograph-mk2"), (BoardKind::HBridgeF405, "phantom-premium-1.5")] {
        let normal = [-0.6, -0.8, 0.0];
        // Without gravity compensation the hand also carries the weight.
        let mut rig =
            Rig::in_contact(kind, name, "gravity_compensation = false\n", &[NearWall::with_normal(normal)], 1.6);
        let file = rig.file.clone().expect("a device");
        let (joints, task) = (file.spec().joints, file.spec().task);
        rig.tool
            .start_stream(Fields(Field::Angle.bit() | Field::Torque.bit() | Field::WallForce.bit()), 20)
            .expect("a stream");
        for feed_forward in [FeedForward::Full, FeedForward::Off] {
            rig.tool.set_wall_gains(gains(feed_forward, 500.0, 1.0)).expect("gains change in contact");
            // The measurement must come before the tip slides along the wall.
            rig.run(10 * MILLISECOND);
            let rows = rig.tool.rows(Duration::from_millis(300)).expect("rows come");
            let row = &rows.last().expect("a row").values;
            let (q, torque, force) = (&row[..joints], &row[joints..2 * joints], row[2 * joints]);
            let device = Linearised::at(&file.description, q, &normal[..task]).expect("a regular pose");
            let shaped = device.shaped_torque();
            let expected = if feed_forward == FeedForward::Full { &shaped } else { &device.row };
            let difference = (shaped.clone() - &device.row).amax();
            assert!(difference > 0.05 * device.row.amax(), "{name}: the feed-forward has no effect here");
            for joint in 0..joints {
                let error = (torque[joint] / force - expected[joint]).abs();
                println!(
                    "{name}, {feed_forward:?}, joint {joint}: torque per force {} N m/N, {} expected",
                    torque[joint] / force,
                    expected[joint]
                );
                assert!(
                    force > 0.2 && error < 0.02 * difference,
                    "{name}, {feed_forward:?}, joint {joint}: torques {row:?}, expected {expected:?}"
                );
            }
        }
    }
}

/// Forces of a wall at one depth, as means over 80 ms of measured and reported forces.
#[derive(Clone, Debug, Default)]
struct Sample {
    /// Depth of the tip, m.
    depth: f64,
    /// Wall force before the limits, from telemetry, N.
    unlimited_force: f64,
    /// Wall force after the limits, from telemetry, N.
    rendered_force: f64,
    /// Force of the device on the hand along the normal, N.
    normal_force: f64,
    /// Force of the device on the hand perpendicular to the normal, N.
    sideways_force: f64,
    /// Smallest and largest value of the field `saturated`, for each joint.
    saturated: Vec<(f64, f64)>,
}

/// Measures samples while a firm hand slowly leads the tip 6 mm into a wall of 2 kN/m, with motors limited to `torque`.
fn measure_pressed(
    kind: BoardKind,
    name: &str,
    normal: [f64; 3],
    feed_forward: &'static str,
    torque: f32,
) -> Vec<Sample> {
    const MAX_DEPTH: f64 = 0.006;
    const SAMPLES: usize = 30;
    const ROWS: usize = 40;
    let mut rig = Rig::with_device(kind, name, |options| options.friction = false);
    rig.prepare("gravity_compensation = true\n");
    let rules = rig.tool.rules().expect("the board replies");
    let limits = Limits { torque: [torque; 3], ..rules.limits };
    rig.tool.set_rules(&Rules { limits, ..rules }).expect("the motors are off");
    let start = rig.with_simulated(|device| device.tip());
    let wall = NearWall { stiffness: 2000.0, gap: 0.001, damping: 0.0, feed_forward, ..NearWall::with_normal(normal) };
    let task = rig.file.as_ref().expect("a device").spec().task;
    rig.set_scene(&scene("gravity_compensation = true\n", start, task, &[wall]));
    rig.arm();
    let goal = std::array::from_fn(|i| start[i] - (wall.gap + MAX_DEPTH) * normal[i]);
    rig.with_simulated(move |device| {
        let path = vec![Waypoint { time: 0.0, value: start }, Waypoint { time: 0.08 * SAMPLES as f64, value: goal }];
        device.set_hand(Hand::new(firm_settings(), Intent::Follow(path), device.tip(), device.time()));
    });
    let fields = Fields(Field::WallForce.bit() | Field::RenderedForce.bit() | Field::Saturated.bit());
    // The stream has a row every 2 ms.
    rig.tool.start_stream(fields, 40).expect("a stream starts");
    let mut samples = Vec::new();
    for _ in 0..SAMPLES {
        let mut sample = Sample { saturated: vec![(f64::INFINITY, 0.0); task], ..Sample::default() };
        let (mut rows, mut times) = (0, 0.0);
        let mut force = [0.0; 3];
        while rows < ROWS {
            for row in rig.tool.rows(Duration::from_millis(4)).expect("rows come") {
                rows += 1;
                sample.unlimited_force += row.get(Field::WallForce)[0];
                sample.rendered_force += row.get(Field::RenderedForce)[0];
                for (range, value) in sample.saturated.iter_mut().zip(row.get(Field::Saturated)) {
                    *range = (range.0.min(*value), range.1.max(*value));
                }
            }
            let (tip, hand) = rig.with_simulated(|device| (device.tip(), device.hand_force()));
            times += 1.0;
            sample.depth += depths(&[wall], start, tip)[0];
            force = std::array::from_fn(|i| force[i] - hand[i]);
        }
        sample.unlimited_force /= rows as f64;
        sample.rendered_force /= rows as f64;
        sample.depth /= times;
        sample.normal_force = (0..3).map(|i| force[i] * normal[i]).sum::<f64>() / times;
        sample.sideways_force =
            (0..3).map(|i| (force[i] / times - sample.normal_force * normal[i]).powi(2)).sum::<f64>().sqrt();
        samples.push(sample);
    }
    assert_eq!(rig.tool.status().expect("the board replies").fault, None, "{name}");
    samples
}

/// If each joint were limited separately, these walls would push sideways with 1 N.
#[test]
fn a_wall_force_above_the_motors_limits_keeps_its_direction() {
    for (kind, name, normal, feed_forward, torque) in [
        (BoardKind::OdriveV3, "pantograph-mk2", [-0.8, -0.6, 0.0], "washout", 0.15),
        (BoardKind::HBridgeF405, "phantom-premium-1.5", [-0.48, -0.64, 0.6], "off", 0.4),
    ] {
        let samples = measure_pressed(kind, name, normal, feed_forward, torque);
        let [first, .., last] = &samples[..] else { panic!("many samples") };
        assert!(first.unlimited_force == 0.0 && last.rendered_force < 0.35 * last.unlimited_force, "{name}: {last:?}");
        // The tolerance covers current sensors, encoder steps and the hand's own motion.
        let uncertain = 0.03 * last.rendered_force;
        for (index, sample) in samples.iter().enumerate() {
            println!("{name}: {sample:?}");
            assert!(
                (sample.normal_force - sample.rendered_force).abs() < uncertain,
                "{name}: reported force differs: {sample:?}"
            );
            assert!(sample.sideways_force < uncertain, "{name}: a force across the normal: {sample:?}");
            let before = samples[index.saturating_sub(1)].normal_force;
            assert!(sample.normal_force > before - 0.3 * uncertain, "{name}: a fall from {before} N: {sample:?}");
            let all_are = |value: f64| sample.saturated.iter().all(|seen| *seen == (value, value));
            assert!(
                sample.rendered_force < sample.unlimited_force * 0.999 || all_are(0.0),
                "{name}: saturated without a cut: {sample:?}"
            );
            assert!(
                sample.rendered_force >= sample.unlimited_force * 0.75 || all_are(1.0),
                "{name}: cut without saturation: {sample:?}"
            );
        }
    }
}

#[test]
fn a_chain_on_the_odrive_v3_renders_and_stops_at_a_fault() {
    session(BoardKind::OdriveV3, "planar-arm", Fault::GateDriver);
}
