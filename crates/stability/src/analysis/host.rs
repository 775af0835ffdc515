//! A wall rendered by a program on a computer. The program samples at its own rate, and the board holds the last force.
//!
//! The program reads position and velocity (the board's estimate) in the reply to its last request, and sends the force
//! with its next request. The board applies this force without feed-forward: τ = Jᵀ f. The analysis therefore opens the
//! board's loop at the force and samples it once per request.

use super::boundary::CircleResponses;
use super::domain::{Domain, domain_from_intervals};
use super::plant::Linearised;
use super::sampled::{AnalysisError, LONGEST_DELAY, Loop, Mode, OpenLoop};
use super::several::open_loop;
use nalgebra::{DMatrix, DVector};
use serde::Serialize;

/// Lowest request rate that is analysed, Hz.
pub const MIN_REQUEST_HZ: f64 = 1.0;

/// A program that renders the wall.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Host {
    /// Request rate, Hz.
    pub rate_hz: f64,
    /// Age of a force when the board accepts it, s, as measured by `haptic board latency`.
    pub delay_s: f64,
}

/// The stable domain of a wall that a program renders.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct HostWall {
    /// Request rate, rounded to whole control periods, Hz.
    pub rate_hz: f64,
    /// Age of a force when the board accepts it, in whole control periods, s. The board's own delay is not included.
    pub delay_s: f64,
    /// Boundary and area.
    #[serde(flatten)]
    pub domain: Domain,
}

impl Host {
    /// Predicts the stable domain of a wall that this program renders on `device` through the board's loop `around`.
    pub fn domain(&self, device: &Linearised, around: &Loop, kd: Option<&[f64]>) -> Result<HostWall, AnalysisError> {
        around.check()?;
        if !(MIN_REQUEST_HZ..=around.rate_hz).contains(&self.rate_hz) {
            return Err(AnalysisError::HostRate { rate: self.rate_hz, board: around.rate_hz });
        }
        let steps = (around.rate_hz / self.rate_hz).round().max(1.0) as usize;
        let late = self.delay_s * around.rate_hz / steps as f64;
        if !(0.0..=LONGEST_DELAY).contains(&late) {
            let longest = LONGEST_DELAY * steps as f64 / around.rate_hz;
            return Err(AnalysisError::HostDelay { delay: self.delay_s, longest });
        }
        // A difference of less than 1e-6 to a whole number of periods is rounding.
        let late = (self.delay_s * around.rate_hz - 1e-6).ceil().max(0.0) as usize;
        let board = open_loop(device, device, around, Mode::Off)?;
        let open = host_loop(&board, steps, late);
        let delay = (late as f64 + around.delay_samples) / steps as f64;
        let domain = domain_from_intervals(&mut CircleResponses::new(&open, delay), open.mass, open.sample_s, kd)?;
        let domain = domain.with_compliance(device.compliance(Mode::Off));
        Ok(HostWall { rate_hz: around.rate_hz / steps as f64, delay_s: late as f64 / around.rate_hz, domain })
    }
}

/// Returns the loop of `board` sampled once in `steps` samples, in units of the longer sample. The force is held for
/// `steps` samples and applied `late` board samples after its sample.
fn host_loop(board: &OpenLoop, steps: usize, late: usize) -> OpenLoop {
    let states = board.input.len();
    let (whole, rest) = (late / steps, late % steps);
    let (until, pushed_until) = advance(board, rest);
    let (after, pushed_after) = advance(board, steps - rest);
    let slots = whole + usize::from(rest > 0);
    let size = states + slots;
    let mut f = DMatrix::zeros(size, size);
    let mut input = DVector::zeros(size);
    // This is A^{N-r} A^r - I, computed without subtracting nearly equal numbers.
    f.view_mut((0, 0), (states, states)).copy_from(&(&until + &after + &after * &until));
    // The same force in units of m/T² has a smaller value with the shorter T.
    let unit = 1.0 / (steps * steps) as f64;
    let early = (&pushed_until + &after * &pushed_until) * unit;
    let mut acts = |asked: usize, by: &DVector<f64>| match asked {
        0 => input.rows_mut(0, states).copy_from(by),
        asked => f.view_mut((0, states + asked - 1), (states, 1)).copy_from(by),
    };
    acts(whole, &(pushed_after * unit));
    if rest > 0 {
        acts(whole + 1, &early);
    }
    for slot in states..size {
        f[(slot, slot)] = -1.0;
        if slot == states {
            input[slot] = 1.0;
        } else {
            f[(slot, slot - 1)] = 1.0;
        }
    }
    let resonances = if board.resonances.is_empty() { Vec::new() } else { super::sampled::resonances(&f, states) };
    OpenLoop {
        f,
        input,
        position: board.position.clone().resize_vertically(size, 0.0),
        velocity: (&board.velocity * steps as f64).resize_vertically(size, 0.0),
        mass: board.mass,
        sample_s: board.sample_s * steps as f64,
        drift: None,
        resonances,
        rounding: board.rounding,
    }
}

/// Returns A^n - I, and the effect of a unit force held for n samples.
fn advance(board: &OpenLoop, samples: usize) -> (DMatrix<f64>, DVector<f64>) {
    let size = board.input.len();
    let mut change = DMatrix::zeros(size, size);
    let mut pushed = DVector::zeros(size);
    for _ in 0..samples {
        change = &change + &board.f + &board.f * &change;
        pushed = &pushed + &board.f * &pushed + &board.input;
    }
    (change, pushed)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::domain::domain;
    use crate::analysis::flexible::{Flexible, Hand};
    use crate::analysis::plant::Drive;
    use crate::analysis::sampled::LinearEstimator;
    use nalgebra::Matrix3;

    fn mass(m: f64, b: f64) -> Linearised {
        Linearised {
            gain: 1.0,
            flexible: Flexible {
                tip: DMatrix::from_element(1, 1, 1.0),
                normal: DVector::from_element(1, 1.0),
                ..Flexible::default()
            },
            mass: DMatrix::from_element(1, 1, m),
            viscous: DVector::from_element(1, b),
            row: DVector::from_element(1, 1.0),
            unit_motion: DVector::from_element(1, 1.0),
        }
    }

    fn control_loop(rate: f64, delay: f64, drive: Drive) -> Loop {
        Loop {
            rate_hz: rate,
            delay_samples: delay,
            estimator: LinearEstimator::Butterworth(0.1 * rate),
            drive,
            damping_compensation: false,
        }
    }

    fn close(a: f64, b: f64, within: f64) -> bool {
        (a / b - 1.0).abs() < within
    }

    #[test]
    fn host_at_the_board_rate_equals_a_board_with_more_delay() {
        let device = mass(0.2, 0.3);
        for (late, delay) in [(0.0, 0.5), (2.0, 0.5), (3.0, 0.0)] {
            let around = control_loop(2000.0, delay, Drive::Current { bandwidth_hz: 900.0 });
            let host = Host { rate_hz: 2000.0, delay_s: late / 2000.0 }.domain(&device, &around, None).unwrap();
            let board = Loop { delay_samples: delay + late, ..around };
            let board = domain(&device, &board, Mode::Off, None).unwrap();
            assert!(close(host.domain.area, board.area, 1e-9) && close(host.domain.kd_max, board.kd_max, 1e-9));
        }
    }

    #[test]
    fn undamped_wall_equals_the_loop_sampled_at_the_host_rate() {
        // Without damping the estimated velocity has no effect, so only the sampling at 20 or 7 board periods remains.
        let held = mass(0.2, 0.3).with_hand(Hand { mass: 0.1, damping: 2.0, stiffness: 300.0 });
        for (device, drive) in [
            (mass(0.2, 0.3), Drive::Ideal),
            (mass(0.2, 0.3), Drive::Current { bandwidth_hz: 300.0 }),
            (held, Drive::Ideal),
        ] {
            for (steps, late, delay) in [(20.0, 0.0, 0.0), (20.0, 20.0, 0.5), (20.0, 33.0, 0.5), (7.0, 24.0, 1.5)] {
                let around = control_loop(20_000.0, delay, drive.clone());
                let host = Host { rate_hz: 20_000.0 / steps, delay_s: late / 20_000.0 };
                let result = host.domain(&device, &around, Some(&[0.0])).unwrap().domain.boundary[0].kp;
                let slow = Loop {
                    rate_hz: 20_000.0 / steps,
                    delay_samples: (late + delay) / steps,
                    estimator: LinearEstimator::BackwardDifference,
                    ..around
                };
                let expected = domain(&device, &slow, Mode::Off, Some(&[0.0])).unwrap().boundary[0].kp;
                assert!(close(result, expected, 1e-7), "{steps} {late} {delay}: {result} is not {expected}");
            }
        }
    }

    #[test]
    fn damped_wall_has_the_closed_form_of_exact_velocity() {
        // For x⁺ = x + v + f/2, v⁺ = v + f, f = -α x - β v, Jury gives α < 2β and β < 2. The lag of the difference,
        // half a board period, is negligible against the host's 500 board periods.
        let around =
            Loop { estimator: LinearEstimator::BackwardDifference, ..control_loop(50_000.0, 0.0, Drive::Ideal) };
        let (m, t) = (0.2, 0.01);
        let host = Host { rate_hz: 1.0 / t, delay_s: 0.0 };
        for beta in [0.2, 0.8, 1.5] {
            let result = host.domain(&mass(m, 0.0), &around, Some(&[beta * m / t])).unwrap().domain;
            assert!(close(result.boundary[0].kp * t * t / m, 2.0 * beta, 5e-3), "{beta}: {result:?}");
            assert!(close(result.kd_max * t / m, 2.0, 5e-3), "{}", result.kd_max);
        }
    }

    /// Simulates a free mass with a velocity from the difference of two board samples, independently of the analysis.
    /// The force is computed every `steps` samples and applied `late` samples later. Returns true if the motion grows.
    fn grows(steps: usize, late: usize, alpha: f64, beta: f64) -> bool {
        let one = Matrix3::new(1.0, 1.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0); // x, v, x before
        let (alpha, beta) = (alpha / (steps * steps) as f64, beta / steps as f64);
        let mut state = nalgebra::Vector3::new(1.0, 0.0, 1.0);
        let mut waiting = std::collections::VecDeque::new();
        let (mut force, mut early, mut size) = (0.0, 0.0_f64, 0.0_f64);
        let samples = 6000 * steps;
        for sample in 0..samples {
            if sample % steps == 0 {
                waiting.push_back((sample + late, -alpha * state[0] - beta * (state[0] - state[2])));
            }
            while waiting.front().is_some_and(|(when, _)| *when <= sample) {
                force = waiting.pop_front().unwrap().1;
            }
            state = one * state + nalgebra::Vector3::new(0.5, 1.0, 0.0) * force;
            size = size.max(state[0].abs());
            if sample == samples / 2 {
                early = size;
                size = 0.0;
            }
            if size > 1e100 {
                return true;
            }
        }
        size > early
    }

    #[test]
    fn simulation_of_a_free_mass_agrees_with_the_boundary() {
        let (m, rate) = (0.2, 4000.0);
        let around = Loop { estimator: LinearEstimator::BackwardDifference, ..control_loop(rate, 0.0, Drive::Ideal) };
        for (steps, late, beta) in [(4, 0, 0.4), (4, 3, 0.4), (4, 4, 0.3), (4, 7, 0.2), (10, 25, 0.1)] {
            let host_s = steps as f64 / rate;
            let host = Host { rate_hz: 1.0 / host_s, delay_s: late as f64 / rate };
            let result = host.domain(&mass(m, 0.0), &around, Some(&[beta * m / host_s])).unwrap().domain;
            let alpha = result.boundary[0].kp * host_s * host_s / m;
            assert!(alpha > 0.01, "{alpha}");
            assert!(!grows(steps, late, 0.99 * alpha, beta), "{steps} {late} {beta}: grows below {alpha}");
            assert!(grows(steps, late, 1.01 * alpha, beta), "{steps} {late} {beta}: decays above {alpha}");
        }
    }

    #[test]
    fn wrong_host_rates_and_delays_are_rejected() {
        let (device, around) = (mass(0.2, 0.0), control_loop(1000.0, 0.0, Drive::Ideal));
        for (rate_hz, delay_s) in [(0.0, 0.0), (1001.0, 0.0), (f64::NAN, 0.0), (100.0, -0.001), (100.0, 1.0)] {
            assert!(Host { rate_hz, delay_s }.domain(&device, &around, None).is_err(), "{rate_hz} {delay_s}");
        }
    }
}
