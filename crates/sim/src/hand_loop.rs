//! The path of the hand of `haptic sim --hand loop`: a circle on a wall that the hand can reach, otherwise a circle at
//! its present position.

use super::{Intent, Waypoint};
use haptic_bridge::math::Libm;
use haptic_bridge::model::mechanism::Mechanism;
use haptic_bridge::render::scene::{Scene, Surface};
use haptic_bridge::with_mechanism;
use haptic_host::device_file::DeviceFile;
use nalgebra::{DMatrix, DVector, SVector, Vector3};

/// Half of the length and of the width of the loop, m.
const HALF_SIZE_M: f64 = 0.015;
/// Largest condition number of the Jacobian on the path, because a board may trip closer to a singular pose.
const MAX_CONDITION: f64 = 30.0;
/// Largest distance of a path's end from the goal, m.
const MAX_GOAL_ERROR_M: f64 = 1e-5;

/// An endless loop, 3 cm across, that takes 4 s per round.
#[derive(Clone, Debug, PartialEq)]
pub struct HandLoop {
    /// The tip's position at home, m, where the hand waits while the motors are off.
    rest: [f64; 3],
    /// Centre of the loop, m.
    pub centre: Vector3<f64>,
    /// Unit normal of the wall.
    normal: Vector3<f64>,
    /// Unit vector along the wall.
    tangent: Vector3<f64>,
    /// True if the circle goes through the surface of a wall.
    pub on_a_wall: bool,
}

impl HandLoop {
    /// Finds a loop in the scene for a tip that starts at the device's home.
    pub fn find(file: &DeviceFile, scene: Option<&Scene<f64>>, tip: [f64; 3]) -> Self {
        let rest = tip;
        let tip = Vector3::from(tip);
        let walls = scene.into_iter().flat_map(|scene| &scene.walls);
        let mut places = walls.flat_map(|wall| {
            let contact = wall.surface.contact::<Libm, 3>(&tip);
            let nearest = tip - contact.normal * contact.distance;
            let own_point = match &wall.surface {
                Surface::Plane(plane) => Vector3::from(plane.point),
                _ => nearest,
            };
            [nearest, own_point].map(|centre| Self {
                rest,
                centre,
                normal: contact.normal,
                tangent: Vector3::new(-contact.normal.y, contact.normal.x, 0.0),
                on_a_wall: true,
            })
        });
        places.find(|place| place.is_within_reach(file)).unwrap_or(Self {
            rest,
            centre: tip + Vector3::y() * HALF_SIZE_M,
            normal: Vector3::y(),
            tangent: Vector3::x(),
            on_a_wall: false,
        })
    }

    fn corners(&self) -> [Vector3<f64>; 4] {
        [self.tangent, -self.normal, -self.tangent, self.normal].map(|direction| self.centre + direction * HALF_SIZE_M)
    }
    fn is_within_reach(&self, file: &DeviceFile) -> bool {
        self.corners().iter().all(|corner| is_within_reach(file, corner))
    }
    /// Returns the intent of the hand while the motors are off: to stay at home, outside the walls.
    pub fn wait(&self) -> Intent {
        Intent::Lead(self.rest)
    }
    /// Returns the path of the hand, which starts at home and lasts an hour.
    pub fn intent(&self) -> Intent {
        let corners = self.corners().map(Into::into);
        let places = std::iter::once(self.rest).chain(corners.into_iter().cycle());
        let points = (0..3600).zip(places).map(|(second, value)| Waypoint { time: f64::from(second), value });
        Intent::Follow(points.collect())
    }
}

/// Returns true if the straight path from home to `goal` avoids singular poses and joint limits.
fn is_within_reach(file: &DeviceFile, goal: &Vector3<f64>) -> bool {
    const STEPS: u32 = 20;
    let Some(home) = file.description.home else { return false };
    let count = file.spec().joints;
    let mut q = DVector::from_column_slice(&home[..count]);
    let at = |q: &DVector<f64>| with_mechanism!(&file.mechanism, m => tip_and_jacobian(m, q));
    let (start, _) = at(&q);
    let goal = DVector::from_column_slice(&goal.as_slice()[..start.len()]);
    (1..=STEPS).all(|step| {
        let target = &start + (&goal - &start) * (f64::from(step) / f64::from(STEPS));
        // Newton's method converges within a few iterations, because each step is a twentieth of the path.
        (0..8).any(|_| {
            let (tip, jacobian) = at(&q);
            let stretch = jacobian.singular_values();
            // NaN, which links that cannot close produce, gives false too.
            let regular = stretch.max() <= MAX_CONDITION * stretch.min();
            if !regular {
                return false;
            }
            let error = &target - tip;
            if error.norm() < MAX_GOAL_ERROR_M {
                let limits = file.description.joints.iter().map(|joint| joint.limits);
                return q
                    .iter()
                    .zip(limits)
                    .all(|(q, limits)| limits.is_none_or(|(low, high)| (low..=high).contains(q)));
            }
            match jacobian.pseudo_inverse(1e-9) {
                Ok(inverse) => q += inverse * error,
                Err(_) => return false,
            }
            false
        })
    })
}

/// Returns the tip, m, and its Jacobian, m/rad.
fn tip_and_jacobian<M: Mechanism<f64, N>, const N: usize>(m: &M, q: &DVector<f64>) -> (DVector<f64>, DMatrix<f64>) {
    let task = M::SPEC.task;
    let pose = m.pose::<Libm>(&SVector::from_fn(|i, _| q[i]));
    let (tip, jacobian) = (m.tip(&pose), m.jacobian(&pose));
    (DVector::from_fn(task, |i, _| tip[i]), DMatrix::from_fn(task, N, |i, j| jacobian[(i, j)]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use haptic_host::scene_file::SceneFile;
    use std::fs;
    use std::path::Path;

    /// Checks every shipped scene on its device.
    #[test]
    fn the_hand_reaches_a_wall_of_every_shipped_scene() {
        let devices = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../devices");
        let mut tried = 0;
        for folder in fs::read_dir(devices.join("scenes")).unwrap().map(|entry| entry.unwrap().path()) {
            let name = folder.file_name().unwrap().to_string_lossy().into_owned();
            let file = DeviceFile::load(devices.join(name + ".toml")).unwrap();
            let home = file.description.home.unwrap();
            let count = file.spec().joints;
            let q = DVector::from_column_slice(&home[..count]);
            let (place, _) = with_mechanism!(&file.mechanism, m => tip_and_jacobian(m, &q));
            let mut tip = [0.0; 3];
            tip[..place.len()].copy_from_slice(place.as_slice());
            for path in fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()) {
                let scene = SceneFile::load(&path, file.spec().task).unwrap().scene::<f64>().unwrap();
                if scene.walls.is_empty() {
                    continue;
                }
                let hand_loop = HandLoop::find(&file, Some(&scene), tip);
                assert!(hand_loop.on_a_wall, "{}", path.display());
                let corners = hand_loop.corners();
                let inside = |surface: &Surface<f64>| {
                    corners.iter().any(|corner| surface.contact::<Libm, 3>(corner).distance < -0.01)
                };
                assert!(scene.walls.iter().any(|wall| inside(&wall.surface)), "{}", path.display());
                tried += 1;
            }
        }
        assert!(tried > 10, "{tried}");
    }

    #[test]
    fn a_goal_outside_the_workspace_is_out_of_reach() {
        let file = DeviceFile::parse(super::super::SHIPPED_DEVICE, "coupled-five-bar.toml").unwrap();
        assert!(is_within_reach(&file, &Vector3::new(-0.1, 0.18, 0.0)));
        // Each arm is 23 cm long and cannot reach this point.
        assert!(!is_within_reach(&file, &Vector3::new(-0.0962, 0.2144, 0.0)));
    }
}
