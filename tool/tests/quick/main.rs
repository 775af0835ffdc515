//! Tests of the tool in every run of `cargo xtask test`: the tool's library in this process and in virtual time, and
//! each command once. No test depends on a clock or takes more than a second or two.

#[path = "../common/mod.rs"]
mod common;

mod absolute;
mod admissible_set;
mod any_order;
mod backup;
mod bad_files;
mod board_commands;
mod brushless;
mod cogging;
mod command_line;
mod devices_with_weight;
mod documents;
mod every_command;
mod examples;
mod faded_terms;
mod forces;
mod golden_model;
mod haply;
mod home;
mod map_command;
mod measured;
mod model_command;
mod plausible;
mod plot;
mod precision;
mod prediction;
mod published;
mod range_command;
mod range_estimators;
mod range_flexible;
mod range_golden;
mod range_model;
mod range_several;
mod read_back;
mod record;
mod replay;
mod report;
mod ripple;
mod saturation;
mod session;
mod shipped_scenes;
mod simulated_board;
mod simulated_device;
mod single_counts;
mod tools;
mod tuned;
mod view;
mod why;
