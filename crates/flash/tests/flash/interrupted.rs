//! A board that is taken away at any request: it never starts half an image, its settings are there, and another
//! attempt goes through.

use crate::bench::{Cut, Site, image};
use crate::steps::attempt;

/// Requests of an attempt that goes well, told again where this fails.
fn requests() -> usize {
    let site = Site::running(&image("odrive-v3", "0.1.0", 10));
    attempt(&site, None, &image("odrive-v3", "0.2.0", 11)).unwrap();
    site.0.borrow().requests
}

#[test]
fn a_board_that_is_taken_away_at_any_request_runs_whole_images_alone() {
    let (old, new) = (image("odrive-v3", "0.1.0", 10), image("odrive-v3", "0.2.0", 11));
    let all = requests();
    assert!(all > 150, "{all}");
    let (mut as_before, mut nothing, mut damaged, mut done) = (0, 0, 0, 0);
    for at in 1..=all {
        for cut in [Cut::Cable, Cut::Power, Cut::PowerWithin(0.0), Cut::PowerWithin(0.4), Cut::PowerWithin(1.0)] {
            let site = Site::running(&old);
            let settings = site.0.borrow().settings();
            site.change(|board| board.cut = Some((at, cut)));
            let outcome = attempt(&site, None, &new);
            let case = format!("request {at}, {cut:?}: {outcome:?}");
            let (whole_old, whole_new, starts) = {
                let board = site.0.borrow();
                assert_eq!(board.settings(), settings, "{case}");
                assert!(!board.arms() || board.holds(&old.segments) || board.holds(&new.segments), "{case}");
                // Even what starts and does not arm is the code of one image.
                let one_code = board.holds(&old.segments[1..]) || board.holds(&new.segments[1..]);
                assert!(!board.starts() || one_code, "{case}");
                (board.holds(&old.segments), board.holds(&new.segments), board.starts())
            };
            match &outcome {
                Ok(_) => done += 1,
                Err(error) if whole_old => {
                    as_before += 1;
                    assert!(starts, "{case}");
                    // The first erase may not have begun: the tool cannot know.
                    assert!(error.to_string().contains("nothing was changed") || error.erased(), "{case}");
                }
                Err(error) if whole_new => {
                    done += 1;
                    assert!(error.to_string().contains("off"), "{case}");
                }
                Err(error) => {
                    assert!(error.erased() && error.to_string().contains("run this again"), "{case}");
                    if starts { damaged += 1 } else { nothing += 1 }
                }
            }

            // The same once more: out of the boot loader where its power stayed on, else by its switch.
            site.change(|board| {
                (board.cut, board.plugged) = (None, true);
                board.now += std::time::Duration::from_secs(2);
                if cut != Cut::Cable {
                    board.boot_pins = true;
                    board.power_cycle();
                    board.boot_pins = false;
                    board.now += std::time::Duration::from_secs(2);
                }
            });
            attempt(&site, None, &new).unwrap_or_else(|error| panic!("{case}, then {error}"));
            assert!(site.0.borrow().holds(&new.segments) && site.0.borrow().arms(), "{case}");
            assert_eq!(site.0.borrow().settings(), settings, "{case}");
        }
    }
    // Each kind of ending was seen; a part of the vectors starts code that finds itself damaged.
    assert!(as_before > 0 && nothing > 0 && damaged > 0 && done > 0, "{as_before} {nothing} {damaged} {done}");
}

#[test]
fn a_command_that_fails_is_told_and_the_next_attempt_goes_through() {
    let (old, new) = (image("odrive-v3", "0.1.0", 10), image("odrive-v3", "0.2.0", 11));
    let mut failures = 0;
    for operation in 1.. {
        let site = Site::running(&old);
        site.change(|board| board.fail = Some(operation));
        let Err(error) = attempt(&site, None, &new) else { break };
        failures += 1;
        assert!(error.to_string().contains("programming failed (errPROG)"), "operation {operation}: {error}");
        assert!(
            !site.0.borrow().arms() || site.0.borrow().holds(&old.segments) || site.0.borrow().holds(&new.segments)
        );
        site.change(|board| {
            board.fail = None;
            match &mut board.chip {
                crate::bench::Chip::BootLoader(boot_loader) => boot_loader.fail = None,
                _ => unreachable!(),
            }
        });
        attempt(&site, None, &new).unwrap_or_else(|error| panic!("operation {operation}, then {error}"));
    }
    assert!(failures > 30, "{failures}");
}

#[test]
fn a_byte_that_does_not_take_is_found_before_the_vectors_are_written() {
    let (old, new) = (image("odrive-v3", "0.1.0", 10), image("odrive-v3", "0.2.0", 11));
    let site = Site::running(&old);
    site.change(|board| board.stuck = Some((0x0800_C123, 0xFF)));
    let error = attempt(&site, None, &new).unwrap_err();
    assert!(error.to_string().starts_with("reading back: the flash at 0x0800c123 holds 0xff"), "{error}");
    assert!(error.erased() && !site.0.borrow().starts());
}
