//! The chain of a tree: the path to the tip, with everything beside it merged, and the coordinates of the tip.

use crate::Selection;
use crate::tree::{Inertia, Joint, Motion, Step, Tree};
use haptic_host::error::{Choice, Failure};
use nalgebra::{DMatrix, Isometry3, Point3, Vector3};
use std::path::Path;

const MAX_JOINTS: usize = 3;

/// A chain of one to three joints.
pub(crate) struct Chain {
    pub name: String,
    pub links: Vec<Link>,
    /// The tip in the frame of the last link, m.
    pub tip: Point3<f64>,
    /// Coordinates of the tip that walls act on, 0 to 2 for x, y and z of the base.
    pub task: Vec<usize>,
    pub gravity: Vector3<f64>,
    /// Sentences about everything that was merged, held or left out.
    pub remarks: Vec<String>,
}

/// A link of a chain, with the joint that moves it. Both have the same frame.
pub(crate) struct Link {
    /// Names of the merged bodies.
    pub bodies: Vec<String>,
    pub joint: Joint,
    /// Joint frame in the frame of the link before, or of the base, at the position zero.
    pub origin: Isometry3<f64>,
    pub inertia: Inertia,
}

impl Tree {
    /// Returns the chain to the tip. `origin` is the file for error messages.
    pub fn chain(&self, selection: &Selection, origin: &Path) -> Result<Chain, Failure> {
        let wrong = |reason: String| Failure::wrong(format!("{}: {reason}", origin.display()));
        let mut depths: Vec<usize> = Vec::with_capacity(self.bodies.len());
        for body in &self.bodies {
            depths.push(body.parent.map_or(0, |parent| depths[parent] + 1));
        }
        let tip = match &selection.tip {
            Some(name) => self.bodies.iter().position(|body| body.name == *name).ok_or_else(|| {
                let bodies: Vec<&str> = self.bodies.iter().map(|body| body.name.as_str()).collect();
                let remedy = format!("the file has {}", listed(&bodies));
                wrong(format!("no body is named \"{name}\"")).remedy(remedy).choose(Choice::Tip)
            })?,
            None => depths.iter().position(|depth| Some(depth) == depths.iter().max()).unwrap_or(0),
        };
        let tip_name = &self.bodies[tip].name;
        let mut on_path = vec![false; self.bodies.len()];
        let mut body = Some(tip);
        while let Some(index) = body {
            on_path[index] = true;
            body = self.bodies[index].parent;
        }
        let path = self.bodies.iter().zip(&on_path).filter(|(_, on_path)| **on_path);
        let names: Vec<&str> = path
            .flat_map(|(body, _)| &body.steps)
            .filter_map(|step| match step {
                Step::Joint(joint) if joint.motion != Motion::Other => Some(joint.name.as_str()),
                _ => None,
            })
            .collect();
        if names.is_empty() {
            let failure = wrong(format!("no revolute or prismatic joint moves the tip {tip_name}"));
            return Err(failure.remedy("choose a tip that a joint moves").choose(Choice::Tip));
        }
        let choose = |reason: String| {
            let remedy = format!("choose up to {MAX_JOINTS} of {}", listed(&names));
            Err(wrong(reason).remedy(remedy).choose(Choice::Joints))
        };
        let mut chosen: Vec<&str> = selection.joints.iter().map(String::as_str).collect();
        if chosen.is_empty() {
            chosen.clone_from(&names);
        }
        if let Some(unknown) = chosen.iter().find(|name| !names.contains(name)) {
            return choose(format!("no joint \"{unknown}\" is between the base and the tip {tip_name}"));
        }
        if let Some(twice) = (1..chosen.len()).find(|index| chosen[..*index].contains(&chosen[*index])) {
            return choose(format!("joint \"{}\" is chosen twice", chosen[twice]));
        }
        if chosen.len() > MAX_JOINTS {
            return choose(format!("{} joints move the tip {tip_name}", chosen.len()));
        }

        let mut links: Vec<Link> = Vec::new();
        // Number of links up to each body, and the body's frame in the last of them.
        let mut frames: Vec<(usize, Isometry3<f64>)> = Vec::with_capacity(self.bodies.len());
        let [mut held, mut dropped_rotors, mut massless, mut at_rest]: [Vec<String>; 4] = Default::default();
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
                        dropped_rotors.extend((joint.inertia > 0.0).then(|| joint.name.clone()));
                    }
                }
            }
            frames.push((count, frame));
            let Some(link) = count.checked_sub(1).map(|link| &mut links[link]) else {
                at_rest.push(body.name.clone());
                continue;
            };
            link.inertia = link.inertia.joined(&body.inertia.moved(&frame));
            link.bodies.push(body.name.clone());
            massless.extend((body.inertia == Inertia::default()).then(|| body.name.clone()));
        }

        let is_still = |link: usize| {
            links[link].joint.inertia == 0.0 && links[link..].iter().all(|link| link.inertia == Inertia::default())
        };
        let still =
            (0..links.len()).filter(|link| is_still(*link)).map(|link| links[link].joint.name.clone()).collect();
        let as_far = depths.iter().filter(|depth| **depth == depths[tip]).count();
        let others = if as_far > 1 { format!("; {} others are as far", as_far - 1) } else { String::new() };
        let mut remarks = vec![match selection.tip {
            Some(_) => format!("Tip: origin of {tip_name}."),
            None => format!("Tip: origin of {tip_name}, the last of the longest path{others}."),
        }];
        for (what, names) in [
            ("At rest with the base", at_rest),
            ("Held at zero", held),
            ("Rotor inertia left out with the joints held", dropped_rotors),
            ("Massless in the file", massless),
            ("Without mass and rotor inertia, which the device needs, are the joints", still),
        ] {
            remarks.extend((!names.is_empty()).then(|| format!("{what}: {}.", names.join(", "))));
        }
        remarks.extend(self.remarks.iter().cloned());
        let tip = Point3::from(frames[tip].1.translation.vector);
        let mut chain = Chain { name: self.name.clone(), links, tip, task: Vec::new(), gravity: self.gravity, remarks };
        let Some(task) = chain.find_task() else {
            let reason = format!("the joints do not move the tip {tip_name} in as many directions as there are joints");
            return choose(reason);
        };
        chain.task = task;
        Ok(chain)
    }
}

impl Chain {
    /// Returns the Jacobian of the tip (x, y, z of the base; one column for each joint) at the joint positions `q`.
    fn jacobian(&self, q: &[f64]) -> DMatrix<f64> {
        let mut frame = Isometry3::identity();
        let mut axes = Vec::new();
        for (link, q) in self.links.iter().zip(q) {
            frame *= link.origin * link.joint.displacement(*q);
            axes.push((link.joint.motion, frame * link.joint.axis.into_inner(), frame.translation.vector));
        }
        let tip = (frame * self.tip).coords;
        let columns = axes.iter().flat_map(|(motion, axis, place)| match motion {
            Motion::Prismatic => axis.data.0[0],
            _ => axis.cross(&(tip - place)).data.0[0],
        });
        DMatrix::from_iterator(3, axes.len(), columns)
    }

    /// Returns the first coordinates in which the joints move the tip in all directions, in the zero pose or, if there
    /// are none, in a bent pose.
    fn find_task(&self) -> Option<Vec<usize>> {
        /// Smallest singular value of a task's Jacobian, as a share of the largest one of all three coordinates. Files
        /// write a right angle as 1.5708, an error of 4e-6.
        const SMALLEST: f64 = 1e-3;
        let tasks: &[&[usize]] = match self.links.len() {
            1 => &[&[0], &[1], &[2]],
            2 => &[&[0, 1], &[0, 2], &[1, 2]],
            _ => &[&[0, 1, 2]],
        };
        let bent = self.links.iter().enumerate().map(|(index, link)| {
            let angle = 0.5 + 0.3 * index as f64;
            if link.joint.motion == Motion::Prismatic { 0.1 * angle } else { angle }
        });
        [vec![0.0; self.links.len()], bent.collect()].iter().find_map(|q| {
            let jacobian = self.jacobian(q);
            let smallest = SMALLEST * jacobian.singular_values().max();
            let spans = |task: &&&[usize]| jacobian.select_rows(task.iter()).singular_values().min() > smallest;
            tasks.iter().find(spans).map(|task| task.to_vec())
        })
    }
}

/// Lists names for a message, twelve at most.
fn listed(names: &[&str]) -> String {
    let dots = if names.len() > 12 { ", …" } else { "" };
    format!("{}{dots}", names[..names.len().min(12)].join(", "))
}
