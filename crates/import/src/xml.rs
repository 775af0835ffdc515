//! Elements of an XML file, whose errors name the file, the line, the element and the remedy.

use haptic_host::error::{Failure, on_one_line};
use nalgebra::{Isometry3, Translation3, Unit, UnitQuaternion, Vector3};
use roxmltree::Node;
use std::path::Path;

/// An element, and the path of its file.
#[derive(Clone, Copy)]
pub(crate) struct Element<'a> {
    pub node: Node<'a, 'a>,
    pub origin: &'a Path,
}

impl<'a> Element<'a> {
    pub fn tag(&self) -> &'a str {
        self.node.tag_name().name()
    }
    pub fn children(self) -> impl DoubleEndedIterator<Item = Element<'a>> {
        self.node.children().filter(Node::is_element).map(move |node| Element { node, ..self })
    }
    /// Returns the child elements with this tag.
    pub fn all(self, tag: &'static str) -> impl DoubleEndedIterator<Item = Element<'a>> {
        self.children().filter(move |child| child.tag() == tag)
    }
    /// Returns the child element with this tag, of which there is one at most.
    pub fn one(self, tag: &'static str) -> Result<Option<Element<'a>>, Failure> {
        match self.all(tag).nth(1) {
            Some(second) => Err(second.error("", "a second element of its kind", "keep one of them")),
            None => Ok(self.all(tag).next()),
        }
    }
    /// Returns a child element that must be there.
    pub fn required(self, tag: &'static str) -> Result<Element<'a>, Failure> {
        self.one(tag)?.ok_or_else(|| self.error("", format!("<{tag}> is missing"), format!("add <{tag} …/>")))
    }
    pub fn text(&self, attribute: &str) -> Option<&'a str> {
        self.node.attribute(attribute)
    }
    pub fn required_text(&self, attribute: &str) -> Result<&'a str, Failure> {
        let missing = || self.error("", format!("`{attribute}` is missing"), format!("add {attribute}=\"…\""));
        self.text(attribute).ok_or_else(missing)
    }
    pub fn numbers<const N: usize>(&self, attribute: &str) -> Result<Option<[f64; N]>, Failure> {
        let Some(text) = self.text(attribute) else { return Ok(None) };
        let finite = |word: &str| word.parse().ok().filter(|number: &f64| number.is_finite());
        let numbers: Option<Vec<f64>> = text.split_whitespace().map(finite).collect();
        numbers.and_then(|numbers| numbers.try_into().ok()).map(Some).ok_or_else(|| {
            let expected = if N == 1 { "one finite number".into() } else { format!("{N} finite numbers") };
            let reason = format!("{attribute} = \"{}\" is not {expected}", shown(text));
            self.error(attribute, reason, format!("write {expected}, with points as decimal marks"))
        })
    }
    pub fn number(&self, attribute: &str) -> Result<Option<f64>, Failure> {
        Ok(self.numbers::<1>(attribute)?.map(|[number]| number))
    }
    /// Returns a number of zero or more; zero if the attribute is missing.
    pub fn magnitude(&self, attribute: &str) -> Result<f64, Failure> {
        let value = self.number(attribute)?.unwrap_or(0.0);
        let negative = || self.error(attribute, format!("{attribute} is negative"), "write zero or a positive number");
        if value < 0.0 { Err(negative()) } else { Ok(value) }
    }
    pub fn vector(&self, attribute: &str) -> Result<Option<Vector3<f64>>, Failure> {
        Ok(self.numbers::<3>(attribute)?.map(Vector3::from))
    }
    pub fn direction(&self, attribute: &str) -> Result<Option<Unit<Vector3<f64>>>, Failure> {
        let Some(vector) = self.vector(attribute)? else { return Ok(None) };
        let zero = || self.error(attribute, format!("{attribute} has no direction"), "write a vector that is not zero");
        Unit::try_new(vector, 1e-9).map(Some).ok_or_else(zero)
    }
    /// Returns an error at an attribute, or at the element if the attribute is missing.
    pub fn error(&self, attribute: &str, reason: impl Into<String>, remedy: impl Into<String>) -> Failure {
        let start = self.node.attribute_node(attribute).map_or(self.node.range().start, |found| found.range().start);
        let (file, at) = (self.origin.display(), self.node.document().text_pos_at(start));
        let named = |node: Node<'_, '_>| {
            let name = node.attribute("name").map_or(String::new(), |name| format!(" name=\"{}\"", shown(name)));
            format!("<{}{name}>", node.tag_name().name())
        };
        let mut element = named(self.node);
        let around = self.node.ancestors().skip(1).find(|node| node.has_attribute("name"));
        if let (false, Some(around)) = (self.node.has_attribute("name"), around) {
            element += &format!(" in {}", named(around));
        }
        Failure::wrong(format!("{file}:{}:{}: {element}: {}", at.row, at.col, reason.into())).remedy(remedy.into())
    }
}

/// Shortens a text from the file for a message.
fn shown(text: &str) -> String {
    on_one_line(&text.chars().take(60).collect::<String>()).into_owned()
}

/// Returns a displacement after a rotation.
pub(crate) fn pose(position: Vector3<f64>, rotation: UnitQuaternion<f64>) -> Isometry3<f64> {
    Isometry3::from_parts(Translation3::from(position), rotation)
}
