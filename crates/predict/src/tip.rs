//! Hazards for a person at the tip: the largest force and kinetic energy that a device's limits allow.

use crate::boards::torque_at_rest;
use crate::plausible::device::weight;
use haptic_bridge::drive::brushed::hidden_by_speed;
use haptic_bridge::model::description::Description;
use haptic_bridge::model::device::Device;
use haptic_bridge::model::motor::Motor;
use haptic_bridge::model::units::JointUnits;
use haptic_stability::analysis::pose::{PoseError, TaskPose};
use nalgebra::DVector;

/// A device at a pose for the computation of hazards.
#[derive(Clone, Debug)]
pub struct Tip {
    pose: TaskPose,
    /// Joint torques that carry the device's weight at the pose, N m.
    weight: Vec<f64>,
}

impl Tip {
    /// Returns the device at home, or `None` if the description has no home. Rejects a singular home.
    pub fn at_home(description: &Description) -> Option<Result<Self, PoseError>> {
        let home = description.home.as_ref()?;
        let joints = description.kind.spec().joints;
        let pose = TaskPose::at(description, &home[..joints]).and_then(TaskPose::regular);
        let weight = Device::<f64>::new("", description).map_or(Vec::new(), |device| weight(&device, &home[..joints]));
        Some(pose.map(|pose| Self { pose, weight }))
    }

    /// Returns the largest tip force for joint torques within ±`torque` (N m, of slides N), N.
    pub fn force(&self, torque: &[f64]) -> f64 {
        self.largest_at_corners(torque, |torque| self.pose.inverse.tr_mul(&torque).rows(0, self.pose.task).norm())
    }

    /// Returns the largest kinetic energy for joint speeds within ±`speed` (rad/s, of slides m/s), J.
    pub fn energy(&self, speed: &[f64]) -> f64 {
        self.largest_at_corners(speed, |speed| 0.5 * speed.dot(&(&self.pose.mass * &speed)))
    }

    /// Returns torque limits that bound the tip force to `newtons`, N m per joint, in proportion to the torque
    /// that each joint needs for this force in its own direction.
    pub fn torques_for(&self, newtons: f64) -> Vec<f64> {
        let jacobian = self.pose.jacobian.rows(0, self.pose.task);
        let shares: Vec<f64> = jacobian.column_iter().map(|column| column.norm()).collect();
        let force = self.force(&shares);
        shares.iter().map(|share| share * newtons / force).collect()
    }

    /// Returns [`Tip::torques_for`] plus the torques that carry the device's weight, N m.
    pub fn limits_for(&self, newtons: f64) -> Vec<f64> {
        self.torques_for(newtons).iter().zip(&self.weight).map(|(torque, weight)| torque + weight.abs()).collect()
    }

    /// Returns the largest `value` over the corners of the box with these half sides.
    fn largest_at_corners(&self, half: &[f64], value: impl Fn(DVector<f64>) -> f64) -> f64 {
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

/// Default limit of joint speed in the boards' firmware, rad/s.
pub const BOARD_SPEED: f64 = 100.0;

/// Returns the default limit of each joint's speed in the boards' firmware, rad/s, of a slide m/s.
pub fn board_speeds(description: &Description) -> Vec<f64> {
    // Six digits remove the lever's rounding to single precision.
    let speed = |units: &&JointUnits| (1e6 * BOARD_SPEED * f64::from(units.lever)).round() / 1e6;
    description.units().iter().map(speed).collect()
}

/// Returns the largest torque of each motor at rest, N m at the joint; 0 for a joint without a motor.
pub fn motor_torques(description: &Description) -> Vec<f64> {
    let joints = description.kind.spec().joints;
    description.joints.iter().map(|joint| joint.motor.map_or(0.0, |motor| torque_at_rest(&motor, joints))).collect()
}

/// Returns the torque per speed that a wrong current sensor may hide in addition to the torque at rest, N m s/rad.
pub fn torques_hidden_by_speed(description: &Description) -> Vec<f64> {
    let torque = |motor: Motor<f64>| (motor.torque_constant * hidden_by_speed(&motor)).abs();
    description.joints.iter().map(|joint| joint.motor.map_or(0.0, torque)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::boards::BoardKind;
    use haptic_host::device_file::DeviceFile;

    /// Returns the shipped devices with a home pose, with the names of their files.
    fn shipped_devices() -> Vec<(String, DeviceFile, Tip)> {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../devices");
        let files = std::fs::read_dir(folder).expect("devices ship").map(|entry| entry.expect("a file").path());
        let mut paths: Vec<_> = files.filter(|path| path.extension().is_some_and(|ending| ending == "toml")).collect();
        paths.sort();
        let devices = paths.into_iter().filter_map(|path| {
            let file = DeviceFile::load(&path).expect("shipped files are sound");
            let tip = Tip::at_home(&file.description)?.expect("home is no singular pose");
            Some((path.file_stem()?.to_string_lossy().into_owned(), file, tip))
        });
        devices.collect()
    }

    #[test]
    fn documented_tip_hazards_match_the_computed_ones() {
        use std::fmt::Write as _;
        let gentle = f64::from(haptic_bridge::safety::limits::GENTLE_FORCE);
        let mut table = String::from(
            "device,rendered (N),torque limits (N m; slides N),any torque within them (N),motors alone (N),\
             an ampere in every motor (N),energy (J)\n",
        );
        for (name, file, tip) in shipped_devices() {
            let limits = tip.torques_for(gentle);
            let listed: Vec<String> = limits.iter().map(|torque| format!("{torque:.3}")).collect();
            let motors = match motor_torques(&file.description) {
                motors if motors.iter().any(|torque| *torque > 0.0) => format!("{:.1}", tip.force(&motors)),
                _ => "no motors in the file".into(),
            };
            let most = tip.force(&limits);
            let energy = tip.energy(&board_speeds(&file.description));
            let limits = listed.join(" ");
            let ampere = file.description.joints.map(|joint| joint.motor.map_or(0.0, |motor| motor.torque_constant));
            let ampere = tip.force(&ampere);
            writeln!(table, "{name},{gentle},{limits},{most:.1},{motors},{ampere:.1},{energy:.2}").expect("it fits");
        }
        for (kind, board) in [
            (BoardKind::OdriveV3, include_str!("../../../firmware/src/board/odrive_v3.rs")),
            (BoardKind::HBridgeF405, include_str!("../../../firmware/src/board/h_bridges.rs")),
        ] {
            assert!(board.contains(&format!("    speed: [{BOARD_SPEED:.1}; 3],")), "boards start with another speed");
            assert!(board.contains(&format!("    current: [{:.1}; 3],", kind.max_current())), "{kind:?}");
        }
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/results/tips.csv");
        if std::env::var_os("UPDATE_DOCS").is_some() {
            std::fs::write(&path, table).expect("docs/results/tips.csv can be written");
        } else {
            let committed = std::fs::read_to_string(&path).expect("docs/results/tips.csv is there");
            assert_eq!(committed, table, "run UPDATE_DOCS=1 cargo test -p haptic-predict --lib tip::");
        }
    }

    #[test]
    fn torque_limits_for_a_force_bound_the_tip_force() {
        let mut checked = 0;
        for (name, file, tip) in shipped_devices() {
            let limits = tip.torques_for(5.0);
            let inverse = &tip.pose.inverse;
            assert_eq!(limits.len(), file.spec().joints);
            let mut most = 0.0_f64;
            // Checks torques throughout the box, not only at its corners.
            for nth in 0..1000_u32 {
                let share = |i: u32| f64::from((nth / 10_u32.pow(i)) % 10) / 4.5 - 1.0;
                let torque = DVector::from_fn(limits.len(), |i, _| share(i as u32) * limits[i]);
                let force: f64 = (0..tip.pose.task).map(|i| inverse.column(i).dot(&torque).powi(2)).sum::<f64>();
                most = most.max(force.sqrt());
            }
            assert!((4.999..5.001).contains(&most), "{name}: {most} N");
            checked += 1;
        }
        assert!(checked >= 3, "{checked} devices with a home pose");
    }
}
