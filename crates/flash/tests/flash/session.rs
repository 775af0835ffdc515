//! A session with the boot loader, and the requests that the scripted boot loader refuses.

use haptic_flash::dfuse::{Dfuse, request};
use haptic_flash::{DfuError, Surroundings as _, Transport as _, UsbError};

use crate::boot_loader::{FLASH, State, Status};
use crate::rig::{Cable, Chip, Site, image};

fn cable() -> (Site, Cable) {
    let mut site = Site::in_boot_loader(&image("odrive-v3", "0.1.0", 10));
    site.change(|board| board.now += std::time::Duration::from_secs(1));
    let loader = site.boot_loaders().unwrap().remove(0);
    let cable = site.open(&loader).unwrap().loader;
    (site, cable)
}

fn state(site: &Site) -> (State, Status) {
    match &site.0.borrow().chip {
        Chip::BootLoader(boot_loader) => (boot_loader.state, boot_loader.status),
        _ => panic!("not in its boot loader"),
    }
}

#[test]
fn the_script_refuses_requests_that_the_documents_forbid() {
    let (site, mut cable) = cable();
    assert_eq!(
        cable.receive(request::UPLOAD, 0, 4),
        Ok(vec![0x00, 0x21, 0x41, 0x92]),
        "the list of supported commands"
    );
    assert_eq!(cable.send(request::DNLOAD, 0, &[0x41, 0, 0, 0, 8]), Err(UsbError::Stalled), "erase while reading");
    assert_eq!(state(&site), (State::Error, Status::StalledPacket));
    assert_eq!(cable.send(request::ABORT, 0, &[]), Err(UsbError::Stalled), "only CLRSTATUS leaves the error state");
    cable.send(request::CLRSTATUS, 0, &[]).unwrap();
    assert_eq!(state(&site), (State::Idle, Status::Ok));
    assert_eq!(cable.send(request::CLRSTATUS, 0, &[]), Err(UsbError::Stalled), "clear without an error");
    cable.send(request::CLRSTATUS, 0, &[]).unwrap();

    cable.send(request::DNLOAD, 0, &[0x41, 0, 0, 1, 8]).unwrap();
    let busy = cable.receive(request::GETSTATUS, 0, 6).unwrap();
    assert_eq!(
        (busy[4], &site.0.borrow().erased[..]),
        (State::Dnbusy as u8, &[4][..]),
        "carried out at the status request"
    );
    assert_eq!(cable.receive(request::GETSTATUS, 0, 6), Err(UsbError::Stalled), "a status request too early");
    cable.send(request::CLRSTATUS, 0, &[]).unwrap();
    assert_eq!(cable.send(request::DNLOAD, 1, &[0; 8]), Err(UsbError::Stalled), "a reserved block");
    cable.send(request::CLRSTATUS, 0, &[]).unwrap();
    cable.send(request::DNLOAD, 0, &[0x77]).unwrap();
    assert_eq!(cable.receive(request::GETSTATUS, 0, 6).unwrap()[4], State::Error as u8, "no such command");
}

#[test]
fn flash_reads_back_full_and_partial_blocks() {
    for length in [4, 2044, 2048, 2052, 5000] {
        let (site, cable) = cable();
        let mut dfuse = Dfuse::begin(cable, 2048).unwrap();
        let bytes: Vec<u8> = (0..length).map(|index| (index * 7 % 253) as u8).collect();
        let start = 0x0802_0000;
        dfuse.erase(start).unwrap();
        for (index, block) in bytes.chunks(dfuse.transfer()).enumerate() {
            dfuse.write(start + (index * 2048) as u32, block).unwrap();
        }
        assert_eq!(dfuse.read(start, length).unwrap(), bytes, "{length}");
        assert_eq!(site.0.borrow().flash[0x2_0000..][..length], bytes, "{length}");
        assert_eq!(site.0.borrow().flash[0x2_0000 + length], 0xFF, "{length}");
    }
}

#[test]
fn a_session_begins_in_any_state_of_an_earlier_session() {
    let before: [&[(u8, u16, &[u8])]; 5] = [
        &[],
        &[(request::DNLOAD, 1, &[0; 4])],
        &[(request::DNLOAD, 0, &[0x21, 0, 0, 0, 8])],
        &[(request::DNLOAD, 0, &[0x21, 0, 0, 0, 8]), (request::GETSTATUS, 0, &[])],
        &[(request::UPLOAD, 2, &[])],
    ];
    for requests in before {
        let (_, mut cable) = cable();
        for (request, value, data) in requests {
            let _ = match *request {
                request::DNLOAD => cable.send(*request, *value, data),
                _ => cable.receive(*request, *value, 6).map(|_| ()),
            };
        }
        // The next session begins later, because the tool must start first.
        cable.wait(std::time::Duration::from_millis(50));
        let mut dfuse = Dfuse::begin(cable, 2048).unwrap_or_else(|error| panic!("{requests:?}: {error}"));
        dfuse.erase(0x0802_0000).unwrap();
    }
}

#[test]
fn a_busy_boot_loader_is_given_up_after_a_timeout() {
    for reply_delay in [0.0, 4.9].map(std::time::Duration::from_secs_f64) {
        let (site, cable) = cable();
        let set_late = |rounds| {
            site.change(|board| match &mut board.chip {
                Chip::BootLoader(boot_loader) => boot_loader.late = rounds,
                _ => unreachable!(),
            });
        };
        set_late(30);
        let mut dfuse = Dfuse::begin(cable, 2048).unwrap();
        dfuse.erase(0x0802_0000).unwrap();
        set_late(u32::MAX);
        site.change(|board| board.reply_delay = reply_delay);
        let began = site.0.borrow().now;
        let error = dfuse.erase(0x0802_0000).unwrap_err();
        assert_eq!(error, DfuError::Endless("erase the sector at 0x08020000".into()));
        assert!((site.0.borrow().now - began).as_secs() <= 25, "reply after {reply_delay:?}");
    }
}

#[test]
fn an_address_without_memory_is_reported() {
    let (_, cable) = cable();
    let mut dfuse = Dfuse::begin(cable, 2048).unwrap();
    let error = dfuse.erase(FLASH.end).unwrap_err().to_string();
    assert_eq!(error, "the boot loader could not erase the sector at 0x08100000: no such memory (errTARGET)");
}
