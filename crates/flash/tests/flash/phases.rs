//! The whole way, where everything goes well or as well as it can.

use haptic_flash::{Cause, FlashError, Found, Progress, Said, Step, flash, look};

use crate::bench::{Chip, SERIAL, Site, image};

pub fn attempt(
    site: &Site,
    serial: Option<&str>,
    image: &haptic_flash::Image,
) -> Result<haptic_flash::Done, FlashError> {
    let mut site = site.clone();
    let found = look(&mut site, serial)?;
    flash(&mut site, &found, image.clone(), &mut |_| {})
}

#[test]
fn a_running_board_gets_another_image_and_keeps_its_settings() {
    let (old, new) = (image("odrive-v3", "0.1.0", 10), image("odrive-v3", "0.2.0", 11));
    let site = Site::running(&old);
    let settings = site.0.borrow().settings();
    let done = attempt(&site, None, &new).unwrap();
    let said = Said { board: "odrive-v3".into(), firmware: "0.2.0".into(), protocol: 11, serial: SERIAL.into() };
    assert_eq!(done.said, said);
    let board = site.0.borrow();
    assert_eq!(board.erased, [0, 3, 4], "the vectors' sector first, and none that the image does not need");
    assert!(board.holds(&new.segments) && board.arms());
    assert_eq!(board.settings(), settings);
    assert_eq!(board.flash[0x2_0000], 0x33, "a sector beyond the image");
    assert_eq!(board.given_back.as_ref(), Some(&settings));
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
    assert!(matches!(look(&mut site, None), Ok(Found::BootLoader(loader)) if loader.serial == SERIAL));
    attempt(&site, Some(SERIAL), &new).unwrap();
    assert!(site.0.borrow().holds(&new.segments));
    assert_eq!(site.0.borrow().given_back, None);
}

#[test]
fn the_steps_are_told_in_their_order() {
    let (old, new) = (image("odrive-v3", "0.1.0", 10), image("odrive-v3", "0.2.0", 11));
    let mut site = Site::running(&old);
    let found = look(&mut site, None).unwrap();
    let (mut steps, mut last) = (Vec::new(), (0, 1));
    let tell = &mut |progress| match progress {
        Progress::Begins(step) => steps.push(step),
        Progress::Done(_, done, of) => last = (done, of),
        Progress::PowerCycle => panic!("it comes back by itself"),
    };
    flash(&mut site, &found, new, tell).unwrap();
    use Step::*;
    let all = [Keep, Enter, Open, Erase, Write, ReadBack, Write, ReadBack, Leave, Return, Compare, GiveBack];
    assert_eq!(steps, all, "the vectors are written when the rest has been read back");
    assert_eq!(last.0, last.1);
}

#[test]
fn a_board_that_does_not_come_back_by_itself_is_switched_off_and_on() {
    let (old, new) = (image("odrive-v3", "0.1.0", 10), image("odrive-v3", "0.2.0", 11));
    for somebody in [true, false] {
        let mut site = Site::running(&old);
        site.change(|board| board.lost_jump = true);
        let found = look(&mut site, None).unwrap();
        let hand = site.clone();
        let tell = &mut |progress| {
            if somebody && progress == Progress::PowerCycle {
                hand.change(|board| board.power_cycle());
            }
        };
        let outcome = flash(&mut site, &found, new.clone(), tell);
        match outcome {
            Ok(_) => assert!(somebody),
            Err(error) => {
                assert!(!somebody && (error.step, &error.cause) == (Step::Return, &Cause::NoReturn));
                assert!(error.to_string().contains("switch the power off and on"), "{error}");
                assert!(matches!(site.0.borrow().chip, Chip::Dead) && site.0.borrow().holds(&new.segments));
            }
        }
    }
}

#[test]
fn a_slow_boot_loader_takes_longer_and_nothing_else() {
    let (old, new) = (image("odrive-v3", "0.1.0", 10), image("odrive-v3", "0.2.0", 11));
    let site = Site::running(&old);
    site.change(|board| board.late = 3);
    attempt(&site, None, &new).unwrap();
    assert!(site.0.borrow().holds(&new.segments));
}
