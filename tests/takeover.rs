//! A program that replaces another keeps the values that do not change with a scene. These values must equal the values
//! of a program that is loaded first.

use crate::rig::{COUNTS_PER_TURN, Rig, at_rate, far_wall, five_bar, hardware, limits, paddle, rules, scene, wall};
use haptic_bridge::control::frame::Samples;
use haptic_bridge::control::joints::Counts;
use haptic_bridge::control::{Command, Rules};
use haptic_bridge::drive::carrier::Carrier;
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::render::scene::Scene;
use haptic_bridge::safety::fault::Fault;
use haptic_bridge::safety::limits::Limits;

/// Returns the prepared values of stages, bounds and limits as text.
fn prepared_values(rig: &Rig) -> String {
    let all = format!("{:?}", rig.control_loop);
    let part = |from: &str, to: &str| {
        // The program has fields of the same names, but the last ones belong to the control loop.
        let begin = all.rfind(from).unwrap_or_else(|| panic!("{from}"));
        let end = begin + all[begin..].find(to).unwrap_or_else(|| panic!("{to}"));
        format!("{}\n", &all[begin..end])
    };
    part("crests: ", ", drive_voltage")
        + &part("unclamped_torque: ", ", now:")
        + &part(", joints: [", ", hardware")
        + &part(", period: ", ", rate_since")
        + &part("heat: [", ", first_index")
}

fn load_scenes(first: Option<&Scene<f32>>, then: &Scene<f32>, change: impl Fn(&mut Rig)) -> Rig {
    let description = five_bar();
    let mut rig = Rig::without_device(hardware(), rules());
    if let Some(first) = first {
        rig.load(&description, first, false).expect("a program that fits");
    }
    change(&mut rig);
    rig.load(&description, then, first.is_some()).expect("a program that fits");
    rig
}

const RATES_HZ: [f32; 14] = [
    200.0,
    500.0,
    499.999_97,
    1_000.0,
    999.999_94,
    2_000.0,
    1_999.999_9,
    4_000.0,
    3_999.999_8,
    7_000.0,
    20_000.0,
    19_999.998,
    45_000.0,
    50_000.0,
];

#[test]
fn a_scene_has_the_same_prepared_values_after_another_scene() {
    let mut differences = Vec::new();
    for first in RATES_HZ {
        for second in RATES_HZ {
            let y = Scene { gravity_compensation: true, ..at_rate(second, scene(2, &[wall(-0.3, 900.0)])) };
            let (taken_over, fresh) =
                (load_scenes(Some(&at_rate(first, scene(2, &[]))), &y, |_| ()), load_scenes(None, &y, |_| ()));
            if prepared_values(&taken_over) != prepared_values(&fresh) {
                differences.push((first, second));
            }
        }
    }
    assert!(differences.is_empty(), "{differences:?}");
}

#[test]
fn limits_changed_between_two_scenes_apply_to_the_second() {
    let mut other = rules();
    other.limits =
        Limits { current: [0.7; MAX_JOINTS], speed: [3.0; MAX_JOINTS], power: 0.5, tip_force: 2.0, ..limits() };
    other.passivity = true;
    for rate in [200.0, 1_000.0, 7_000.0, 20_000.0, 50_000.0] {
        let (x, y) = (at_rate(rate, scene(2, &[])), at_rate(rate, scene(2, &[wall(-0.3, 900.0)])));
        for before in [true, false] {
            // As in a restore, the program is built with the new rules, which are loaded after the program.
            let with = |first: Option<&Scene<f32>>| {
                let mut rig = load_scenes(first, &y, |rig| {
                    rig.rules = other;
                    if before {
                        rig.execute(Command::Rules(other)).expect("off");
                    }
                });
                rig.execute(Command::Rules(other)).expect("off");
                rig
            };
            assert_eq!(prepared_values(&with(Some(&x))), prepared_values(&with(None)), "{rate} Hz, before {before}");
        }
    }
}

/// Returns the lowest speed (rad/s) that trips the limit of 20 rad/s, with samples at every crest of the true carrier.
fn lowest_tripping_speed(first: Option<f32>, rate: f32) -> f64 {
    let limited = Rules { limits: Limits { power: 1.0e3, ..limits() }, ..rules() };
    let mut description = paddle();
    description.joints[0].limits = Some((-100.0, 100.0));
    let carrier_hz = f64::from(Carrier::for_rate(hardware().timer_hz, rate).carrier_hz());
    for tenths in 150..400 {
        let speed = f64::from(tenths) * 0.1;
        let mut rig = Rig::new(&description, &at_rate(first.unwrap_or(rate), far_wall()), hardware(), limited);
        if first.is_some() {
            rig.load(&description, &at_rate(rate, far_wall()), true).expect("a scene");
        }
        rig.execute(Command::Arm).expect("the board is ready to arm");
        let counts_per_crest = COUNTS_PER_TURN / std::f64::consts::TAU * speed / carrier_hz;
        for crest in 0..(0.05 * carrier_hz) as i32 {
            let counts = Counts([(counts_per_crest * f64::from(crest)) as i32, 0, 0]);
            rig.control_loop.guard(&Samples { counts, ..rig.samples });
        }
        if rig.fault() == Some(Fault::SpeedLimit) {
            return speed;
        }
        assert_eq!(rig.fault(), None, "{speed} rad/s");
    }
    f64::INFINITY
}

#[test]
fn a_rounding_of_the_rate_does_not_move_the_speed_limit() {
    let mut differences = Vec::new();
    for (first, second) in [(1_000.0, 999.999_94), (2_000.0, 1_999.999_9), (4_000.0, 3_999.999_8)] {
        let (alone, after_first) = (lowest_tripping_speed(None, second), lowest_tripping_speed(Some(first), second));
        println!("{first:?} then {second:?}: {alone:.1} rad/s by itself, {after_first:.1} rad/s after the other");
        if (after_first - alone).abs() > 0.15 {
            differences.push((first, second, alone, after_first));
        }
    }
    assert!(differences.is_empty(), "{differences:?}");
}
