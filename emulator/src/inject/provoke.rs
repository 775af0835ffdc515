//! Causes a fault and checks the board's reaction.

use std::time::Duration;

use haptic_bridge::board::settings::{Damage, Key};
use haptic_bridge::safety::fault::{Fault, FaultRecord, State};
use haptic_bridge::safety::refusal::Refusal;
use haptic_host::backup::Backup;
use haptic_host::link::{Board, BoardError};

use super::{Injection, injection};
use crate::run::{MICROSECOND, MILLISECOND, SECOND, StoppedBoard};

/// Result of a provoked fault.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// The latched fault.
    pub record: FaultRecord,
    /// Number of control periods from the cause until the bridges float.
    pub periods_from_cause: u32,
    /// Number of control periods from the step that detected the fault until the bridges float. `None` if the chip
    /// restarted, because a restart resets the count.
    pub periods_from_detection: Option<u32>,
}

/// Returns true if every bridge floats and the power stages are disabled.
pub fn bridges_are_off(stopped: &mut StoppedBoard<'_>) -> bool {
    stopped.hardware().bridges_float()
}

/// Causes `fault` and checks that it is latched, that the bridges are off, that arming is refused, and that only a
/// request clears it. Returns `None` for faults that the boards cannot detect.
#[must_use]
pub fn provoke(fault: Fault) -> Option<Outcome> {
    let Injection::Chip { create, cause, within_ms, .. } = injection(fault) else { return None };
    let name = fault.name();
    let mut rig = create();
    let resets = rig.while_stopped(|stopped| stopped.resets().len());
    let before = rig.steps();
    let began = rig.now();
    cause(&mut rig);
    let mut off_at = None;
    while rig.now() < began + within_ms * MILLISECOND {
        if rig.while_stopped(bridges_are_off) {
            off_at = Some((rig.now(), rig.steps()));
            break;
        }
        rig.run(25 * MICROSECOND);
    }
    let (at, steps) =
        off_at.unwrap_or_else(|| panic!("{name}: bridges are still on after {within_ms} ms: {:?}", rig.tool.status()));
    rig.run(20 * MILLISECOND);
    // After a restart the host must enumerate the chip again.
    let ready_again = rig.shared.board().run_until(2 * SECOND, MILLISECOND, |stopped| stopped.usb().is_ready());
    assert!(ready_again, "{name}: the USB port did not return");
    let restarted = rig.while_stopped(|stopped| stopped.resets().len()) > resets;
    if restarted {
        rig.tool = Board::over(rig.shared.wire(), "again").unwrap_or_else(|error| panic!("{name}: {error}"));
    }
    let status = rig.tool.status().expect("the board replies");
    let record = status.fault.unwrap_or_else(|| panic!("{name}: no fault is latched: {status:?}"));
    assert_eq!((record.fault, status.state), (fault, State::Fault), "{name}: another fault or state: {status:?}");
    if fault == Fault::SettingsDamaged {
        // The damaged name is replaced by its default, not by an older name. The other settings are kept.
        let details = rig.tool.details().expect("the board replies");
        assert_eq!(details.damage.as_slice(), [(Key::Name, Damage::Corrupt)]);
        assert_eq!((details.name.as_str(), details.device.is_some()), ("", true), "{details:?}");
        let backup = Backup::read(&mut rig.tool).expect("the board replies");
        let is_kept = |key: Key| backup.settings.contains_key(key.name());
        assert!(is_kept(Key::Device) && !is_kept(Key::Name), "{:?}", backup.settings.keys());
        assert!(backup.prepared_settings().is_ok(), "the remaining settings can be restored");
    }
    let listed = rig.tool.faults().expect("the board replies");
    assert!(listed.iter().any(|listed| listed.fault == fault), "{name}: not listed: {listed:?}");
    // The fault stays latched, the bridges stay off, and arming is refused.
    let _ = rig.tool.rows(Duration::from_millis(50));
    let answer = rig.tool.arm();
    let names_fault = matches!(answer, Err(BoardError::Refused(Refusal::Faulted(latched))) if latched == fault);
    // After a restart the chip has also lost its device, and refuses for that reason.
    let refused_after_restart = restarted && matches!(answer, Err(BoardError::Refused(_)));
    assert!(names_fault || refused_after_restart, "{name}: arming was not refused: {answer:?}");
    assert!(rig.while_stopped(bridges_are_off), "{name}: bridges came on again");
    if fault == Fault::NotFinite {
        // The NaN is still in the scene, and only a new scene removes it.
        rig.set_scene("");
    }
    rig.tool.clear().unwrap_or_else(|error| panic!("{name}: {error}"));
    rig.run(MILLISECOND);
    let status = rig.tool.status().expect("the board replies");
    assert_eq!((status.state, status.fault), (State::Disarmed, None), "{name} is not cleared");
    assert!(rig.while_stopped(bridges_are_off), "{name}: clearing turned the bridges on");
    if matches!(fault, Fault::ImageDamaged | Fault::RamDamaged | Fault::WrongBoard) {
        // Neither clearing nor loading the device again after the restart repairs anything.
        rig.load("");
        rig.tool.home().unwrap_or_else(|error| panic!("{name}: {error}"));
        let answer = rig.tool.check_polarity();
        let names_fault = matches!(answer, Err(BoardError::Refused(Refusal::Faulted(again))) if again == fault);
        assert!(names_fault && rig.while_stopped(bridges_are_off), "{name}: the check was not refused: {answer:?}");
    }
    let periods_from_cause = ((at - began) / (50 * MICROSECOND)) as u32;
    // This fault is detected before the bridges are ever on. The steps since then only waited for the reply.
    let never_on = fault == Fault::StrayCurrent;
    // A step is counted when it ends, long after its bridges went off.
    let since = (steps.wrapping_sub(record.step) as i32).max(0) as u32;
    let periods_from_detection = (!restarted).then_some(if never_on { 0 } else { since });
    assert!(before <= steps || restarted, "{name}: steps went back");
    Some(Outcome { record, periods_from_cause, periods_from_detection })
}
