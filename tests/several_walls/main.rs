//! Walls that meet at an angle: what docs/model.md section 2 promises of them, held by loops, plants and bounds that do
//! not use the code under test. The feed-forward's torques alone come from it.

mod continuity;
mod linear;
mod plant;
mod springs;

use haptic::device_file::DeviceFile;
use haptic::model::{Precision, WallForce, evaluate};

/// A shipped device.
fn device(name: &str) -> DeviceFile {
    DeviceFile::load(format!("{}/devices/{name}.toml", env!("CARGO_MANIFEST_DIR"))).expect("a shipped device")
}

/// A unit vector at this angle, rad.
fn at(angle: f64) -> Vec<f64> {
    vec![angle.cos(), angle.sin()]
}

fn scaled(v: &[f64]) -> Vec<f64> {
    let length = v.iter().map(|x| x * x).sum::<f64>().sqrt();
    v.iter().map(|x| x / length).collect()
}

/// Joint torques for walls of these normals, stiffness and forces, at rest and without what the device weighs.
fn torque(device: &DeviceFile, q: &[f64], walls: &[(Vec<f64>, f64, f64)], precision: Precision) -> Vec<f64> {
    torque_of_some(device, q, walls, &vec![true; walls.len()], precision)
}

/// As [`torque`], some of the walls without the feed-forward.
fn torque_of_some(
    device: &DeviceFile,
    q: &[f64],
    walls: &[(Vec<f64>, f64, f64)],
    with: &[bool],
    precision: Precision,
) -> Vec<f64> {
    let of = |forces: bool| {
        let walls: Vec<WallForce> = walls
            .iter()
            .zip(with)
            .map(|((normal, stiffness, force), feed_forward)| WallForce {
                normal: normal.clone(),
                stiffness: *stiffness,
                force: if forces { *force } else { 0.0 },
                feed_forward: *feed_forward,
            })
            .collect();
        evaluate(device, q, &vec![0.0; q.len()], &walls, precision).expect("a regular pose").torque
    };
    of(true).iter().zip(of(false)).map(|(with, without)| with - without).collect()
}

/// Numbers that look random and are the same on every machine.
struct Random(u64);

impl Random {
    fn between(&mut self, low: f64, high: f64) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        low + (high - low) * ((self.0 >> 11) as f64 / (1_u64 << 53) as f64)
    }

    fn direction(&mut self, task: usize) -> Vec<f64> {
        loop {
            let v: Vec<f64> = (0..task).map(|_| self.between(-1.0, 1.0)).collect();
            let square: f64 = v.iter().map(|x| x * x).sum();
            if (0.01..1.0).contains(&square) {
                return scaled(&v);
            }
        }
    }

    /// A unit vector within `angle` (rad) of `n`.
    fn near(&mut self, n: &[f64], angle: f64) -> Vec<f64> {
        loop {
            let side = self.direction(n.len());
            let v: Vec<f64> = n.iter().zip(&side).map(|(a, b)| a + angle.tan() * b).collect();
            let v = scaled(&v);
            if v.iter().zip(n).map(|(a, b)| a * b).sum::<f64>() >= angle.cos() {
                return v;
            }
        }
    }
}
