//! One conversation with the boot loader, and what the script itself refuses.

use haptic_flash::dfuse::{Dfuse, request};
use haptic_flash::{DfuError, Surroundings as _, Transport as _, UsbError};

use crate::bench::{Cable, Chip, Site, image};
use crate::boot_loader::{FLASH, State, Status};

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
fn the_script_refuses_what_the_documents_refuse() {
    let (site, mut cable) = cable();
    assert_eq!(cable.receive(request::UPLOAD, 0, 4), Ok(vec![0x00, 0x21, 0x41, 0x92]), "the commands it knows");
    assert_eq!(cable.send(request::DNLOAD, 0, &[0x41, 0, 0, 0, 8]), Err(UsbError::Stalled), "erase while it is read");
    assert_eq!(state(&site), (State::Error, Status::StalledPacket));
    assert_eq!(cable.send(request::ABORT, 0, &[]), Err(UsbError::Stalled), "only one way out of an error");
    cable.send(request::CLRSTATUS, 0, &[]).unwrap();
    assert_eq!(state(&site), (State::Idle, Status::Ok));
    assert_eq!(cable.send(request::CLRSTATUS, 0, &[]), Err(UsbError::Stalled), "clear what is no error");
    cable.send(request::CLRSTATUS, 0, &[]).unwrap();

    cable.send(request::DNLOAD, 0, &[0x41, 0, 0, 1, 8]).unwrap();
    let busy = cable.receive(request::GETSTATUS, 0, 6).unwrap();
    assert_eq!((busy[4], &site.0.borrow().erased[..]), (State::Dnbusy as u8, &[4][..]), "carried out when asked");
    assert_eq!(cable.receive(request::GETSTATUS, 0, 6), Err(UsbError::Stalled), "asked before its time");
    cable.send(request::CLRSTATUS, 0, &[]).unwrap();
    assert_eq!(cable.send(request::DNLOAD, 1, &[0; 8]), Err(UsbError::Stalled), "a reserved block");
    cable.send(request::CLRSTATUS, 0, &[]).unwrap();
    cable.send(request::DNLOAD, 0, &[0x77]).unwrap();
    assert_eq!(cable.receive(request::GETSTATUS, 0, 6).unwrap()[4], State::Error as u8, "no such command");
}

#[test]
fn what_is_written_is_read_whole_blocks_and_ends() {
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
fn a_conversation_begins_wherever_another_one_stopped() {
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
        // Whoever comes next has had to start first.
        cable.wait(std::time::Duration::from_millis(50));
        let mut dfuse = Dfuse::begin(cable, 2048).unwrap_or_else(|error| panic!("{requests:?}: {error}"));
        dfuse.erase(0x0802_0000).unwrap();
    }
}

#[test]
fn a_busy_boot_loader_is_waited_for_and_one_that_never_ends_is_given_up() {
    for answers_after in [0.0, 4.9].map(std::time::Duration::from_secs_f64) {
        let (site, cable) = cable();
        let late = |rounds| {
            site.change(|board| match &mut board.chip {
                Chip::BootLoader(boot_loader) => boot_loader.late = rounds,
                _ => unreachable!(),
            });
        };
        late(30);
        let mut dfuse = Dfuse::begin(cable, 2048).unwrap();
        dfuse.erase(0x0802_0000).unwrap();
        late(u32::MAX);
        site.change(|board| board.answers_after = answers_after);
        let began = site.0.borrow().now;
        let error = dfuse.erase(0x0802_0000).unwrap_err();
        assert_eq!(error, DfuError::Endless("erase the sector at 0x08020000".into()));
        assert!((site.0.borrow().now - began).as_secs() <= 25, "answers after {answers_after:?}");
    }
}

#[test]
fn an_address_without_memory_is_told_as_that() {
    let (_, cable) = cable();
    let mut dfuse = Dfuse::begin(cable, 2048).unwrap();
    let error = dfuse.erase(FLASH.end).unwrap_err().to_string();
    assert_eq!(error, "the boot loader could not erase the sector at 0x08100000: it has no such memory (errTARGET)");
}
