//! File templates: a commented device file for each mechanism, and a scene file for a device.

use crate::plausible::scene::Ripple;
use crate::tune::{USUAL_RIPPLE_N, three_digits};
use crate::wall_ahead::{FirstWall, first_wall};
use haptic_bridge::model::catalogue::Kind;
use haptic_bridge::render::scene::Surface;
use haptic_host::device_file::DeviceFile;
use haptic_host::error::Failure;
use haptic_host::words::with_unit;

/// Part of a template that the mechanism's [`Spec`](haptic_bridge::model::catalogue::Spec) does not contain.
struct Example {
    /// Description of the mechanism with its pose of zero angles.
    about: &'static str,
    gravity: &'static str,
    /// Lines of `[geometry]`: key, value, comment.
    geometry: &'static [(&'static str, &'static str, &'static str)],
    /// Mass (kg), centre of mass (m), inertia (kg m²) and reference of the centre of mass of each link.
    links: &'static [(f64, f64, f64, &'static str)],
    /// Inertia (kg m²), limits (rad) and comment of each joint.
    joints: &'static [(f64, [f64; 2], &'static str)],
    /// Origin and axis of each joint of a chain.
    frames: &'static [(&'static str, &'static str)],
    home: &'static str,
}

fn example(kind: Kind) -> Example {
    const FROM_MOTOR: &str = "from the motor towards the elbow";
    const FROM_ELBOW: &str = "from the elbow towards the tip";
    match kind {
        Kind::Paddle => Example {
            about: "One handle on one pivot. Its task coordinate is the arc, length times angle.",
            gravity: "[0.0, 0.0]             # x, y; zero if it is balanced or lies flat",
            geometry: &[("length", "0.07", "pivot to handle")],
            links: &[],
            joints: &[(8.0e-4, [-0.6, 0.6], "the whole paddle about its pivot, and the rotor times the ratio squared")],
            frames: &[],
            home: "[0.0]",
        },
        Kind::Paddles2 | Kind::Paddles3 => Example {
            about: "Two or three handles on one board, each on its own pivot. The task coordinates are the arcs, length times\n\
                    # angle. A handle points along (cos q, sin q).",
            gravity: "[0.0, 0.0]             # x, y; zero if the handles are balanced or lie flat",
            geometry: match kind {
                Kind::Paddles2 => &[("lengths", "[0.08, 0.08]", "pivot to handle, of each paddle")],
                _ => &[("lengths", "[0.08, 0.08, 0.08]", "pivot to handle, of each paddle")],
            },
            links: &[],
            joints: if kind == Kind::Paddles2 { &[PADDLE_JOINT; 2] } else { &[PADDLE_JOINT; 3] },
            frames: &[],
            home: if kind == Kind::Paddles2 { "[0.0, 0.0]" } else { "[0.0, 0.0, 0.0]" },
        },
        Kind::Chain1 => Example {
            about: "One handle on one pivot that feels gravity: an upright paddle. Its task coordinate is the arc of the tip.\n\
                    # A slide is a chain of one joint too: type = \"prismatic\", task = [\"x\"] (docs/devices.md).",
            gravity: "[0.0, -9.81, 0.0]      # x, y, z; y is up",
            geometry: &[
                ("tip", "[0.07, 0.0, 0.0]", "m, in the last link's frame"),
                ("task", "[\"arc\"]", "coordinates that walls act on: \"arc\", or one of \"x\", \"y\", \"z\""),
            ],
            links: &[(0.05, 0.035, 4.0e-5, "from the pivot")],
            joints: &[(2.0e-4, [0.9, 2.2], "rotor times the ratio squared")],
            frames: &[("[0.0, 0.0, 0.0]", "[0.0, 0.0, 1.0]")],
            home: "[1.5707963]",
        },
        Kind::Chain2 => Example {
            about: "Two joints in series with any axes, here an arm in the plane. At zero angles both links point along +x.",
            gravity: "[0.0, 0.0, -9.81]      # x, y, z in the base frame; z is up",
            geometry: &[
                ("tip", "[0.1, 0.0, 0.0]", "m, in the last link's frame"),
                ("task", "[\"x\", \"y\"]", "coordinates of the tip that walls act on, as many as joints"),
            ],
            links: &[
                (0.06, 0.05, 6.0e-5, "from joint 0 towards joint 1"),
                (0.04, 0.05, 4.0e-5, "from joint 1 towards the tip"),
            ],
            joints: &[(2.0e-5, [-1.0, 1.6], "rotor times the ratio squared"), (2.0e-5, [0.4, 2.6], "")],
            frames: &[("[0.0, 0.0, 0.0]", "[0.0, 0.0, 1.0]"), ("[0.12, 0.0, 0.0]", "[0.0, 0.0, 1.0]")],
            home: "[0.2, 1.4]",
        },
        Kind::Chain3 => Example {
            about: "Three joints in series with any axes, here an arm like the Touch: a turret about the vertical z axis, shoulder\n\
                    # and elbow about horizontal axes. At zero angles both arms point along +x.",
            gravity: "[0.0, 0.0, -9.81]      # x, y, z in the base frame; z is up",
            geometry: &[
                ("tip", "[0.13, 0.0, 0.0]", "m, in the last link's frame"),
                ("task", "[\"x\", \"y\", \"z\"]", "coordinates of the tip that walls act on, as many as joints"),
            ],
            links: &[
                (0.1, 0.0, 1.0e-4, "from the turret's axis"),
                (0.06, 0.05, 1.0e-4, "from the shoulder towards the elbow"),
                (0.03, 0.06, 5.0e-5, "from the elbow towards the tip"),
            ],
            joints: &[
                (1.0e-4, [-0.9, 0.9], "rotor times the ratio squared"),
                (1.0e-4, [-1.2, 0.2], ""),
                (5.0e-5, [0.5, 2.2], ""),
            ],
            frames: &[
                ("[0.0, 0.0, 0.0]", "[0.0, 0.0, 1.0]"),
                ("[0.0, 0.0, 0.0]", "[0.0, 1.0, 0.0]"),
                ("[0.13, 0.0, 0.0]", "[0.0, 1.0, 0.0]"),
            ],
            home: "[0.0, -0.7, 1.3]",
        },
        Kind::FiveBar => Example {
            about: "Two motors side by side, two arms, one tip. Joint 0 is the motor at -base/2 (left), joint 1 the one at\n\
                    # +base/2; both angles are zero along +x and grow counter-clockwise.",
            gravity: "[0.0, 0.0]             # x, y; zero for a device that lies flat",
            geometry: &[
                ("base", "0.05", "between the motors' axes"),
                ("proximal", "[0.07, 0.07]", "motor to elbow, arm 0 then arm 1"),
                ("distal", "[0.09, 0.09]", "elbow to tip"),
                ("assembly", "1", "1: the tip lies left of the way from C to D (above, seen as drawn); -1: right"),
            ],
            links: &[
                (0.02, 0.03, 1.0e-5, FROM_MOTOR),
                (0.02, 0.03, 1.0e-5, FROM_MOTOR),
                (0.012, 0.045, 1.0e-5, FROM_ELBOW),
                (0.012, 0.045, 1.0e-5, FROM_ELBOW),
            ],
            joints: &[(2.0e-6, [1.2, 3.3], "rotor times the ratio squared"), (2.0e-6, [-0.2, 1.9], "")],
            frames: &[],
            home: "[2.3, 0.8415926]",
        },
        Kind::FiveBarTurret => Example {
            about: "A five-bar whose plane turns about its own x axis. Joint 0 is the turret, joints 1 and 2 the five-bar's\n\
                    # motors at -base/2 and +base/2; their angles are zero along +x and grow counter-clockwise.",
            gravity: "[0.0, 0.0, -9.81]      # x, y, z at joint 0 = 0",
            geometry: &[
                ("base", "0.04", "between the motors' axes"),
                ("proximal", "[0.09, 0.09]", "motor to elbow"),
                ("distal", "[0.12, 0.12]", "elbow to tip"),
                ("assembly", "1", "1: the tip lies left of the way from elbow to elbow; -1: right"),
            ],
            links: &[
                (0.04, 0.035, 3.0e-5, FROM_MOTOR),
                (0.04, 0.035, 3.0e-5, FROM_MOTOR),
                (0.03, 0.06, 4.0e-5, FROM_ELBOW),
                (0.03, 0.06, 4.0e-5, FROM_ELBOW),
            ],
            joints: &[
                (4.0e-4, [-0.8, 0.8], "turret: rotor times the ratio squared, and other parts that turn with it"),
                (8.0e-5, [1.2, 3.3], "rotor times the ratio squared"),
                (8.0e-5, [-0.2, 1.9], ""),
            ],
            frames: &[],
            home: "[0.0, 2.2, 0.9415926]",
        },
        Kind::Parallelogram => Example {
            about: "Phantom-like: a turret (joint 0, about the vertical y axis) and an arm in its plane. The angles of\n\
                    # joints 1 (upper arm) and 2 (forearm) are absolute: both zero along the horizontal +x.",
            gravity: "[0.0, -9.81, 0.0]      # x, y, z; y is up",
            geometry: &[
                ("upper", "0.21", "upper arm: shoulder to elbow"),
                ("fore", "0.17", "forearm: elbow to tip"),
                ("crank", "0.03", "drive crank: shoulder to coupler, and elbow to the forearm's rear end"),
            ],
            links: &[
                (0.17, 0.05, 8.0e-4, "from the shoulder towards the elbow"),
                (0.05, 0.06, 2.0e-4, "from the elbow towards the tip"),
                (0.06, 0.015, 4.0e-5, "from the shoulder towards the crank's tip; a counterweight counts here"),
                (0.04, 0.105, 1.4e-4, "from the crank's tip, along the upper arm"),
            ],
            joints: &[
                (2.0e-3, [-0.8, 0.8], "turret: rotor times the ratio squared, and other parts that turn with it"),
                (3.0e-4, [0.2, 2.0], "rotor times the ratio squared"),
                (3.0e-4, [-1.2, 0.8], ""),
            ],
            frames: &[],
            home: "[0.0, 1.2, -0.2]",
        },
        Kind::Serial3r => Example {
            about: "A planar arm with three links, one more than the tip needs. Each angle counts from the link before, joint 0\n\
                    # from +x; all grow counter-clockwise.",
            gravity: "[0.0, 0.0]             # x, y; zero for an arm that lies flat",
            geometry: &[("lengths", "[0.15, 0.12, 0.08]", "of link 1, 2 and 3, joint to joint and joint to tip")],
            links: &[
                (0.1, 0.07, 2.0e-4, "from joint 0 towards joint 1"),
                (0.07, 0.06, 9.0e-5, "from joint 1 towards joint 2"),
                (0.04, 0.04, 2.5e-5, "from joint 2 towards the tip"),
            ],
            joints: &[
                (5.0e-5, [-1.5, 2.0], "rotor times the ratio squared"),
                (2.0e-5, [0.3, 2.6], ""),
                (1.0e-5, [-1.5, 2.0], ""),
            ],
            frames: &[],
            home: "[0.3, 1.2, 0.8]",
        },
        // Lengths and zero angles of a Falcon as libnifalcon's FalconGeometry.h has them: r, c, a and b + d + e, without
        // the offsets s, f and of the rods' joints. Its counts per turn are 4 x 320 slots x 7.62. Masses and inertias
        // are assumed.
        Kind::Delta => Example {
            about: "Falcon-like: three arms with a pair of rods each carry a platform that does not turn. Angle 0 points\n\
                    # outwards, and angles grow towards +z, which points to the operator; y is up.",
            gravity: "[0.0, -9.81, 0.0]      # x, y, z; y is up",
            geometry: &[
                ("base", "0.037", "from the z axis to every motor's axis"),
                ("platform", "0.014", "from the platform's centre to the ends of the rods"),
                ("upper", "0.06", "arm: motor to elbow"),
                ("fore", "0.125", "rods: elbow to platform"),
                ("azimuth", "[0.0, 2.0943951, 4.1887902]", "rad, of the legs about z; default these"),
                ("assembly", "1", "1: tip on the side of (c1 - c0) x (c2 - c0), +z in this order; -1: other side"),
            ],
            links: &[(0.03, 0.03, 1.0e-5, FROM_MOTOR), (0.005, 0.0, 0.0, ""), (0.04, 0.0, 0.0, "")],
            joints: &[
                (5.0e-5, [-0.3, 1.4], "rotor times the ratio squared"),
                (5.0e-5, [-0.3, 1.4], ""),
                (5.0e-5, [-0.3, 1.4], ""),
            ],
            frames: &[],
            home: "[0.6108652, 0.6108652, 0.6108652]",
        },
    }
}

/// Joint of an example of several paddles.
const PADDLE_JOINT: (f64, [f64; 2], &str) =
    (8.0e-4, [-0.6, 0.6], "the whole paddle about its pivot, and the rotor times the ratio squared");

/// Motors and encoders that the boards support, as a sentence without full stop.
pub const MOTORS_AND_ENCODERS: &str = "boards drive brushed motors (odrive-v3 also brushless ones) and read incremental encoders (A and B): two of each at 10 to 50 V (odrive-v3), three at 6 to \
     34 V (H-bridges)";

/// Returns a device file of this mechanism that passes every check except the confirmation of its motors.
pub fn device_file(kind: Kind, name: &str) -> String {
    let spec = kind.spec();
    let example = example(kind);
    let is_chain = spec.name == "chain";
    let turret = spec.task == 3 && !is_chain && kind != Kind::Delta;
    let mut text = format!(
        "# {about}\n\
         # Every number here is an example: replace it with your device's value. SI units throughout (m, kg, s, N, rad).\n\
         # docs/devices.md has a drawing and the source of each number; `haptic check FILE` summarises the device.\n\
         # Motors and encoders: {MOTORS_AND_ENCODERS}.\n\n\
         name = {name:?}\n\
         mechanism = \"{}\"\n\
         gravity = {}\n\
         # supply = 24.0                      # V, supply of the board: bounds the motors' torque\n\n\
         [geometry]                           # m, between axes\n",
        spec.name,
        example.gravity,
        about = example.about,
    );
    let mut line = |key: &str, value: String, comment: &str| text.push_str(&line(key, &value, comment));
    for (key, value, comment) in example.geometry {
        line(key, (*value).into(), comment);
    }
    for (index, ((mass, com, inertia, from), name)) in example.links.iter().zip(spec.links).enumerate() {
        let first = index == 0;
        line(&format!("\n[[link]]  # {index}: {name}\nmass"), number(*mass), if first { "kg" } else { "" });
        if from.is_empty() {
            continue;
        }
        if is_chain {
            line("com", format!("[{}, 0.0, 0.0]", number(*com)), &format!("m, x, y, z of the centre of mass, {from}"));
            let (axial, across) = (number(0.05 * inertia), number(*inertia));
            let meaning = "kg m²: ixx, iyy, izz, ixy, ixz, iyz about the centre of mass";
            line("inertia", format!("[{axial}, {across}, {across}, 0.0, 0.0, 0.0]"), if first { meaning } else { "" });
            continue;
        }
        line("com", number(*com), &format!("m, centre of mass {from}"));
        line(
            "inertia",
            number(*inertia),
            if first { "kg m², about the centre of mass, normal to the linkage's plane" } else { "" },
        );
        if turret {
            line(
                "inertia_axial",
                number(0.05 * inertia),
                if first { "kg m², about the link's own axis; default 0" } else { "" },
            );
            let across = "kg m², in the plane across the link; default `inertia`";
            line("inertia_transverse", number(0.97 * inertia), if first { across } else { "" });
        }
    }
    for (index, (inertia, limits, comment)) in example.joints.iter().enumerate() {
        let first = index == 0;
        let note = |comment: &'static str| if first { comment } else { "" };
        line(&format!("\n[[joint]]  # {index}\ninertia"), number(*inertia), &with_prefix("kg m²", comment));
        if let Some((origin, axis)) = example.frames.get(index) {
            line(
                "origin",
                (*origin).into(),
                note("m, of the joint's frame in the frame of the link before; default zero"),
            );
            line("# rpy", "[0.0, 0.0, 0.0]".into(), note("rad, roll, pitch, yaw of the joint's frame; default zero"));
            line("axis", (*axis).into(), note("in the joint's frame; default z"));
            line(
                "# type",
                "\"prismatic\"".into(),
                note("for a slide, with counts_per_metre and force_constant; default revolute"),
            );
        }
        line("viscous", "3.0e-4".into(), note("N m s/rad, friction that grows with speed; default 0"));
        line("coulomb", "2.0e-3".into(), note("N m, dry friction; default 0"));
        line(
            "limits",
            format!("[{:?}, {:?}]", limits[0], limits[1]),
            note("rad, lowest and highest angle, inside the stops"),
        );
        line(
            "# transmission",
            "\"rigid\"".into(),
            note("write this if the motor sits on the joint; otherwise [joint.transmission]"),
        );
        line(
            "\n[joint.encoder]\ncounts_per_turn",
            "20000".into(),
            note("lines x 4 x ratio, at the joint; any positive number"),
        );
        line("offset", "0.0".into(), note("rad, the angle at count 0; homing overrules it; default 0"));
        line("inverted", "false".into(), note("true when the counts fall as the angle grows; default false"));
        line("\n[joint.motor]\ntorque_constant", "0.2".into(), note("N m/A at the joint: motor's x ratio"));
        if first {
            line("# kind", "\"brushless\"".into(), "with pole_pairs = 11: all figures of a phase (docs/devices.md)");
        }
        line("resistance", "2.0".into(), note("ohm, between the terminals"));
        line("inductance", "0.001".into(), note("H; default 0: unknown, and no real board arms"));
        line("back_emf", "0.2".into(), note("V s/rad at the joint; default torque_constant, the same in SI"));
        line("max_current", "3.0".into(), note("A, continuous limit of motor and supply"));
        line(
            "verified",
            "false".into(),
            note("true once you have verified these numbers; otherwise a real board does not arm"),
        );
        if first {
            line(
                "\n# [joint.transmission]              # a compliant belt or cable; without this table it is rigid\n# stiffness",
                "50.0".into(),
                "N m/rad at the joint, between motor and link",
            );
            line("# damping", "0.01".into(), "N m s/rad at the joint; default 0");
            line(
                "# motor_inertia",
                number(0.2 * inertia),
                "kg m², the part of `inertia` on the motor's side; default all",
            );
            line("# encoder_at", "\"motor\"".into(), "or \"joint\": the side that the encoder is on");
            line(
                "\n# [joint.friction]                  # dry friction that is larger at rest than in motion\n# static",
                "0.003".into(),
                "N m, friction at rest; at least `coulomb`",
            );
            line("# stribeck_speed", "0.1".into(), "rad/s, speed at which most of the difference is gone");
            line(
                "\n# [joint.cogging]                   # torque of the motor's magnets\n# amplitude",
                "0.001".into(),
                "N m",
            );
            line("# per_turn", "24".into(), "periods in a turn of the joint");
            line(
                "\n# [[joint.mode]]                    # a part that swings on the link, up to two\n# frequency",
                "150.0".into(),
                "Hz, with the joint held still",
            );
            line("# damping", "0.01".into(), "of critical damping; default 0");
            line("# inertia", number(0.05 * inertia), "kg m², inertia of the swinging part about the joint");
        }
    }
    if !spec.are_links_optional {
        line("\n[handle]\nmass", "0.02".into(), "kg, a point at the tip; default none");
    }
    line("\n[home]\nq", example.home.into(), "rad, the pose in which you hold the device for `haptic home`");
    line("# by", "\"hand\"".into(), "or \"index\" or \"stop\": docs/files.md");
    text
}

/// Returns a scene file for a device, with one wall in front of home and every optional key as a comment.
pub fn scene_file(device: &DeviceFile) -> Result<String, Failure> {
    let FirstWall { scene, ripple } = first_wall(device)?;
    let task = device.spec().task;
    let list = |values: &[f32]| {
        // Rounds to tenths of a millimetre, without a negative zero.
        let tenths = values.iter().take(task).map(|value| (1e4 * f64::from(*value)).round() / 1e4 + 0.0);
        let values: Vec<String> = tenths.map(|value| format!("{value:?}")).collect();
        format!("[{}]", values.join(", "))
    };
    let axes = ["along the arc", "x, y", "x, y, z"][task - 1];
    let mut text = format!(
        "# A scene for {}: a wall in front of its home pose. SI units throughout (m, kg, s, N, rad).\n\
         # Lines that begin with `# ` and a key are optional. `haptic check DEVICE FILE` predicts the limits of each wall,\n\
         # `haptic tune` finds the stiffest one.\n\n",
        device.name
    );
    let mut line = |key: &str, value: &str, comment: &str| text.push_str(&line(key, value, comment));
    line("rate_hz", &number(scene.rate_hz.into()), "control steps a second, 200 to 50000");
    line("cutoff_hz", &number(scene.cutoff_hz.into()), "Hz, of the velocity's low-pass, below half the rate");
    line("# estimator", "\"butterworth\"", "of the velocity; docs/model.md section 3 lists them");
    line("# gravity_compensation", "true", "the motors carry the device's weight");
    line("# hand_speed", "0.5", "m/s, speed of a hand here");
    for wall in &scene.walls {
        let Surface::Plane(plane) = &wall.surface else { continue };
        line("\n[[wall]]  # 0; up to eight\nshape", "\"plane\"", "default; docs/files.md has the round ones");
        line("point", &list(&plane.point), &format!("m, {axes}: a point of the surface"));
        line("normal", &list(&plane.normal), &format!("{axes}, out of the solid towards the hand; any length"));
        let ripple_note = match ripple {
            None => String::new(),
            Some(Ripple { ripple_n, allowed_n }) => format!(
                "; its force ripples by {} under a hand{}",
                ripple_n.map_or("very much".into(), |ripple| format!("{} rms", with_unit(ripple, "N"))),
                if allowed_n > USUAL_RIPPLE_N { ", the least that these encoders allow" } else { "" }
            ),
        };
        let comment = format!("N/m; well within what is predicted stable{ripple_note}");
        line("stiffness", &number(three_digits(wall.stiffness.into(), false)), &comment);
        line("damping", &number(three_digits(wall.damping.into(), false)), "N s/m; default 0");
        let law = format!("{:?}", wall.feed_forward.name());
        line(
            "feed_forward",
            &law,
            "default \"washout\"; \"full\": the paper's, which pushes sideways at rest; \"off\"",
        );
        line("# washout_hz", "2.0", "Hz, corner below which a washed-out feed-forward fades");
        line("# bilateral", "false", "true: the wall acts on both sides and may pull");
    }
    line("\n# [[spring]]                        # up to four; a pull to a point\n# point", &list(&[0.0; 3]), "m");
    line("# stiffness", "200.0", "N/m");
    line("# damping", "1.0", "N s/m; default 0");
    line("\n# [[field]]                         # drag everywhere\n# damping", "0.5", "N s/m");
    Ok(text)
}

fn line(key: &str, value: &str, comment: &str) -> String {
    // A key may have lines before it.
    let begins = key.rfind('\n').map_or(0, |newline| newline + 1);
    let (before, key) = key.split_at(begins);
    let pair = format!("{key} = {value}");
    let comment = if comment.is_empty() { String::new() } else { format!("# {comment}") };
    format!("{before}{}\n", format!("{pair:<36} {comment}").trim_end())
}

fn with_prefix(unit: &str, comment: &str) -> String {
    if comment.is_empty() { String::new() } else { format!("{unit}: {comment}") }
}

/// Formats a TOML float; small values use powers of ten.
fn number(value: f64) -> String {
    if value.abs() < 1e-2 && value != 0.0 { format!("{value:.3e}") } else { format!("{value:?}") }
}

#[cfg(test)]
mod tests {
    use super::{Kind, device_file, scene_file};
    use crate::plausible::device::file_warnings;
    use haptic_host::device_file::DeviceFile;
    use haptic_host::scene_file::SceneFile;
    use haptic_stability::analysis::prediction::Subject;

    #[test]
    fn every_template_lacks_only_the_confirmation_of_its_motors() {
        for kind in Kind::ALL {
            let text = device_file(*kind, "mine");
            let file = DeviceFile::parse(&text, "mine.toml").unwrap_or_else(|error| panic!("{error}\n{text}"));
            assert_eq!(file.description.kind, *kind);
            // The template leaves out the transmission, because only the device's maker knows it.
            let [unspecified] = &file_warnings(&file)[..] else { panic!("{:?}", file_warnings(&file)) };
            assert!(unspecified.text.contains("transmission = \"rigid\""), "{}", unspecified.text);
            let rigid = text.replace("# transmission = \"rigid\"", "transmission = \"rigid\"");
            assert_eq!(file_warnings(&DeviceFile::parse(&rigid, "mine.toml").unwrap()), []);
            let lacks = file.missing_for_board();
            assert!(lacks.iter().all(|lack| lack.contains("verified")), "{lacks:?}");
            assert_eq!(lacks.len(), kind.spec().joints);
        }
    }

    #[test]
    fn the_template_contains_every_key_of_device_files() {
        let text = device_file(Kind::Parallelogram, "mine");
        let keys = "name mechanism gravity upper fore crank mass com inertia inertia_axial inertia_transverse \
                    viscous coulomb limits counts_per_turn offset inverted torque_constant resistance inductance \
                    back_emf max_current verified q";
        for key in keys.split(' ') {
            assert!(text.lines().any(|line| line.starts_with(&format!("{key} = "))), "{key}");
        }
        let keys = "stiffness damping motor_inertia encoder_at static stribeck_speed amplitude per_turn frequency \
                    inertia supply";
        for key in keys.split(' ') {
            assert!(text.lines().any(|line| line.starts_with(&format!("# {key} = "))), "{key}");
        }
    }

    #[test]
    fn a_scene_template_is_valid_with_every_optional_key() {
        for kind in Kind::ALL {
            let file = DeviceFile::parse(&device_file(*kind, "mine"), "mine.toml").unwrap();
            let task = file.spec().task;
            let text = scene_file(&file).unwrap();
            let keys = "[[ estimator gravity hand_speed washout_hz bilateral point stiffness damping".split(' ');
            let every = keys.fold(text.clone(), |text, key| text.replace(&format!("\n# {key}"), &format!("\n{key}")));
            assert!(!every.lines().skip(4).any(|line| line.starts_with('#')), "{every}");
            for text in [&text, &every] {
                let scene =
                    SceneFile::parse(text, "scene.toml", task).unwrap_or_else(|error| panic!("{error}\n{text}"));
                assert!(scene.walls_entered(&file, &file.description.home.unwrap()).is_empty(), "{text}");
                assert_eq!(
                    (scene.scene.springs.is_empty(), scene.hand_speed.is_none()),
                    (text != &every, text != &every)
                );
            }
            let scene = SceneFile::parse(&text, "scene.toml", task).unwrap().scene;
            let (warnings, contacts) =
                crate::plausible::scene::file_warnings(&Subject::new(&file.description).unwrap(), &scene);
            assert_eq!((warnings.as_slice(), contacts.len()), (&[][..], 1), "{text}");
        }
    }

    #[test]
    fn a_device_template_is_valid_with_every_optional_key() {
        for kind in Kind::ALL {
            let keys = ["[joint.", "[[joint.", "stiffness", "damping", "motor_inertia", "encoder_at", "static"];
            let more = ["stribeck_speed", "amplitude", "per_turn", "frequency", "inertia", "supply"];
            let mut text = device_file(*kind, "mine");
            for key in keys.into_iter().chain(more) {
                text = text.replace(&format!("\n# {key}"), &format!("\n{key}"));
            }
            let file = DeviceFile::parse(&text, "mine.toml").unwrap_or_else(|error| panic!("{error}\n{text}"));
            let first = file.description.joints[0];
            assert!(first.transmission.is_some() && first.friction.is_some() && first.cogging.is_some());
            assert!(first.modes[0].is_some());
        }
    }
}
