//! Restores settings after a firmware update, on a simulated board.

use haptic_flash::restore_lost_settings;
use haptic_host::backup::Backup;
use haptic_host::link::PortSpec;

#[test]
fn settings_are_restored_only_if_one_has_changed() {
    let mut board = haptic_sim::open(&PortSpec::Sim(None)).unwrap();
    let rules = board.rules().unwrap();
    board.save().unwrap();
    let saved = Backup::read(&mut board).unwrap();
    assert!(saved.settings.len() >= 3, "{:?}", saved.settings.keys());
    assert_eq!(restore_lost_settings(&mut board, &saved), Ok(Vec::new()), "nothing is lost");

    let mut lower = rules;
    lower.limits.tip_force /= 2.0;
    board.set_rules(&lower).unwrap();
    board.save().unwrap();
    let restored = restore_lost_settings(&mut board, &saved).unwrap();
    assert!(restored.contains(&"rules".to_string()) && restored.contains(&"device".to_string()), "{restored:?}");
    assert_eq!(board.rules().unwrap(), rules);
    assert_eq!(Backup::read(&mut board).unwrap().settings, saved.settings);
    assert_eq!(restore_lost_settings(&mut board, &saved), Ok(Vec::new()));
}
