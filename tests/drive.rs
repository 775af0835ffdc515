//! The motor stage makes the current of the commanded torque, with duties within the bridge's range.

use haptic_bridge::drive::brushed::{Axis, UNKNOWN_INDUCTANCE_SHARE};
use haptic_bridge::drive::stage::{Bridge, Duty, MAX_DUTY, Stage, Supply};
use haptic_bridge::model::motor::Motor;

const CARRIER_HZ: f32 = 20_000.0;
const BUS_VOLTS: f32 = 24.0;

fn motor() -> Motor<f32> {
    Motor {
        torque_constant: 0.05,
        resistance: 1.5,
        inductance: 1.0e-3,
        back_emf: 0.05,
        max_current: 4.0,
        winding: haptic_bridge::model::motor::Winding::Brushed,
        verified: true,
    }
}

fn bridge(current_sensed: bool) -> Bridge {
    Bridge { carrier_hz: CARRIER_HZ, dead_time: 200.0e-9, bandwidth_hz: 1_000.0, current_sensed, legs: 2 }
}

/// A motor's winding at a constant speed (rad/s), driven by a bridge with a dead time (s). The current is computed
/// exactly between two changes of duty.
struct Winding {
    motor: Motor<f32>,
    speed: f32,
    /// Speed that the drive receives, rad/s.
    measured_speed: f32,
    dead_time: f32,
    current: f32,
    /// Duty of the present voltage across the winding.
    duty: f32,
}

impl Winding {
    fn new(motor: Motor<f32>, speed: f32) -> Self {
        Self { motor, speed, measured_speed: 0.0, dead_time: bridge(true).dead_time, current: 0.0, duty: 0.0 }
    }

    /// Applies a duty for this share of a carrier period.
    fn apply(&mut self, duty: f32, share: f32) {
        let lost = 2.0 * self.dead_time * CARRIER_HZ * BUS_VOLTS * self.current.signum();
        let emf = self.motor.back_emf * self.speed;
        let goal = (duty * BUS_VOLTS - lost - emf) / self.motor.resistance;
        let fade = (-self.motor.resistance / self.motor.inductance / CARRIER_HZ * share).exp();
        self.current = goal + (self.current - goal) * fade;
    }

    /// Runs `periods` carrier periods as on a board. The current is sampled at the crest, and the duty applies from the
    /// next valley on. Calls `at_valley` with the period and the current (A).
    fn run(&mut self, axis: &mut Axis, periods: usize, at_valley: impl FnMut(usize, f32)) {
        self.run_late(axis, periods, |_| false, at_valley);
    }

    /// Like `run`, but the duties of the periods for which `late` is true apply from the next crest on.
    fn run_late(
        &mut self,
        axis: &mut Axis,
        periods: usize,
        late: impl Fn(usize) -> bool,
        mut at_valley: impl FnMut(usize, f32),
    ) {
        for period in 0..periods {
            let late = late(period);
            let next = f32::from(axis.drive(&Supply::of(BUS_VOLTS), self.current, self.measured_speed, late));
            axis.settle(BUS_VOLTS, self.measured_speed, self.measured_speed, self.measured_speed);
            self.apply(self.duty, 0.5);
            at_valley(period, self.current);
            self.duty = if late { self.duty } else { next };
            self.apply(self.duty, 0.5);
            self.duty = next;
        }
    }
}

fn settled_current(motor: &Motor<f32>, has_sensors: bool, torque: f32, speed: f32, seconds: f32) -> (f32, Axis) {
    let mut axis = Axis::new(motor, &bridge(has_sensors), 10.0);
    let mut winding = Winding { measured_speed: speed, ..Winding::new(*motor, speed) };
    axis.command(torque);
    winding.run(&mut axis, (seconds * CARRIER_HZ) as usize, |_, _| {});
    (winding.current, axis)
}

#[test]
fn the_current_loop_makes_the_torque_at_rest_and_in_motion() {
    for torque in [0.1, -0.1, 0.02] {
        for speed in [0.0, 50.0, -50.0] {
            let (current, _) = settled_current(&motor(), true, torque, speed, 0.05);
            assert!((current - torque / 0.05).abs() < 1.0e-3, "{torque} N m at {speed} rad/s: {current} A");
        }
    }
}

#[test]
fn the_current_loop_is_right_with_a_wrong_resistance() {
    let mut warm = motor();
    warm.resistance *= 1.4;
    let mut axis = Axis::new(&motor(), &bridge(true), 10.0);
    let mut winding = Winding::new(warm, 0.0);
    axis.command(0.15);
    winding.run(&mut axis, 2_000, |_, _| {});
    assert!((winding.current - 3.0).abs() < 1.0e-3, "{}", winding.current);
}

#[test]
fn a_step_within_the_bus_voltage_takes_one_carrier_period() {
    // 0.4 A in 50 µs need 8 V across 1 mH and at most 2.4 V across 6 ohm.
    for (resistance, inductance) in
        [(1.5, 1.0e-3), (6.0, 1.0e-3), (1.5, 1.0e-4), (1.5, 2.0e-5), (1.5, 1.0e-9), (0.01, 1.0e-3)]
    {
        let motor = Motor { resistance, inductance, ..motor() };
        let mut axis = Axis::new(&motor, &Bridge { dead_time: 0.0, ..bridge(true) }, 10.0);
        let mut winding = Winding { dead_time: 0.0, ..Winding::new(motor, 0.0) };
        axis.command(0.02);
        winding.run(&mut axis, 50, |period, current| {
            // The duty is computed at the crest of period 0 and applies from its valley to the next valley.
            let wanted = if period == 0 { 0.0 } else { 0.4 };
            assert!((current - wanted).abs() < 0.002, "{resistance} ohm, {inductance} H, period {period}: {current} A");
        });
    }
}

/// A name, and a function that returns true for periods with late duties (steps longer than half a carrier period).
type LatePattern = (&'static str, fn(usize) -> bool);

const LATE_PATTERNS: [LatePattern; 4] = [
    ("always", |_| true),
    ("at every other crest", |period| period.is_multiple_of(2)),
    ("at irregular crests", |period| [0, 1, 3].contains(&(period * period % 7))),
    ("from the fifth crest on", |period| period > 3),
];

#[test]
fn late_duties_agree_with_the_model_of_a_motor_like_its_file() {
    let file = Motor { back_emf: 0.0, ..motor() };
    for inductance in [1.0e-3, 1.0e-4, 2.0e-5] {
        let file = Motor { inductance, ..file };
        for (name, late) in LATE_PATTERNS {
            let mut axis = Axis::new(&file, &Bridge { dead_time: 0.0, ..bridge(true) }, 10.0);
            let mut winding = Winding { dead_time: 0.0, ..Winding::new(file, 0.0) };
            for target in [0.4, -0.4, 2.0, 0.0, -3.5, 3.5, 0.02, 0.02] {
                axis.command(0.05 * target);
                let mut overshoot = 0.0_f32;
                let begin = winding.current;
                winding.run_late(&mut axis, 40, late, |_, current| {
                    overshoot = overshoot.max((current - target) / (target - begin + 0.001));
                });
                let (strain, ..) = axis.strain();
                assert!(strain.abs() < 0.01, "{name}, {inductance} H, {target} A: strain {strain} V");
                assert!(
                    (winding.current - target).abs() < 0.001,
                    "{name}, {inductance} H: a current of {} A, not {target} A",
                    winding.current
                );
                let allowed = if name == "always" { 0.01 } else { 0.51 };
                assert!(overshoot < allowed, "{name}, {inductance} H, {target} A: an overshoot of {overshoot}");
            }
        }
    }
}

#[test]
fn no_pattern_of_late_duties_causes_an_over_current() {
    let limit = 4.0;
    for (resistance, inductance) in [(0.5, 1.0e-4), (0.5, 3.0e-4), (1.5, 1.0e-4), (1.5, 1.0e-3), (0.5, 2.0e-5)] {
        let file = Motor { resistance, inductance, ..motor() };
        // The torque reverses every few periods, at every phase of the late duties, while the rotor turns.
        for (name, late) in LATE_PATTERNS {
            for every in 1..9 {
                let mut axis = Axis::new(&file, &bridge(true), limit);
                let mut winding = Winding::new(file, 0.0);
                for nth in 0..200_usize {
                    winding.speed = 60.0 * (nth as f32 * 0.05).sin();
                    winding.measured_speed = winding.speed;
                    axis.command(if nth.is_multiple_of(2) { 0.2 } else { -0.2 });
                    winding.run_late(&mut axis, every, |period| late(nth * every + period), |_, _| {});
                    let case = format!("{name}, {resistance} ohm, {inductance} H, every {every}, reversal {nth}");
                    assert!(winding.current.abs() < 1.5 * limit + 1.0, "{case}: a current of {} A", winding.current);
                    let (strain, _, tolerance) = axis.strain();
                    assert!(strain.abs() < tolerance, "{case}: a strain of {strain} V, tolerance {tolerance} V");
                }
            }
        }
    }
}

#[test]
fn a_step_beyond_the_bus_voltage_takes_longer_and_settles() {
    let step = |actual: Motor<f32>| {
        let mut axis = Axis::new(&motor(), &bridge(true), 10.0);
        let (mut peak, mut arrived) = (0.0_f32, None);
        axis.command(0.1);
        Winding::new(actual, 0.0).run(&mut axis, 200, |period, current| {
            peak = peak.max(current);
            arrived = arrived.or((current > 1.8).then_some(period));
        });
        (peak / 2.0, arrived.unwrap_or(usize::MAX))
    };
    // 2 A in 50 µs would need 43 V. The available 22 V need two periods.
    let (peak, arrived) = step(motor());
    assert!(peak < 1.01 && arrived == 2, "{peak} of the step, {arrived} periods");
    // If the inductance is lower than in the file, the current overshoots by the same share until it is corrected.
    for (resistance, inductance) in [(1.4, 1.0), (0.7, 1.0), (1.0, 1.3), (1.0, 0.7), (1.4, 0.7)] {
        let expected = motor();
        let actual = Motor {
            resistance: resistance * expected.resistance,
            inductance: inductance * expected.inductance,
            ..expected
        };
        let (peak, arrived) = step(actual);
        assert!(peak < 1.4 && arrived <= 5, "R x {resistance}, L x {inductance}: peak {peak}, {arrived} periods");
    }
}

/// Computes the overshoot of a winding's current, as a share of the final current. The final voltage is applied at once
/// while a loop of `bandwidth` (rad/s) integrates the error. With s = L/R d/dt, `winding` = L/R (s) and x = bandwidth
/// L/R the error obeys e'' + e' + x e = 0, e(0) = 1, e'(0) = -1. The overshoot is the negative minimum of e.
fn overshoot(winding: f64, bandwidth: f64) -> f64 {
    let (x, h) = (bandwidth * winding, 1.0e-4);
    let (mut error, mut rate, mut least) = (1.0_f64, -1.0_f64, 0.0_f64);
    for _ in 0..200_000 {
        // The error of the midpoint rule with these steps is below 1e-7.
        let (middle, middle_rate) = (error + 0.5 * h * rate, rate + 0.5 * h * (-rate - x * error));
        (error, rate) = (error + h * middle_rate, rate + h * (-middle_rate - x * middle));
        least = least.min(error);
    }
    -least
}

#[test]
fn a_winding_of_unknown_inductance_overshoots_as_documented() {
    let file = Motor { inductance: 0.0, ..motor() };
    let bandwidth = f64::from(UNKNOWN_INDUCTANCE_SHARE * bridge(true).bandwidth_hz) * core::f64::consts::TAU;
    for (inductance, documented) in [(0.45e-3, 0.07), (1.2e-3, 0.14), (1.5e-3, 0.16)] {
        let mut axis = Axis::new(&file, &bridge(true), 10.0);
        axis.command(0.1);
        let mut peak = 0.0_f32;
        let mut winding = Winding::new(Motor { inductance, ..file }, 0.0);
        winding.run(&mut axis, 1_000, |_, current| peak = peak.max(current));
        let found = f64::from(peak) / 2.0 - 1.0;
        let expected = overshoot(f64::from(inductance / file.resistance), bandwidth);
        // The loop is up to 3/4 of a carrier period late: 314 rad/s · 37.5 µs are 1.2 % of the integral's share (up to
        // 0.31).
        assert!((found - expected).abs() < 0.004, "{inductance} H: overshoot {found}, not {expected}");
        assert!((found - documented).abs() < 0.005, "{inductance} H: overshoot {found}, documented {documented}");
    }
}

#[test]
fn a_winding_of_unknown_inductance_does_not_ring() {
    let file = Motor { inductance: 0.0, ..motor() };
    for inductance in [1.0e-5, 1.0e-4, 1.0e-3, 1.5e-3] {
        let mut axis = Axis::new(&file, &bridge(true), 10.0);
        axis.command(0.1);
        let (mut over, mut least) = (false, 2.0_f32);
        let mut winding = Winding::new(Motor { inductance, ..file }, 0.0);
        winding.run(&mut axis, 1_000, |_, current| {
            over |= current > 2.0;
            least = if over { least.min(current) } else { least };
        });
        // At x = 0.31 the solution in `overshoot` swings back by exp(-π/2 / √(x - 1/4)) = 0.2 % of the change.
        assert!(least > 0.99 * 2.0, "{inductance} H: the current falls back to {least} A");
        assert!((winding.current - 2.0).abs() < 0.01, "{inductance} H: a current of {} A", winding.current);
    }
}

#[test]
fn without_a_current_sensor_the_model_sets_the_voltage() {
    for (torque, speed) in [(0.1, 0.0), (-0.1, 20.0), (0.15, -60.0)] {
        let (current, _) = settled_current(&motor(), false, torque, speed, 0.05);
        assert!((current - torque / 0.05).abs() < 0.1, "{torque} N m at {speed} rad/s: {current} A");
    }
}

/// Commands a torque and returns the resulting current command, A.
fn commanded_current(axis: &mut Axis, torque: f32) -> f32 {
    axis.command(torque);
    axis.target_current()
}

#[test]
fn the_current_command_stays_within_the_current_limit() {
    let mut axis = Axis::new(&motor(), &bridge(true), 3.0);
    assert_eq!(commanded_current(&mut axis, 99.0), 3.0);
    assert_eq!(commanded_current(&mut axis, -99.0), -3.0);
    let mut axis = Axis::new(&motor(), &bridge(true), 99.0);
    assert_eq!(commanded_current(&mut axis, 99.0), 4.0, "the motor's own limit");
    axis.limit(1.0);
    assert_eq!(commanded_current(&mut axis, 99.0), 1.0);
    axis.limit(99.0);
    assert_eq!(commanded_current(&mut axis, 99.0), 4.0);
    axis.limit(-1.0);
    assert_eq!(commanded_current(&mut axis, 99.0), 0.0);
}

#[test]
fn a_motor_without_a_torque_constant_gets_no_current() {
    let mut dead = motor();
    dead.torque_constant = 0.0;
    let mut axis = Axis::new(&dead, &bridge(true), 10.0);
    assert_eq!(commanded_current(&mut axis, 1.0), 0.0);
    axis.limit(10.0);
    assert_eq!(commanded_current(&mut axis, 1.0), 0.0);
}

#[test]
fn the_integrator_does_not_wind_up_at_a_saturated_bus() {
    // 4 A need 6 V, and 480 rad/s induce 24 V, so 24 V cannot make this current. Once the motor has stopped, the
    // current must be right within 2 ms.
    let mut axis = Axis::new(&motor(), &bridge(true), 10.0);
    let mut winding = Winding { measured_speed: 480.0, ..Winding::new(motor(), 480.0) };
    axis.command(0.2);
    winding.run(&mut axis, 20_000, |_, _| {});
    (winding.speed, winding.measured_speed) = (0.0, 0.0);
    axis.command(0.2);
    winding.run(&mut axis, 40, |_, _| {});
    assert!((winding.current - 4.0).abs() < 0.05, "{}", winding.current);
}

const TEST_NUMBERS: [f32; 12] = [
    0.0,
    -0.0,
    1.0,
    -1.0,
    1.0e-30,
    3.0e38,
    -3.0e38,
    f32::MIN_POSITIVE,
    f32::INFINITY,
    f32::NEG_INFINITY,
    f32::NAN,
    24.0,
];

#[test]
fn each_leg_stays_between_4_and_96_percent_for_any_input() {
    for has_sensors in [true, false] {
        for torque in TEST_NUMBERS {
            for speed in TEST_NUMBERS {
                for bus in TEST_NUMBERS {
                    for current in TEST_NUMBERS {
                        let mut axis = Axis::new(&motor(), &bridge(has_sensors), 10.0);
                        axis.command(torque);
                        for late in [false, true, true, false] {
                            let duty = f32::from(axis.drive(&Supply::of(bus), current, speed, late));
                            let legs = [0.5 + 0.5 * duty, 0.5 - 0.5 * duty];
                            let inside = legs.iter().all(|leg| (0.039_999..=0.960_001).contains(leg));
                            assert!(inside, "{torque} N m, {speed} rad/s, {bus} V, {current} A: duty {duty}");
                        }
                    }
                }
            }
        }
    }
}

#[test]
fn a_motor_with_any_parameters_gets_a_duty_within_bounds() {
    for a in TEST_NUMBERS {
        for b in TEST_NUMBERS {
            for c in TEST_NUMBERS {
                let motor = Motor {
                    torque_constant: a,
                    resistance: b,
                    inductance: c,
                    back_emf: a,
                    max_current: b,
                    winding: haptic_bridge::model::motor::Winding::Brushed,
                    verified: true,
                };
                let mut axis = Axis::new(&motor, &bridge(true), c);
                axis.command(1.0);
                for late in [false, true, true, false] {
                    let duty = f32::from(axis.drive(&Supply::of(BUS_VOLTS), 0.5, 1.0, late));
                    assert!(duty.abs() <= MAX_DUTY, "motor {a} {b} {c}: duty {duty}");
                }
            }
        }
    }
}

#[test]
fn the_current_loop_recovers_from_invalid_numbers() {
    for torque in TEST_NUMBERS {
        for speed in TEST_NUMBERS {
            for bus in TEST_NUMBERS {
                let mut axis = Axis::new(&motor(), &bridge(true), 10.0);
                axis.command(torque);
                let drives = [true, false, true].map(|late| axis.drive(&Supply::of(bus), torque, speed, late));
                assert!(drives.iter().all(|duty| f32::from(*duty).abs() <= MAX_DUTY));
                axis.command(0.1);
                let mut winding = Winding::new(motor(), 0.0);
                winding.run(&mut axis, 400, |_, _| {});
                assert!((winding.current - 2.0).abs() < 0.01, "{torque}, {speed}, {bus} V: {} A", winding.current);
            }
        }
    }
}

#[test]
fn without_supply_there_is_no_duty() {
    let mut axis = Axis::new(&motor(), &bridge(true), 10.0);
    axis.command(0.1);
    for bus in [0.0, 0.5, -24.0, f32::NAN] {
        assert_eq!(axis.drive(&Supply::of(bus), 0.0, 0.0, false), Duty::default());
    }
}

/// A lowered limit must act at once because between two control steps (100 crests at 200 Hz) no torque is commanded.
#[test]
fn a_lowered_current_limit_acts_at_the_next_crest() {
    let motor = Motor { max_current: 20.0, ..motor() };
    let mut axis = Axis::new(&motor, &bridge(true), 20.0);
    axis.command(axis.torque_of(10.0));
    axis.limit(6.0);
    assert_eq!(axis.target_current(), 6.0);
    axis.command(axis.torque_of(-10.0));
    axis.limit(5.0);
    assert_eq!(axis.target_current(), -5.0);
}

/// A limit that is lowered after loading must tighten the motor's model like a limit that was set before.
#[test]
fn a_lowered_limit_tightens_the_model_of_unknown_inductance() {
    for inductance in [0.0, 1.0e-3] {
        let motor = Motor { inductance, max_current: 20.0, ..motor() };
        let mut lowered = Axis::new(&motor, &bridge(true), 20.0);
        lowered.limit(0.5);
        assert_eq!(lowered, Axis::new(&motor, &bridge(true), 0.5), "{inductance} H");
    }
}
