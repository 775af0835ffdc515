//! Mass models for a board: the closed form, a frozen matrix, or a table that fits the board's memory.

use crate::bench::probe::Probe;
use haptic_bridge::math::Libm;
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::model::device::Device;
use haptic_bridge::model::mechanism::Mechanism;
use haptic_bridge::model::precomputed::{Grid, Interpolation, MassModelData, TABLE_VALUES, checksum, tabulate};
use haptic_bridge::with_mechanism;
use nalgebra::SVector;

/// A mass model with the values of its table.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PrecomputedModel {
    /// The model as it is sent to the board.
    pub data: MassModelData,
    /// Table values, which are sent before the model; empty for other models.
    pub values: Vec<f32>,
}

impl PrecomputedModel {
    /// Returns the model's name in the instruction counts.
    pub fn name(&self) -> &'static str {
        match &self.data {
            MassModelData::Exact => "exact",
            MassModelData::Frozen(_) => "frozen",
            MassModelData::Table(grid, _) => match grid.interpolation {
                Interpolation::Bilinear => "bilinear",
                Interpolation::Bicubic => "bicubic",
            },
        }
    }

    /// Returns the size of the table values on the board, bytes.
    pub fn bytes(&self) -> usize {
        4 * self.values.len()
    }
}

/// Returns a frozen mass matrix: the mean of M over `probes`.
pub fn frozen_model(device: &Device<f64>, probes: &[Probe]) -> PrecomputedModel {
    fn mean<M: Mechanism<f64, N>, const N: usize>(m: &M, probes: &[Probe]) -> [f32; 6] {
        let mut triangle = [0.0; 6];
        for probe in probes {
            let mass = m.mass(&m.pose::<Libm>(&SVector::<f64, N>::from_fn(|i, _| probe.q[i])));
            for (row, column) in M::MASS_ENTRIES {
                triangle[row * (row + 1) / 2 + column] += mass[(*row, *column)] / probes.len() as f64;
            }
        }
        triangle.map(|entry| entry as f32)
    }
    let triangle = with_mechanism!(&device.mechanism, m => mean(m, probes));
    PrecomputedModel { data: MassModelData::Frozen(triangle), values: Vec::new() }
}

/// Returns the largest number of points per coordinate for which a square grid fits the board's memory.
pub fn max_grid_points(device: &Device<f64>) -> u8 {
    let entries = device.mechanism.mass_entries().len();
    ((TABLE_VALUES / entries) as f64).sqrt().floor().min(255.0) as u8
}

/// Returns the ranges of the two coordinates that M depends on, over `probes`, widened by 1 %, rad.
pub fn shape_range(device: &Device<f64>, probes: &[Probe]) -> [[f64; 2]; 2] {
    let [mut low, mut high] = [[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]];
    for probe in probes {
        for (k, angle) in shape(device, &probe.q).into_iter().enumerate() {
            low[k] = low[k].min(angle);
            high[k] = high[k].max(angle);
        }
    }
    for (low, high) in low.iter_mut().zip(&mut high) {
        let slack = 0.01 * (*high - *low).max(0.1);
        *low -= slack;
        *high += slack;
    }
    [low, high]
}

fn shape(device: &Device<f64>, q: &[f64; MAX_JOINTS]) -> [f64; 2] {
    fn of<M: Mechanism<f64, N>, const N: usize>(m: &M, q: &[f64; MAX_JOINTS]) -> [f64; 2] {
        m.shape(&SVector::from_fn(|i, _| q[i]))
    }
    with_mechanism!(&device.mechanism, m => of(m, q))
}

/// Computes a table over `range` (low and high of both shape coordinates, rad); `None` if the board has no room.
pub fn mass_table(
    device: &Device<f64>,
    interpolation: Interpolation,
    points: [u8; 2],
    range: [[f64; 2]; 2],
) -> Option<PrecomputedModel> {
    fn tabulated_values<M: Mechanism<f64, N>, const N: usize>(m: &M, grid: &Grid<f64>) -> Vec<f32> {
        let mut values = vec![0.0; grid.values(M::MASS_ENTRIES.len())];
        tabulate::<f64, Libm, M, N>(m, grid, |index, value| values[index] = value as f32);
        values
    }
    let entries = device.mechanism.mass_entries().len();
    let grid = Grid::<f64>::new(interpolation, points, range[0], range[1], entries)?;
    let values = with_mechanism!(&device.mechanism, m => tabulated_values(m, &grid));
    if values.iter().any(|value| !value.is_finite()) {
        return None;
    }
    let grid = Grid::<f32> {
        interpolation,
        points,
        low: grid.low.map(|low| low as f32),
        spacing: grid.spacing.map(|spacing| spacing as f32),
    };
    let crc = checksum(&values);
    Some(PrecomputedModel { data: MassModelData::Table(grid, crc), values })
}
