//! The state at one moment as a page draws it: positions and numbers.
//!
//! A device in space is drawn in the plane of its first two task coordinates, which is the plane of a linkage on a turret
//! at joint 0 = 0. Positions of a paddle or a slide are drawn on their tracks.

use super::scope::Ring;
use crate::track::Track;
use haptic_bridge::board::telemetry::{Field, Fields};
use haptic_bridge::math::Libm;
use haptic_bridge::model::description::Description;
use haptic_bridge::model::device::Device;
use haptic_bridge::render::scene::{Scene, Spring};
use haptic_host::link::Column;
use haptic_host::vectors::padded;
use haptic_stability::analysis::plant::Linearised;
use haptic_stability::analysis::pose::TaskPose;
use haptic_stability::skeleton::skeleton;
use nalgebra::{DVector, Vector3};
use serde::Serialize;

/// Fields that are streamed for the page and recorded; they include the fields that `haptic replay` needs.
pub const FIELDS: Fields = Fields(
    Field::Angle.bit()
        | Field::Tip.bit()
        | Field::Torque.bit()
        | Field::Distance.bit()
        | Field::NormalVelocity.bit()
        | Field::WallForce.bit()
        | Field::RenderedForce.bit()
        | Field::Saturated.bit()
        | Field::Energy.bit()
        | Field::Counts.bit()
        | Field::State.bit()
        | Field::Sensed.bit(),
);

/// Time over which ripple, saturation and power are computed, s.
const RECENT_TIME: f64 = 0.1;
/// Time over which the frequency of an oscillation is computed, s: three periods of 10 Hz.
const OSCILLATION_TIME: f64 = 0.3;

/// A point or a vector of the drawn plane.
type Flat = [f64; 2];

/// The ellipse of effective inertia, from Λ; each half axis is the inertia that a push along the axis meets.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Ellipse {
    /// Largest and smallest effective inertia, kg.
    pub axes: Flat,
    /// Direction of the largest effective inertia, rad from +x.
    pub angle: f64,
}

/// Geometry of a moment.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Geometry {
    /// Tip, m.
    pub tip: Flat,
    /// Links, from end to end, m.
    pub bars: Vec<[Flat; 2]>,
    /// Rails of prismatic joints, from end to end, m.
    pub rails: Vec<[Flat; 2]>,
    /// Pivots on the base, m.
    pub base: Vec<Flat>,
    /// Effective inertia.
    pub ellipse: Option<Ellipse>,
    /// Force of the motors at the tip, N.
    pub force: Flat,
    /// Tips of further paddles, m, with the forces of the motors there, N.
    pub more: Vec<[Flat; 2]>,
    /// Anchor of each spring of the scene: its point, or the nearest point of its line, m.
    pub springs: Vec<Flat>,
}

/// Numbers of a moment.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Numbers {
    /// Force rendered along the nearest wall's normal, N.
    pub force: f64,
    /// Depth in the nearest wall, m; negative outside.
    pub depth: f64,
    /// Motor force across the nearest wall's normal, N, which pushes a hand along the wall.
    pub sideways: f64,
    /// Deviation of the force from its mean over the last tenth of a second, N rms.
    pub ripple: f64,
    /// Frequency at which the force oscillates about its mean, Hz; `None` without oscillation.
    pub frequency: Option<f64>,
    /// Power that the nearest wall gave out over the last tenth of a second, in addition to the energy stored in its
    /// spring, W. An ideal spring and damper give out none: the power comes from delay.
    pub power: f64,
    /// Share of the last tenth of a second in which a motor was at its limit.
    pub saturated: f64,
    /// Weff and Wrr along the nearest wall's normal, kg; `None` at a singular pose.
    pub inertia: Option<Flat>,
    /// Index of the nearest wall, from 0.
    pub wall: Option<usize>,
    /// Angles of the encoders without motors, rad.
    pub sensed: Vec<f64>,
}

/// Returns the wall that the tip is deepest in or nearest to, and its normal.
pub fn nearest_wall(scene: &Scene<f64>, tip: &[f64]) -> Option<(usize, Vector3<f64>)> {
    let tip = Vector3::from(padded(tip));
    let contacts = scene.walls.iter().enumerate().map(|(index, wall)| (index, wall.surface.contact::<Libm, 3>(&tip)));
    contacts.min_by(|a, b| a.1.distance.total_cmp(&b.1.distance)).map(|(index, contact)| (index, contact.normal))
}

/// The newest row of a stream, by field.
pub struct Newest<'a> {
    ring: &'a Ring,
    columns: &'a [Column],
}

impl<'a> Newest<'a> {
    /// Creates a view of a ring with these columns.
    pub fn of(ring: &'a Ring, columns: &'a [Column]) -> Self {
        Self { ring, columns }
    }

    /// Returns the number in a field's column; 0 before the first row.
    pub fn get(&self, field: Field, axis: usize) -> f64 {
        let column = self.columns.iter().position(|column| column.field == field && column.axis == axis);
        let value = column.and_then(|column| self.ring.value(self.ring.end().checked_sub(1)?, column));
        value.filter(|value| value.is_finite()).map_or(0.0, f64::from)
    }

    fn vector(&self, field: Field, count: usize) -> Vec<f64> {
        (0..count).map(|axis| self.get(field, axis)).collect()
    }

    fn recent_values(&self, field: Field, axis: usize, rows: u64) -> impl Iterator<Item = f64> {
        let column = self.columns.iter().position(|column| column.field == field && column.axis == axis);
        column.into_iter().flat_map(move |column| self.ring.last_values(column, rows)).map(f64::from)
    }

    /// Returns the joint angles, rad.
    pub fn q(&self, joints: usize) -> Vec<f64> {
        self.vector(Field::Angle, joints)
    }

    /// Returns geometry and numbers of the newest row. `rows_hz`: row rate, Hz.
    pub fn moment(
        &self,
        device: &Device<f64>,
        links: Option<&Description>,
        tracks: &[Track],
        scene: &Scene<f64>,
        rows_hz: f64,
    ) -> (Geometry, Numbers) {
        let joints = device.axes();
        let q = self.q(joints);
        let tip = self.vector(Field::Tip, joints);
        let pose = TaskPose::of(&device.mechanism, &q).and_then(TaskPose::regular).ok();
        let task = device.mechanism.kind().spec().task;
        let places: Vec<Flat> = tracks.iter().zip(&tip).map(|(track, tip)| track.place(*tip)).collect();
        let mut geometry = Geometry { tip: places.first().copied().unwrap_or(padded(&tip)), ..Geometry::default() };
        if let Some(drawn) = links.and_then(|links| skeleton(links, &q)) {
            geometry.bars = drawn.bars.iter().map(|bar| [bar.from.into(), bar.to.into()]).collect();
            geometry.rails = drawn.slides.iter().map(|slide| slide.rail().map(Into::into)).collect();
            geometry.base = drawn.base.iter().map(|base| (*base).into()).collect();
        }
        geometry.springs = scene.springs.iter().map(|spring| padded(&spring_anchor(spring, &tip[..task]))).collect();
        let recent = (RECENT_TIME * rows_hz).ceil() as u64;
        let wall = nearest_wall(scene, &tip[..task]);
        let stiffness = wall.map_or(0.0, |(index, _)| scene.walls[index].stiffness);
        let force: Vec<f64> =
            self.recent_values(Field::RenderedForce, 0, (OSCILLATION_TIME * rows_hz).ceil() as u64).collect();
        let mut numbers = Numbers {
            force: self.get(Field::RenderedForce, 0),
            depth: -self.get(Field::Distance, 0),
            ripple: ripple_about_mean(self.recent_values(Field::RenderedForce, 0, recent)),
            frequency: frequency(&force, rows_hz),
            power: energy_given_out(
                self.recent_values(Field::RenderedForce, 0, recent).zip(self.recent_values(Field::Distance, 0, recent)),
                stiffness,
            ) / RECENT_TIME,
            saturated: (0..joints)
                .map(|axis| share_matching(self.recent_values(Field::Saturated, axis, recent), |value| value > 0.0))
                .fold(0.0, f64::max),
            wall: wall.map(|(index, _)| index),
            sensed: self.vector(Field::Sensed, device.sensed.len()),
            ..Numbers::default()
        };
        geometry.more = places.iter().skip(1).map(|place| [*place, [0.0; 2]]).collect();
        let Some(pose) = pose else { return (geometry, numbers) };
        let torque = DVector::from_vec(self.vector(Field::Torque, joints));
        let force = pose.inverse.tr_mul(&torque).rows(0, task).into_owned();
        if tracks.is_empty() {
            geometry.force = padded(force.as_slice());
            let l = &pose.operational;
            geometry.ellipse = Some(ellipse(l[(0, 0)], l[(0, 1)], l[(1, 1)]));
        }
        // On a track the force acts along it.
        let along = tracks.iter().zip(&tip).zip(&force);
        let drawn = along.map(|((track, tip), force)| track.direction(*tip).map(|entry| force * entry));
        for (to, drawn) in [&mut geometry.force].into_iter().chain(geometry.more.iter_mut().map(|[_, f]| f)).zip(drawn)
        {
            *to = drawn;
        }
        if let Some((_, normal)) = wall {
            let n = DVector::from_fn(task, |i, _| normal[i]);
            numbers.sideways = (&force - &n * n.dot(&force)).norm();
            let linearised = Linearised::of(device, &q, n.as_slice(), scene.admissible).ok();
            numbers.inertia = linearised.and_then(|linearised| Some([linearised.w_eff()?, linearised.w_rr()]));
        }
        (geometry, numbers)
    }
}

/// Returns the position that a spring pulls the tip to.
fn spring_anchor(spring: &Spring<f64>, tip: &[f64]) -> [f64; 3] {
    let Spring { point, direction, .. } = spring;
    let along: f64 = tip.iter().enumerate().map(|(i, tip)| (tip - point[i]) * direction[i]).sum();
    core::array::from_fn(|i| point[i] + along * direction[i])
}

/// Returns the half axes of a symmetric 2 x 2 matrix, and the direction of the larger.
fn ellipse(xx: f64, xy: f64, yy: f64) -> Ellipse {
    let (mean, half) = (0.5 * (xx + yy), 0.5 * (xx - yy).hypot(2.0 * xy));
    Ellipse { axes: [mean + half, mean - half], angle: 0.5 * (2.0 * xy).atan2(xx - yy) }
}

/// Computes the root mean square deviation from the mean of all values.
fn ripple_about_mean(values: impl Iterator<Item = f64>) -> f64 {
    let values: Vec<f64> = values.collect();
    if values.is_empty() {
        return 0.0;
    }
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / count).sqrt()
}

/// Computes the frequency of an oscillation about the mean from its upward crossings. A crossing counts only after the
/// value was below the mean by half the rms, so that noise does not count.
fn frequency(values: &[f64], rows_hz: f64) -> Option<f64> {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let margin = 0.5 * ripple_about_mean(values.iter().copied());
    let (mut below, mut crossings) = (false, Vec::new());
    for (row, value) in values.iter().enumerate() {
        if below && value - mean > margin {
            crossings.push(row);
        }
        below = value - mean < if below { margin } else { -margin };
    }
    let periods = crossings.len().checked_sub(1).filter(|periods| *periods >= 2)?;
    Some(periods as f64 * rows_hz / (crossings[periods] - crossings[0]) as f64)
}

/// Computes the energy (J) that a wall gave out over some rows of its force and distance, minus the decrease of the
/// energy stored in its spring. A force is held until the next row.
fn energy_given_out(rows: impl Iterator<Item = (f64, f64)>, stiffness: f64) -> f64 {
    let stored = |distance: f64| 0.5 * stiffness * distance.min(0.0).powi(2);
    let (mut given, mut before) = (0.0, None);
    for (force, distance) in rows {
        if let Some((force, before)) = before {
            given += force * (distance - before) - (stored(before) - stored(distance));
        }
        before = Some((force, distance));
    }
    given
}

fn share_matching(values: impl Iterator<Item = f64>, matches: impl Fn(f64) -> bool) -> f64 {
    let (mut count, mut matching) = (0_u32, 0_u32);
    for value in values {
        count += 1;
        matching += u32::from(matches(value));
    }
    if count == 0 { 0.0 } else { f64::from(matching) / f64::from(count) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::demo::Demo;
    use haptic_bridge::render::scene::FeedForward;
    use haptic_host::device_file::DeviceFile;
    use haptic_host::link::columns;

    #[test]
    fn the_ellipse_of_a_rotated_matrix_is_rotated() {
        // R(0.3) diag(3, 1) R(0.3)ᵀ.
        let (s, c) = 0.3_f64.sin_cos();
        let found = ellipse(3.0 * c * c + s * s, 2.0 * s * c, 3.0 * s * s + c * c);
        assert!((found.axes[0] - 3.0).abs() < 1e-12 && (found.axes[1] - 1.0).abs() < 1e-12);
        assert!((found.angle - 0.3).abs() < 1e-12);
    }

    #[test]
    fn a_spring_is_anchored_at_its_point_or_on_its_line() {
        let mut spring = Spring { point: [0.1, 0.2, 0.0], direction: [0.0; 3], stiffness: 1.0, damping: 0.0 };
        assert_eq!(spring_anchor(&spring, &[0.5, 0.9]), [0.1, 0.2, 0.0]);
        spring.direction = [0.6, 0.8, 0.0];
        // Along the line by 0.6 · 0.4 + 0.8 · 0.7 = 0.8.
        let [x, y, z] = spring_anchor(&spring, &[0.5, 0.9]);
        assert!((x - 0.58).abs() < 1e-12 && (y - 0.84).abs() < 1e-12 && z == 0.0, "{x}, {y}, {z}");
    }

    #[test]
    fn the_ripple_of_a_sine_is_its_rms() {
        let sine = (0..1000).map(|i| 5.0 + 3.0 * (f64::from(i) * std::f64::consts::TAU / 100.0).sin());
        assert!((ripple_about_mean(sine) - 3.0 / 2.0_f64.sqrt()).abs() < 1e-9);
        assert_eq!(ripple_about_mean(std::iter::empty()), 0.0);
    }

    #[test]
    fn the_frequency_is_counted_in_spite_of_noise() {
        // 73 Hz at 1 kHz, with every other row off by a fifth of the amplitude.
        let row = |i: u32| (f64::from(i) * 0.073 * std::f64::consts::TAU).sin() + [0.2, -0.2][i as usize % 2];
        let oscillation: Vec<f64> = (0..300).map(row).collect();
        assert!((frequency(&oscillation, 1000.0).unwrap() - 73.0).abs() < 0.5);
        for still in [vec![], vec![2.0; 300], oscillation[..20].to_vec()] {
            assert_eq!(frequency(&still, 1000.0), None);
        }
    }

    /// A spring returns the energy that it absorbed, wherever it is released; a spring that is one sample late gives
    /// out kp x₀² sin(ω T) π more in each period of x = x₀ sin ω t.
    #[test]
    fn only_a_late_spring_gives_out_energy() {
        let (kp, depth, w, rows) = (1000.0, 1e-3, 0.05_f64, 10_000_u32);
        let distance = |i: f64| -0.01 + depth * (w * i).sin();
        let spring = |late: f64| (0..rows).map(move |i| (-kp * distance(f64::from(i) - late), distance(f64::from(i))));
        let per_period = kp * depth.powi(2) * std::f64::consts::PI;
        let periods = w * f64::from(rows) / std::f64::consts::TAU;
        // A force held for a row acts half a row late.
        for late in [1.0, 3.0] {
            let expected = periods * per_period * (w * (late + 0.5)).sin();
            let found = energy_given_out(spring(late), kp);
            assert!((found / expected - 1.0).abs() < 0.02, "{found} J, not {expected} J");
        }
        assert!(energy_given_out(spring(-0.5), kp).abs() < 1e-3 * per_period * periods);
    }

    #[test]
    fn the_force_of_a_paddle_is_drawn_along_its_arc() {
        let file = DeviceFile::parse(include_str!("../../../../devices/hapkit-paddle.toml"), "hapkit").unwrap();
        let (device, columns) = (file.device::<f64>().unwrap(), columns(FIELDS, &file.description.units(), 0));
        let (length, angle) = (file.description.geometry[0], 0.3_f64);
        let mut ring = Ring::new(columns.len(), 10);
        ring.push(columns.iter().map(|column| match column.field {
            Field::Angle => angle as f32,
            Field::Tip => (length * angle) as f32,
            Field::Torque => (2.0 * length) as f32,
            _ => 0.0,
        }));
        let newest = Newest::of(&ring, &columns);
        let scene = Scene { task: 1, ..Scene::default() };
        let tracks = Track::of(&device, Some(&file.description));
        let (geometry, _) = newest.moment(&device, Some(&file.description), &tracks, &scene, 1000.0);
        let [x, y] = geometry.force;
        assert!((x + 2.0 * angle.sin()).abs() < 1e-5 && (y - 2.0 * angle.cos()).abs() < 1e-5, "{x} {y}");
    }

    /// Torques Jᵀ n f for a force f along the wall's normal push the tip with f along the normal, and not sideways.
    #[test]
    fn a_force_along_the_normal_is_drawn_along_it() {
        let demo = Demo::shipped(1).unwrap();
        let device: Device<f64> = demo.file.device().unwrap();
        let pose = TaskPose::of(&device.mechanism, demo.q()).unwrap();
        let n = DVector::from_column_slice(&demo.normal);
        let torque = pose.jacobian.tr_mul(&n) * 4.0;
        let columns = columns(FIELDS, &demo.file.description.units(), 0);
        let mut ring = Ring::new(columns.len(), 10);
        ring.push(columns.iter().map(|column| match column.field {
            Field::Angle => demo.pose[column.axis] as f32,
            Field::Tip => pose.position[column.axis] as f32,
            Field::Torque => torque[column.axis] as f32,
            _ => 0.0,
        }));
        let scene = demo.scene([pose.position[0], pose.position[1]], FeedForward::Off).cast::<f64>();
        let newest = Newest::of(&ring, &columns);
        let (geometry, numbers) = newest.moment(&device, Some(&demo.file.description), &[], &scene, 1000.0);
        for axis in 0..2 {
            assert!((geometry.force[axis] - 4.0 * n[axis]).abs() < 1e-5, "{:?}", geometry.force);
            assert!((geometry.bars[3][1][axis] - geometry.tip[axis]).abs() < 1e-6, "the links end at the tip");
        }
        assert!(numbers.sideways < 1e-5, "{}", numbers.sideways);
        let inertia = demo.inertia().unwrap();
        let [effective, rendered] = numbers.inertia.unwrap();
        // Angles were rounded to f32.
        assert!((effective / inertia.effective - 1.0).abs() < 1e-5 && (rendered / inertia.rendered - 1.0).abs() < 1e-5);
        assert_eq!(numbers.wall, Some(0));
    }
}
