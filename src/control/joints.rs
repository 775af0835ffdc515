//! Values of every joint, padded with zeros to [`MAX_JOINTS`]. Counts, torques, currents and duties are separate types.

use crate::model::catalogue::MAX_JOINTS;
use core::ops::{Deref, DerefMut};

macro_rules! quantities {
    ($($(#[$doc:meta])* $Name:ident of $Number:ty;)*) => {$(
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq)]
        #[repr(transparent)]
        pub struct $Name(pub [$Number; MAX_JOINTS]);

        impl $Name {
            /// Builds the value of every joint with `each`.
            #[inline(always)]
            pub fn from_fn(each: impl FnMut(usize) -> $Number) -> Self {
                Self(core::array::from_fn(each))
            }
        }

        impl Deref for $Name {
            type Target = [$Number; MAX_JOINTS];

            #[inline(always)]
            fn deref(&self) -> &Self::Target {
                &self.0
            }
        }

        impl DerefMut for $Name {
            #[inline(always)]
            fn deref_mut(&mut self) -> &mut Self::Target {
                &mut self.0
            }
        }
    )*};
}

quantities! {
    /// Encoder counts, extended to 32 bits, wrapping.
    Counts of i32;
    /// Joint torques, N m.
    Torques of f32;
    /// Motor currents, A.
    Currents of f32;
    /// Bridge duties, signed, as shares of the bus voltage.
    Duties of f32;
}
