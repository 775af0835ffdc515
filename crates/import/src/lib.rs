//! Converts models of robots in URDF or MJCF to device files of the mechanism `chain`.
//!
//! [`read`] returns the kinematic [`Tree`] of a file, [`Tree::chain`] the [`Chain`] of up to three joints between base
//! and tip, with all other bodies merged, and [`Chain::device_file`] the text of the device file.
//!
//! ```
//! use haptic_import::{Selection, read};
//!
//! # fn main() -> Result<(), haptic_host::error::Failure> {
//! let robot = r#"<robot name="knob">
//!     <link name="base"/> <link name="arm"/> <link name="handle"/>
//!     <joint name="turn" type="continuous"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/></joint>
//!     <joint name="end" type="fixed"><parent link="arm"/><child link="handle"/><origin xyz="0.07 0 0"/></joint>
//! </robot>"#;
//! let path = "knob.urdf".as_ref();
//! let chain = read(robot, path)?.chain(&Selection::default(), path)?;
//! assert_eq!((chain.links.len(), &chain.task[..]), (1, &[1][..]));
//! # Ok(())
//! # }
//! ```
#![forbid(unsafe_code)]

mod chain;
mod device_file;
mod mjcf;
mod tree;
mod urdf;
mod xml;

pub use chain::{Chain, Link, MAX_JOINTS, Selection};
pub use tree::{Body, Inertia, Joint, Motion, Step, Tree};

use haptic_host::error::Failure;
use haptic_host::file_error::ForeignFormat;
use roxmltree::{Document, Error};
use std::path::Path;

/// Reads a text in URDF or MJCF, recognised by its first element. Error messages name `origin` as the file.
pub fn read(text: &str, origin: &Path) -> Result<Tree, Failure> {
    let foreign = |(name, remedy): (&str, &str)| {
        Failure::wrong(format!("{}: this is {name}, neither URDF nor MJCF", origin.display())).remedy(remedy)
    };
    let format = || ForeignFormat::of(text).map(ForeignFormat::name_and_remedy);
    let document = Document::parse(text).map_err(|error| match format() {
        _ if matches!(&error, Error::UnknownNamespace(prefix, _) if prefix == "xacro") => {
            foreign(ForeignFormat::XACRO.name_and_remedy())
        }
        Some(format) if !text.trim_start_matches('\u{feff}').trim_start().starts_with('<') => foreign(format),
        _ => {
            let (file, at) = (origin.display(), error.pos());
            let reason = format!("{file}:{}:{}: not valid XML: {error}", at.row, at.col);
            Failure::wrong(reason).remedy("name a URDF or MJCF file, and correct the XML at this place")
        }
    })?;
    let root = xml::Element { node: document.root_element(), origin };
    match root.tag() {
        "robot" if document.descendants().any(is_xacro) => Err(foreign(ForeignFormat::XACRO.name_and_remedy())),
        "robot" => urdf::read(root),
        "mujoco" => mjcf::read(root),
        _ => Err(foreign(format().unwrap_or(("XML", "name a URDF or MJCF file")))),
    }
}

/// Returns true for an element that xacro expands.
fn is_xacro(node: roxmltree::Node<'_, '_>) -> bool {
    let is_template = |text: &str| text.contains("${") || text.contains("$(");
    node.tag_name().namespace().is_some_and(|space| space.contains("xacro"))
        || node.attributes().any(|attribute| is_template(attribute.value()))
}
