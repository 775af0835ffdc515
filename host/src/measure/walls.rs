//! The walls of a measurement's scene: the one that is tested, two beside it that pull the tip aside, and one across the
//! normal for every other direction.

use haptic_bridge::render::scene::{FeedForward, Plane, Scene, Surface, VelocityTerms, Wall};
use nalgebra::DVector;

use super::{MeasureError, Setup};

/// Distance between the tested wall and the one that pulls aside, m: more than any pull.
pub const APART: f64 = 0.01;

/// Walls of the scene: the tested one, the two that pull aside (at +[`APART`] and -[`APART`]), then those across.
pub const TESTED: u8 = 0;
pub const ASIDE: [u8; 2] = [1, 2];
pub const ACROSS: u8 = 3;

/// Unit vectors across a normal.
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

/// The scene of a measurement, its walls without gains yet.
pub fn scene(
    setup: &Setup,
    tip: &DVector<f64>,
    normal: &DVector<f64>,
    across: &[DVector<f64>],
) -> Result<Scene<f32>, MeasureError> {
    let mut scene = Scene {
        task: tip.len() as u8,
        rate_hz: setup.rate_hz as f32,
        cutoff_hz: setup.cutoff_hz as f32,
        velocity_terms: VelocityTerms::Off,
        ..Scene::default()
    };
    let padded = |v: &DVector<f64>| -> [f32; 3] { core::array::from_fn(|i| v.get(i).map_or(0.0, |v| *v as f32)) };
    let aside = [tip + normal * APART, tip - normal * APART];
    let places = std::iter::once((tip, normal))
        .chain(aside.iter().map(|point| (point, normal)))
        .chain(across.iter().map(|direction| (tip, direction)));
    for (point, direction) in places {
        let wall = Wall {
            surface: Surface::Plane(Plane { point: padded(point), normal: padded(direction) }),
            stiffness: 0.0,
            damping: 0.0,
            feed_forward: FeedForward::Off,
            washout_hz: setup.washout_hz as f32,
            damping_compensation: false,
            bilateral: true,
        };
        scene.walls.push(wall).map_err(|_| MeasureError::Scene("too many walls".into()))?;
    }
    Ok(scene)
}
