//! Converts between a device's task frame and CHAI3D's frame, which has x towards the operator, y to the right and z
//! up. Computes the handle's orientation.

use haptic_bridge::model::catalogue::Kind;
use haptic_bridge::model::description::MAX_SENSED;
use nalgebra::{Matrix3, Rotation3, Vector3};
use std::str::FromStr;

/// Returns the rotation Rz(s₀) Ry(s₁) Rx(s₂) of the angles of the encoders without motors, rad: the handle's
/// orientation on the link that carries the encoders.
pub fn rotation(sensed: &[f32; MAX_SENSED]) -> Matrix3<f64> {
    let [yaw, pitch, roll] = sensed.map(f64::from);
    Rotation3::from_euler_angles(roll, pitch, yaw).into_inner()
}

/// For each of CHAI3D's axes, the index and sign of the task axis; `None` if the device does not move along this axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Axes(pub [Option<(usize, f64)>; 3]);

impl Axes {
    /// Returns the axes of a mechanism in its usual position. A planar device stands upright if `has_weight`, otherwise
    /// lies on the table.
    pub fn of(kind: Kind, has_weight: bool) -> Self {
        let (x, y, z) = (Some((0, 1.0)), Some((1, 1.0)), Some((2, 1.0)));
        let back = |axis: Option<(usize, f64)>| axis.map(|(index, sign)| (index, -sign));
        match kind {
            Kind::Paddle => Self([None, x, None]),
            // The first paddle moves to the right, the second up and the third towards the operator.
            Kind::Paddles2 => Self([None, x, y]),
            Kind::Paddles3 => Self([z, x, y]),
            // The file's own base frame, with as many of its axes as the task has.
            Kind::Chain1 => Self([x, None, None]),
            Kind::Chain2 => Self([x, y, None]),
            Kind::Chain3 => Self([x, y, z]),
            Kind::FiveBar | Kind::Serial3r if has_weight => Self([None, x, y]),
            Kind::FiveBar | Kind::Serial3r => Self([y, back(x), None]),
            // The y axis is vertical, and the arm reaches along x towards the operator.
            Kind::Parallelogram => Self([x, back(z), y]),
            // The motors are on the far side from the operator, and y points to the operator.
            Kind::FiveBarTurret => Self([y, back(x), z]),
            // The motors are on a vertical plate, and the tip is in front of it, as on a Falcon or an omega.
            Kind::Delta => Self([z, x, y]),
        }
    }

    /// Converts a vector from the task frame to CHAI3D's frame.
    pub fn to_chai3d(self, task: [f64; 3]) -> [f64; 3] {
        self.0.map(|axis| axis.map_or(0.0, |(index, sign)| sign * task[index]))
    }
    /// Returns the matrix that turns vectors of the task frame to CHAI3D's frame. Axes that the device lacks complete a
    /// right-handed frame.
    pub fn matrix(self) -> Matrix3<f64> {
        let mut rows = self.0.map(|axis| axis.map(|(index, sign)| sign * Vector3::ith(index, 1.0)));
        let known: Vec<usize> = (0..3).filter(|row| rows[*row].is_some()).collect();
        if let [row] = known[..]
            && let Some((index, _)) = self.0[row]
        {
            rows[(row + 1) % 3] = Some(Vector3::ith((index + 1) % 3, 1.0));
        }
        let [x, y, z] = std::array::from_fn(|row| match (rows[row], rows[(row + 1) % 3], rows[(row + 2) % 3]) {
            (Some(known), ..) => known,
            (None, Some(next), Some(last)) => next.cross(&last),
            _ => Vector3::ith(row, 1.0),
        });
        Matrix3::from_columns(&[x, y, z]).transpose()
    }
    /// Converts a vector from CHAI3D's frame to the task frame. Drops components along axes that the device lacks.
    pub fn to_task(self, chai3d: [f64; 3]) -> [f64; 3] {
        let mut task = [0.0; 3];
        for (axis, value) in self.0.iter().zip(chai3d) {
            if let Some((index, sign)) = axis {
                task[*index] = sign * value;
            }
        }
        task
    }
}

impl FromStr for Axes {
    type Err = String;

    /// Parses the task axes of CHAI3D's x, y and z, such as `y,-x,0`.
    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || {
            format!(
                "`{text}` is not a list of axes: write three of x, y, z, -x, -y, -z and 0, no axis twice, such as y,-x,0"
            )
        };
        let words: Vec<&str> = text.split(',').map(str::trim).collect();
        let [a, b, c] = words[..] else { return Err(wrong()) };
        let mut axes = [None; 3];
        for (axis, word) in axes.iter_mut().zip([a, b, c]) {
            let (sign, name) = word.strip_prefix('-').map_or((1.0, word), |name| (-1.0, name));
            *axis = match name {
                "0" if sign > 0.0 => None,
                "x" => Some((0, sign)),
                "y" => Some((1, sign)),
                "z" => Some((2, sign)),
                _ => return Err(wrong()),
            };
        }
        let mut used: Vec<usize> = axes.iter().flatten().map(|(index, _)| *index).collect();
        used.sort_unstable();
        let count = used.len();
        used.dedup();
        if used.len() == count && count > 0 { Ok(Self(axes)) } else { Err(wrong()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_are_right_handed_and_convert_both_ways() {
        for kind in Kind::ALL {
            for has_weight in [false, true] {
                let axes = Axes::of(*kind, has_weight);
                let entries = kind.spec().task;
                let task: [f64; 3] = std::array::from_fn(|i| if i < entries { 1.0 + i as f64 } else { 0.0 });
                assert_eq!(axes.to_task(axes.to_chai3d(task)), task, "{kind:?}");
                if entries == 3 {
                    let [a, b, c] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|e| axes.to_chai3d(e));
                    let cross = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
                    assert_eq!(cross, c, "{kind:?}");
                }
            }
        }
    }

    #[test]
    fn a_handle_that_turns_about_a_task_axis_turns_about_this_axis_in_chai3d() {
        for kind in Kind::ALL {
            for has_weight in [false, true] {
                let axes = Axes::of(*kind, has_weight);
                assert!((axes.matrix().determinant() - 1.0).abs() < 1e-12, "{kind:?}");
                for (index, angle) in [(0, [0.0, 0.0, 0.3]), (1, [0.0, 0.3, 0.0]), (2, [0.3, 0.0, 0.0])] {
                    let turned = axes.matrix() * rotation(&angle) * axes.matrix().transpose();
                    let axis = Vector3::ith(index, 1.0);
                    assert!((turned * axes.matrix() * axis - axes.matrix() * axis).norm() < 1e-12, "{kind:?}");
                    let trace: f64 = 1.0 + 2.0 * f64::from(0.3_f32).cos();
                    assert!((turned.trace() - trace).abs() < 1e-12, "{kind:?}");
                }
            }
        }
        // Rz(0.1) Ry(0.2) Rx(0.3) of the x axis.
        let x = rotation(&[0.1, 0.2, 0.3]) * Vector3::x();
        let (yaw, pitch) = (f64::from(0.1_f32), f64::from(0.2_f32));
        let expected = Vector3::new(yaw.cos() * pitch.cos(), yaw.sin() * pitch.cos(), -pitch.sin());
        assert!((x - expected).norm() < 1e-12);
    }

    #[test]
    fn axes_are_read_from_text() {
        assert_eq!("y,-x,0".parse(), Ok(Axes([Some((1, 1.0)), Some((0, -1.0)), None])));
        for wrong in ["", "x,y", "x,x,0", "0,0,0", "x,y,q", "x,y,-0", "x,y,z,0"] {
            assert!(wrong.parse::<Axes>().is_err(), "{wrong}");
        }
    }
}
