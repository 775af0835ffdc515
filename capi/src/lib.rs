//! haptic-bridge boards for programs in C: the functions that `include/hapticbridge.h` declares and documents.
//!
//! Nothing unwinds across the border: a panic becomes [`BROKEN`], and dropping a session disarms its board.

use haptic::device_file::DeviceFile;
use haptic::link::{PortSpec, Session};
use haptic::scene_file::SceneFile;
use haptic_bridge::board::protocol::{ForceAnswer, ForceDone, ForceRequest, HostContact};
use haptic_bridge::render::scene::Scene;
use std::cell::RefCell;
use std::ffi::{CStr, CString, c_char};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Mutex, PoisonError};

/// `HB_VERSION`: raised by any change of a structure or a function.
pub const VERSION: u32 = 1;
/// `HB_OK`
pub const OK: i32 = 0;
/// `HB_FAILED`
pub const FAILED: i32 = 1;
/// `HB_BAD_ARGUMENT`
pub const BAD_ARGUMENT: i32 = 2;
/// `HB_BROKEN`
pub const BROKEN: i32 = 3;

/// `hb_board`
pub struct Board(Mutex<Option<Session>>);

/// `hb_request`
#[repr(C)]
#[derive(Clone, Copy, Debug, Default)]
#[allow(missing_docs, reason = "documented in the header")]
pub struct Request {
    pub hold_s: f32,
    pub fade_s: f32,
    pub force_n: [f32; 3],
    pub torque_nm: [f32; 3],
    pub has_contact: i32,
    pub point_m: [f32; 3],
    pub normal: [f32; 3],
    pub stiffness_n_m: f32,
    pub damping_ns_m: f32,
}

/// `hb_state`
#[repr(C)]
#[derive(Clone, Copy, Debug, Default)]
#[allow(missing_docs, reason = "documented in the header")]
pub struct State {
    pub done: i32,
    pub state: i32,
    pub step: u32,
    pub period_s: f32,
    pub age_s: f32,
    pub share: f32,
    pub tip_m: [f32; 3],
    pub velocity_m_s: [f32; 3],
    pub q_rad: [f32; 3],
    pub torque_nm: [f32; 3],
    pub force_n: [f32; 3],
}

impl From<&ForceAnswer> for State {
    fn from(answer: &ForceAnswer) -> Self {
        let done = match answer.done {
            ForceDone::Taken => 0,
            ForceDone::Looked => 1,
            ForceDone::NotArmed => 2,
            ForceDone::NotNewer => 3,
            ForceDone::TooOld => 4,
            ForceDone::Bad(_) => 5,
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

/// What a call of this library can end with, beside well.
enum Failure {
    /// In the words of the tool.
    Words(String),
    /// Of which argument.
    Argument(&'static str),
}

impl<E: std::error::Error> From<E> for Failure {
    fn from(error: E) -> Self {
        Self::Words(error.to_string())
    }
}

thread_local! {
    static ERROR: RefCell<CString> = RefCell::default();
}

/// Keeps words for `hb_error`.
fn say(words: &str) {
    let text: String = words.chars().filter(|character| *character != '\0').collect();
    ERROR.with(|error| *error.borrow_mut() = CString::new(text).unwrap_or_default());
}

/// Runs `work`, and turns whatever becomes of it into a code and words.
fn guarded<T>(work: impl FnOnce() -> Result<T, Failure>) -> Result<T, i32> {
    match catch_unwind(AssertUnwindSafe(work)) {
        Ok(Ok(value)) => Ok(value),
        Ok(Err(Failure::Words(words))) => {
            say(&words);
            Err(FAILED)
        }
        Ok(Err(Failure::Argument(which))) => {
            say(&format!("{which} is NULL, or no UTF-8"));
            Err(BAD_ARGUMENT)
        }
        Err(_) => {
            say("a defect of libhapticbridge: please report it with what was called");
            Err(BROKEN)
        }
    }
}

/// Text from C.
///
/// # Safety
/// `text` is NULL or a string that ends with a zero.
unsafe fn text<'a>(text: *const c_char, name: &'static str) -> Result<&'a str, Failure> {
    if text.is_null() {
        return Err(Failure::Argument(name));
    }
    // SAFETY: as the caller promises.
    unsafe { CStr::from_ptr(text) }.to_str().map_err(|_| Failure::Argument(name))
}

/// Has a board's session do something; a panic in it lets go of the session, which disarms the board.
///
/// # Safety
/// `board` is NULL or came from [`hb_open`] and has not been closed.
unsafe fn with(board: *const Board, work: impl FnOnce(&mut Session) -> Result<(), Failure>) -> i32 {
    let done = guarded(|| {
        // SAFETY: as the caller promises.
        let board = unsafe { board.as_ref() }.ok_or(Failure::Argument("the board"))?;
        let mut held = board.0.lock().unwrap_or_else(PoisonError::into_inner);
        let mut session = held.take().ok_or_else(|| Failure::Words("the board was let go after a defect".into()))?;
        let done = work(&mut session);
        *held = Some(session);
        done
    });
    done.err().unwrap_or(OK)
}

/// See the header.
#[unsafe(no_mangle)]
pub extern "C" fn hb_version() -> u32 {
    VERSION
}

/// See the header.
#[unsafe(no_mangle)]
pub extern "C" fn hb_error() -> *const c_char {
    ERROR.with(|error| error.borrow().as_ptr())
}

/// See the header.
///
/// # Safety
/// `port` is NULL or a string that ends with a zero.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn hb_open(port: *const c_char) -> *mut Board {
    let opened = guarded(|| {
        let spec = if port.is_null() {
            PortSpec::Find
        } else {
            // SAFETY: as the caller promises.
            unsafe { text(port, "the port") }?.parse::<PortSpec>().map_err(Failure::Words)?
        };
        Ok(Session::open(&spec)?)
    });
    opened.map_or(std::ptr::null_mut(), |session| Box::into_raw(Box::new(Board(Mutex::new(Some(session))))))
}

/// See the header.
///
/// # Safety
/// `board` is NULL or came from [`hb_open`] and has not been closed; no other call on it is under way.
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

/// See the header.
///
/// # Safety
/// As for the others; the files are NULL or strings that end with a zero.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn hb_load(board: *const Board, device_file: *const c_char, scene_file: *const c_char) -> i32 {
    // SAFETY: as the caller promises.
    unsafe {
        with(board, |session| {
            let device = DeviceFile::load(text(device_file, "the device file")?)?;
            let task = device.spec().task;
            let scene = if scene_file.is_null() {
                Scene { task: task as u8, ..Scene::default() }
            } else {
                SceneFile::load(text(scene_file, "the scene file")?, task)?.scene()?
            };
            session.set_device(&device.device()?)?;
            Ok(session.set_scene(&scene)?)
        })
    }
}

/// Declares functions that only need a board.
macro_rules! plain {
    ($($name:ident: $method:ident;)*) => {$(
        /// See the header.
        ///
        /// # Safety
        /// `board` is NULL or came from [`hb_open`] and has not been closed.
        #[unsafe(no_mangle)]
        pub unsafe extern "C" fn $name(board: *const Board) -> i32 {
            // SAFETY: as the caller promises.
            unsafe { with(board, |session| Ok(session.$method()?)) }
        }
    )*};
}
plain! {
    hb_home: home;
    hb_check_polarity: check_polarity;
    hb_arm: arm;
    hb_disarm: disarm;
    hb_clear: clear;
}

/// See the header.
///
/// # Safety
/// As for the others; `request` is NULL or points to one, `state` to room for one.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn hb_exchange(board: *const Board, request: *const Request, state: *mut State) -> i32 {
    // SAFETY: as the caller promises.
    unsafe {
        with(board, |session| {
            let state = state.as_mut().ok_or(Failure::Argument("the state"))?;
            let request = request.as_ref().map(ForceRequest::from).unwrap_or_default();
            *state = State::from(&session.exchange(request)?);
            Ok(())
        })
    }
}
