//! The mechanics of rigid bodies from first principles.
//!
//! Every link is placed in space (centre of mass, principal axes) directly from the section on mechanisms in
//! docs/model.md, with its distal angle. Velocities are differences of placements, the mass matrix is Σ m JvᵀJv +
//! JωᵀIJω, and gravity's torques are the gradient of the potential energy. The code shares no algebra with the library,
//! because no term is lumped or in closed form.

use haptic_bridge::model::catalogue::Kind;
use haptic_bridge::model::description::Description;
use nalgebra::{Matrix3, Rotation3, Vector2, Vector3};

/// A rigid body: mass, position of the centre of mass, axes (columns), and the inertia tensor along these axes.
#[derive(Clone, Copy, Debug)]
pub struct Body {
    mass: f64,
    com: Vector3<f64>,
    axes: Matrix3<f64>,
    inertia: Matrix3<f64>,
}

fn point_mass(mass: f64, com: Vector3<f64>) -> Body {
    Body { mass, com, axes: Matrix3::identity(), inertia: Matrix3::zeros() }
}

/// Returns the links of a chain, the handle, and the position of the tip along the task's coordinates.
fn place_chain(device: &Description, q: &[f64]) -> (Vec<Body>, Vector3<f64>) {
    let (mut frame, mut origin, mut bodies) = (Matrix3::identity(), Vector3::zeros(), Vec::new());
    for ((joint, link), q) in device.joints.iter().zip(&device.links).zip(q) {
        origin += frame * Vector3::from(joint.frame.origin);
        let [roll, pitch, yaw] = joint.frame.rpy;
        frame *= Rotation3::from_euler_angles(roll, pitch, yaw).matrix();
        let axis = Vector3::from(joint.frame.axis).normalize();
        if joint.prismatic {
            origin += frame * axis * *q;
        } else {
            frame *= Rotation3::new(axis * *q).matrix();
        }
        let com = origin + frame * Vector3::from(link.com_vector());
        bodies.push(Body { mass: link.mass, com, axes: frame, inertia: link.tensor() });
    }
    let tip = Vector3::new(device.geometry[0], device.geometry[1], device.geometry[2]);
    let place = origin + frame * tip;
    bodies.push(point_mass(device.handle_mass, place));
    let mut task = Vector3::zeros();
    for (entry, coordinate) in task.iter_mut().zip(&device.geometry[3..]).take(q.len()) {
        *entry = place[*coordinate as usize];
    }
    (bodies, task)
}

/// Returns the arms, rods and platform of a delta, and its tip.
fn place_delta(device: &Description, q: &[f64]) -> (Vec<Body>, Vector3<f64>) {
    let [base, platform, upper, fore, azimuths @ .., assembly] = device.geometry;
    let [arm, rod, end, ..] = device.links;
    let up = Vector3::z();
    let outward = azimuths.map(|azimuth| Vector3::new(azimuth.cos(), azimuth.sin(), 0.0));
    let direction = |i: usize| outward[i] * q[i].cos() + up * q[i].sin();
    let elbow = |i: usize| outward[i] * base + direction(i) * upper;
    // The tip is at the distance of a rod from three points: trilateration in the frame of the triangle.
    let [c0, c1, c2] = [0, 1, 2].map(|i| elbow(i) - outward[i] * platform);
    let (side1, side2) = (c1 - c0, c2 - c0);
    let x_axis = side1.normalize();
    let y_axis = (side2 - x_axis * x_axis.dot(&side2)).normalize();
    let x = side1.norm() / 2.0;
    let y = (side2.norm_squared() / 2.0 - x * x_axis.dot(&side2)) / y_axis.dot(&side2);
    let z = assembly * (fore * fore - x * x - y * y).sqrt();
    let tip = c0 + x_axis * x + y_axis * y + x_axis.cross(&y_axis) * z;
    let mut bodies = vec![point_mass(end.mass + device.handle_mass, tip)];
    for i in 0..3 {
        let across = up * q[i].cos() - outward[i] * q[i].sin();
        let axes = Matrix3::from_columns(&[direction(i), across, outward[i].cross(&up)]);
        bodies.push(Body {
            mass: arm.mass,
            com: outward[i] * base + direction(i) * arm.com,
            axes,
            inertia: arm.tensor(),
        });
        // Simpson's rule is exact for the energy of two slender rods.
        let (from, to) = (elbow(i), tip + outward[i] * platform);
        for (share, place) in [(1.0 / 6.0, from), (2.0 / 3.0, (from + to) / 2.0), (1.0 / 6.0, to)] {
            bodies.push(point_mass(2.0 * rod.mass * share, place));
        }
    }
    (bodies, tip)
}

/// Returns the bodies of a device at joint angles `q` and its task position (φ last on the redundant arm).
pub fn place_bodies(device: &Description, q: &[f64]) -> (Vec<Body>, Vector3<f64>) {
    let g = device.geometry;
    let along = |angle: f64| Vector2::new(angle.cos(), angle.sin());
    let (turret, arms) = match device.kind {
        Kind::FiveBarTurret | Kind::Parallelogram => (q[0], &q[1..]),
        _ => (0.0, q),
    };
    let mut phi = 0.0;
    let (links, tip) = match device.kind {
        Kind::Chain1 | Kind::Chain2 | Kind::Chain3 => return place_chain(device, q),
        Kind::Delta => return place_delta(device, q),
        Kind::Paddle | Kind::Paddles2 | Kind::Paddles3 => {
            let mut tip = Vector3::zeros();
            tip.iter_mut().zip(q).zip(&g).for_each(|((arc, q), length)| *arc = length * q);
            let handles = q.iter().zip(&device.links).map(|(q, link)| Body {
                mass: link.mass,
                com: along(*q).push(0.0) * link.com,
                axes: *Rotation3::from_axis_angle(&Vector3::z_axis(), *q).matrix(),
                inertia: link.tensor(),
            });
            let point = along(q[0]).push(0.0) * g[0];
            return (handles.chain(std::iter::once(point_mass(device.handle_mass, point))).collect(), tip);
        }
        Kind::FiveBar | Kind::FiveBarTurret => {
            let (a, b) = (Vector2::new(-g[0] / 2.0, 0.0), Vector2::new(g[0] / 2.0, 0.0));
            let (c, d) = (a + along(arms[0]) * g[1], b + along(arms[1]) * g[2]);
            // The law of cosines at C in the triangle C, D, P.
            let span = d - c;
            let angle = ((span.norm_squared() + g[3] * g[3] - g[4] * g[4]) / (2.0 * g[3] * span.norm())).acos();
            let p = c + along(span.y.atan2(span.x) + g[5] * angle) * g[3];
            let links =
                vec![(a, along(arms[0])), (b, along(arms[1])), (c, (p - c).normalize()), (d, (p - d).normalize())];
            (links, p)
        }
        Kind::Parallelogram => {
            let (upper, fore) = (along(arms[0]), along(arms[1]));
            let elbow = upper * g[0];
            let zero = Vector2::zeros();
            (vec![(zero, upper), (elbow, fore), (zero, -fore), (-fore * g[2], upper)], elbow + fore * g[1])
        }
        Kind::Serial3r => {
            let mut end = Vector2::zeros();
            let mut links = Vec::new();
            for i in 0..3 {
                phi += arms[i];
                links.push((end, along(phi)));
                end += along(phi) * g[i];
            }
            (links, end)
        }
    };
    // The axes of the arms' plane, in world coordinates.
    let (s, c) = turret.sin_cos();
    let plane = match device.kind {
        Kind::FiveBarTurret => Matrix3::new(1.0, 0.0, 0.0, 0.0, c, -s, 0.0, s, c),
        Kind::Parallelogram => Matrix3::new(c, 0.0, s, 0.0, 1.0, 0.0, -s, 0.0, c),
        _ => Matrix3::identity(),
    };
    let world = |v: Vector2<f64>| plane * Vector3::new(v.x, v.y, 0.0);
    let mut bodies: Vec<Body> = links
        .iter()
        .zip(&device.links)
        .map(|((from, direction), link)| Body {
            mass: link.mass,
            com: world(from + direction * link.com),
            axes: plane * Matrix3::new(direction.x, -direction.y, 0.0, direction.y, direction.x, 0.0, 0.0, 0.0, 1.0),
            inertia: link.tensor(),
        })
        .collect();
    bodies.push(point_mass(device.handle_mass, world(tip)));
    let task = if device.kind == Kind::Serial3r { Vector3::new(tip.x, tip.y, phi) } else { world(tip) };
    (bodies, task)
}

/// Computes the derivative of `f` at 0 by central differences with Richardson extrapolation (error of order step⁴).
pub fn derivative<V>(step: f64, f: impl Fn(f64) -> V) -> V
where
    V: std::ops::Sub<Output = V> + std::ops::Mul<f64, Output = V>,
{
    let central = |h: f64| (f(h) - f(-h)) * (0.5 / h);
    central(0.5 * step) * (4.0 / 3.0) - central(step) * (1.0 / 3.0)
}

/// Computes the mass matrix (rows) and gravity's torques of a device at `q`.
pub fn dynamics(device: &Description, q: &[f64]) -> (Vec<Vec<f64>>, Vec<f64>) {
    let n = q.len();
    let moved = |i: usize, h: f64| {
        let mut q = q.to_vec();
        q[i] += h;
        place_bodies(device, &q).0
    };
    let (here, _) = place_bodies(device, q);
    let step = 1.0e-4;
    // Linear and angular velocity of each body per unit velocity of each joint.
    let rates: Vec<Vec<(Vector3<f64>, Vector3<f64>)>> = (0..n)
        .map(|i| {
            (0..here.len())
                .map(|k| {
                    let v = derivative(step, |h| moved(i, h)[k].com);
                    let spin = derivative(step, |h| moved(i, h)[k].axes) * here[k].axes.transpose();
                    (v, Vector3::new(spin[(2, 1)], spin[(0, 2)], spin[(1, 0)]))
                })
                .collect()
        })
        .collect();
    let gravity = Vector3::from(device.gravity);
    let mut mass = vec![vec![0.0; n]; n];
    let mut weight = vec![0.0; n];
    for i in 0..n {
        mass[i][i] = device.joints[i].inertia;
        for (k, body) in here.iter().enumerate() {
            let (vi, wi) = rates[i][k];
            weight[i] -= body.mass * gravity.dot(&vi);
            for j in 0..n {
                let (vj, wj) = rates[j][k];
                let (wi, wj) = (body.axes.tr_mul(&wi), body.axes.tr_mul(&wj));
                mass[i][j] += body.mass * vi.dot(&vj) + wi.dot(&(body.inertia * wj));
            }
        }
    }
    (mass, weight)
}
