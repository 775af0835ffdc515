//! Tests of the C interface, by a program in C and by direct calls.

mod header;

use haptic_host::device_file::DeviceFile;
use haptic_host::haptic_bridge::model::description::Encoder;
use haptic_host::link::{Board as HostBoard, Session};
use haptic_sim::{BoardOptions, SHIPPED_DEVICE, SharedBoard, door, ready_board, server};
use hapticbridge::{
    Board, HB_ARMED, HB_BAD, HB_BAD_ARGUMENT, HB_DISARMED, HB_FAILED, HB_FAULT, HB_OK, HB_UNANSWERED, HB_VERSION,
    Request, State, hb_arm, hb_check_polarity, hb_clear, hb_close, hb_error, hb_exchange, hb_fault_text, hb_home,
    hb_load, hb_open, hb_set_scene, hb_wait_for_forces,
};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::ffi::{CStr, CString, c_char};
use std::mem::{offset_of, size_of};
use std::path::Path;
use std::process::Command;
use std::ptr::null;
use std::sync::atomic::AtomicBool;

/// Returns the folder of this test, which also has the shared library.
fn library_folder() -> std::path::PathBuf {
    std::env::current_exe().unwrap().parent().unwrap().to_path_buf()
}

#[test]
#[cfg(target_os = "linux")]
fn the_example_compiles_without_warnings_and_pushes_a_board() {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = library_folder();
    let program = folder.join("capi-push");
    let compiled = Command::new("gcc")
        .args(["-std=c11", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wdouble-promotion", "-Werror", "-I"])
        .arg(here.join("include"))
        .arg(here.join("examples/push.c"))
        .arg("-L")
        .arg(&folder)
        .args(["-lhapticbridge", "-lm", "-o"])
        .arg(&program)
        .arg(format!("-Wl,-rpath,{}", folder.display()))
        .output()
        .expect("gcc: `apt-get install gcc`");
    assert!(compiled.status.success(), "{}", String::from_utf8_lossy(&compiled.stderr));
    // Creates the link that an installation of the library has.
    let soname = format!("libhapticbridge.so.{HB_VERSION}");
    let _ = std::fs::remove_file(folder.join(&soname));
    std::os::unix::fs::symlink("libhapticbridge.so", folder.join(&soname)).unwrap();
    let device = here.join("../../devices/coupled-five-bar.toml");
    let ran = Command::new(&program).arg("sim").arg(device).output().unwrap();
    let output = String::from_utf8_lossy(&ran.stdout);
    assert!(ran.status.success(), "{output}{}", String::from_utf8_lossy(&ran.stderr));
    let lines: Vec<&str> = output.lines().collect();
    let numbers: Vec<f64> = lines[0].split(' ').filter_map(|word| word.parse().ok()).collect();
    // 0.5 N against 100 N/m are 5 mm, less the friction of two joints (0.005 N m on 0.1 m arms). 0 is taken, 1 is
    // armed.
    assert!((numbers[0] - 0.005).abs() < 0.001 && numbers[1].abs() < 0.001, "{output}");
    assert_eq!(numbers[2..], [0.0, 1.0], "{output}");
    let sizes = [size_of::<Request>(), size_of::<State>()];
    let offsets = [offset_of!(Request, damping_ns_m), offset_of!(State, fault)];
    let expected = format!("sizes {} {} offsets {} {}", sizes[0], sizes[1], offsets[0], offsets[1]);
    assert_eq!(lines[1], expected, "header and library have the same structures");
    assert!(lines[2].starts_with("cannot connect to 127.0.0.1:1"), "{output}");
    // A linked program finds the library by this name, independent of the path at link time.
    let dynamic = Command::new("readelf").arg("-d").arg(folder.join("libhapticbridge.so")).output().unwrap();
    assert!(String::from_utf8_lossy(&dynamic.stdout).contains(&format!("soname: [{soname}]")));
    let package = std::fs::read_to_string(here.join("hapticbridge.pc")).unwrap();
    assert!(package.contains(concat!("Version: ", env!("CARGO_PKG_VERSION"), "\n")));
}

fn words(text: *const c_char) -> String {
    // SAFETY: pointers from the library are never NULL and their strings end with a zero.
    unsafe { CStr::from_ptr(text) }.to_str().unwrap().into()
}

fn error() -> String {
    words(hb_error())
}

#[test]
fn a_program_starts_a_strict_board_and_clears_its_fault() {
    let mut file = DeviceFile::parse(SHIPPED_DEVICE, "coupled-five-bar.toml").unwrap();
    for joint in &mut file.description.joints[..2] {
        joint.motor.as_mut().unwrap().verified = true;
        joint.limits = Some((-4.0, 4.0));
    }
    file.description.sensed[1] = Some(Encoder { counts_per_turn: 4_000.0, offset: 0.0, inverted: true });
    file.description.sensed[0] = Some(Encoder { counts_per_turn: 4_000.0, offset: 0.5, inverted: false });
    let options = BoardOptions { strict: true, ..BoardOptions::default() };
    let shared = SharedBoard::new(ready_board(&file, options).unwrap());
    let board = Board::of(Session::of(HostBoard::over(shared.wire(), "sim").unwrap()));
    let mut state = State::default();
    // SAFETY: every pointer is valid for its type, and no call uses the board after hb_close().
    unsafe {
        let mut read_state = || {
            assert_eq!(hb_exchange(board, null(), &mut state), HB_OK, "{}", error());
            state
        };
        assert_eq!((hb_set_scene(board, null()), hb_home(board)), (HB_OK, HB_OK), "{}", error());
        assert_eq!(hb_check_polarity(board), HB_OK, "{}", error());
        // Homing and polarity check stay valid with another scene.
        assert_eq!((hb_set_scene(board, null()), hb_arm(board)), (HB_OK, HB_OK), "{}", error());
        for _ in 0..4 {
            shared.lock().run(0.4);
            assert_eq!((read_state().state, read_state().fault), (HB_ARMED, 0), "{}", error());
        }
        shared.lock().device_mut().set_sensed_counts([0, 1_000, 0]);
        shared.lock().run(0.01);
        let [first, second, third] = read_state().sensed_rad;
        assert_eq!((first, third), (0.5, 0.0));
        assert!((second + std::f32::consts::FRAC_PI_2).abs() < 1e-5, "{second}");
        let push = Request { hold_s: 0.1, force_n: [0.5, 0.0, 0.0], ..Request::default() };
        assert_eq!(hb_exchange(board, &push, &mut State::default()), HB_OK);
        shared.lock().run(0.05);
        let now = read_state();
        assert!(now.qd_rad_s[0].hypot(now.qd_rad_s[1]) > 0.02, "{now:?}");
        shared.lock().run(0.6);
        let fault = read_state();
        assert_eq!((fault.state, fault.fault), (HB_FAULT, 16));
        assert_eq!(error(), words(hb_fault_text(16)));
        assert!(error().starts_with("HostLost (16): the host has sent no sign of life"), "{}", error());
        assert_eq!(words(hb_fault_text(0)), "");
        assert!(words(hb_fault_text(7)).contains("then hb_clear() and arm again"), "{}", words(hb_fault_text(7)));
        assert_eq!((hb_clear(board), read_state().state, read_state().fault), (HB_OK, HB_DISARMED, 0));
        hb_close(board);
    }
}

#[test]
fn errors_name_functions_and_arguments() {
    let device = concat!(env!("CARGO_MANIFEST_DIR"), "/../../devices/coupled-five-bar.toml");
    let device = CString::new(device).unwrap();
    // SAFETY: every pointer is NULL or valid for its type, and no call uses the board after hb_close().
    unsafe {
        // A pointer from an earlier call must show the latest message.
        let before = hb_error();
        assert_eq!((hb_arm(null()), words(before)), (HB_BAD_ARGUMENT, "the board is NULL".into()));
        let board = hb_open(c"sim".as_ptr());
        assert_eq!((hb_load(board, device.as_ptr(), null()), hb_home(board)), (HB_OK, HB_OK), "{}", error());
        // If the check had not ended when the call returns, the board would refuse to arm.
        assert_eq!((hb_check_polarity(board), hb_arm(board)), (HB_OK, HB_OK), "{}", error());
        assert_eq!(hb_load(board, device.as_ptr(), null()), HB_FAILED);
        assert_eq!(error(), "the board refuses: the motors are armed: hb_disarm() first");
        let mut state = State::default();
        let absurd = Request { hold_s: 0.02, fade_s: 0.05, force_n: [f32::NAN, 0.0, 0.0], ..Request::default() };
        assert_eq!((hb_exchange(board, &absurd, &mut state), state.done), (HB_OK, HB_BAD));
        assert!(error().starts_with("not taken: each entry of the force must be at most"), "{}", error());
        assert_eq!(hb_wait_for_forces(board, f64::NAN), HB_BAD_ARGUMENT);
        assert_eq!(error(), "the time is not a number of seconds, 0 or more");
        assert_eq!(hb_wait_for_forces(board, 0.0), HB_OK);
        assert_eq!(hb_exchange(board, null(), &mut state), HB_UNANSWERED, "there is no wait");
        assert_eq!(hb_wait_for_forces(board, 0.1), HB_OK);
        assert_eq!(hb_exchange(board, null(), &mut state), HB_OK, "the next request succeeds");
        hb_close(board);
    }
}

/// The system's allocator, which counts the allocations of each thread.
struct CountingAllocator;

thread_local! {
    static ALLOCATIONS: Cell<u32> = const { Cell::new(0) };
}

// SAFETY: all calls are passed to the system's allocator.
unsafe impl GlobalAlloc for CountingAllocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.set(ALLOCATIONS.get() + 1);
        // SAFETY: as the caller promises.
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        // SAFETY: as the caller promises.
        unsafe { System.dealloc(memory, layout) }
    }
}

#[global_allocator]
static COUNTING: CountingAllocator = CountingAllocator;

#[test]
fn an_exchange_allocates_nothing() {
    let file = DeviceFile::parse(SHIPPED_DEVICE, "coupled-five-bar.toml").unwrap();
    let mut simulated = ready_board(&file, BoardOptions::default()).unwrap();
    let door = door::tcp(([127, 0, 0, 1], 0).into(), door::Patience::default()).unwrap();
    let port = CString::new(door.port.as_str()).unwrap();
    // The board runs in its own thread.
    std::thread::spawn(move || server::serve(&mut simulated, &door, server::Pace::RealTime, &AtomicBool::new(false)));
    // SAFETY: the pointer is a zero-terminated string.
    let board = unsafe { hb_open(port.as_ptr()) };
    let push = Request { hold_s: 0.02, fade_s: 0.05, force_n: [0.1, 0.0, 0.0], ..Request::default() };
    let exchange = || {
        let mut state = State::default();
        // SAFETY: all pointers are valid.
        let code = unsafe { hb_exchange(board, &push, &mut state) };
        assert_eq!((code, state.state), (HB_OK, HB_ARMED));
    };
    // SAFETY: no call uses the board after hb_close().
    unsafe {
        assert_eq!((hb_set_scene(board, null()), hb_arm(board)), (HB_OK, HB_OK), "{}", error());
        exchange();
        let before = ALLOCATIONS.get();
        (0..100).for_each(|_| exchange());
        assert_eq!(ALLOCATIONS.get() - before, 0);
        hb_close(board);
    }
}
