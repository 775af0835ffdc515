//! Reads URDF, the Unified Robot Description Format of ROS (wiki.ros.org/urdf/XML).

use crate::tree::{Body, Inertia, Joint, Motion, Step, Tree};
use crate::xml::{Element, pose};
use haptic_host::error::Failure;
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use std::collections::BTreeMap;

/// Reads a `<robot>`.
pub(crate) fn read(robot: Element<'_>) -> Result<Tree, Failure> {
    let mut links = BTreeMap::new();
    for link in robot.all("link") {
        if links.insert(link.required_text("name")?, link).is_some() {
            return Err(link.error_at("name", "a second link of this name", "name each link differently"));
        }
    }
    let mut joints = Vec::new();
    let mut parent_joint = BTreeMap::new();
    for joint in robot.all("joint") {
        let mut ends = [""; 2];
        for (end, tag) in ends.iter_mut().zip(["parent", "child"]) {
            let element = joint.required(tag)?;
            *end = element.required_text("link")?;
            if !links.contains_key(*end) {
                return Err(element.error_at("link", format!("no <link> is named \"{end}\""), "correct the name"));
            }
        }
        let [parent, child] = ends;
        if parent_joint.insert(child, joint).is_some() {
            return Err(joint.error(
                format!("link \"{child}\" has two parents: a closed loop, which a chain cannot describe"),
                "remove one of the joints",
            ));
        }
        joints.push((parent, child, joint));
    }
    let roots: Vec<&str> = robot.all("link").filter_map(|link| link.text("name")).collect();
    let roots: Vec<&str> = roots.into_iter().filter(|name| !parent_joint.contains_key(name)).collect();
    let [root] = roots[..] else {
        let reason = format!("{} links have no parent ({})", roots.len(), roots.join(", "));
        return Err(robot.error(reason, "connect the links by joints to one tree"));
    };

    let mut tree = Tree {
        name: robot.text("name").unwrap_or_default().into(),
        format: "URDF",
        bodies: Vec::with_capacity(links.len()),
        gravity: Vector3::new(0.0, 0.0, -9.81),
        remarks: vec!["URDF has no rotor inertia: `inertia` of each joint is 0 here, write yours.".into()],
    };
    // Links to visit, with the index of the parent. The last comes first.
    let mut next: Vec<(&str, Option<usize>)> = vec![(root, None)];
    while let Some((name, parent)) = next.pop() {
        let steps = parent_joint.get(name).map_or(Ok(Vec::new()), |joint| steps(*joint))?;
        let children = joints.iter().rev().filter(|(parent, ..)| *parent == name);
        next.extend(children.map(|(_, child, _)| (*child, Some(tree.bodies.len()))));
        tree.bodies.push(Body { name: name.into(), parent, steps, inertia: inertia(links[name])? });
    }
    if let Some((_, child, joint)) = joints.iter().find(|(_, child, _)| !tree.bodies.iter().any(|b| b.name == *child)) {
        let reason = format!("link \"{child}\" is not connected to \"{root}\": the joints form a closed loop");
        return Err(joint.error(reason, "correct the parents"));
    }
    Ok(tree)
}

fn steps(joint: Element<'_>) -> Result<Vec<Step>, Failure> {
    let name = joint.required_text("name")?;
    let kind = joint.required_text("type")?;
    let fixed = Step::Fixed(origin(joint)?);
    let motion = match kind {
        "fixed" => return Ok(vec![fixed]),
        "revolute" | "continuous" => Motion::Revolute,
        "prismatic" => Motion::Prismatic,
        "floating" => Motion::Other("floating"),
        "planar" => Motion::Other("planar"),
        _ => {
            let remedy = "write revolute, continuous, prismatic or fixed";
            return Err(joint.error_at("type", format!("type \"{kind}\" is unknown"), remedy));
        }
    };
    if let Some(mimic) = joint.one("mimic")? {
        return Err(mimic.error(
            "the joint repeats another joint's motion, which a chain cannot describe",
            "remove <mimic> (the joint is then a joint of its own) or write type=\"fixed\"",
        ));
    }
    let axis = joint.one("axis")?.map_or(Ok(None), |axis| axis.direction("xyz"))?;
    let mut limits = None;
    if let (Some(limit), true) = (joint.one("limit")?, kind != "continuous") {
        let ends = [limit.number("lower")?.unwrap_or(0.0), limit.number("upper")?.unwrap_or(0.0)];
        if ends[0] > ends[1] {
            return Err(limit.error("lower is above upper", "exchange the two"));
        }
        limits = (ends[0] < ends[1]).then_some(ends);
    }
    let dynamics = joint.one("dynamics")?;
    let friction = |key| dynamics.map_or(Ok(0.0), |dynamics| dynamics.magnitude(key));
    let joint = Joint {
        name: name.into(),
        motion,
        axis: axis.unwrap_or(Vector3::x_axis()),
        limits,
        viscous: friction("damping")?,
        coulomb: friction("friction")?,
        inertia: 0.0,
    };
    Ok(vec![fixed, Step::Joint(joint)])
}

/// Reads the `<origin>` in an element.
fn origin(element: Element<'_>) -> Result<Isometry3<f64>, Failure> {
    let Some(origin) = element.one("origin")? else { return Ok(Isometry3::identity()) };
    let [roll, pitch, yaw] = origin.numbers("rpy")?.unwrap_or_default();
    Ok(pose(origin.vector("xyz")?.unwrap_or_default(), UnitQuaternion::from_euler_angles(roll, pitch, yaw)))
}

fn inertia(link: Element<'_>) -> Result<Inertia, Failure> {
    let Some(inertial) = link.one("inertial")? else { return Ok(Inertia::default()) };
    let (mass, tensor) = (inertial.required("mass")?, inertial.required("inertia")?);
    mass.required_number("value")?;
    let mut values = [0.0; 6];
    for (value, key) in values.iter_mut().zip(["ixx", "iyy", "izz", "ixy", "ixz", "iyz"]) {
        *value = tensor.required_number(key)?;
    }
    Inertia::new(tensor, mass.magnitude("value")?, origin(inertial)?, values)
}
