//! Settings that a board keeps over its update, or gets back after it: on a simulated board.

use haptic_flash::put_back;
use haptic_host::backup::Backup;
use haptic_host::link::PortSpec;

#[test]
fn settings_are_put_back_where_one_is_not_as_it_was_and_left_alone_else() {
    let mut board = haptic_sim::open(&PortSpec::Sim(None)).unwrap();
    let rules = board.rules().unwrap();
    board.save().unwrap();
    let kept = Backup::read(&mut board).unwrap();
    assert!(kept.settings.len() >= 3, "{:?}", kept.settings.keys());
    assert_eq!(put_back(&mut board, &kept), Ok(Vec::new()), "nothing is lost");

    let mut lower = rules;
    lower.limits.tip_force /= 2.0;
    board.set_rules(&lower).unwrap();
    board.save().unwrap();
    let back = put_back(&mut board, &kept).unwrap();
    assert!(back.contains(&"rules".to_string()) && back.contains(&"device".to_string()), "{back:?}");
    assert_eq!(board.rules().unwrap(), rules);
    assert_eq!(Backup::read(&mut board).unwrap().settings, kept.settings);
    assert_eq!(put_back(&mut board, &kept), Ok(Vec::new()));
}
