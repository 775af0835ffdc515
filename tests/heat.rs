//! A motor's thermal budget holds across changes of the device and the rules, and across restarts.

use crate::common::property_config;
use crate::rig::{self, Rig, hardware, paddle, rules, scene, wall};
use core::sync::atomic::{AtomicU32, Ordering};
use haptic_bridge::control::{Command, Rules};
use haptic_bridge::drive::heat::{Heat, STORED_WORDS, WORDS, store_heat, stored_heat};
use haptic_bridge::model::motor::Motor;
use haptic_bridge::safety::fault::Fault;
use proptest::prelude::*;

/// Returns the heat of a cold motor that may carry `peak` (A) for 4 s and `continuous` (A) continuously.
fn cold_motor(peak: f32, continuous: f32) -> Heat {
    let mut heat = Heat::default();
    heat.limit(peak, continuous);
    heat
}

/// Returns the unknown heat of a motor that may carry `peak` (A) for 4 s and `continuous` (A) continuously.
fn unknown_heat(peak: f32, continuous: f32) -> Heat {
    let mut heat = Heat::UNKNOWN;
    heat.limit(peak, continuous);
    heat
}

/// Returns the time after which `current` (A) uses up the budget, or `None` if that takes longer than `seconds`.
fn time_to_trip(heat: &mut Heat, current: f32, seconds: f32) -> Option<f32> {
    let dt = 1.0e-3;
    (0..(seconds / dt).round() as u32).find(|_| heat.warm(current * current * dt, dt)).map(|step| step as f32 * dt)
}

fn restored_heat(heat: &Heat) -> Heat {
    Heat::from_words(heat.words())
}

#[test]
fn a_motor_carries_its_peak_for_4_s_and_its_continuous_current() {
    let seconds = time_to_trip(&mut cold_motor(4.0, 1.0), 4.0, 10.0).unwrap();
    assert!((seconds - 4.0).abs() < 0.01, "{seconds}");
    assert_eq!(time_to_trip(&mut cold_motor(4.0, 1.0), 0.999, 200.0), None);
}

#[test]
fn the_smallest_heat_of_a_step_is_counted() {
    // At 50 kHz, 1 % above the continuous current and with most of the budget used, a step adds less than the last
    // digit of the sum. The budget is (4² - 1²) · 4 = 60 A² s, of which 59 are used. (1.01² - 1) A² use the rest in 50
    // s.
    let mut heat = cold_motor(4.0, 1.0);
    let dt = 1.0 / 50_000.0;
    for _ in 0..(59.0_f32 / 15.0 / dt) as u32 {
        heat.warm(4.0 * 4.0 * dt, dt);
    }
    let mut seconds = 0.0_f64;
    while !heat.warm(1.01 * 1.01 * dt, dt) && seconds < 100.0 {
        seconds += f64::from(dt);
    }
    assert!((seconds - 50.0).abs() < 2.0, "{seconds}");
}

#[test]
fn a_larger_continuous_current_applies_once_the_motor_is_cold() {
    let mut heat = cold_motor(4.0, 1.0);
    // 4 A for 1 s add (4² - 1²) A² s.
    assert_eq!(time_to_trip(&mut heat, 4.0, 1.0), None);
    let mut next = restored_heat(&heat);
    for heat in [&mut heat, &mut next] {
        heat.limit(4.0, 3.0);
        assert_eq!(time_to_trip(heat, 0.0, 5.0), None);
        let held = heat.held();
        assert!((held - 10.0).abs() < 0.1, "1 A² s per second: {held} A² s");
        assert_eq!(time_to_trip(heat, 0.0, 11.0), None);
        assert_eq!(time_to_trip(heat, 2.99, 100.0), None, "3 A may flow continuously");
    }
}

#[test]
fn a_larger_continuous_current_applies_after_a_minute() {
    // The continuous current is 10 mA by mistake, so a motor warmed by 0.5 A would take seven hours to cool.
    let mut heat = cold_motor(3.0, 0.01);
    assert_eq!(time_to_trip(&mut heat, 0.5, 10.0), None);
    heat.limit(3.0, 1.0);
    assert!(time_to_trip(&mut heat.clone(), 0.99, 59.0).is_some());
    assert_eq!(time_to_trip(&mut heat, 0.0, 59.0), None);
    assert!(heat.held() > 2.4, "{heat:?}");
    assert_eq!(time_to_trip(&mut heat, 0.0, 5.0), None);
    assert_eq!(heat.held(), 0.0);
}

#[test]
fn a_smaller_continuous_current_does_not_prolong_a_peak() {
    // After half of the 4 s the continuous current is set from 2.9 A to 0.01 A. The other half must be left.
    let mut heat = cold_motor(3.0, 2.9);
    assert_eq!(time_to_trip(&mut heat, 3.0, 2.0), None);
    let mut next = restored_heat(&heat);
    for heat in [&mut heat, &mut next] {
        heat.limit(3.0, 0.01);
        let more = time_to_trip(heat, 3.0, 20.0).unwrap();
        assert!((more - 2.0).abs() < 0.01, "the peak may last another {more} s");
    }
    // Many small reductions must not prolong the peak either.
    let (mut heat, mut current, mut seconds) = (cold_motor(3.0, 2.99), 2.99_f32, 0.0_f32);
    while !heat.warm(9.0e-3, 1.0e-3) {
        seconds += 1.0e-3;
        current *= 0.998;
        heat.limit(3.0, current);
    }
    assert!((seconds - 4.0).abs() < 0.05, "{seconds} s");
}

#[test]
fn unknown_heat_is_half_of_a_budget_once_there_is_a_budget() {
    // There is no budget because every allowed current may flow continuously.
    let heat = unknown_heat(3.0, 3.0);
    assert!(heat.held().is_nan());
    assert!(restored_heat(&heat).held().is_nan(), "still unknown after a restart");
    for mut heat in [heat, restored_heat(&heat)] {
        heat.limit(3.0, 1.0);
        // Half of the budget (3² - 1²) A² · 4 s.
        assert_eq!(heat.held(), 16.0);
    }
    // A device without this motor does not change the motor's heat.
    let mut absent = Heat::UNKNOWN;
    absent.limit(0.0, 1.0);
    assert_eq!(time_to_trip(&mut absent, 0.01, 10.0), None);
    absent.limit(3.0, 1.0);
    assert_eq!(absent.held(), 16.0);
}

#[test]
fn unknown_heat_is_at_most_half_of_the_budget_in_force() {
    // A device with motors of 20 A is loaded first, by mistake.
    let heat = unknown_heat(20.0, 5.0);
    assert_eq!(heat.held(), 0.5 * 4.0 * 375.0);
    for mut heat in [heat, restored_heat(&heat)] {
        heat.limit(3.0, 5.0);
        heat.limit(3.0, 1.0);
        assert!((heat.held() - 16.0).abs() < 0.01, "more heat would trip until a power cycle: {heat:?}");
        // The motor cools. A larger budget then raises the estimate.
        assert_eq!(time_to_trip(&mut heat, 0.0, 4.0), None);
        assert!((heat.held() - 12.0).abs() < 0.01, "{heat:?}");
        heat.limit(4.0, 1.0);
        assert!((heat.held() - 26.0).abs() < 0.01, "{heat:?}");
        // 6 A² s of known heat are added, and no budget reduces known heat.
        assert_eq!(time_to_trip(&mut heat, 2.0, 2.0), None);
        heat.limit(2.0, 1.0);
        assert!((heat.held() - 12.0).abs() < 0.01, "half of 12, and 6: {heat:?}");
    }
}

#[test]
fn a_continuous_current_that_was_too_low_leaves_no_heat() {
    for noise in [0.0, 0.03] {
        let mut heat = cold_motor(3.0, 1.0);
        heat.warm(16.0, 0.0);
        heat.limit(3.0, 0.01);
        assert_eq!(time_to_trip(&mut heat, noise, 100.0), None);
        heat.limit(3.0, 1.0);
        assert_eq!(time_to_trip(&mut heat, 0.0, 17.0), None);
        assert_eq!(heat.held(), 0.0, "1 A² s per second, as when the heat was added");
        assert_eq!(time_to_trip(&mut heat, 0.99, 600.0), None);
    }
}

#[test]
fn a_motor_cools_while_a_device_without_it_is_loaded() {
    let mut heat = cold_motor(3.0, 1.0);
    heat.warm(20.0, 0.0);
    heat.limit(0.0, 1.0);
    assert_eq!(time_to_trip(&mut heat, 0.0, 5.0), None);
    heat.limit(3.0, 1.0);
    assert!((heat.held() - 15.0).abs() < 0.1, "{heat:?}");
}

#[test]
fn an_unlimited_peak_does_not_extend_the_budget() {
    let mut heat = cold_motor(3.0, 1.0);
    heat.warm(31.0, 0.0);
    heat.limit(3.0, 3.0);
    // 1 A² s of the 32 is left, and 3 A use (3² - 1²) A².
    let lasted = time_to_trip(&mut heat, 3.0, 10.0).unwrap();
    assert!((0.12..0.13).contains(&lasted), "{lasted} s");
}

#[test]
fn invalid_words_are_unknown_heat() {
    let mut sound = cold_motor(3.0, 1.0);
    sound.warm(5.0, 0.0);
    assert_eq!(restored_heat(&sound), sound);
    for place in 0..WORDS {
        for bits in [f32::NAN.to_bits(), u32::MAX] {
            let mut words = sound.words();
            words[place] = bits;
            assert_eq!(Heat::from_words(words), Heat::UNKNOWN, "a wrong word {place} is not noticed");
        }
    }
}

#[test]
fn heat_is_kept_over_a_restart_completely_or_not_at_all() {
    let memory: [AtomicU32; STORED_WORDS] = [const { AtomicU32::new(0) }; STORED_WORDS];
    assert_eq!(stored_heat(&memory), [Heat::UNKNOWN; 3], "memory without power");
    let mut heat = [cold_motor(3.0, 1.0), unknown_heat(20.0, 5.0), Heat::default()];
    heat[0].warm(5.0, 0.0);
    store_heat(&heat, &memory);
    assert_eq!(stored_heat(&memory), heat);
    // A restart during the next write leaves one wrong word.
    for place in 0..STORED_WORDS {
        let before = memory[place].fetch_xor(1 << (place % 32), Ordering::Relaxed);
        assert_eq!(stored_heat(&memory), [Heat::UNKNOWN; 3], "a wrong word {place} is not noticed");
        memory[place].store(before, Ordering::Relaxed);
    }
}

#[derive(Clone, Debug)]
enum Event {
    Rules { peak: f32, continuous: f32 },
    Motor(Option<f32>),
    Restart,
    Flows { share: f32, seconds: f32 },
}

fn event() -> impl Strategy<Value = Event> {
    let continuous = prop_oneof![Just(0.3_f32), Just(1.0), Just(1.2), Just(2.0), Just(2.9)];
    prop_oneof![
        (1.5_f32..3.5, continuous).prop_map(|(peak, continuous)| Event::Rules { peak, continuous }),
        prop_oneof![Just(None), Just(Some(3.0)), Just(Some(1.0)), Just(Some(20.0))].prop_map(Event::Motor),
        Just(Event::Restart),
        (0.0_f32..1.0, 0.0_f32..8.0).prop_map(|(share, seconds)| Event::Flows { share, seconds }),
    ]
}

proptest! {
    #![proptest_config(property_config(500))]

    /// The oracle is a lower bound of the heat: the integral of i² - c² with the largest continuous current c so far.
    #[test]
    fn no_request_cools_a_motor_sooner(events in proptest::collection::vec(event(), 1..60)) {
        let (mut heat, mut rules, mut motor) = (Heat::default(), (3.0_f32, 1.0_f32), Some(3.0_f32));
        heat.limit(3.0, 1.0);
        let (mut least, mut largest) = (0.0_f64, 1.0_f64);
        let dt = 0.01_f32;
        for event in events {
            match event {
                Event::Rules { peak, continuous } => rules = (peak, continuous),
                Event::Motor(of) => motor = of,
                Event::Restart => heat = restored_heat(&heat),
                Event::Flows { share, seconds } => {
                    let current = share * motor.unwrap_or(0.0).min(rules.0);
                    for _ in 0..(seconds / dt) as u32 {
                        let is_tripped = heat.warm(current * current * dt, dt);
                        least = (least + (f64::from(current).powi(2) - largest * largest) * f64::from(dt)).max(0.0);
                        let held = f64::from(heat.held());
                        prop_assert!(held >= least - 0.02 - 1.0e-3 * least, "a heat of {held} A² s, expected at least {least}");
                        if is_tripped {
                            break;
                        }
                    }
                }
            }
            let peak = motor.unwrap_or(0.0).min(rules.0);
            heat.limit(peak, rules.1);
            largest = largest.max(f64::from(rules.1.min(peak)));
        }
        // A minute after the last change the present limits apply, so the heat ends.
        heat.limit(3.0, 1.0);
        let rest = |heat: &mut Heat, seconds: f32| (0..(seconds / dt) as u32).for_each(|_| _ = heat.warm(0.0, dt));
        rest(&mut heat, 61.0);
        // The heat falls by 1 A² s per second, times (3² - 2.9²) / (3² - 1²) if it was added at a limit of 2.9 A.
        let seconds = heat.held() / 0.0737 + 1.0;
        rest(&mut heat, seconds);
        prop_assert_eq!(heat.held(), 0.0);
        prop_assert_eq!(time_to_trip(&mut heat, 0.99, 60.0), None);
    }
}

/// Presses a paddle into a wall at 2.9 A until the thermal budget trips. 3 A are allowed, 1 A continuously.
fn tripped_rig() -> Rig {
    let mut rig = Rig::pressed_paddle(290.0);
    rig.hold_in_place(10.0);
    assert_eq!(rig.fault(), Some(Fault::ThermalBudget));
    rig
}

fn raised_rules() -> Rules {
    let mut raised = rules();
    raised.limits.continuous_current = [2.9; 3];
    raised
}

#[test]
fn a_motor_does_not_cool_faster_after_a_restart() {
    let mut rig = tripped_rig();
    let heat = *rig.control_loop.heat();
    rig.execute(Command::Clear).unwrap();
    rig.execute(Command::Rules(raised_rules())).unwrap();
    let mut again = Rig::without_device(hardware(), raised_rules());
    again.control_loop.start_heat(heat);
    again.load(&paddle(), &scene(1, &[wall(-0.05, 100.0)]), false).unwrap();
    for rig in [&mut rig, &mut again] {
        let before = rig.control_loop.heat()[0].held();
        rig.run(4.0);
        let held = rig.control_loop.heat()[0].held();
        assert!((before - held - 4.0).abs() < 0.1, "1 A² s per second: the heat falls from {before} to {held} A² s");
    }
}

#[test]
fn sensor_noise_without_a_motor_does_not_count_as_heat() {
    let mut rig = Rig::without_device(hardware(), rules());
    rig.control_loop.start_heat([Heat::UNKNOWN; 3]);
    let mut bare = paddle();
    bare.joints[0].motor = None;
    rig.shown_current = Some(0.1);
    rig.load(&bare, &scene(1, &[wall(-0.05, 100.0)]), false).unwrap();
    rig.run(1.0);
    rig.load(&paddle(), &scene(1, &[wall(-0.05, 100.0)]), false).unwrap();
    rig.run(0.1);
    rig.run(20.0);
    assert_eq!(rig.control_loop.heat()[0].held(), 0.0, "half of 32 A² s at 1 A² s per second");
}

#[test]
fn a_tighter_continuous_current_while_armed_prolongs_no_peak() {
    let lasts = |tighten: bool| {
        let mut rules = rules();
        rules.limits.continuous_current = [2.7; 3];
        let mut rig = Rig::new(&paddle(), &scene(1, &[wall(-0.005, 290.0)]), hardware(), rules);
        rig.press_wall();
        let began = rig.control_loop.steps();
        while rig.fault().is_none() {
            rig.hold_in_place(0.05);
            if tighten && rules.limits.continuous_current[0] > 0.3 {
                rules.limits.continuous_current[0] -= 0.05;
                rig.execute(Command::Rules(rules)).expect("rules are tightened while armed");
            }
        }
        assert_eq!(rig.fault(), Some(Fault::ThermalBudget));
        (rig.control_loop.steps() - began) as f32 / rig::RATE_HZ
    };
    let (plain, tightened) = (lasts(false), lasts(true));
    assert!(tightened <= plain, "a peak of {plain} s, tightened {tightened} s");
}

#[test]
fn unknown_heat_stays_unknown_over_a_restart() {
    let mut strong = paddle();
    strong.joints[0].motor = Some(Motor { max_current: 20.0, ..strong.joints[0].motor.unwrap() });
    let boot = |heat, current: f32| {
        let mut rules = rules();
        rules.limits.current = [current; 3];
        let mut rig = Rig::without_device(hardware(), rules);
        rig.control_loop.start_heat(heat);
        rig.load(&strong, &scene(1, &[wall(-0.05, 100.0)]), false).unwrap();
        rig
    };
    for (first, then) in [(1.5, 20.0), (20.0, 3.0)] {
        let kept = *boot([Heat::UNKNOWN; 3], first).control_loop.heat();
        let held = boot(kept, then).control_loop.heat()[0].held();
        let half = 0.5 * 4.0 * (then * then - 1.0);
        assert!((held - half).abs() < 0.01 * half, "{first} A, then {then} A: {held} A² s, not {half}");
    }
}

#[test]
fn a_hot_motor_cools_while_off_and_stays_hot_through_a_load() {
    let mut rig = tripped_rig();
    rig.execute(Command::Clear).unwrap();
    rig.turn(0, 0.0, 1.0);
    rig.prepare(&paddle(), &scene(1, &[wall(-0.005, 290.0)]));
    let press = |rig: &mut Rig, seconds: f32| {
        rig.press_wall();
        rig.hold_in_place(seconds);
    };
    press(&mut rig, 0.5);
    assert_eq!(rig.fault(), Some(Fault::ThermalBudget), "the motor had no time to cool");

    // The budget is (3² - 1²) A² for 4 s, and at rest the motor regains 1 A² s per second.
    rig.execute(Command::Clear).unwrap();
    rig.turn(0, 0.0, 1.0);
    rig.run(33.0);
    press(&mut rig, 2.0);
    assert_eq!(rig.fault(), None, "the motor has cooled");
}

/// Returns the seconds until a paddle at 2.9 A trips (3 A allowed, 1 A continuously) on a board that starts with
/// `heat`.
fn pressing_time(heat: Heat) -> f32 {
    let mut rig = Rig::without_device(hardware(), rules());
    rig.control_loop.start_heat([heat; 3]);
    rig.prepare(&paddle(), &scene(1, &[wall(-0.005, 290.0)]));
    rig.press_wall();
    let began = rig.control_loop.frame().step;
    rig.hold_in_place(10.0);
    assert_eq!(rig.fault(), Some(Fault::ThermalBudget));
    (rig.control_loop.frame().step - began) as f32 / rig::RATE_HZ
}

#[test]
fn a_reset_keeps_the_heat_and_unknown_heat_is_half_the_budget() {
    // (2.9² - 1) A² use up the budget of (3² - 1) A² · 4 s in 4.3 s.
    let cold = pressing_time(Heat::default());
    assert!((4.2..4.5).contains(&cold), "{cold} s");
    let hot = tripped_rig().control_loop.heat()[0];
    // The motor cools for 1 s while homing and arming, by the heat of 0.14 s at 2.9 A.
    let after = pressing_time(hot);
    assert!(after < 0.3, "{after} s");
    let warm = pressing_time(Heat::UNKNOWN);
    assert!((0.45 * cold..0.65 * cold).contains(&warm), "{warm} s, cold {cold} s");
}
