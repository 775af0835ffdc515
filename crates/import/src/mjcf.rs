//! Reads MJCF, the models of MuJoCo (mujoco.readthedocs.io/en/stable/XMLreference.html).

use crate::tree::{Body, Inertia, Joint, Motion, Step, Tree};
use crate::xml::{Element, pose};
use haptic_host::error::Failure;
use nalgebra::{Isometry3, Matrix3, Rotation3, Unit, UnitQuaternion, Vector3};
use std::collections::BTreeSet;

/// Way to a file without what only MuJoCo computes.
const LET_MUJOCO_SAVE: &str = "let MuJoCo write a plain file (write saveinertial=\"true\" into <compiler>, then `Save xml` \
                               of its program simulate, or mujoco.mj_saveLastXML in Python) and convert that file";

/// Settings of the whole file.
struct Settings<'a> {
    /// Radians per unit of angle.
    angle_unit: f64,
    euler_sequence: &'a str,
    /// A range alone limits a joint.
    auto_limits: bool,
    /// Class of the defaults that apply everywhere.
    top_class: &'a str,
    defaults: Vec<Default<'a>>,
}

/// MuJoCo's name for the class of the defaults that apply everywhere.
const MAIN: &str = "main";

/// A `<default>` element with its class and the class around it.
struct Default<'a> {
    element: Element<'a>,
    class: &'a str,
    parent: Option<&'a str>,
}

/// Reads a `<mujoco>`.
pub(crate) fn read(root: Element<'_>) -> Result<Tree, Failure> {
    if let Some(include) = root.all("include").next() {
        return Err(include.error("other files are not read", LET_MUJOCO_SAVE));
    }
    let mut remarks = Vec::new();
    let settings = Settings::read(root, &mut remarks)?;
    let mut gravity = Vector3::new(0.0, 0.0, -9.81);
    for option in root.all("option") {
        gravity = option.vector("gravity")?.unwrap_or(gravity);
    }
    for unread in ["equality", "tendon"].iter().filter(|tag| root.all(tag).any(|it| it.children().next().is_some())) {
        remarks.push(format!("<{unread}> is left out: what it couples moves freely here."));
    }
    let world = Body { name: "world".into(), parent: None, steps: Vec::new(), inertia: Inertia::default() };
    let mut tree = Tree {
        name: root.text("model").unwrap_or_default().into(),
        format: "MJCF",
        bodies: vec![world],
        gravity,
        remarks,
    };
    let mut names = BTreeSet::from(["world".to_owned()]);
    // Bodies and frames to be read. The last comes first.
    let mut next: Vec<Pending<'_>> = Vec::new();
    for element in root.all("worldbody").rev() {
        let class = element.text("childclass");
        Pending { element, parent: 0, class, frame: Isometry3::identity() }.push_children(&mut next)?;
    }
    while let Some(Pending { element, parent, class, frame }) = next.pop() {
        let class = element.text("childclass").or(class);
        let frame = frame * settings.pose(element)?;
        if element.tag() == "frame" {
            Pending { element, parent, class, frame }.push_children(&mut next)?;
            continue;
        }
        let index = tree.bodies.len();
        let name = element.text("name").map_or_else(|| format!("body{index}"), Into::into);
        if !names.insert(name.clone()) {
            return Err(element.error("a second body of this name", "name each body differently"));
        }
        let mut steps = vec![Step::Fixed(frame)];
        settings.add_joints(element, &name, class, &mut steps, &mut tree.remarks)?;
        let inertia = settings.inertia(element, &name)?;
        if element.magnitude("gravcomp")? > 0.0 {
            tree.remarks.push(format!("gravcomp of {name} is left out: the body has its full weight here."));
        }
        tree.bodies.push(Body { name, parent: Some(parent), steps, inertia });
        Pending { element, parent: index, class, frame: Isometry3::identity() }.push_children(&mut next)?;
    }
    Ok(tree)
}

/// A `<body>` or `<frame>` to be read.
struct Pending<'a> {
    element: Element<'a>,
    /// Index of the parent body.
    parent: usize,
    /// Class of defaults around the element.
    class: Option<&'a str>,
    /// Displacement by the frames between the parent body and the element.
    frame: Isometry3<f64>,
}

impl<'a> Pending<'a> {
    /// Adds the bodies and frames in this element, which is read itself, to those to be read.
    fn push_children(&self, next: &mut Vec<Pending<'a>>) -> Result<(), Failure> {
        for child in self.element.children().rev() {
            match child.tag() {
                "body" | "frame" => next.push(Pending { element: child, ..*self }),
                "replicate" | "composite" | "flexcomp" | "attach" | "include" => {
                    return Err(child.error(format!("<{}> is not read", child.tag()), LET_MUJOCO_SAVE));
                }
                "joint" | "freejoint" | "inertial" if self.element.tag() == "frame" => {
                    return Err(child.error("the element is in a <frame>", "move it out of the <frame>"));
                }
                _ => {}
            }
        }
        Ok(())
    }
}

impl<'a> Settings<'a> {
    fn read(root: Element<'a>, remarks: &mut Vec<String>) -> Result<Self, Failure> {
        let top_class = root.all("default").find_map(|top| top.text("class")).unwrap_or(MAIN);
        let mut defaults = Vec::new();
        let mut next: Vec<Default<'_>> =
            root.all("default").rev().map(|element| Default { element, class: top_class, parent: None }).collect();
        while let Some(default) = next.pop() {
            for element in default.element.all("default").rev() {
                let class = element.required_text("class")?;
                next.push(Default { element, class, parent: Some(default.class) });
            }
            defaults.push(default);
        }
        let mut settings =
            Self { angle_unit: 1f64.to_radians(), euler_sequence: "xyz", auto_limits: true, top_class, defaults };
        for compiler in root.all("compiler") {
            match compiler.text("angle") {
                Some("radian") => settings.angle_unit = 1.0,
                Some("degree") => settings.angle_unit = 1f64.to_radians(),
                Some(_) => return Err(compiler.error_at("angle", "unknown unit", "write radian or degree")),
                None => {}
            }
            if let Some(sequence) = compiler.text("eulerseq") {
                if sequence.len() != 3 || !sequence.chars().all(|c| "xyzXYZ".contains(c)) {
                    let remedy = "write three letters of xyz (axes that turn along) or XYZ (fixed axes)";
                    return Err(compiler.error_at("eulerseq", "not a sequence of axes", remedy));
                }
                settings.euler_sequence = sequence;
            }
            settings.auto_limits = compiler.text("autolimits").map_or(settings.auto_limits, |word| word != "false");
            for (key, acts) in [
                ("coordinate", compiler.text("coordinate") == Some("global")),
                ("inertiafromgeom", compiler.text("inertiafromgeom") == Some("true")),
                ("settotalmass", compiler.number("settotalmass")?.is_some_and(|mass| mass > 0.0)),
            ] {
                if acts {
                    return Err(compiler.error_at(key, format!("{key} is not read"), LET_MUJOCO_SAVE));
                }
            }
            let bounds = ["boundmass", "boundinertia", "balanceinertia"];
            for bound in bounds.iter().filter(|key| compiler.text(key).is_some()) {
                remarks.push(format!("{bound} of <compiler> is left out."));
            }
        }
        Ok(settings)
    }

    /// Returns the element with an attribute of a joint: the joint itself, or a `<joint>` in the defaults of its class or
    /// of the closest class around that one.
    fn source(&self, joint: Element<'a>, class: &str, key: &str) -> Element<'a> {
        let has_key = |element: &Element<'_>| element.node.has_attribute(key);
        let mut class = Some(class);
        let templates = core::iter::from_fn(|| {
            let name = class?;
            // A class may stand in several elements. The last one counts.
            let own: Vec<&Default<'a>> = self.defaults.iter().rev().filter(|default| default.class == name).collect();
            class = own.iter().find_map(|default| default.parent);
            Some(own.into_iter().flat_map(|default| default.element.all("joint").rev()))
        });
        core::iter::once(joint).chain(templates.flatten()).find(has_key).unwrap_or(joint)
    }

    /// Adds the joints of a body.
    fn add_joints(
        &self,
        body: Element<'a>,
        name: &str,
        class: Option<&'a str>,
        steps: &mut Vec<Step>,
        remarks: &mut Vec<String>,
    ) -> Result<(), Failure> {
        let joints = body.children().filter(|child| ["joint", "freejoint"].contains(&child.tag()));
        for (number, joint) in joints.enumerate() {
            let class = joint.text("class").or(class).filter(|class| *class != MAIN).unwrap_or(self.top_class);
            if class != MAIN && !self.defaults.iter().any(|default| default.class == class) {
                let remedy = "name a class that a <default> defines";
                return Err(joint.error_at("class", format!("class \"{class}\" is unknown"), remedy));
            }
            let of = |key: &str| self.source(joint, class, key);
            let kind = if joint.tag() == "freejoint" { "free" } else { of("type").text("type").unwrap_or("hinge") };
            let motion = match kind {
                "hinge" => Motion::Revolute,
                "slide" => Motion::Prismatic,
                "ball" => Motion::Other("ball"),
                "free" => Motion::Other("free"),
                _ => return Err(of("type").error_at("type", "unknown type", "write hinge, slide, ball or free")),
            };
            let joint_name = joint.text("name").map_or_else(|| format!("{name}.{number}"), Into::into);
            let angle_unit = if motion == Motion::Prismatic { 1.0 } else { self.angle_unit };
            let limited = match of("limited").text("limited").unwrap_or("auto") {
                "auto" => self.auto_limits,
                word => word == "true",
            };
            let mut limits = None;
            if !matches!(motion, Motion::Other(_)) {
                limits = of("range").numbers::<2>("range")?.map(|range| range.map(|end| end * angle_unit));
            }
            if limited && limits.is_some_and(|[low, high]| low > high) {
                return Err(of("range").error_at(
                    "range",
                    "the lowest position is above the highest",
                    "exchange the two",
                ));
            }
            if of("stiffness").number("stiffness")?.is_some_and(|stiffness| stiffness != 0.0) {
                remarks.push(format!("The spring (stiffness) of joint {joint_name} is left out."));
            }
            let reference = of("ref").number("ref")?.unwrap_or(0.0) * angle_unit;
            let anchor = pose(of("pos").vector("pos")?.unwrap_or_default(), UnitQuaternion::identity());
            let joint = Joint {
                name: joint_name,
                motion,
                axis: of("axis").direction("axis")?.unwrap_or(Vector3::z_axis()),
                limits: limits.filter(|[low, high]| limited && low < high),
                viscous: of("damping").magnitude("damping")?,
                coulomb: of("frictionloss").magnitude("frictionloss")?,
                inertia: of("armature").magnitude("armature")?,
            };
            // The file shows the body at the position `ref`.
            let before = anchor * joint.displacement(-reference);
            steps.extend([Step::Fixed(before), Step::Joint(joint), Step::Fixed(anchor.inverse())]);
        }
        Ok(())
    }

    fn inertia(&self, body: Element<'a>, name: &str) -> Result<Inertia, Failure> {
        let Some(inertial) = body.one("inertial")? else {
            let reason =
                format!("body {name} has no <inertial>: MuJoCo computes one from its shapes, which are not read");
            return Err(body
                .error(reason, format!("write its <inertial> (with mass 0 for a mere frame), or {LET_MUJOCO_SAVE}")));
        };
        inertial.required_number("mass")?;
        let tensor = match (inertial.numbers::<6>("fullinertia")?, inertial.numbers::<3>("diaginertia")?) {
            (Some(full), None) => full,
            (None, Some([xx, yy, zz])) => [xx, yy, zz, 0.0, 0.0, 0.0],
            (None, None) => return Err(inertial.error("the inertia is missing", "add diaginertia or fullinertia")),
            (Some(_), Some(_)) => {
                return Err(inertial.error("diaginertia and fullinertia at once", "keep one of them"));
            }
        };
        Inertia::new(inertial, inertial.magnitude("mass")?, self.pose(inertial)?, tensor)
    }

    /// Reads position and orientation of an element.
    fn pose(&self, element: Element<'a>) -> Result<Isometry3<f64>, Failure> {
        let no_direction =
            |key: &str| element.error_at(key, format!("{key} gives no orientation"), "correct its numbers");
        let given =
            ["quat", "euler", "axisangle", "xyaxes", "zaxis"].into_iter().filter(|key| element.text(key).is_some());
        let given: Vec<&str> = given.collect();
        let rotation = match given[..] {
            [] => UnitQuaternion::identity(),
            ["quat"] => {
                let [w, i, j, k] = element.numbers("quat")?.unwrap_or_default();
                UnitQuaternion::try_new(nalgebra::Quaternion::new(w, i, j, k), 1e-9)
                    .ok_or_else(|| no_direction("quat"))?
            }
            ["euler"] => {
                let angles = element.vector("euler")?.unwrap_or_default() * self.angle_unit;
                self.euler_sequence.chars().zip(angles.iter()).fold(
                    UnitQuaternion::identity(),
                    |before, (axis, angle)| {
                        let direction = [Vector3::x_axis(), Vector3::y_axis(), Vector3::z_axis()]
                            [(axis.to_ascii_lowercase() as usize) - ('x' as usize)];
                        let turn = UnitQuaternion::from_axis_angle(&direction, *angle);
                        if axis.is_lowercase() { before * turn } else { turn * before }
                    },
                )
            }
            ["axisangle"] => {
                let [x, y, z, angle] = element.numbers("axisangle")?.unwrap_or_default();
                let axis = Unit::try_new(Vector3::new(x, y, z), 1e-9).ok_or_else(|| no_direction("axisangle"))?;
                UnitQuaternion::from_axis_angle(&axis, angle * self.angle_unit)
            }
            ["xyaxes"] => {
                let [a, b, c, d, e, f] = element.numbers("xyaxes")?.unwrap_or_default();
                let (x, y) = (Vector3::new(a, b, c), Vector3::new(d, e, f));
                let x = x.try_normalize(1e-9).ok_or_else(|| no_direction("xyaxes"))?;
                let y = (y - x * x.dot(&y)).try_normalize(1e-9).ok_or_else(|| no_direction("xyaxes"))?;
                let axes = Matrix3::from_columns(&[x, y, x.cross(&y)]);
                UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes))
            }
            ["zaxis"] => {
                let z = element.direction("zaxis")?.unwrap_or(Vector3::z_axis());
                // Half a turn about x for the opposite direction, as MuJoCo has it.
                UnitQuaternion::rotation_between_axis(&Vector3::z_axis(), &z)
                    .unwrap_or(UnitQuaternion::from_axis_angle(&Vector3::x_axis(), core::f64::consts::PI))
            }
            _ => {
                let remedy = "keep one of them";
                return Err(element.error(format!("several orientations ({})", given.join(", ")), remedy));
            }
        };
        Ok(pose(element.vector("pos")?.unwrap_or_default(), rotation))
    }
}
