//! Laws of the sampled loop that hold for every device, and constants from independent computations.

use crate::common::{ideal_loop, point_mass, rigid_device};
use haptic_stability::analysis::plant::{Drive, Linearised, MotorElectrics};
use haptic_stability::analysis::range::{domain, oscillation};
use haptic_stability::analysis::sampled::{AnalysisError, LinearEstimator, Loop, Mode};
use nalgebra::{DMatrix, DVector};

/// Returns two undamped joints whose coupling leads to this ratio Wrr/Weff.
fn coupled_joints(ratio: f64) -> Linearised {
    // M = [[1, a], [a, 1]] with rows Jr = (1, 0): Weff = 1 - a², E = (1, 0): Wrr = 1.
    let a = (1.0 - 1.0 / ratio).sqrt();
    rigid_device(&[0.3, 0.3 * a, 0.3 * a, 0.3], &[0.0; 2], &[1.0, 0.0], &[1.0, 0.0])
}

/// Returns three joints whose values all differ.
fn three_joints() -> Linearised {
    let jacobian = nalgebra::Matrix3::new(0.2, 0.05, -0.03, 0.01, 0.17, 0.06, -0.04, 0.02, 0.11);
    let inverse = jacobian.try_inverse().unwrap();
    let n = nalgebra::Vector3::new(0.48, 0.6, 0.64);
    let (row, unit) = (jacobian.transpose() * n, inverse * n);
    let mass = [3.0e-3, 4e-4, -2e-4, 4e-4, 1.1e-3, 5e-4, -2e-4, 5e-4, 9e-4];
    rigid_device(&mass, &[2e-3, 1e-3, 5e-4], row.as_slice(), unit.as_slice())
}

fn control_loop(rate_hz: f64, cutoff_hz: f64) -> Loop {
    ideal_loop(rate_hz, 0.0, LinearEstimator::Butterworth(cutoff_hz))
}

fn area(device: &Linearised, around: &Loop, mode: Mode) -> f64 {
    domain(device, around, mode, Some(&[])).unwrap().area
}

#[test]
fn undamped_area_grows_by_the_square_of_the_inertia_ratio() {
    for (rate, cutoff, ratio) in
        [(200.0, 20.0, 1.205), (1000.0, 20.0, 3.0), (50_000.0, 20.0, 1.449), (20_000.0, 500.0, 10.0)]
    {
        let device = coupled_joints(ratio);
        let found = area(&device, &control_loop(rate, cutoff), Mode::Full)
            / area(&device, &control_loop(rate, cutoff), Mode::Off);
        assert!((found / (ratio * ratio) - 1.0).abs() < 1e-5, "{rate}/{cutoff}: {found}");
    }
}

#[test]
fn a_fast_board_keeps_the_gained_area_behind_a_washout() {
    let fast = control_loop(20_000.0, 500.0);
    for (ratio, washed) in [(1.205, 1.447), (1.449, 2.08)] {
        let device = coupled_joints(ratio);
        let found = area(&device, &fast, Mode::Washout(2.0)) / area(&device, &fast, Mode::Off);
        assert!((found / washed - 1.0).abs() < 1e-2, "{found} is not {washed}");
    }
}

#[test]
fn on_a_slow_board_a_fast_washout_is_worse_than_none() {
    let slow = control_loop(200.0, 20.0);
    let device = coupled_joints(1.205);
    let [off, full] = [Mode::Off, Mode::Full].map(|mode| area(&device, &slow, mode));
    let washed = |hz| area(&device, &slow, Mode::Washout(hz));
    let (gentle, middle) = (washed(0.2) / full, washed(1.0) / full);
    assert!((0.97..0.99).contains(&gentle), "{gentle}");
    assert!((0.84..0.94).contains(&middle), "{middle}");
    assert!(washed(10.0) < off);
}

/// A step-by-step simulation decays below the boundary and grows above, with the predicted frequency and growth.
#[test]
fn the_boundary_is_where_a_simulation_starts_to_grow() {
    let device = three_joints();
    for mode in [Mode::Off, Mode::Full, Mode::Washout(4.0)] {
        let around = Loop { delay_samples: 0.5, ..control_loop(1000.0, 100.0) };
        let whole_range = domain(&device, &around, mode, None).unwrap();
        let kd = whole_range.kd_max * 0.4;
        let kp = domain(&device, &around, mode, Some(&[kd])).unwrap().boundary[0].kp;
        for (gain, grows) in [(kp * 0.99, false), (kp * 1.01, true)] {
            let (growth, hz) = simulated_swing(&device, mode, gain, kd);
            assert_eq!(growth > 0.0, grows, "{mode:?}: {growth}");
            let expected = oscillation(&device, &around, mode, gain, kd).unwrap().unwrap();
            assert!((hz / expected.hz - 1.0).abs() < 2e-3, "{mode:?}: {hz} Hz is not {expected:?}");
            // The largest sample is up to 2 % below the peak. Over 1.2 s this causes an error of 0.02/s.
            assert!((growth - expected.growth_per_s).abs() < 0.02, "{mode:?}: {growth}/s is not {expected:?}");
        }
    }
}

/// Runs the loop at 1 kHz, 100 Hz cutoff and half a sample of delay with 200 implicit-midpoint steps per half sample.
/// Returns the growth of the largest |x| from the fourth to the last fifth of the time, 1/s, and the frequency, Hz.
fn simulated_swing(device: &Linearised, mode: Mode, kp: f64, kd: f64) -> (f64, f64) {
    let rate = 1000.0;
    let step = 0.5 / rate / 200.0;
    let inverse = device.mass.clone().try_inverse().unwrap();
    let damping = DMatrix::from_diagonal(&device.viscous);
    let identity = DMatrix::identity(3, 3);
    // Implicit midpoint for v' = M⁻¹(τ - B v).
    let half = &inverse * &damping * (step / 2.0);
    let left = (&identity + &half).try_inverse().unwrap();
    let right = &identity - &half;
    let shaped = device.shaped_torque();
    // Direct-form filters by the textbook's bilinear transform.
    let k = (std::f64::consts::PI * 100.0 / rate).tan();
    let norm = 1.0 / (1.0 + std::f64::consts::SQRT_2 * k + k * k);
    let (b0, a1, a2) = (k * k * norm, 2.0 * (k * k - 1.0) * norm, (1.0 - std::f64::consts::SQRT_2 * k + k * k) * norm);
    let h = match mode {
        Mode::Washout(hz) => (std::f64::consts::PI * hz / rate).tan(),
        _ => 0.0,
    };
    let (mut v, mut x, mut last_x) = (DVector::<f64>::zeros(3), 1e-3, 1e-3);
    let (mut d1, mut d2, mut y1, mut y2) = (0.0, 0.0, 0.0, 0.0);
    let (mut f1, mut h1) = (0.0, 0.0);
    let mut torque = DVector::<f64>::zeros(3);
    let steps = 6000;
    let (mut early, mut late) = (0.0f64, 0.0f64);
    let mut upward = Vec::new();
    for sample in 0..steps {
        let d0 = (x - last_x) * rate;
        last_x = x;
        let y0 = b0 * (d0 + 2.0 * d1 + d2) - a1 * y1 - a2 * y2;
        (d2, d1, y2, y1) = (d1, d0, y1, y0);
        let force = -kp * x - kd * y0;
        let high = ((force - f1) + (1.0 - h) * h1) / (1.0 + h);
        (f1, h1) = (force, high);
        let next = match mode {
            Mode::Off => &device.row * force,
            Mode::Full => &shaped * force,
            Mode::Washout(_) => &device.row * force + (&shaped - &device.row) * high,
        };
        for part in 0..400 {
            if part == 200 {
                torque = next.clone();
            }
            let before = v.clone();
            v = &left * (&right * &v + &inverse * &torque * step);
            x += device.row.dot(&(before + &v)) / 2.0 * step;
        }
        if sample > steps * 3 / 5 {
            let largest = if sample < steps * 4 / 5 { &mut early } else { &mut late };
            *largest = largest.max(x.abs());
            if last_x < 0.0 && x >= 0.0 {
                upward.push((f64::from(sample) - x / (x - last_x)) / rate);
            }
        }
    }
    let hz = (upward.len() - 1) as f64 / (upward[upward.len() - 1] - upward[0]);
    ((late / early).ln() * rate / f64::from(steps / 5), hz)
}

#[test]
fn the_area_is_continuous_as_one_joints_damping_vanishes() {
    let mut device = three_joints();
    device.viscous[1] = 1e-9;
    let nearly = area(&device, &control_loop(20_000.0, 100.0), Mode::Off);
    device.viscous[1] = 0.0;
    let exactly = area(&device, &control_loop(20_000.0, 100.0), Mode::Off);
    assert!((nearly / exactly - 1.0).abs() < 1e-5, "{nearly} {exactly}");
}

#[test]
fn a_voltage_drive_without_inductance_adds_back_emf_damping() {
    let device = three_joints();
    let motor = MotorElectrics { torque_constant: 0.3, back_emf: 0.28, resistance: 2.0, inductance: 0.0 };
    let mut damped = device.clone();
    damped.viscous.add_scalar_mut(0.3 * 0.28 / 2.0);
    for mode in [Mode::Off, Mode::Full] {
        let voltage_loop = Loop { drive: Drive::Voltage(vec![motor; 3]), ..control_loop(1000.0, 50.0) };
        let (by_motor, by_hand) =
            (area(&device, &voltage_loop, mode), area(&damped, &control_loop(1000.0, 50.0), mode));
        assert!((by_motor / by_hand - 1.0).abs() < 1e-9);
        // A little inductance changes the area a little.
        let lagging = MotorElectrics { inductance: 2e-6, ..motor };
        let lagging = Loop { drive: Drive::Voltage(vec![lagging; 3]), ..control_loop(1000.0, 50.0) };
        let lagged = area(&device, &lagging, mode);
        assert!((lagged / by_motor - 1.0).abs() < 5e-3 && lagged != by_motor, "{lagged} {by_motor}");
    }
}

#[test]
fn a_fast_current_loop_is_nearly_ideal_and_a_slow_one_is_not() {
    let device = three_joints();
    let ideal = area(&device, &control_loop(1000.0, 50.0), Mode::Off);
    let with = |bandwidth_hz| {
        area(&device, &Loop { drive: Drive::Current { bandwidth_hz }, ..control_loop(1000.0, 50.0) }, Mode::Off)
    };
    assert!((with(1e6) / ideal - 1.0).abs() < 1e-2);
    assert!(with(50.0) < 0.7 * ideal);
}

#[test]
fn damping_compensation_stabilises_a_creeping_feed_forward() {
    // With uneven joint damping the feed-forward's torque on joint 1 moves the tip the wrong way: Jr B⁻¹ M E < 0.
    let device = rigid_device(&[1e-3, 0.0, 0.0, 2e-4], &[2e-3, 5e-5], &[0.1, 0.05], &[15.0, -10.0]);
    let creep: f64 = (0..2).map(|j| device.row[j] * device.shaped_torque()[j] / device.viscous[j]).sum();
    assert!(creep < 0.0);
    let loop_ = control_loop(2000.0, 100.0);
    assert_eq!(area(&device, &loop_, Mode::Full), 0.0);
    assert!(area(&device, &loop_, Mode::Off) > 0.0);
    let compensated = Loop { damping_compensation: true, ..loop_ };
    let undamped = area(&device.clone().undamped(), &compensated, Mode::Full);
    let found = area(&device, &compensated, Mode::Full);
    assert!(found > 0.5 * undamped, "{found} of {undamped}");
}

#[test]
fn the_area_of_a_fast_loop_scales_with_the_square_of_the_mass() {
    let loop_ = control_loop(50_000.0, 20.0);
    let ratio = area(&point_mass(7.0), &loop_, Mode::Off) / area(&point_mass(0.007), &loop_, Mode::Off);
    assert!((ratio / 1e6 - 1.0).abs() < 1e-6, "{ratio}");
}

#[test]
fn impossible_loops_are_refused() {
    let device = three_joints();
    let refusal = |loop_: Loop, mode| domain(&device, &loop_, mode, None).unwrap_err();
    assert_eq!(refusal(control_loop(200.0, 100.0), Mode::Off), AnalysisError::Cutoff { cutoff: 100.0, rate: 200.0 });
    let washout = refusal(control_loop(200.0, 20.0), Mode::Washout(150.0));
    assert_eq!(washout, AnalysisError::Cutoff { cutoff: 150.0, rate: 200.0 });
    assert_eq!(refusal(control_loop(0.0, 20.0), Mode::Off), AnalysisError::Rate(0.0));
    let early = Loop { delay_samples: -1.0, ..control_loop(200.0, 20.0) };
    assert_eq!(refusal(early, Mode::Off), AnalysisError::Delay(-1.0));
}
