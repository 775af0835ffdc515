//! The list of mechanisms, from which their code is generated, and the largest size of a mechanism.

/// Maximum number of joints of a mechanism.
pub const MAX_JOINTS: usize = 3;
/// Maximum number of links of a mechanism.
pub const MAX_LINKS: usize = 4;
/// Maximum number of values in a mechanism's geometry.
pub const MAX_GEOMETRY: usize = 8;

/// Required entries in the device file of a mechanism.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Spec {
    /// Name in device files. Mechanisms of one name differ in the number of joints.
    pub name: &'static str,
    /// Name that differs for each mechanism, for templates and reports.
    pub label: &'static str,
    /// Number of joints N.
    pub joints: usize,
    /// Task dimension d.
    pub task: usize,
    /// Names of the links, in order.
    pub links: &'static [&'static str],
    /// True if a device file may omit all links.
    pub are_links_optional: bool,
    /// Keys of `[geometry]` in order, each with its number of values.
    pub geometry: &'static [(&'static str, usize)],
    /// Number of gravity's entries.
    pub gravity: usize,
}

/// Expands `$with!{ (Variant, module, N) ... }` over every mechanism. A new mechanism needs one line here.
#[macro_export]
macro_rules! mechanisms {
    ($with:ident) => {
        $with! {
            (Paddle, paddle, 1)
            (FiveBar, five_bar, 2)
            (FiveBarTurret, five_bar_turret, 3)
            (Parallelogram, parallelogram, 3)
            (Serial3r, serial_3r, 3)
            (Paddles2, paddle, 2)
            (Paddles3, paddle, 3)
            (Chain1, chain, 1)
            (Chain2, chain, 2)
            (Chain3, chain, 3)
            (Delta, delta, 3)
        }
    };
}

macro_rules! define {
    ($(($Variant:ident, $module:ident, $n:literal))*) => {
        /// Kind of mechanism.
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
