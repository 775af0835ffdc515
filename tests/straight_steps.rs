//! Straight steps against the general one: the same numbers, bit for bit, whatever the device, the scene and the motion.

mod common;

use common::{Draw, NUMBERS, device};
use haptic_bridge::math::{Libm, Math, Minimax, Real};
use haptic_bridge::model::catalogue::Kind;
use haptic_bridge::model::description::Encoder;
use haptic_bridge::model::device::Device;
use haptic_bridge::model::mechanism::Mechanism;
use haptic_bridge::render::controller::{Controller, Gains, Push, Step};
use haptic_bridge::render::scene::{FeedForward, Plane, Scene, Surface, VelocityTerms, Wall};
use haptic_bridge::render::velocity::{Estimator, Washout};
use haptic_bridge::with_mechanism;

const CASES: usize = 60;
const STEPS: usize = 100;
const COUNTS_PER_TURN: f64 = 20_000.0;
const RATE: f64 = 20_000.0;

/// Numbers in [0, 1), the same at every run (Knuth's 64-bit linear congruence, the upper half).
struct Stream(u64);

impl Stream {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 32) as f64 / f64::from(u32::MAX)
    }

    fn list(&mut self) -> Vec<f64> {
        (0..NUMBERS).map(|_| self.next().min(0.999_999)).collect()
    }
}

/// How often something happened that a straight step does by a way of its own.
#[derive(Default, Debug)]
struct Seen {
    free: usize,
    touched: usize,
    faded: usize,
    off: usize,
    damped: usize,
    owed: usize,
}

/// One plane near `place`, with everything drawn that its straight step knows.
fn scene<T: Real>(draw: &mut Draw<'_>, place: &[f64], task: usize) -> Scene<T> {
    let direction: [f64; 3] = draw.list(-1.0, 1.0);
    let direction: [f64; 3] = core::array::from_fn(|i| if i < task { direction[i] } else { 0.0 });
    let length = direction.iter().map(|x| x * x).sum::<f64>().sqrt().max(1.0e-3);
    let normal = direction.map(|x| x / length);
    let depth = draw.within(-0.01, 0.02);
    let point = core::array::from_fn(|i| if i < task { place[i] + depth * normal[i] } else { 0.0 });
    let mut of = |several: usize| (draw.within(0.0, several as f64) as usize).min(several - 1);
    let feed_forward = [FeedForward::Off, FeedForward::Full, FeedForward::Washout][of(3)];
    let velocity_terms = [VelocityTerms::Off, VelocityTerms::Paper, VelocityTerms::Rendered][of(3)];
    let estimator = [Estimator::Butterworth, Estimator::FirstOrder, Estimator::BackwardDifference][of(3)];
    let (bilateral, gravity_compensation) = (of(4) == 0, of(2) == 0);
    let mut scene = Scene::<f64> {
        task: task as u8,
        rate_hz: RATE,
        velocity_terms,
        estimator,
        gravity_compensation,
        ..Scene::default()
    };
    let wall = Wall {
        surface: Surface::Plane(Plane { point, normal }),
        stiffness: draw.order(10.0, 5000.0),
        damping: draw.within(0.0, 5.0),
        feed_forward,
        washout_hz: draw.order(0.2, 50.0),
        damping_compensation: false,
        bilateral,
    };
    scene.walls.push(wall).expect("room for a wall");
    scene.cast()
}

fn wander<T: Real, M: Mechanism<T, N>, K: Math<T>, const N: usize>(
    mechanism: &M,
    device: &Device<T>,
    stream: &mut Stream,
    seen: &mut Seen,
) {
    let numbers = stream.list();
    let mut draw = Draw::new(&numbers);
    let mut counts: [f64; N] = draw.list(-0.5 * COUNTS_PER_TURN, 0.5 * COUNTS_PER_TURN);
    let q = nalgebra::SVector::from_fn(|i, _| T::from_f64(counts[i] / COUNTS_PER_TURN * core::f64::consts::TAU));
    let tip = mechanism.tip(&mechanism.pose::<K>(&q));
    let place: Vec<f64> = tip.iter().map(|x| x.to_f64()).collect();
    let scene = scene::<T>(&mut draw, &place, M::SPEC.task);
    let mut straight = Controller::<T, M, K, N>::new(*mechanism, device, &scene).expect("a scene");
    let passivity = draw.within(0.0, 1.0) < 0.5;
    straight.set_passivity(passivity);
    let mut general = straight.clone();
    let pace = draw.order(0.1, 60.0);
    let mut going: [f64; N] = draw.list(-1.0, 1.0);
    for nth in 0..STEPS {
        if nth == STEPS / 2 {
            let wall = scene.walls[0];
            let (feed_forward, washout_hz) = (FeedForward::Washout, wall.washout_hz);
            let half = T::from_f64(0.5);
            let gains =
                Gains { wall: 0, stiffness: wall.stiffness * half, damping: wall.damping, feed_forward, washout_hz };
            let washout = Washout::new(washout_hz, scene.rate_hz).expect("a corner");
            straight.set_gains(&gains, &washout);
            general.set_gains(&gains, &washout);
        }
        if nth % (STEPS / 4) == 0 {
            // The host pushes for a quarter of the way, off and on.
            let push = Push { force: [T::from_f64(0.3); 3], ..Push::default() };
            let push = (nth / (STEPS / 4) % 2 == 1).then_some(&push);
            straight.set_push(push);
            general.set_push(push);
        }
        for (count, going) in counts.iter_mut().zip(&mut going) {
            *going = 0.95 * *going + 0.1 * (stream.next() - 0.5);
            *count += pace * *going;
        }
        let at = counts.map(|count| count as i32);
        let (fast, slow): (Step<T, N>, Step<T, N>) = (straight.step(&at), general.step_generally(&at));
        assert_eq!(fast, slow, "{} at {at:?} of {scene:?}", M::SPEC.name);
        let Some(wall) = scene.walls.first() else { continue };
        seen.free += usize::from(slow.contacts == 0);
        seen.touched += usize::from(slow.contacts > 0);
        seen.faded += usize::from(slow.shaping > T::zero() && slow.shaping < T::one());
        seen.off += usize::from(slow.shaping == T::zero());
        seen.damped += usize::from(slow.passivity_damping > T::zero());
        seen.owed += usize::from(slow.energy < T::zero() && !wall.bilateral);
    }
    assert_eq!(format!("{straight:?}"), format!("{general:?}"), "{}: what is remembered", M::SPEC.name);
}

#[test]
fn a_straight_step_is_the_general_one_to_the_bit() {
    let mut stream = Stream(7);
    for (kind, fade_reached) in [
        (Kind::Paddle, false),
        (Kind::FiveBar, true),
        (Kind::FiveBarTurret, true),
        (Kind::Parallelogram, true),
        (Kind::Serial3r, true),
    ] {
        let mut seen = Seen::default();
        for _ in 0..CASES {
            let numbers = stream.list();
            let mut description = device(kind, &mut Draw::new(&numbers));
            for joint in &mut description.joints {
                joint.encoder = Some(Encoder { counts_per_turn: COUNTS_PER_TURN, offset: 0.0, inverted: false });
            }
            let Ok(single) = Device::<f32>::new("drawn", &description) else { continue };
            let Ok(double) = Device::<f64>::new("drawn", &description) else { continue };
            with_mechanism!(&single.mechanism, m => wander::<f32, _, Minimax, _>(m, &single, &mut stream, &mut seen));
            with_mechanism!(&double.mechanism, m => wander::<f64, _, Libm, _>(m, &double, &mut stream, &mut seen));
        }
        let ways = [seen.free, seen.touched, seen.damped, seen.owed];
        assert!(ways.iter().all(|times| *times > 20), "{kind:?}: {seen:?}");
        assert!(!fade_reached || (seen.faded > 10 && seen.off > 10), "{kind:?}: {seen:?}");
    }
}
