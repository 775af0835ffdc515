//! `haptic range` of several walls: one wall given twice equals the wall of the independent domains, and sets of walls
//! agree with loops built from M, J and the torques of `haptic model`.

use crate::common::domains::{self, Case, Known, WALL_SETS};
use crate::common::oracle::Bodies;
use crate::common::prelude::*;
use crate::common::{Folder, file, json, type_lines};
use haptic_stability::analysis::range::domain_of_several;
use haptic_stability::analysis::several::WallSet;

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect()
}

#[test]
fn one_wall_given_twice_has_its_independent_domain() {
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

#[test]
fn sets_of_walls_end_where_independent_loops_do() {
    for (name, q, normals, shares, without, kd) in WALL_SETS {
        let split = |list: &str| list.split(',').map(|part| part.parse().unwrap()).collect::<Vec<f64>>();
        let share = DVector::from_vec(split(shares));
        let share = &share / share.sum();
        let (path, q) = (file(&format!("{name}.toml")), format!("--q={q}"));
        let n: Vec<String> = normals.iter().map(|normal| format!("--normal={normal}")).collect();
        let mut common: Vec<&str> = vec![&path, &q];
        common.extend(n.iter().map(String::as_str));
        common.extend(without.iter().flat_map(|walls| ["--no-feed-forward", walls]));

        // Torques per newton of each wall from `haptic model`, less the device's weight.
        let model = |forces: DVector<f64>| {
            let forces: Vec<String> = forces.iter().map(|force| format!("--force={force}")).collect();
            let forces: Vec<&str> = forces.iter().map(String::as_str).collect();
            json(&[&["model"], &common[..], &forces, &["--stiffness", shares]].concat())
        };
        let none = model(0.0 * &share);
        let matrix = |key: &str| {
            let rows: Vec<Vec<f64>> = none[key].as_array().unwrap().iter().map(numbers).collect();
            DMatrix::from_fn(rows.len(), rows[0].len(), |i, j| rows[i][j])
        };
        let (mass, jacobian) = (matrix("mass"), matrix("jacobian"));
        let joints = mass.nrows();
        let normals = normals.iter().map(|normal| DVector::from_vec(split(normal)).normalize());
        let normals = DMatrix::from_columns(&normals.collect::<Vec<_>>());
        let torque = |model: &Value| DVector::from_vec(numbers(&model["torque"]));
        let levers = (0..share.len()).map(|wall| {
            let one = DVector::from_fn(share.len(), |i, _| f64::from(u8::from(i == wall)));
            torque(&model(one)) - torque(&none)
        });
        let levers = DMatrix::from_columns(&levers.collect::<Vec<_>>());
        let description = DeviceFile::load(&path).unwrap().description;
        let damping = DVector::from_fn(joints, |j, _| description.joints[j].viscous);
        let mut bodies = Bodies {
            mass,
            damping: DMatrix::from_diagonal(&damping),
            stiffness: DMatrix::zeros(joints, joints),
            driven: DMatrix::identity(joints, joints),
            torques: DMatrix::zeros(joints, jacobian.nrows()),
            seen: jacobian.clone(),
        };
        let kd_text = kd.to_string();
        let loop_ = ["--share", shares, "--rate", "1000", "--cutoff", "100", "--delay", "1", "--kd", &kd_text];
        let range = json(&[&["range"], &common[..], &loop_].concat());
        for (key, levers) in [("off", jacobian.tr_mul(&normals)), ("full", levers)] {
            bodies.torques = levers * DMatrix::from_diagonal(&share) * normals.transpose();
            let kp = range[key]["boundary"][0]["kp"].as_f64().unwrap();
            assert!(kp > 0.0, "{name} {key}: nothing is stable at {kd} N s/m");
            let (below, above) = (bodies.radius(kp * 0.999, kd), bodies.radius(kp * 1.001, kd));
            assert!(below < 1.0 && above > 1.0, "{name} {key}: {below} below {kp} N/m and {above} above");
        }
    }
}

#[test]
fn impossible_sets_of_walls_are_refused() {
    let folder = Folder::new();
    let progress = folder.path("progress.json");
    let two = "devices/coupled-five-bar.toml --normal=1,0 --normal=0,1";
    let measured = format!("{two} --port sim --progress {progress}");
    type_lines(
        &format!(
            "2: measure-range {measured} --share 1,2,3 => 3 numbers for 2 walls
            2: measure-range {measured} --share 1,0 => holds 0
            2: measure-range {measured} --normal=0,1,0 => this device takes 2
            2: measure-range {measured} --normal=0,0 => points nowhere
            2: measure-range {measured} --normal=0,1 --normal=0,1 --normal=0,1 => measure at most 4
            2: range {two} --share 1,2,3 => 3 numbers for 2 walls
            2: range {two} --share 1,0 => holds 0
            2: range {two} --share 1,-2 => holds -2
            2: range {two} --no-feed-forward 2 => names wall 2, and there are 2
            2: range {two} --no-feed-forward 0,1 => leaves no wall with a feed-forward
            2: range {two} --feed-forward-gain 1.2 => several --normal"
        ),
        &[],
    );
    assert!(!std::path::Path::new(&progress).exists(), "nothing was begun");
}
