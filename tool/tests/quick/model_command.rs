//! `haptic model` as other programs use it: JSON document, exit codes, and names of singular poses.

use crate::common::{self, numbers, output, run, type_lines};
use nalgebra::{DMatrix, DVector};
use serde_json::Value;

fn model_line<'a>(device: &'a str, args: &[&'a str]) -> Vec<&'a str> {
    [&["model", device], args].concat()
}

/// Returns the JSON document of a command that prints nothing on standard error.
fn model_json(name: &str, args: &[&str]) -> Value {
    let (code, out, err) = run(&model_line(&format!("devices/{name}.toml"), &[args, &["--json"]].concat()));
    assert_eq!((code, err.as_str()), (0, ""));
    serde_json::from_str(&out).expect("one JSON document and nothing else")
}

/// Returns the one line on standard error of a command that ends with exit code 1.
fn failing_model(name: &str, args: &[&str]) -> String {
    let message = common::refusal(1, &model_line(&format!("devices/{name}.toml"), args));
    assert_eq!(message.trim_end().lines().count(), 1, "one line: {message}");
    message
}

fn angles_option(q: &[f64]) -> String {
    let angles: Vec<String> = q.iter().map(|angle| format!("{angle:?}")).collect();
    format!("--q={}", angles.join(","))
}

#[test]
fn the_document_has_the_documented_keys_and_shapes() {
    let one = model_json("woodenhaptics", &["--q=0.2,1.0,-0.5", "--normal=0.7,0.7,0", "--force", "2"]);
    let keys: Vec<&str> = one.as_object().expect("an object").keys().map(String::as_str).collect();
    let documented = "admissible bias condition coupling f_a forces jacobian mass normals perception position precision q \
                      qd torque torque_without_feed_forward w_aa w_eff w_ra w_rr z_a z_r";
    assert_eq!(keys.join(" "), documented);
    let shape = |value: &Value| {
        let rows = value.as_array().expect("a list");
        (rows.len(), rows.first().and_then(Value::as_array).map_or(0, Vec::len))
    };
    for (key, expected) in [
        ("jacobian", (3, 3)),
        ("mass", (3, 3)),
        ("w_rr", (1, 1)),
        ("w_ra", (1, 2)),
        ("w_aa", (2, 2)),
        ("w_eff", (1, 1)),
        ("coupling", (1, 1)),
        ("z_r", (1, 0)),
        ("z_a", (2, 0)),
        ("f_a", (2, 0)),
        ("torque", (3, 0)),
    ] {
        assert_eq!(shape(&one[key]), expected, "{key}");
    }
    assert!(one["condition"]["jacobian"].is_f64() && one["condition"]["mass"].is_f64());
    // At an edge of two walls two directions are rendered and one is free.
    let edge = ["--q=0.2,1.0,-0.5", "--normal=1,0,0", "--force=1", "--normal=0,1,0", "--force=2"];
    let two = model_json("woodenhaptics", &edge);
    assert_eq!(shape(&two["w_rr"]), (2, 2));
    assert_eq!(shape(&two["w_ra"]), (2, 1));
    assert_eq!(shape(&two["f_a"]), (1, 0));
    // The redundant arm has a planar tip and three joints.
    let arm = model_json("serial-3r", &["--q=0.6,0.9,-0.7", "--normal=0,1", "--force=1"]);
    assert_eq!(shape(&arm["jacobian"]), (2, 3));
    assert_eq!(arm["position"].as_array().map(Vec::len), Some(2));
}

/// Returns true if two numbers differ only by rounding.
fn is_near(value: &Value, expected: f64) -> bool {
    value.as_f64().is_some_and(|value| (value - expected).abs() < 1e-12)
}

#[test]
fn several_walls_have_directions_and_shares() {
    let [n, m] = ["--normal=0.6,0.8", "--normal=-0.8,0.6"];
    let corner = model_json("coupled-five-bar", &[n, m, "--stiffness=3,1"]);
    let [first, second] = corner["directions"].as_array().unwrap().as_slice() else { panic!("{corner}") };
    // Walls at a right angle have their normals as directions, the stiffer first. The second wall has a third of the
    // stiffness, so the share of the first is 1 - 1/9.
    let sign = if first["along"][0].as_f64() > Some(0.0) { 1.0 } else { -1.0 };
    assert!(is_near(&first["along"][0], 0.6 * sign) && is_near(&first["along"][1], 0.8 * sign), "{first}");
    assert!(is_near(&first["stiffness"], 1.0) && is_near(&first["share"], 8.0 / 9.0), "{first}");
    assert!(is_near(&second["stiffness"], 1.0 / 3.0) && second["share"].is_null(), "{second}");
    // One of two equal walls has the feed-forward, so its share is a half.
    let half = model_json("coupled-five-bar", &[n, n, "--no-feed-forward=1"]);
    assert!(is_near(&half["directions"][0]["share"], 0.5), "{half}");
    // A single wall has no list of directions.
    assert!(model_json("coupled-five-bar", &[n]).get("directions").is_none());
}

#[test]
fn negative_numbers_parse_in_either_notation() {
    let equals = model_json("haply-2diy", &["--q=-0.3,1.2", "--qd=-1,2", "--normal=-1,0.5", "--force=-2"]);
    let spaced = model_json("haply-2diy", &["--q", "-0.3,1.2", "--qd", "-1,2", "--normal", "-1,0.5", "--force", "-2"]);
    assert_eq!(equals, spaced);
}

#[test]
fn a_normal_of_any_length_is_the_same_wall() {
    let short = model_json("haply-2diy", &["--normal=3e-30,4e-30", "--force=2"]);
    let long = model_json("haply-2diy", &["--normal=0.6,0.8", "--force=2"]);
    for key in ["torque", "torque_without_feed_forward"] {
        let (short, long) = (numbers(&short[key]), numbers(&long[key]));
        assert_eq!((short.len(), long.len()), (2, 2), "{key} of two joints");
        let same = short.iter().zip(&long).all(|(a, b)| *a != 0.0 && (a - b).abs() < 1.0e-12);
        assert!(same, "{key} of 2 N: {short:?} {long:?}");
    }
}

#[test]
fn the_default_pose_is_home() {
    let home = model_json("coupled-five-bar", &[]);
    let report = model_json("coupled-five-bar", &["--q=2.3,0.84159265358979"]);
    assert_eq!(home, report);
}

#[test]
fn whole_turns_change_no_torque_of_the_board() {
    // The board's trigonometry is accurate within a turn, so angles are reduced to one turn before rounding to f32.
    let turn = core::f64::consts::TAU;
    let wall = ["--normal=0.7,0.7", "--force=2", "--precision=f32"];
    let near = model_json("coupled-five-bar", &[&wall[..], &[&angles_option(&[2.6, 1.75])]].concat());
    let angles = [2.6 + 1000.0 * turn, 1.75 - 1000.0 * turn];
    // Angles of many turns cause a warning on standard error.
    let far_report =
        common::json(&model_line("devices/coupled-five-bar.toml", &[&wall[..], &[&angles_option(&angles)]].concat()));
    let (near, far) = (numbers(&near["torque"]), numbers(&far_report["torque"]));
    let same = near.iter().zip(&far).all(|(a, b)| (a - b).abs() < 2.0e-6);
    assert!(near.len() == 2 && far.len() == 2 && same, "{near:?} {far:?}");
}

#[test]
fn a_stretched_arm_is_a_serial_singularity_of_its_joint() {
    // haply-2diy: arm 0 is stretched at 1.2 rad, so the tip is 0.16 m from its motor. The law of cosines gives arm 1.
    let (base, proximal, distal) = (0.038_f64, 0.07_f64, 0.09_f64);
    let tip = ((proximal + distal) * 1.2_f64.cos() - base, (proximal + distal) * 1.2_f64.sin());
    let reach = tip.0.hypot(tip.1);
    let elbow = ((proximal.powi(2) + reach.powi(2) - distal.powi(2)) / (2.0 * proximal * reach)).acos();
    let q1 = tip.1.atan2(tip.0) - elbow;
    let message = failing_model("haply-2diy", &[&angles_option(&[1.2, q1]), "--normal=0,1", "--force=1"]);
    assert!(message.contains("serial singularity: joint 0 turns without moving the tip"), "{message}");
    // Close to the singularity the model can still be evaluated.
    let near = model_json("haply-2diy", &[&angles_option(&[1.2 + 1.0e-3, q1]), "--normal=0,1", "--force=1"]);
    assert!(near["condition"]["jacobian"].as_f64().is_some_and(|condition| condition > 100.0));
}

#[test]
fn aligned_distal_links_are_a_parallel_singularity() {
    // pantograph-mk2: the elbows are exactly two distal lengths apart.
    let q1 = ((0.15_f64 - 0.025) / 0.126).acos();
    let message = failing_model("pantograph-mk2", &[&angles_option(&[core::f64::consts::PI - q1, q1]), "--normal=0,1"]);
    assert!(message.contains("parallel singularity"), "{message}");
    let message = failing_model("pantograph-mk2", &[&angles_option(&[core::f64::consts::PI, 0.0]), "--normal=0,1"]);
    assert!(message.contains("do not meet"), "{message}");
}

#[test]
fn other_mechanisms_name_their_singularities() {
    for (name, q, word) in [
        // Upper arm and forearm are in line.
        ("woodenhaptics", "--q=0.2,0.5,0.5", "serial singularity: joints 1 and 2 turn together"),
        // The first two links are in line.
        ("serial-3r", "--q=0.3,0,0.5", "serial singularity"),
    ] {
        let normal = if name == "serial-3r" { "--normal=0,1" } else { "--normal=0,1,0" };
        let message = failing_model(name, &[q, normal]);
        assert!(message.contains(word), "{message}");
    }
}

#[test]
fn wrong_arguments_are_refused() {
    let line = "2: model devices/haply-2diy.toml";
    let table = [
        ("--q=1", "--q has 1 number, but this device takes 2"),
        ("--q=1,2,3", "--q has 3 numbers"),
        ("--qd=1", "--qd has 1 number,"),
        ("--normal=0,0", "--normal is zero"),
        ("--normal=0,0,1", "--normal has 3 numbers"),
        ("--normal=0,1 --force=1 --force=2", "in pairs"),
        ("--force=1", "in pairs"),
        ("--q=a,b", "`a` is not a number"),
        ("--q=nan,1", "not a finite number"),
        ("--q=", "not a number"),
        ("--normal=0,1 --force=inf", "not a finite number"),
        ("--precision=f16", "f16"),
        ("--colour", "--colour"),
    ];
    table.iter().for_each(|(options, words)| type_lines(&format!("{line} {options} => {words}"), &[]));
}

#[test]
fn the_text_names_gain_and_cost_of_the_feed_forward() {
    let text = |name: &str, normal: &str| output(&model_line(&format!("devices/{name}.toml"), &[normal, "--force=1"]));
    // The home pose of a light five-bar has almost no coupling; the home pose of a WoodenHaptics has much.
    let light = text("pantograph-mk2", "--normal=0,1");
    assert!(light.contains("has almost no benefit"), "{light}");
    let heavy = text("woodenhaptics", "--normal=0.5,1,0");
    assert!(heavy.contains("more inertia here") && !heavy.contains("has almost no benefit"), "{heavy}");
    assert!(heavy.contains("pushes a hand along the wall"), "{heavy}");
}

/// Reads a matrix from rows of numbers.
fn parse_matrix(value: &Value) -> DMatrix<f64> {
    let rows = value.as_array().expect("rows");
    let columns = rows[0].as_array().expect("a row").len();
    DMatrix::from_fn(rows.len(), columns, |i, j| rows[i][j].as_f64().expect("a number"))
}

/// Returns the inertias that a hand feels along a wall, kg: the eigenvalues of the force per acceleration across the
/// normal while the wall's `torque` (N m per newton) keeps the tip on its surface.
fn inertias_along_wall(document: &Value, torque: &DVector<f64>, normal: &[f64]) -> Vec<f64> {
    let (jacobian, mass) = (parse_matrix(&document["jacobian"]), parse_matrix(&document["mass"]));
    let solve = |torque: &DVector<f64>| &jacobian * mass.clone().lu().solve(torque).expect("a mass matrix");
    let n = DVector::from_column_slice(normal);
    // Directions across the normal are eigenvectors of 1 - n nᵀ.
    let flat = (DMatrix::identity(n.len(), n.len()) - &n * n.transpose()).symmetric_eigen();
    let across: Vec<DVector<f64>> =
        (0..n.len()).filter(|i| flat.eigenvalues[*i] > 0.5).map(|i| flat.eigenvectors.column(i).into_owned()).collect();
    let response = solve(torque);
    let displacements = across.iter().map(|t| {
        let free_response = solve(&(jacobian.transpose() * t));
        // The wall's force keeps the tip on its surface.
        &free_response - &response * (n.dot(&free_response) / n.dot(&response))
    });
    let displacements: Vec<DVector<f64>> = displacements.collect();
    let mobility = DMatrix::from_fn(across.len(), across.len(), |i, j| across[i].dot(&displacements[j]));
    let mut inertias: Vec<f64> = mobility.complex_eigenvalues().iter().map(|value| 1.0 / value.re).collect();
    inertias.sort_by(f64::total_cmp);
    inertias
}

#[test]
fn a_hand_feels_less_inertia_along_a_wall_with_the_feed_forward() {
    for (name, pose, normal) in [
        ("coupled-five-bar", "--q=2.6,1.75", vec![0.6, 0.8]),
        ("phantom-premium-1.5", "--q=0.3,0.9,-0.3", vec![-0.6, 0.0, 0.8]),
        ("serial-3r", "--q=0.5,0.8,0.7", vec![0.6, 0.8]),
    ] {
        let list: Vec<String> = normal.iter().map(f64::to_string).collect();
        let along = format!("--normal={}", list.join(","));
        // The difference of the torques at 1 N and 0 N leaves out the weight.
        let [none, one] = ["--force=0", "--force=1"].map(|force| model_json(name, &[pose, &along, force]));
        let perception = &one["perception"];
        let mut sums = Vec::new();
        for (mode, torques) in [("off", "torque_without_feed_forward"), ("full", "torque")] {
            let torque = DVector::from_vec(numbers(&one[torques])) - DVector::from_vec(numbers(&none[torques]));
            let found = numbers(&perception["along_wall"][mode]);
            let known = inertias_along_wall(&one, &torque, &normal);
            assert_eq!(found.len(), known.len());
            for (found, known) in found.iter().zip(&known) {
                assert!((found / known - 1.0).abs() < 1e-9, "{name} {mode}: {found} is not {known}");
            }
            sums.push(found.iter().sum::<f64>());
        }
        assert!(sums[1] < 0.999 * sums[0], "{name}: {sums:?}");
        // In the air the felt inertia depends on the direction.
        let (tip, ratio) = (numbers(&perception["tip"]), perception["ratio"].as_f64().expect("a number"));
        assert_eq!(tip.len(), normal.len());
        assert!((ratio - tip.last().unwrap() / tip[0]).abs() < 1e-12 && ratio > 1.0, "{name}: {tip:?}");
        let w_eff = one["w_eff"][0][0].as_f64().expect("a number");
        assert!(tip[0] <= w_eff && w_eff <= *tip.last().unwrap(), "{name}: {w_eff} of {tip:?}");
    }
}

#[test]
fn overflow_is_an_error() {
    let message = failing_model("haply-2diy", &["--qd=1e200,1e200", "--normal=0,1", "--json"]);
    assert!(message.contains("overflow"), "{message}");
}
