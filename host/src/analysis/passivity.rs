//! Passivity beside stability: walls that no hand at all can make oscillate.
//!
//! - J. E. Colgate and G. G. Schenkel, "Passivity of a class of sampled-data systems: application to haptic
//!   interfaces", Journal of Robotic Systems 14 (1997) 37-47: **b > kp T/2 + |kd|** for a wall with backward-difference
//!   damping, where b is the physical damping of the device.
//! - J. J. Abbott and A. M. Okamura, "Effects of position quantization and sampling rate on virtual-wall passivity",
//!   IEEE Transactions on Robotics 21 (2005) 952-964: **kp ≤ min(2b/T, 2 fc/Δ)** for a pure spring, with Coulomb
//!   friction fc and position quantum Δ.
//!
//! A delay of d samples makes T/2 of the first T (1/2 + d): their condition b > T/2 max over θ of
//! Re((1 - e^-jθ) H)/(1 - cos θ) with H = e^-jdθ (kp + kd (1 - e^-jθ)/T) is
//! b > kp T/2 sin((d + 1/2) θ)/sin(θ/2) - kd cos((d + 1) θ), the first largest at θ → 0 and the second at most kd. So
//! it is exact for a spring and for a damper alone, and enough for both together. For a fraction of a sample it is the
//! condition of slow motions, which passivity needs at least.
//!
//! Both are for one moving mass whose force acts along its motion. On a device with several joints the least favourable
//! admissible motion counts, so b and fc are the smallest that any joint motion with unit rendered velocity dissipates.
//! They say nothing about the feed-forward, whose torques do not act along the rendered motion.

use haptic_bridge::model::description::Description;
use nalgebra::DVector;

use super::plant::Linearised;

/// What dissipates along the rendered direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Passivity {
    /// Smallest viscous damping of unit rendered motion, (Jr B⁻¹ Jrᵀ)⁻¹, N s/m; zero when a joint that moves has none.
    pub damping: f64,
    /// Smallest Coulomb friction, minⱼ Cⱼ/|Jrⱼ|, N.
    pub coulomb: f64,
    /// Largest step of the rendered position when every encoder steps once, Σⱼ |Jrⱼ| Δⱼ, m; `None` without encoders.
    pub quantum: Option<f64>,
    /// How late a force acts on average, T (1/2 + delay), s.
    pub lateness: f64,
}

impl Passivity {
    /// Of a device at a pose, as `device` sees it, sampled every `sample_s` with a delay of `delay_samples`.
    pub fn new(device: &Linearised, description: &Description, sample_s: f64, delay_samples: f64) -> Self {
        let joints = description.kind.spec().joints;
        let row: &DVector<f64> = &device.row;
        // A joint that the rendered direction does not move dissipates nothing and costs nothing.
        let moving = || (0..joints).filter(|&j| row[j].abs() > 1e-9 * row.amax());
        let damping = 1.0 / moving().map(|j| row[j] * row[j] / device.viscous[j]).sum::<f64>();
        let coulomb = moving().map(|j| description.joints[j].coulomb / row[j].abs()).fold(f64::INFINITY, f64::min);
        let quantum = moving()
            .map(|j| {
                let encoder = description.joints[j].encoder?;
                Some(row[j].abs() * std::f64::consts::TAU / encoder.counts_per_turn.abs())
            })
            .sum();
        Self {
            damping: if damping.is_finite() { damping } else { 0.0 },
            coulomb: if coulomb.is_finite() { coulomb } else { 0.0 },
            quantum,
            lateness: sample_s * (0.5 + delay_samples),
        }
    }

    /// Largest passive stiffness at a damping by Colgate and Schenkel, N/m; zero beyond b.
    pub fn sampled(&self, kd: f64) -> f64 {
        ((self.damping - kd.abs()) / self.lateness).max(0.0)
    }

    /// Largest passive stiffness of a pure spring by Abbott and Okamura, N/m; `None` without encoder data.
    pub fn quantised(&self) -> Option<f64> {
        let friction = 2.0 * self.coulomb / self.quantum?;
        Some(friction.min(self.sampled(0.0)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device_file::DeviceFile;

    #[test]
    fn a_paddle_has_the_textbook_bounds() {
        let file = DeviceFile::parse(
            "name = \"p\"\nmechanism = \"paddle\"\ngravity = [0.0]\n[geometry]\nlength = 0.1\n[[joint]]\ninertia = 1e-3\n\
             viscous = 2e-3\ncoulomb = 5e-3\n[joint.encoder]\ncounts_per_turn = 62831.853071795864\n\
             offset = 0.0\ninverted = false\n",
            "p.toml",
        )
        .unwrap();
        let device = Linearised::at(&file.description, &[0.0], &[1.0]).unwrap();
        let bounds = Passivity::new(&device, &file.description, 1e-3, 0.0);
        // b = 2e-3/0.1² = 0.2 N s/m, fc = 0.05 N, Δ = 0.1 · 1e-4 m.
        assert!((bounds.sampled(0.05) - 300.0).abs() < 1e-6);
        assert_eq!(bounds.sampled(0.3), 0.0);
        // 2 fc/Δ = 1e4 N/m is above 2b/T = 400 N/m.
        assert!((bounds.quantised().unwrap() - 400.0).abs() < 1e-6);
        // A sample of delay makes T/2 three times that.
        let late = Passivity::new(&device, &file.description, 1e-3, 1.0);
        assert!((late.sampled(0.05) - 100.0).abs() < 1e-6);
        assert!((late.quantised().unwrap() - 400.0 / 3.0).abs() < 1e-6);
    }

    /// The condition of Colgate and Schenkel in their own terms, over a fine grid of frequencies: whether a wall is
    /// passive.
    fn passive(b: f64, kp: f64, kd: f64, t: f64, delay: f64) -> bool {
        (1..4000).all(|i| {
            let theta = std::f64::consts::PI * f64::from(i) / 4000.0;
            let turned = |steps: f64| ((steps * theta).cos(), -(steps * theta).sin());
            let (one, lag) = (turned(1.0), turned(delay));
            let back = (1.0 - one.0, -one.1);
            let wall = (kp + kd / t * back.0, kd / t * back.1);
            let product = |a: (f64, f64), b: (f64, f64)| (a.0 * b.0 - a.1 * b.1, a.0 * b.1 + a.1 * b.0);
            let real = product(back, product(lag, wall)).0;
            b > t / 2.0 * real / (1.0 - theta.cos())
        })
    }

    #[test]
    fn the_bound_is_that_of_the_whole_condition_with_every_delay() {
        let (b, t) = (0.2, 1e-3);
        for delay in [0.0, 1.0, 2.0, 5.0] {
            let bounds = Passivity { damping: b, coulomb: 0.0, quantum: None, lateness: t * (0.5 + delay) };
            let limit = bounds.sampled(0.0);
            assert!(passive(b, 0.999 * limit, 0.0, t, delay) && !passive(b, 1.001 * limit, 0.0, t, delay), "{delay}");
            for kd in [0.05, 0.1, 0.19] {
                assert!(passive(b, 0.999 * bounds.sampled(kd), kd, t, delay), "{delay} {kd}");
            }
        }
    }
}
