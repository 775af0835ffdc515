//! Links and joints of a mechanism in the plane of its linkage, for drawings.
//!
//! Joint 0 of a device on a turret turns this plane. The plane's x and y are those at joint 0 = 0. A delta is seen along
//! its z axis.

use haptic_bridge::math::FineTable;
use haptic_bridge::model::catalogue::Kind;
use haptic_bridge::model::description::Description;
use haptic_bridge::model::mechanism::{Delta, Mechanism};
use nalgebra::{Matrix3, Rotation3, Vector3};

/// A point in the linkage's plane, m.
pub type Point = (f64, f64);

/// A rigid link, drawn as a straight bar.
#[derive(Clone, Debug, PartialEq)]
pub struct Bar {
    /// Name of the link as in device files.
    pub name: &'static str,
    /// End nearer to the base.
    pub from: Point,
    /// End farther from the base.
    pub to: Point,
    /// Length in the device file, m.
    pub length: f64,
}

/// An actuated joint's angle in the drawing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Angle {
    /// Index of the joint, from 0.
    pub joint: usize,
    /// Vertex of the angle.
    pub at: Point,
    /// Direction of joint angle zero, rad from +x.
    pub zero: f64,
    /// Angle of the joint, rad, counter-clockwise from `zero`.
    pub angle: f64,
    /// Length of the joint's link, m.
    pub arm: f64,
}

/// Axis of a turret in the linkage's plane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Turret {
    /// Joint 0 turns the plane about its x axis.
    AboutX,
    /// Joint 0 turns the plane about its y axis.
    AboutY,
}

impl Turret {
    /// Returns the turret of a mechanism, or `None` if it has no turret.
    pub fn of(kind: Kind) -> Option<Self> {
        match kind {
            Kind::FiveBarTurret => Some(Self::AboutX),
            Kind::Parallelogram => Some(Self::AboutY),
            _ => None,
        }
    }
}

/// A device at one pose.
#[derive(Clone, Debug, PartialEq)]
pub struct Skeleton {
    /// The links.
    pub bars: Vec<Bar>,
    /// The angles of the joints that act in the plane.
    pub angles: Vec<Angle>,
    /// Pivots on the base.
    pub base: Vec<Point>,
    /// Points with the letters that the documentation uses for them.
    pub letters: Vec<(&'static str, Point)>,
    /// The tip.
    pub tip: Point,
}

fn point_at(from: Point, length: f64, angle: f64) -> Point {
    (from.0 + length * angle.cos(), from.1 + length * angle.sin())
}

/// Returns the device at joint angles `q` (rad), or `None` if its linkage does not close or `q` has too few angles.
pub fn skeleton(description: &Description, q: &[f64]) -> Option<Skeleton> {
    if q.len() < description.kind.spec().joints {
        return None;
    }
    match description.kind {
        Kind::Paddle | Kind::Paddles2 | Kind::Paddles3 => Some(paddles(description, q)),
        Kind::Chain1 | Kind::Chain2 | Kind::Chain3 => Some(chain(description, q)),
        Kind::FiveBar => five_bar(description, [q[0], q[1]], 0),
        Kind::FiveBarTurret => five_bar(description, [q[1], q[2]], 1),
        Kind::Parallelogram => Some(parallelogram(description, q[1], q[2])),
        Kind::Serial3r => Some(serial_arm(description, q)),
        Kind::Delta => delta(description, q),
    }
}

/// Returns the paddles side by side. The tip is that of the first.
fn paddles(description: &Description, q: &[f64]) -> Skeleton {
    let spec = description.kind.spec();
    let mut paddles =
        Skeleton { bars: Vec::new(), angles: Vec::new(), base: Vec::new(), letters: Vec::new(), tip: (0.0, 0.0) };
    let longest = description.geometry.iter().fold(0.0_f64, |longest, length| longest.max(*length));
    for (joint, (length, q)) in description.geometry.iter().copied().zip(q).enumerate().take(spec.joints) {
        let pivot = (0.0, -2.0 * longest * joint as f64);
        let tip = point_at(pivot, length, *q);
        paddles.bars.push(Bar { name: spec.links[joint], from: pivot, to: tip, length });
        paddles.angles.push(Angle { joint, at: pivot, zero: 0.0, angle: *q, arm: length });
        paddles.base.push(pivot);
        if joint == 0 {
            paddles.tip = tip;
        }
    }
    paddles
}

/// Returns a chain as seen against its missing task coordinate: the drawing's axes are the first two task coordinates.
/// A chain of one joint is seen along its axis if it turns, otherwise along a normal of its axis.
fn chain(description: &Description, q: &[f64]) -> Skeleton {
    let spec = description.kind.spec();
    let (mut frame, mut origin) = (Matrix3::identity(), Vector3::zeros());
    let (mut points, mut axis) = (Vec::new(), Vector3::z());
    for (joint, q) in description.joints.iter().zip(q).take(spec.joints) {
        origin += frame * Vector3::from(joint.frame.origin);
        points.push(origin);
        let [roll, pitch, yaw] = joint.frame.rpy;
        frame *= Rotation3::from_euler_angles(roll, pitch, yaw).matrix();
        let own = Vector3::from(joint.frame.axis).normalize();
        axis = frame * own;
        if joint.prismatic {
            origin += axis * *q;
        } else {
            frame *= Rotation3::new(own * *q).matrix();
        }
    }
    let [x, y, z, first, second, ..] = description.geometry;
    points.push(origin + frame * Vector3::new(x, y, z));
    let unit = |coordinate: f64| Vector3::from_fn(|row, _| f64::from(u8::from(row as f64 == coordinate)));
    let (right, up) = if spec.joints > 1 {
        (unit(first), unit(second))
    } else if description.joints[0].prismatic {
        let right = if first < 3.0 { unit(first) } else { axis };
        (right, (unit(2.0) - right * right.z).try_normalize(1e-6).unwrap_or(Vector3::y()))
    } else {
        let right = (Vector3::x() - axis * axis.x).try_normalize(1e-6).unwrap_or(Vector3::y());
        (right, axis.cross(&right))
    };
    let seen = |point: &Vector3<f64>| (point.dot(&right), point.dot(&up));
    let bars = points.windows(2).zip(spec.links).map(|(ends, name)| Bar {
        name,
        from: seen(&ends[0]),
        to: seen(&ends[1]),
        length: (ends[1] - ends[0]).norm(),
    });
    Skeleton {
        bars: bars.collect(),
        angles: Vec::new(),
        base: vec![seen(&points[0])],
        letters: Vec::new(),
        tip: seen(&points[spec.joints]),
    }
}

fn five_bar(description: &Description, q: [f64; 2], first: usize) -> Option<Skeleton> {
    let [base, l1, l2, r1, r2, assembly, ..] = description.geometry;
    let (a, b) = ((-base / 2.0, 0.0), (base / 2.0, 0.0));
    let (c, d) = (point_at(a, l1, q[0]), point_at(b, l2, q[1]));
    let (dx, dy) = (d.0 - c.0, d.1 - c.1);
    let apart = dx.hypot(dy);
    // Position of the tip's foot on the line from C to D, and height of the tip above the line.
    let foot = (r1 * r1 - r2 * r2 + apart * apart) / (2.0 * apart);
    let height = (r1 * r1 - foot * foot).sqrt() * assembly;
    let tip = (c.0 + (foot * dx - height * dy) / apart, c.1 + (foot * dy + height * dx) / apart);
    (tip.0.is_finite() && tip.1.is_finite()).then(|| Skeleton {
        bars: vec![
            Bar { name: "proximal-1", from: a, to: c, length: l1 },
            Bar { name: "proximal-2", from: b, to: d, length: l2 },
            Bar { name: "distal-1", from: c, to: tip, length: r1 },
            Bar { name: "distal-2", from: d, to: tip, length: r2 },
        ],
        angles: vec![
            Angle { joint: first, at: a, zero: 0.0, angle: q[0], arm: l1 },
            Angle { joint: first + 1, at: b, zero: 0.0, angle: q[1], arm: l2 },
        ],
        base: vec![a, b],
        letters: vec![("A", a), ("B", b), ("C", c), ("D", d)],
        tip,
    })
}

fn parallelogram(description: &Description, q1: f64, q2: f64) -> Skeleton {
    let [upper, fore, crank, ..] = description.geometry;
    let o = (0.0, 0.0);
    let e = point_at(o, upper, q1);
    let tip = point_at(e, fore, q2);
    let (crank_tip, rear) = (point_at(o, -crank, q2), point_at(e, -crank, q2));
    Skeleton {
        bars: vec![
            Bar { name: "upper", from: o, to: e, length: upper },
            // The bar begins at the forearm's rear end; length and centre of mass count from E.
            Bar { name: "fore", from: rear, to: tip, length: fore },
            Bar { name: "crank", from: o, to: crank_tip, length: crank },
            Bar { name: "coupler", from: crank_tip, to: rear, length: upper },
        ],
        angles: vec![
            Angle { joint: 1, at: o, zero: 0.0, angle: q1, arm: upper },
            Angle { joint: 2, at: e, zero: 0.0, angle: q2, arm: fore },
        ],
        base: vec![o],
        letters: vec![("O", o), ("E", e)],
        tip,
    }
}

fn serial_arm(description: &Description, q: &[f64]) -> Skeleton {
    let names = ["link-1", "link-2", "link-3"];
    let (mut at, mut heading) = ((0.0, 0.0), 0.0);
    let (mut bars, mut angles) = (Vec::new(), Vec::new());
    for (joint, name) in names.into_iter().enumerate() {
        let length = description.geometry[joint];
        angles.push(Angle { joint, at, zero: heading, angle: q[joint], arm: length });
        heading += q[joint];
        let to = point_at(at, length, heading);
        bars.push(Bar { name, from: at, to, length });
        at = to;
    }
    Skeleton { bars, angles, base: vec![(0.0, 0.0)], letters: Vec::new(), tip: at }
}

/// Returns the legs and the platform as seen along z. A pair of rods is one bar.
fn delta(description: &Description, q: &[f64]) -> Option<Skeleton> {
    let mechanism = Delta::<f64>::new(description).ok()?;
    let pose = mechanism.pose::<FineTable>(&Vector3::new(q[0], q[1], q[2]));
    if mechanism.regularity(&pose).parallel == 0.0 {
        return None;
    }
    let tip = mechanism.tip(&pose);
    let tip = (tip[0], tip[1]);
    let [base, platform, upper, fore, azimuths @ .., _] = description.geometry;
    let (mut bars, mut motors) = (Vec::new(), Vec::new());
    for (azimuth, q) in azimuths.into_iter().zip(q) {
        let motor = point_at((0.0, 0.0), base, azimuth);
        let elbow = point_at(motor, upper * q.cos(), azimuth);
        let end = point_at(tip, platform, azimuth);
        bars.extend([
            Bar { name: "arm", from: motor, to: elbow, length: upper },
            Bar { name: "rod", from: elbow, to: end, length: fore },
            Bar { name: "platform", from: end, to: tip, length: platform },
        ]);
        motors.push(motor);
    }
    Some(Skeleton { bars, angles: Vec::new(), base: motors, letters: Vec::new(), tip })
}
