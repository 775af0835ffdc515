//! What the linear theory leaves out, one by one and together: encoder steps, the drive's electrics, friction,
//! saturation, a hand.
//!
//! None of these rows is a test of the theory: each says what the measured boundary does when the world is less simple.

use super::{Case, FULL, Mode, drawn_as, measured_area, measured_in, predicted};
use haptic::measure::progress::Progress;
use haptic::sim::{BoardOptions, TIMER_HZ};
use haptic_bridge::drive::carrier::Carrier;
use std::fmt::Write as _;
use std::path::Path;

/// Where it is measured: the paper's cutoff at 1 kHz.
const CASE: Case = Case { name: "range-1khz-world", rate_hz: 1000.0, cutoff_hz: 20.0 };
const REPEATS: usize = 3;

/// What acts beside the device's inertia.
#[derive(Clone, Copy, Debug)]
pub struct World {
    /// What it is called in the table.
    name: &'static str,
    /// Encoders of the device file (20000 counts), not of 2²³ counts.
    pub encoders: bool,
    /// Bridges, windings, current loops and the supply's limit, not torque at once.
    pub electric: bool,
    /// Viscous friction of the device file.
    pub viscous: bool,
    /// Coulomb friction of the device file.
    pub coulomb: bool,
    /// A relaxed grip at rest, 0.12 kg behind 1200 N/m.
    pub hand: bool,
    /// Torque limit of the motors, N m.
    pub torque_limit: f64,
    /// Largest pull into the wall before it is let go, m: friction holds a small one.
    pub pull: f64,
}

/// What the theory is about.
pub const NOTHING: World = World {
    name: "nothing",
    encoders: false,
    electric: false,
    viscous: false,
    coulomb: false,
    hand: false,
    torque_limit: 2.0,
    pull: 3e-4,
};

const ALL_BUT_COULOMB: World = World {
    name: "encoder steps, the drive, viscous friction and a hand",
    encoders: true,
    electric: true,
    viscous: true,
    hand: true,
    ..NOTHING
};

const WORLDS: [World; 8] = [
    NOTHING,
    World { name: "encoder steps", encoders: true, ..NOTHING },
    World { name: "the drive", electric: true, ..NOTHING },
    World { name: "saturation at 0.02 N m", torque_limit: 0.02, ..NOTHING },
    World { name: "viscous friction", viscous: true, ..NOTHING },
    World { name: "Coulomb friction, pulled by 2 mm", coulomb: true, pull: 2e-3, ..NOTHING },
    World { name: "a hand", hand: true, ..NOTHING },
    ALL_BUT_COULOMB,
];

/// What the table shows.
const WHY: &str = "
Encoder steps hide the smallest swings, so the onset is seen a little later, and not always at the same place. The
drive (2 ohm and 1 mH, 24 V, 120 ns of dead time) makes a current within a carrier period, a twentieth of a sample:
`haptic range --drive current` predicts 0.985. A torque limit bounds how far the swings grow and not when they begin.
Viscous friction adds its damping to the wall's. Coulomb friction holds every swing that is small enough: what is
measured is the stiffness from which a pull of 2 mm no longer comes to rest, which depends on the pull and does not
repeat. A hand damps most of all. It loads the other directions as well, so what the feed-forward removes is a smaller
part of what acts there, and what it buys shrinks from 57 to 18 %, with all of it together to 7 %.
";

/// The table, its figure written to `folder`.
pub fn section(folder: &Path) -> Result<String, Box<dyn std::error::Error>> {
    let divider = f64::from(Carrier::for_rate(TIMER_HZ, CASE.rate_hz as f32).divider);
    let theory = predicted(&CASE, BoardOptions::default().delay / divider, None)?;
    let ran = std::thread::scope(|scope| {
        let threads: Vec<_> = WORLDS
            .iter()
            .map(|world| scope.spawn(|| measured_in(&CASE, &FULL, 2.0, REPEATS, world).map_err(|e| e.to_string())))
            .collect();
        threads.into_iter().map(|thread| thread.join()).collect::<Vec<_>>()
    });
    let mut text = String::from(
        "\n### What the theory leaves out\n\n\
         The same device, pose and normal at 1000 Hz and a cutoff of 20 Hz, with one thing added at a time. Areas of the measured \
         boundaries over the theory's, 12 dampings, medians of 3 repeats; the spread is the widest bar of a damping over its \
         median. None of this tests the theory: it says what else there is.\n\n\
         | added | area off | area full | full over off | widest spread |\n|---|---:|---:|---:|---:|\n",
    );
    for (world, result) in WORLDS.iter().zip(ran) {
        let name = world.name;
        let outcome = match result.map_err(|_| format!("{name}: the measurement panicked"))? {
            Ok(outcome) => outcome,
            Err(why) => {
                let why = why.split(';').next().unwrap_or_default();
                let _ = writeln!(text, "| {name} | no boundary: {why} | | | |");
                continue;
            }
        };
        let progress = &outcome.progress;
        let (off, full) = (measured_area(progress, Mode::Off), measured_area(progress, Mode::Full));
        let _ = writeln!(
            text,
            "| {name} | {:.3} | {:.3} | {:.3} | {:.0} % |",
            off / theory.off.area,
            full / theory.full.area,
            full / off,
            100.0 * spread(progress)
        );
        if name == ALL_BUT_COULOMB.name {
            let picture = drawn_as(&CASE, &outcome, &format!("simulated board; {name}"));
            picture.save_svg(&folder.join(format!("{}.svg", CASE.name)))?;
            picture.save_png(&folder.join(format!("{}.png", CASE.name)))?;
        }
    }
    text.push_str(WHY);
    let _ = write!(text, "\n![with what the theory leaves out](results/{}.svg)\n", CASE.name);
    Ok(text)
}

/// The widest bar of a damping over its median.
fn spread(progress: &Progress) -> f64 {
    let wide = |mode| {
        progress
            .of(mode)
            .iter()
            .map(|point| {
                let (low, high) = point.bounds();
                if point.median() > 0.0 { (high - low) / point.median() } else { 0.0 }
            })
            .fold(0.0, f64::max)
    };
    FULL.into_iter().map(wide).fold(0.0, f64::max)
}
