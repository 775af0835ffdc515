//! Cases that are hard to compute, with the board's f32 against f64. tool/tests/deep/hard_cases asserts the same
//! bounds, also for f64, against a reference of 106 bits.

mod bounds;
pub mod rows;

use crate::common::device_file::shipped_device;

type Exact = f64;
type ExactMath = haptic_bridge::math::Libm;
