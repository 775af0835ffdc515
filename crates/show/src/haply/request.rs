//! A program's message in Haply's JSON: forces as `values` (3.1) or `vector` (3.5), and the requested axes.

use serde_json::Value;
use std::fmt;
use std::str::FromStr;

/// The requests in one message of a program.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ProgramRequest {
    /// Force, N, in the program's axes; `None` if the message has no force or marks it as not to be executed.
    pub force: Option<[f64; 3]>,
    /// True if the program requests the full state once.
    pub full: bool,
    /// Axes of the program's vectors from now on, both sent and received; `None` to keep the present axes.
    pub basis: Option<Basis>,
    /// True if the program requests to clear a latched fault, a command that Haply does not have.
    pub clear_fault: bool,
    /// Commands and settings that a board does not support.
    pub others: Vec<String>,
    /// True if a part of the message is for another device.
    pub for_other_device: bool,
}

impl ProgramRequest {
    /// Parses a message, from a text or a binary frame, for the device with this id.
    pub fn parse(message: &[u8], id: &str) -> Result<Self, String> {
        let message: Value = serde_json::from_slice(message).map_err(|error| format!("not JSON: {error}"))?;
        let mut request = Self::default();
        for (name, value) in entries(&message["session"]) {
            match name.as_str() {
                "force_render_full_state" => request.full = !value.is_null(),
                "configure" => request.configure(value)?,
                other => request.others.push(format!("session.{other}")),
            }
        }
        for device in message["inverse3"].as_array().into_iter().flatten() {
            if device["device_id"] != id {
                request.for_other_device = true;
                continue;
            }
            request.configure(&device["configure"])?;
            for (name, command) in entries(&device["commands"]) {
                match name.as_str() {
                    "set_cursor_force" => {
                        let vector = if command["vector"].is_null() { &command["values"] } else { &command["vector"] };
                        let entry = |axis: &str| vector[axis].as_f64().filter(|newtons| newtons.is_finite());
                        let (Some(x), Some(y), Some(z)) = (entry("x"), entry("y"), entry("z")) else {
                            return Err("set_cursor_force needs the numbers x, y and z in vector or values".into());
                        };
                        request.force = (command["execute"] != false).then_some([x, y, z]);
                    }
                    "probe_position" => {}
                    "clear_fault" => request.clear_fault = true,
                    other => request.others.push(other.into()),
                }
            }
        }
        Ok(request)
    }

    fn configure(&mut self, settings: &Value) -> Result<(), String> {
        for (name, value) in entries(settings) {
            match name.as_str() {
                "basis" => self.basis = Some(value["permutation"].as_str().unwrap_or_default().parse()?),
                // The name of the program, which has no effect.
                "profile" => {}
                other => self.others.push(format!("configure.{other}")),
            }
        }
        Ok(())
    }
}

fn entries(value: &Value) -> impl Iterator<Item = (&String, &Value)> {
    value.as_object().into_iter().flatten()
}

/// The mapping from Haply's axes to x, y and z of a program: Haply's axis and the sign of each.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Basis([(usize, f64); 3]);

const AXIS_LETTERS: [char; 3] = ['X', 'Y', 'Z'];

impl Default for Basis {
    fn default() -> Self {
        Self([0, 1, 2].map(|axis| (axis, 1.0)))
    }
}

impl Basis {
    /// Converts a vector from Haply's axes to the program's.
    pub fn to_program(self, haply: [f64; 3]) -> [f64; 3] {
        self.0.map(|(axis, sign)| 0.0 + sign * haply[axis])
    }

    /// Converts a vector from the program's axes to Haply's.
    pub fn to_haply(self, program: [f64; 3]) -> [f64; 3] {
        let mut haply = [0.0; 3];
        for ((axis, sign), value) in self.0.into_iter().zip(program) {
            haply[axis] = sign * value;
        }
        haply
    }
}

impl FromStr for Basis {
    type Err = String;

    /// Parses a text such as `X-ZY`.
    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || {
            format!("`{text}` is not a basis: write X, Y and Z in the program's order, with - before a reversed axis")
        };
        let (mut axes, mut sign) = (Vec::new(), 1.0);
        for letter in text.chars() {
            match AXIS_LETTERS.iter().position(|axis| *axis == letter) {
                Some(axis) => axes.push((axis, std::mem::replace(&mut sign, 1.0))),
                None if letter == '-' => sign = -1.0,
                None if letter == '+' => {}
                None => return Err(wrong()),
            }
        }
        let axes: [(usize, f64); 3] = axes.try_into().map_err(|_| wrong())?;
        let all = (0..3).all(|axis| axes.iter().any(|(other, _)| *other == axis));
        if all && sign > 0.0 { Ok(Self(axes)) } else { Err(wrong()) }
    }
}

impl fmt::Display for Basis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|(axis, sign)| {
            let sign = if *sign < 0.0 { "-" } else { "" };
            write!(f, "{sign}{}", AXIS_LETTERS[*axis])
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<ProgramRequest, String> {
        ProgramRequest::parse(text.as_bytes(), "A")
    }

    #[test]
    fn forces_are_read_in_both_spellings_for_this_device_only() {
        let request = |commands: &str| {
            parse(&format!("{{\"session\":{{}},\"inverse3\":[{{\"device_id\":\"A\",\"commands\":{commands}}}]}}"))
        };
        let force = Some([1.0, -2.0, 0.5]);
        let vector = "{\"x\":1.0,\"y\":-2,\"z\":0.5}";
        assert_eq!(request(&format!("{{\"set_cursor_force\":{{\"values\":{vector}}}}}")).unwrap().force, force);
        let new = format!("{{\"set_cursor_force\":{{\"vector\":{vector},\"execute\":true}}}}");
        assert_eq!(request(&new).unwrap().force, force);
        assert_eq!(parse(&new.replace("set", "get")), Ok(ProgramRequest::default()));
        assert_eq!(request(&new.replace("true", "false")).unwrap(), ProgramRequest::default());
        assert_eq!(request("{\"probe_position\":{}}").unwrap(), ProgramRequest::default());
        assert_eq!(request("{\"set_cursor_position\":{}}").unwrap().others, ["set_cursor_position"]);
        assert!(request("{\"set_cursor_force\":{\"values\":{\"x\":1}}}").is_err());
        assert!(parse("{").is_err());
        let other = format!("{{\"inverse3\":[{{\"device_id\":\"B\",\"commands\":{new}}}]}}");
        assert_eq!(parse(&other), Ok(ProgramRequest { for_other_device: true, ..ProgramRequest::default() }));
        assert!(parse("{\"session\":{\"force_render_full_state\":{}}}").unwrap().full);
    }

    #[test]
    fn the_basis_is_read_and_other_settings_are_listed() {
        let session =
            parse("{\"session\":{\"configure\":{\"basis\":{\"permutation\":\"XZY\"},\"profile\":{}}}}").unwrap();
        assert_eq!((session.basis.unwrap().to_string(), session.others.len()), ("XZY".into(), 0));
        let device = "{\"basis\":{\"permutation\":\"YZ-X\"},\"damping\":{\"scalar\":5},\"preset\":{}}";
        let device = parse(&format!("{{\"inverse3\":[{{\"device_id\":\"A\",\"configure\":{device}}}]}}")).unwrap();
        assert_eq!(device.others, ["configure.damping", "configure.preset"]);
        // The program's x is Haply's y, its y Haply's z, its z Haply's x reversed.
        let basis = device.basis.unwrap();
        assert_eq!(basis.to_program([1.0, 2.0, 3.0]), [2.0, 3.0, -1.0]);
        assert_eq!(basis.to_haply([2.0, 3.0, -1.0]), [1.0, 2.0, 3.0]);
        for wrong in ["", "XY", "XYX", "XYZZ", "XYZ-", "xyz", "X Y Z"] {
            assert!(wrong.parse::<Basis>().is_err(), "{wrong}");
        }
    }
}
