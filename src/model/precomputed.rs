//! Mass matrices that the control step does not compute: one matrix for all poses, or a table over the joint angles.
//!
//! M depends on at most two joint coordinates ([`Mechanism::shape`]), so a table is a grid over these two. It contains
//! only the distinct entries of M ([`Mechanism::MASS_ENTRIES`]) and has a fixed size of [`TABLE_VALUES`] numbers, under
//! 3 KB of the board's memory. Outside the grid, and at points without a valid mass matrix, the closed form is used.
//!
//! [`MassModel::new`] makes a mass model from the data of a tool, and [`MassModel::shaping`] uses it. The velocity
//! terms z always come from the mechanism, because they are forces, not a mass matrix.

use crate::checksum::Crc32;
use crate::math::{Math, Real};
use crate::model::mechanism::{Mechanism, Shaping};
use crate::model::solve::is_positive_definite;
use heapless::Vec;
use nalgebra::{SMatrix, SVector};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Maximum number of values in a table (2 800 bytes): 15 x 15 points of a five-bar, 13 x 13 with a turret, 10 x 10 of
/// 3R.
pub const TABLE_VALUES: usize = 700;
/// Maximum number of distinct entries in a mechanism's M.
const MAX_ENTRIES: usize = 6;

/// The interpolation between a table's values.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum Interpolation {
    /// Linear in both coordinates: continuous, error of second order in the spacing.
    Bilinear,
    /// Catmull-Rom in both coordinates: continuous with continuous slope, error of third order. The outermost points
    /// only determine slopes.
    Bicubic,
}

impl Interpolation {
    /// Returns the number of points on each side of the grid that lie outside the usable range.
    const fn margin(self) -> u8 {
        match self {
            Self::Bilinear => 0,
            Self::Bicubic => 1,
        }
    }
}

/// The grid of a table. Its values are ordered point by point, with the second coordinate fastest. Each point has the
/// entries of [`Mechanism::MASS_ENTRIES`], kg m².
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Grid<T> {
    /// Interpolation between values.
    pub interpolation: Interpolation,
    /// Number of points along each coordinate.
    pub points: [u8; 2],
    /// First point, rad.
    pub low: [T; 2],
    /// Distance between points, rad.
    pub spacing: [T; 2],
}

impl<T: Real> Grid<T> {
    /// Makes a grid that is usable from `low` to `high` (rad), with `points` points along each coordinate. `None` if
    /// the table would hold more than [`TABLE_VALUES`] numbers with `entries` numbers per point, if too few points are
    /// given to interpolate, or if the range is empty.
    pub fn new(
        interpolation: Interpolation,
        points: [u8; 2],
        low: [T; 2],
        high: [T; 2],
        entries: usize,
    ) -> Option<Self> {
        let margin = interpolation.margin();
        if points.iter().any(|count| *count < 2 + 2 * margin) {
            return None;
        }
        let cells = points.map(|count| T::from_i32(i32::from(count - 1 - 2 * margin)));
        let spacing: [T; 2] = core::array::from_fn(|i| (high[i] - low[i]) / cells[i]);
        let grid = Self {
            interpolation,
            points,
            low: core::array::from_fn(|i| low[i] - spacing[i] * T::from_i32(i32::from(margin))),
            spacing,
        };
        grid.is_usable(entries).then_some(grid)
    }

    /// Returns the number of values for a mechanism with this many entries.
    pub fn values(&self, entries: usize) -> usize {
        usize::from(self.points[0]) * usize::from(self.points[1]) * entries
    }

    /// Returns the joint coordinates of a grid point, rad.
    pub fn coordinates(&self, i: usize, j: usize) -> [T; 2] {
        let along = |k: usize, index: usize| self.low[k] + self.spacing[k] * T::from_i32(index as i32);
        [along(0, i), along(1, j)]
    }

    fn is_usable(&self, entries: usize) -> bool {
        let min_points = 2 + 2 * self.interpolation.margin();
        self.points.iter().all(|count| *count >= min_points)
            && self.values(entries) <= TABLE_VALUES
            && self.spacing.iter().all(|step| step.is_finite() && *step > T::zero())
            && self.low.iter().all(|low| low.is_finite())
    }
}

/// Computes the values of a table for `mechanism` and passes each value to `put` with its index.
pub fn tabulate<T: Real, K: Math<T>, M: Mechanism<T, N>, const N: usize>(
    mechanism: &M,
    grid: &Grid<T>,
    mut put: impl FnMut(usize, T),
) {
    let mut index = 0;
    for i in 0..usize::from(grid.points[0]) {
        for j in 0..usize::from(grid.points[1]) {
            let mass = mechanism.mass(&mechanism.pose::<K>(&joints(mechanism, &grid.coordinates(i, j))));
            for (row, column) in M::MASS_ENTRIES {
                put(index, mass[(*row, *column)]);
                index += 1;
            }
        }
    }
}

/// Returns joint angles with these shape coordinates. Joints that M does not depend on are at zero.
pub fn joints<T: Real, M: Mechanism<T, N>, const N: usize>(mechanism: &M, shape: &[T; 2]) -> SVector<T, N> {
    SVector::from_fn(|joint, _| {
        let mut unit = SVector::<T, N>::zeros();
        unit[joint] = T::one();
        let [first, second] = mechanism.shape(&unit);
        first * shape[0] + second * shape[1]
    })
}

/// A table in run-time form.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Table<T> {
    interpolation: Interpolation,
    low: [T; 2],
    inverse_spacing: [T; 2],
    /// First and last usable cell.
    first: i32,
    last: [i32; 2],
    /// Number of points along the second coordinate.
    row: usize,
    /// Values in the order of [`Grid`], followed by zeros.
    values: [T; TABLE_VALUES],
}

impl<T: Real> Table<T> {
    fn new(grid: &Grid<T>, given: &[T]) -> Self {
        let margin = i32::from(grid.interpolation.margin());
        let mut values = [T::zero(); TABLE_VALUES];
        for (value, given) in values.iter_mut().zip(given) {
            *value = *given;
        }
        Self {
            interpolation: grid.interpolation,
            low: grid.low,
            inverse_spacing: grid.spacing.map(|step| T::one() / step),
            first: margin,
            last: grid.points.map(|count| i32::from(count) - 2 - margin),
            row: usize::from(grid.points[1]),
            values,
        }
    }

    /// Returns the cell of joint coordinates and the position in the cell, from 0 to 1; `None` outside the grid.
    #[inline(always)]
    fn cell(&self, shape: &[T; 2]) -> Option<([usize; 2], [T; 2])> {
        let mut cell = [0; 2];
        let mut within = [T::zero(); 2];
        for k in 0..2 {
            let u = (shape[k] - self.low[k]) * self.inverse_spacing[k];
            let whole = u.integer_part();
            // The far edge belongs to the last cell.
            let last = self.last[k];
            let whole = if whole == last + 1 && u == T::from_i32(whole) { last } else { whole };
            if !(u >= T::zero() && whole >= self.first && whole <= last) {
                return None;
            }
            cell[k] = whole as usize;
            within[k] = u - T::from_i32(whole);
        }
        Some((cell, within))
    }

    /// Returns M at joint coordinates; `None` outside the grid.
    fn mass<M: Mechanism<T, N>, const N: usize>(&self, shape: &[T; 2]) -> Option<SMatrix<T, N, N>> {
        let entries = self.entries(shape, M::MASS_ENTRIES.len())?;
        let mut mass = SMatrix::<T, N, N>::zeros();
        for ((row, column), value) in M::MASS_ENTRIES.iter().zip(entries) {
            for place in [(*row, *column), (*column, *row)] {
                if let Some(entry) = mass.get_mut(place) {
                    *entry = value;
                }
            }
        }
        Some(mass)
    }

    /// Returns the first `count` entries at joint coordinates. Not inlined, because all mechanisms share it.
    #[inline(never)]
    fn entries(&self, shape: &[T; 2], count: usize) -> Option<[T; MAX_ENTRIES]> {
        let (cell, within) = self.cell(shape)?;
        let one = T::one();
        let linear = [[one - within[0], within[0]], [one - within[1], within[1]]];
        let cubic = [catmull_rom(within[0]), catmull_rom(within[1])];
        // The cubic curve needs one neighbour before the cell.
        let (along, across, before): (&[T], &[T], usize) = match self.interpolation {
            Interpolation::Bilinear => (&linear[0], &linear[1], 0),
            Interpolation::Bicubic => (&cubic[0], &cubic[1], 1),
        };
        let mut entries = [T::zero(); MAX_ENTRIES];
        for (i, first) in along.iter().enumerate() {
            let start = ((cell[0] + i).wrapping_sub(before) * self.row + cell[1].wrapping_sub(before)) * count;
            let mut line = self.values.get(start..)?.chunks_exact(count.max(1));
            for second in across {
                let weight = *first * *second;
                for (entry, value) in entries.iter_mut().zip(line.next()?) {
                    *entry += weight * *value;
                }
            }
        }
        Some(entries)
    }
}

/// Returns the weights of four neighbours at `t` in [0, 1] between the middle two (Catmull and Rom 1974, tension 1/2).
fn catmull_rom<T: Real>(t: T) -> [T; 4] {
    let half = T::from_f64(0.5);
    let s = T::one() - t;
    let (before, after) = (-half * t * s * s, -half * t * t * s);
    let smooth = t * t * (T::from_f64(3.0) - t - t);
    [before, T::one() - smooth - after, smooth - before, after]
}

/// Source of the mass matrix in the control step.
#[derive(Clone, Debug, Default, PartialEq)]
#[allow(clippy::large_enum_variant, reason = "the board has no heap, and a program reserves memory for either")]
pub enum MassModel<T: Real, const N: usize> {
    /// The mechanism's closed form, computed in every control step.
    #[default]
    Exact,
    /// One matrix for the complete workspace, kg m².
    Frozen(SMatrix<T, N, N>),
    /// A table over the joint angles.
    Table(Table<T>),
}

impl<T: Real, const N: usize> MassModel<T, N> {
    /// Makes the run-time form of a table for the mechanism `M`; `None` if the grid or the number of values is wrong.
    pub fn table<M: Mechanism<T, N>>(grid: &Grid<T>, values: &[T]) -> Option<Self> {
        let entries = M::MASS_ENTRIES.len();
        let fits = grid.is_usable(entries) && grid.values(entries) == values.len();
        fits.then(|| Self::Table(Table::new(grid, values)))
    }

    /// Returns the joint motion and the inertia of a unit tip motion along `n`. Not inlined, because every copy would
    /// enlarge the image, and the call costs little.
    #[inline(never)]
    pub fn shaping<M: Mechanism<T, N>>(
        &self,
        mechanism: &M,
        q: &SVector<T, N>,
        pose: &M::Pose,
        n: &SVector<T, N>,
    ) -> Shaping<T, N> {
        let mass = match self {
            Self::Exact => return mechanism.shaping(pose, n),
            Self::Frozen(mass) => *mass,
            Self::Table(table) => {
                let mass = table.mass::<M, N>(&mechanism.shape(q)).filter(is_positive_definite);
                mass.unwrap_or_else(|| mechanism.mass(pose))
            }
        };
        Shaping::of(&mass, mechanism.inverse(pose, n))
    }
}

/// A mass model in a request. A table is not stored in flash, because it does not fit one setting. After a restart the
/// board uses the closed form until the tool sends the table again.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub enum MassModelData {
    /// The mechanism's closed form.
    #[default]
    Exact,
    /// The lower triangle of one matrix, row by row, kg m².
    Frozen([f32; 6]),
    /// A table whose values were sent before, with the CRC-32 of the values.
    Table(Grid<f32>, u32),
}

impl<const N: usize> MassModel<f32, N> {
    /// Makes the run-time form with the received values of a table; `None` if the data are not a valid mass matrix.
    pub fn new<M: Mechanism<f32, N>>(data: &MassModelData, values: &[f32]) -> Option<Self> {
        match data {
            MassModelData::Exact => Some(Self::Exact),
            MassModelData::Frozen(triangle) => {
                let mass = SMatrix::<f32, N, N>::from_fn(|i, j| {
                    let (row, column) = if i > j { (i, j) } else { (j, i) };
                    triangle.get(row * (row + 1) / 2 + column).copied().unwrap_or(f32::NAN)
                });
                let usable = mass.iter().all(|entry| entry.is_finite()) && is_positive_definite(&mass);
                usable.then_some(Self::Frozen(mass))
            }
            MassModelData::Table(grid, _) => Self::table::<M>(grid, values),
        }
    }
}

/// A part of a table in a request.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct TableChunk {
    /// Index of the first value.
    pub offset: u16,
    /// Values.
    pub values: Vec<f32, 64>,
}

/// The received values of a table that is sent in parts.
#[derive(Clone, Debug, Default)]
pub struct TableReceiver {
    values: Vec<f32, TABLE_VALUES>,
}

impl TableReceiver {
    /// Appends a chunk that begins at value `offset`; 0 restarts the transfer. Returns false if the offset does not
    /// continue the transfer, if the table would be too long, or if a value is not finite.
    pub fn take(&mut self, offset: usize, chunk: &[f32]) -> bool {
        if !self.fits(offset, chunk) {
            return false;
        }
        if offset == 0 {
            self.values.clear();
        }
        self.values.extend_from_slice(chunk).is_ok()
    }

    /// Returns true if the chunk is finite, fits, and is the first of a table or continues the previous chunk.
    pub fn fits(&self, offset: usize, chunk: &[f32]) -> bool {
        let next = offset == 0 || offset == self.values.len();
        next && offset + chunk.len() <= TABLE_VALUES && chunk.iter().all(|value| value.is_finite())
    }

    /// Returns the values received so far.
    pub fn values(&self) -> &[f32] {
        &self.values
    }

    /// Returns true if exactly `values` values with the checksum `crc` were received.
    pub fn is_complete(&self, values: usize, crc: u32) -> bool {
        self.values.len() == values && checksum(&self.values) == crc
    }
}

/// Returns the checksum that identifies a table's values: CRC-32 of their little-endian bytes.
pub fn checksum(values: &[f32]) -> u32 {
    let mut crc = Crc32::new();
    for value in values {
        crc.take(&value.to_le_bytes());
    }
    crc.sum()
}
