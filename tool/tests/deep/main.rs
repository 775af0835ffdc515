//! Slow tests, tests that kill processes, and tests of computed documents. `cargo xtask test --deep PART` runs a
//! module.

#[path = "../common/mod.rs"]
mod common;

mod claims;

mod cogging;

mod documents {
    mod drawings;
    mod long_blocks;
    mod map_picture;
}

mod hard_cases;

mod lies;

mod processes {
    mod arm_key;
    mod continued;
    mod demo;
    mod killed;
    mod view;
}

mod ranges {
    mod complete;
    mod measure_range_command;
    mod measured_range;
    mod published_steps;
    mod range_several_flexible;
    mod sets_of_walls;
    mod several_walls;
    mod undamped_constants;
}

mod soak;

mod tune {
    mod design;
    mod first_walls;
    mod plan;
    mod settings;
    mod tuned_devices;
}
