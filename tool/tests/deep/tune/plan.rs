//! The planner chooses only terms that a scene needs. Simpler scenes cost less. Other poses keep the error budget.

use crate::common::prelude::*;
use crate::common::{shipped_device, shipped_path};
use haptic_predict::bench::error::{Law, Terms, TorqueVariant, Trigonometry, errors};
use haptic_predict::bench::probe::HAND_SPEED;
use haptic_predict::plan::{Budget, Plan, cost, plan, probes_on_walls};

fn device(name: &str) -> Device<f64> {
    shipped_device(name).device().unwrap()
}

fn scene(device: &Device<f64>, name: &str) -> SceneFile {
    let path = shipped_path(&format!("scenes/{}/{name}.toml", device.name));
    SceneFile::load(path, device.mechanism.kind().spec().task).unwrap()
}

fn plan_of(device: &Device<f64>, file: &SceneFile) -> Plan {
    plan(device, &file.scene, Budget::Percent(1.0), file.hand_speed.unwrap_or(HAND_SPEED)).unwrap()
}

#[test]
fn shipped_scenes_have_the_expected_plans() {
    let wanted = [
        ("haply-2diy", "wall-soft", Terms::None),
        ("coupled-five-bar", "tracing", Terms::FeedForward),
        ("coupled-five-bar", "wall", Terms::FeedForwardZ),
        ("hapkit-paddle", "wall", Terms::None),
        ("phantom-premium-1.5", "ramp", Terms::FeedForwardZ),
    ];
    for (name, file, terms) in wanted {
        let device = device(name);
        let plan = plan_of(&device, &scene(&device, file));
        assert_eq!(plan.terms, terms, "{name} {file}");
    }
}

#[test]
fn a_looser_budget_leaves_the_velocity_terms_out() {
    let device = device("coupled-five-bar");
    // Without the velocity terms the error is a twentieth of the force on this disc.
    let scene = scene(&device, "tracing").scene;
    let loose_plan = plan(&device, &scene, Budget::Percent(50.0), HAND_SPEED).unwrap();
    assert_eq!(loose_plan.terms, Terms::FeedForward);
    let tight_plan = plan(&device, &scene, Budget::OneDutyStep, HAND_SPEED).unwrap();
    assert_eq!(tight_plan.terms, Terms::FeedForwardZ);
    assert!(loose_plan.instructions < tight_plan.instructions);
}

#[test]
fn instructions_fall_as_a_scene_gets_simpler() {
    for name in ["coupled-five-bar", "phantom-premium-1.5", "serial-3r"] {
        let device = device(name);
        let one = scene(&device, if name == "phantom-premium-1.5" { "table" } else { "wall" }).scene;
        let mut two = one.clone();
        two.walls.push(one.walls[0]).unwrap();
        let without_terms = Scene { velocity_terms: VelocityTerms::Off, ..one.clone() };
        let mut plain_scene = without_terms.clone();
        plain_scene.walls[0].feed_forward = FeedForward::Off;
        let mut empty_scene = plain_scene.clone();
        empty_scene.walls.clear();
        let costs = [two, one, without_terms, plain_scene, empty_scene].map(|scene| cost(&device, &scene));
        assert!(costs.windows(2).all(|pair| pair[0] > pair[1]), "{name}: {costs:?}");
        assert!(costs.iter().all(|cost| (50..5000).contains(cost)), "{name}: {costs:?}");
    }
}

#[test]
fn the_budget_is_kept_at_poses_that_the_planner_did_not_use() {
    let budget = 1.0;
    for (name, file, other) in [
        ("coupled-five-bar", "tracing", 230),
        ("coupled-five-bar", "wall", 230),
        ("haply-2diy", "wall-stiff", 230),
        ("fictive-five-bar-turret", "ball", 31),
        ("serial-3r", "wall", 31),
    ] {
        let device = device(name);
        let file = scene(&device, file);
        let speed = file.hand_speed.unwrap_or(HAND_SPEED);
        let plan = plan(&device, &file.scene, Budget::Percent(budget), speed).unwrap();
        let elsewhere = probes_on_walls(&device, &file.scene, other, speed).unwrap();
        assert!(elsewhere.len() > 50, "{name}: {} situations", elsewhere.len());
        let law = Law::of(&file.scene, &device).unwrap();
        let way = TorqueVariant { terms: plan.terms, trigonometry: Trigonometry::Tabulated, law };
        let errors = errors(&device, &elsewhere, &way).unfaded_errors;
        assert!(100.0 * errors.share.max <= budget, "{name}: {errors:?}");
    }
}

#[test]
fn an_impossible_budget_names_the_smallest_error() {
    let device = device("coupled-five-bar");
    let scene = scene(&device, "wall").scene;
    let failure = plan(&device, &scene, Budget::Percent(1.0e-9), HAND_SPEED).unwrap_err().to_string();
    assert!(failure.contains("the best one needs"), "{failure}");
}
