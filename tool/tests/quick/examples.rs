//! The example programs run and have plausible results.

#[path = "../../../examples/follow_telemetry.rs"]
mod follow_telemetry;
#[path = "../../../examples/predict_range.rs"]
mod predict_range;
#[path = "../../../examples/press_a_wall.rs"]
mod press_a_wall;
#[path = "../../../examples/push_from_the_host.rs"]
mod push_from_the_host;

#[test]
fn every_example_runs_to_its_end() {
    press_a_wall::main().expect("a wall that can be pressed");
    follow_telemetry::follow("sim").expect("telemetry of a simulated board");
    predict_range::main().expect("a range");
    let (from, to) = push_from_the_host::push("sim").expect("a board that can be pushed");
    // 1 N presses 5.37 mm deep into 50 N/m and, from 5 mm on, 2050 N/m. Friction of 0.005 N m on 0.1 m may hold a part.
    let sunk = f64::from(from[1] - to[1]);
    assert!((sunk - 0.005_37).abs() < 0.000_1, "{sunk} m");
}

#[test]
fn every_example_program_has_a_test() {
    let mut names: Vec<String> = std::fs::read_dir(crate::common::root().join("examples"))
        .expect("the folder of examples")
        .map(|entry| entry.expect("a readable entry").file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    assert_eq!(names, ["follow_telemetry.rs", "predict_range.rs", "press_a_wall.rs", "push_from_the_host.rs"]);
}
