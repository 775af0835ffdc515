//! Writes a device file for the device that a board runs.
//!
//! A board has the coefficients of a device's equations of motion, and many sets of links have the same coefficients.
//! The search finds links whose coefficients round to the board's to the bit and that differ little from known links:
//! those of a given file, or of the mechanism's template. The device of the file moves, weighs and pushes like the
//! board's; its links are not those of the real device.

use crate::template;
use haptic_bridge::model::catalogue::{MAX_GEOMETRY, MAX_JOINTS, MAX_LINKS};
use haptic_bridge::model::description::{Description, Link};
use haptic_bridge::model::device::Device;
use haptic_bridge::model::mechanism::AnyMechanism;
use haptic_host::device_file::DeviceFile;
use haptic_host::read_back::{self, coefficients, rounds_to};
use nalgebra::{DMatrix, DVector};

/// Returns the text of a device file that loads onto a board as exactly this device. The search starts from a
/// description of the same mechanism or from its template. `None` if no file is found, for example for a device that no
/// file described.
pub fn device_file(device: &Device<f32>, similar: Option<&Description>) -> Option<String> {
    let kind = device.mechanism.kind();
    let template = DeviceFile::parse(&template::device_file(kind, "template"), "template").ok()?.description;
    let similar = similar.filter(|similar| similar.kind == kind).copied();
    let starts = similar.into_iter().chain([1.0, 0.1, 10.0, 0.01, 100.0].map(|factor| scaled(&template, factor)));
    let about = [
        "Read back from a board. It keeps the coefficients of the equations of motion, not the links they came from:",
        "masses, centres of mass, inertias and what they share with [handle] and the joints' inertia are one choice of",
        "many that give exactly these equations. Transmissions, friction at rest, cogging and modes are not kept, and",
        "an offset only to half a count.",
    ];
    let about = about.map(String::from);
    starts.flat_map(|start| Search::find_near(device, start)).find_map(|description| {
        let text = read_back::to_toml(&about, &read_back::device(&device.name, &description));
        let read = DeviceFile::parse(&text, "read back").ok()?.device::<f32>().ok()?;
        (read == *device).then_some(text)
    })
}

/// Returns the device with its mass scaled by `factor`.
fn scaled(description: &Description, factor: f64) -> Description {
    let mut scaled = *description;
    for link in &mut scaled.links {
        let Link { mass, inertia, inertia_axial, inertia_transverse, .. } = link;
        [mass, inertia, inertia_axial, inertia_transverse].into_iter().for_each(|value| *value *= factor);
    }
    scaled.joints.iter_mut().for_each(|joint| joint.inertia *= factor);
    scaled.handle_mass *= factor;
    scaled
}

/// First index of each group among the unknowns: gravity, geometry, five values per link, the joints' inertia, the
/// handle.
const GEOMETRY: usize = 3;
const LINKS: usize = GEOMETRY + MAX_GEOMETRY;
const JOINTS: usize = LINKS + 5 * MAX_LINKS;
const HANDLE: usize = JOINTS + MAX_JOINTS;
const UNKNOWNS: usize = HANDLE + 1;

type Unknowns = [f64; UNKNOWNS];

fn unknowns(of: &Description) -> Unknowns {
    let links = of.links.iter().flat_map(|l| [l.mass, l.com, l.inertia, l.inertia_axial, l.inertia_transverse]);
    let mut all = of.gravity.into_iter().chain(of.geometry).chain(links).chain(of.joints.iter().map(|j| j.inertia));
    core::array::from_fn(|_| all.next().unwrap_or(of.handle_mass))
}

fn description_with(of: &Description, x: &Unknowns) -> Description {
    let mut result = *of;
    result.gravity.copy_from_slice(&x[..GEOMETRY]);
    result.geometry.copy_from_slice(&x[GEOMETRY..LINKS]);
    for (link, x) in result.links.iter_mut().zip(x[LINKS..JOINTS].as_chunks::<5>().0) {
        let [mass, com, inertia, inertia_axial, inertia_transverse] = *x;
        *link = Link { mass, com, inertia, inertia_axial, inertia_transverse };
    }
    result.joints.iter_mut().zip(&x[JOINTS..HANDLE]).for_each(|(joint, x)| joint.inertia = *x);
    result.handle_mass = x[HANDLE];
    result
}

/// Returns the size below which a change of an unknown is small at any value.
fn size(unknown: usize) -> f64 {
    match unknown {
        ..GEOMETRY => 1.0,
        GEOMETRY..LINKS => 1e-2,
        JOINTS..HANDLE => 1e-6,
        HANDLE => 1e-3,
        link => [1e-3, 1e-3, 1e-6, 1e-6, 1e-6][(link - LINKS) % 5],
    }
}

fn can_be_negative(unknown: usize) -> bool {
    unknown < GEOMETRY || ((LINKS..JOINTS).contains(&unknown) && (unknown - LINKS) % 5 == 1)
}

/// A search for unknowns whose coefficients round to a board's.
struct Search {
    start: Description,
    /// Each coefficient of the board, and the interval of values that round to it.
    targets: Vec<(f32, (f64, f64))>,
}

impl Search {
    /// Finds a description near `start`, with the home pose, friction, encoders and motors of the device.
    fn find_near(device: &Device<f32>, mut start: Description) -> Option<Description> {
        let targets: Vec<_> = coefficients(&device.mechanism)
            .into_iter()
            .map(|(_, value)| (value as f32, rounds_to(value as f32)))
            .collect();
        if !targets.iter().all(|(_, (low, high))| low.is_finite() && high.is_finite()) {
            return None;
        }
        let inertia = start.joints.map(|joint| joint.inertia);
        start.joints = read_back::joints(device);
        start.joints.iter_mut().zip(inertia).for_each(|(joint, inertia)| joint.inertia = inertia);
        start.home = read_back::home(device);
        let search = Self { start, targets };
        let assembly = start.kind.spec().geometry.iter().position(|(key, _)| *key == "assembly");
        // The assembly sign cannot be approached in steps, so both signs are tried.
        let place =
            assembly.map(|at| GEOMETRY + start.kind.spec().geometry[..at].iter().map(|(_, n)| n).sum::<usize>());
        let signs: &[f64] = if place.is_some() { &[1.0, -1.0] } else { &[1.0] };
        signs.iter().find_map(|sign| {
            let mut x = unknowns(&start);
            if let Some(place) = place {
                x[place] = *sign;
            }
            search.find(x, place)
        })
    }

    fn find(&self, x: Unknowns, assembly: Option<usize>) -> Option<Description> {
        let spec = self.start.kind.spec();
        let lengths = spec.geometry.iter().map(|(_, count)| count).sum::<usize>();
        let geometry: Vec<usize> = (GEOMETRY..GEOMETRY + lengths).filter(|at| Some(*at) != assembly).collect();
        let rest: Vec<usize> = (0..spec.task)
            .chain(LINKS..LINKS + 5 * spec.links.len())
            .chain(JOINTS..JOINTS + spec.joints)
            .chain([HANDLE])
            .collect();
        // Coefficients that depend on lengths alone are solved first.
        let slopes = self.slopes(&x, &rest)?;
        let of_lengths: Vec<usize> = (0..self.targets.len()).filter(|row| slopes.row(*row).amax() == 0.0).collect();
        let slopes = self.slopes(&x, &geometry)?.select_rows(&of_lengths);
        // A length that no such coefficient contains stays: the board knows only the weight of a crank.
        let kept: Vec<usize> = (0..geometry.len()).filter(|column| slopes.column(*column).amax() > 0.0).collect();
        let geometry: Vec<usize> = kept.into_iter().map(|column| geometry[column]).collect();
        let x = self.solve(x, &geometry, &of_lengths)?;
        let x = self.round_lengths(x, &geometry, &of_lengths)?;
        let all: Vec<usize> = (0..self.targets.len()).collect();
        let x = self.choose_gravity(x, spec.task);
        let free: Vec<usize> = rest.into_iter().filter(|at| *at >= GEOMETRY || x[*at] != 0.0).collect();
        let x = self.solve(x, &free, &all)?;
        Some(description_with(&self.start, &x))
    }

    fn at(&self, x: &Unknowns) -> Option<Vec<f64>> {
        let result = coefficients(&AnyMechanism::<f64>::new(&description_with(&self.start, x)).ok()?);
        let values: Vec<f64> = result.into_iter().map(|(_, value)| value).collect();
        values.iter().all(|value| value.is_finite()).then_some(values)
    }

    /// Computes the derivatives of the coefficients with respect to the unknowns in `free`.
    fn slopes(&self, x: &Unknowns, free: &[usize]) -> Option<DMatrix<f64>> {
        let mut slopes = DMatrix::zeros(self.targets.len(), free.len());
        for (column, at) in free.iter().enumerate() {
            let step = 1e-4 * size(*at).max(x[*at].abs());
            let (mut up, mut down) = (*x, *x);
            up[*at] += step;
            down[*at] -= step;
            // A mechanism that cannot carry weight has no other gravity.
            let (Some(up), Some(down)) = (self.at(&up), self.at(&down)) else { continue };
            for row in 0..self.targets.len() {
                slopes[(row, column)] = (up[row] - down[row]) / (2.0 * step);
            }
        }
        Some(slopes)
    }

    /// Returns true if a coefficient in `rows` does not round to the board's value.
    fn differs(&self, values: &[f64], rows: &[usize]) -> bool {
        rows.iter().any(|row| values[*row] as f32 != self.targets[*row].0)
    }

    /// Changes the `free` unknowns of `x` as little as possible until the coefficients in `rows` round to the board's
    /// values.
    fn solve(&self, mut x: Unknowns, free: &[usize], rows: &[usize]) -> Option<Unknowns> {
        for _ in 0..300 {
            let values = self.at(&x)?;
            if !self.differs(&values, rows) {
                return Some(x);
            }
            let (step, part) = self.step(&x, &values, free, rows)?;
            let mut share = part;
            // A step may open the linkage, or leave a joint without inertia.
            let next = (0..20).find_map(|_| {
                let mut next = x;
                for (at, step) in free.iter().zip(step.iter()) {
                    next[*at] += share * step;
                    if !can_be_negative(*at) {
                        next[*at] = next[*at].max(0.0);
                    }
                }
                share *= 0.5;
                self.at(&next).map(|_| next)
            })?;
            x = next;
        }
        None
    }

    /// Computes a Gauss-Newton step and the share of it to take.
    fn step(&self, x: &Unknowns, values: &[f64], free: &[usize], rows: &[usize]) -> Option<(DVector<f64>, f64)> {
        let slopes = self.slopes(x, free)?;
        let scale = |at: usize| size(at).max(x[at].abs());
        // Weigh each coefficient by its own rounding interval.
        let weight = |row: usize| {
            let (low, high) = self.targets[row].1;
            1.0 / (high - low).max(1e-14 * slopes.row(row).amax()).max(1e-40)
        };
        let miss = DVector::from_iterator(
            rows.len(),
            rows.iter().map(|row| {
                let (low, high) = self.targets[*row].1;
                let inside = 0.05 * (high - low);
                (values[*row].clamp(low + inside, high - inside) - values[*row]) * weight(*row)
            }),
        );
        let mut held = vec![false; free.len()];
        loop {
            let matrix = DMatrix::from_fn(rows.len(), free.len(), |row, column| {
                if held[column] { 0.0 } else { slopes[(rows[row], column)] * weight(rows[row]) * scale(free[column]) }
            });
            let svd = matrix.svd(true, true);
            let least = 1e-11 * svd.singular_values.amax();
            let scaled = svd.solve(&miss, least).ok()?;
            // An unknown at zero that would become negative is held.
            let stuck = |column: usize| {
                !held[column] && !can_be_negative(free[column]) && x[free[column]] <= 0.0 && scaled[column] < 0.0
            };
            let new: Vec<usize> = (0..free.len()).filter(|column| stuck(*column)).collect();
            if new.is_empty() {
                let part = (0.7 / scaled.amax().max(1e-300)).min(1.0);
                let step = DVector::from_fn(free.len(), |column, _| scaled[column] * scale(free[column]));
                return Some((step, part));
            }
            new.into_iter().for_each(|column| held[column] = true);
        }
    }

    /// Rounds the lengths to the fewest decimals that keep the board's values: most lengths are round, and equal ones
    /// become equal.
    fn round_lengths(&self, x: Unknowns, geometry: &[usize], rows: &[usize]) -> Option<Unknowns> {
        (2..=15).find_map(|decimals| {
            let grid = 10f64.powi(decimals);
            let mut short = x;
            geometry.iter().for_each(|at| short[*at] = (x[*at] * grid).round() / grid);
            let values = self.at(&short)?;
            (!self.differs(&values, rows)).then_some(short)
        })
    }

    /// Adds gravity if the mechanism carries weight, except for components that the board lacks: a component that is
    /// zero there is exactly zero.
    fn choose_gravity(&self, mut x: Unknowns, task: usize) -> Unknowns {
        for at in 0..task {
            let (mut some, mut none) = (x, x);
            some[at] = if x[at] == 0.0 { -9.81 } else { x[at] };
            none[at] = 0.0;
            let (Some(with), Some(without)) = (self.at(&some), self.at(&none)) else { continue };
            let mut touched = (0..with.len()).filter(|row| with[*row] != without[*row]);
            x = if touched.all(|row| self.targets[row].0 == 0.0) { none } else { some };
        }
        x
    }
}
