//! Complete flash sequences that succeed.

use haptic_flash::{Cause, FlashError, FlashTarget, Identity, Phase, Progress, find_board, flash};

use crate::rig::{Chip, SERIAL, Site, image};

pub fn attempt(
    site: &Site,
    serial: Option<&str>,
    image: &haptic_flash::Image,
) -> Result<haptic_flash::FlashSummary, FlashError> {
    let mut site = site.clone();
    let target = find_board(&mut site, serial)?;
    flash(&mut site, &target, image.clone(), &mut |_| {})
}

#[test]
fn a_running_board_gets_another_image_and_keeps_its_settings() {
    let (old, new) = (image("odrive-v3", "0.1.0", 10), image("odrive-v3", "0.2.0", 11));
    let site = Site::running(&old);
    let settings = site.0.borrow().settings();
    let done = attempt(&site, None, &new).unwrap();
    let identity =
        Identity { board: "odrive-v3".into(), firmware: "0.2.0".into(), protocol: 11, serial: SERIAL.into() };
    assert_eq!(done.identity, identity);
    let board = site.0.borrow();
    assert_eq!(board.erased, [0, 3, 4], "the vectors' sector first, and no sector that the image does not need");
    assert!(board.holds(&new.segments) && board.arms());
    assert_eq!(board.settings(), settings);
    assert_eq!(board.flash[0x2_0000], 0x33, "the sector beyond the image is unchanged");
    assert_eq!(board.restored_settings.as_ref(), Some(&settings));
    assert_eq!((done.sectors, done.restored), (3, vec!["rules".to_string()]));
    assert_eq!(done.bytes, new.size().next_multiple_of(4));
}

#[test]
fn a_bare_boot_loader_is_found_and_flashed() {
    let (old, new) = (image("odrive-v3", "0.1.0", 10), image("h-bridge-f405", "0.2.0", 11));
    let mut site = Site::in_boot_loader(&old);
    site.change(|board| {
        board.now += std::time::Duration::from_secs(1);
        board.boot_pins = false;
    });
    assert!(matches!(find_board(&mut site, None), Ok(FlashTarget::BootLoader(loader)) if loader.serial == SERIAL));
    attempt(&site, Some(SERIAL), &new).unwrap();
    assert!(site.0.borrow().holds(&new.segments));
    assert_eq!(site.0.borrow().restored_settings, None);
}

#[test]
fn the_phases_are_reported_in_their_order() {
    let (old, new) = (image("odrive-v3", "0.1.0", 10), image("odrive-v3", "0.2.0", 11));
    let mut site = Site::running(&old);
    let target = find_board(&mut site, None).unwrap();
    let (mut phases, mut last) = (Vec::new(), (0, 1));
    let tell = &mut |progress| match progress {
        Progress::Begins(phase) => phases.push(phase),
        Progress::Done(_, done, of) => last = (done, of),
        Progress::PowerCycle => panic!("the board restarts by itself"),
    };
    flash(&mut site, &target, new, tell).unwrap();
    use Phase::*;
    let all =
        [ReadSettings, Enter, Open, Erase, Write, ReadBack, Write, ReadBack, Leave, Return, Compare, RestoreSettings];
    assert_eq!(phases, all, "the vectors are written when the rest has been read back");
    assert_eq!(last.0, last.1);
}

#[test]
fn a_board_that_does_not_restart_is_switched_off_and_on() {
    let (old, new) = (image("odrive-v3", "0.1.0", 10), image("odrive-v3", "0.2.0", 11));
    for with_user in [true, false] {
        let mut site = Site::running(&old);
        site.change(|board| board.fails_to_start = true);
        let target = find_board(&mut site, None).unwrap();
        let hand = site.clone();
        let tell = &mut |progress| {
            if with_user && progress == Progress::PowerCycle {
                hand.change(|board| board.power_cycle());
            }
        };
        let outcome = flash(&mut site, &target, new.clone(), tell);
        match outcome {
            Ok(_) => assert!(with_user),
            Err(error) => {
                assert!(!with_user && (error.phase, &error.cause) == (Phase::Return, &Cause::NoReturn));
                assert!(error.to_string().contains("switch the power off and on"), "{error}");
                assert!(matches!(site.0.borrow().chip, Chip::Dead) && site.0.borrow().holds(&new.segments));
            }
        }
    }
}

#[test]
fn a_slow_boot_loader_only_takes_longer() {
    let (old, new) = (image("odrive-v3", "0.1.0", 10), image("odrive-v3", "0.2.0", 11));
    let site = Site::running(&old);
    site.change(|board| board.late = 3);
    attempt(&site, None, &new).unwrap();
    assert!(site.0.borrow().holds(&new.segments));
}
