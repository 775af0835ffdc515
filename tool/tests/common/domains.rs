//! Independently computed stable domains of single walls (tests/golden/range.json).

use haptic_host::device_file::DeviceFile;
use haptic_stability::analysis::sampled::{LinearEstimator, Loop, Mode};
use serde_json::Value;

/// A wall at one pose of a device, and its control loop.
pub struct Case {
    pub id: String,
    pub file: DeviceFile,
    /// Joint angles, rad.
    pub q: Vec<f64>,
    pub normal: Vec<f64>,
    pub around: Loop,
    /// Independently computed domains without and with the feed-forward.
    pub expected: [(Mode, KnownDomain); 2],
}

/// An independently computed domain: kp, N/m, at each kd, N s/m, the area under kp, and the largest kd.
pub struct KnownDomain {
    pub kd: Vec<f64>,
    pub kp: Vec<f64>,
    pub area: f64,
    pub kd_max: f64,
}

/// Returns the twenty cases of tests/golden/range.json.
pub fn all_cases() -> Vec<Case> {
    let golden: Value = serde_json::from_str(&super::read("tests/golden/range.json")).unwrap();
    let cases: Vec<Case> = golden["cases"].as_array().unwrap().iter().map(parse_case).collect();
    assert_eq!(cases.len(), 20);
    cases
}

fn parse_case(case: &Value) -> Case {
    let number = |value: &Value| value.as_f64().unwrap();
    let numbers = |value: &Value| value.as_array().unwrap().iter().map(number).collect::<Vec<f64>>();
    let known = |key: &str| {
        let expected = &case["expect"][key];
        let points = expected["boundary"].as_array().unwrap();
        let of = |name: &str| points.iter().map(|point| number(&point[name])).collect();
        KnownDomain { kd: of("kd"), kp: of("kp"), area: number(&expected["area"]), kd_max: number(&expected["kd_max"]) }
    };
    let id = case["id"].as_str().unwrap().to_string();
    Case {
        file: DeviceFile::parse(case["device"].as_str().unwrap(), &id).unwrap(),
        id,
        q: numbers(&case["q"]),
        normal: numbers(&case["normal"]),
        around: super::ideal_loop(
            number(&case["rate"]),
            number(&case["delay"]),
            LinearEstimator::Butterworth(number(&case["cutoff"])),
        ),
        expected: [(Mode::Off, known("off")), (Mode::Full, known("full"))],
    }
}

/// A set of walls: device, pose, normals, shares, walls without the feed-forward, damping (N s/m).
pub type WallSetCase = (&'static str, &'static str, &'static [&'static str], &'static str, Option<&'static str>, f64);

/// Sets of walls: facets that differ by 2, 5 and 10 degrees, and corners in the plane and in space.
pub const WALL_SETS: [WallSetCase; 8] = [
    ("coupled-five-bar", "2.6,1.75", &["0.2419219,0.9702957", "0.2756374,0.9612617"], "1,1", None, 15.0),
    ("coupled-five-bar", "2.6,1.75", &["0.2419219,0.9702957", "0.3255682,0.9455186"], "1,1", None, 15.0),
    ("coupled-five-bar", "2.6,1.75", &["0.9702957,-0.2419219", "0.9135455,-0.4067366"], "2,1", None, 15.0),
    ("coupled-five-bar", "2.6,1.75", &["0.97,0.24", "0.24,-0.97"], "3,1", None, 15.0),
    ("coupled-five-bar", "2.6,1.75", &["0.97,-0.24", "0.9,-0.45"], "3,1", Some("1"), 15.0),
    ("phantom-premium-1.5", "0.3,0.9,-0.3", &["0.6,0.8,0", "0,0.6,0.8", "1,0,0.2"], "1,0.5,0.02", None, 2.0),
    ("phantom-premium-1.5", "0.3,0.9,-0.3", &["0.6,0.8,0", "0,0.6,0.8", "1,0,0.2"], "1,0.5,0.3", Some("0,2"), 2.0),
    ("serial-3r", "0.4,0.9,0.7", &["0.6,0.8", "-0.3,0.9"], "1,0.2", None, 2.0),
];
