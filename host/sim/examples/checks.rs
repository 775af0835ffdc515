#![allow(dead_code)]
#[path = "../../tool/tests/common/drawn.rs"]
mod drawn;
#[path = "../../tool/tests/common/forces.rs"]
mod forces;
#[path = "../../tool/tests/common/lies.rs"]
mod lies;
use haptic_host::device_file::DeviceFile;
pub fn shipped(name: &str) -> DeviceFile {
    DeviceFile::load(format!("devices/{name}.toml")).unwrap()
}
pub fn all_shipped() -> Vec<DeviceFile> {
    let mut files: Vec<_> = std::fs::read_dir("devices").unwrap().map(|e| e.unwrap().path()).collect();
    files.retain(|p| p.extension().is_some_and(|e| e == "toml"));
    files.sort();
    files.into_iter().map(|p| DeviceFile::load(p).unwrap()).collect()
}
fn main() {
    let args: Vec<String> = std::env::args().collect();
    let kind = args[1].as_str();
    let (from, to): (u64, u64) = (args[2].parse().unwrap(), args[3].parse().unwrap());
    let mut all = Vec::new();
    match kind {
        "shipped" => {
            let nothing = lies::Lie { what: "nothing", when: lies::When::Always(|_, _| ()) };
            for file in all_shipped() {
                println!("{} {:?}", file.name, lies::moved(&file, &nothing));
            }
            return;
        }
        "lies" => {
            let mut file = shipped("hapkit-paddle");
            let motor = file.description.joints[0].motor.as_mut().unwrap();
            (motor.torque_constant, motor.back_emf, motor.resistance, motor.max_current) = (1.9, 1.9, 2.33, 2.0);
            for what in [
                "first current sensor freezes",
                "current sensors begin to show half",
                "first current sensor 0.5 A too low",
            ] {
                let lie = lies::LIES.iter().find(|lie| lie.what == what).unwrap();
                println!("{what}: {:?}", lies::outcome(&file, lie));
            }
            return;
        }
        "wrong" => {
            for s in from..to {
                all.push(drawn::check_wrong(s));
            }
        }
        _ => {
            for s in from..to {
                all.push(drawn::check_sound(s));
            }
        }
    }
    let passed = all.iter().filter(|c| c.ended.is_ok()).count();
    let bad: Vec<_> = all
        .iter()
        .filter(|c| if kind == "wrong" { c.moved.push > 5.0 || c.moved.travel > 0.15 } else { c.ended.is_err() })
        .collect();
    for c in &bad {
        println!("{c}");
    }
    let m = |f: fn(&drawn::Checked) -> f64| all.iter().map(f).fold(0.0, f64::max);
    println!(
        "{} of {} bad, {} passed, worst {:.2} N {:.3} rad",
        bad.len(),
        all.len(),
        passed,
        m(|c| c.moved.push),
        m(|c| c.moved.travel)
    );
}
