//! `haptic tune` agrees with derived results and with a plain scan of all settings.

use crate::common::prelude::*;
use crate::common::{Folder, ideal_loop, json, point_mass, root, shipped_device, tuned, type_lines};
use haptic_bridge::render::velocity::{Chosen, Estimator};
use haptic_predict::tune::{Margins, Question, Settings, accepted_wall, extreme_device, to_toml, tune};
use haptic_stability::analysis::control_loop::CURRENT_LOOP_HZ;
use haptic_stability::analysis::range::stiffnesses;

fn control_loop(rate_hz: f64) -> Loop {
    ideal_loop(rate_hz, 0.5, LinearEstimator::Butterworth(0.025 * rate_hz))
}

/// By (4), a controller with another mass matrix renders a force f with the torque t f. On an undamped device the tip
/// then accelerates along n by Jr M⁻¹ t f, so the loop is that of a mass 1/(Jr M⁻¹ t).
#[test]
fn a_wrong_mass_matrix_changes_the_inertia_of_the_loop() {
    let file = shipped_device("coupled-five-bar");
    let (q, n) = ([2.6, 1.75], [0.94, -0.34]);
    let believed = Linearised::at(&file.description, &q, &n).unwrap().undamped();
    let mut device = believed.clone();
    device.mass += DMatrix::from_row_slice(2, 2, &[8e-4, 2e-4, 2e-4, 0.0]);
    let torque = believed.shaped_torque();
    let inertia = 1.0 / device.row.dot(&device.mass.clone().cholesky().unwrap().solve(&torque));
    assert!(
        (inertia / device.w_rr() - 1.0).abs() > 0.003 && (inertia / believed.w_rr() - 1.0).abs() > 0.01,
        "equal models"
    );
    let around = control_loop(5_000.0);
    for damping in [20.0, 80.0, 200.0] {
        let of_one = domain(&point_mass(1.0), &around, Mode::Off, Some(&[damping])).unwrap().boundary[0].kp;
        let found = stiffnesses(&device, &believed, &around, Mode::Full, &[inertia * damping]).unwrap()[0];
        assert!((found / (inertia * of_one) - 1.0).abs() < 1e-6, "{damping}: {found}, {}", inertia * of_one);
    }
}

#[test]
fn no_other_signs_of_the_inertia_errors_are_worse() {
    let file = shipped_device("coupled-five-bar");
    let (q, n) = ([2.6, 1.75], [0.94, -0.34]);
    let at = |description: &Description| Linearised::at(description, &q, &n).unwrap();
    let believed = at(&file.description);
    for shaped in [false, true] {
        let torque = if shaped { believed.shaped_torque() } else { believed.row.clone() };
        let inertia = |description: &Description| {
            let device = at(description);
            1.0 / device.row.dot(&device.mass.cholesky().unwrap().solve(&torque))
        };
        let found =
            inertia(&extreme_device(&file.description, &q, &n, Admissible::Orientation, shaped, 0.1, false).unwrap());
        let mut smallest = f64::INFINITY;
        for signs in 0..1 << 7 {
            let factor = |part: usize| if signs >> part & 1 == 1 { 1.1 } else { 0.9 };
            let mut changed_device = file.description;
            for (part, link) in changed_device.links.iter_mut().enumerate() {
                link.mass *= factor(part);
                link.inertia *= factor(part);
            }
            for (part, joint) in changed_device.joints[..2].iter_mut().enumerate() {
                joint.inertia *= factor(4 + part);
            }
            changed_device.handle_mass *= factor(6);
            smallest = smallest.min(inertia(&changed_device));
        }
        assert!((found / smallest - 1.0).abs() < 1e-3, "shaped {shaped}: {found} kg, but {smallest} kg is possible");
        assert!(found < 0.95 * inertia(&file.description), "shaped {shaped}");
    }
}

fn question(file: &DeviceFile, margins: Margins) -> Question<'_> {
    let (q, normal) = (vec![2.3, 0.84159265358979], vec![0.0, -1.0]);
    Question { q, normal, margins, board_ripple_n: Some(0.1), ..tuned::question(file, 5_000.0) }
}

/// Without margins a wall is stable if it is in the range of `haptic range`, which is computed here for every wall.
#[test]
fn no_wall_of_a_plain_scan_is_much_stiffer() {
    let file = shipped_device("haply-2diy");
    let question = question(&file, Margins::NONE);
    let found = tune(&question, &Sweep::quiet()).unwrap();
    let best = found.best.settings;
    assert!(found.best.ripple_n <= question.ripple_n);
    assert_eq!(tune(&question, &Sweep::quiet()).unwrap(), found, "a second run has another result");
    let device = Linearised::at(&file.description, &question.q, &question.normal).unwrap();
    let over = |value| Chosen { value, filtered: false };
    let usual = |name: &str| Estimator::ALL.iter().find(|(other, _)| *other == name).unwrap().1;
    let mut tried = 0;
    for (kind, cutoff_hz) in [
        (usual("butterworth"), 200.0),
        (usual("butterworth"), 500.0),
        (usual("first-order"), 200.0),
        (usual("predicted"), 30.0),
        (usual("difference").with_options(over(8)), 500.0),
    ] {
        for damping in [0.5, 1.0, 2.0, 4.0, 8.0, 16.0] {
            let settings =
                Settings { kind, estimator: kind.name(), cutoff_hz, stiffness: 1.12 * best.stiffness, damping, ..best };
            let around = Loop {
                estimator: LinearEstimator::of(kind, cutoff_hz).unwrap(),
                drive: Drive::Current { bandwidth_hz: CURRENT_LOOP_HZ },
                ..control_loop(5_000.0)
            };
            let around = Loop { delay_samples: 0.125, ..around };
            let max_stiffness = domain(&device, &around, Mode::Off, Some(&[damping])).unwrap().boundary[0].kp;
            if max_stiffness < settings.stiffness {
                continue;
            }
            let keeps = accepted_wall(&question, &settings).unwrap();
            assert!(keeps.is_none(), "{keeps:?} is stiffer than the result, {best:?}");
            tried += 1;
        }
    }
    assert!(tried > 10, "{tried}");
}

#[test]
fn no_wall_of_a_grid_is_much_stiffer_on_ten_random_devices() {
    for number in 0..10 {
        let file = tuned::random_device(number);
        let dampings = [0.2, 0.35, 0.6, 0.8, 1.0, 1.25, 1.7, 2.8, 5.0];
        let (best, tried) = tuned::tune_and_check(&tuned::question(&file, 5_000.0), &dampings, &[1.06, 1.25]);
        println!("{number} {}: {best:?}, {tried} walls", file.name);
    }
}

/// The ripple of a tip that moves evenly through encoder steps, kp √(Σ step²/12), is only a rule of thumb. It does not
/// limit the search; the limit is the ripple that the hands feel.
#[test]
fn the_result_is_the_stiffest_wall_and_names_its_limit() {
    let file = shipped_device("haply-2diy");
    let question = question(&file, Margins::default());
    let found = tune(&question, &Sweep::quiet()).unwrap();
    let top = found.others.iter().map(|other| other.settings.stiffness).fold(0.0, f64::max);
    assert!(found.best.settings.stiffness * 1.03 >= top, "{found:?}");
    assert!(found.best.ripple_n <= 0.1 && found.best.board_ripple_n.unwrap() <= 0.1, "{found:?}");
    let device = Linearised::at(&file.description, &[2.3, 0.84159265358979], &[0.0, -1.0]).unwrap();
    let steps: f64 = (0..2).map(|i| (device.row[i] * std::f64::consts::TAU / 10_752.0).powi(2) / 12.0).sum();
    let limit = |name: &str| found.limits.iter().find(|limit| limit.limit == name).unwrap().stiffness;
    assert!((limit("rule of thumb, encoder steps").unwrap() * steps.sqrt() / 0.1 - 1.0).abs() < 1e-9);
    // The named limit binds at the resulting stiffness, within the last step of the search.
    let active = limit(found.active).unwrap() / found.best.settings.stiffness;
    assert!((1.0..1.15).contains(&active), "{} at {active} times", found.active);
    for limit in &found.limits {
        let binds = limit.limit != "rule of thumb, encoder steps"
            && limit.stiffness.is_some_and(|most| most < found.best.settings.stiffness);
        assert!(!binds, "{limit:?} is exceeded by {:?}", found.best);
    }
}

/// With half a millimetre per count the scene's settings are already the best.
#[test]
fn the_result_is_never_worse_than_the_scenes_settings() {
    let (device, scene) = ("devices/capstan-pantograph.toml", "devices/scenes/capstan-pantograph/wall.toml");
    let report = json(&["tune", device, "--scene", scene, "--rates", "20000"]);
    assert!(report["times"].as_f64().unwrap() >= 1.0, "{report}");
}

#[test]
fn margins_cost_stiffness_where_stability_limits_it() {
    let file = shipped_device("haply-2diy");
    let most = |margins: Margins| {
        // No wall reaches this ripple limit.
        let question =
            Question { ripple_n: 50.0, board_ripple_n: None, counts: 1e-6, speed: 1e-6, ..question(&file, margins) };
        tune(&question, &Sweep::quiet()).unwrap()
    };
    let (with, without) = (most(Margins::default()), most(Margins::NONE));
    assert!(with.best.settings.stiffness < 0.9 * without.best.settings.stiffness, "{with:?} {without:?}");
}

#[test]
fn the_written_scene_has_the_settings_of_the_result() {
    let kind = Estimator::ALL.iter().find(|(name, _)| *name == "difference").unwrap().1;
    for (kind, cutoff_hz) in
        [(kind.with_options(Chosen { value: 8, filtered: false }), 500.0), (Estimator::FirstOrder, 225.0)]
    {
        let settings = Settings {
            rate_hz: 5_000.0,
            kind,
            estimator: kind.name(),
            value: kind.chosen().map_or(0, |chosen| chosen.value),
            cutoff_hz,
            feed_forward: FeedForward::Washout,
            washout_hz: 5.0,
            damping_compensation: true,
            stiffness: 12_300.0,
            damping: 4.56,
        };
        let text = to_toml(&settings, Admissible::Consistent, &[0.0, 0.125], &[0.6, -0.8], &["A wall.".into()]);
        let scene = SceneFile::parse(&text, "tuned.toml", 2).unwrap_or_else(|error| panic!("{text}\n{error}")).scene;
        assert_eq!(Settings::of(&scene, 0), Some(settings), "{text}");
        assert_eq!(scene.admissible, Admissible::Consistent);
    }
}

#[test]
fn a_shipped_wall_becomes_twice_as_stiff_at_the_same_ripple() {
    let folder = Folder::new();
    let tuned_path = folder.path("tuned.toml");
    let (device, scene) = ("devices/haply-2diy.toml", "devices/scenes/haply-2diy/wall-stiff.toml");
    let words = ["tune", device, "--scene", scene, "--rates", "5000", "--out", &tuned_path];
    let report = json(&words);
    assert!(report["times"].as_f64().unwrap() > 2.0, "{report}");
    assert!(report["best"]["ripple_n"].as_f64() <= report["ripple_limit_n"].as_f64(), "{report}");
    // The written scene passes `check`, and its wall is still at the same place.
    type_lines(&format!("check {device} {tuned_path}"), &[]);
    let tuned = SceneFile::load(&tuned_path, 2).unwrap().scene;
    let plane = |scene: &haptic_bridge::render::scene::Scene<f64>| scene.walls[0].surface;
    assert_eq!(plane(&tuned), plane(&SceneFile::load(root().join(scene), 2).unwrap().scene));
    assert_eq!(Some(tuned.walls[0].stiffness), report["best"]["stiffness"].as_f64());
}

#[test]
fn settings_that_no_board_supports_are_refused() {
    let line = "2: tune devices/haply-2diy.toml --normal=0,1";
    type_lines(
        &format!(
            "{line} --rates 45000 => no board has kept up with
            {line} --ripple 0 => must be positive
            {line} --port sim => exists only during this command"
        ),
        &[],
    );
}
