//! `haptic range` of several walls: one wall given twice is the wall (the independent domains hold it), sets of walls
//! end where loops built here from M, J and the torques of `haptic model` end.

use crate::common::domains::{self, Case, Known, SETS};
use crate::common::{file, haptic, json};
use haptic_bridge::model::admissible::Admissible;
use haptic_host::device_file::DeviceFile;
use haptic_stability::analysis::range::domain_of_several;
use haptic_stability::analysis::several::{Member, WallSet};
use nalgebra::{DMatrix, DVector};
use serde_json::Value;

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect()
}

#[test]
fn one_wall_given_twice_is_the_wall_of_the_independent_domains() {
    for Case { id, file, q, normal, around, expected } in domains::all() {
        let walls = [Member::new(normal.clone(), 0.3), Member::new(normal, 0.7)];
        let set = WallSet::at(&file.description, &q, &walls, Admissible::default()).unwrap();
        for (mode, Known { kd, kp, .. }) in expected {
            let key = format!("{mode:?}");
            let found = domain_of_several(&set, &around, mode, Some(&kd)).unwrap();
            let largest = kp.iter().fold(0.0_f64, |a, b| a.max(*b));
            for (point, known) in found.boundary.iter().zip(&kp) {
                let off = (point.kp - known) / largest;
                // Bisection of a growth of 1e-11 a sample.
                assert!(off.abs() < 1e-5, "{id} {key} at kd = {}: kp off by {off:e} of the largest", point.kd);
            }
        }
    }
}

/// Largest |z| of the loop of walls (rows per joint angle, torques per newton, shares) at these totals; what no wall
/// sees (z = 1) left out. Joint damping acts, 1 kHz, Butterworth at 100 Hz, a delay of one sample.
struct Independent {
    mass: DMatrix<f64>,
    viscous: DVector<f64>,
    rows: DMatrix<f64>,
    levers: DMatrix<f64>,
    share: Vec<f64>,
}

impl Independent {
    fn radius(&self, kp: f64, kd: f64) -> f64 {
        let t = 1.0e-3;
        let (walls, n) = self.rows.shape();
        let inverse = self.mass.clone().try_inverse().unwrap();
        // Exact over a sample, by the series of the exponential: q, q̇ T and the torque held.
        let mut a = DMatrix::zeros(3 * n, 3 * n);
        for i in 0..n {
            a[(i, n + i)] = 1.0;
            for j in 0..n {
                a[(n + i, n + j)] = -t * inverse[(i, j)] * self.viscous[j];
                a[(n + i, 2 * n + j)] = t * t * inverse[(i, j)];
            }
        }
        let mut step = DMatrix::identity(3 * n, 3 * n);
        let mut term = step.clone();
        for k in 1..40 {
            term = &term * &a / f64::from(k);
            step += &term;
        }
        let w = (std::f64::consts::PI * 100.0 * t).tan();
        let scale = 1.0 / (1.0 + std::f64::consts::SQRT_2 * w + w * w);
        let b = w * w * scale;
        let (a1, a2) = (2.0 * (w * w - 1.0) * scale, (1.0 - std::f64::consts::SQRT_2 * w + w * w) * scale);
        // The last torque, then for every wall its last distance and two filter states.
        let size = 3 * n + 3 * walls;
        let mut matrix = DMatrix::zeros(size, size);
        for column in 0..size {
            let s = DVector::from_fn(size, |i, _| f64::from(u8::from(i == column)));
            let x = &self.rows * s.rows(0, n);
            let mut next = DVector::zeros(size);
            let mut force = DVector::zeros(walls);
            for i in 0..walls {
                let at = 3 * n + 3 * i;
                let d = x[i] - s[at];
                let y = b * d + s[at + 1];
                next[at] = x[i];
                next[at + 1] = 2.0 * b * d - a1 * y + s[at + 2];
                next[at + 2] = b * d - a2 * y;
                force[i] = -self.share[i] * (kp * x[i] + kd / t * y);
            }
            let moved = &step * s.rows(0, 3 * n);
            next.rows_mut(0, 2 * n).copy_from(&moved.rows(0, 2 * n));
            next.rows_mut(2 * n, n).copy_from(&(&self.levers * force));
            matrix.set_column(column, &next);
        }
        let far = |z: &&nalgebra::Complex<f64>| (**z - 1.0).norm() > 1.0e-5;
        matrix.complex_eigenvalues().iter().filter(far).map(|z| z.norm()).fold(0.0, f64::max)
    }
}

#[test]
fn sets_of_walls_end_where_independent_loops_do() {
    for (name, q, normals, shares, without, kd) in SETS {
        let path = file(&format!("{name}.toml"));
        let share: Vec<f64> = shares.split(',').map(|part| part.parse().unwrap()).collect();
        let total: f64 = share.iter().sum();
        let share: Vec<f64> = share.iter().map(|part| part / total).collect();
        let q = format!("--q={q}");
        let n: Vec<String> = normals.iter().map(|normal| format!("--normal={normal}")).collect();
        let mut common: Vec<&str> = vec![&path, &q];
        common.extend(n.iter().map(String::as_str));
        common.extend(without.iter().flat_map(|walls| ["--no-feed-forward", walls]));

        // Torques per newton of each wall: `haptic model` says them, less what the device weighs.
        let torque = |forces: &[f64]| {
            let forces: Vec<String> = forces.iter().map(|force| format!("--force={force}")).collect();
            let mut all = vec!["model"];
            all.extend(&common);
            all.extend(forces.iter().map(String::as_str));
            all.extend(["--stiffness", shares]);
            json(&all)
        };
        let none = torque(&vec![0.0; share.len()]);
        let mass: Vec<Vec<f64>> = none["mass"].as_array().unwrap().iter().map(numbers).collect();
        let jacobian: Vec<Vec<f64>> = none["jacobian"].as_array().unwrap().iter().map(numbers).collect();
        let joints = mass.len();
        let unit = |normal: &str| {
            let v: Vec<f64> = normal.split(',').map(|x| x.parse().unwrap()).collect();
            let length = v.iter().map(|x| x * x).sum::<f64>().sqrt();
            v.into_iter().map(|x| x / length).collect::<Vec<f64>>()
        };
        let rows = DMatrix::from_fn(share.len(), joints, |i, j| {
            unit(normals[i]).iter().zip(&jacobian).map(|(n, row)| n * row[j]).sum()
        });
        let weight = numbers(&none["torque"]);
        let levers: Vec<DVector<f64>> = (0..share.len())
            .map(|pushing| {
                let forces: Vec<f64> = (0..share.len()).map(|i| f64::from(u8::from(i == pushing))).collect();
                let found = numbers(&torque(&forces)["torque"]);
                DVector::from_fn(joints, |j, _| found[j] - weight[j])
            })
            .collect();
        let description = DeviceFile::load(&path).unwrap().description;
        let plain = Independent {
            mass: DMatrix::from_fn(joints, joints, |i, j| mass[i][j]),
            viscous: DVector::from_fn(joints, |j, _| description.joints[j].viscous),
            levers: rows.transpose(),
            rows: rows.clone(),
            share: share.clone(),
        };
        let kd_text = format!("{kd}");
        let mut all = vec!["range"];
        all.extend(&common);
        all.extend(["--share", shares, "--rate", "1000", "--cutoff", "100", "--delay", "1", "--kd", &kd_text]);
        let range = json(&all);
        let shaped = Independent { levers: DMatrix::from_columns(&levers), ..plain.clone_of() };
        for (key, set) in [("off", &plain), ("full", &shaped)] {
            let kp = range[key]["boundary"][0]["kp"].as_f64().unwrap();
            assert!(kp > 0.0, "{name} {key}: nothing is stable at {kd} N s/m");
            let (below, above) = (set.radius(kp * 0.999, kd), set.radius(kp * 1.001, kd));
            assert!(below < 1.0 && above > 1.0, "{name} {key}: {below} below {kp} N/m and {above} above");
        }
    }
}

impl Independent {
    fn clone_of(&self) -> Self {
        Self {
            mass: self.mass.clone(),
            viscous: self.viscous.clone(),
            rows: self.rows.clone(),
            levers: self.levers.clone(),
            share: self.share.clone(),
        }
    }
}

#[test]
fn walls_that_cannot_be_measured_together_are_refused_before_anything_moves() {
    let path = file("coupled-five-bar.toml");
    let folder = tempfile::tempdir().unwrap();
    let of = |extra: &[&str], says: &str| {
        let all = [&["measure-range", &path, "--port", "sim", "--normal=1,0"], extra].concat();
        let done = haptic(&all).current_dir(&folder).assert().code(2);
        let error = String::from_utf8(done.get_output().stderr.clone()).unwrap();
        assert!(error.contains(says), "{error}");
    };
    of(&["--normal=0,1", "--share", "1,2,3"], "3 numbers for 2 walls");
    of(&["--normal=0,1", "--share", "1,0"], "holds 0");
    of(&["--normal=0,1,0"], "this device takes 2");
    of(&["--normal=0,0"], "points nowhere");
    of(&["--normal=0,1"; 4], "measure at most 4");
    assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 0, "nothing was begun");
}

#[test]
fn shares_that_do_not_fit_are_refused() {
    let path = file("coupled-five-bar.toml");
    let of = |extra: &[&str], code: i32, says: &str| {
        let mut all = vec![
            "range",
            &path,
            "--q=2.6,1.75",
            "--normal=0.26,0.97",
            "--normal=0,1",
            "--rate",
            "1000",
            "--cutoff",
            "100",
        ];
        all.extend(extra);
        let done = haptic(&all).assert().code(code);
        let error = String::from_utf8(done.get_output().stderr.clone()).unwrap();
        assert!(error.contains(says), "{error}");
    };
    of(&["--share", "1,2,3"], 2, "3 numbers for 2 walls");
    of(&["--share", "1,0"], 2, "holds 0");
    of(&["--share", "1,-2"], 2, "holds -2");
    of(&["--no-feed-forward", "2"], 2, "names wall 2, and there are 2");
    of(&["--no-feed-forward", "0,1"], 2, "leaves no wall with a feed-forward");
    of(&["--feed-forward-gain", "1.2"], 2, "several --normal");
}
