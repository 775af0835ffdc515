//! Converts models of robots in URDF or MJCF to device files of the mechanism `chain`: up to three joints between base and
//! tip, with all other bodies merged.
//!
//! ```
//! # fn main() -> Result<(), haptic_host::error::Failure> {
//! let robot = r#"<robot name="knob">
//!     <link name="base"/> <link name="arm"/> <link name="handle"/>
//!     <joint name="turn" type="continuous"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/></joint>
//!     <joint name="end" type="fixed"><parent link="arm"/><child link="handle"/><origin xyz="0.07 0 0"/></joint>
//! </robot>"#;
//! let converted = haptic_import::convert(robot, "knob.urdf".as_ref(), &Default::default())?;
//! assert!(converted.joints == 1 && converted.device_file.contains("task = [\"y\"]"));
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

use haptic_host::error::Failure;
use haptic_host::file_error::ForeignFormat;
use roxmltree::{Document, Error};
use std::path::Path;

/// Parts of a model that the user chooses.
#[derive(Clone, Debug, Default)]
pub struct Selection {
    /// Name of the body whose origin is the tip; by default the last body of the longest path.
    pub tip: Option<String>,
    /// Names of the joints that move, in any order; by default all between base and tip.
    pub joints: Vec<String>,
}

/// A converted model.
#[derive(Clone, Debug)]
pub struct Converted {
    /// Text of the device file, with every remark as a comment.
    pub device_file: String,
    /// Number of joints.
    pub joints: usize,
    /// Sentences for the user about everything that was merged, held or left out.
    pub remarks: Vec<String>,
}

/// Converts a model, whose format is recognised by its first element. Error messages name `origin` as the file.
pub fn convert(text: &str, origin: &Path, selection: &Selection) -> Result<Converted, Failure> {
    let foreign = |(name, remedy): (&str, &str)| {
        Failure::wrong(format!("{}: this is {name}, neither URDF nor MJCF", origin.display())).remedy(remedy)
    };
    let xacro = || foreign(ForeignFormat::XACRO.name_and_remedy());
    let format = ForeignFormat::of(text).map(ForeignFormat::name_and_remedy);
    let document = Document::parse(text).map_err(|error| match format {
        _ if matches!(&error, Error::UnknownNamespace(prefix, _) if prefix == "xacro") => xacro(),
        Some(format) if !text.trim_start_matches('\u{feff}').trim_start().starts_with('<') => foreign(format),
        _ => {
            let (file, at) = (origin.display(), error.pos());
            let reason = format!("{file}:{}:{}: not valid XML: {error}", at.row, at.col);
            Failure::wrong(reason).remedy("name a URDF or MJCF file, and correct the XML at this place")
        }
    })?;
    let root = xml::Element { node: document.root_element(), origin };
    let tree = match root.tag() {
        "robot" if document.descendants().any(is_xacro) => return Err(xacro()),
        "robot" => urdf::read(root)?,
        "mujoco" => mjcf::read(root)?,
        _ => return Err(foreign(format.unwrap_or(("XML", "name a URDF or MJCF file")))),
    };
    let chain = tree.chain(selection, origin)?;
    Ok(Converted { device_file: chain.device_file(), joints: chain.links.len(), remarks: chain.remarks })
}

/// Returns true for an element that xacro expands.
fn is_xacro(node: roxmltree::Node<'_, '_>) -> bool {
    node.tag_name().namespace().is_some_and(|space| space.contains("xacro"))
        || node.attributes().any(|attribute| ["${", "$("].iter().any(|sign| attribute.value().contains(sign)))
}
