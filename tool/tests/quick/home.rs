//! After homing the measured pose is exactly home, even with a coarse encoder.

use crate::common::shipped_path;
use crate::common::sim::Sim;

#[test]
fn a_coarse_encoder_reads_exactly_home() {
    let sim = Sim::start(&[&shipped_path("capstan-pantograph.toml")]);
    sim.run(&["home"]).success();
    let info = sim.json(&["info"]);
    for (read, declared) in info["q"].as_array().unwrap().iter().zip([2.897_247, 0.244_346]) {
        // One count is 8.9e-3 rad. The tolerance covers only single precision, 3e-7 of an angle of 3 rad.
        assert!((read.as_f64().unwrap() - declared).abs() < 2e-6, "{read} is not {declared}");
    }
}
