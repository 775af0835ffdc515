//! haptic-bridge boards for programs in C. `UPDATE_DOCS=1 cargo test -p haptic-c header` generates
//! `include/hapticbridge.h` from this file by cbindgen.
//!
//! A panic becomes [`HB_BROKEN`] instead of crossing the C interface, and drops the session, which disarms the board.

#![allow(clippy::missing_safety_doc, reason = "the header documents the conditions for pointers")]

use haptic_bridge::board::protocol::{ForceAnswer, ForceDone, ForceRequest, HostContact};
use haptic_bridge::render::scene::Scene;
use haptic_bridge::safety::fault::{Fault, State as BoardState};
use haptic_bridge::safety::refusal::Refusal;
use haptic_host::device_file::DeviceFile;
use haptic_host::link::{BoardError, LinkError, PortSpec, Session};
use haptic_host::scene_file::SceneFile;
use haptic_host::words::{commands_to_calls, fault_and_remedy};
use std::cell::UnsafeCell;
use std::ffi::{CStr, CString, c_char};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{LazyLock, Mutex, PoisonError};
use std::time::Duration;

/// Version of this header. A library of another version has other structures: compare with hb_version().
pub const HB_VERSION: u32 = 3;

/// Return value of a function: success.
pub const HB_OK: i32 = 0;
/// Return value of a function: failure, such as no board, a refusal or a wrong file.
pub const HB_FAILED: i32 = 1;
/// Return value of a function: an argument is NULL, not UTF-8, not finite or out of range.
pub const HB_BAD_ARGUMENT: i32 = 2;
/// Return value of a function: a defect of the library, which has disarmed the board.
pub const HB_BROKEN: i32 = 3;
/// Return value of a function: no reply in time, because the board or the computer was busy or a frame was lost.
pub const HB_UNANSWERED: i32 = 4;
/// Return value of a function: the connection was lost. Close the board, and open it once it is connected again.
pub const HB_LOST: i32 = 5;

/// hb_state.done: the request acts (docs/host-force.md).
pub const HB_TAKEN: i32 = 0;
/// hb_state.done: hold and fade are 0, so the request only read the state.
pub const HB_LOOKED: i32 = 1;
/// hb_state.done: the request does not act, because the motors are off.
pub const HB_NOT_ARMED: i32 = 2;
/// hb_state.done: the request does not act, because a request with the same or a later number acts.
pub const HB_NOT_NEWER: i32 = 3;
/// hb_state.done: the request does not act, because more time than hold and fade has passed since the last call.
pub const HB_TOO_OLD: i32 = 4;
/// hb_state.done: the request does not act, because one of its numbers is invalid. hb_error() names the number.
pub const HB_BAD: i32 = 5;

/// hb_state.state: the motors are off.
pub const HB_DISARMED: i32 = 0;
/// hb_state.state: the motors are on.
pub const HB_ARMED: i32 = 1;
/// hb_state.state: the polarity check turns the motors on one after the other, with a small torque.
pub const HB_CHECKING_POLARITY: i32 = 2;
/// hb_state.state: the motors are off until hb_clear(). hb_state.fault and hb_error() give the reason.
pub const HB_FAULT: i32 = 3;
/// hb_state.state: `haptic home --key` pushes the joints to their stops one after the other.
pub const HB_HOMING: i32 = 4;

/// A board that this program holds.
pub struct Board(Mutex<Option<Session>>);

impl Board {
    /// Creates a board for a program in C, which frees the board with [`hb_close`].
    pub fn of(session: Session) -> *mut Self {
        Box::into_raw(Box::new(Self(Mutex::new(Some(session)))))
    }
}

/// A request to the motors, which replaces the previous request. A request of zeros only reads the state.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default)]
pub struct Request {
    /// Time for which the request acts in full, 0 to 0.2.
    pub hold_s: f32,
    /// Time in which the request then fades to zero, 0 to 0.2.
    pub fade_s: f32,
    /// Force at the tip.
    pub force_n: [f32; 3],
    /// Joint torques.
    pub torque_nm: [f32; 3],
    /// 1 if the board renders the plane of the next four fields, otherwise 0.
    pub has_contact: i32,
    /// A point on the plane.
    pub point_m: [f32; 3],
    /// Unit normal of the plane, which points out of the solid.
    pub normal: [f32; 3],
    /// Stiffness of the plane.
    pub stiffness_n_m: f32,
    /// Damping of the plane.
    pub damping_ns_m: f32,
}

/// State of the device.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default)]
pub struct State {
    /// HB_TAKEN, or the reason why the request does not act.
    pub done: i32,
    /// HB_DISARMED, HB_ARMED, HB_CHECKING_POLARITY, HB_FAULT or HB_HOMING.
    pub state: i32,
    /// Number of control steps since the board started, which wraps at 2^32.
    pub step: u32,
    /// Period of the control steps.
    pub period_s: f32,
    /// Age of the state from which the acting request was computed; negative if no request acts.
    pub age_s: f32,
    /// Share of the request that acts.
    pub share: f32,
    /// Position of the tip.
    pub tip_m: [f32; 3],
    /// Velocity of the tip.
    pub velocity_m_s: [f32; 3],
    /// Joint angles. Of a slide its travel, m, and so are its speed, m/s, and its force, N.
    pub q_rad: [f32; 3],
    /// Commanded joint torques, after all limits.
    pub torque_nm: [f32; 3],
    /// Force that the host's force and contact have added at the tip.
    pub force_n: [f32; 3],
    /// Joint velocities.
    pub qd_rad_s: [f32; 3],
    /// Code of the latched fault, see hb_fault_text(); 0 without a fault.
    pub fault: i32,
    /// Angles of the encoders without motors.
    pub sensed_rad: [f32; 3],
}

const _: () = assert!(HB_ARMED == BoardState::Armed as i32 && HB_FAULT == BoardState::Fault as i32);
const _: () = assert!(HB_DISARMED == BoardState::Disarmed as i32 && HB_HOMING == BoardState::Homing as i32);
const _: () = assert!(HB_CHECKING_POLARITY == BoardState::CheckingPolarity as i32);

impl From<&ForceAnswer> for State {
    fn from(reply: &ForceAnswer) -> Self {
        let done = match reply.done {
            ForceDone::Taken => HB_TAKEN,
            ForceDone::Looked => HB_LOOKED,
            ForceDone::NotArmed => HB_NOT_ARMED,
            ForceDone::NotNewer => HB_NOT_NEWER,
            ForceDone::TooOld => HB_TOO_OLD,
            ForceDone::Bad(_) => HB_BAD,
        };
        Self {
            done,
            state: reply.state as i32,
            step: reply.step,
            period_s: reply.period,
            age_s: reply.age.unwrap_or(-1.0),
            share: reply.share,
            tip_m: reply.tip,
            velocity_m_s: reply.velocity,
            q_rad: reply.q,
            torque_nm: reply.torque,
            force_n: reply.force,
            qd_rad_s: reply.qd,
            fault: 0,
            sensed_rad: reply.sensed,
        }
    }
}

impl From<&Request> for ForceRequest {
    fn from(request: &Request) -> Self {
        let contact = HostContact {
            point: request.point_m,
            normal: request.normal,
            stiffness: request.stiffness_n_m,
            damping: request.damping_ns_m,
        };
        Self {
            hold: request.hold_s,
            fade: request.fade_s,
            force: request.force_n,
            torque: request.torque_nm,
            contact: (request.has_contact != 0).then_some(contact),
            ..Self::default()
        }
    }
}

/// The failure of a call: its code and its message.
struct Failure(i32, String);

impl Failure {
    fn argument(which: &str, what: &str) -> Self {
        Self(HB_BAD_ARGUMENT, format!("{which} is {what}"))
    }
}

impl<E: std::error::Error + 'static> From<E> for Failure {
    fn from(error: E) -> Self {
        let any: &dyn std::error::Error = &error;
        let link = match any.downcast_ref() {
            Some(BoardError::Link(link)) => Some(link),
            _ => any.downcast_ref(),
        };
        let code = match link {
            Some(LinkError::Unanswered { .. } | LinkError::Silent { .. }) => HB_UNANSWERED,
            Some(LinkError::Lost(_)) => HB_LOST,
            _ => HB_FAILED,
        };
        Self(code, error.to_string())
    }
}

/// Commands of the tool, and the functions that replace them.
const CALLS: [(&str, &str); 6] = [
    ("device FILE", "hb_load()"),
    ("scene FILE", "hb_set_scene()"),
    ("home", "hb_home()"),
    ("polarity", "hb_check_polarity()"),
    ("disarm", "hb_disarm()"),
    ("faults --clear", "hb_clear()"),
];

/// Size of the buffer for `hb_error`, bytes.
const BUFFER_SIZE: usize = 1024;

thread_local! {
    /// Buffer for `hb_error`, which never moves, so that a pointer to it always shows the latest message.
    static ERROR: UnsafeCell<[u8; BUFFER_SIZE]> = const { UnsafeCell::new([0; BUFFER_SIZE]) };
}

/// Stores a message for `hb_error`.
fn store_message(message: &str) {
    let text = commands_to_calls(message, &CALLS).replace('\0', "");
    let end = (0..BUFFER_SIZE.min(text.len() + 1)).rev().find(|end| text.is_char_boundary(*end)).unwrap_or(0);
    ERROR.with(|error| {
        // SAFETY: the buffer belongs to this thread, and no other reference to it exists during this block.
        let buffer = unsafe { &mut *error.get() };
        buffer[..end].copy_from_slice(&text.as_bytes()[..end]);
        buffer[end] = 0;
    });
}

/// Runs `work`. Converts a failure or a panic to a code, and stores the message.
fn catch_failure<T>(work: impl FnOnce() -> Result<T, Failure>) -> Result<T, i32> {
    let done = catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|_| {
        Err(Failure(
            HB_BROKEN,
            "a defect of libhapticbridge: please report it and name the function that was called".into(),
        ))
    });
    done.map_err(|Failure(code, message)| {
        store_message(&message);
        code
    })
}

/// Reads a string from C.
///
/// # Safety
/// `text` is NULL or a zero-terminated string.
unsafe fn text<'a>(text: *const c_char, name: &'static str) -> Result<&'a str, Failure> {
    if text.is_null() {
        return Err(Failure::argument(name, "NULL"));
    }
    // SAFETY: as the caller promises.
    unsafe { CStr::from_ptr(text) }.to_str().map_err(|_| Failure::argument(name, "not UTF-8"))
}

/// Runs `work` with the session of a board. A panic of `work` drops the session, which disarms the board.
///
/// # Safety
/// `board` is NULL or came from [`hb_open`] and has not been closed.
unsafe fn with_session(board: *const Board, work: impl FnOnce(&mut Session) -> Result<(), Failure>) -> i32 {
    let done = catch_failure(|| {
        // SAFETY: as the caller promises.
        let board = unsafe { board.as_ref() }.ok_or_else(|| Failure::argument("the board", "NULL"))?;
        let mut session_slot = board.0.lock().unwrap_or_else(PoisonError::into_inner);
        let mut session = session_slot.take().ok_or_else(|| {
            Failure(
                HB_BROKEN,
                "the board was released after a defect of libhapticbridge: close it and open it again".into(),
            )
        })?;
        let done = work(&mut session);
        *session_slot = Some(session);
        done
    });
    done.err().unwrap_or(HB_OK)
}

/// Returns the HB_VERSION of the library.
#[unsafe(no_mangle)]
pub extern "C" fn hb_version() -> u32 {
    HB_VERSION
}

/// Returns the message of the last failed call of this thread. After hb_exchange() the message can also be the reason
/// of HB_BAD or the latched fault. The pointer is never NULL and stays the same for the life of the thread.
#[unsafe(no_mangle)]
pub extern "C" fn hb_error() -> *const c_char {
    ERROR.with(|error| error.get().cast_const().cast())
}

/// Returns the meaning and the remedy of a fault code from hb_state.fault; an empty text for an unknown code.
#[unsafe(no_mangle)]
pub extern "C" fn hb_fault_text(fault: i32) -> *const c_char {
    static TEXTS: LazyLock<Vec<(i32, CString)>> = LazyLock::new(|| {
        let text = |fault: &Fault| commands_to_calls(&format!("{fault}; {}", fault.remedy()), &CALLS);
        Fault::ALL.iter().map(|fault| (fault.code().into(), CString::new(text(fault)).unwrap_or_default())).collect()
    });
    TEXTS.iter().find(|(code, _)| *code == fault).map_or(c"".as_ptr(), |(_, text)| text.as_ptr())
}

/// Opens a board. `port` is a serial port or serial number, tcp:HOST:PORT, sim, sim:DEVICE.toml, or NULL for the only
/// connected board. Returns NULL if the board cannot be opened.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn hb_open(port: *const c_char) -> *mut Board {
    let opened = catch_failure(|| {
        let spec = if port.is_null() {
            PortSpec::Find
        } else {
            // SAFETY: as the caller promises.
            unsafe { text(port, "the port") }?.parse::<PortSpec>().map_err(|message| Failure(HB_FAILED, message))?
        };
        Ok(Session::of(haptic_sim::open(&spec)?))
    });
    opened.map_or(std::ptr::null_mut(), Board::of)
}

/// Disarms the board and closes it. NULL is allowed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn hb_close(board: *mut Board) {
    if !board.is_null() {
        // SAFETY: as the caller promises.
        let board = unsafe { Box::from_raw(board) };
        let _ = catch_failure(|| {
            drop(board);
            Ok(())
        });
    }
}

/// Loads a device file and a scene file; a NULL scene is free space. The motors must be off. The device must be homed
/// again. The polarity check stays valid if the same device is loaded again and homed close to its earlier home.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn hb_load(board: *const Board, device_file: *const c_char, scene_file: *const c_char) -> i32 {
    // SAFETY: as the caller promises.
    unsafe {
        with_session(board, |session| {
            let device = DeviceFile::load(text(device_file, "the device file")?)?;
            let scene = scene(scene_file, device.spec().task)?;
            session.set_device(&device.device()?)?;
            Ok(session.set_scene(&scene)?)
        })
    }
}

/// Loads a scene file for the present device, which stays homed; NULL is free space. The motors must be off.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn hb_set_scene(board: *const Board, scene_file: *const c_char) -> i32 {
    // SAFETY: as the caller promises.
    unsafe {
        with_session(board, |session| {
            let device = session.device()?.ok_or(BoardError::Refused(Refusal::NoDevice))?;
            Ok(session.set_scene(&scene(scene_file, device.mechanism.kind().spec().task)?)?)
        })
    }
}

/// Loads a scene for a device of `task` dimensions.
///
/// # Safety
/// `file` is NULL, for free space, or a zero-terminated string.
unsafe fn scene(file: *const c_char, task: usize) -> Result<Scene<f32>, Failure> {
    if file.is_null() {
        return Ok(Scene { task: task as u8, ..Scene::default() });
    }
    // SAFETY: as the caller promises.
    Ok(SceneFile::load(unsafe { text(file, "the scene file") }?, task)?.scene()?)
}

/// Declares that the device is in its home pose.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn hb_home(board: *const Board) -> i32 {
    // SAFETY: as the caller promises.
    unsafe { with_session(board, |session| Ok(session.home()?)) }
}

/// Checks that every motor turns its joint in the direction in which the encoder counts. Moves each joint a little and
/// waits for the end of the check. Returns HB_OK only if all joints pass.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn hb_check_polarity(board: *const Board) -> i32 {
    let check = |session: &mut Session| {
        session.check_polarity()?;
        Ok(session.wait_for_polarity()?.require_pass()?)
    };
    // SAFETY: as the caller promises.
    unsafe { with_session(board, check) }
}

/// Turns the motors on; the torque ramps up over 0.5 s. hb_exchange(), also with NULL, must then be called as often as
/// the board's rules require a heartbeat, by default every 0.5 s.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn hb_arm(board: *const Board) -> i32 {
    // SAFETY: as the caller promises.
    unsafe { with_session(board, |session| Ok(session.arm()?)) }
}

/// Turns the motors off.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn hb_disarm(board: *const Board) -> i32 {
    // SAFETY: as the caller promises.
    unsafe { with_session(board, |session| Ok(session.disarm()?)) }
}

/// Clears a latched fault.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn hb_clear(board: *const Board) -> i32 {
    // SAFETY: as the caller promises.
    unsafe { with_session(board, |session| Ok(session.clear()?)) }
}

/// Sets the time for which hb_exchange() waits for its reply, s. By default it waits for 0.1 s and retries for 1 s in
/// total. A program with a faster loop sets a shorter time, which limits the delay by a lost frame.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn hb_wait_for_forces(board: *const Board, seconds: f64) -> i32 {
    // SAFETY: as the caller promises.
    unsafe {
        with_session(board, |session| {
            let patience = Duration::try_from_secs_f64(seconds)
                .map_err(|_| Failure::argument("the time", "not a number of seconds, 0 or more"))?;
            session.wait_for_forces(patience);
            Ok(())
        })
    }
}

/// Sends a request (NULL only reads the state) and waits for the reply, usually less than a millisecond. Returns
/// HB_UNANSWERED without a reply, see hb_wait_for_forces(). A refused request is not a failure; hb_state.done gives the
/// reason. Allocates no memory after the first calls, except for messages for hb_error().
#[unsafe(no_mangle)]
pub unsafe extern "C" fn hb_exchange(board: *const Board, request: *const Request, state: *mut State) -> i32 {
    // SAFETY: as the caller promises.
    unsafe {
        with_session(board, |session| {
            let state = state.as_mut().ok_or_else(|| Failure::argument("the state", "NULL"))?;
            let request = request.as_ref().map(ForceRequest::from).unwrap_or_default();
            let reply = session.exchange(request)?;
            if let ForceDone::Bad(_) = reply.done {
                store_message(&reply.done.to_string());
            }
            let fault = session.fault();
            if let Some(record) = &fault {
                store_message(&fault_and_remedy(record));
            }
            *state = State { fault: fault.map_or(0, |record| record.fault.code().into()), ..State::from(&reply) };
            Ok(())
        })
    }
}
