//! Rules that the independent cases do not contain. Each row has a text of a model, its replacement, and words of the
//! device file or of the error message.

use haptic_import::{Selection, convert};

const URDF: &str = r#"<robot name="arm">
<link name="base"/>
<link name="a"><inertial><mass value="0.1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="b"/>
<joint name="j1" type="revolute"><parent link="base"/><child link="a"/><limit lower="-1" upper="1"/></joint>
<joint name="j2" type="fixed"><parent link="a"/><child link="b"/><origin xyz="0 0.1 0"/></joint>
</robot>"#;

const URDF_ROWS: &str = r#"
    name="arm" => => name = "my-device" | verified = false | Tip: origin of b | Massless in the file: b.
    mass value="0.1" => mass value="0,1" => m:3:32: <mass> in <link name="a">: value = "0,1" is not one finite number; write
    mass value="0.1" => mass value="-0.1" => m:3:32: | negative; write
    mass value="0.1" => mass => m:3:26: <mass> in <link name="a">: `value` is missing; add
    izz="1" => izz="-1" => m:3:45: | principal moment of inertia is negative
    <link name="b"/> => <link name="a"/> => m:4:7: | second link of this name
    <child link="b"/> => <child link="c"/> => m:6:56: | no <link> is named "c"
    <child link="b"/> => <child link="a"/> => m:6:1: | two parents
    <parent link="base"/> => <parent link="b"/> => m:5:1: | link "a" is not connected to "base"
    type="fixed" => type="mobile" => m:6:18: | type "mobile" is unknown
    lower="-1" => lower="2" => m:5:72: | lower is above upper
    <limit => <axis xyz="0 0 0"/><limit => m:5:78: | no direction
    <limit => <mimic joint="j2"/><limit => m:5:72: | repeats another joint's motion | remove <mimic>
    <limit => <limit lower="0" upper="1"/><limit => second element of its kind
    name="arm" => name="arm" size="${2*l}" => this is xacro | `xacro FILE -o OUT.urdf`
    <link name="b"/> => <xacro:arm/> => this is xacro
    </robot> => => m:1:1: not valid XML
    0 0.1 0 => 0.1 0 0 => do not move the tip b in as many directions
    type="revolute" => type="floating" => no revolute or prismatic joint moves the tip b
"#;

const MJCF: &str = r#"<mujoco model="arm">
<default><joint armature="2"/><default class="c"><joint damping="1"/></default></default><compiler eulerseq="XYZ"/>
<worldbody>
<body name="a" pos="0 0 1"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><joint name="j" class="c"/>
<body name="b" pos="0.1 0.2 0.3"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></body>
</worldbody></mujoco>"#;

const MJCF_ROWS: &str = r#"
    name="j" => => At rest with the base: world | viscous = 1.0 | inertia = 2.0 | # Joint 0: a.0 | # limits
    name="j" => range="-90 180" => limits = [-1.5707963267949, 3.1415926535898]
    name="j" => range="-90 180" limited="false" => # limits
    name="j" => type="slide" axis="1 0 0" range="-1 2" ref="0.2" => limits = [-1.0, 2.0] | origin = [-0.2, 0.0, 1.0]
    name="j" => ref="90" stiffness="2" => rpy = [0.0, 0.0, -1.5707963267949] | The spring
    <worldbody> => <compiler autolimits="false" angle="radian"/><default><joint range="-1 1"/></default><worldbody> => # limits
    0 0 1"><i => 0 0 1" quat="2 0 0 2"><i => rpy = [0.0, 0.0, 1.5707963267949]
    0 0 1"><i => 0 0 1" axisangle="0 0 2 90"><i => rpy = [0.0, 0.0, 1.5707963267949]
    0 0 1"><i => 0 0 1" euler="90 0 90"><i => rpy = [1.5707963267949, 0.0, 1.5707963267949]
    <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></body> => </body></body> => m:5:1: | body b has no <inertial>
    <body name="b" => <frame pos="0 0 1"/><body name="b" gravcomp="1" => tip = [0.1, 0.2, 0.3] | gravcomp of b is left out
    class="c"/> => class="d"/> => m:4:96: | class "d" is unknown
    damping="1" => damping="x" => m:2:57: | damping = "x"
    body name="b" => body name="a" => second body of this name
    0 0 1"><i => 0 0 1" zaxis="1 0 0"><i => m:4:1: | the orientation by zaxis is not read
    0 0 1"><i => 0 0 1" quat="0 0 0 0"><i => m:4:28: | quat gives no orientation
    <worldbody> => <include file="x.xml"/><worldbody> => m:3:1: | <include>: other files are not read | mj_saveLastXML
    <worldbody> => <worldbody><frame><joint/></frame> => m:3:19: | in a <frame>
    <worldbody> => <compiler inertiafromgeom="true"/><worldbody> => m:3:11: | inertiafromgeom
    <worldbody> => <compiler eulerseq="abc"/><worldbody> => not a sequence of axes
"#;

fn outcome(text: &str, selection: &Selection) -> String {
    match convert(text, "m".as_ref(), selection) {
        Ok(converted) => converted.device_file,
        Err(failure) => failure.to_string(),
    }
}

#[test]
fn rules_and_mistakes_have_their_outcome() {
    for (model, rows) in [(URDF, URDF_ROWS), (MJCF, MJCF_ROWS)] {
        for row in rows.trim().lines() {
            let parts: Vec<&str> = row.split("=>").map(str::trim).collect();
            assert!(model.contains(parts[0]), "{row}");
            let found = outcome(&model.replacen(parts[0], parts[1], 1), &Selection::default());
            assert!(parts[2].split(" | ").all(|word| found.contains(word.trim())), "{row}\n{found}");
        }
    }
    for (text, format) in [("{}", "JSON"), ("name: a\n", "YAML"), ("<sdf/>", "SDF"), ("<svg/>", "XML")] {
        let found = outcome(text, &Selection::default());
        assert!(found.contains(&format!("this is {format}")) && found.contains("neither URDF nor MJCF"), "{found}");
    }
}

#[test]
fn wrong_choices_name_the_possible_ones() {
    let body = |i: i32| {
        let inertial = r#"<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>"#;
        format!(r#"<body name="b{i}" pos="0.1 0 0.1">{inertial}<joint name="j{i}" axis="0 1 0"/>"#)
    };
    let bodies: String = (0..4).map(body).collect();
    let text = format!("<mujoco><worldbody>{bodies}{}</worldbody></mujoco>", "</body>".repeat(4));
    for (tip, joints, words) in [
        (None, "", "4 joints move the tip b3; choose up to 3 of j0, j1, j2, j3"),
        (None, "j0 j9", "no joint \"j9\" is between the base and the tip b3"),
        (Some("b1"), "j2", "no joint \"j2\" is between the base and the tip b1; choose up to 3 of j0, j1"),
        (None, "j0 j0", "joint \"j0\" is chosen twice"),
        (Some("hand"), "", "no body is named \"hand\"; the file has world, b0, b1, b2, b3"),
        (Some("b1"), "j0", "Held at zero: j1, j2, j3."),
    ] {
        let joints = joints.split_whitespace().map(Into::into).collect();
        let found = outcome(&text, &Selection { tip: tip.map(Into::into), joints });
        assert!(found.contains(words), "{found}");
    }
}
