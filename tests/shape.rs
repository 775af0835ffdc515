//! A toy wall shape, defined in one impl, and the functions that follow from a shape's list of keys.

use haptic_bridge::math::{Libm, Math, Real};
use haptic_bridge::render::scene::shape::{Meaning, Shape, ShapeSpec, Values};
use haptic_bridge::render::scene::{Contact, Cylinder, Plane, Sphere, Surface};
use nalgebra::{SVector, Vector3};

/// A slab: all points within half the thickness from a plane.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Slab<T> {
    middle: [T; 3],
    normal: [T; 3],
    thickness: T,
}

impl<T: Real> Shape<T> for Slab<T> {
    const SPEC: ShapeSpec = ShapeSpec {
        name: "slab",
        least_task: 1,
        keys: &[("point", Meaning::Point), ("normal", Meaning::Direction), ("thickness", Meaning::Length)],
    };

    fn from_values([a, b, c, x, y, z, thickness, _]: &Values<T>) -> Self {
        Self { middle: [*a, *b, *c], normal: [*x, *y, *z], thickness: *thickness }
    }

    fn values(&self) -> Values<T> {
        let ([a, b, c], [x, y, z]) = (self.middle, self.normal);
        [a, b, c, x, y, z, self.thickness, T::zero()]
    }

    fn contact<K: Math<T>, const N: usize>(&self, p: &SVector<T, N>) -> Contact<T, N> {
        let normal = SVector::from_fn(|i, _| self.normal[i]);
        let height = (0..N).fold(T::zero(), |sum, i| sum + self.normal[i] * (p[i] - self.middle[i]));
        let side = if height < T::zero() { -T::one() } else { T::one() };
        Contact { distance: height.abs() - self.thickness * T::from_f64(0.5), normal: normal * side }
    }

    fn normal_rate<K: Math<T>, const N: usize>(&self, _: &SVector<T, N>, _: &SVector<T, N>) -> SVector<T, N> {
        SVector::zeros()
    }
}

#[test]
fn a_toy_shape_is_one_impl() {
    let slab = Slab { middle: [0.0, 0.0, 0.1], normal: [0.0, 0.0, 1.0], thickness: 0.02 };
    assert_eq!(Slab::from_values(&slab.values()), slab);
    for (height, distance, up) in [(0.15, 0.04, 1.0), (0.05, 0.04, -1.0), (0.105, -0.005, 1.0)] {
        let contact = slab.contact::<Libm, 3>(&Vector3::new(1.0, 2.0, height));
        assert!((contact.distance - distance).abs() < 1e-15, "{contact:?}");
        assert_eq!(contact.normal, Vector3::new(0.0, 0.0, up));
    }
}

#[test]
fn every_shape_is_made_from_its_name_and_values() {
    let shapes = [
        Surface::Plane(Plane { point: [0.5, -0.25, 0.125], normal: [0.0, 1.0, 0.0] }),
        Surface::Sphere(Sphere { center: [0.5, -0.25, 0.125], radius: 0.0625, inside: true }),
        Surface::Cylinder(Cylinder {
            point: [0.5, -0.25, 0.125],
            axis: [1.0, 0.0, 0.0],
            radius: 0.0625,
            inside: false,
        }),
    ];
    assert_eq!(shapes.len(), Surface::<f64>::SPECS.len());
    for shape in shapes {
        let spec = shape.spec();
        assert_eq!(Surface::from_values(spec.name, &shape.values()), Some(shape));
        let width: usize = spec.keys.iter().map(|(_, meaning)| meaning.width()).sum();
        assert!(shape.values()[width..].iter().all(|value| *value == 0.0), "{}: a value without a key", spec.name);
        // These numbers are exact in f32.
        assert_eq!(shape.cast::<f32>().cast::<f64>(), shape);
    }
    assert_eq!(Surface::<f64>::from_values("slab", &[0.0; 8]), None);
}
