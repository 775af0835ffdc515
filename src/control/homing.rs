//! Homing: the counts at which the joints have the angles of the device file.
//!
//! A person declares the home pose, or moves every joint over its encoder's index mark while the motors are off. Homing
//! by stops begins with the home pose, roughly; `polarity/stops.rs` then pushes the joints.

use super::{ControlLoop, REST_SPEED};
use crate::control::joints::Counts;
use crate::control::program::Program;
use crate::drive::stage::Stage;
use crate::math::Math;
use crate::math::floor_to_i32;
use crate::model::catalogue::MAX_JOINTS;
use crate::model::description::Homing;
use crate::model::device::MAX_BEYOND_LIMITS;
use crate::safety::refusal::Refusal;
use core::ops::DerefMut;

/// Largest number of encoder turns between `offset` and an index mark.
const MAX_INDEX_TURNS: f32 = 1.0e6;

impl<P, K, S> ControlLoop<P, S>
where
    P: DerefMut<Target = Program<K, S>>,
    K: Math<f32>,
    S: Stage,
{
    /// Homes the device by its present pose or by its index marks.
    pub(super) fn home(&mut self) -> Result<(), Refusal> {
        self.check_motors_off()?;
        self.check_encoders_read()?;
        let program = self.program.as_ref().ok_or(Refusal::NoDevice)?;
        let home = program.home.ok_or(Refusal::NoHome)?;
        match program.homing {
            Homing::Index => {
                let angles = self.angles_by_index();
                if matches!(angles, Err(Refusal::IndexOutside(_))) {
                    self.forget_marks();
                }
                self.declare(&angles?);
            }
            _ if !self.is_slower_than(REST_SPEED) => return Err(Refusal::Moving),
            homing => {
                self.declare(&home);
                self.homed = homing == Homing::Hand;
                self.first_index = [None; MAX_JOINTS];
            }
        }
        Ok(())
    }

    /// Declares that the joints are at `q`, rad. An absolute encoder gives the angle of its joint within a turn of its
    /// magnet. The device is homed.
    pub(super) fn declare(&mut self, q: &[f32; MAX_JOINTS]) {
        let (counts, axes) = (self.now.counts, self.absolute_axes());
        let q = core::array::from_fn(|i| if axes[i] { self.absolute_angle(i, q[i]) } else { q[i] });
        if let Some(program) = self.program.as_mut() {
            program.controller.home(&counts, &q);
            self.sensed.home();
            (self.placed, self.homed) = (true, true);
            self.keep_polarity_near_its_home();
            self.set_bounds();
            self.update_cogging();
        }
    }

    /// Forgets the index marks and the counts that the joints have passed.
    pub(super) fn forget_marks(&mut self) {
        (self.first_index, self.swept) = ([None; MAX_JOINTS], None);
    }

    /// Extends the range of counts that every joint has passed. Call in every step with the motors off.
    pub(super) fn sweep(&mut self) {
        let counts = self.now.counts;
        let (low, high) = self.swept.get_or_insert((counts, counts));
        let outside = |count: i32, from: i32| count.wrapping_sub(from);
        *low = Counts::from_fn(|i| if outside(counts[i], low[i]) < 0 { counts[i] } else { low[i] });
        *high = Counts::from_fn(|i| if outside(counts[i], high[i]) > 0 { counts[i] } else { high[i] });
    }

    /// Returns the present joint angles (rad) by the index marks. An encoder that turns several times in its joint's
    /// range has several marks; the angles that the joint has passed must leave one of them only.
    pub(super) fn angles_by_index(&self) -> Result<[f32; MAX_JOINTS], Refusal> {
        let program = self.program.as_ref().ok_or(Refusal::NoDevice)?;
        let (first, last) = self.swept.unwrap_or((self.now.counts, self.now.counts));
        let mut q = [0.0; MAX_JOINTS];
        for i in 0..self.count().min(MAX_JOINTS) {
            let joint = i as u8;
            let (scale, offset) = (program.radians_per_count[i], program.offsets[i]);
            let turn = self.rules.index_period[i] as f32 * scale.abs();
            if turn <= 0.0 {
                return Err(Refusal::NoIndexPeriod(joint));
            }
            let beyond = program.lever[i] * MAX_BEYOND_LIMITS as f32;
            let (low, high) = program.limits[i].ok_or(Refusal::NoJointLimits(joint))?;
            let mark = self.first_index[i].ok_or(Refusal::IndexUnseen(joint))?;
            let angle = |count: i32| offset + count.wrapping_sub(mark) as f32 * scale;
            let ends = [angle(first[i]), angle(last[i])];
            let turns = |angle: f32| (angle / turn).clamp(-MAX_INDEX_TURNS, MAX_INDEX_TURNS);
            let least = -floor_to_i32(turns(ends[0].min(ends[1]) - low + beyond));
            let most = floor_to_i32(turns(high + beyond - ends[0].max(ends[1])));
            match most - least {
                0 => q[i] = angle(self.now.counts[i]) + least as f32 * turn,
                1.. => return Err(Refusal::IndexAmbiguous(joint)),
                _ => return Err(Refusal::IndexOutside(joint)),
            }
        }
        Ok(q)
    }
}
