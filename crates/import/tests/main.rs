//! Tests of the conversion from URDF and MJCF.

mod formats;
mod golden;
mod refusals;
