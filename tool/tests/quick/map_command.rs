//! `haptic map` as other programs use it.

use crate::common::{json, pose_option};

const DEVICE: &str = "devices/coupled-five-bar.toml";
const TURRET: &str = "devices/phantom-premium-1.5.toml";

#[test]
fn every_point_agrees_with_haptic_model() {
    let map = json(&["map", DEVICE, "--normal", "0.6,-0.8", "--points", "100"]);
    let points = map["points"].as_array().unwrap();
    assert!(points.len() > 20);
    for point in points.iter().step_by(7) {
        let q = pose_option(&point["q"]);
        let model = json(&["model", DEVICE, &q, "--normal", "0.6,-0.8"]);
        for (one, other) in [
            (&point["w_eff"], &model["w_eff"][0][0]),
            (&point["w_rr"], &model["w_rr"][0][0]),
            (&point["condition"]["jacobian"], &model["condition"]["jacobian"]),
            (&point["condition"]["mass"], &model["condition"]["mass"]),
            (&point["position"][1], &model["position"][1]),
        ] {
            let (one, other) = (one.as_f64().unwrap(), other.as_f64().unwrap());
            assert!((one - other).abs() < 1e-9 * other.abs().max(1e-3), "{q}: {one} {other}");
        }
    }
}

/// Behind the turret's axis the linkage would be in another arm pose, so the map has no points there.
#[test]
fn a_coarse_grid_does_not_cross_a_singularity() {
    let map = json(&["map", TURRET, "--normal", "0,1,0"]);
    let points = map["points"].as_array().unwrap();
    assert!(points.len() > 300, "{}", points.len());
    for point in points {
        let number = |key: &str, i: usize| point[key][i].as_f64().unwrap();
        let in_plane = number("position", 0) * number("q", 0).cos() - number("position", 2) * number("q", 0).sin();
        assert!(in_plane > 0.0, "{point}");
    }
}

#[test]
fn a_point_has_the_documented_keys() {
    let map = json(&["map", DEVICE, "--normal", "1,0", "--points", "30"]);
    let keys: Vec<&String> = map["points"][0].as_object().unwrap().keys().collect();
    let documented = [
        ["condition", "coupling", "eigenvalues", "eigenvectors", "position"],
        ["q", "w_eff", "w_rr", "worst_coupling", "worst_ratio"],
    ];
    assert_eq!(keys, documented.as_flattened());
}
