//! The outline of a wall in a drawing of the xy plane, for every shape.

use crate::track::Track;
use haptic_bridge::render::scene::{Plane, Surface};
use serde::{Deserialize, Serialize};

/// Sine of the largest angle at which a direction counts as parallel to the drawing plane or to its normal.
const ALIGNED_SINE: f64 = 1e-3;

/// The intersection of a wall's surface with the drawing plane.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "is", rename_all = "kebab-case")]
pub enum Outline {
    /// An infinite straight line.
    Line {
        /// A point on the line, m.
        at: [f64; 2],
        /// Direction out of the solid.
        normal: [f64; 2],
    },
    /// A circle.
    Circle {
        /// Centre, m.
        at: [f64; 2],
        /// Radius, m.
        radius: f64,
        /// True if the tip moves inside and the solid is around it.
        inside: bool,
    },
}

/// Returns the outline of a surface; `None` if the outline is neither a line nor a circle, for example of an oblique
/// cylinder or of a plane parallel to the drawing. Callers must report that no outline is drawn.
pub fn outline(surface: &Surface<f64>) -> Option<Outline> {
    let flat = |point: [f64; 3]| [point[0], point[1]];
    match surface {
        Surface::Plane(plane) => {
            let normal = flat(plane.normal);
            (normal[0].hypot(normal[1]) > ALIGNED_SINE).then(|| Outline::Line { at: flat(plane.point), normal })
        }
        Surface::Sphere(ball) => {
            Some(Outline::Circle { at: flat(ball.center), radius: ball.radius, inside: ball.inside })
        }
        Surface::Cylinder(rod) => (rod.axis[0].hypot(rod.axis[1]) < ALIGNED_SINE).then(|| Outline::Circle {
            at: flat(rod.point),
            radius: rod.radius,
            inside: rod.inside,
        }),
    }
}

/// Returns the track that a wall across a single task coordinate lies on, and the wall's line across it. A wall between
/// several paddles has none.
pub fn outline_on_track(surface: &Surface<f64>, tracks: &[Track]) -> Option<(usize, Outline)> {
    let Surface::Plane(Plane { point, normal }) = surface else { return None };
    let (index, track) = tracks.iter().enumerate().find(|(index, _)| normal[*index].abs() > 1.0 - ALIGNED_SINE)?;
    let direction = track.direction(point[index]);
    let normal = direction.map(|entry| normal[index].signum() * entry);
    Some((index, Outline::Line { at: track.place(point[index]), normal }))
}

impl Outline {
    /// Returns a point on the line, or the centre of the circle, m.
    pub fn at(&self) -> [f64; 2] {
        match self {
            Self::Line { at, .. } | Self::Circle { at, .. } => *at,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use haptic_bridge::render::scene::{Cylinder, Sphere};

    #[test]
    fn oblique_cylinders_and_facing_planes_have_no_outline() {
        let point = [0.1, 0.2, 0.3];
        let plane = |normal| outline(&Surface::Plane(Plane { point, normal }));
        let rod = |axis| outline(&Surface::Cylinder(Cylinder { point, axis, radius: 0.05, inside: true }));
        let circle = |radius, inside| Some(Outline::Circle { at: [0.1, 0.2], radius, inside });
        assert_eq!(plane([0.6, 0.8, 0.0]), Some(Outline::Line { at: [0.1, 0.2], normal: [0.6, 0.8] }));
        assert_eq!(plane([0.0, 0.0, 1.0]), None);
        assert_eq!(rod([0.0, 0.0, 1.0]), circle(0.05, true));
        assert_eq!(rod([1.0, 0.0, 0.0]), None);
        let ball = Sphere { center: point, radius: 0.02, inside: false };
        assert_eq!(outline(&Surface::Sphere(ball)), circle(0.02, false));
    }
}
