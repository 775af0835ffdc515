//! The control step over long times, at far angles, with wrapping counters, at singularities, and with invalid numbers.

use crate::common::device_file::shipped_device;
use crate::hard_cases::rows::steps::{controller, counts, pad_to_three, scene, with_encoders};
use crate::rig::{self, Rig};
use haptic_bridge::control::Command;
use haptic_bridge::control::compiled::BoardMath;
use haptic_bridge::control::joints::Counts;
use haptic_bridge::control::program::Program;
use haptic_bridge::drive::stage::MAX_DUTY;
use haptic_bridge::math::Libm;
use haptic_bridge::model::description::Description;
use haptic_bridge::model::device::Device;
use haptic_bridge::model::mechanism::{AnyMechanism, FiveBar, Mechanism};
use haptic_bridge::render::controller::{Controller, FULL_REGULARITY, NO_REGULARITY, PARALLEL_REGULARITY, Step};
use haptic_bridge::render::scene::FeedForward;
use nalgebra::{SVector, Vector2, Vector3};

const COUNTS_PER_TURN: i32 = 1_048_576;

type HaplyController = Controller<f32, FiveBar<f32>, BoardMath, 2>;

/// Returns the controller of a Haply whose tip is on a wall, with all terms on, and the start pose.
fn haply_controller(feed_forward: FeedForward) -> (HaplyController, Vector2<f64>) {
    let device = with_encoders(&shipped_device("haply-2diy"));
    let Ok(AnyMechanism::FiveBar(mechanism)) = AnyMechanism::<f32>::new(&device) else { panic!("a sound five-bar") };
    let Ok(AnyMechanism::FiveBar(double)) = AnyMechanism::<f64>::new(&device) else { panic!("a sound five-bar") };
    let q = Vector2::new(2.4, 0.7);
    let tip = double.tip(&double.pose::<Libm>(&q));
    let scene = scene(2, [tip.x, tip.y, 0.0], [0.6, 0.8, 0.0], 1_000.0, 5.0, feed_forward);
    (controller(mechanism, &device, &scene), q)
}

/// Returns the counts of a periodic motion in and out of the wall of [`haply_controller`].
fn motion_counts(q: &Vector2<f64>, step: u32) -> [i32; 2] {
    let t = f64::from(step % 1_000) / 1_000.0 * std::f64::consts::TAU;
    counts(&Vector2::new(q.x + 0.1 * libm::sin(t), q.y + 0.1 * libm::cos(2.0 * t)))
}

fn assert_same(a: &Step<f32, 2>, b: &Step<f32, 2>) {
    assert_eq!((a.torque, a.tip, a.qd, a.wall_force), (b.torque, b.tip, b.qd, b.wall_force));
}

#[test]
fn wrapping_counters_change_nothing() {
    let (mut plain, q) = haply_controller(FeedForward::Washout);
    let (mut wrapping, _) = haply_controller(FeedForward::Washout);
    let start = motion_counts(&q, 0);
    // One raw counter overflows upwards, the other downwards, while the tip is in the wall.
    let shift = [(i32::MAX - 10).wrapping_sub(start[0]), (i32::MIN + 10).wrapping_sub(start[1])];
    let shifted = |c: [i32; 2]| [c[0].wrapping_add(shift[0]), c[1].wrapping_add(shift[1])];
    let home = [(f64::from(start[0]) / f64::from(COUNTS_PER_TURN) * std::f64::consts::TAU) as f32, q.y as f32 + 0.1];
    plain.home(&start, &home);
    wrapping.home(&shifted(start), &home);
    let mut wrapped = [false; 2];
    for step in 0..3_000 {
        let c = motion_counts(&q, step);
        for i in 0..2 {
            wrapped[i] |= c[i].checked_add(shift[i]).is_none();
        }
        assert_same(&wrapping.step(&shifted(c)), &plain.step(&c));
    }
    assert_eq!(wrapped, [true; 2]);
}

#[test]
fn a_pose_many_turns_away_is_the_same_pose() {
    for turns in [1, 7, 1_000, 2_000] {
        let (mut near, q) = haply_controller(FeedForward::Full);
        let (mut far, _) = haply_controller(FeedForward::Full);
        let (mut behind, _) = haply_controller(FeedForward::Full);
        for step in 0..2_000 {
            let c = motion_counts(&q, step);
            let a = near.step(&c);
            let b = far.step(&c.map(|c| c + turns * COUNTS_PER_TURN));
            assert_eq!((a.torque, a.tip, a.qd), (b.torque, b.tip, b.qd));
            // Negative angles round differently.
            let b = behind.step(&c.map(|c| c - turns * COUNTS_PER_TURN));
            assert!((a.tip - b.tip).amax() < 1e-7, "the tip differs after {turns} turns");
            assert!((a.torque - b.torque).amax() < 1e-3, "after {turns} turns: torque {} and {}", a.torque, b.torque);
        }
    }
}

#[test]
fn ten_hours_at_1_khz_do_not_change_a_step() {
    const STEPS: u32 = 10 * 3600 * 1000;
    let (mut long, q) = haply_controller(FeedForward::Washout);
    let (mut short, _) = haply_controller(FeedForward::Washout);
    let period: Vec<[i32; 2]> = (0..1_000).map(|step| motion_counts(&q, step)).collect();
    let at = |step: u32| &period[(step % 1_000) as usize];
    // In the last 100 s every filter forgets its initial state.
    const FIRST_COMPARED: u32 = STEPS - 100_000;
    for step in 0..FIRST_COMPARED {
        long.step(at(step));
    }
    let mut largest = 0.0_f32;
    let mut worst = 0.0_f32;
    for step in FIRST_COMPARED..STEPS {
        let (a, b) = (long.step(at(step)), short.step(at(step)));
        if step >= STEPS - 1_000 {
            largest = largest.max(b.torque.amax());
            worst = worst.max((a.torque - b.torque).amax());
        }
    }
    assert!(largest > 0.01, "the tip must touch the wall: {largest}");
    assert!(worst <= 1e-6 * largest, "torques differ by {worst} of {largest} N m");
}

/// Moves a device along a path of joint angles with a constant force of about 1 N on its tip. Returns the result of
/// every step, and the sine that scales the feed-forward.
fn steps_along<M: Mechanism<f32, N>, const N: usize>(
    mechanism: M,
    device: &Description,
    normal: [f64; 3],
    path: impl Iterator<Item = SVector<f64, N>>,
) -> Vec<(Step<f32, N>, f32)> {
    // The surface of this 1 N/m wall is 1 m away, so the force hardly changes along the path.
    let task = M::SPEC.task;
    let scene = scene(task, normal, normal, 1.0, 0.0, FeedForward::Full);
    let mut controller = controller::<f32, BoardMath, M, N>(mechanism, device, &scene);
    path.map(|q| {
        let step = controller.step(&counts(&q));
        let regularity = mechanism.regularity(&mechanism.pose::<BoardMath>(&step.q));
        (step, regularity.serial.min(regularity.parallel / PARALLEL_REGULARITY as f32))
    })
    .collect()
}

/// Asserts that the feed-forward fades from 1 to 0 between the documented sines, and that torques change smoothly.
fn assert_fades<const N: usize>(name: &str, steps: &[(Step<f32, N>, f32)]) {
    let largest = steps.iter().fold(0.0_f32, |most, (step, _)| most.max(step.torque.amax()));
    for (step, sine) in steps {
        assert!(step.torque.iter().all(|t| t.is_finite()), "{name}: {step:?}");
        assert!(*sine < FULL_REGULARITY as f32 || step.shaping == 1.0, "{name} at {sine}: share {}", step.shaping);
        assert!(*sine > NO_REGULARITY as f32 || step.shaping == 0.0, "{name} at {sine}: share {}", step.shaping);
    }
    assert_eq!(steps[0].0.shaping, 1.0, "{name}");
    assert_eq!(steps[steps.len() - 1].0.shaping, 0.0, "{name}");
    for pair in steps.windows(2).skip(200) {
        let ((before, _), (after, sine)) = (&pair[0], &pair[1]);
        let jump = (after.torque - before.torque).amax();
        assert!(jump < 0.02 * largest, "{name} at a sine of {sine}: the torque jumps by {jump} of {largest}");
        assert!((after.shaping - before.shaping).abs() < 0.01, "{name}");
    }
}

/// Returns a straight path of joint angles from `start` to `end` in steps of a few counts.
fn straight_path<const N: usize>(
    start: SVector<f64, N>,
    end: SVector<f64, N>,
) -> impl Iterator<Item = SVector<f64, N>> {
    (0..=40_000).map(move |k| start + (end - start) * (f64::from(k) / 40_000.0))
}

fn mechanism_of(file: &str) -> AnyMechanism<f32> {
    AnyMechanism::new(&shipped_device(file)).expect("a sound device")
}

#[test]
fn the_feed_forward_fades_smoothly_near_an_elbow_singularity() {
    let AnyMechanism::Parallelogram(phantom) = mechanism_of("phantom-premium-1.5") else { panic!("a parallelogram") };
    let folding = straight_path(Vector3::new(0.3, 0.9, -0.3), Vector3::new(0.3, 0.9, 0.895));
    assert_fades(
        "parallelogram",
        &steps_along(phantom, &with_encoders(&shipped_device("phantom-premium-1.5")), [0.6, 0.8, 0.0], folding),
    );
    let AnyMechanism::Serial3r(arm) = mechanism_of("serial-3r") else { panic!("a serial arm") };
    let stretching = straight_path(Vector3::new(0.5, 0.8, 0.7), Vector3::new(0.5, 0.005, 0.7));
    let device = with_encoders(&shipped_device("serial-3r"));
    assert_fades("serial-3r", &steps_along(arm, &device, [0.6, 0.8, 0.0], stretching));
}

#[test]
fn the_feed_forward_fades_smoothly_near_the_turrets_axis() {
    let AnyMechanism::Parallelogram(phantom) = mechanism_of("phantom-premium-1.5") else { panic!("a parallelogram") };
    // The tip reaches the turret's axis when both arm angles are past the vertical by the same amount.
    let over = straight_path(Vector3::new(0.3, 1.2, 0.3), Vector3::new(0.3, 2.1, 0.905));
    let device = with_encoders(&shipped_device("phantom-premium-1.5"));
    assert_fades("axis", &steps_along(phantom, &device, [0.6, 0.0, 0.8], over));
}

#[test]
fn the_feed_forward_fades_smoothly_near_a_parallel_singularity() {
    let mut device = with_encoders(&shipped_device("coupled-five-bar"));
    device.geometry[0] = 0.1;
    let Ok(AnyMechanism::FiveBar(wide)) = AnyMechanism::<f32>::new(&device) else { panic!("a five-bar") };
    // Both arms swing outwards until the rods are almost in line, where base + 2 l cos = 2 r.
    let outwards = straight_path(Vector2::new(2.0, 1.141_592_65), Vector2::new(2.497_592_65, 0.644));
    assert_fades("rods", &steps_along(wide, &device, [0.6, 0.8, 0.0], outwards));
}

#[test]
fn the_feed_forward_fades_smoothly_near_both_singularities_of_a_delta() {
    let AnyMechanism::Delta(delta) = mechanism_of("falcon-like") else { panic!("a delta") };
    let device = with_encoders(&shipped_device("falcon-like"));
    // One leg is stretched.
    let stretching = straight_path(Vector3::new(-1.2, 0.0, 0.0), Vector3::new(-1.81, 0.0, 0.0));
    assert_fades("leg", &steps_along(delta, &device, [0.6, 0.8, 0.0], stretching));
    // The elbows come together, so that the rods become parallel.
    let inwards = straight_path(Vector3::repeat(0.9), Vector3::repeat(1.7));
    assert_fades("rods", &steps_along(delta, &device, [0.6, 0.8, 0.0], inwards));
}

#[test]
fn torques_are_finite_at_any_count() {
    for feed_forward in [FeedForward::Off, FeedForward::Full, FeedForward::Washout] {
        let (mut controller, _) = haply_controller(feed_forward);
        let extremes = [0, 1, -1, i32::MAX, i32::MIN, i32::MAX / 3, i32::MIN / 7, COUNTS_PER_TURN / 2];
        for a in extremes {
            for b in extremes {
                let step = controller.step(&[a, b]);
                assert!(step.torque.iter().chain(step.tip.iter()).chain(step.qd.iter()).all(|x| x.is_finite()));
                assert!(step.wall_force.is_finite() && step.wall_force >= 0.0);
            }
        }
    }
}

#[test]
fn torques_are_finite_at_every_pose_of_every_shipped_device() {
    fn sweep<M: Mechanism<f32, N>, const N: usize>(mechanism: M, file: &str) {
        let device = with_encoders(&shipped_device(file));
        let n = pad_to_three(&SVector::<f64, N>::from_element(1.0 / (M::SPEC.task as f64).sqrt()), M::SPEC.task);
        let scene = scene(M::SPEC.task, n, n, 1e6, 100.0, FeedForward::Full);
        let mut controller = controller::<f32, BoardMath, M, N>(mechanism, &device, &scene);
        // The angles include right angles, straight lines, closures that do not exist, and exactly singular poses.
        let angles: Vec<i32> = (0..16).map(|k| k * (COUNTS_PER_TURN / 16)).collect();
        for k in 0..16_usize.pow(N as u32) {
            let at: [i32; N] = core::array::from_fn(|i| angles[k / 16_usize.pow(i as u32) % 16]);
            for _ in 0..2 {
                let step = controller.step(&at);
                assert!(step.torque.iter().all(|x| x.is_finite()), "{file} at {at:?}: {step:?}");
            }
        }
    }
    for file in ["hapkit-paddle", "haply-2diy", "coupled-five-bar", "pantograph-mk2", "serial-3r"] {
        haptic_bridge::with_mechanism!(mechanism_of(file), m => sweep(m, file));
    }
    for file in ["fictive-five-bar-turret", "phantom-premium-1.5", "woodenhaptics", "falcon-like"] {
        haptic_bridge::with_mechanism!(mechanism_of(file), m => sweep(m, file));
    }
}

const INVALID_NUMBERS: [f32; 7] =
    [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, f32::MIN_POSITIVE / 8.0, -1.0e-45, -0.0];

#[test]
fn invalid_measurements_never_reach_a_duty() {
    for poison in INVALID_NUMBERS {
        for field in 0..4 {
            let mut rig = Rig::armed_paddle();
            match field {
                0 => rig.samples.bus_voltage = poison,
                1 => rig.shown_current = Some(poison),
                2 => rig.resistance = poison,
                _ => rig.reported_fault = Some((haptic_bridge::safety::fault::Fault::GateDriver, None, poison)),
            }
            for _ in 0..50 {
                rig.step();
                assert!(rig.duties.iter().all(|duty| duty.abs() <= MAX_DUTY), "{poison}: duties {:?}", rig.duties);
            }
            let frame = rig.control_loop.frame();
            assert!(frame.motors.torque.iter().all(|t| t.is_finite()), "{poison}: {frame:?}");
        }
    }
}

#[test]
fn a_device_with_an_invalid_number_is_refused_or_harmless() {
    let scene = rig::scene(2, &[rig::wall(0.0, 1_000.0)]);
    let sound = rig::device(&rig::five_bar());
    let mut buffer = [0; 1024];
    let bytes = postcard::to_slice(&sound, &mut buffer).expect("a device can be sent").to_vec();
    let (mut loaded, mut refused) = (0, 0);
    for poison in INVALID_NUMBERS {
        for place in 0..bytes.len() - 4 {
            let mut spoilt = bytes.clone();
            spoilt[place..place + 4].copy_from_slice(&poison.to_le_bytes());
            let Ok(device) = postcard::from_bytes::<Device<f32>>(&spoilt) else { continue };
            let mut rig = Rig::without_device(rig::hardware(), rig::rules());
            let program = Program::new(&rig.hardware, &rig.rules.limits, &device, &scene, false);
            let Ok(program) = program else {
                refused += 1;
                continue;
            };
            if rig.execute(Command::Program(Box::new(program))).is_err() {
                refused += 1;
                continue;
            }
            loaded += 1;
            rig.settle();
            let _ = rig.execute(Command::Home);
            rig.settle();
            let _ = rig.execute(Command::PolarityKnown);
            let _ = rig.execute(Command::Arm);
            for k in 0..200 {
                rig.samples.counts = Counts([40 * (k % 50), -30 * (k % 50), 0]);
                rig.step();
                assert!(rig.duties.iter().all(|duty| duty.abs() <= MAX_DUTY), "byte {place}: duties {:?}", rig.duties);
            }
        }
    }
    assert!(loaded > 500 && refused > 0, "{loaded} loaded, {refused} refused");
}
