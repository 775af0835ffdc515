//! Refused flash requests and their messages.

use haptic_flash::{Cause, Misfit, Phase, SETTINGS, Segment, UsbError};

use crate::phases::attempt;
use crate::rig::{Site, image};

fn old_image() -> haptic_flash::Image {
    image("odrive-v3", "0.1.0", 10)
}

fn new_image() -> haptic_flash::Image {
    image("odrive-v3", "0.2.0", 11)
}

/// Makes an attempt that must fail and leave the flash unchanged. Returns the error.
fn refusal(site: &Site, image: &haptic_flash::Image) -> haptic_flash::FlashError {
    let before = site.0.borrow().flash.clone();
    let error = attempt(site, None, image).unwrap_err();
    assert!(before == site.0.borrow().flash, "{error}");
    assert!(error.to_string().contains("nothing was changed") && !error.is_erased(), "{error}");
    error
}

#[test]
fn an_image_for_another_board_is_refused() {
    let site = Site::running(&old_image());
    let error = refusal(&site, &image("h-bridge-f405", "0.2.0", 11));
    assert_eq!(
        error.to_string(),
        "identifying the board: the image is for h-bridge-f405 and this board is odrive-v3; flash the image for this \
         board: haptic flash odrive-v3; nothing was changed"
    );
    assert_eq!(site.0.borrow().requests, 0, "its boot loader is not entered");
}

#[test]
fn images_that_cannot_be_flashed_are_refused() {
    let error_of = |change: fn(&mut Vec<Segment>)| {
        let mut image = new_image();
        change(&mut image.segments);
        refusal(&Site::running(&old_image()), &image).to_string()
    };
    let text = error_of(|segments| segments.push(Segment { address: SETTINGS.end - 4, bytes: vec![0; 4] }));
    assert!(text.contains("overwrite the board's settings"), "{text}");
    assert!(error_of(|segments| segments.clear()).contains("empty"));
    assert!(error_of(|segments| segments.retain(|segment| segment.address != 0x0800_0000)).contains("no vectors"));
    assert!(
        error_of(|segments| segments.push(Segment { address: 0x0800_C100, bytes: vec![0; 4] })).contains("overlap")
    );
    assert!(error_of(|segments| segments[1].address = 0xFFFF_F000).contains("does not fit"));
    assert!(error_of(|segments| segments[1].address = 0x0810_0000).contains("needs flash at 0x08100000"));
    assert!(error_of(|segments| segments[1].bytes.resize(1 << 20, 0)).contains("needs flash at 0x08100000"));
}

#[test]
fn another_chip_is_refused() {
    // An STM32L4, an STM32F7 and a chip without a description.
    for memory in
        ["@Internal Flash  /0x08000000/512*0002Kg", "@Internal Flash  /0x08000000/04*032Kg,01*128Kg,03*256Kg", "flash"]
    {
        let site = Site::running(&old_image());
        site.change(|board| board.memory = memory);
        let error = refusal(&site, &new_image());
        assert!(matches!(error.cause, Cause::Misfit(Misfit::OtherChip) | Cause::Layout(_)), "{error}");
        assert!(error.to_string().contains("switch the power off and on to start the present firmware"), "{error}");
    }
}

#[test]
fn a_protected_chip_is_refused_and_unchanged() {
    let site = Site::running(&old_image());
    site.change(|board| board.protected = true);
    let text = refusal(&site, &new_image()).to_string();
    assert!(
        text.contains("protected") && text.contains("erases the whole chip") && text.contains("unprotect"),
        "{text}"
    );
}

#[test]
fn a_boot_loader_that_cannot_be_opened_names_the_remedy() {
    for (error, word) in [(UsbError::Forbidden, "haptic udev"), (UsbError::Busy, "dfu-util")] {
        let site = Site::running(&old_image());
        site.change(|board| board.open_error = Some(error));
        let error = refusal(&site, &new_image());
        assert!(error.phase == Phase::Open && error.to_string().contains(word), "{error}");
    }
}

#[test]
fn a_board_that_does_not_enter_its_boot_loader_is_reported() {
    let site = Site::running(&old_image());
    site.change(|board| board.ignores_restart = true);
    let error = refusal(&site, &new_image());
    assert_eq!((error.phase, &error.cause), (Phase::Enter, &Cause::NoBootLoader));
    assert!(error.to_string().contains("DIP switch"), "{error}");
}

#[test]
fn a_missing_board_and_a_wrong_serial_are_distinguished() {
    let site = Site::running(&old_image());
    let error = attempt(&site, Some("ABC"), &new_image()).unwrap_err();
    assert_eq!(error.cause, Cause::NotThere("ABC".into()));
    site.change(|board| board.plugged = false);
    assert_eq!(refusal(&site, &new_image()).cause, Cause::NoBoard);
}

#[test]
fn a_board_that_restarts_with_another_version_is_reported() {
    let site = Site::running(&old_image());
    site.change(|board| board.reported_version = Some("0.0.9"));
    let error = attempt(&site, None, &new_image()).unwrap_err();
    assert_eq!(error.phase, Phase::Compare);
    let text = error.to_string();
    assert!(text.contains("odrive-v3 0.0.9, protocol 11") && text.contains("odrive-v3 0.2.0, protocol 11"), "{text}");
}
