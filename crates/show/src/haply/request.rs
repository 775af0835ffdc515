//! A program's request in the JSON of Haply's service: forces in both of its spellings, `values` (3.1) and `vector`
//! (3.5), and the axes that it wants them in.

use serde_json::Value;
use std::fmt;
use std::str::FromStr;

/// The request in one message of a program.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Wish {
    /// Force, N, in the program's axes; `None` if the message has no force or marks it as not to be executed.
    pub force: Option<[f64; 3]>,
    /// It asks for the full state once.
    pub full: bool,
    /// The axes in which it speaks and is spoken to from now on.
    pub basis: Option<Basis>,
    /// It asks that a latched fault be cleared: no command of Haply's.
    pub clear_fault: bool,
    /// Commands and settings that a board has nothing for.
    pub others: Vec<String>,
    /// Part of it is for a device that is not this one.
    pub elsewhere: bool,
}

impl Wish {
    /// Reads a message, of a text frame or a binary one, for the device with this id.
    pub fn parse(message: &[u8], id: &str) -> Result<Self, String> {
        let message: Value = serde_json::from_slice(message).map_err(|error| format!("not JSON: {error}"))?;
        let mut wish = Self::default();
        for (name, value) in entries(&message["session"]) {
            match name.as_str() {
                "force_render_full_state" => wish.full = !value.is_null(),
                "configure" => wish.configure(value)?,
                other => wish.others.push(format!("session.{other}")),
            }
        }
        for device in message["inverse3"].as_array().into_iter().flatten() {
            if device["device_id"] != id {
                wish.elsewhere = true;
                continue;
            }
            wish.configure(&device["configure"])?;
            for (name, command) in entries(&device["commands"]) {
                match name.as_str() {
                    "set_cursor_force" => {
                        let vector = if command["vector"].is_null() { &command["values"] } else { &command["vector"] };
                        let entry = |axis: &str| vector[axis].as_f64().filter(|newtons| newtons.is_finite());
                        let (Some(x), Some(y), Some(z)) = (entry("x"), entry("y"), entry("z")) else {
                            return Err("set_cursor_force without the numbers x, y and z in vector or values".into());
                        };
                        wish.force = (command["execute"] != false).then_some([x, y, z]);
                    }
                    "probe_position" => {}
                    "clear_fault" => wish.clear_fault = true,
                    other => wish.others.push(other.into()),
                }
            }
        }
        Ok(wish)
    }

    fn configure(&mut self, settings: &Value) -> Result<(), String> {
        for (name, value) in entries(settings) {
            match name.as_str() {
                "basis" => self.basis = Some(value["permutation"].as_str().unwrap_or_default().parse()?),
                // The program's name.
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

/// Which of Haply's axes a program's x, y and z are, and which way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Basis([(usize, f64); 3]);

const LETTERS: [char; 3] = ['X', 'Y', 'Z'];

impl Default for Basis {
    fn default() -> Self {
        Self([0, 1, 2].map(|axis| (axis, 1.0)))
    }
}

impl Basis {
    /// A vector in Haply's axes in the program's.
    pub fn to_program(self, haply: [f64; 3]) -> [f64; 3] {
        self.0.map(|(axis, sign)| 0.0 + sign * haply[axis])
    }

    /// And back.
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

    /// Such as `X-ZY`.
    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || {
            format!("`{text}` is no basis: write X, Y and Z in the program's order, with - before one that is reversed")
        };
        let (mut axes, mut sign) = (Vec::new(), 1.0);
        for letter in text.chars() {
            match LETTERS.iter().position(|axis| *axis == letter) {
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
            write!(f, "{sign}{}", LETTERS[*axis])
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Wish, String> {
        Wish::parse(text.as_bytes(), "A")
    }

    #[test]
    fn forces_are_read_in_both_spellings_and_only_for_this_device() {
        let wish = |commands: &str| {
            parse(&format!("{{\"session\":{{}},\"inverse3\":[{{\"device_id\":\"A\",\"commands\":{commands}}}]}}"))
        };
        let force = Some([1.0, -2.0, 0.5]);
        let vector = "{\"x\":1.0,\"y\":-2,\"z\":0.5}";
        assert_eq!(wish(&format!("{{\"set_cursor_force\":{{\"values\":{vector}}}}}")).unwrap().force, force);
        let new = format!("{{\"set_cursor_force\":{{\"vector\":{vector},\"execute\":true}}}}");
        assert_eq!(wish(&new).unwrap().force, force);
        assert_eq!(parse(&new.replace("set", "get")), Ok(Wish::default()));
        assert_eq!(wish(&new.replace("true", "false")).unwrap(), Wish::default());
        assert_eq!(wish("{\"probe_position\":{}}").unwrap(), Wish::default());
        assert_eq!(wish("{\"set_cursor_position\":{}}").unwrap().others, ["set_cursor_position"]);
        assert!(wish("{\"set_cursor_force\":{\"values\":{\"x\":1}}}").is_err());
        assert!(parse("{").is_err());
        let other = format!("{{\"inverse3\":[{{\"device_id\":\"B\",\"commands\":{new}}}]}}");
        assert_eq!(parse(&other), Ok(Wish { elsewhere: true, ..Wish::default() }));
        assert!(parse("{\"session\":{\"force_render_full_state\":{}}}").unwrap().full);
    }

    #[test]
    fn a_basis_is_set_for_session_or_device_and_every_other_setting_is_named() {
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
        for none in ["", "XY", "XYX", "XYZZ", "XYZ-", "xyz", "X Y Z"] {
            assert!(none.parse::<Basis>().is_err(), "{none}");
        }
    }
}
