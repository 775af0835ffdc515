//! A board that is interrupted at any request never arms with a partial image, keeps its settings, and can be flashed
//! again.

use crate::phases::attempt;
use crate::rig::{Cut, Site, image};

/// Returns the number of requests of a successful attempt.
fn request_count() -> usize {
    let site = Site::running(&image("odrive-v3", "0.1.0", 10));
    attempt(&site, None, &image("odrive-v3", "0.2.0", 11)).unwrap();
    site.0.borrow().requests
}

#[test]
fn an_interrupted_board_only_runs_complete_images() {
    let (old, new) = (image("odrive-v3", "0.1.0", 10), image("odrive-v3", "0.2.0", 11));
    let all = request_count();
    assert!(all > 150, "{all}");
    let (mut unchanged, mut nothing, mut damaged, mut done) = (0, 0, 0, 0);
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
                // Firmware that starts has the complete code of one image, even if the firmware does not arm.
                let one_code = board.holds(&old.segments[1..]) || board.holds(&new.segments[1..]);
                assert!(!board.starts() || one_code, "{case}");
                (board.holds(&old.segments), board.holds(&new.segments), board.starts())
            };
            match &outcome {
                Ok(_) => done += 1,
                Err(error) if whole_old => {
                    unchanged += 1;
                    assert!(starts, "{case}");
                    // The tool cannot know that the first erase has not begun.
                    assert!(error.to_string().contains("nothing was changed") || error.is_erased(), "{case}");
                }
                Err(error) if whole_new => {
                    done += 1;
                    assert!(error.to_string().contains("off"), "{case}");
                }
                Err(error) => {
                    assert!(error.is_erased() && error.to_string().contains("run this again"), "{case}");
                    if starts { damaged += 1 } else { nothing += 1 }
                }
            }

            // Flashes again, after a power cycle with the DIP switch set to DFU unless the power stayed on.
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
    // Every kind of outcome has occurred. With partial vectors, the code starts and detects its damage.
    assert!(unchanged > 0 && nothing > 0 && damaged > 0 && done > 0, "{unchanged} {nothing} {damaged} {done}");
}

#[test]
fn a_failed_command_is_reported_and_the_next_attempt_succeeds() {
    let (old, new) = (image("odrive-v3", "0.1.0", 10), image("odrive-v3", "0.2.0", 11));
    let mut failures = 0;
    for operation in 1.. {
        let site = Site::running(&old);
        site.change(|board| board.failing_operation = Some(operation));
        let Err(error) = attempt(&site, None, &new) else { break };
        failures += 1;
        assert!(error.to_string().contains("programming failed (errPROG)"), "operation {operation}: {error}");
        assert!(
            !site.0.borrow().arms() || site.0.borrow().holds(&old.segments) || site.0.borrow().holds(&new.segments)
        );
        site.change(|board| {
            board.failing_operation = None;
            match &mut board.chip {
                crate::rig::Chip::BootLoader(boot_loader) => boot_loader.failing_operation = None,
                _ => unreachable!(),
            }
        });
        attempt(&site, None, &new).unwrap_or_else(|error| panic!("operation {operation}, then {error}"));
    }
    assert!(failures > 30, "{failures}");
}

#[test]
fn a_stuck_byte_is_found_before_the_vectors_are_written() {
    let (old, new) = (image("odrive-v3", "0.1.0", 10), image("odrive-v3", "0.2.0", 11));
    let site = Site::running(&old);
    site.change(|board| board.stuck_byte = Some((0x0800_C123, 0xFF)));
    let error = attempt(&site, None, &new).unwrap_err();
    assert!(error.to_string().starts_with("reading back: the flash at 0x0800c123 holds 0xff"), "{error}");
    assert!(error.is_erased() && !site.0.borrow().starts());
}
