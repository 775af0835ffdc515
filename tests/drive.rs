//! The drive makes the current that the torque needs, within duties that the bridge can stand.

use haptic_bridge::device::Motor;
use haptic_bridge::drive::{Axis, Bridge, MAX_DUTY};

const CARRIER: f32 = 20_000.0;
const BUS: f32 = 24.0;

fn motor() -> Motor<f32> {
    Motor {
        torque_constant: 0.05,
        resistance: 1.5,
        inductance: 1.0e-3,
        back_emf: 0.05,
        max_current: 4.0,
        verified: true,
    }
}

fn bridge(current_sensed: bool) -> Bridge {
    Bridge { carrier_hz: CARRIER, dead_time: 200.0e-9, bandwidth_hz: 1_000.0, current_sensed }
}

/// A motor's winding at a constant speed (rad/s), with the dead time of its bridge; exact between two duties.
struct Winding {
    motor: Motor<f32>,
    speed: f32,
    current: f32,
}

impl Winding {
    fn apply(&mut self, duty: f32) {
        let lost = 2.0 * 200.0e-9 * CARRIER * BUS * self.current.signum();
        let emf = self.motor.back_emf * self.speed;
        let goal = (duty * BUS - lost - emf) / self.motor.resistance;
        let fade = (-self.motor.resistance / self.motor.inductance / CARRIER).exp();
        self.current = goal + (self.current - goal) * fade;
    }
}

fn settled(motor: &Motor<f32>, sensed: bool, torque: f32, speed: f32, seconds: f32) -> (f32, Axis) {
    let mut axis = Axis::new(motor, &bridge(sensed), 10.0, 10.0);
    let mut winding = Winding { motor: *motor, speed, current: 0.0 };
    axis.command(torque, speed);
    for _ in 0..(seconds * CARRIER) as u32 {
        let duty = axis.duty(BUS, winding.current);
        winding.apply(duty);
    }
    (winding.current, axis)
}

#[test]
fn the_current_loop_makes_the_torque_asked_for_at_rest_and_in_motion() {
    for torque in [0.1, -0.1, 0.02] {
        for speed in [0.0, 50.0, -50.0] {
            let (current, _) = settled(&motor(), true, torque, speed, 0.05);
            assert!((current - torque / 0.05).abs() < 1.0e-3, "{torque} N m at {speed} rad/s: {current} A");
        }
    }
}

#[test]
fn the_current_loop_is_right_although_the_resistance_is_not() {
    let mut warm = motor();
    warm.resistance *= 1.4;
    let mut axis = Axis::new(&motor(), &bridge(true), 10.0, 10.0);
    let mut winding = Winding { motor: warm, speed: 0.0, current: 0.0 };
    axis.command(0.15, 0.0);
    for _ in 0..2_000 {
        let duty = axis.duty(BUS, winding.current);
        winding.apply(duty);
    }
    assert!((winding.current - 3.0).abs() < 1.0e-3, "{}", winding.current);
}

#[test]
fn the_current_loop_reaches_63_percent_at_its_stated_bandwidth() {
    // A loop of 1 kHz bandwidth answers a step with a time constant of 1/(2π 1 kHz) = 159 µs: three carrier periods.
    let mut axis = Axis::new(&motor(), &bridge(true), 10.0, 10.0);
    let mut winding = Winding { motor: motor(), speed: 0.0, current: 0.0 };
    axis.command(0.1, 0.0);
    let mut periods = 0;
    while winding.current < 0.632 * 2.0 && periods < 100 {
        let duty = axis.duty(BUS, winding.current);
        winding.apply(duty);
        periods += 1;
    }
    assert!((2..=5).contains(&periods), "{periods} periods of 50 µs");
}

#[test]
fn without_a_current_sensor_the_voltage_makes_the_current() {
    for (torque, speed) in [(0.1, 0.0), (-0.1, 20.0), (0.15, -60.0)] {
        let (current, _) = settled(&motor(), false, torque, speed, 0.05);
        assert!((current - torque / 0.05).abs() < 0.1, "{torque} N m at {speed} rad/s: {current} A");
    }
}

#[test]
fn torque_beyond_the_current_limit_is_not_made() {
    let mut axis = Axis::new(&motor(), &bridge(true), 3.0, 3.0);
    assert_eq!(axis.command(99.0, 0.0), 3.0);
    assert_eq!(axis.command(-99.0, 0.0), -3.0);
    let mut axis = Axis::new(&motor(), &bridge(true), 99.0, 3.0);
    assert_eq!(axis.command(99.0, 0.0), 4.0, "the motor's own limit");
    axis.limit(1.0, 1.0);
    assert_eq!(axis.command(99.0, 0.0), 1.0);
    axis.limit(99.0, 1.0);
    assert_eq!(axis.command(99.0, 0.0), 4.0);
    axis.limit(-1.0, f32::NAN);
    assert_eq!(axis.command(99.0, 0.0), 0.0);
}

#[test]
fn a_motor_without_a_torque_constant_gets_no_current() {
    let mut dead = motor();
    dead.torque_constant = 0.0;
    let mut axis = Axis::new(&dead, &bridge(true), 10.0, 10.0);
    assert_eq!(axis.command(1.0, 0.0), 0.0);
    axis.limit(10.0, 10.0);
    assert_eq!(axis.command(1.0, 0.0), 0.0);
}

#[test]
fn the_integrator_does_not_wind_up_against_a_voltage_that_is_not_there() {
    // 4 A need 6 V and 480 rad/s make 24 V: far beyond the bus. Once the motor slows the current is right within 2 ms.
    let mut axis = Axis::new(&motor(), &bridge(true), 10.0, 10.0);
    let mut winding = Winding { motor: motor(), speed: 480.0, current: 0.0 };
    for _ in 0..20_000 {
        axis.command(0.2, winding.speed);
        let duty = axis.duty(BUS, winding.current);
        winding.apply(duty);
    }
    winding.speed = 0.0;
    for _ in 0..40 {
        axis.command(0.2, winding.speed);
        let duty = axis.duty(BUS, winding.current);
        winding.apply(duty);
    }
    assert!((winding.current - 4.0).abs() < 0.05, "{}", winding.current);
}

/// Numbers that come from nowhere.
const WILD: [f32; 12] = [
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
fn whatever_comes_in_each_leg_stays_between_4_and_96_percent() {
    for sensed in [true, false] {
        for torque in WILD {
            for speed in WILD {
                for bus in WILD {
                    for current in WILD {
                        let mut axis = Axis::new(&motor(), &bridge(sensed), 10.0, 10.0);
                        axis.command(torque, speed);
                        for _ in 0..3 {
                            let duty = axis.duty(bus, current);
                            let legs = [0.5 + 0.5 * duty, 0.5 - 0.5 * duty];
                            let inside = legs.iter().all(|leg| (0.039_999..=0.960_001).contains(leg));
                            assert!(inside, "{torque} {speed} {bus} {current}: {duty}");
                        }
                    }
                }
            }
        }
    }
}

#[test]
fn a_motor_made_of_wild_numbers_still_gets_a_duty_within_bounds() {
    for a in WILD {
        for b in WILD {
            for c in WILD {
                let wild = Motor {
                    torque_constant: a,
                    resistance: b,
                    inductance: c,
                    back_emf: a,
                    max_current: b,
                    verified: true,
                };
                let mut axis = Axis::new(&wild, &bridge(true), c, a);
                axis.command(1.0, 1.0);
                for _ in 0..3 {
                    let duty = axis.duty(BUS, 0.5);
                    assert!(duty.abs() <= MAX_DUTY, "{a} {b} {c}: {duty}");
                }
            }
        }
    }
}

#[test]
fn without_supply_there_is_no_duty() {
    let mut axis = Axis::new(&motor(), &bridge(true), 10.0, 10.0);
    axis.command(0.1, 0.0);
    for bus in [0.0, 0.5, -24.0, f32::NAN] {
        assert_eq!(axis.duty(bus, 0.0), 0.0);
    }
}

#[test]
fn a_motor_stands_its_peak_for_four_seconds_and_its_continuous_current_for_ever() {
    let mut axis = Axis::new(&motor(), &bridge(true), 4.0, 1.0);
    let dt = 1.0 / 20_000.0;
    let mut seconds = 0.0;
    while !axis.heat(4.0 * 4.0 * dt, dt) && seconds < 10.0 {
        seconds += dt;
    }
    assert!((seconds - 4.0).abs() < 0.01, "{seconds}");
    let mut axis = Axis::new(&motor(), &bridge(true), 4.0, 1.0);
    assert!((0..4_000_000).all(|_| !axis.heat(0.999 * 0.999 * dt, dt)));
}

#[test]
fn the_heat_of_a_step_is_counted_however_small_it_is() {
    // 50 kHz, a hundredth above the continuous current and far into the budget: a step adds less than the sum's last
    // digit. (1.01² - 1) A² and a budget of (4² - 1²)·4 A² s, of which 59 are spent: 50 s are left.
    let mut axis = Axis::new(&motor(), &bridge(true), 4.0, 1.0);
    let dt = 1.0 / 50_000.0;
    for _ in 0..(59.0_f32 / 15.0 / dt) as u32 {
        axis.heat(4.0 * 4.0 * dt, dt);
    }
    let mut seconds = 0.0_f64;
    while !axis.heat(1.01 * 1.01 * dt, dt) && seconds < 100.0 {
        seconds += f64::from(dt);
    }
    assert!((seconds - 50.0).abs() < 2.0, "{seconds}");
}
