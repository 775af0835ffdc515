//! What a person at the tip can meet: the largest force and the energy of motion that limits leave a device.

use crate::analysis::pose::{PoseError, TaskPose};
use haptic_bridge::model::description::Description;
use nalgebra::DVector;

/// Force at the tip, N, that the torque limits of a device are set for unless its user says otherwise: a push that a
/// wrist withstands and that a hand can hold.
pub const GENTLE_FORCE: f64 = 5.0;

/// A device at one pose, to ask what its limits leave.
#[derive(Clone, Debug)]
pub struct Tip {
    pose: TaskPose,
}

impl Tip {
    /// Of a device at a pose (rad), by default its home pose; `None` without one. Errors where the pose is singular.
    pub fn at_home(description: &Description) -> Option<Result<Self, PoseError>> {
        let home = description.home.as_ref()?;
        let joints = description.kind.spec().joints;
        let pose = TaskPose::at(description, &home[..joints]).and_then(TaskPose::regular);
        Some(pose.map(|pose| Self { pose }))
    }

    /// The largest force (N) at the tip that joint torques within ±`torque` (N m) make, whatever their signs.
    pub fn force(&self, torque: &[f64]) -> f64 {
        self.worst(torque, |torque| self.pose.inverse.tr_mul(&torque).rows(0, self.pose.task).norm())
    }

    /// The largest energy (J) of motion with joint speeds within ±`speed` (rad/s).
    pub fn energy(&self, speed: &[f64]) -> f64 {
        self.worst(speed, |speed| 0.5 * speed.dot(&(&self.pose.mass * &speed)))
    }

    /// Torque limits (N m), one a joint, under which no torque makes more than `newtons` at the tip: in proportion to
    /// what each joint needs for that force in its own direction.
    pub fn torques_for(&self, newtons: f64) -> Vec<f64> {
        let jacobian = self.pose.jacobian.rows(0, self.pose.task);
        let shares: Vec<f64> = jacobian.column_iter().map(|column| column.norm()).collect();
        let force = self.force(&shares);
        shares.iter().map(|share| share * newtons / force).collect()
    }

    /// The largest `value` over the corners of a box.
    fn worst(&self, half: &[f64], value: impl Fn(DVector<f64>) -> f64) -> f64 {
        let joints = self.pose.mass.nrows();
        let corner = |signs: usize| {
            DVector::from_fn(joints, |i, _| {
                let half = half.get(i).copied().unwrap_or(0.0);
                if signs >> i & 1 == 1 { -half } else { half }
            })
        };
        (0..1 << joints).map(|signs| value(corner(signs))).fold(0.0, f64::max)
    }
}

/// What each motor itself can do, N m at the joint; 0 without one.
pub fn motor_torques(description: &Description) -> Vec<f64> {
    let motors = description.joints.iter().map(|joint| joint.motor);
    motors.map(|motor| motor.map_or(0.0, |motor| (motor.torque_constant * motor.max_current).abs())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device_file::DeviceFile;

    #[test]
    fn no_torque_within_the_limits_for_a_force_makes_more_of_it() {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../devices");
        let files = std::fs::read_dir(folder).expect("devices ship").map(|entry| entry.expect("a file").path());
        let mut tried = 0;
        for path in files.filter(|path| path.extension().is_some_and(|ending| ending == "toml")) {
            let file = DeviceFile::load(&path).expect("shipped files are sound");
            let Some(tip) = Tip::at_home(&file.description) else { continue };
            let tip = tip.expect("home is no singular pose");
            let limits = tip.torques_for(5.0);
            let inverse = &tip.pose.inverse;
            assert_eq!(limits.len(), file.spec().joints);
            let mut most = 0.0_f64;
            // Torques all over the box, not only where the largest is looked for.
            for nth in 0..1000_u32 {
                let share = |i: u32| f64::from((nth / 10_u32.pow(i)) % 10) / 4.5 - 1.0;
                let torque = DVector::from_fn(limits.len(), |i, _| share(i as u32) * limits[i]);
                let force: f64 = (0..tip.pose.task).map(|i| inverse.column(i).dot(&torque).powi(2)).sum::<f64>();
                most = most.max(force.sqrt());
            }
            assert!((4.999..5.001).contains(&most), "{}: {most} N", path.display());
            tried += 1;
        }
        assert!(tried >= 3, "{tried} devices with a home pose");
    }
}
