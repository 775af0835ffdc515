//! Wrong models are refused with file, line, element and remedy. Each row has a text of a model, its replacement, and
//! words of the message.

use haptic_import::{Selection, read};

const URDF: &str = r#"<robot name="arm">
<link name="base"/>
<link name="a"><inertial><mass value="0.1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="b"/>
<joint name="j1" type="revolute"><parent link="base"/><child link="a"/><limit lower="-1" upper="1"/></joint>
<joint name="j2" type="fixed"><parent link="a"/><child link="b"/><origin xyz="0 0.1 0"/></joint>
</robot>"#;

const URDF_MISTAKES: &str = r#"
    mass value="0.1" => mass value="0,1" => m:3:32: | <mass> in <link name="a">: value = "0,1" is not one finite number
    mass value="0.1" => mass value="-0.1" => m:3:32: | negative
    mass value="0.1" => mass => m:3:26: | <mass> in <link name="a">: `value` is missing
    izz="1" => izz="-1" => m:3:45: | principal moment of inertia is negative
    ixx="1" => => `ixx` is missing
    <link name="b"/> => <link name="a"/> => m:4:7: | second link of this name
    <child link="b"/> => <child link="c"/> => m:6:56: | no <link> is named "c"
    <child link="b"/> => <child link="a"/> => m:6:1: | two parents
    <parent link="base"/> => <parent link="b"/> => m:5:1: | link "a" is not connected to "base"
    type="fixed" => type="mobile" => m:6:18: | type "mobile" is unknown
    lower="-1" => lower="2" => m:5:72: | lower is above upper
    <limit => <axis xyz="0 0 0"/><limit => m:5:78: | no direction
    <limit => <mimic joint="j2"/><limit => m:5:72: | repeats another joint's motion | remove <mimic>
    <limit => <limit lower="0" upper="1"/><limit => second element of its kind
    name="arm" => xmlns:xacro="http://ros.org/wiki/xacro" size="${2*l}" => this is xacro | `xacro FILE -o OUT.urdf`
    <link name="b"/> => <xacro:arm/> => this is xacro
    </robot> => => m:1:1: not valid XML
    0 0.1 0 => 0.1 0 0 => do not move the tip b in as many directions
    type="revolute" => type="floating" => no revolute or prismatic joint moves the tip b
"#;

const MJCF: &str = r#"<mujoco model="arm">
<default><default class="c"><joint damping="1"/></default></default>
<worldbody>
<body name="a"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><joint name="j" class="c"/>
<body name="b" pos="0.1 0 0"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></body>
</worldbody></mujoco>"#;

const MJCF_MISTAKES: &str = r#"
    "0.1 0 0"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/> => "0.1 0 0"> => m:5:1: | body b has no <inertial>
    "c"/> => "d"/> => m:4:84: | class "d" is unknown
    damping="1" => damping="x" => m:2:36: | damping = "x"
    body name="b" => body name="a" => second body of this name
    "0.1 0 0"> => "0.1 0 0" quat="1 0 0 0" euler="0 0 0"> => m:5:1: | several orientations (quat, euler)
    "0.1 0 0"> => "0.1 0 0" quat="0 0 0 0"> => m:5:30: | quat gives no orientation
    name="j" => name="j" type="screw" => unknown type
    <worldbody> => <include file="x.xml"/><worldbody> => m:3:1: | <include>: other files are not read | mj_saveLastXML
    <worldbody> => <worldbody><replicate count="2"/> => <replicate> is not read
    <worldbody> => <worldbody><frame><joint/></frame> => m:3:19: | in a <frame>
    <worldbody> => <compiler inertiafromgeom="true"/><worldbody> => m:3:11: | inertiafromgeom
    <worldbody> => <compiler eulerseq="abc"/><worldbody> => not a sequence of axes
"#;

fn refusal(text: &str, selection: &Selection) -> String {
    let found = read(text, "m".as_ref()).and_then(|tree| tree.chain(selection, "m".as_ref()));
    found.expect_err(text).to_string()
}

#[test]
fn mistakes_are_refused_with_line_element_and_remedy() {
    for (model, table) in [(URDF, URDF_MISTAKES), (MJCF, MJCF_MISTAKES)] {
        assert!(read(model, "m".as_ref()).unwrap().chain(&Selection::default(), "m".as_ref()).is_ok());
        for row in table.trim().lines() {
            let parts: Vec<&str> = row.split("=>").map(str::trim).collect();
            let (from, to, words) = (parts[0], parts[1], parts[2]);
            assert!(model.contains(from), "{row}");
            let message = refusal(&model.replacen(from, to, 1), &Selection::default());
            assert!(words.split(" | ").all(|word| message.contains(word.trim())), "{row}\n{message}");
            assert!(message.contains("; "), "a remedy: {message}");
        }
    }
    for (text, words) in [
        ("{ \"name\": \"a\" }", "this is JSON"),
        ("name: a\n", "this is YAML"),
        ("<sdf version=\"1.7\"/>", "this is SDF"),
        ("<svg/>", "this is XML"),
    ] {
        let message = refusal(text, &Selection::default());
        assert!(message.contains(words) && message.contains("neither URDF nor MJCF"), "{message}");
    }
}

#[test]
fn wrong_choices_name_the_possible_ones() {
    let long: String = (0..4)
        .map(|i| {
            let body = r#"<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>"#;
            format!(r#"<body name="b{i}" pos="0.1 0 0.1">{body}<joint name="j{i}" axis="0 1 0"/>"#)
        })
        .collect();
    let long = format!("<mujoco><worldbody>{long}{}</worldbody></mujoco>", "</body>".repeat(4));
    for (tip, joints, words) in [
        (None, "", "4 joints move the tip b3; choose up to 3 of j0, j1, j2, j3"),
        (None, "j0 j1 j2 j3", "4 joints move"),
        (None, "j0 j9", "no joint \"j9\" is between the base and the tip b3"),
        (Some("b1"), "j2", "no joint \"j2\" is between the base and the tip b1; choose up to 3 of j0, j1"),
        (None, "j0 j0", "joint \"j0\" is chosen twice"),
        (Some("hand"), "", "no body is named \"hand\"; the file has world, b0, b1, b2, b3"),
        (Some("world"), "", "no revolute or prismatic joint moves the tip world"),
    ] {
        let joints = joints.split_whitespace().map(Into::into).collect();
        let message = refusal(&long, &Selection { tip: tip.map(Into::into), joints });
        assert!(message.contains(words), "{message}");
    }
}
