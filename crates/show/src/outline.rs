//! The outline of a wall in a drawing of the plane of x and y: the one place that knows it for every shape, used by the
//! page and by the terminal.

use haptic_bridge::render::scene::Surface;
use serde::{Deserialize, Serialize};

/// A direction this close to square on the plane, or along it, is so: its sine.
const SQUARE_SINE: f64 = 1e-3;

/// The section of a wall's surface.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "is", rename_all = "kebab-case")]
pub enum Outline {
    /// A straight line without ends.
    Line {
        /// A point of it, m.
        at: [f64; 2],
        /// Out of the solid.
        normal: [f64; 2],
    },
    /// A circle.
    Circle {
        /// Its centre, m.
        at: [f64; 2],
        /// m
        radius: f64,
        /// The tip moves inside; the solid is around it.
        inside: bool,
    },
}

/// The outline of a surface; `None` if that is neither a line nor a circle, as of an oblique cylinder or of a plane
/// seen face on: callers have to say so.
pub fn outline(surface: &Surface<f64>) -> Option<Outline> {
    let flat = |point: [f64; 3]| [point[0], point[1]];
    match surface {
        Surface::Plane(plane) => {
            let normal = flat(plane.normal);
            (normal[0].hypot(normal[1]) > SQUARE_SINE).then(|| Outline::Line { at: flat(plane.point), normal })
        }
        Surface::Sphere(ball) => {
            Some(Outline::Circle { at: flat(ball.center), radius: ball.radius, inside: ball.inside })
        }
        Surface::Cylinder(rod) => (rod.axis[0].hypot(rod.axis[1]) < SQUARE_SINE).then(|| Outline::Circle {
            at: flat(rod.point),
            radius: rod.radius,
            inside: rod.inside,
        }),
    }
}

/// The same for a device whose task is the length of an arc with this radius (m) about the origin: a wall across the arc.
pub fn on_an_arc(surface: &Surface<f64>, radius: f64) -> Option<Outline> {
    let Surface::Plane(plane) = surface else { return None };
    let (sin, cos) = (plane.point[0] / radius).sin_cos();
    let side = plane.normal[0].signum();
    Some(Outline::Line { at: [radius * cos, radius * sin], normal: [-side * sin, side * cos] })
}

impl Outline {
    /// A point of it, or its centre, m.
    pub fn at(&self) -> [f64; 2] {
        match self {
            Self::Line { at, .. } | Self::Circle { at, .. } => *at,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use haptic_bridge::render::scene::{Cylinder, Plane, Sphere};

    #[test]
    fn what_is_neither_line_nor_circle_has_no_outline() {
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
