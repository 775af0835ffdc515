//! Every shipped scene (devices/scenes/DEVICE/) is within reach of its device and away from the home pose.

use crate::common::prelude::*;
use crate::common::toml_files;
use haptic_bridge::with_mechanism;
use nalgebra::SVector;

/// Loads every shipped device with its scenes.
fn devices_with_scenes() -> Vec<(DeviceFile, Vec<SceneFile>)> {
    toml_files("")
        .into_iter()
        .map(|path| {
            let device = DeviceFile::load(&path).unwrap_or_else(|error| panic!("{error}"));
            let scenes = toml_files(&format!("scenes/{}", device.name))
                .iter()
                .map(|scene| SceneFile::load(scene, device.spec().task).unwrap_or_else(|error| panic!("{error}")))
                .collect();
            (device, scenes)
        })
        .collect()
}

/// Returns the tip's distance from each wall at joint angles `q`; `None` if the linkage cannot close there.
fn distances(device: &DeviceFile, scene: &Scene<f64>, q: &[f64; 3]) -> Option<Vec<f64>> {
    fn wall_gaps<const N: usize, M: Mechanism<f64, N>>(m: &M, scene: &Scene<f64>, q: &[f64; 3]) -> Option<Vec<f64>> {
        let pose = m.pose::<Libm>(&SVector::<f64, N>::from_fn(|i, _| q[i]));
        let mut tip = m.tip(&pose);
        (M::SPEC.task..N).for_each(|i| tip[i] = 0.0);
        let distance = |wall: &haptic_bridge::render::scene::Wall<f64>| wall.surface.contact::<Libm, N>(&tip).distance;
        (m.regularity(&pose).parallel > 0.0).then(|| scene.walls.iter().map(distance).collect())
    }
    with_mechanism!(&device.mechanism, m => wall_gaps(m, scene, q))
}

#[test]
fn every_device_has_a_scene_and_home_is_outside_every_wall() {
    for (device, scenes) in devices_with_scenes() {
        assert!(!scenes.is_empty(), "{} has no scene", device.name);
        let home = device.description.home.expect("shipped devices have a home");
        for file in scenes {
            assert_eq!(file.walls_entered(&device, &home), Vec::<usize>::new(), "{}", file.path.display());
        }
    }
}

#[test]
fn a_home_inside_a_wall_is_reported() {
    let device = crate::common::shipped_device("haply-2diy");
    let home = device.description.home.expect("shipped devices have a home");
    // In the home pose the tip is 0.114 m in front of the motors.
    let text = "[[wall]]\npoint = [0.0, 0.13]\nnormal = [0.0, -1.0]\nstiffness = 1\n\
                [[wall]]\npoint = [0.0, 0.11]\nnormal = [0.0, -1.0]\nstiffness = 1\n";
    let scene = SceneFile::parse(text, "scene", 2).expect("sound");
    assert_eq!(scene.walls_entered(&device, &home), vec![1]);
}

#[test]
fn every_wall_can_be_reached_from_both_sides() {
    for (device, scenes) in devices_with_scenes() {
        let home = device.description.home.expect("shipped devices have a home");
        for file in scenes {
            let mut touched = vec![false; file.scene.walls.len()];
            // A hand would move the tip about ±1 rad around home.
            let steps = || (-10..=10).map(|step| f64::from(step) * 0.1);
            let all = steps().flat_map(|a| steps().flat_map(move |b| steps().map(move |c| [a, b, c])));
            for offset in all {
                let q = core::array::from_fn(|i| home[i] + offset[i]);
                let distances = distances(&device, &file.scene, &q).unwrap_or_default();
                for (touched, distance) in touched.iter_mut().zip(distances) {
                    *touched |= distance < -0.002;
                }
            }
            assert!(touched.iter().all(|touched| *touched), "{}: out of reach: {touched:?}", file.path.display());
        }
    }
}
