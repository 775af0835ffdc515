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
    /// Returns the tag.
    pub fn tag(&self) -> &'a str {
        self.node.tag_name().name()
    }
    /// Returns all child elements.
    pub fn children(self) -> impl DoubleEndedIterator<Item = Element<'a>> {
        let elements = self.node.children().filter(Node::is_element);
        elements.map(move |node| Element { node, ..self })
    }
    /// Returns the child elements with this tag.
    pub fn all(self, tag: &'static str) -> impl DoubleEndedIterator<Item = Element<'a>> {
        self.children().filter(move |child| child.tag() == tag)
    }
    /// Returns the child element with this tag, of which there is one at most.
    pub fn one(self, tag: &'static str) -> Result<Option<Element<'a>>, Failure> {
        let mut all = self.all(tag);
        let first = all.next();
        match all.next() {
            Some(second) => Err(second.error("a second element of its kind", "keep one of them")),
            None => Ok(first),
        }
    }
    /// Returns a required child element.
    pub fn required(self, tag: &'static str) -> Result<Element<'a>, Failure> {
        self.one(tag)?.ok_or_else(|| self.error(format!("<{tag}> is missing"), format!("add <{tag} …/>")))
    }
    /// Returns the text of an attribute.
    pub fn text(&self, attribute: &str) -> Option<&'a str> {
        self.node.attribute(attribute)
    }
    /// Returns the text of a required attribute.
    pub fn required_text(&self, attribute: &str) -> Result<&'a str, Failure> {
        self.text(attribute).ok_or_else(|| self.missing(attribute))
    }
    /// Returns the numbers of an attribute.
    pub fn numbers<const N: usize>(&self, attribute: &str) -> Result<Option<[f64; N]>, Failure> {
        let Some(text) = self.text(attribute) else { return Ok(None) };
        let numbers: Option<Vec<f64>> =
            text.split_whitespace().map(|word| word.parse().ok().filter(|number: &f64| number.is_finite())).collect();
        numbers.and_then(|numbers| numbers.try_into().ok()).map(Some).ok_or_else(|| {
            let expected = if N == 1 { "one finite number".into() } else { format!("{N} finite numbers") };
            let reason = format!("{attribute} = \"{}\" is not {expected}", shown(text));
            self.error_at(attribute, reason, format!("write {expected}, with points as decimal marks"))
        })
    }
    /// Returns one number.
    pub fn number(&self, attribute: &str) -> Result<Option<f64>, Failure> {
        Ok(self.numbers::<1>(attribute)?.map(|[number]| number))
    }
    /// Returns a required number.
    pub fn required_number(&self, attribute: &str) -> Result<f64, Failure> {
        self.number(attribute)?.ok_or_else(|| self.missing(attribute))
    }
    /// Returns a number that must not be negative, or 0 if the attribute is missing.
    pub fn magnitude(&self, attribute: &str) -> Result<f64, Failure> {
        match self.number(attribute)?.unwrap_or(0.0) {
            value if value < 0.0 => Err(self.error_at(
                attribute,
                format!("{attribute} = {value} is negative"),
                "write zero or a positive number",
            )),
            value => Ok(value),
        }
    }
    /// Returns a vector.
    pub fn vector(&self, attribute: &str) -> Result<Option<Vector3<f64>>, Failure> {
        Ok(self.numbers::<3>(attribute)?.map(Vector3::from))
    }
    /// Returns a direction.
    pub fn direction(&self, attribute: &str) -> Result<Option<Unit<Vector3<f64>>>, Failure> {
        let Some(vector) = self.vector(attribute)? else { return Ok(None) };
        Unit::try_new(vector, 1e-9).map(Some).ok_or_else(|| {
            self.error_at(attribute, format!("{attribute} has no direction"), "write a vector that is not zero")
        })
    }
    /// Returns the error of a missing attribute.
    fn missing(&self, attribute: &str) -> Failure {
        self.error(format!("`{attribute}` is missing"), format!("add {attribute}=\"…\""))
    }
    /// Returns an error at this element.
    pub fn error(&self, reason: impl Into<String>, remedy: impl Into<String>) -> Failure {
        self.failure(self.node.range().start, &reason.into(), &remedy.into())
    }
    /// Returns an error at an attribute of this element, or at the element if the attribute is missing.
    pub fn error_at(&self, attribute: &str, reason: impl Into<String>, remedy: impl Into<String>) -> Failure {
        let start = self.node.attribute_node(attribute).map_or(self.node.range().start, |found| found.range().start);
        self.failure(start, &reason.into(), &remedy.into())
    }

    fn failure(&self, offset: usize, reason: &str, remedy: &str) -> Failure {
        let at = self.node.document().text_pos_at(offset);
        let file = self.origin.display();
        Failure::wrong(format!("{file}:{}:{}: {}: {reason}", at.row, at.col, self.describe())).remedy(remedy)
    }
    /// Returns the tag with the name, or with the closest named element around it.
    fn describe(&self) -> String {
        let named = |node: Node<'_, '_>| {
            let name = node.attribute("name").map_or(String::new(), |name| format!(" name=\"{}\"", shown(name)));
            format!("<{}{name}>", node.tag_name().name())
        };
        let around = self.node.ancestors().skip(1).find(|node| node.has_attribute("name"));
        match around {
            Some(around) if !self.node.has_attribute("name") => format!("{} in {}", named(self.node), named(around)),
            _ => named(self.node),
        }
    }
}

/// Shortens a text from the file for a message of one line.
fn shown(text: &str) -> String {
    let short: String = text.chars().take(60).collect();
    let dots = if short.len() < text.len() { "…" } else { "" };
    format!("{}{dots}", on_one_line(&short))
}

/// Returns a displacement after a rotation.
pub(crate) fn pose(position: Vector3<f64>, rotation: UnitQuaternion<f64>) -> Isometry3<f64> {
    Isometry3::from_parts(Translation3::from(position), rotation)
}
