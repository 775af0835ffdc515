//! `haptic model` reports the golden cases as the library computes them, in both precisions. The library's tests have
//! their own reader of device files, which reads the same values as the tool.

use haptic_host::device_file::DeviceFile;
use haptic_stability::model::{Precision, WallForce, evaluate};

#[allow(dead_code)]
#[path = "../../../tests/common/device_file.rs"]
mod device_file;
#[path = "../../../tests/golden/mod.rs"]
mod golden;
use golden::{F32_TOLERANCE, F64_TOLERANCE, assert_agree, cases, list, number, text};

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
        let as_f64 = report(Precision::F64);
        let quantities = [
            ("position", as_f64.position),
            ("jacobian", as_f64.jacobian.concat()),
            ("mass", as_f64.mass.concat()),
            ("bias", as_f64.bias),
            ("w_rr", as_f64.w_rr.concat()),
            ("w_eff", as_f64.w_eff.concat()),
            ("coupling", as_f64.coupling.concat()),
            ("z_r", as_f64.z_r),
            ("f_a", as_f64.f_a),
            ("torque", as_f64.torque),
            ("torque_without_feed_forward", as_f64.torque_without_feed_forward),
        ];
        assert_agree(&case, &quantities, F64_TOLERANCE);
        let condition = number(&case["condition_jacobian"]);
        assert!((as_f64.condition.jacobian / condition - 1.0).abs() < 1.0e-9, "{}: {:?}", case["id"], as_f64.condition);
        let single = report(Precision::F32);
        let torques = [("torque", single.torque), ("torque_without_feed_forward", single.torque_without_feed_forward)];
        assert_agree(&case, &torques, F32_TOLERANCE);
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
