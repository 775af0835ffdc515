//! haptic-bridge boards for programs made with CHAI3D 3.3, which need not be changed or rebuilt: the 14 functions that
//! its `CPhantomDevices.cpp` looks up in `libhdPhantom.so`, with its units, axes and order (docs/chai3d.md).
//!
//! HAPTIC_PORT says which board; without it there is a simulated one. Functions return 0, or -1 where they could not;
//! words go to standard error. Nothing unwinds across the border, and the motors go off when the program ends.

#![allow(non_snake_case, reason = "CHAI3D's names")]

mod device;

use device::HdDevice;
use std::ffi::{c_char, c_int};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Mutex, PoisonError};

/// The board: not looked for yet, looked for in vain, or open.
enum Found {
    NotYet,
    None,
    Open(Box<HdDevice>),
}

static FOUND: Mutex<Found> = Mutex::new(Found::NotYet);

const DONE: c_int = 0;
const FAILED: c_int = -1;

/// Has the board do something, and opens it first if it is not open. After a panic it is let go of, which disarms it.
fn with(id: c_int, work: impl FnOnce(&mut HdDevice) -> bool) -> c_int {
    if id != 0 {
        return FAILED;
    }
    let done = catch_unwind(AssertUnwindSafe(|| {
        let mut found = FOUND.lock().unwrap_or_else(PoisonError::into_inner);
        if matches!(*found, Found::NotYet) {
            *found = match HdDevice::open() {
                Ok(device) => Found::Open(Box::new(device)),
                Err(words) => {
                    haptic_host::tell!("haptic-bridge: {words}");
                    Found::None
                }
            };
        }
        let Found::Open(mut device) = std::mem::replace(&mut *found, Found::None) else { return false };
        let done = work(&mut device);
        *found = Found::Open(device);
        done
    }));
    if done.unwrap_or(false) { DONE } else { FAILED }
}

/// Motors off when the program ends, also where it closes nothing. A program that is killed leaves it to the board's
/// watch of its host.
extern "C" fn at_the_end() {
    let _ = catch_unwind(|| {
        if let Ok(mut found) = FOUND.try_lock() {
            *found = Found::None;
        }
    });
}
#[cfg(target_os = "linux")]
#[used]
#[unsafe(link_section = ".fini_array")]
static AT_THE_END: extern "C" fn() = at_the_end;

/// Writes three numbers.
///
/// # Safety
/// The pointers are NULL or each has room for one.
unsafe fn put(to: [*mut f64; 3], values: [f64; 3]) -> bool {
    for (to, value) in to.into_iter().zip(values) {
        // SAFETY: as the caller promises.
        match unsafe { to.as_mut() } {
            Some(to) => *to = value,
            None => return false,
        }
    }
    true
}

/// Reads three numbers.
///
/// # Safety
/// The pointers are NULL or each points to one.
unsafe fn get(from: [*const f64; 3]) -> Option<[f64; 3]> {
    let mut values = [0.0; 3];
    for (from, value) in from.into_iter().zip(&mut values) {
        // SAFETY: as the caller promises.
        *value = *unsafe { from.as_ref() }?;
    }
    Some(values)
}

/// The number of devices: 1 if the board can be opened, else 0.
#[unsafe(no_mangle)]
pub extern "C" fn hdPhantomGetNumDevices() -> c_int {
    c_int::from(with(0, |_| true) == DONE)
}

/// Opens the device, and turns its motors on. Where the board refuses that, positions are there and forces are not.
#[unsafe(no_mangle)]
pub extern "C" fn hdPhantomOpen(id: c_int) -> c_int {
    with(id, HdDevice::arm)
}

/// Turns the motors off.
#[unsafe(no_mangle)]
pub extern "C" fn hdPhantomClose(id: c_int) -> c_int {
    with(id, HdDevice::disarm)
}

/// The tip, m; none while the board is gone.
///
/// # Safety
/// The pointers are NULL or each has room for one number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn hdPhantomGetPosition(id: c_int, x: *mut f64, y: *mut f64, z: *mut f64) -> c_int {
    // SAFETY: as the caller promises.
    with(id, |device| device.position().is_some_and(|position| unsafe { put([x, y, z], position) }))
}

/// Its velocity, m/s; none while the board is gone.
///
/// # Safety
/// The pointers are NULL or each has room for one number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn hdPhantomGetLinearVelocity(id: c_int, x: *mut f64, y: *mut f64, z: *mut f64) -> c_int {
    // SAFETY: as the caller promises.
    with(id, |device| device.velocity().is_some_and(|velocity| unsafe { put([x, y, z], velocity) }))
}

/// The orientation, as rows: none of our devices has any but the identity.
///
/// # Safety
/// The pointers are NULL or each has room for one number.
#[unsafe(no_mangle)]
#[allow(clippy::too_many_arguments, reason = "CHAI3D's")]
pub unsafe extern "C" fn hdPhantomGetRotation(
    id: c_int,
    r00: *mut f64,
    r01: *mut f64,
    r02: *mut f64,
    r10: *mut f64,
    r11: *mut f64,
    r12: *mut f64,
    r20: *mut f64,
    r21: *mut f64,
    r22: *mut f64,
) -> c_int {
    // SAFETY: as the caller promises.
    with(id, |_| unsafe {
        put([r00, r01, r02], [1.0, 0.0, 0.0])
            && put([r10, r11, r12], [0.0, 1.0, 0.0])
            && put([r20, r21, r22], [0.0, 0.0, 1.0])
    })
}

/// The buttons that are pressed, one bit each: no board has any.
#[unsafe(no_mangle)]
pub extern "C" fn hdPhantomGetButtons(_id: c_int) -> c_int {
    0
}

/// Pushes with a force (N) and returns at the next tick, a millisecond after the one before.
///
/// # Safety
/// The pointers are NULL or each points to a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn hdPhantomSetForce(id: c_int, x: *const f64, y: *const f64, z: *const f64) -> c_int {
    // SAFETY: as the caller promises.
    with(id, |device| unsafe { get([x, y, z]) }.is_some_and(|force| device.force(force)))
}

/// Torques at the handle: no device has any, so this does nothing.
///
/// # Safety
/// None is needed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn hdPhantomSetTorque(id: c_int, _x: *const f64, _y: *const f64, _z: *const f64) -> c_int {
    with(id, |_| true)
}

/// As [`hdPhantomSetForce`]; the torques do nothing.
///
/// # Safety
/// As of [`hdPhantomSetForce`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn hdPhantomSetForceAndTorque(
    id: c_int,
    x: *const f64,
    y: *const f64,
    z: *const f64,
    _tx: *const f64,
    _ty: *const f64,
    _tz: *const f64,
) -> c_int {
    // SAFETY: as the caller promises.
    unsafe { hdPhantomSetForce(id, x, y, z) }
}

/// The distance that the tip goes from the middle, about, m.
///
/// # Safety
/// `radius` is NULL or has room for one number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn hdPhantomGetWorkspaceRadius(id: c_int, radius: *mut f64) -> c_int {
    // SAFETY: as the caller promises.
    with(id, |device| unsafe { put([radius; 3], [device.radius; 3]) })
}

/// The name of the device, at most 254 bytes and a zero: CHAI3D has room for 255.
///
/// # Safety
/// `name` is NULL or has room for 255 bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn hdPhantomGetType(id: c_int, name: *mut c_char) -> c_int {
    with(id, |device| {
        if name.is_null() {
            return false;
        }
        let bytes = &device.name.as_bytes()[..device.name.len().min(254)];
        // SAFETY: as the caller promises, and no more than 255 are written.
        unsafe {
            std::ptr::copy_nonoverlapping(bytes.as_ptr(), name.cast(), bytes.len());
            *name.add(bytes.len()) = 0;
        }
        true
    })
}

/// The control loop is the board's own.
#[unsafe(no_mangle)]
pub extern "C" fn hdPhantomStartServo() {}

/// See [`hdPhantomStartServo`]; the motors go off with [`hdPhantomClose`].
#[unsafe(no_mangle)]
pub extern "C" fn hdPhantomStopServo() {}
