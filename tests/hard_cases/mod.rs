//! Cases that are hard to compute: the board's f32 against f64. tool/tests/deep/hard_cases asserts the same of 106
//! bits, and of f64 too.

mod bounds;
pub mod rows;

use crate::common::device_file::shipped;

/// The reference's numbers, and their trigonometry.
type Exact = f64;
type ExactMath = haptic_bridge::math::Libm;
