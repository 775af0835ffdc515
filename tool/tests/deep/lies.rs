//! What a board believes of files, wires and sensors that are wrong: docs/results/lies.csv.

use crate::common::forces::too_hard;
use crate::common::lies::{LIES, Lie, Outcome, When, outcome};
use crate::common::{root, shipped};
use haptic_host::device_file::DeviceFile;
use haptic_host::output::csv_line;

const DEVICES: [&str; 4] = ["coupled-five-bar", "hapkit-paddle", "pantograph-mk2", "woodenhaptics"];

/// What the table says of a lie about a device.
fn cell(file: &DeviceFile, lie: &Lie) -> String {
    // A paddle has one joint.
    if lie.what.contains("first two") && file.spec().joints < 2 {
        return String::new();
    }
    match outcome(file, lie) {
        Outcome::Refused(record) => format!("check: {}", record.fault.name()),
        Outcome::Seen(record, after, harm) if harm.push > 0.0 => {
            format!("{:.2} ms: {}; {:.1} N, {:.1} rad/s", after * 1e3, record.fault.name(), harm.push, harm.speed)
        }
        Outcome::Seen(record, after, _) => format!("{:.2} ms: {}", after * 1e3, record.fault.name()),
        Outcome::Missed(harm) => format!("no: {:.1} N, {:.1} A, {:.1} rad/s", harm.push, harm.current, harm.speed),
    }
}

/// `UPDATE_DOCS=1 cargo xtask test --deep lies` writes it anew.
#[test]
fn the_table_of_lies_is_what_comes_of_them() {
    let row = |what: &str, cells: [String; DEVICES.len()]| csv_line(std::iter::once(what.into()).chain(cells));
    let mut made = row("what is wrong", DEVICES.map(String::from));
    let nothing = Lie { what: "nothing", when: When::Always(|_, _| ()) };
    for lie in std::iter::once(&nothing).chain(&LIES) {
        made += &row(lie.what, DEVICES.map(|name| cell(&shipped(name), lie)));
    }
    let path = root().join("docs/results/lies.csv");
    if std::env::var_os("UPDATE_DOCS").is_some() {
        std::fs::write(&path, made).expect("docs/results/lies.csv can be written");
    } else {
        let kept = std::fs::read_to_string(&path).expect("docs/results/lies.csv is there");
        assert_eq!(kept, made, "run UPDATE_DOCS=1 cargo xtask test --deep lies");
    }
}

/// Scenes and motions that nobody has drawn before: HAPTIC_SEQUENCES of them for each device.
#[test]
fn no_shipped_device_pushes_harder_than_its_limit_allows() {
    let count = std::env::var("HAPTIC_SEQUENCES").ok().and_then(|text| text.parse().ok()).unwrap_or(20);
    let first =
        std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).map_or(0, |since| since.as_secs()) << 20;
    println!("seeds from {first}");
    let wrong = too_hard(first..first + count);
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
