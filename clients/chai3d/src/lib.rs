//! haptic-bridge boards for unchanged programs that were made with CHAI3D 3.3: the 14 functions that CHAI3D's
//! `CPhantomDevices.cpp` looks up in `libhdPhantom.so`, with its units, axes and order (docs/chai3d.md).
//!
//! HAPTIC_PORT names the board; the default is a simulated board. Functions return 0, or -1 on failure, and write
//! messages to standard error. No panic crosses the C interface, and the motors go off when the program ends.

#![allow(non_snake_case, reason = "CHAI3D's names")]

mod device;

use device::HdDevice;
use std::ffi::{c_char, c_int};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Mutex, PoisonError};

/// The state of the board: not opened yet, failed to open, or open.
enum Connection {
    NotOpened,
    Failed,
    Open(Box<HdDevice>),
}

static CONNECTION: Mutex<Connection> = Mutex::new(Connection::NotOpened);

const DONE: c_int = 0;
const FAILED: c_int = -1;

/// Runs `work` with the board, which is opened first if necessary. A panic of `work` drops the board, which disarms it.
fn with_device(id: c_int, work: impl FnOnce(&mut HdDevice) -> bool) -> c_int {
    if id != 0 {
        return FAILED;
    }
    let done = catch_unwind(AssertUnwindSafe(|| {
        let mut connection = CONNECTION.lock().unwrap_or_else(PoisonError::into_inner);
        if matches!(*connection, Connection::NotOpened) {
            *connection = match HdDevice::open() {
                Ok(device) => Connection::Open(Box::new(device)),
                Err(message) => {
                    haptic_host::tell!("haptic-bridge: {message}");
                    Connection::Failed
                }
            };
        }
        let Connection::Open(mut device) = std::mem::replace(&mut *connection, Connection::Failed) else {
            return false;
        };
        let done = work(&mut device);
        *connection = Connection::Open(device);
        done
    }));
    if done.unwrap_or(false) { DONE } else { FAILED }
}

/// Turns the motors off when a program ends without closing the device. A killed program does not run this function;
/// the board then disarms because it watches its host.
extern "C" fn disarm_at_exit() {
    let _ = catch_unwind(|| {
        if let Ok(mut connection) = CONNECTION.try_lock() {
            *connection = Connection::Failed;
        }
    });
}
#[cfg(target_os = "linux")]
#[used]
#[unsafe(link_section = ".fini_array")]
static DISARM_AT_EXIT: extern "C" fn() = disarm_at_exit;

/// Writes three numbers.
///
/// # Safety
/// Each pointer is NULL or valid for writing a number.
unsafe fn write_numbers(to: [*mut f64; 3], values: [f64; 3]) -> bool {
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
/// Each pointer is NULL or valid for reading a number.
unsafe fn read_numbers(from: [*const f64; 3]) -> Option<[f64; 3]> {
    let mut values = [0.0; 3];
    for (from, value) in from.into_iter().zip(&mut values) {
        // SAFETY: as the caller promises.
        *value = *unsafe { from.as_ref() }?;
    }
    Some(values)
}

/// Returns the number of devices: 1 if the board can be opened, otherwise 0.
#[unsafe(no_mangle)]
pub extern "C" fn hdPhantomGetNumDevices() -> c_int {
    c_int::from(with_device(0, |_| true) == DONE)
}

/// Opens the device and turns its motors on. If the board refuses, positions work but forces do not.
#[unsafe(no_mangle)]
pub extern "C" fn hdPhantomOpen(id: c_int) -> c_int {
    with_device(id, HdDevice::arm)
}

/// Turns the motors off.
#[unsafe(no_mangle)]
pub extern "C" fn hdPhantomClose(id: c_int) -> c_int {
    with_device(id, HdDevice::disarm)
}

/// Reads the position of the tip, m. Fails while the board is lost.
///
/// # Safety
/// Each pointer is NULL or valid for writing a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn hdPhantomGetPosition(id: c_int, x: *mut f64, y: *mut f64, z: *mut f64) -> c_int {
    // SAFETY: as the caller promises.
    with_device(id, |device| device.position().is_some_and(|position| unsafe { write_numbers([x, y, z], position) }))
}

/// Reads the velocity of the tip, m/s. Fails while the board is lost.
///
/// # Safety
/// Each pointer is NULL or valid for writing a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn hdPhantomGetLinearVelocity(id: c_int, x: *mut f64, y: *mut f64, z: *mut f64) -> c_int {
    // SAFETY: as the caller promises.
    with_device(id, |device| device.velocity().is_some_and(|velocity| unsafe { write_numbers([x, y, z], velocity) }))
}

/// Reads the rotation matrix of the handle; the identity unless the device has encoders without motors. Fails while the
/// board is lost.
///
/// # Safety
/// Each pointer is NULL or valid for writing a number.
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
    with_device(id, |device| unsafe {
        device.rotation().is_some_and(|[first, second, third]| {
            write_numbers([r00, r01, r02], first)
                && write_numbers([r10, r11, r12], second)
                && write_numbers([r20, r21, r22], third)
        })
    })
}

/// Returns the pressed buttons as bits: always 0, because no board has buttons.
#[unsafe(no_mangle)]
pub extern "C" fn hdPhantomGetButtons(_id: c_int) -> c_int {
    0
}

/// Pushes with a force (N) and returns at the next tick, 1 ms after the previous tick.
///
/// # Safety
/// Each pointer is NULL or valid for reading a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn hdPhantomSetForce(id: c_int, x: *const f64, y: *const f64, z: *const f64) -> c_int {
    // SAFETY: as the caller promises.
    with_device(id, |device| unsafe { read_numbers([x, y, z]) }.is_some_and(|force| device.force(force)))
}

/// Does nothing, because no device makes torques at the handle.
///
/// # Safety
/// No requirements.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn hdPhantomSetTorque(id: c_int, _x: *const f64, _y: *const f64, _z: *const f64) -> c_int {
    with_device(id, |_| true)
}

/// Like [`hdPhantomSetForce`]; ignores the torques.
///
/// # Safety
/// As for [`hdPhantomSetForce`].
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

/// Reads the approximate radius of the workspace, m.
///
/// # Safety
/// `radius` is NULL or valid for writing a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn hdPhantomGetWorkspaceRadius(id: c_int, radius: *mut f64) -> c_int {
    // SAFETY: as the caller promises.
    with_device(id, |device| unsafe { write_numbers([radius; 3], [device.radius; 3]) })
}

/// Reads the name of the device, at most 254 bytes and a zero, because CHAI3D's buffer has 255 bytes.
///
/// # Safety
/// `name` is NULL or valid for writing 255 bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn hdPhantomGetType(id: c_int, name: *mut c_char) -> c_int {
    with_device(id, |device| {
        if name.is_null() {
            return false;
        }
        let bytes = &device.name.as_bytes()[..device.name.len().min(254)];
        // SAFETY: as the caller promises; at most 255 bytes are written.
        unsafe {
            std::ptr::copy_nonoverlapping(bytes.as_ptr(), name.cast(), bytes.len());
            *name.add(bytes.len()) = 0;
        }
        true
    })
}

/// Does nothing, because the board has its own control loop.
#[unsafe(no_mangle)]
pub extern "C" fn hdPhantomStartServo() {}

/// Does nothing, because [`hdPhantomClose`] turns the motors off.
#[unsafe(no_mangle)]
pub extern "C" fn hdPhantomStopServo() {}
