//! The pose that homing declares is the pose that is read, however coarse the encoder.

use crate::common::file;
use crate::common::sim::Sim;

#[test]
fn a_coarse_encoder_reads_home_where_home_is() {
    let sim = Sim::start(&[&file("capstan-pantograph.toml")]);
    sim.run(&["home"]).success();
    let info = sim.run(&["info", "--json"]).success();
    let info: serde_json::Value = serde_json::from_slice(&info.get_output().stdout).unwrap();
    for (read, declared) in info["q"].as_array().unwrap().iter().zip([2.897_247, 0.244_346]) {
        // One count is 8.9e-3 rad; single precision keeps 3e-7 of an angle of 3 rad.
        assert!((read.as_f64().unwrap() - declared).abs() < 2e-6, "{read} is not {declared}");
    }
}
