//! `haptic model` reports the golden cases as the library computes them, in both precisions. The library's tests have
//! their own reader of device files, which reads the same values as the tool.

use haptic_host::device_file::DeviceFile;
use haptic_stability::model::{Precision, WallForce, evaluate};

#[allow(dead_code)]
#[path = "../../../tests/common/device_file.rs"]
mod device_file;
#[path = "../../../tests/golden/mod.rs"]
mod golden;
use golden::{F32_TOLERANCE, F64_TOLERANCE, agree, cases, list, number, text};

#[test]
fn the_report_has_every_quantity_under_its_name() {
    for case in cases() {
        let device = DeviceFile::parse(text(&case["device"]), text(&case["id"])).expect("a sound device");
        let (normal, force) = (list(&case["normal"]), number(&case["force"]));
        let wall = WallForce { normal, force, stiffness: 1.0, feed_forward: true };
        let report = |precision| {
            evaluate(&device, &list(&case["q"]), &list(&case["qd"]), std::slice::from_ref(&wall), precision)
                .expect("a regular pose")
        };
        let double = report(Precision::F64);
        let quantities = [
            ("position", double.position),
            ("jacobian", double.jacobian.concat()),
            ("mass", double.mass.concat()),
            ("bias", double.bias),
            ("w_rr", double.w_rr.concat()),
            ("w_eff", double.w_eff.concat()),
            ("coupling", double.coupling.concat()),
            ("z_r", double.z_r),
            ("f_a", double.f_a),
            ("torque", double.torque),
            ("torque_without_feed_forward", double.torque_without_feed_forward),
        ];
        agree(&case, &quantities, F64_TOLERANCE);
        let condition = number(&case["condition_jacobian"]);
        assert!((double.condition.jacobian / condition - 1.0).abs() < 1.0e-9, "{}: {:?}", case["id"], double.condition);
        let single = report(Precision::F32);
        let torques = [("torque", single.torque), ("torque_without_feed_forward", single.torque_without_feed_forward)];
        agree(&case, &torques, F32_TOLERANCE);
    }
}

#[test]
fn the_librarys_tests_read_device_files_as_the_tool_does() {
    let files = crate::common::toml_files("").into_iter();
    let shipped = files.map(|path| std::fs::read_to_string(path).expect("a readable file"));
    let golden = cases().into_iter().map(|case| text(&case["device"]).to_string());
    for file in shipped.chain(golden) {
        let tool = DeviceFile::parse(&file, "device").expect("a sound device");
        assert_eq!(device_file::parse(&file), tool.description, "{}", tool.name);
    }
}
