//! haptic-bridge boards for programs in C. `include/hapticbridge.h` is made of this file by cbindgen, documentation and
//! all: `UPDATE_DOCS=1 cargo test -p haptic-c header`.
//!
//! Nothing unwinds across the border: a panic becomes [`HB_BROKEN`], and dropping a session disarms its board.

#![allow(clippy::missing_safety_doc, reason = "what C is told is the documentation: pointers are NULL or what it says")]

use haptic_bridge::board::protocol::{ForceAnswer, ForceDone, ForceRequest, HostContact};
use haptic_bridge::render::scene::Scene;
use haptic_bridge::safety::fault::{Fault, State as BoardState};
use haptic_bridge::safety::refusal::Refusal;
use haptic_host::device_file::DeviceFile;
use haptic_host::link::{BoardError, LinkError, PortSpec, Session};
use haptic_host::scene_file::SceneFile;
use haptic_host::words::{fault_and_remedy, for_a_program};
use std::cell::UnsafeCell;
use std::ffi::{CStr, CString, c_char};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{LazyLock, Mutex, PoisonError};
use std::time::Duration;

/// Of this header. A library of another number has other structures: compare with hb_version().
pub const HB_VERSION: u32 = 2;

/// What a function returns: it was done.
pub const HB_OK: i32 = 0;
/// It could not be done: no board, a refusal, a file that is wrong.
pub const HB_FAILED: i32 = 1;
/// NULL, text that is not UTF-8, or a number that is not finite or out of range.
pub const HB_BAD_ARGUMENT: i32 = 2;
/// A defect of the library; the board was told to disarm.
pub const HB_BROKEN: i32 = 3;
/// No answer in time: the board or the computer was busy, or a frame was lost. The next call goes on.
pub const HB_UNANSWERED: i32 = 4;
/// The board was unplugged, or the connection to it ended: close it, and open it again once it is back.
pub const HB_LOST: i32 = 5;

/// hb_state.done: what was done with a request (docs/host-force.md). It acts.
pub const HB_TAKEN: i32 = 0;
/// hold and fade 0: it only asked.
pub const HB_LOOKED: i32 = 1;
/// The motors are off.
pub const HB_NOT_ARMED: i32 = 2;
/// A request with this number or a later one acts.
pub const HB_NOT_NEWER: i32 = 3;
/// More time than hold and fade since the last call.
pub const HB_TOO_OLD: i32 = 4;
/// A number that cannot be used: hb_error() says which.
pub const HB_BAD: i32 = 5;

/// hb_state.state: the motors are off.
pub const HB_DISARMED: i32 = 0;
/// They are on.
pub const HB_ARMED: i32 = 1;
/// They are on, a little, one after the other.
pub const HB_CHECKING_POLARITY: i32 = 2;
/// They are off until hb_clear(): hb_state.fault and hb_error() say why.
pub const HB_FAULT: i32 = 3;

/// A board that this program holds.
pub struct Board(Mutex<Option<Session>>);

impl Board {
    /// For C, which gives it back to [`hb_close`].
    pub fn of(session: Session) -> *mut Self {
        Box::into_raw(Box::new(Self(Mutex::new(Some(session)))))
    }
}

/// What the motors are asked for, in the place of what was asked for before. All zeros only asks how the device is.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default)]
pub struct Request {
    /// For how long it acts in full, 0 to 0.2.
    pub hold_s: f32,
    /// In how long it then fades to nothing, 0 to 0.2.
    pub fade_s: f32,
    /// At the tip.
    pub force_n: [f32; 3],
    /// At the joints.
    pub torque_nm: [f32; 3],
    /// 1: the board renders the plane below; 0: none.
    pub has_contact: i32,
    /// A point of it.
    pub point_m: [f32; 3],
    /// Its unit normal, out of the solid.
    pub normal: [f32; 3],
    /// Its stiffness.
    pub stiffness_n_m: f32,
    /// Its damping.
    pub damping_ns_m: f32,
}

/// How the device is.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default)]
pub struct State {
    /// HB_TAKEN or why not.
    pub done: i32,
    /// HB_DISARMED and so on.
    pub state: i32,
    /// Control steps since boot, wrapping.
    pub step: u32,
    /// From step to step.
    pub period_s: f32,
    /// Of the state that the acting request was computed from; negative when none acts.
    pub age_s: f32,
    /// Of what is asked for that acts.
    pub share: f32,
    /// Where the tip is.
    pub tip_m: [f32; 3],
    /// How fast it is.
    pub velocity_m_s: [f32; 3],
    /// Joint angles.
    pub q_rad: [f32; 3],
    /// Commanded, after all limits.
    pub torque_nm: [f32; 3],
    /// That the host's force and contact have really added at the tip.
    pub force_n: [f32; 3],
    /// Joint velocities.
    pub qd_rad_s: [f32; 3],
    /// Code of the fault that is latched, see hb_fault_text(); 0 without one.
    pub fault: i32,
}

const _: () = assert!(HB_ARMED == BoardState::Armed as i32 && HB_FAULT == BoardState::Fault as i32);
const _: () = assert!(HB_DISARMED == BoardState::Disarmed as i32);
const _: () = assert!(HB_CHECKING_POLARITY == BoardState::CheckingPolarity as i32);

impl From<&ForceAnswer> for State {
    fn from(answer: &ForceAnswer) -> Self {
        let done = match answer.done {
            ForceDone::Taken => HB_TAKEN,
            ForceDone::Looked => HB_LOOKED,
            ForceDone::NotArmed => HB_NOT_ARMED,
            ForceDone::NotNewer => HB_NOT_NEWER,
            ForceDone::TooOld => HB_TOO_OLD,
            ForceDone::Bad(_) => HB_BAD,
        };
        Self {
            done,
            state: answer.state as i32,
            step: answer.step,
            period_s: answer.period,
            age_s: answer.age.unwrap_or(-1.0),
            share: answer.share,
            tip_m: answer.tip,
            velocity_m_s: answer.velocity,
            q_rad: answer.q,
            torque_nm: answer.torque,
            force_n: answer.force,
            qd_rad_s: answer.qd,
            fault: 0,
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

/// The failure of a call of this library: a code, and words.
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

/// Commands that a person would type, and what a program calls instead.
const CALLS: [(&str, &str); 6] = [
    ("device FILE", "hb_load()"),
    ("scene FILE", "hb_set_scene()"),
    ("home", "hb_home()"),
    ("polarity", "hb_check_polarity()"),
    ("disarm", "hb_disarm()"),
    ("faults --clear", "hb_clear()"),
];

/// Longest text that `hb_error` tells, bytes.
const ROOM: usize = 1024;

thread_local! {
    /// Stays where it is, so that a pointer to it tells the newest error whenever it was taken.
    static ERROR: UnsafeCell<[u8; ROOM]> = const { UnsafeCell::new([0; ROOM]) };
}

/// Keeps words for `hb_error`.
fn say(words: &str) {
    let text = for_a_program(words, &CALLS).replace('\0', "");
    let end = (0..ROOM.min(text.len() + 1)).rev().find(|end| text.is_char_boundary(*end)).unwrap_or(0);
    ERROR.with(|error| {
        // SAFETY: only this thread has it, and no reference to it lives longer than this.
        let room = unsafe { &mut *error.get() };
        room[..end].copy_from_slice(&text.as_bytes()[..end]);
        room[end] = 0;
    });
}

/// Runs `work`, and turns whatever becomes of it into a code and words.
fn guarded<T>(work: impl FnOnce() -> Result<T, Failure>) -> Result<T, i32> {
    let done = catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|_| {
        Err(Failure(HB_BROKEN, "a defect of libhapticbridge: please report it with what was called".into()))
    });
    done.map_err(|Failure(code, words)| {
        say(&words);
        code
    })
}

/// Text from C.
///
/// # Safety
/// `text` is NULL or a string that ends with a zero.
unsafe fn text<'a>(text: *const c_char, name: &'static str) -> Result<&'a str, Failure> {
    if text.is_null() {
        return Err(Failure::argument(name, "NULL"));
    }
    // SAFETY: as the caller promises.
    unsafe { CStr::from_ptr(text) }.to_str().map_err(|_| Failure::argument(name, "no UTF-8"))
}

/// Has a board's session do something; a panic in it lets go of the session, which disarms the board.
///
/// # Safety
/// `board` is NULL or came from [`hb_open`] and has not been closed.
unsafe fn with(board: *const Board, work: impl FnOnce(&mut Session) -> Result<(), Failure>) -> i32 {
    let done = guarded(|| {
        // SAFETY: as the caller promises.
        let board = unsafe { board.as_ref() }.ok_or_else(|| Failure::argument("the board", "NULL"))?;
        let mut held = board.0.lock().unwrap_or_else(PoisonError::into_inner);
        let mut session =
            held.take().ok_or_else(|| Failure(HB_BROKEN, "the board was let go after a defect".into()))?;
        let done = work(&mut session);
        *held = Some(session);
        done
    });
    done.err().unwrap_or(HB_OK)
}

/// HB_VERSION of the library.
#[unsafe(no_mangle)]
pub extern "C" fn hb_version() -> u32 {
    HB_VERSION
}

/// What went wrong in the last call of this thread that failed; after hb_exchange() also which number of a request was
/// HB_BAD, or which fault is latched. Never NULL; the same pointer for as long as the thread lives.
#[unsafe(no_mangle)]
pub extern "C" fn hb_error() -> *const c_char {
    ERROR.with(|error| error.get().cast_const().cast())
}

/// What a fault means and what to do about it, of its code in hb_state.fault. Valid for ever; empty for what is no code.
#[unsafe(no_mangle)]
pub extern "C" fn hb_fault_text(fault: i32) -> *const c_char {
    static TEXTS: LazyLock<Vec<(i32, CString)>> = LazyLock::new(|| {
        let text = |fault: &Fault| for_a_program(&format!("{fault}; {}", fault.remedy()), &CALLS);
        Fault::ALL.iter().map(|fault| (fault.code().into(), CString::new(text(fault)).unwrap_or_default())).collect()
    });
    TEXTS.iter().find(|(code, _)| *code == fault).map_or(c"".as_ptr(), |(_, text)| text.as_ptr())
}

/// Opens a board: a serial port or serial number, tcp:HOST:PORT, sim, sim:DEVICE.toml, or NULL for the only one
/// connected. NULL when it cannot be opened.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn hb_open(port: *const c_char) -> *mut Board {
    let opened = guarded(|| {
        let spec = if port.is_null() {
            PortSpec::Find
        } else {
            // SAFETY: as the caller promises.
            unsafe { text(port, "the port") }?.parse::<PortSpec>().map_err(|words| Failure(HB_FAILED, words))?
        };
        Ok(Session::of(haptic_sim::open(&spec)?))
    });
    opened.map_or(std::ptr::null_mut(), Board::of)
}

/// Disarms the board and lets go of it. NULL is allowed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn hb_close(board: *mut Board) {
    if !board.is_null() {
        // SAFETY: as the caller promises.
        let board = unsafe { Box::from_raw(board) };
        let _ = guarded(|| {
            drop(board);
            Ok(())
        });
    }
}

/// Loads a device file and a scene file; a NULL scene is free space. Motors must be off. Homing is forgotten. The polarity
/// check still counts where the same device is loaded again and then homed near where it was homed before.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn hb_load(board: *const Board, device_file: *const c_char, scene_file: *const c_char) -> i32 {
    // SAFETY: as the caller promises.
    unsafe {
        with(board, |session| {
            let device = DeviceFile::load(text(device_file, "the device file")?)?;
            let scene = scene(scene_file, device.spec().task)?;
            session.set_device(&device.device()?)?;
            Ok(session.set_scene(&scene)?)
        })
    }
}

/// Loads a scene file for the device that the board has, which stays homed; NULL is free space. Motors must be off.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn hb_set_scene(board: *const Board, scene_file: *const c_char) -> i32 {
    // SAFETY: as the caller promises.
    unsafe {
        with(board, |session| {
            let device = session.device()?.ok_or(BoardError::Refused(Refusal::NoDevice))?;
            Ok(session.set_scene(&scene(scene_file, device.mechanism.kind().spec().task)?)?)
        })
    }
}

/// A scene for a device of `task` dimensions.
///
/// # Safety
/// `file` is NULL, for free space, or a string that ends with a zero.
unsafe fn scene(file: *const c_char, task: usize) -> Result<Scene<f32>, Failure> {
    if file.is_null() {
        return Ok(Scene { task: task as u8, ..Scene::default() });
    }
    // SAFETY: as the caller promises.
    Ok(SceneFile::load(unsafe { text(file, "the scene file") }?, task)?.scene()?)
}

/// The device stands in its home pose.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn hb_home(board: *const Board) -> i32 {
    // SAFETY: as the caller promises.
    unsafe { with(board, |session| Ok(session.home()?)) }
}

/// Checks that every motor turns its joint the way its encoder counts, which moves each joint a little; returns when
/// that is known, HB_OK only where all of them do.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn hb_check_polarity(board: *const Board) -> i32 {
    let check = |session: &mut Session| {
        session.check_polarity()?;
        Ok(session.wait_for_polarity()?.passed()?)
    };
    // SAFETY: as the caller promises.
    unsafe { with(board, check) }
}

/// Motors on; torque ramps up over half a second. hb_exchange(), also with NULL, must then be called at least as often as
/// the board's rules ask for a sign of the host: every half second, unless they say otherwise.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn hb_arm(board: *const Board) -> i32 {
    // SAFETY: as the caller promises.
    unsafe { with(board, |session| Ok(session.arm()?)) }
}

/// Motors off.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn hb_disarm(board: *const Board) -> i32 {
    // SAFETY: as the caller promises.
    unsafe { with(board, |session| Ok(session.disarm()?)) }
}

/// Clears a latched fault.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn hb_clear(board: *const Board) -> i32 {
    // SAFETY: as the caller promises.
    unsafe { with(board, |session| Ok(session.clear()?)) }
}

/// For how long hb_exchange() waits for its answer, s. Unless this says otherwise it waits for 0.1 and asks again, for a
/// second in all. A program whose loop has less time asks for less: a lost frame then costs it no more.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn hb_wait_for_forces(board: *const Board, seconds: f64) -> i32 {
    // SAFETY: as the caller promises.
    unsafe {
        with(board, |session| {
            let patience = Duration::try_from_secs_f64(seconds)
                .map_err(|_| Failure::argument("the time", "no number of seconds from 0 up"))?;
            session.wait_for_forces(patience);
            Ok(())
        })
    }
}

/// Sends a request (NULL only asks) and waits for the answer, usually below a millisecond. Where none comes it returns
/// HB_UNANSWERED, see hb_wait_for_forces(), and the next request goes on. A request that was not taken is no failure:
/// hb_state.done says why. Allocates no memory after the first calls, unless it has words for hb_error().
#[unsafe(no_mangle)]
pub unsafe extern "C" fn hb_exchange(board: *const Board, request: *const Request, state: *mut State) -> i32 {
    // SAFETY: as the caller promises.
    unsafe {
        with(board, |session| {
            let state = state.as_mut().ok_or_else(|| Failure::argument("the state", "NULL"))?;
            let request = request.as_ref().map(ForceRequest::from).unwrap_or_default();
            let answer = session.exchange(request)?;
            if let ForceDone::Bad(_) = answer.done {
                say(&answer.done.to_string());
            }
            let fault = session.fault();
            if let Some(record) = &fault {
                say(&fault_and_remedy(record));
            }
            *state = State { fault: fault.map_or(0, |record| record.fault.code().into()), ..State::from(&answer) };
            Ok(())
        })
    }
}
