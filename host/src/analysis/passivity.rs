//! Passivity beside stability: walls that no hand at all can make oscillate.
//!
//! - J. E. Colgate and G. G. Schenkel, "Passivity of a class of sampled-data systems: application to haptic interfaces",
//!   Journal of Robotic Systems 14 (1997) 37-47: **b > kp T/2 + |kd|** for a wall with backward-difference damping, where b is
//!   the physical damping of the device.
//! - J. J. Abbott and A. M. Okamura, "Effects of position quantization and sampling rate on virtual-wall passivity",
//!   IEEE Transactions on Robotics 21 (2005) 952-964: **kp ≤ min(2b/T, 2 fc/Δ)** for a pure spring, with Coulomb friction fc and
//!   position quantum Δ.
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
    /// Sample period T, s.
    pub sample_s: f64,
}

impl Passivity {
    /// Of a device at a pose, as `device` sees it.
    pub fn new(device: &Linearised, description: &Description, sample_s: f64) -> Self {
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
            sample_s,
        }
    }

    /// Largest passive stiffness at a damping by Colgate and Schenkel, N/m; zero beyond b.
    pub fn sampled(&self, kd: f64) -> f64 {
        (2.0 * (self.damping - kd.abs()) / self.sample_s).max(0.0)
    }

    /// Largest passive stiffness of a pure spring by Abbott and Okamura, N/m; `None` without encoder data.
    pub fn quantised(&self) -> Option<f64> {
        let friction = 2.0 * self.coulomb / self.quantum?;
        Some(friction.min(2.0 * self.damping / self.sample_s))
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
        let bounds = Passivity::new(&device, &file.description, 1e-3);
        // b = 2e-3/0.1² = 0.2 N s/m, fc = 0.05 N, Δ = 0.1 · 1e-4 m.
        assert!((bounds.sampled(0.05) - 300.0).abs() < 1e-6);
        assert_eq!(bounds.sampled(0.3), 0.0);
        // 2 fc/Δ = 1e4 N/m is above 2b/T = 400 N/m.
        assert!((bounds.quantised().unwrap() - 400.0).abs() < 1e-6);
    }
}
