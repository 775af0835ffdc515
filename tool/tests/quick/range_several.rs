//! `haptic range` of several walls. One wall given twice has the independently computed domain of the wall, and sets of
//! walls have the limits of loops computed from M, J and the torques of `haptic model`.

use crate::common::bodies::Bodies;
use crate::common::domains::{self, Case, KnownDomain, WALL_SETS};
use crate::common::prelude::*;
use crate::common::{Folder, json, numbers, shipped_path, type_lines};
use haptic_stability::analysis::flexible::Hand;
use haptic_stability::analysis::pose::TaskPose;
use haptic_stability::analysis::range::domain_of_several;
use haptic_stability::analysis::several::WallSet;

#[test]
fn one_wall_given_twice_has_the_independent_domain() {
    for Case { id, file, q, normal, around, expected } in domains::all_cases() {
        let walls = [Member::new(normal.clone(), 0.3), Member::new(normal, 0.7)];
        let set = WallSet::at(&file.description, &q, &walls, Admissible::default()).unwrap();
        for (mode, KnownDomain { kd, kp, .. }) in expected {
            let key = format!("{mode:?}");
            let found = domain_of_several(&set, &around, mode, Some(&kd)).unwrap();
            let largest = kp.iter().fold(0.0_f64, |a, b| a.max(*b));
            for (point, known) in found.boundary.iter().zip(&kp) {
                let off = (point.kp - known) / largest;
                // The limit is bisected to a growth of 1e-11 per sample.
                assert!(off.abs() < 1e-5, "{id} {key} at kd = {}: kp off by {off:e} of the largest", point.kd);
            }
        }
    }
}

#[test]
fn sets_of_walls_have_the_limits_of_independent_loops() {
    for (name, q, normals, shares, without, kd) in WALL_SETS {
        let path = shipped_path(&format!("{name}.toml"));
        let share: Vec<f64> = shares.split(',').map(|part| part.parse().unwrap()).collect();
        let total: f64 = share.iter().sum();
        let share: Vec<f64> = share.iter().map(|part| part / total).collect();
        let angles: Vec<f64> = q.split(',').map(|angle| angle.parse().unwrap()).collect();
        let q = format!("--q={q}");
        let n: Vec<String> = normals.iter().map(|normal| format!("--normal={normal}")).collect();
        let mut common: Vec<&str> = vec![&path, &q];
        common.extend(n.iter().map(String::as_str));
        common.extend(without.iter().flat_map(|walls| ["--no-feed-forward", walls]));
        // Torques of `haptic model` per newton of each wall. The torques of the device's weight are subtracted below.
        let torque = |forces: &[f64]| {
            let forces: Vec<String> = forces.iter().map(|force| format!("--force={force}")).collect();
            let mut all = vec!["model"];
            all.extend(&common);
            all.extend(forces.iter().map(String::as_str));
            all.extend(["--stiffness", shares]);
            json(&all)
        };
        let none = torque(&vec![0.0; share.len()]);
        let unit = |normal: &&str| {
            let v: Vec<f64> = normal.split(',').map(|x| x.parse().unwrap()).collect();
            DVector::from_vec(v).normalize()
        };
        let normals: Vec<DVector<f64>> = normals.iter().map(unit).collect();
        let weight = numbers(&none["torque"]);
        let file = DeviceFile::load(&path).unwrap();
        let pose = TaskPose::of(&file.mechanism, &angles).unwrap();
        let through_jacobian = pose.jacobian.rows(0, pose.task).transpose();
        let (task, joints) = (pose.task, angles.len());
        let (mut plain, mut shaped) = (DMatrix::zeros(joints, task), DMatrix::zeros(joints, task));
        for (pushing, normal) in normals.iter().enumerate() {
            let forces: Vec<f64> = (0..share.len()).map(|i| f64::from(u8::from(i == pushing))).collect();
            let found = numbers(&torque(&forces)["torque"]);
            let lever = DVector::from_fn(joints, |j, _| found[j] - weight[j]);
            plain += &through_jacobian * normal * normal.transpose() * share[pushing];
            shaped += lever * normal.transpose() * share[pushing];
        }
        let kd_text = format!("{kd}");
        let mut all = vec!["range"];
        all.extend(&common);
        all.extend(["--share", shares, "--rate", "1000", "--cutoff", "100", "--delay", "1", "--kd", &kd_text]);
        let range = json(&all);
        for (key, torques) in [("off", plain), ("full", shaped)] {
            let kp = range[key]["boundary"][0]["kp"].as_f64().unwrap();
            Bodies::new(&file, &angles, Hand::default(), torques).assert_limit(kp, kd, &format!("{name} {key}"));
        }
    }
}

#[test]
fn impossible_sets_of_walls_are_refused() {
    let folder = Folder::new();
    let progress = folder.path("progress.json");
    let five_bar = "devices/coupled-five-bar.toml --q=2.6,1.75";
    let measure = format!("2: measure-range {five_bar} --port sim --progress {progress} --normal=1,0");
    let range = format!("2: range {five_bar} --normal=0.26,0.97 --normal=0,1 --rate 1000 --cutoff 100");
    type_lines(
        &format!(
            "{measure} --normal=0,1 --share 1,0 => holds 0
            {measure} --normal=0,1,0 => this device takes 2
            {measure} --normal=0,0 => points nowhere
            {measure} --normal=0,1 --normal=0,1 --normal=0,1 --normal=0,1 => measure at most 4
            {range} --share 1,2,3 => 3 numbers for 2 walls
            {range} --share 1,-2 => holds -2
            {range} --no-feed-forward 2 => names wall 2, and there are 2
            {range} --no-feed-forward 0,1 => leaves no wall with a feed-forward
            {range} --feed-forward-gain 1.2 => several --normal"
        ),
        &[],
    );
    assert!(!std::path::Path::new(&progress).exists(), "a progress file was written");
}
