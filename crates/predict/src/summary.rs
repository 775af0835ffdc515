//! Summary of a device file: reach and home of the tip, its force, and the mass.

use crate::plausible::device::force_at;
use haptic_bridge::model::device::Device;
use haptic_host::device_file::DeviceFile;
use haptic_host::words::with_unit;
use haptic_stability::analysis::map::{MapPoint, climb, map};
use haptic_stability::analysis::pose::{PoseError, TaskPose};
use serde::Serialize;

const GRID_POSES: usize = 3000;
/// First step of the search from the farthest grid pose to the end of the reach, rad.
const FIRST_STEP_RAD: f64 = 0.1;

/// Range of a quantity.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Span {
    /// Lowest value.
    pub low: f64,
    /// Highest value.
    pub high: f64,
}

impl Span {
    fn of(values: impl Iterator<Item = f64>) -> Option<Self> {
        values.fold(None, |span: Option<Self>, v| {
            Some(span.map_or(Self { low: v, high: v }, |s| Self { low: s.low.min(v), high: s.high.max(v) }))
        })
    }
}

/// A summary of the device that a file describes.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Range of the tip along each task coordinate, m, over the poses that are connected with home.
    pub reach: Vec<Span>,
    /// Position of the tip at home, m.
    pub tip_at_home: Option<Vec<f64>>,
    /// Largest force at the tip at home in its weakest and its strongest direction, N.
    pub force_at_home: Option<Span>,
    /// Largest tip motion at home per count of one encoder, m; `None` if a joint has no encoder.
    pub count_at_home: Option<f64>,
    /// Mass of links and handle, kg.
    pub moving_mass: f64,
    /// Effective inertia at home over all normals, kg.
    pub w_eff_at_home: Option<Span>,
    /// Effective inertia over the workspace and all normals, kg.
    pub w_eff: Option<Span>,
}

/// Returns the tip's range along a task coordinate, up to the limit or singularity that ends its motion.
fn reach(device: &Device<f64>, points: &[MapPoint], axis: usize) -> Result<Option<Span>, PoseError> {
    let place = |point: &&MapPoint| point.position[axis];
    let farthest = |sign: f64| {
        let from = points.iter().max_by(|a, b| (sign * place(a)).total_cmp(&(sign * place(b))))?;
        Some(climb(device, &from.q, FIRST_STEP_RAD, |pose| sign * pose.position[axis]).map(|reached| sign * reached))
    };
    let (low, high) = (farthest(-1.0).transpose()?, farthest(1.0).transpose()?);
    Ok(low.zip(high).map(|(low, high)| Span { low, high }))
}

impl Summary {
    /// Computes the summary of a device file.
    pub fn of(file: &DeviceFile) -> Result<Self, PoseError> {
        let description = &file.description;
        let spec = file.spec();
        let points = map(description, &[1.0, 0.0, 0.0][..spec.task], GRID_POSES)?;
        let device = file.device::<f64>()?;
        let reach = (0..spec.task).filter_map(|axis| reach(&device, &points, axis).transpose());
        let reach = reach.collect::<Result<_, _>>()?;
        let w_eff = Span::of(points.iter().flat_map(|p| p.eigenvalues.iter().copied()));
        let home = description.home.map(|home| TaskPose::of(&device.mechanism, &home[..spec.joints])).transpose()?;
        let regular = home.clone().and_then(|pose| pose.regular().ok());
        let w_eff_at_home = regular.as_ref().and_then(|pose| {
            let mobility = &pose.jacobian * pose.mass.clone().cholesky()?.solve(&pose.jacobian.transpose());
            let free = mobility.view((0, 0), (pose.task, pose.task)).into_owned();
            Span::of(free.symmetric_eigenvalues().iter().map(|mobile| 1.0 / mobile))
        });
        let joints = &description.joints[..spec.joints];
        let count_at_home =
            regular.as_ref().filter(|_| joints.iter().all(|joint| joint.encoder.is_some())).map(|pose| {
                let tip = pose.jacobian.rows(0, pose.task);
                let moved = tip
                    .column_iter()
                    .zip(&device.joints)
                    .map(|(column, joint)| column.norm() * joint.radians_per_count);
                moved.fold(0.0, |most: f64, moved| most.max(moved.abs()))
            });
        let links = description.links.iter().take(spec.links.len()).map(|link| link.mass).sum::<f64>();
        Ok(Self {
            reach,
            tip_at_home: home.map(|pose| pose.position),
            force_at_home: regular.and_then(|pose| force_at(&device, &pose)).map(|(low, high)| Span { low, high }),
            count_at_home,
            moving_mass: links + description.handle_mass,
            w_eff_at_home,
            w_eff,
        })
    }

    /// Formats the summary as text lines, one per item.
    pub fn lines(&self) -> Vec<String> {
        let millimetres = |v: f64| format!("{:.1}", (1e4 * v).round() / 10.0 + 0.0);
        let mut lines = Vec::new();
        let axes = ["x", "y", "z"].into_iter().zip(&self.reach);
        let reach = axes.map(|(axis, span)| format!("{axis} {} to {}", millimetres(span.low), millimetres(span.high)));
        lines.push(format!("reach of the tip: {} mm", reach.collect::<Vec<_>>().join(", ")));
        if let Some(tip) = &self.tip_at_home {
            let tip = tip.iter().map(|v| millimetres(*v)).collect::<Vec<_>>().join(", ");
            lines.push(format!("tip at home: ({tip}) mm"));
        }
        let between = |span: &Span, unit: &str| {
            if (span.high / span.low - 1.0).abs() < 5e-3 {
                return with_unit(span.low, unit);
            }
            format!("{} to {}", with_unit(span.low, unit), with_unit(span.high, unit))
        };
        match &self.force_at_home {
            Some(force) => {
                lines.push(format!("largest force at the tip at home, by direction: {}", between(force, "N")))
            }
            None => lines.push("largest force at the tip: unknown without [home] and [joint.motor]".into()),
        }
        if let Some(count) = self.count_at_home {
            lines.push(format!("one encoder count moves the tip at home by up to {}", with_unit(count, "m")));
        }
        if self.moving_mass > 0.0 {
            lines.push(format!("links and handle weigh {}", with_unit(self.moving_mass, "kg")));
        }
        let mut weff = Vec::new();
        weff.extend(self.w_eff_at_home.as_ref().map(|span| format!("{} at home", between(span, "kg"))));
        weff.extend(self.w_eff.as_ref().map(|span| format!("{} over the workspace", between(span, "kg"))));
        lines.push(format!("effective inertia Weff: {}", weff.join(", ")));
        lines
    }
}
