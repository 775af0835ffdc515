//! The mechanisms there are, by name: the one list that everything about them is made from, and how large any may be.

/// Most joints any mechanism has.
pub const MAX_JOINTS: usize = 3;
/// Most links any mechanism lists.
pub const MAX_LINKS: usize = 4;
/// Most numbers any mechanism's geometry takes.
pub const MAX_GEOMETRY: usize = 6;

/// The entries that a device file must hold for a mechanism.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Spec {
    /// The name in device files.
    pub name: &'static str,
    /// Number of joints N.
    pub joints: usize,
    /// Task dimension d.
    pub task: usize,
    /// The links in order.
    pub links: &'static [&'static str],
    /// The keys of `[geometry]` in order, each with its number of values.
    pub geometry: &'static [(&'static str, usize)],
    /// True if angles a whole turn apart are the same pose (false for a paddle, whose task is arc length).
    pub periodic: bool,
}

/// Expands `$with!{ (Variant, module, N) ... }` over every mechanism. Adding a mechanism is adding its line here.
#[macro_export]
macro_rules! mechanisms {
    ($with:ident) => {
        $with! {
            (Paddle, paddle, 1)
            (FiveBar, five_bar, 2)
            (FiveBarTurret, five_bar_turret, 3)
            (Parallelogram, parallelogram, 3)
            (Serial3r, serial_3r, 3)
        }
    };
}

macro_rules! define {
    ($(($Variant:ident, $module:ident, $n:literal))*) => {
        /// Which mechanism.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize, postcard_schema::Schema)]
        pub enum Kind {
            $(
                #[doc = concat!("See [`", stringify!($Variant), "`](crate::model::mechanism::", stringify!($Variant), ").")]
                $Variant,
            )*
        }

        impl Kind {
            /// Every mechanism.
            pub const ALL: &'static [Kind] = &[$(Kind::$Variant),*];
        }
    };
}
mechanisms!(define);
