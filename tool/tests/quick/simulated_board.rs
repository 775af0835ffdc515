//! Replies and motion of the simulated board over its real protocol. Time advances only while a test reads or runs it.

use crate::common::prelude::*;
use crate::common::strict::verify_motors;
use crate::common::{board, plane_wall, shipped_device};
use haptic_bridge::model::description::Encoder;
use haptic_bridge::model::mechanism::FiveBar;
use haptic_bridge::render::controller::Gains;
use haptic_bridge::safety::refusal::Refusal;
use haptic_host::link::{BoardError, fields};
use haptic_sim::{Hand, HandLoop, SimulatedBoard};
use nalgebra::Vector2;
use std::time::Duration;

fn device_file() -> DeviceFile {
    shipped_device("coupled-five-bar")
}

fn connect_board(options: BoardOptions) -> (SharedBoard, Board) {
    board(&device_file(), options)
}

/// Returns a scene with a wall whose surface is `gap` metres below the tip and faces up (+y).
fn wall_below_tip(shared: &SharedBoard, gap: f64, feed_forward: FeedForward) -> Scene<f32> {
    let tip = shared.lock().device().tip();
    let point = [tip[0] as f32, (tip[1] - gap) as f32, 0.0];
    let wall = Wall { feed_forward, ..plane_wall(point, [0.0, 1.0, 0.0], 1000.0, 5.0) };
    Scene { task: 2, walls: [wall].into_iter().collect(), ..Scene::default() }
}

fn push_down(shared: &SharedBoard, newtons: f64) {
    let mut guard = shared.lock();
    let (tip, now) = (guard.device().tip(), guard.time());
    let push = Intent::Push(vec![
        Waypoint { time: 0.0, value: [0.0; 3] },
        Waypoint { time: 0.3, value: [0.0, -newtons, 0.0] },
    ]);
    guard.device_mut().set_hand(Hand::new(HandSettings::default(), push, tip, now));
}

fn expect_refusal(result: Result<(), BoardError>) -> Refusal {
    match result {
        Err(BoardError::Refused(refusal)) => refusal,
        other => panic!("expected a refusal, got {other:?}"),
    }
}

#[test]
fn a_board_describes_itself() {
    let (_, mut board) = connect_board(BoardOptions::default());
    assert_eq!(board.info().board.as_str(), "simulated");
    let details = board.details().unwrap();
    assert_eq!(details.device.as_deref(), Some("coupled-five-bar"));
    assert_eq!((details.axes, details.walls, details.real), (3, 0, false));
    assert_eq!((details.rate_hz, details.carrier_hz, details.delay_samples), (20_000.0, 20_000.0, 0.5));
}

/// Returns the last row of the stream of encoders without motors.
fn sensed_row(shared: &SharedBoard, board: &mut Board) -> Vec<f64> {
    board.start_stream(fields("sensed").unwrap(), 20).unwrap();
    shared.lock().run(0.01);
    let rows = board.rows(Duration::from_millis(10)).unwrap();
    board.stop_stream().unwrap();
    rows.last().expect("a row").values.clone()
}

#[test]
fn encoders_without_motors_are_streamed_from_home() {
    let mut file = device_file();
    let encoder = Encoder { counts_per_turn: 4_000.0, offset: 0.5, inverted: true };
    file.description.sensed = [Some(encoder), Some(Encoder { offset: 0.0, inverted: false, ..encoder }), None];
    let (shared, mut board) = board(&file, BoardOptions::default());
    shared.lock().device_mut().set_sensed_counts([1_000, 500, 9]);
    let quarter = f64::from(std::f32::consts::FRAC_PI_2);
    let near = |row: &[f64], expected: [f64; 2]| {
        assert!(row.len() == 2 && row.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{row:?}");
    };
    near(&sensed_row(&shared, &mut board), [0.5 - quarter, 0.5 * quarter]);
    board.home().unwrap();
    near(&sensed_row(&shared, &mut board), [0.5, 0.0]);
    shared.lock().device_mut().set_sensed_counts([0, 1_500, 9]);
    near(&sensed_row(&shared, &mut board), [0.5 + quarter, quarter]);
}

#[test]
fn a_push_penetrates_a_wall_as_its_stiffness_predicts() {
    let (shared, mut board) = connect_board(BoardOptions::default());
    board.set_scene(&wall_below_tip(&shared, 0.005, FeedForward::Off)).unwrap();
    board.arm().unwrap();
    push_down(&shared, 4.0);
    board.start_stream(fields("distance,force,state").unwrap(), 20).unwrap();
    let mut last = Vec::new();
    while shared.lock().time() < 2.5 {
        if let Some(row) = board.rows(Duration::from_millis(100)).unwrap().pop() {
            last = row.values;
        }
    }
    // 4 N on 1000 N/m are 4 mm, but joint friction (0.005 N m on 0.1 m arms) may hold a part of the force.
    assert!((last[0] + 0.004).abs() < 0.0003, "distance {}", last[0]);
    assert!((last[1] - 4.0).abs() < 0.3, "force {}", last[1]);
    assert_eq!(last[2..], [1.0, 1.0], "state Armed, one wall touched");
    assert_eq!(board.losses().missing, 0);
    board.disarm().unwrap();
    assert_eq!(board.status().unwrap().state, State::Disarmed);
}

#[test]
fn a_disarmed_wall_has_no_force() {
    let (shared, mut board) = connect_board(BoardOptions::default());
    board.set_scene(&wall_below_tip(&shared, 0.005, FeedForward::Off)).unwrap();
    push_down(&shared, 4.0);
    let before = shared.lock().device().tip()[1];
    shared.lock().run(0.5);
    assert!(shared.lock().device().tip()[1] < before - 0.01);
    assert_eq!(shared.lock().device().currents(), [0.0; 3]);
}

#[test]
fn requests_in_the_middle_of_a_stream_lose_no_rows() {
    let (_, mut board) = connect_board(BoardOptions::default());
    board.keep_alive();
    board.start_stream(fields("q").unwrap(), 1).unwrap();
    let mut received = 0;
    while received < 10_000 {
        received += board.rows(Duration::from_millis(100)).unwrap().len();
        board.status().unwrap();
    }
    board.stop_stream().unwrap();
    received += board.rows(Duration::ZERO).unwrap().len();
    let losses = board.losses();
    assert_eq!((losses.missing, losses.batches_lost, losses.received), (0, 0, received as u64));
}

#[test]
fn a_host_that_does_not_read_loses_a_counted_number_of_rows() {
    let (shared, mut board) = connect_board(BoardOptions { send_buffer: 4_000, ..BoardOptions::default() });
    board.start_stream(fields("q,tip").unwrap(), 1).unwrap();
    shared.lock().run(1.0);
    let mut rows = Vec::new();
    while rows.last().is_none_or(|row: &haptic_host::link::Row| row.step < 21_000) {
        rows.extend(board.rows(Duration::from_millis(50)).unwrap());
    }
    let losses = board.losses();
    let span = u64::from(rows[rows.len() - 1].step - rows[0].step) + 1;
    assert!(losses.missing > 15_000, "{losses}");
    assert_eq!(losses.received + losses.missing, span, "a step is neither received nor counted as missing");
    assert_eq!(losses.dropped_by_board, losses.missing);
    assert_eq!(losses.batches_lost, 0);
}

#[test]
fn arming_is_refused_with_the_reason() {
    let options = BoardOptions { strict: true, ..BoardOptions::default() };
    let shared = SharedBoard::new(SimulatedBoard::new(&device_file().description, options).unwrap());
    let mut board = Board::over(shared.wire(), "sim").unwrap();
    assert_eq!(expect_refusal(board.arm()), Refusal::NoDevice);
    assert_eq!(expect_refusal(board.home()), Refusal::NoDevice);
    let mut description = device_file().description;
    board.set_device(&Device::new("unverified", &description).unwrap()).unwrap();
    assert_eq!(expect_refusal(board.arm()), Refusal::NoScene);
    board.set_scene(&wall_below_tip(&shared, 0.01, FeedForward::Full)).unwrap();
    assert_eq!(expect_refusal(board.arm()), Refusal::MotorNotVerified(0));
    verify_motors(&mut description);
    board.set_device(&Device::new("verified", &description).unwrap()).unwrap();
    assert_eq!(expect_refusal(board.arm()), Refusal::NotHomed);
    board.home().unwrap();
    assert_eq!(expect_refusal(board.arm()), Refusal::PolarityUnchecked);
    board.check_polarity().unwrap();
    run_with_heartbeats(&shared, &mut board, 20.0);
    assert!(board.status().unwrap().polarity, "{:?}", board.status());
    // The polarity check moved the device, so put the wall around the tip's new place.
    let scene = wall_below_tip(&shared, -0.01, FeedForward::Full);
    board.set_scene(&scene).unwrap();
    assert_eq!(expect_refusal(board.arm()), Refusal::InsideWall);
}

/// Runs the board for some seconds with a heartbeat every 0.1 s.
fn run_with_heartbeats(shared: &SharedBoard, board: &mut Board, seconds: f64) {
    board.keep_alive();
    for _ in 0..(10.0 * seconds) as u32 {
        shared.lock().run(0.1);
        board.rows(Duration::ZERO).unwrap();
    }
}

#[test]
fn a_reversed_motor_is_detected_before_arming() {
    let mut file = device_file();
    let mut wired = file.description;
    wired.joints[1].motor.as_mut().unwrap().torque_constant *= -1.0;
    wired.joints[1].motor.as_mut().unwrap().back_emf *= -1.0;
    verify_motors(&mut file.description);
    let options = BoardOptions { strict: true, ..BoardOptions::default() };
    let mut simulated = SimulatedBoard::new(&wired, options).unwrap();
    simulated.load(&file.name, &file.description, None).unwrap();
    let shared = SharedBoard::new(simulated);
    let mut board = Board::over(shared.wire(), "sim").unwrap();
    board.home().unwrap();
    board.check_polarity().unwrap();
    run_with_heartbeats(&shared, &mut board, 20.0);
    let fault = board.status().unwrap().fault.unwrap();
    assert_eq!((fault.fault, fault.axis), (Fault::PolarityWrong, Some(1)));
    assert_eq!(board.faults().unwrap().len(), 1);
}

#[test]
fn gains_change_during_contact_and_invalid_gains_are_refused() {
    let (shared, mut board) = connect_board(BoardOptions::default());
    board.set_scene(&wall_below_tip(&shared, 0.005, FeedForward::Washout)).unwrap();
    board.arm().unwrap();
    push_down(&shared, 4.0);
    shared.lock().run(2.0);
    let before = shared.lock().device().tip()[1];
    let gains =
        Gains { wall: 0, stiffness: 4000.0, damping: 10.0, feed_forward: FeedForward::Washout, washout_hz: 2.0 };
    board.set_wall_gains(gains).unwrap();
    shared.lock().run(1.0);
    let risen = shared.lock().device().tip()[1] - before;
    assert!((risen - 0.003).abs() < 0.0006, "4 N/1000 - 4 N/4000 = 3 mm, got {risen}");
    for bad in [f32::NAN, f32::INFINITY, -1.0] {
        assert!(matches!(expect_refusal(board.set_wall_gains(Gains { stiffness: bad, ..gains })), Refusal::Scene(_)));
    }
    assert!(matches!(expect_refusal(board.set_wall_gains(Gains { wall: 3, ..gains })), Refusal::Scene(_)));
    assert_eq!(board.scene().unwrap().unwrap().walls[0].stiffness, 4000.0);
}

#[test]
fn a_silent_host_disarms_and_a_waiting_one_does_not() {
    let (shared, mut board) = connect_board(BoardOptions::default());
    board.set_scene(&wall_below_tip(&shared, 0.05, FeedForward::Off)).unwrap();
    let rules = Rules { host_action: HostAction::Disarm, host_seconds: 0.3, ..board.rules().unwrap() };
    board.set_rules(&rules).unwrap();
    board.arm().unwrap();
    board.keep_alive();
    for _ in 0..20 {
        board.rows(Duration::from_millis(50)).unwrap();
    }
    assert_eq!(board.status().unwrap().state, State::Armed);
    shared.lock().run(0.5);
    let status = board.status().unwrap();
    assert_eq!(status.state, State::Fault);
    assert_eq!(status.fault.unwrap().fault, Fault::HostLost);
    assert_eq!(expect_refusal(board.arm()), Refusal::Faulted(Fault::HostLost));
    board.clear().unwrap();
    board.arm().unwrap();
}

#[test]
fn settings_survive_a_restart_once_saved() {
    let (shared, mut board) = connect_board(BoardOptions::default());
    let scene = wall_below_tip(&shared, 0.02, FeedForward::Full);
    board.set_scene(&scene).unwrap();
    board.restart().unwrap();
    assert_eq!(board.device().unwrap(), None, "an unsaved device survived");
    shared.lock().load("saved", &device_file().description, Some(scene.clone())).unwrap();
    board.save().unwrap();
    board.restart().unwrap();
    assert_eq!(board.details().unwrap().device.as_deref(), Some("saved"));
    assert_eq!(board.scene().unwrap(), Some(scene));
    assert!(matches!(board.status().unwrap().state, State::Disarmed));
}

#[test]
fn two_runs_are_the_same_bit_for_bit() {
    let run = || {
        let (shared, mut board) = connect_board(BoardOptions::default());
        board.set_scene(&wall_below_tip(&shared, 0.002, FeedForward::Washout)).unwrap();
        board.arm().unwrap();
        push_down(&shared, 3.0);
        board.start_stream(fields("all").unwrap(), 7).unwrap();
        let mut rows = Vec::new();
        while shared.lock().time() < 0.6 {
            rows.extend(board.rows(Duration::from_millis(30)).unwrap());
        }
        rows
    };
    assert_eq!(run(), run());
}

/// Simulates a second of contact with a wall too stiff for its rate. Returns the least energy (J), the largest added
/// damping (N s/m), and the root mean square of the velocity in the second half (m/s) from the telemetry.
fn unstable_contact(passivity: bool) -> (f64, f64, f64) {
    let (shared, mut board) = connect_board(BoardOptions::default());
    let mut scene = wall_below_tip(&shared, 0.001, FeedForward::Off);
    scene.rate_hz = 1_000.0;
    scene.cutoff_hz = 100.0;
    scene.walls[0].stiffness = 40_000.0;
    scene.walls[0].damping = 0.0;
    board.set_scene(&scene).unwrap();
    let rules = board.rules().unwrap();
    board.set_rules(&Rules { passivity, ..rules }).unwrap();
    board.arm().unwrap();
    push_down(&shared, 2.0);
    board.start_stream(fields("velocity,energy,passivity").unwrap(), 1).unwrap();
    let mut rows = Vec::new();
    while rows.len() < 1_000 {
        rows.extend(board.rows(Duration::from_millis(100)).unwrap());
    }
    let lowest = rows.iter().map(|row| row.values[1]).fold(0.0, f64::min);
    let highest = rows.iter().map(|row| row.values[2]).fold(0.0, f64::max);
    let squares: f64 = rows[500..1_000].iter().map(|row| row.values[0].powi(2)).sum();
    (lowest, highest, (squares / 500.0).sqrt())
}

#[test]
fn energy_from_a_wall_is_reported_and_damped_by_the_rules() {
    let (given_out, undamped, free) = unstable_contact(false);
    assert!(given_out < -1e-3, "the wall gave out {given_out} J");
    assert_eq!(undamped, 0.0, "damping must be added only on request");
    let (given_out, damping, damped) = unstable_contact(true);
    assert!(given_out < -1e-3, "the wall gave out {given_out} J");
    assert!(damping > 1.0, "{damping} N s/m");
    // Passivity control takes away only a tenth to a fifth of the speed and does not make the wall stable
    // (docs/safety.md). The exact share depends on rounding, because the motion is chaotic.
    let left = damped / free;
    assert!((0.75..0.95).contains(&left), "{damped} m/s with damping, {free} m/s without");
}

/// Oracle: a five-bar that renders a force straight up with at most `most` N m in each joint.
struct StraightForce {
    mechanism: FiveBar<f64>,
    most: f64,
}

impl StraightForce {
    fn requested_torques(&self, q: &[f64], newtons: f64) -> Vector2<f64> {
        let pose = self.mechanism.pose::<Libm>(&Vector2::new(q[0], q[1]));
        self.mechanism.transpose(&pose, &Vector2::new(0.0, newtons))
    }

    fn limit_share(&self, torques: &Vector2<f64>) -> f64 {
        torques.iter().fold(1.0, |share, torque| share.min(self.most / torque.abs()))
    }

    fn tip_force(&self, q: &[f64], torque: &Vector2<f64>) -> Vector2<f64> {
        let pose = self.mechanism.pose::<Libm>(&Vector2::new(q[0], q[1]));
        self.mechanism.jacobian_inverse(&pose).tr_mul(torque)
    }
}

#[test]
fn a_wall_beyond_the_motors_pushes_straight_with_full_torque() {
    const LIMIT_NM: f64 = 0.3;
    let device = Options::frictionless();
    let options = BoardOptions { device, drive: DriveModel::Ideal, ..BoardOptions::default() };
    let (shared, mut board) = connect_board(options);
    let mut rules = board.rules().unwrap();
    rules.limits.torque = [LIMIT_NM as f32; 3];
    rules.limits.tip_force = 1.0e3;
    board.set_rules(&rules).unwrap();
    let mut scene = wall_below_tip(&shared, 0.002, FeedForward::Off);
    scene.walls[0].damping = 0.0;
    board.set_scene(&scene).unwrap();
    board.arm().unwrap();
    // Wait for the torque ramp after arming.
    shared.lock().run(0.6);
    let start_s = {
        let mut guard = shared.lock();
        let (tip, now) = (guard.device().tip(), guard.time());
        let slid = [tip[0] + 0.03, tip[1] - 0.04, 0.0];
        let path = vec![Waypoint { time: 0.0, value: tip }, Waypoint { time: 1.0, value: slid }];
        guard.device_mut().set_hand(Hand::new(HandSettings::default(), Intent::Follow(path), tip, now));
        now
    };
    board.start_stream(fields("q,torque,distance,force,rendered,saturated,state").unwrap(), 20).unwrap();
    let mut rows = Vec::new();
    while shared.lock().time() < start_s + 1.0 {
        rows.extend(board.rows(Duration::from_millis(50)).unwrap());
    }
    let Ok(AnyMechanism::FiveBar(mechanism)) = AnyMechanism::<f64>::new(&device_file().description) else {
        panic!("the shipped device is a five-bar")
    };
    let straight = StraightForce { mechanism, most: LIMIT_NM };
    let (mut beyond, mut flagged, mut deepest, mut aside) = (0, Vec::new(), 0.0_f64, 0.0_f64);
    for row in rows.iter().filter(|row| row.values[5] > 0.05) {
        let [q0, q1, torque0, torque1, distance, force, rendered, flag0, flag1, ..] = row.values[..] else { panic!() };
        let q = [q0, q1];
        let requested_torques = straight.requested_torques(&q, force);
        let share = straight.limit_share(&requested_torques);
        // The rendered force is scaled by the factor `share` and has no sideways part.
        let tip_force = straight.tip_force(&q, &Vector2::new(torque0, torque1));
        assert!((tip_force[1] - share * force).abs() < 0.01, "{row:?}: {tip_force} is not {share} times {force}");
        assert!(tip_force[0].abs() < 0.01, "{row:?}: {tip_force} pulls sideways");
        assert!((rendered - tip_force[1]).abs() < 0.01, "{row:?}: {tip_force}");
        if !(0.999..1.0).contains(&share) {
            let flag = f64::from(u8::from(share < 1.0));
            assert_eq!([flag0, flag1], [flag; 2], "{row:?}: {share}");
            flagged.push(flag);
        }
        beyond += usize::from(share < 0.5);
        deepest = deepest.max(-distance);
        aside = aside.max(straight.tip_force(&q, &requested_torques.map(|t| t.clamp(-LIMIT_NM, LIMIT_NM)))[0].abs());
    }
    let changes = flagged.windows(2).filter(|pair| pair[0] != pair[1]).count();
    assert!(flagged.first() == Some(&0.0) && changes == 1, "{changes} changes of the flag");
    assert!(beyond > 100 && deepest > 0.01, "{beyond} rows with half of the force, {deepest} m deep");
    assert!(aside > 0.5, "if each joint were limited alone, the sideways force would be only {aside} N");
    assert!(rows.iter().all(|row| row.values[9] == 1.0), "not armed in every row");
}

#[test]
fn a_hand_loop_stays_outside_walls_until_the_board_is_armed() {
    let (shared, mut board) = connect_board(BoardOptions::default());
    let scene = wall_below_tip(&shared, 0.01, FeedForward::Off);
    board.set_scene(&scene).unwrap();
    let tip = shared.lock().device().tip();
    let walls = Scene { task: 2, walls: scene.walls.iter().map(Wall::cast).collect(), ..Scene::default() };
    let around = HandLoop::find(&device_file(), Some(&walls), tip);
    assert!(around.on_a_wall);
    shared.lock().set_hand_loop(HandSettings { tremor: 2e-4, ..HandSettings::default() }, around);
    for _ in 0..3 {
        // Arm at many times of the loop, which lasts 4 s. If the board is armed, the hand is in the wall for 2 s.
        for _ in 0..10 {
            shared.lock().run(0.41);
            board.arm().expect("the hand waits outside of the wall");
            board.disarm().unwrap();
        }
        board.arm().unwrap();
        let mut deepest: f64 = 0.0;
        for _ in 0..30 {
            shared.lock().run(0.1);
            deepest = deepest.min(shared.lock().device().tip()[1] - (tip[1] - 0.01));
        }
        assert!(deepest < -0.001, "the hand does not press the armed board's wall: {deepest} m");
        board.disarm().unwrap();
    }
}
