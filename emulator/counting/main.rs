//! The counting image runs every variant of the control step on the chip, between markers for the emulator's `count`.
//!
//! Only the core runs, without board, clock set-up and interrupts. `cargo xtask bench` builds the image, counts its
//! instructions on the emulated chip and stores the counts in crates/predict/src/bench/counts.json. A variant's name is
//! `mechanism/trigonometry/exact/terms`, followed by the velocity estimator if it is not the usual one. Each
//! variant is called at several poses with the tip inside the walls, after a few steps of motion.
#![no_std]
#![no_main]

mod devices;

use core::hint::black_box;
use core::panic::PanicInfo;
use core::ptr::{addr_of_mut, write_volatile};
use haptic_bridge::math::{Math, Micromath, Minimax, Tabulated};
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::model::description::Description;
use haptic_bridge::model::device::Device;
use haptic_bridge::model::mechanism::Mechanism;
use haptic_bridge::render::controller::Controller;
use haptic_bridge::render::scene::{FeedForward, Plane, Scene, Sphere, Spring, Surface, VelocityTerms, Wall};
use haptic_bridge::render::step_result::StepResult;
use haptic_bridge::render::velocity::{Chosen, Estimator, MAX_WINDOW};
use haptic_bridge::with_mechanism;
use heapless::String;
use nalgebra::SVector;

#[unsafe(no_mangle)]
static mut BENCH_NAME: [u32; 2] = [0; 2];

#[unsafe(no_mangle)]
#[inline(never)]
extern "C" fn bench_begin() {
    // SAFETY: the instruction has no effect. It makes the three markers different functions.
    unsafe { core::arch::asm!("nop") };
}

#[unsafe(no_mangle)]
#[inline(never)]
extern "C" fn bench_end() {
    // SAFETY: the instructions have no effect, as in `bench_begin`.
    unsafe { core::arch::asm!("nop", "nop") };
}

#[unsafe(no_mangle)]
#[inline(never)]
extern "C" fn bench_done() {
    // SAFETY: the instructions have no effect, as in `bench_begin`.
    unsafe { core::arch::asm!("nop", "nop", "nop") };
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    loop {
        core::hint::spin_loop();
    }
}

/// Poses relative to home, rad. Every pose is regular for every device of this image.
const POSES: [[f32; MAX_JOINTS]; 6] =
    [[0.0; 3], [0.15, 0.2, -0.1], [-0.2, -0.15, 0.25], [0.3, 0.1, 0.2], [-0.1, 0.25, -0.2], [0.1, -0.2, -0.15]];
#[derive(Clone, Copy, PartialEq)]
enum Walls {
    None,
    OnePlane,
    /// Two crossing planes that the tip touches.
    TwoPlanes,
    Ball,
    Spring,
    PlaneAndSpring,
}

/// Name, contents of the scene, feed-forward and velocity terms of each variant.
const TERMS: &[(&str, Walls, FeedForward, VelocityTerms)] = &[
    ("none", Walls::OnePlane, FeedForward::Off, VelocityTerms::Off),
    ("feed-forward", Walls::OnePlane, FeedForward::Full, VelocityTerms::Off),
    ("feed-forward+z", Walls::OnePlane, FeedForward::Full, VelocityTerms::Rendered),
    ("washout", Walls::OnePlane, FeedForward::Washout, VelocityTerms::Off),
    ("washout+z", Walls::OnePlane, FeedForward::Washout, VelocityTerms::Rendered),
    ("free", Walls::None, FeedForward::Off, VelocityTerms::Off),
    ("edge, none", Walls::TwoPlanes, FeedForward::Off, VelocityTerms::Off),
    ("edge, washout", Walls::TwoPlanes, FeedForward::Washout, VelocityTerms::Off),
    ("edge, washout+z", Walls::TwoPlanes, FeedForward::Washout, VelocityTerms::Rendered),
    ("ball, washout", Walls::Ball, FeedForward::Washout, VelocityTerms::Off),
    ("ball, washout+z", Walls::Ball, FeedForward::Washout, VelocityTerms::Rendered),
    ("spring", Walls::Spring, FeedForward::Off, VelocityTerms::Off),
    ("spring beside, none", Walls::PlaneAndSpring, FeedForward::Off, VelocityTerms::Off),
    ("spring beside, washout", Walls::PlaneAndSpring, FeedForward::Washout, VelocityTerms::Off),
];
/// Steps before the counted step. The first starts a few counts away, so velocities are not zero.
const RUN_UP_STEPS: i32 = 3;
/// Steps before the counted step, enough to fill the longest window of an estimator.
const LONG_RUN_UP_STEPS: i32 = MAX_WINDOW as i32 + RUN_UP_STEPS;

#[cortex_m_rt::entry]
fn main() -> ! {
    // The variants need much stack (several controllers at once), so the stack starts at the end of the RAM.
    // SAFETY: nothing of this function is used after the jump, and no data is stored in this part of RAM (memory.x).
    unsafe { core::arch::asm!("mov sp, {top}", "b {run}", top = in(reg) 0x2002_0000, run = sym run, options(noreturn)) }
}

extern "C" fn run() -> ! {
    set_name("empty");
    bench_begin();
    bench_end();
    for description in [
        devices::PADDLE,
        devices::FIVE_BAR,
        devices::FIVE_BAR_TURRET,
        devices::PARALLELOGRAM,
        devices::SERIAL_3R,
        devices::DELTA,
        devices::PADDLES_2,
        devices::PADDLES_3,
        devices::CHAIN_1,
        devices::CHAIN_2,
        devices::CHAIN_3,
    ] {
        let Ok(device) = Device::<f32>::new("bench", &description) else { panic!() };
        count_with_every_math(&device, &description);
    }
    bench_done();
    loop {
        core::hint::spin_loop();
    }
}

#[inline(never)]
fn count_with_every_math(device: &Device<f32>, description: &Description) {
    with_mechanism!(&device.mechanism, mechanism => {
        count_variants::<_, Tabulated, _>(mechanism, device, description);
        count_variants::<_, Minimax, _>(mechanism, device, description);
        count_variants::<_, Micromath, _>(mechanism, device, description);
    });
}

#[inline(never)]
fn count_variants<M: Mechanism<f32, N>, K: Math<f32>, const N: usize>(
    mechanism: &M,
    device: &Device<f32>,
    description: &Description,
) {
    let home = description.home.unwrap_or_default();
    let pose = mechanism.pose::<K>(&SVector::from_fn(|i, _| home[i] as f32));
    let tip = mechanism.tip(&pose);
    for (term, walls, feed_forward, velocity_terms) in TERMS {
        // Scenes other than one plane are counted with the board's trigonometry.
        if *walls != Walls::OnePlane && K::NAME != Tabulated::NAME {
            continue;
        }
        let scene = scene::<M, N>(&tip, *walls, *feed_forward, *velocity_terms);
        count::<M, K, N>(mechanism, device, &scene, &home, &["exact/", term], RUN_UP_STEPS);
    }
    // Velocity estimators are counted with the board's own trigonometry and the longest windows.
    if K::NAME == Tabulated::NAME {
        for (estimator, usual) in Estimator::ALL {
            let longest = |chosen| match usual.spec().and_then(|spec| spec.key).filter(|key| key.unit == "samples") {
                Some(key) => Chosen { value: key.range.1, ..chosen },
                None => chosen,
            };
            let mut scene = scene::<M, N>(&tip, Walls::OnePlane, FeedForward::Full, VelocityTerms::Off);
            scene.estimator = usual.chosen().map_or(*usual, |chosen| usual.with_options(longest(chosen)));
            let name = ["exact/feed-forward, ", estimator];
            count::<M, K, N>(mechanism, device, &scene, &home, &name, LONG_RUN_UP_STEPS);
        }
    }
}

/// Counts the step of a scene at every pose. The variant's name is mechanism, trigonometry and `rest`.
#[inline(never)]
fn count<M: Mechanism<f32, N>, K: Math<f32>, const N: usize>(
    mechanism: &M,
    device: &Device<f32>,
    scene: &Scene<f32>,
    home: &[f64; MAX_JOINTS],
    rest: &[&str],
    run_up: i32,
) {
    let Ok(mut controller) = Controller::<f32, M, K, N>::new(*mechanism, device, scene) else { panic!() };
    let mut text = String::<96>::new();
    for part in [M::SPEC.label, "/", K::NAME, "/"].iter().chain(rest) {
        let _ = text.push_str(part);
    }
    set_name(&text);
    for offset in POSES {
        step_at::<M, K, N>(&mut controller, device, home, &offset, run_up);
    }
}

#[inline(never)]
fn step_at<M: Mechanism<f32, N>, K: Math<f32>, const N: usize>(
    controller: &mut Controller<f32, M, K, N>,
    device: &Device<f32>,
    home: &[f64; MAX_JOINTS],
    offset: &[f32; MAX_JOINTS],
    run_up: i32,
) {
    let mut counts: [i32; N] =
        core::array::from_fn(|i| ((home[i] as f32 + offset[i]) / device.joints[i].radians_per_count) as i32);
    let controller = black_box(controller);
    controller.forget();
    let mut result = StepResult::default();
    for step in 0..=run_up {
        for (i, count) in counts.iter_mut().enumerate() {
            *count += 1 + i as i32;
        }
        let counts = black_box(&counts);
        let counted = step == run_up;
        if counted {
            bench_begin();
        }
        control_step::<M, K, N>(controller, counts, black_box(&mut result));
        if counted {
            bench_end();
        }
    }
}

/// Runs the control step like the interrupt. The results are left where the control loop and telemetry read them.
#[inline(never)]
fn control_step<M: Mechanism<f32, N>, K: Math<f32>, const N: usize>(
    controller: &mut Controller<f32, M, K, N>,
    counts: &[i32; N],
    found: &mut StepResult<f32>,
) {
    controller.render(counts, &[0.0; MAX_JOINTS], found);
}

/// Returns a scene in which every pose is inside the walls.
fn scene<M: Mechanism<f32, N>, const N: usize>(
    tip: &SVector<f32, N>,
    walls: Walls,
    feed_forward: FeedForward,
    velocity_terms: VelocityTerms,
) -> Scene<f32> {
    let task = M::SPEC.task;
    let directions = match task {
        1 => [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]],
        2 => [[0.6, 0.8, 0.0], [0.8, -0.6, 0.0]],
        _ => [[0.36, 0.48, 0.8], [0.8, -0.6, 0.0]],
    };
    let at =
        |direction: &[f32; 3]| core::array::from_fn(|i| if i < task { tip[i.min(N - 1)] + direction[i] } else { 0.0 });
    let plane = |direction: &[f32; 3]| Surface::Plane(Plane { point: at(direction), normal: *direction });
    let surfaces = match walls {
        Walls::None | Walls::Spring => [None, None],
        Walls::OnePlane | Walls::PlaneAndSpring => [Some(plane(&directions[0])), None],
        Walls::TwoPlanes => [Some(plane(&directions[0])), Some(plane(&directions[1]))],
        Walls::Ball => {
            let ball = Sphere { center: at(&directions[0]), radius: 2.0, inside: false };
            [Some(Surface::Sphere(ball)), None]
        }
    };
    let mut scene = Scene { task: task as u8, velocity_terms, ..Scene::default() };
    // The stiffness differs, because equal walls need no shaping.
    for (surface, stiffness) in surfaces.into_iter().flatten().zip([1000.0, 500.0]) {
        let _ = scene.walls.push(Wall {
            surface,
            stiffness,
            damping: 2.0,
            feed_forward,
            washout_hz: 2.0,
            damping_compensation: false,
            bilateral: false,
        });
    }
    if matches!(walls, Walls::Spring | Walls::PlaneAndSpring) {
        let spring = Spring { point: at(&[0.01, 0.0, 0.0]), direction: [0.0; 3], stiffness: 200.0, damping: 1.0 };
        let _ = scene.springs.push(spring);
    }
    scene
}

fn set_name(text: &str) {
    // SAFETY: there is only one thread. The write is volatile because the emulator reads it.
    unsafe { write_volatile(addr_of_mut!(BENCH_NAME), [text.as_ptr() as u32, text.len() as u32]) };
}
