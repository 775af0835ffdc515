//! Reads MJCF, the models of MuJoCo (mujoco.readthedocs.io/en/stable/XMLreference.html).

use crate::tree::{Body, Inertia, Joint, Motion, Step, Tree};
use crate::xml::{Element, pose};
use haptic_host::error::Failure;
use nalgebra::{Isometry3, Quaternion, Unit, UnitQuaternion, Vector3};
use std::collections::BTreeSet;

/// Way to a file without what only MuJoCo computes.
const LET_MUJOCO_SAVE: &str = "let MuJoCo write a plain file (write saveinertial=\"true\" into <compiler>, then `Save xml` \
                               of its program simulate, or mujoco.mj_saveLastXML in Python) and convert that file";

/// Class of the defaults that apply everywhere.
const MAIN: &str = "main";

/// Settings of the whole file.
struct Settings<'a> {
    /// Radians per unit of angle.
    angle_unit: f64,
    euler_sequence: &'a str,
    /// A range alone limits a joint.
    auto_limits: bool,
    defaults: Vec<Default<'a>>,
}

/// A `<default>` element with its class and the class around it.
struct Default<'a> {
    element: Element<'a>,
    class: &'a str,
    parent: Option<&'a str>,
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

/// Reads a `<mujoco>`.
pub(crate) fn read(root: Element<'_>) -> Result<Tree, Failure> {
    if let Some(include) = root.all("include").next() {
        return Err(include.error("", "other files are not read", LET_MUJOCO_SAVE));
    }
    let settings = Settings::read(root)?;
    let mut gravity = Vector3::new(0.0, 0.0, -9.81);
    for option in root.all("option") {
        gravity = option.vector("gravity")?.unwrap_or(gravity);
    }
    let unread = ["equality", "tendon"].into_iter().filter(|tag| root.all(tag).any(|all| all.children().count() > 0));
    let mut remarks: Vec<String> = unread.map(|tag| format!("<{tag}> is left out.")).collect();
    let world = Body { name: "world".into(), parent: None, steps: Vec::new(), inertia: Inertia::default() };
    let mut bodies = vec![world];
    let mut names = BTreeSet::from(["world".to_owned()]);
    // The last comes first.
    let mut next: Vec<Pending<'_>> = Vec::new();
    for element in root.all("worldbody").rev() {
        let class = element.text("childclass");
        Pending { element, parent: 0, class, frame: Isometry3::identity() }.push_children(&mut next)?;
    }
    while let Some(Pending { element, mut parent, class, frame }) = next.pop() {
        let class = element.text("childclass").or(class);
        let mut frame = frame * settings.pose(element)?;
        if element.tag() == "body" {
            let name = element.text("name").map_or_else(|| format!("body{}", bodies.len()), Into::into);
            if !names.insert(name.clone()) {
                return Err(element.error("", "a second body of this name", "name each body differently"));
            }
            let mut steps = vec![Step::Fixed(frame)];
            settings.add_joints(element, &name, class, &mut steps, &mut remarks)?;
            if element.magnitude("gravcomp")? > 0.0 {
                remarks.push(format!("gravcomp of {name} is left out: the body has its full weight here."));
            }
            let inertia = settings.inertia(element, &name)?;
            bodies.push(Body { name, parent: Some(parent), steps, inertia });
            (parent, frame) = (bodies.len() - 1, Isometry3::identity());
        }
        Pending { element, parent, class, frame }.push_children(&mut next)?;
    }
    Ok(Tree { name: root.text("model").unwrap_or_default().into(), bodies, gravity, remarks })
}

impl<'a> Pending<'a> {
    /// Adds the bodies and frames in this element, which is read itself, to those to be read.
    fn push_children(&self, next: &mut Vec<Pending<'a>>) -> Result<(), Failure> {
        for child in self.element.children().rev() {
            match child.tag() {
                "body" | "frame" => next.push(Pending { element: child, ..*self }),
                "replicate" | "composite" | "flexcomp" | "attach" | "include" => {
                    return Err(child.error("", "this element is not read", LET_MUJOCO_SAVE));
                }
                "joint" | "freejoint" | "inertial" if self.element.tag() == "frame" => {
                    return Err(child.error("", "the element is in a <frame>", "move it out of the <frame>"));
                }
                _ => {}
            }
        }
        Ok(())
    }
}

impl<'a> Settings<'a> {
    fn read(root: Element<'a>) -> Result<Self, Failure> {
        let (mut angle_unit, mut euler_sequence, mut auto_limits) = (1f64.to_radians(), "xyz", true);
        for compiler in root.all("compiler") {
            match compiler.text("angle") {
                Some("radian") => angle_unit = 1.0,
                Some("degree") => angle_unit = 1f64.to_radians(),
                Some(_) => return Err(compiler.error("angle", "unknown unit", "write radian or degree")),
                None => {}
            }
            euler_sequence = compiler.text("eulerseq").unwrap_or(euler_sequence);
            if euler_sequence.len() != 3 || !euler_sequence.chars().all(|c| "xyzXYZ".contains(c)) {
                let remedy = "write three letters of xyz (axes that turn along) or XYZ (fixed axes)";
                return Err(compiler.error("eulerseq", "not a sequence of axes", remedy));
            }
            auto_limits = compiler.text("autolimits").map_or(auto_limits, |word| word != "false");
            let total = compiler.number("settotalmass")?.is_some_and(|mass| mass > 0.0);
            for (key, acts) in [
                ("coordinate", compiler.text("coordinate") == Some("global")),
                ("inertiafromgeom", compiler.text("inertiafromgeom") == Some("true")),
                ("settotalmass", total),
            ] {
                if acts {
                    return Err(compiler.error(key, format!("{key} is not read"), LET_MUJOCO_SAVE));
                }
            }
        }
        let top = |element| Default { element, class: MAIN, parent: None };
        let mut next: Vec<Default<'_>> = root.all("default").rev().map(top).collect();
        let mut defaults = Vec::new();
        while let Some(default) = next.pop() {
            for element in default.element.all("default").rev() {
                next.push(Default { element, class: element.required_text("class")?, parent: Some(default.class) });
            }
            defaults.push(default);
        }
        Ok(Self { angle_unit, euler_sequence, auto_limits, defaults })
    }

    /// Returns the element with an attribute of a joint: the joint itself, or a `<joint>` in the defaults of its class or
    /// of the closest class around that one.
    fn source(&self, joint: Element<'a>, class: &str, key: &str) -> Element<'a> {
        let mut class = Some(class);
        let templates = core::iter::from_fn(|| {
            let name = class?;
            // A class may stand in several elements. The last one counts.
            let own: Vec<&Default<'a>> = self.defaults.iter().rev().filter(|default| default.class == name).collect();
            class = own.iter().find_map(|default| default.parent);
            Some(own.into_iter().flat_map(|default| default.element.all("joint").rev()))
        });
        let has_key = |element: &Element<'_>| element.node.has_attribute(key);
        core::iter::once(joint).chain(templates.flatten()).find(has_key).unwrap_or(joint)
    }

    /// Adds the joints of a body.
    fn add_joints(
        &self,
        body: Element<'a>,
        body_name: &str,
        class: Option<&'a str>,
        steps: &mut Vec<Step>,
        remarks: &mut Vec<String>,
    ) -> Result<(), Failure> {
        let joints = body.children().filter(|child| ["joint", "freejoint"].contains(&child.tag()));
        for (number, joint) in joints.enumerate() {
            let class = joint.text("class").or(class).unwrap_or(MAIN);
            if class != MAIN && !self.defaults.iter().any(|default| default.class == class) {
                let remedy = "name a class that a <default> defines";
                return Err(joint.error("class", format!("class \"{class}\" is unknown"), remedy));
            }
            let of = |key: &str| self.source(joint, class, key);
            let motion = match of("type").text("type").unwrap_or("hinge") {
                _ if joint.tag() == "freejoint" => Motion::Other,
                "hinge" => Motion::Revolute,
                "slide" => Motion::Prismatic,
                "ball" | "free" => Motion::Other,
                _ => return Err(of("type").error("type", "unknown type", "write hinge, slide, ball or free")),
            };
            let name = joint.text("name").map_or_else(|| format!("{body_name}.{number}"), Into::into);
            let unit = if motion == Motion::Prismatic { 1.0 } else { self.angle_unit };
            let limited = match of("limited").text("limited") {
                None | Some("auto") => self.auto_limits,
                Some(word) => word == "true",
            };
            let mut limits = None;
            if limited && motion != Motion::Other {
                limits = of("range").numbers::<2>("range")?.map(|range| range.map(|end| end * unit));
            }
            if limits.is_some_and(|[low, high]| low > high) {
                return Err(of("range").error("range", "the lowest position is above the highest", "exchange the two"));
            }
            if of("stiffness").magnitude("stiffness")? > 0.0 {
                remarks.push(format!("The spring (stiffness) of joint {name} is left out."));
            }
            let reference = of("ref").number("ref")?.unwrap_or(0.0) * unit;
            let anchor = pose(of("pos").vector("pos")?.unwrap_or_default(), UnitQuaternion::identity());
            let joint = Joint {
                name,
                motion,
                axis: of("axis").direction("axis")?.unwrap_or(Vector3::z_axis()),
                limits: limits.filter(|[low, high]| low < high),
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
            return Err(body.error("", reason, format!("write it (mass 0 for a mere frame), or {LET_MUJOCO_SAVE}")));
        };
        inertial.required_text("mass")?;
        let tensor = match (inertial.numbers::<6>("fullinertia")?, inertial.numbers::<3>("diaginertia")?) {
            (Some(full), None) => full,
            (None, Some([xx, yy, zz])) => [xx, yy, zz, 0.0, 0.0, 0.0],
            _ => return Err(inertial.error("", "not one inertia", "write either diaginertia or fullinertia")),
        };
        Inertia::new(inertial, inertial.magnitude("mass")?, self.pose(inertial)?, tensor)
    }

    /// Reads position and orientation of an element.
    fn pose(&self, element: Element<'a>) -> Result<Isometry3<f64>, Failure> {
        let keys = ["quat", "euler", "axisangle", "xyaxes", "zaxis"];
        let given: Vec<&str> = keys.into_iter().filter(|key| element.text(key).is_some()).collect();
        let rotation = match given[..] {
            [] => UnitQuaternion::identity(),
            ["quat"] => {
                let [w, i, j, k] = element.numbers("quat")?.unwrap_or_default();
                let zero = || element.error("quat", "quat gives no orientation", "write a quaternion that is not zero");
                UnitQuaternion::try_new(Quaternion::new(w, i, j, k), 1e-9).ok_or_else(zero)?
            }
            ["euler"] => {
                let angles = element.vector("euler")?.unwrap_or_default() * self.angle_unit;
                let turns = self.euler_sequence.chars().zip(angles.iter()).map(|(axis, angle)| {
                    let index = usize::from(axis.to_ascii_lowercase() as u8 - b'x');
                    let direction = [Vector3::x_axis(), Vector3::y_axis(), Vector3::z_axis()][index];
                    (axis.is_lowercase(), UnitQuaternion::from_axis_angle(&direction, *angle))
                });
                turns.fold(UnitQuaternion::identity(), |all, (along, turn)| if along { all * turn } else { turn * all })
            }
            ["axisangle"] => {
                let [x, y, z, angle] = element.numbers("axisangle")?.unwrap_or_default();
                let zero = || element.error("axisangle", "the axis has no direction", "write an axis that is not zero");
                let axis = Unit::try_new(Vector3::new(x, y, z), 1e-9).ok_or_else(zero)?;
                UnitQuaternion::from_axis_angle(&axis, angle * self.angle_unit)
            }
            _ => {
                let reason = format!("the orientation by {} is not read", given.join(" and "));
                return Err(element.error(given[0], reason, "write one quat"));
            }
        };
        Ok(pose(element.vector("pos")?.unwrap_or_default(), rotation))
    }
}
