//! The text of a device file.

use crate::chain::{Chain, Link};
use crate::tree::Motion;
use core::fmt::Write;
use haptic_host::error::on_one_line;

/// Longest line of a comment.
const WIDTH: usize = 116;

impl Chain {
    /// Returns the device file. Motors and encoders are placeholders.
    pub fn device_file(&self) -> String {
        let name = if self.name.trim().is_empty() { "my-device" } else { &self.name };
        let name = on_one_line(name).replace('\\', "\\\\").replace('"', "\\\"");
        let axes: Vec<String> = self.task.iter().map(|axis| format!("{:?}", ["x", "y", "z"][*axis])).collect();
        let mut text = String::new();
        for remark in &self.remarks {
            comment(&mut text, remark);
        }
        comment(&mut text, "SI units throughout (m, kg, s, N, rad); docs/devices.md explains every number.");
        let gravity = list(self.gravity.as_slice(), 1.0);
        let _ = write!(
            text,
            "\nname = \"{name}\"\nmechanism = \"chain\"\ngravity = {gravity}  # m/s², in the base frame\n\n\
             [geometry]\ntip = {}  # m, in the last link's frame\n\
             task = [{}]  # coordinates of the tip (base frame) that walls act on\n",
            list(self.tip.coords.as_slice(), 1e-3),
            axes.join(", "),
        );
        for (index, link) in self.links.iter().enumerate() {
            let (inertia, t) = (&link.inertia, &link.inertia.tensor);
            let tensor = [t[(0, 0)], t[(1, 1)], t[(2, 2)], t[(0, 1)], t[(0, 2)], t[(1, 2)]];
            text.push('\n');
            comment(&mut text, &format!("Link {index}: {}", link.bodies.join(" + ")));
            let _ = write!(
                text,
                "[[link]]\nmass = {}\ncom = {}\ninertia = {}\n",
                number(inertia.mass),
                list(inertia.com.as_slice(), 0.0),
                list(&tensor, 0.0),
            );
        }
        for (index, link) in self.links.iter().enumerate() {
            let joint = &link.joint;
            let slides = joint.motion == Motion::Prismatic;
            let (kind, unit, turn, constant) = match slides {
                true => ("prismatic", "m", "counts_per_metre = 100000", "force_constant = 10.0"),
                false => ("revolute", "rad", "counts_per_turn = 20000", "torque_constant = 0.2"),
            };
            text.push('\n');
            comment(&mut text, &format!("Joint {index}: {}", joint.name));
            let _ = write!(
                text,
                "[[joint]]\ntype = \"{kind}\"\norigin = {}\nrpy = {}\naxis = {}\n\
                 inertia = {}  # {}, rotor times the ratio squared\nviscous = {}\ncoulomb = {}\n",
                list(link.origin.translation.vector.as_slice(), 1e-3),
                list(&roll_pitch_yaw(link), 1.0),
                list(joint.axis.as_slice(), 1.0),
                number(joint.inertia),
                if slides { "kg" } else { "kg m²" },
                number(joint.viscous),
                number(joint.coulomb),
            );
            text += &match joint.limits {
                Some(limits) => format!("limits = {}\n", list(&limits, 1.0)),
                None => format!("# limits = [-1.0, 1.0]  # {unit}, which a real board needs\n"),
            };
            let _ = write!(
                text,
                "\n[joint.encoder]\n{turn}  # placeholder\noffset = 0.0\ninverted = false\n\n[joint.motor]\n\
                 {constant}  # placeholder, and so are the next three\nresistance = 2.0\ninductance = 0.001\n\
                 max_current = 3.0\nverified = false  # true once you have checked these numbers\n",
            );
        }
        let home = list(&vec![0.0; self.links.len()], 1.0);
        text + &format!("\n# [home]\n# q = {home}  # the pose in which you hold the device for `haptic home`\n")
    }
}

/// Returns roll, pitch and yaw of a joint's frame, exact also where roll and yaw turn about nearly the same axis.
fn roll_pitch_yaw(link: &Link) -> [f64; 3] {
    let r = link.origin.rotation.to_rotation_matrix();
    let yaw = r[(1, 0)].atan2(r[(0, 0)]);
    let (sin, cos) = yaw.sin_cos();
    // The matrix after the yaw is undone.
    let across = |column| cos * r[(1, column)] - sin * r[(0, column)];
    [(-across(2)).atan2(across(1)), (-r[(2, 0)]).atan2(cos * r[(0, 0)] + sin * r[(1, 0)]), yaw]
}

/// Adds a comment in lines of at most [`WIDTH`] characters.
fn comment(text: &mut String, sentence: &str) {
    let mut length = usize::MAX;
    for word in on_one_line(sentence).split(' ') {
        let more = word.chars().count() + 1;
        if length.saturating_add(more) > WIDTH {
            text.push_str(if length == usize::MAX { "#" } else { "\n#" });
            length = 1;
        }
        text.push(' ');
        text.push_str(word);
        length += more;
    }
    text.push('\n');
}

/// Returns a list in which the rounding errors of a rotation are zero: values below 1e-14 of the largest, or of `scale`.
fn list(values: &[f64], scale: f64) -> String {
    let largest = values.iter().fold(scale, |largest, value| largest.max(value.abs()));
    let values = values.iter().map(|value| if value.abs() < 1e-14 * largest { 0.0 } else { *value });
    format!("[{}]", values.map(number).collect::<Vec<_>>().join(", "))
}

/// Returns a number with fourteen digits at most, so that 1.5708 stays 1.5708 after its way through a rotation.
fn number(value: f64) -> String {
    let rounded: f64 = format!("{value:.13e}").parse().unwrap_or(value);
    format!("{:?}", rounded + 0.0)
}
