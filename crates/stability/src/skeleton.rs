//! Links and joints of a mechanism on the plane of a drawing.
//!
//! Joint 0 of a device on a turret turns the plane of its linkage. The plane's x and y are those at joint 0 = 0. Chains
//! and deltas are bodies in space, which a [`View`] projects.

use haptic_bridge::math::FineTable;
use haptic_bridge::model::catalogue::Kind;
use haptic_bridge::model::description::Description;
use haptic_bridge::model::mechanism::{Delta, Mechanism};
use nalgebra::{Matrix3, Rotation3, Vector3};

/// Sine of the largest angle at which a direction counts as parallel to a view, or to its normal.
const ALIGNED_SINE: f64 = 1e-3;
/// Share by which links that are seen longer make a view better, whatever joints it shows.
const LONGER: f64 = 1.02;
/// Length of a link below which it is seen from its end, m.
const SHORTEST: f64 = 1e-6;
const COORDINATES: [&str; 3] = ["x", "y", "z"];

/// A point in the plane of a drawing, m.
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

/// Angle of a revolute joint whose axis points at the viewer or away.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Angle {
    /// Index of the joint, from 0.
    pub joint: usize,
    /// Vertex of the angle.
    pub at: Point,
    /// Direction of joint angle zero, rad from +x.
    pub zero: f64,
    /// Angle of the joint, rad from `zero`.
    pub angle: f64,
    /// 1 if the angle grows counter-clockwise, -1 if clockwise.
    pub sense: f64,
    /// Length of the joint's link, m.
    pub arm: f64,
}

/// Travel of a prismatic joint that slides in the plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slide {
    /// Index of the joint, from 0.
    pub joint: usize,
    /// Place of the carriage at travel zero.
    pub zero: Point,
    /// Unit vector of positive travel.
    pub along: Point,
    /// Travel of the joint, m.
    pub travel: f64,
    /// Travel at the ends of the rail, m: the limits, zero and the present travel.
    pub ends: (f64, f64),
}

impl Slide {
    /// Returns the place of the carriage at a travel (m).
    pub fn place(&self, travel: f64) -> Point {
        (self.zero.0 + travel * self.along.0, self.zero.1 + travel * self.along.1)
    }

    /// Returns the ends of the rail.
    pub fn rail(&self) -> [Point; 2] {
        [self.place(self.ends.0), self.place(self.ends.1)]
    }
}

/// Axis of a revolute joint that lies in the plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Axis {
    /// Index of the joint, from 0.
    pub joint: usize,
    /// A point on the axis.
    pub at: Point,
    /// Unit vector of the axis.
    pub along: Point,
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
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Skeleton {
    /// The links.
    pub bars: Vec<Bar>,
    /// The revolute joints that act in the plane.
    pub angles: Vec<Angle>,
    /// The prismatic joints that act in the plane.
    pub slides: Vec<Slide>,
    /// The axes in the plane.
    pub axes: Vec<Axis>,
    /// Pivots on the base.
    pub base: Vec<Point>,
    /// Points with the letters that the documentation uses for them.
    pub letters: Vec<(&'static str, Point)>,
    /// The tip; of several paddles the first one's.
    pub tip: Point,
    /// Tips of further paddles.
    pub more_tips: Vec<Point>,
}

impl Skeleton {
    /// Returns true if the drawing shows the motion of a joint.
    pub fn shows(&self, joint: usize) -> bool {
        self.angles
            .iter()
            .map(|angle| angle.joint)
            .chain(self.slides.iter().map(|slide| slide.joint))
            .any(|j| j == joint)
    }

    /// Returns all points of links, rails and tips.
    pub fn points(&self) -> impl Iterator<Item = Point> + '_ {
        let rails = self.slides.iter().flat_map(Slide::rail);
        self.bars.iter().flat_map(|bar| [bar.from, bar.to]).chain(rails).chain([self.tip])
    }
}

/// Direction from which a drawing shows a body in space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    right: Vector3<f64>,
    up: Vector3<f64>,
    /// Names of the axes to the right and up.
    pub names: [&'static str; 2],
}

impl View {
    /// The x axis to the right, the y axis up.
    pub fn xy() -> Self {
        Self::of_coordinates([0, 1])
    }

    fn of_coordinates([right, up]: [usize; 2]) -> Self {
        let unit = |coordinate| Vector3::from_fn(|row, _| f64::from(u8::from(row == coordinate)));
        Self { right: unit(right), up: unit(up), names: [right, up].map(|i| COORDINATES[i.min(2)]) }
    }

    /// Returns the plane of the first two task coordinates; for a chain of one joint the first [`View::of_drawing`].
    pub fn of_task(description: &Description) -> Self {
        match description.kind {
            Kind::Paddles2 | Kind::Paddles3 => Self { names: ["arc of paddle 0", "arc of paddle 1"], ..Self::xy() },
            Kind::Chain1 => Self::of_drawing(description)[0],
            Kind::Chain2 | Kind::Chain3 => Self::of_coordinates(task_plane(description)),
            _ => Self::xy(),
        }
    }

    /// Returns the views of a drawing. The first shows a chain's links longest at home, if possible in the plane of the
    /// task. A second view shows joints that the first does not show, if any view of two coordinates does.
    pub fn of_drawing(description: &Description) -> Vec<Self> {
        match description.kind {
            Kind::Chain1 | Kind::Chain2 | Kind::Chain3 => {}
            Kind::Delta => {
                let azimuth = description.geometry[4];
                let right = Vector3::new(azimuth.cos(), azimuth.sin(), 0.0);
                let name = if azimuth == 0.0 { "x" } else { "along leg 0" };
                return vec![Self::xy(), Self { right, up: Vector3::z(), names: [name, "z"] }];
            }
            _ => return vec![Self::xy()],
        }
        let spec = description.kind.spec();
        let home = description.home.unwrap_or_default();
        // The axis against gravity points upwards, or at the viewer.
        let against_gravity = (0..3).find(|i| description.gravity[*i] < 0.0);
        let upright = |[a, b]: [usize; 2]| match against_gravity {
            Some(up) if up == a || (up == 1 && [a, b] == [0, 2]) => [b, a],
            _ => [a, b],
        };
        let planes = [[0, 1], [0, 2], [1, 2]].map(upright);
        let first = if spec.joints > 1 { task_plane(description) } else { planes[0] };
        let mut views: Vec<Self> = [first].into_iter().chain(planes).map(Self::of_coordinates).collect();
        let (joints, _) = chain_joints(description, &home);
        if let ([joint], false) = (joints.as_slice(), description.joints[0].prismatic)
            && joint.axis.amax() < 1.0 - ALIGNED_SINE * ALIGNED_SINE
        {
            // No view of two coordinates shows the angle.
            let right = Vector3::z().cross(&joint.axis).normalize();
            views.push(Self { right, up: joint.axis.cross(&right), names: ["across", "up"] });
        }
        let seen = |view: &Self| {
            let skeleton = chain(description, &home, view);
            let ends = skeleton.bars.iter().map(|bar| [bar.from, bar.to]);
            let lines = ends.chain(skeleton.slides.iter().map(Slide::rail));
            let length: f64 = lines.map(|[a, b]| (a.0 - b.0).hypot(a.1 - b.1)).sum();
            let shown: Vec<bool> = (0..spec.joints).map(|joint| skeleton.shows(joint)).collect();
            (length, shown)
        };
        let count = |shown: &[bool]| shown.iter().filter(|shown| **shown).count();
        let mut best = (views[0], seen(&views[0]));
        for view in &views[1..] {
            let (length, shown) = seen(view);
            let (best_length, best_shown) = &best.1;
            let shows_more = count(&shown) > count(best_shown);
            if length > LONGER * best_length || (LONGER * length > *best_length && shows_more) {
                best = (*view, (length, shown));
            }
        }
        let missing = |view: &Self| {
            let shown = seen(view).1;
            shown.iter().zip(&best.1.1).filter(|(here, there)| **here && !**there).count()
        };
        let other = views.iter().rev().max_by_key(|view| missing(view)).filter(|view| missing(view) > 0);
        [best.0].into_iter().chain(other.copied()).collect()
    }

    /// Returns the unit vectors to the right and up in coordinates of the task. They are shorter if the task lacks a
    /// coordinate of the view.
    pub fn in_task(&self, description: &Description) -> [[f64; 3]; 2] {
        let task = description.kind.spec().task;
        let is_chain = matches!(description.kind, Kind::Chain2 | Kind::Chain3);
        let coordinate = |i: usize| if is_chain { description.geometry[3 + i] as usize } else { i };
        [self.right, self.up].map(|axis| {
            core::array::from_fn(|i| if i < task { axis.get(coordinate(i)).copied().unwrap_or(0.0) } else { 0.0 })
        })
    }

    fn project(&self, point: &Vector3<f64>) -> Point {
        (point.dot(&self.right), point.dot(&self.up))
    }

    /// Returns the component of a vector towards the viewer.
    fn towards(&self, vector: &Vector3<f64>) -> f64 {
        self.right.cross(&self.up).dot(vector)
    }
}

/// Returns the first two task coordinates of a chain of at least two joints.
fn task_plane(description: &Description) -> [usize; 2] {
    [description.geometry[3] as usize, description.geometry[4] as usize]
}

fn point_at(from: Point, length: f64, angle: f64) -> Point {
    (from.0 + length * angle.cos(), from.1 + length * angle.sin())
}

/// Returns the device at joint angles `q` (rad), a chain on the plane of its task and a delta along z. Returns `None` if
/// its linkage does not close or `q` has too few angles.
pub fn skeleton(description: &Description, q: &[f64]) -> Option<Skeleton> {
    skeleton_in(description, q, &View::of_task(description))
}

/// Like [`skeleton`], but shows a chain or a delta from any direction. Other mechanisms are drawn in their plane.
pub fn skeleton_in(description: &Description, q: &[f64], view: &View) -> Option<Skeleton> {
    if q.len() < description.kind.spec().joints {
        return None;
    }
    match description.kind {
        Kind::Paddle | Kind::Paddles2 | Kind::Paddles3 => Some(paddles(description, q)),
        Kind::Chain1 | Kind::Chain2 | Kind::Chain3 => Some(chain(description, q, view)),
        Kind::FiveBar => five_bar(description, [q[0], q[1]], 0),
        Kind::FiveBarTurret => five_bar(description, [q[1], q[2]], 1),
        Kind::Parallelogram => Some(parallelogram(description, q[1], q[2])),
        Kind::Serial3r => Some(serial_arm(description, q)),
        Kind::Delta => delta(description, q, view),
    }
}

/// Returns the paddles side by side. The tip is that of the first.
fn paddles(description: &Description, q: &[f64]) -> Skeleton {
    let spec = description.kind.spec();
    let longest = description.geometry.iter().fold(0.0_f64, |longest, length| longest.max(*length));
    let (mut bars, mut angles, mut tips) = (Vec::new(), Vec::new(), Vec::new());
    for (joint, (length, q)) in description.geometry.iter().copied().zip(q).enumerate().take(spec.joints) {
        let pivot = (0.0, -2.0 * longest * joint as f64);
        let tip = point_at(pivot, length, *q);
        bars.push(Bar { name: spec.links[joint], from: pivot, to: tip, length });
        angles.push(Angle { joint, at: pivot, zero: 0.0, angle: *q, sense: 1.0, arm: length });
        tips.push(tip);
    }
    let base = angles.iter().map(|angle| angle.at).collect();
    let tip = tips.remove(0);
    Skeleton { bars, angles, base, tip, more_tips: tips, ..Skeleton::default() }
}

/// A joint of a chain at some pose, in the base frame.
struct ChainJoint {
    /// Origin at travel zero, m.
    zero: Vector3<f64>,
    /// Origin, m.
    at: Vector3<f64>,
    axis: Vector3<f64>,
}

/// Returns the joints of a chain and its tip (m).
fn chain_joints(description: &Description, q: &[f64]) -> (Vec<ChainJoint>, Vector3<f64>) {
    let (mut frame, mut origin) = (Matrix3::identity(), Vector3::zeros());
    let mut joints = Vec::new();
    for (joint, q) in description.joints.iter().zip(q).take(description.kind.spec().joints) {
        origin += frame * Vector3::from(joint.frame.origin);
        let [roll, pitch, yaw] = joint.frame.rpy;
        frame *= Rotation3::from_euler_angles(roll, pitch, yaw).matrix();
        let own = Vector3::from(joint.frame.axis).normalize();
        let (zero, axis) = (origin, frame * own);
        if joint.prismatic {
            origin += axis * *q;
        } else {
            frame *= Rotation3::new(own * *q).matrix();
        }
        joints.push(ChainJoint { zero, at: origin, axis });
    }
    let [x, y, z, ..] = description.geometry;
    (joints, origin + frame * Vector3::new(x, y, z))
}

fn chain(description: &Description, q: &[f64], view: &View) -> Skeleton {
    let (joints, tip) = chain_joints(description, q);
    let ends: Vec<Vector3<f64>> = joints.iter().skip(1).map(|next| next.zero).chain([tip]).collect();
    let mut drawn = Skeleton { tip: view.project(&tip), ..Skeleton::default() };
    let links = description.kind.spec().links;
    for (i, (joint, q)) in joints.iter().zip(q).enumerate() {
        let at = view.project(&joint.at);
        drawn.bars.push(Bar {
            name: links[i],
            from: at,
            to: view.project(&ends[i]),
            length: (ends[i] - joint.at).norm(),
        });
        let along = view.project(&joint.axis);
        let is_in_plane = view.towards(&joint.axis).abs() < ALIGNED_SINE;
        if description.joints[i].prismatic {
            let (low, high) = description.joints[i].limits.unwrap_or((*q, *q));
            let ends = (low.min(*q).min(0.0), high.max(*q).max(0.0));
            let zero = view.project(&joint.zero);
            drawn.slides.extend(is_in_plane.then_some(Slide { joint: i, zero, along, travel: *q, ends }));
        } else if is_in_plane {
            drawn.axes.push(Axis { joint: i, at, along });
        } else if along.0.hypot(along.1) < ALIGNED_SINE {
            // The link may be seen from its end; then a later point shows the direction.
            let mut arms = ends[i..].iter().map(|end| view.project(end)).map(|end| (end.0 - at.0, end.1 - at.1));
            let arm = arms.find(|arm| arm.0.hypot(arm.1) > SHORTEST).unwrap_or((SHORTEST, 0.0));
            let sense = view.towards(&joint.axis).signum();
            let zero = arm.1.atan2(arm.0) - sense * *q;
            drawn.angles.push(Angle { joint: i, at, zero, angle: *q, sense, arm: arm.0.hypot(arm.1) });
        }
    }
    drawn.base.extend(joints.first().map(|joint| view.project(&joint.zero)));
    drawn
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
            Angle { joint: first, at: a, zero: 0.0, angle: q[0], sense: 1.0, arm: l1 },
            Angle { joint: first + 1, at: b, zero: 0.0, angle: q[1], sense: 1.0, arm: l2 },
        ],
        axes: (0..first).map(|joint| Axis { joint, at: (0.0, 0.0), along: (1.0, 0.0) }).collect(),
        base: vec![a, b],
        letters: vec![("A", a), ("B", b), ("C", c), ("D", d)],
        tip,
        ..Skeleton::default()
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
            Angle { joint: 1, at: o, zero: 0.0, angle: q1, sense: 1.0, arm: upper },
            Angle { joint: 2, at: e, zero: 0.0, angle: q2, sense: 1.0, arm: fore },
        ],
        axes: vec![Axis { joint: 0, at: o, along: (0.0, 1.0) }],
        base: vec![o],
        letters: vec![("O", o), ("E", e)],
        tip,
        ..Skeleton::default()
    }
}

fn serial_arm(description: &Description, q: &[f64]) -> Skeleton {
    let names = ["link-1", "link-2", "link-3"];
    let (mut at, mut heading) = ((0.0, 0.0), 0.0);
    let (mut bars, mut angles) = (Vec::new(), Vec::new());
    for (joint, name) in names.into_iter().enumerate() {
        let length = description.geometry[joint];
        angles.push(Angle { joint, at, zero: heading, angle: q[joint], sense: 1.0, arm: length });
        heading += q[joint];
        let to = point_at(at, length, heading);
        bars.push(Bar { name, from: at, to, length });
        at = to;
    }
    Skeleton { bars, angles, base: vec![(0.0, 0.0)], tip: at, ..Skeleton::default() }
}

/// Returns the legs and the platform. A pair of rods is one bar.
fn delta(description: &Description, q: &[f64], view: &View) -> Option<Skeleton> {
    const LEGS: [&str; 3] = ["joint 0", "joint 1", "joint 2"];
    let mechanism = Delta::<f64>::new(description).ok()?;
    let pose = mechanism.pose::<FineTable>(&Vector3::new(q[0], q[1], q[2]));
    if mechanism.regularity(&pose).parallel == 0.0 {
        return None;
    }
    let tip = mechanism.tip(&pose);
    let [base, platform, upper, fore, azimuths @ .., _] = description.geometry;
    let mut drawn = Skeleton { tip: view.project(&tip), ..Skeleton::default() };
    for (joint, (azimuth, q)) in azimuths.into_iter().zip(q).enumerate() {
        let outward = Vector3::new(azimuth.cos(), azimuth.sin(), 0.0);
        let motor = outward * base;
        let elbow = motor + outward * (upper * q.cos()) + Vector3::z() * (upper * q.sin());
        let [at, elbow, end] = [motor, elbow, tip + outward * platform].map(|point| view.project(&point));
        drawn.bars.extend([
            Bar { name: "arm", from: at, to: elbow, length: upper },
            Bar { name: "rod", from: elbow, to: end, length: fore },
            Bar { name: "platform", from: end, to: drawn.tip, length: platform },
        ]);
        let facing = view.towards(&outward.cross(&Vector3::z()));
        if facing.abs() > 1.0 - ALIGNED_SINE {
            let (across, up) = view.project(&outward);
            drawn.angles.push(Angle {
                joint,
                at,
                zero: up.atan2(across),
                angle: *q,
                sense: facing.signum(),
                arm: upper,
            });
        } else if facing.abs() < ALIGNED_SINE {
            drawn.letters.push((LEGS[joint], at));
        }
        drawn.base.push(at);
    }
    Some(drawn)
}
