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
            return Err(link.error("name", "a second link of this name", "name each link differently"));
        }
    }
    // Parent and joint of each link with a parent, and the children of each link in the order of the file.
    let mut above = BTreeMap::new();
    let mut children: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for joint in robot.all("joint") {
        let mut ends = [""; 2];
        for (end, tag) in ends.iter_mut().zip(["parent", "child"]) {
            let element = joint.required(tag)?;
            *end = element.required_text("link")?;
            if !links.contains_key(*end) {
                return Err(element.error("link", format!("no <link> is named \"{end}\""), "correct the name"));
            }
        }
        let [parent, child] = ends;
        if above.insert(child, joint).is_some() {
            let reason = format!("link \"{child}\" has two parents: a closed loop, which a chain cannot describe");
            return Err(joint.error("", reason, "remove one of the joints"));
        }
        children.entry(parent).or_default().push(child);
    }
    let roots: Vec<&str> = links.keys().filter(|name| !above.contains_key(*name)).copied().collect();
    let [root] = roots[..] else {
        let reason = format!("{} links have no parent ({})", roots.len(), roots.join(", "));
        return Err(robot.error("", reason, "connect the links by joints to one tree"));
    };

    let mut bodies = Vec::with_capacity(links.len());
    // Links to be read, with the index of the parent. The last comes first.
    let mut next = vec![(root, None)];
    while let Some((name, parent)) = next.pop() {
        let steps = above.remove(name).map_or(Ok(Vec::new()), steps)?;
        let below = children.get(name).into_iter().flatten().rev();
        next.extend(below.map(|child| (*child, Some(bodies.len()))));
        bodies.push(Body { name: name.into(), parent, steps, inertia: inertia(links[name])? });
    }
    if let Some((child, joint)) = above.first_key_value() {
        let reason = format!("link \"{child}\" is not connected to \"{root}\": the joints form a closed loop");
        return Err(joint.error("", reason, "correct the parents"));
    }
    let remarks = vec!["URDF has no rotor inertia: `inertia` of each joint is 0 here, write yours.".into()];
    let name = robot.text("name").unwrap_or_default().into();
    Ok(Tree { name, bodies, gravity: Vector3::new(0.0, 0.0, -9.81), remarks })
}

/// Reads the way from a parent through a joint.
fn steps(joint: Element<'_>) -> Result<Vec<Step>, Failure> {
    let fixed = Step::Fixed(origin(joint)?);
    let kind = joint.required_text("type")?;
    let motion = match kind {
        "fixed" => return Ok(vec![fixed]),
        "revolute" | "continuous" => Motion::Revolute,
        "prismatic" => Motion::Prismatic,
        "floating" | "planar" => Motion::Other,
        _ => {
            let remedy = "write revolute, continuous, prismatic or fixed";
            return Err(joint.error("type", format!("type \"{kind}\" is unknown"), remedy));
        }
    };
    if let Some(mimic) = joint.one("mimic")? {
        let reason = "the joint repeats another joint's motion, which a chain cannot describe";
        let remedy = "remove <mimic> (the joint is then a joint of its own) or write type=\"fixed\"";
        return Err(mimic.error("", reason, remedy));
    }
    let axis = joint.one("axis")?.map_or(Ok(None), |axis| axis.direction("xyz"))?.unwrap_or(Vector3::x_axis());
    let mut limits = None;
    if let (Some(limit), true) = (joint.one("limit")?, kind != "continuous") {
        let ends = [limit.number("lower")?.unwrap_or(0.0), limit.number("upper")?.unwrap_or(0.0)];
        if ends[0] > ends[1] {
            return Err(limit.error("", "lower is above upper", "exchange the two"));
        }
        limits = (ends[0] < ends[1]).then_some(ends);
    }
    let dynamics = joint.one("dynamics")?;
    let friction = |key| dynamics.map_or(Ok(0.0), |dynamics| dynamics.magnitude(key));
    let (viscous, coulomb) = (friction("damping")?, friction("friction")?);
    let name = joint.required_text("name")?.into();
    Ok(vec![fixed, Step::Joint(Joint { name, motion, axis, limits, viscous, coulomb, inertia: 0.0 })])
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
    mass.required_text("value")?;
    let mut values = [0.0; 6];
    for (value, key) in values.iter_mut().zip(["ixx", "iyy", "izz", "ixy", "ixz", "iyz"]) {
        tensor.required_text(key)?;
        *value = tensor.number(key)?.unwrap_or_default();
    }
    Inertia::new(tensor, mass.magnitude("value")?, origin(inertial)?, values)
}
