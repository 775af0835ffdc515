//! A wrong file is refused with exit code 2 and one message per mistake with file name, line and remedy. Tables list
//! likely mistakes. In addition, the tests damage every line of every shipped file.

use crate::common::{Folder, refusal, run, shipped_path, toml_files, type_lines};
use haptic_host::device_file::DeviceFile;
use haptic_host::scene_file::SceneFile;
use haptic_host::toml_file::FileError;

const DEVICE: &str = r#"name = "example"
mechanism = "five-bar"
gravity = [0.0, 0.0]

[geometry]
base = 0.05
proximal = [0.07, 0.07]
distal = [0.09, 0.09]
assembly = 1

[[link]]
mass = 0.02
com = 0.03
inertia = 1.0e-5

[[link]]
mass = 0.02
com = 0.03
inertia = 1.0e-5

[[link]]
mass = 0.01
com = 0.04
inertia = 1.0e-5

[[link]]
mass = 0.01
com = 0.04
inertia = 1.0e-5

[[joint]]
inertia = 2.0e-6
limits = [-1.0, 3.0]

[joint.encoder]
counts_per_turn = 16384
offset = 0.0
inverted = false

[joint.motor]
torque_constant = 0.05
resistance = 2.0
max_current = 3.0

[[joint]]
inertia = 2.0e-6

[home]
q = [2.4, 0.7]
"#;

const SCENE: &str = r#"rate_hz = 20000
cutoff_hz = 500

[[wall]]
point = [0.0, 0.13]
normal = [0.0, -1.0]
stiffness = 1000.0
damping = 1.0

[[wall]]
shape = "sphere"
point = [0.0, 0.1]
radius = 0.05
inside = true
stiffness = 1000.0

[[spring]]
point = [0.0, 0.1]
direction = [1.0, 0.0]
stiffness = 100.0

[[field]]
damping = 1.0
"#;

/// Runs `haptic check` on this device and scene, which must be refused with exit code 2. Returns the one-line message.
fn check_error(device: &str, scene: &str) -> String {
    let folder = Folder::new();
    let message = refusal(2, &["check", &folder.write("device.toml", device), &folder.write("scene.toml", scene)]);
    assert_eq!(message.trim_end().lines().count(), 1, "one line: {message}");
    message
}

fn replace_once(text: &str, from: &str, to: &str) -> String {
    assert!(text.contains(from), "`{from}` is not in the example");
    text.replacen(from, to, 1)
}

#[test]
fn the_unchanged_examples_are_valid() {
    DeviceFile::parse(DEVICE, "example").expect("a sound device");
    SceneFile::parse(SCENE, "example", 2).expect("a sound scene");
}

/// Each row has a text of the example, its replacement, line and column of the message, and words of the message.
const DEVICE_MISTAKES: &str = r#"
    mass = 0.02 => mas = 0.02 => :12:1: => `mas` | [[link]] 0 (proximal-1) | did you mean `mass`?
    mass = 0.02⏎ =>  => :11:1: => `mass` | [[link]] 0 | missing | add `mass = 0.02`
    mass = 0.02 => mass = -0.02 => :12:8: => `mass` | -0.02 | zero or more
    mass = 0.02 => mass = nan => :12:8: => `mass` | not a finite number
    mass = 0.02 => mass = 1e39 => :12:8: => `mass` | not a finite number | ordinary number
    mass = 0.02 => mass = "0.02" => :12:8: => `mass` | a string, not a number
    mass = 0.02 => mass = [0.02] => :12:8: => `mass` | a list, not a number
    inertia = 1.0e-5 => inertia = -1.0e-5 => :14:11: => `inertia` | zero or more
    proximal = [0.07, 0.07] => proximal = [0.07] => :7:12: => `proximal` | 1 number instead of 2
    proximal = [0.07, 0.07] => proximal = 0.07 => :7:12: => a number, not a list of 2 numbers
    proximal = [0.07, 0.07] => proximal = [0.07, 0] => :7:19: => `proximal` | greater than zero
    max_current = 3.0⏎ => max_current = 3.0⏎[joint.transmission]⏎stiffness = 0⏎ => :45:13: => `stiffness` | [joint.transmission] of [[joint]] 0 | more than zero
    max_current = 3.0⏎ => max_current = 3.0⏎[joint.transmission]⏎damping = 0.1⏎ => :44:1: => `stiffness` | missing | add `stiffness = 50.0`
    max_current = 3.0⏎ => max_current = 3.0⏎[joint.transmission]⏎stiffness = 5.0⏎motor_inertia = 3.0e-6⏎ => :46:17: => motor_inertia is 0.000003 | more than all of the joint's inertia (0.000002)
    max_current = 3.0⏎ => max_current = 3.0⏎[joint.transmission]⏎stiffness = 5.0⏎encoder_at = "link"⏎ => :46:14: => `encoder_at` | motor | joint
    max_current = 3.0⏎ => max_current = 3.0⏎[joint.friction]⏎static = 0.1⏎ => :44:1: => `stribeck_speed` | [joint.friction] of [[joint]] 0 | missing | add `stribeck_speed = 0.1`
    limits = [-1.0, 3.0]⏎ => limits = [-1.0, 3.0]⏎coulomb = 0.02⏎[joint.friction]⏎static = 0.01⏎stribeck_speed = 0.1⏎ => :36:10: => static is 0.01 N m, less than the joint's coulomb (0.02) | at least as much
    max_current = 3.0⏎ => max_current = 3.0⏎[joint.cogging]⏎amplitude = -0.1⏎per_turn = 24⏎ => :45:13: => `amplitude` | [joint.cogging] of [[joint]] 0 | zero or more
    max_current = 3.0⏎ => max_current = 3.0⏎[[joint.mode]]⏎frequency = 100⏎ => :44:1: => `inertia` | [[joint.mode]] 0 of [[joint]] 0 | missing | add `inertia = 1.0e-5`
    max_current = 3.0⏎ => max_current = 3.0⏎[[joint.mode]]⏎frequency = 100⏎inertia = 1.0⏎ => :44:1: => the modes of joint 0 swing with more inertia than the links have about this joint at home
    max_current = 3.0⏎ => max_current = 3.0⏎[[joint.mode]]⏎frequency = 0⏎inertia = 1.0e-9⏎ => :45:13: => `frequency` | more than zero
    limits = [-1.0, 3.0]⏎ => limits = [-1.0, 3.0]⏎transmission = "stiff"⏎ => :34:16: => `transmission` | rigid
    [home] => [[sensed]]⏎name = "grip"⏎⏎[home] => :48:1: => `counts_per_turn` | [[sensed]] 0 | missing | add `counts_per_turn = 4096`
    [home] => [[sensed]]⏎counts_per_turn = 0⏎⏎[home] => :49:19: => `counts_per_turn` | [[sensed]] 0 | more than zero
    [home] => [[sensed]]⏎counts_per_turn = 9⏎limits = [0, 1]⏎⏎[home] => :50:1: => `limits` | [[sensed]] 0
    [home] => [[sensed]]⏎counts_per_turn = 9⏎[[sensed]]⏎counts_per_turn = 9⏎[[sensed]]⏎counts_per_turn = 9⏎[[sensed]]⏎⏎[home] => :54:1: => 4 [[sensed]] tables | 3 at most
    base = 0.05 => base = 0.5 => :5:1: => cannot close | check the lengths
    base = 0.05 => base = -0.05 => :6:8: => `base`
    com = 0.03 => com = 1e25 => :1:1: => overflows the board's 32-bit floats
    assembly = 1 => assembly = 2 => :9:12: => assembly must be 1 or -1
    mechanism = "five-bar" => mechanism = "fivebar" => :2:13: => did you mean "five-bar"? | paddle
    mechanism = "five-bar" => mechanism = 5 => :2:13: => a string in quotes
    mechanism = "five-bar"⏎ =>  => :1:1: => `mechanism` is missing
    gravity = [0.0, 0.0] => gravity = [0.0, 0.0, -9.81] => :3:11: => 3 numbers instead of 2 | m/s²
    name = "example" => name = "" => :1:8: => name
    name = "example" => name = "a\nb" => :1:8: => one line
    name = "example" => name = "a"⏎name = "b" => :2:1: => duplicate key
    name = "example" => name "example" => :1: => not valid TOML
    [geometry] => [geometri] => :5:2: => unknown key `geometri` | did you mean `geometry`?
    [geometry] => [[geometry]] => :5:1: => one [geometry] table
    [home] => [[link]]⏎[home] => :48:1: => 5 [[link]] tables instead of 4 | proximal-1
    [[joint]]⏎inertia = 2.0e-6⏎⏎[home] => [home] => :31:1: => 1 [[joint]] tables instead of 2
    counts_per_turn = 16384 => counts_per_turn = 0 => :36:19: => `counts_per_turn` | more than zero
    inverted = false => inverted = 0 => :38:12: => `inverted` | not true or false
    limits = [-1.0, 3.0] => limits = [3.0, -1.0] => :33:10: => the wrong way round
    limits = [-1.0, 3.0] => limits = [-1.0, 2.0] => :49:6: => home | outside its limits
    q = [2.4, 0.7] => q = [137, 40] => :49:6: => outside its limits | angles are in radians: 137 degrees are 2.3911 rad
    limits = [-1.0, 3.0] => limits = [80, 172] => :49:6: => these limits, if meant in degrees, are [1.3963, 3.0020] rad
    resistance = 2.0 => resistance = 0.0 => :42:14: => `resistance` | more than zero
    resistance = 2.0 => resistance = 2.0⏎inductance = -1 => :43:14: => `inductance` | zero or more
    max_current = 3.0⏎ =>  => :40:1: => `max_current` | [joint.motor] of [[joint]] 0
    q = [2.4, 0.7] => q = [2.4] => :49:5: => 1 number instead of 2 | one angle per joint
    distal = [0.09, 0.09] => distal = [0.09, 0.04] => :49:5: => home | cannot close
    inertia = 2.0e-6⏎limits => limits => :31:1: => `inertia` | missing
"#;

const SCENE_MISTAKES: &str = r#"
    normal = [0.0, -1.0] => normal = [0.0, 0.0] => :6:10: => `normal` | points nowhere
    normal = [0.0, -1.0] => normal = [0.0, -1.0, 0.0] => :6:10: => 3 numbers instead of 2
    normal = [0.0, -1.0]⏎ =>  => :4:1: => `normal` | missing | add `normal = [0.0, 1.0]`
    damping = 1.0 => rate_hz = 1000 => :8:1: => `rate_hz` | belongs at the top of the file
    point = [0.0, 0.13] => point = [0.13] => :5:9: => 1 number instead of 2
    stiffness = 1000.0 => stiffness = -1000.0 => :7:13: => `stiffness` | zero or more
    damping = 1.0 => damping = -1.0 => :8:11: => `damping` | zero or more
    damping = 1.0 => radius = 1.0 => :8:1: => unknown key `radius` | [[wall]] 0 (plane)
    damping = 1.0 => feed_forward = "on" => :8:16: => off, full, washout
    damping = 1.0 => feed_forward = true => :8:16: => a string in quotes
    damping = 1.0 => washout_hz = 0 => :8:14: => `washout_hz` | more than zero
    damping = 1.0 => washout_hz = 10000 => :8:14: => below half the rate of 20000 Hz
    damping = 1.0 => bilateral = 1 => :8:13: => not true or false
    shape = "sphere" => shape = "cube" => :11:9: => plane, sphere, cylinder
    shape = "sphere" => shape = "cylinder" => :11:9: => moves in space | shape = "sphere"
    radius = 0.05 => radius = 0 => :13:10: => `radius` | more than zero
    radius = 0.05 => radius = 1e-60 => :13:10: => `radius` | more than zero
    radius = 0.05⏎ =>  => :10:1: => `radius` | missing
    direction = [1.0, 0.0] => direction = [0, 0] => :19:13: => points nowhere
    stiffness = 100.0 => stiffness = -1 => :20:13: => zero or more
    [[field]]⏎damping = 1.0 => [[field]]⏎damping = -1.0 => :23:11: => zero or more
    [[field]]⏎damping = 1.0 => [[field]] => :22:1: => `damping` | missing
    rate_hz = 20000 => rate_hz = 199 => :1:11: => from 200 to 50000 Hz
    rate_hz = 20000 => rate_hz = 50001 => :1:11: => from 200 to 50000 Hz
    cutoff_hz = 500 => cutoff_hz = 10000 => :2:13: => below half the rate of 20000 Hz
    cutoff_hz = 500 => cutoff_hz = 0 => :2:13: => more than zero
    cutoff_hz = 500 => estimator = "kalman" => :2:13: => butterworth, first-order, backward-difference
    cutoff_hz = 500 => cutof_hz = 500 => :2:1: => did you mean `cutoff_hz`?
    [[spring]] => [spring] => :17:1: => [[spring]] tables
"#;

fn check_mistakes(table: &str, text: &str, check_error: impl Fn(&str) -> String) {
    for row in table.lines().filter(|row| !row.is_empty()) {
        let cells: Vec<String> = row.trim_start().split(" => ").map(|cell| cell.replace('⏎', "\n")).collect();
        let [from, to, place, words] = &cells[..] else { panic!("{row}") };
        let error = check_error(&replace_once(text, from, to));
        let is_told = error.contains(&format!(".toml{place}")) && words.split(" | ").all(|word| error.contains(word));
        assert!(is_told, "{row}\n{error}");
    }
}

#[test]
fn a_wrong_device_is_refused_with_line_and_remedy() {
    check_mistakes(DEVICE_MISTAKES, DEVICE, |device| check_error(device, SCENE));
}

#[test]
fn a_wrong_scene_is_refused_with_line_and_remedy() {
    check_mistakes(SCENE_MISTAKES, SCENE, |scene| check_error(DEVICE, scene));
    let wall = "[[wall]]\npoint = [0.0, 0.13]\nnormal = [0.0, -1.0]\nstiffness = 1000.0\n";
    let message = check_error(DEVICE, &format!("{SCENE}{}", wall.repeat(7)));
    assert!(message.contains("at most 8 [[wall]] tables"), "{message}");
}

#[test]
fn a_handle_of_a_paddle_is_refused() {
    for name in ["upright-hapkit", "two-paddles"] {
        let shipped = std::fs::read_to_string(shipped_path(&format!("{name}.toml"))).expect("a shipped file");
        let text = replace_once(&shipped, "[home]", "[handle]\nmass = 0.01\n\n[home]");
        let error = DeviceFile::parse(&text, "device").expect_err("a paddle with a handle").to_string();
        assert!(error.lines().count() == 1 && error.contains("paddles take no [handle]"), "{error}");
    }
}

#[test]
fn all_mistakes_of_a_file_are_reported() {
    let mistakes = [
        ("gravity = [0.0, 0.0]\n", "", "`gravity` is missing"),
        ("proximal = [0.07, 0.07]", "proximal = [0.07]", "`proximal` in [geometry] has 1 number"),
        ("mass = 0.02", "mas = 0.02", "did you mean `mass`?"),
        ("com = 0.04", "com = \"4 cm\"", "`com` in [[link]] 2 (distal-1) is a string"),
        ("counts_per_turn = 16384", "counts_per_turn = -1", "`counts_per_turn` in [joint.encoder] of [[joint]] 0"),
        ("resistance = 2.0\n", "", "`resistance` in [joint.motor] of [[joint]] 0 is missing"),
        ("q = [2.4, 0.7]", "q = [2.4]", "`q` in [home] has 1 number"),
    ];
    let text = mistakes.iter().fold(DEVICE.to_string(), |text, (from, to, _)| replace_once(&text, from, to));
    let message = refusal(2, &["check", &Folder::new().write("device.toml", text)]);
    assert_eq!(message.lines().count(), mistakes.len(), "{message}");
    for (line, (_, _, words)) in message.lines().zip(mistakes) {
        assert!(line.contains("device.toml:") && line.contains(words), "{words}: {line}");
    }
    let scene = SCENE.replace("rate_hz = 20000", "rate_hz = 1").replace("stiffness = 1000.0", "stiffness = -1.0");
    let error = SceneFile::parse(&scene.replace("[[field]]\ndamping = 1.0", "[[field]]"), "scene", 2).unwrap_err();
    assert_eq!(error.to_string().lines().count(), 4, "{error}");
}

/// The message for a key from a data sheet names the key to write instead, so that the user does not drop the number.
#[test]
fn terms_of_data_sheets_are_refused_with_the_right_key() {
    let motor = "torque_constant = 0.05\n";
    let encoder = "counts_per_turn = 16384\n";
    let joint = "limits = [-1.0, 3.0]\n";
    for (after, line, words) in [
        (motor, "ratio = 14.7", "multiply torque_constant, back_emf and counts_per_turn by the ratio"),
        (joint, "gear = 5", "rotor's inertia by its square"),
        (motor, "kv = 270", "torque_constant = 9.549 / kv"),
        (motor, "phase_resistance = 0.04", "write resistance"),
        (motor, "pole_pairs = 7", "has kind = \"brushless\" and pole_pairs"),
        (encoder, "lines = 1024", "counts_per_turn = 4 x lines x gear ratio"),
        (encoder, "cpr = 4096", "counts_per_turn = the edges of A and B"),
        (encoder, "type = \"AS5047\"", "write kind = \"as5047\" or \"as5048\""),
        (encoder, "index = true", "set `offset`"),
        (encoder, "noise = 2.0", "cannot be described yet"),
        (joint, "backlash = 0.01", "cannot be described yet"),
    ] {
        let text = check_error(&replace_once(DEVICE, after, &format!("{after}{line}\n")), SCENE);
        assert!(text.contains("unknown key") && text.contains(words) && !text.contains("remove"), "{line}: {text}");
    }
    // In another table the same key is an ordinary unknown key.
    let text = check_error(&replace_once(DEVICE, "name = ", "type = \"five-bar\"\nname = "), SCENE);
    assert!(text.contains("unknown key") && !text.contains("encoder"), "{text}");
}

#[test]
fn files_in_other_formats_and_missing_files_are_refused() {
    let folder = Folder::new();
    let urdf = "<?xml version=\"1.0\"?>\n<!-- own -->\n<robot name=\"a\"><link name=\"b\"/></robot>\n";
    let xacro = "<?xml version=\"1.0\"?>\n<robot><xacro:arm/></robot>\n";
    for (name, text, words) in [
        ("arm.urdf", urdf, "this is URDF"),
        ("arm.xacro", xacro, "this is xacro"),
        ("arm.xml", "<mujoco model=\"a\"><worldbody/></mujoco>\n", "this is MJCF"),
        ("a.json", "{ \"name\": \"a\", \"base\": 0.05 }\n", "this is JSON"),
        ("a.yaml", "# own\nname: a\nmechanism: five-bar\n", "this is YAML"),
        ("a.csv", "wall,stiffness,damping\n0,300,1\n", "this is a table (CSV)"),
    ] {
        let message = refusal(2, &["check", &folder.write(name, text)]);
        assert!(message.lines().count() == 1 && message.contains(words) && message.contains("haptic "), "{message}");
        assert_eq!(message.contains("haptic new --from FILE"), !words.contains("CSV"), "{message}");
    }
    let binary = folder.write("binary.toml", b"name = \"\xff\"");
    let (fifo, huge) = (folder.path("fifo"), folder.write("huge.toml", "#".repeat((1 << 20) + 1)));
    assert!(std::process::Command::new("mkfifo").arg(&fifo).status().unwrap().success());
    for (path, word) in [
        (folder.path("none.toml"), "none.toml: cannot be read"),
        (folder.path("."), "cannot be read"),
        (binary, "binary.toml:1:9: not UTF-8 text"),
        ("/dev/zero".into(), "a pipe or a device"),
        (fifo, "a pipe or a device"),
        (huge, "1 MiB"),
    ] {
        let message = refusal(2, &["check", &path]);
        assert!(message.contains(word) && message.trim_end().lines().count() == 1, "{message}");
    }
    // The recording is a sparse file of 16 GiB, which takes no space on the disk.
    let days = folder.write("days.csv", "");
    std::fs::OpenOptions::new().write(true).open(&days).unwrap().set_len(16 << 30).unwrap();
    type_lines(&format!("2: plot {days} => more than 2 GiB\n2: replay {days} => more than 2 GiB"), &[]);
}

/// The defaults are that counts rise with the angle and that count 0 is angle 0.
#[test]
fn an_encoder_needs_only_its_counts() {
    let short = replace_once(DEVICE, "offset = 0.0\ninverted = false\n", "");
    let of = |text: &str| DeviceFile::parse(text, "device").map(|file| file.description);
    assert_eq!(of(&short), of(DEVICE));
}

#[test]
fn contradictions_of_absolute_encoders_are_refused() {
    let counts = "counts_per_turn = 16384\n";
    let kind = "kind = \"as5047\"\n";
    let compliant = "limits = [-1.0, 3.0]\n[joint.transmission]\nstiffness = 50.0\nencoder_at = \"motor\"\n";
    for (changes, words) in [
        (&[(counts, "kind = \"as5600\"\n")][..], "`kind` in [joint.encoder] of [[joint]] 0 cannot be \"as5600\""),
        (&[(counts, "kind = \"as5047\"\ncounts_per_turn = 4096\n")], "an as5047 always has 16384 counts"),
        (&[(counts, "kind = \"as5048\"\nat = \"link\"\n")], "0 cannot be \"link\""),
        (&[(counts, "at = \"joint\"\ncounts_per_turn = 16384\n")], "unknown key `at`"),
        (&[(counts, kind), ("torque_constant", "ratio = 0.0\ntorque_constant")], "`ratio` in [joint.motor]"),
        (&[(counts, "kind = \"as5047\"\nat = \"joint\"\n"), ("limits = [-1.0, 3.0]\n", compliant)], "different shafts"),
        (&[(counts, kind), ("q = [2.4, 0.7]", "q = [2.4, 0.7]\nby = \"index\"")], "of joint 0 has no index mark"),
    ] {
        let text = changes.iter().fold(DEVICE.to_string(), |text, (from, to)| replace_once(&text, from, to));
        let error = DeviceFile::parse(&text, "device").expect_err(words).to_string();
        assert!(error.lines().count() == 1 && error.contains(words), "{words}: {error}");
    }
    let slide = "name = \"slide\"\nmechanism = \"chain\"\ngravity = [0.0, 0.0, 0.0]\n[geometry]\ntip = [0.0, 0.0, 0.0]\n\
                 task = [\"z\"]\n[[link]]\nmass = 0.1\ncom = [0.0, 0.0, 0.0]\ninertia = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]\n\
                 [[joint]]\ntype = \"prismatic\"\ninertia = 0.01\n[joint.encoder]\nkind = \"as5047\"\n";
    for (more, words) in [("at = \"joint\"\n", "a slide does not turn"), ("", "turns_per_metre = 25")] {
        let error = DeviceFile::parse(&format!("{slide}{more}"), "device").expect_err(words).to_string();
        assert!(error.contains(words), "{words}: {error}");
    }
    // The counts per turn of the joint follow from the ratio.
    let motor = "[joint.motor]\nturns_per_metre = 40.0\nforce_constant = 5.0\nresistance = 2.0\nmax_current = 1.0\n";
    let file = DeviceFile::parse(&format!("{slide}{motor}"), "device").expect("a valid file");
    let counts = file.description.joints[0].encoder.expect("an encoder").counts_per_turn / std::f64::consts::TAU;
    assert!((counts - 40.0 * 16_384.0).abs() < 1e-6, "{counts} per metre");
    let text = haptic_host::read_back::to_toml(
        &[],
        &haptic_host::read_back::device_entries(&file.device().expect("a device")),
    );
    assert!(text.contains("kind = \"as5047\"\nat = \"motor\"") && text.contains("turns_per_metre = 40.0"), "{text}");
}

type Parser = fn(&str) -> Result<(), FileError>;
fn shipped_files() -> Vec<(String, Parser)> {
    let mut all: Vec<(String, Parser)> = Vec::new();
    for path in toml_files("") {
        let text = std::fs::read_to_string(&path).expect("readable");
        let task = DeviceFile::parse(&text, &path).expect("sound").spec().task;
        all.push((text, |text| DeviceFile::parse(text, "device").map(drop)));
        for scene in toml_files(&format!("scenes/{}", path.file_stem().expect("a name").to_string_lossy())) {
            let parser: Parser = match task {
                1 => |text| SceneFile::parse(text, "scene", 1).map(drop),
                2 => |text| SceneFile::parse(text, "scene", 2).map(drop),
                _ => |text| SceneFile::parse(text, "scene", 3).map(drop),
            };
            all.push((std::fs::read_to_string(scene).expect("readable"), parser));
        }
    }
    all
}

/// Returns the text with one line replaced.
fn replace_line(text: &str, line: usize, replacement: &str) -> String {
    let lines = text.lines().enumerate().map(|(index, old)| if index == line { replacement } else { old });
    lines.collect::<Vec<_>>().join("\n")
}

#[test]
fn every_misspelt_key_and_mistyped_value_is_refused() {
    let mut tried = 0;
    for (text, parse) in shipped_files() {
        parse(&text).expect("sound as shipped");
        for (index, line) in text.lines().enumerate() {
            let Some((key, value)) = line.split_once(" = ") else { continue };
            if line.starts_with('#') {
                continue;
            }
            tried += 1;
            let misspelt = parse(&replace_line(&text, index, &format!("{key}x = {value}")));
            let error = misspelt.expect_err(&format!("`{key}x` must be refused"));
            // An error of the table can come first: without its kind, an absolute encoder lacks counts.
            let place = format!(":{}:1: unknown key `{key}x`", index + 1);
            assert!(error.to_string().contains(&place), "{error}");
            // A date is a wrong value for every key.
            let mistyped = parse(&replace_line(&text, index, &format!("{key} = 1979-05-27")));
            let error = mistyped.expect_err(&format!("`{key}` must not be a date"));
            assert_eq!(error.position, Some((index + 1, key.len() + 4)), "{error}");
            assert!(error.to_string().contains("a date"), "{error}");
            // Numbers must be finite.
            let number = |value: &str| value.split('#').next().is_some_and(|value| value.trim().parse::<f64>().is_ok());
            if number(value) {
                for wrong in ["nan", "inf", "-inf", "1e99"] {
                    let error = parse(&replace_line(&text, index, &format!("{key} = {wrong}"))).expect_err(wrong);
                    assert_eq!(error.position, Some((index + 1, key.len() + 4)), "{error}");
                }
            }
        }
    }
    assert!(tried > 300, "{tried} keys tried");
}

#[test]
fn a_file_cut_short_anywhere_never_crashes_the_parser() {
    for (text, parse) in shipped_files() {
        for end in (0..text.len()).filter(|end| text.is_char_boundary(*end)) {
            if let Err(error) = parse(&text[..end]) {
                let (line, _) = error.position.expect("a place in the file");
                assert!(line <= text[..end].lines().count().max(1) + 1, "{error}");
            }
        }
    }
}

/// Text of a file or its name must not control the terminal. ESC could move the cursor or rename the window.
#[test]
fn control_characters_of_a_file_do_not_reach_the_terminal() {
    let random = [("mechanism =", "\"\\u001b]0;x\\u0007\" = 1\nmechanism =")];
    let folder = Folder::new();
    let path = folder.path("a\u{1b}[31m\u{9b}2J.toml");
    std::fs::rename(folder.write_changed("coupled-five-bar", &random), &path).unwrap();
    for arguments in [
        &["check", &path][..],
        &["model", &path, "--q", "2.4,0.7"],
        &["info", "--port", &format!("sim:{path}")],
        &["device", &path, "--port", "sim"],
    ] {
        let (code, out, err) = run(arguments);
        let printed = out + &err;
        assert!(code != 0 && !printed.is_empty(), "{arguments:?}");
        assert!(printed.chars().all(|c| !c.is_control() || c == '\n'), "{arguments:?}: {printed:?}");
    }
}

#[test]
fn a_model_is_converted_and_named_where_it_is_no_device_file() {
    let folder = Folder::new();
    let inertial = r#"<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>"#;
    let tip = format!(r#"<body name="b" pos="0.1 0 0">{inertial}</body>"#);
    let arm = format!(r#"<body name="a">{inertial}<joint name="j"/>{tip}</body>"#);
    let model = folder.write("arm.xml", format!("<mujoco><worldbody>{arm}</worldbody></mujoco>"));
    let device = folder.path("arm.toml");
    let table = format!(
        "new --from {model} -o {device} => a chain of 1 joint; then `haptic check | Tip: origin of b
         new --from {model} --tip b --joints j => mechanism = \"chain\" | verified = false
         2: new --from {model} --joints k => no joint \"k\" | (--joints)
         2: new --from {model} --tip c => no body is named \"c\" | (--tip)
         2: new five-bar --from {model} => cannot be used with
         2: new --tip a => --from
         2: check {model} => this is MJCF | (haptic new --from FILE -o OUT.toml)"
    );
    type_lines(&table, &[]);
}
