//! The chain of a tree: the path to the tip, with everything beside it merged, and the coordinates of the tip.

use crate::tree::{Inertia, Joint, Motion, Step, Tree};
use haptic_host::error::{Choice, Failure};
use nalgebra::{DMatrix, Isometry3, Point3, Vector3};
use std::path::Path;

/// Largest number of joints in a chain.
pub const MAX_JOINTS: usize = 3;

/// Parts of a tree that the user chooses.
#[derive(Clone, Debug, Default)]
pub struct Selection {
    /// Name of the body whose origin is the tip; by default the last body of the longest path.
    pub tip: Option<String>,
    /// Names of the joints that move, in any order; by default all on the path.
    pub joints: Vec<String>,
}

/// A chain of one to three joints.
#[derive(Clone, Debug)]
pub struct Chain {
    /// Name of the robot; empty if the file has none.
    pub name: String,
    /// Links with their joints, from the base.
    pub links: Vec<Link>,
    /// The tip in the frame of the last link, m.
    pub tip: Point3<f64>,
    /// Coordinates of the tip that walls act on, 0 to 2 for x, y and z of the base.
    pub task: Vec<usize>,
    /// Gravity in the frame of the base, m/s².
    pub gravity: Vector3<f64>,
    /// Sentences for the user: everything that was merged, held or left out.
    pub remarks: Vec<String>,
}

/// A link of a chain, with the joint that moves it. Both have the same frame.
#[derive(Clone, Debug)]
pub struct Link {
    /// Names of the merged bodies.
    pub bodies: Vec<String>,
    /// The joint.
    pub joint: Joint,
    /// Joint frame in the frame of the link before, or of the base, at the position zero.
    pub origin: Isometry3<f64>,
    /// Inertia of the link.
    pub inertia: Inertia,
}

impl Tree {
    /// Returns the chain to the tip. `origin` is the file for error messages.
    pub fn chain(&self, selection: &Selection, origin: &Path) -> Result<Chain, Failure> {
        let wrong = |reason: String| Failure::wrong(format!("{}: {reason}", origin.display()));
        let (tip, tip_remark) = self.tip(selection.tip.as_deref()).map_err(wrong).map_err(|error| {
            let bodies: Vec<&str> = self.bodies.iter().map(|body| body.name.as_str()).collect();
            error.remedy(format!("the file has {}", listed(&bodies))).choose(Choice::Tip)
        })?;
        let mut on_path = vec![false; self.bodies.len()];
        let mut body = Some(tip);
        while let Some(index) = body {
            on_path[index] = true;
            body = self.bodies[index].parent;
        }
        let joints_on_path: Vec<&Joint> = (0..self.bodies.len())
            .filter(|index| on_path[*index])
            .flat_map(|index| self.bodies[index].joints())
            .filter(|joint| !matches!(joint.motion, Motion::Other(_)))
            .collect();
        let names: Vec<&str> = joints_on_path.iter().map(|joint| joint.name.as_str()).collect();
        let choose = |reason: String| {
            let remedy = format!("choose up to {MAX_JOINTS} of {}", listed(&names));
            wrong(reason).remedy(remedy).choose(Choice::Joints)
        };
        let tip_name = &self.bodies[tip].name;
        if names.is_empty() {
            let reason = format!("no revolute or prismatic joint moves the tip {tip_name}");
            return Err(wrong(reason).remedy("choose a tip that a joint moves").choose(Choice::Tip));
        }
        let chosen: Vec<&str> = match &selection.joints[..] {
            [] => names.clone(),
            joints => joints.iter().map(String::as_str).collect(),
        };
        if let Some(unknown) = chosen.iter().find(|name| !names.contains(name)) {
            return Err(choose(format!("no joint \"{unknown}\" is between the base and the tip {tip_name}")));
        }
        if let Some(twice) = (1..chosen.len()).find(|index| chosen[..*index].contains(&chosen[*index])) {
            return Err(choose(format!("joint \"{}\" is chosen twice", chosen[twice])));
        }
        if chosen.len() > MAX_JOINTS {
            return Err(choose(format!("{} joints move the tip {tip_name}", chosen.len())));
        }

        let mut links: Vec<Link> = Vec::new();
        // Number of links up to each body, and the body's frame in the last of them.
        let mut frames: Vec<(usize, Isometry3<f64>)> = Vec::with_capacity(self.bodies.len());
        let (mut held, mut dropped_rotors, mut massless, mut at_rest) =
            (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for (index, body) in self.bodies.iter().enumerate() {
            let (mut count, mut frame) = body.parent.map_or((0, Isometry3::identity()), |parent| frames[parent]);
            for step in &body.steps {
                match step {
                    Step::Fixed(displacement) => frame *= displacement,
                    Step::Joint(joint) if on_path[index] && chosen.contains(&joint.name.as_str()) => {
                        let joint = joint.clone();
                        links.push(Link { bodies: Vec::new(), joint, origin: frame, inertia: Inertia::default() });
                        (count, frame) = (links.len(), Isometry3::identity());
                    }
                    Step::Joint(joint) => {
                        let outside = joint.limits.is_some_and(|[low, high]| low > 0.0 || high < 0.0);
                        held.push(format!("{}{}", joint.name, if outside { " (outside its limits)" } else { "" }));
                        if joint.inertia > 0.0 {
                            dropped_rotors.push(joint.name.as_str());
                        }
                    }
                }
            }
            frames.push((count, frame));
            match count.checked_sub(1) {
                None => at_rest.push(body.name.as_str()),
                Some(link) => {
                    links[link].inertia = links[link].inertia.joined(&body.inertia.moved(&frame));
                    links[link].bodies.push(body.name.clone());
                    if body.inertia == Inertia::default() {
                        massless.push(body.name.as_str());
                    }
                }
            }
        }

        let mut remarks = vec![tip_remark];
        let mut remark = |what: &str, names: &[&str]| {
            if !names.is_empty() {
                remarks.push(format!("{what}: {}.", names.join(", ")));
            }
        };
        remark("At rest with the base", &at_rest);
        remark("Held at zero", &held.iter().map(String::as_str).collect::<Vec<_>>());
        remark("Rotor inertia left out with the joints held", &dropped_rotors);
        remark("Massless in the file", &massless);
        let moved = |link: usize| links[link..].iter().any(|link| link.inertia != Inertia::default());
        let still: Vec<&str> = (0..links.len())
            .filter(|link| links[*link].joint.inertia == 0.0 && !moved(*link))
            .map(|link| links[link].joint.name.as_str())
            .collect();
        remark("No mass and no rotor inertia, which the device needs, on the joints", &still);
        remarks.extend(self.remarks.iter().cloned());
        let tip = Point3::from(frames[tip].1.translation.vector);
        let mut chain = Chain { name: self.name.clone(), links, tip, task: Vec::new(), gravity: self.gravity, remarks };
        chain.task = chain.find_task().ok_or_else(|| {
            let reason = format!("the joints do not move the tip {tip_name} in as many directions as there are joints");
            choose(reason)
        })?;
        Ok(chain)
    }

    /// Returns the index of the tip and a remark about it, or the reason why there is none.
    fn tip(&self, name: Option<&str>) -> Result<(usize, String), String> {
        if let Some(name) = name {
            let found = self.bodies.iter().position(|body| body.name == name);
            let remark = format!("Tip: origin of {name}.");
            return found.map(|tip| (tip, remark)).ok_or_else(|| format!("no body is named \"{name}\""));
        }
        let mut depths: Vec<usize> = Vec::with_capacity(self.bodies.len());
        for body in &self.bodies {
            depths.push(body.parent.map_or(0, |parent| depths[parent] + 1));
        }
        let longest = depths.iter().copied().max().unwrap_or(0);
        let deepest: Vec<usize> = (0..depths.len()).filter(|index| depths[*index] == longest).collect();
        let tip = *deepest.first().ok_or("the file has no body")?;
        let others = match deepest.len() - 1 {
            0 => String::new(),
            others => format!(", the first of {} that are as far", others + 1),
        };
        Ok((tip, format!("Tip: origin of {}, at the end of the longest path{others}.", self.bodies[tip].name)))
    }
}

impl crate::tree::Body {
    fn joints(&self) -> impl Iterator<Item = &Joint> {
        self.steps.iter().filter_map(|step| match step {
            Step::Joint(joint) => Some(joint),
            Step::Fixed(_) => None,
        })
    }
}

impl Chain {
    /// Returns the Jacobian of the tip (x, y, z of the base; one column for each joint) at the joint positions `q`.
    pub fn jacobian(&self, q: &[f64]) -> DMatrix<f64> {
        let mut frame = Isometry3::identity();
        let frames: Vec<Isometry3<f64>> = (self.links.iter().zip(q))
            .map(|(link, q)| {
                frame *= link.origin * link.joint.displacement(*q);
                frame
            })
            .collect();
        let tip = frame * self.tip;
        let mut jacobian = DMatrix::zeros(3, self.links.len());
        for (index, (link, frame)) in self.links.iter().zip(&frames).enumerate() {
            let axis = frame * link.joint.axis.into_inner();
            let column = match link.joint.motion {
                Motion::Prismatic => axis,
                _ => axis.cross(&(tip - Point3::from(frame.translation.vector))),
            };
            jacobian.set_column(index, &column);
        }
        jacobian
    }

    /// Returns the first coordinates in which the joints move the tip in all directions, in the zero pose or, if there
    /// are none, in a bent pose.
    fn find_task(&self) -> Option<Vec<usize>> {
        /// Smallest singular value of a task's Jacobian, as a share of the largest one of all three coordinates. Files
        /// write a right angle as 1.5708, an error of 4e-6.
        const SMALLEST: f64 = 1e-3;
        let joints = self.links.len();
        let tasks: &[&[usize]] = match joints {
            1 => &[&[0], &[1], &[2]],
            2 => &[&[0, 1], &[0, 2], &[1, 2]],
            _ => &[&[0, 1, 2]],
        };
        let bent = self.links.iter().enumerate().map(|(index, link)| {
            let angle = 0.5 + 0.3 * index as f64;
            if link.joint.motion == Motion::Prismatic { 0.1 * angle } else { angle }
        });
        [vec![0.0; joints], bent.collect()].iter().find_map(|q| {
            let jacobian = self.jacobian(q);
            let largest = jacobian.singular_values().max();
            let spans =
                |task: &&&[usize]| jacobian.select_rows(task.iter()).singular_values().min() > SMALLEST * largest;
            tasks.iter().find(spans).map(|task| task.to_vec())
        })
    }
}

/// Lists names for a message, twelve at most.
fn listed(names: &[&str]) -> String {
    let dots = if names.len() > 12 { ", …" } else { "" };
    format!("{}{dots}", names.iter().take(12).copied().collect::<Vec<_>>().join(", "))
}
