//! Settings decode to the encoded value or are refused. A changed layout without a new version fails these tests.

use crate::rig;
use haptic_bridge::board::settings::{BoardName, Damage, Key, LONGEST_SETTING, Polarity, Setting, decode, encode};
use haptic_bridge::checksum::crc32;
use haptic_bridge::control::{HostAction, Rules};
use haptic_bridge::model::cogging::{Harmonic, Potentials};
use haptic_bridge::model::description::Description;
use haptic_bridge::model::device::Device;
use haptic_bridge::render::scene::{Cylinder, FeedForward, Posture, Scene, Sphere, Spring, Surface, VelocityTerms};
use haptic_bridge::render::velocity::{Chosen, Estimator};
use haptic_bridge::safety::limits::Limits;
use std::fmt::Debug;
use std::fmt::Write as _;
use std::path::Path;

fn full_scene() -> Scene<f32> {
    let mut scene = rig::scene(3, &[]);
    for i in 0..8 {
        let mut wall = rig::wall(0.125 * i as f32, 500.0 + i as f32);
        wall.surface = match i % 3 {
            0 => Surface::Sphere(Sphere { center: [0.5, -0.25, 0.0], radius: 0.0625, inside: i > 3 }),
            1 => Surface::Cylinder(Cylinder {
                point: [0.0, 0.125, 1.0],
                axis: [0.0, 1.0, 0.0],
                radius: 0.03125,
                inside: false,
            }),
            _ => wall.surface,
        };
        wall.feed_forward = [FeedForward::Off, FeedForward::Full, FeedForward::Washout][i % 3];
        wall.bilateral = i == 7;
        scene.walls.push(wall).unwrap();
    }
    for i in 0..4 {
        let spring = Spring { point: [0.5 * i as f32; 3], direction: [0.0, 0.0, 1.0], stiffness: 250.0, damping: 2.5 };
        scene.springs.push(spring).unwrap();
    }
    scene.posture = Some(Posture { orientation: 1.5, stiffness: 0.25, damping: 0.0625 });
    scene
}

fn full_rules() -> Rules {
    Rules {
        host_action: HostAction::Hold,
        host_seconds: 0.25,
        passivity: true,
        index_period: [60_000, -1, 4_096],
        ..rig::rules()
    }
}

/// Returns a device like those that the first firmware stored. The angles at count 0 equal the description's home, even
/// if it is between two counts. Boards in the field have such entries.
fn stored_device() -> Device<f32> {
    let five_bar = rig::five_bar();
    let home = five_bar.home.map(|home| home.map(|q| q as f32));
    Device { home, ..rig::device(&Description { home: None, ..five_bar }) }
}

/// Returns the largest potentials.
fn potentials() -> Potentials {
    let harmonic = |order: u16| Harmonic { order, energy: 0.125 / f32::from(order), phase: -1.5 };
    Potentials([12, 24, 84].map(|order| (1..=8).map(|i| harmonic(i * order)).collect()))
}

/// Returns one encoded value of every setting, with the setting's key.
fn specimens() -> Vec<(Key, Vec<u8>)> {
    fn entry<S: Setting>(value: &S) -> (Key, Vec<u8>) {
        (S::KEY, encode(value).expect("the value fits an entry").to_vec())
    }
    vec![
        entry(&stored_device()),
        entry(&full_scene()),
        entry(&full_rules()),
        entry(&potentials()),
        entry(&Polarity(0xC0FF_EE01)),
        entry(&BoardName("bench left".try_into().unwrap())),
    ]
}

fn assert_round_trip<S: Setting + PartialEq + Debug>(value: &S) {
    assert_eq!(decode::<S>(&encode(value).unwrap()).as_ref(), Ok(value));
}

#[test]
fn every_setting_decodes_to_the_encoded_value() {
    assert_round_trip(&rig::device(&rig::five_bar()));
    assert_round_trip(&rig::device(&rig::paddle()));
    assert_round_trip(&rig::device(&rig::sensing_paddle()));
    assert_round_trip(&full_scene());
    assert_round_trip(&full_rules());
    assert_round_trip(&potentials());
    assert_round_trip(&Polarity(7));
    assert_round_trip(&BoardName::default());
}

#[test]
fn every_key_has_a_specimen() {
    let keys: Vec<Key> = specimens().into_iter().map(|(key, _)| key).collect();
    assert_eq!(keys, Key::ALL);
}

fn decode_entry(key: Key, entry: &[u8]) -> Result<(), Damage> {
    match key {
        Key::Device => decode::<Device<f32>>(entry).map(drop),
        Key::Scene => decode::<Scene<f32>>(entry).map(drop),
        Key::Rules => decode::<Rules>(entry).map(drop),
        Key::Cogging => decode::<Potentials>(entry).map(drop),
        Key::Polarity => decode::<Polarity>(entry).map(drop),
        Key::Name => decode::<BoardName>(entry).map(drop),
    }
}

#[test]
fn an_entry_with_any_bit_wrong_is_refused() {
    for (key, entry) in specimens() {
        for bit in 0..8 * entry.len() {
            let mut damaged = entry.clone();
            damaged[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(decode_entry(key, &damaged), Err(Damage::Corrupt), "{key:?}, bit {bit}");
        }
    }
}

#[test]
fn a_shortened_or_extended_entry_is_refused() {
    for (key, entry) in specimens() {
        for length in 0..entry.len() {
            assert_eq!(decode_entry(key, &entry[..length]), Err(Damage::Corrupt), "{key:?}, {length} bytes");
        }
        let extended = [&entry[..], &[0]].concat();
        assert_eq!(decode_entry(key, &extended), Err(Damage::Corrupt));
    }
}

/// Changes the body of an entry and appends the matching checksum.
fn with_changed_body(entry: &[u8], change: impl Fn(&mut Vec<u8>)) -> Vec<u8> {
    let mut body = entry[..entry.len() - 4].to_vec();
    change(&mut body);
    let sum = crc32(&body).to_le_bytes();
    [&body[..], &sum].concat()
}

#[test]
fn another_version_is_reported_with_its_number() {
    for (key, entry) in specimens() {
        let newer = with_changed_body(&entry, |body| body[1] = 9);
        assert_eq!(decode_entry(key, &newer), Err(Damage::UnknownVersion(9)), "{key:?}");
    }
}

#[test]
fn another_key_and_trailing_bytes_are_refused() {
    for (key, entry) in specimens() {
        assert_eq!(
            decode_entry(key, &with_changed_body(&entry, |body| body[0] ^= 0x40)),
            Err(Damage::OtherKey),
            "{key:?}"
        );
        assert_eq!(decode_entry(key, &with_changed_body(&entry, |body| body.push(0))), Err(Damage::Corrupt), "{key:?}");
        assert_eq!(
            decode_entry(key, &with_changed_body(&entry, |body| body.truncate(1))),
            Err(Damage::Corrupt),
            "{key:?}"
        );
    }
}

#[test]
fn the_largest_scene_fits_an_entry_with_room_to_spare() {
    let length = encode(&full_scene()).unwrap().len();
    assert!(length < LONGEST_SETTING, "an entry of {length} bytes");
}

#[test]
fn the_checksum_is_the_published_crc_32() {
    assert_eq!(crc32(b"123456789"), 0xCBF4_3926);
}

#[test]
fn a_scene_of_version_1_keeps_its_velocity_terms() {
    let entry = earlier_scene_entry(1);
    let expected =
        Scene { velocity_terms: VelocityTerms::Paper, feed_forward_gain: 1.0, posture: None, ..full_scene() };
    assert_eq!(decode::<Scene<f32>>(&entry), Ok(expected.clone()));
    // The flag of version 1 follows rate, cutoff, estimator and weight.
    let off = with_changed_body(&entry, |body| body[13] = 0);
    assert_eq!(decode::<Scene<f32>>(&off), Ok(Scene { velocity_terms: VelocityTerms::Off, ..expected }));
    let cut = with_changed_body(&entry, |body| body.truncate(body.len() - 1));
    assert_eq!(decode::<Scene<f32>>(&cut), Err(Damage::Corrupt));
}

#[test]
fn devices_of_earlier_versions_have_brushed_motors() {
    let entry = earlier_entry("device-3", [1, 3]);
    assert_eq!(decode::<Device<f32>>(&entry), Ok(stored_device()));
    // Version 2 had neither homing nor encoders without motors.
    let without_additions = |body: &mut Vec<u8>| {
        body[1] = 2;
        body.truncate(body.len() - 2);
    };
    assert_eq!(decode::<Device<f32>>(&with_changed_body(&entry, without_additions)), Ok(stored_device()));
}

#[test]
fn rules_without_a_tip_force_limit_get_a_low_limit() {
    // This is the entry `rules 1` of tests/golden/settings.txt from the time when version 1 was the newest.
    let hex = "03019a99993e9a99993e9a99993e0000404000004040000040400000803f0000803f0000803f0000a0410000a0410000a041\
               00000040000020410000e041010000803e01c0a907018040cea6abd0";
    let entry: Vec<u8> =
        (0..hex.len() / 2).map(|i| u8::from_str_radix(&hex[2 * i..2 * i + 2], 16).expect("hexadecimal")).collect();
    let rules = full_rules();
    let expected = Rules { limits: Limits { tip_force: 5.0, ..rules.limits }, ..rules };
    assert_eq!(decode::<Rules>(&entry), Ok(expected));
    let json = serde_json::to_value(rules).expect("rules as JSON");
    let mut old = json.clone();
    old["limits"].as_object_mut().expect("fields").remove("tip_force").expect("a field");
    assert_eq!(serde_json::from_value::<Rules>(old).expect("readable rules"), expected);
    assert_eq!(serde_json::from_value::<Rules>(json).expect("readable rules"), rules);
}

/// Reads an entry of an earlier version from tests/golden, which has this key and version.
fn earlier_entry(name: &str, begin: [u8; 2]) -> Vec<u8> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/golden/{name}.txt"));
    let hex = std::fs::read_to_string(path).expect("the golden file is there");
    let hex = hex.trim();
    let entry: Vec<u8> =
        (0..hex.len() / 2).map(|i| u8::from_str_radix(&hex[2 * i..2 * i + 2], 16).expect("hexadecimal")).collect();
    assert_eq!(entry[..2], begin, "{name}");
    entry
}

fn earlier_scene_entry(version: u8) -> Vec<u8> {
    earlier_entry(&format!("scene-{version}"), [2, version])
}

#[test]
fn scenes_of_earlier_versions_decode_without_a_posture() {
    for version in [2, 3] {
        assert_eq!(
            decode::<Scene<f32>>(&earlier_scene_entry(version)),
            Ok(Scene { posture: None, ..full_scene() }),
            "version {version}"
        );
    }
}

#[test]
fn every_estimator_keeps_its_options() {
    for (_, estimator) in Estimator::ALL {
        let chosen = estimator.chosen().map(|chosen| Chosen { value: chosen.value + 1, filtered: true });
        let estimator = chosen.map_or(*estimator, |chosen| estimator.with_options(chosen));
        assert_round_trip(&Scene { estimator, ..full_scene() });
    }
}

#[test]
fn a_scene_of_version_1_reads_from_a_json_backup() {
    let json = serde_json::to_value(full_scene()).expect("a scene as JSON");
    assert_eq!(json["velocity_terms"], "rendered");
    for (stored, expected) in [(true, VelocityTerms::Paper), (false, VelocityTerms::Off)] {
        let mut old = json.clone();
        let fields = old.as_object_mut().expect("fields");
        fields.insert("velocity_terms".into(), stored.into());
        fields.remove("feed_forward_gain").expect("a field");
        fields.remove("admissible").expect("a field");
        fields.remove("posture").expect("a field");
        let read: Scene<f32> = serde_json::from_value(old).expect("a readable scene");
        assert_eq!(read, Scene { velocity_terms: expected, posture: None, ..full_scene() });
    }
    let mut wrong = json;
    wrong.as_object_mut().expect("fields").insert("velocity_terms".into(), "some".into());
    assert!(serde_json::from_value::<Scene<f32>>(wrong).is_err());
}

/// Boards in the field have these bytes, which must always decode to the same values unless the version changes.
/// `UPDATE_GOLDEN=1 cargo test settings` rewrites the file after a version was raised.
#[test]
fn entries_are_byte_for_byte_those_of_earlier_firmware() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/settings.txt");
    let mut now = String::from("# key version: the entry, in hexadecimal. See tests/settings.rs.\n");
    for (key, entry) in specimens() {
        let hex: String = entry.iter().map(|byte| format!("{byte:02x}")).collect();
        writeln!(now, "{} {}: {hex}", key.name(), entry[1]).unwrap();
    }
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        std::fs::write(&path, &now).unwrap();
    }
    let then = std::fs::read_to_string(&path).expect("the golden file is there");
    for (then, now) in then.lines().zip(now.lines()) {
        assert_eq!(then, now, "the layout of a setting changed: raise its VERSION, then update the golden file");
    }
    assert_eq!(then.lines().count(), now.lines().count());
}
