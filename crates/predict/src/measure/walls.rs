//! Walls in a measurement's scene: the tested walls, two that pull the tip aside, and one per direction across the
//! pull. Between trials a single tested wall also holds the tip; several tested walls need an additional wall.

use super::{MeasureError, MeasurementSetup};
use haptic_bridge::render::scene::{FeedForward, MAX_WALLS, Plane, Posture, Scene, Surface, VelocityTerms, Wall};
use haptic_host::vectors::padded;
use haptic_stability::analysis::pose::unit_normal;
use nalgebra::DVector;

/// Distance from the wall that holds the tip to each wall that pulls the tip aside, m; longer than every pull.
pub const ASIDE_DISTANCE: f64 = 0.01;
/// Longest pull, m.
pub const LONGEST_PULL: f64 = 0.5 * ASIDE_DISTANCE;

/// Indices of the walls that hold the tip, which follow the tested walls. A single tested wall also holds the tip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Layout {
    /// Wall at the position of the tip, normal to the pulls.
    pub hold: u8,
    /// Walls at +[`ASIDE_DISTANCE`] and -[`ASIDE_DISTANCE`] from the tip's position.
    pub aside: [u8; 2],
    /// First wall of the directions across the pull.
    pub across: u8,
}

impl Layout {
    fn new(tested: usize) -> Self {
        let hold = if tested == 1 { 0 } else { tested as u8 };
        Self { hold, aside: [hold + 1, hold + 2], across: hold + 3 }
    }
}

/// Returns the maximum number of walls that can be tested together: the walls of a scene minus the holding walls.
#[must_use]
pub fn max_tested_walls(task: usize) -> usize {
    MAX_WALLS - 2 - task
}

/// Returns unit vectors perpendicular to a normal and to each other.
pub fn complement(normal: &DVector<f64>) -> Vec<DVector<f64>> {
    match normal.len() {
        2 => vec![DVector::from_vec(vec![-normal[1], normal[0]])],
        3 => {
            let k = normal.iamin();
            let mut first = DVector::zeros(3);
            first[k] = 1.0;
            first -= normal * normal[k];
            first.normalize_mut();
            let second = normal.cross(&first);
            vec![first, second]
        }
        _ => Vec::new(),
    }
}

/// Returns true if a measurement made this scene: bilateral planes, two at ±[`ASIDE_DISTANCE`] from another.
#[must_use]
pub fn is_measurement(scene: &Scene<f32>) -> bool {
    let plane = |wall: &Wall<f32>| match wall.surface {
        Surface::Plane(plane) if wall.bilateral => Some(plane),
        _ => None,
    };
    let Some(planes) = scene.walls.iter().map(plane).collect::<Option<Vec<_>>>() else { return false };
    let apart = |aside: &Plane<f32>, by: f64| {
        (0..3).all(|k| {
            let expected = f64::from(planes[0].point[k]) + by * f64::from(aside.normal[k]);
            (f64::from(aside.point[k]) - expected).abs() < 1e-6
        })
    };
    scene.springs.is_empty()
        && scene.field_damping == 0.0
        && planes.windows(2).any(|pair| {
            pair[0].normal == pair[1].normal && apart(&pair[0], ASIDE_DISTANCE) && apart(&pair[1], -ASIDE_DISTANCE)
        })
}

/// Returns the scene of a measurement at `q` (rad), for pulls along `direction`, with all gains 0.
pub fn scene(
    setup: &MeasurementSetup,
    q: &[f64],
    tip: &DVector<f64>,
    direction: &DVector<f64>,
    across: &[DVector<f64>],
) -> Result<(Layout, Scene<f32>), MeasureError> {
    let mut scene = Scene {
        task: tip.len() as u8,
        rate_hz: setup.rate_hz as f32,
        cutoff_hz: setup.cutoff_hz as f32,
        velocity_terms: VelocityTerms::Off,
        estimator: setup.law.estimator,
        admissible: setup.law.admissible,
        posture: setup.law.posture.map(|held| Posture {
            orientation: q.iter().sum::<f64>() as f32,
            stiffness: held.stiffness as f32,
            damping: held.damping as f32,
        }),
        ..Scene::default()
    };
    let layout = Layout::new(setup.walls.len());
    let mut places: Vec<(DVector<f64>, DVector<f64>)> = Vec::new();
    for wall in &setup.walls {
        places.push((tip.clone(), unit_normal(&wall.normal, tip.len(), tip.len())?));
    }
    if layout.hold > 0 {
        places.push((tip.clone(), direction.clone()));
    }
    places.extend([ASIDE_DISTANCE, -ASIDE_DISTANCE].map(|apart| (tip + direction * apart, direction.clone())));
    places.extend(across.iter().map(|other| (tip.clone(), other.clone())));
    let single = |v: &DVector<f64>| padded::<3>(v.as_slice()).map(|v| v as f32);
    for (point, normal) in &places {
        let wall = Wall {
            surface: Surface::Plane(Plane { point: single(point), normal: single(normal) }),
            stiffness: 0.0,
            damping: 0.0,
            feed_forward: FeedForward::Off,
            washout_hz: setup.washout_hz as f32,
            damping_compensation: setup.law.damping_compensation,
            bilateral: true,
        };
        scene.walls.push(wall).map_err(|_| {
            let most = max_tested_walls(tip.len());
            MeasureError::Scene(format!(
                "{} walls cannot be measured at once: this device allows at most {most}",
                setup.walls.len()
            ))
        })?;
    }
    Ok((layout, scene))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measure::Law;
    use haptic_stability::analysis::several::Member;

    #[test]
    fn scenes_of_measurements_are_recognised() {
        for normals in [vec![vec![0.6, 0.8]], vec![vec![1.0, 0.0], vec![0.3, -0.9]], vec![vec![0.1, 0.2, 0.9]]] {
            let walls: Vec<_> = normals.into_iter().map(|normal| Member::new(normal, 1.0)).collect();
            let tip = DVector::from_fn(walls[0].normal.len(), |i, _| 0.07 - 0.1 * i as f64);
            let setup = MeasurementSetup {
                rate_hz: 1_000.0,
                cutoff_hz: 20.0,
                washout_hz: 2.0,
                law: Law::default(),
                torque_limit: 1.0,
                largest_pull: 2e-3,
                walls: walls.clone(),
            };
            let direction = unit_normal(&walls[0].normal, tip.len(), tip.len()).unwrap();
            let (_, mut own) = scene(&setup, &[], &tip, &direction, &complement(&direction)).unwrap();
            own.walls[0].stiffness = 300.0;
            assert!(is_measurement(&own));
            own.walls[0].bilateral = false;
            assert!(!is_measurement(&own));
        }
        assert!(!is_measurement(&Scene::default()));
    }
}
