//! Tests of the conversion from URDF and MJCF.

mod golden;
mod refusals;
