//! As much of protocol buffers as a recording needs: messages of plain numbers and texts, and their description.
//!
//! The description is a `FileDescriptorSet`, which is what an MCAP file carries as the schema of such messages. Its
//! fields' numbers are those of descriptor.proto.

/// What a field holds, by its number in descriptor.proto.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// 64-bit float.
    Double = 1,
    /// 32-bit float.
    Float = 2,
    /// Unsigned, 32 bits, as short as it can be.
    Uint32 = 13,
    /// One of a few.
    Enum = 14,
    /// Text.
    Text = 9,
    /// Signed, 32 bits.
    Sfixed32 = 15,
}

impl Kind {
    const ALL: [Self; 6] = [Self::Double, Self::Float, Self::Uint32, Self::Enum, Self::Text, Self::Sfixed32];

    /// How its bytes are told apart on the wire.
    fn wire(self) -> u64 {
        match self {
            Self::Uint32 | Self::Enum => 0,
            Self::Double => 1,
            Self::Text => 2,
            Self::Float | Self::Sfixed32 => 5,
        }
    }
}

/// A field of a message: its name and kind. Fields are numbered from 1 in their order.
pub type Field = (String, Kind);

fn varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

fn number(out: &mut Vec<u8>, field: u64, value: u64) {
    varint(out, field << 3);
    varint(out, value);
}

/// A text, or a message within one.
pub fn text(out: &mut Vec<u8>, field: u64, bytes: impl AsRef<[u8]>) {
    let bytes = bytes.as_ref();
    varint(out, field << 3 | 2);
    varint(out, bytes.len() as u64);
    out.extend(bytes);
}

/// A number, as its field's kind has it.
pub fn value(out: &mut Vec<u8>, field: u64, kind: Kind, value: f64) {
    varint(out, field << 3 | kind.wire());
    match kind {
        Kind::Double => out.extend(value.to_le_bytes()),
        Kind::Float => out.extend((value as f32).to_le_bytes()),
        Kind::Sfixed32 => out.extend((value as i64 as i32).to_le_bytes()),
        Kind::Uint32 | Kind::Enum => varint(out, u64::from(value as u32)),
        Kind::Text => varint(out, 0),
    }
}

/// Describes a message `haptic.NAME` and the words of its enum fields, which are all of one enum, `haptic.WORDS`.
pub fn describe(name: &str, fields: &[Field], words: (&str, &[&str])) -> Vec<u8> {
    let mut message = Vec::new();
    text(&mut message, 1, name);
    for (index, (field, kind)) in fields.iter().enumerate() {
        let mut described = Vec::new();
        text(&mut described, 1, field);
        number(&mut described, 3, index as u64 + 1);
        // Optional: there is at most one.
        number(&mut described, 4, 1);
        number(&mut described, 5, *kind as u64);
        if *kind == Kind::Enum {
            text(&mut described, 6, format!(".haptic.{}", words.0));
        }
        text(&mut described, 10, field);
        text(&mut message, 2, described);
    }
    let mut file = Vec::new();
    text(&mut file, 1, format!("haptic/{}.proto", name.to_lowercase()));
    text(&mut file, 2, "haptic");
    text(&mut file, 4, message);
    if !words.1.is_empty() {
        let mut choice = Vec::new();
        text(&mut choice, 1, words.0);
        for (index, word) in words.1.iter().enumerate() {
            let mut described = Vec::new();
            text(&mut described, 1, word);
            number(&mut described, 2, index as u64);
            text(&mut choice, 2, described);
        }
        text(&mut file, 5, choice);
    }
    text(&mut file, 12, "proto3");
    let mut set = Vec::new();
    text(&mut set, 1, file);
    set
}

/// One field as it stands in a message.
enum Found<'a> {
    Number(u64),
    Bytes(&'a [u8]),
    Four([u8; 4]),
    Eight([u8; 8]),
}

/// Takes the next field off a message: its number and its content; `None` at the end and for what is not a field.
fn next<'a>(bytes: &mut &'a [u8]) -> Option<(u64, Found<'a>)> {
    fn varint(bytes: &mut &[u8]) -> Option<u64> {
        let mut value = 0;
        for shift in (0..64).step_by(7) {
            let (first, rest) = bytes.split_first()?;
            *bytes = rest;
            value |= u64::from(first & 0x7f) << shift;
            if first & 0x80 == 0 {
                return Some(value);
            }
        }
        None
    }
    let tag = varint(bytes)?;
    let found = match tag & 7 {
        0 => Found::Number(varint(bytes)?),
        1 => {
            let (eight, rest) = bytes.split_first_chunk()?;
            *bytes = rest;
            Found::Eight(*eight)
        }
        2 => {
            let length = usize::try_from(varint(bytes)?).ok()?;
            let (found, rest) = bytes.split_at_checked(length)?;
            *bytes = rest;
            Found::Bytes(found)
        }
        5 => {
            let (four, rest) = bytes.split_first_chunk()?;
            *bytes = rest;
            Found::Four(*four)
        }
        _ => return None,
    };
    Some((tag >> 3, found))
}

/// The fields that a description gives a message, as far as their kinds are known here; with their numbers.
pub fn described(mut set: &[u8], message: &str) -> Vec<(u64, Field)> {
    let mut fields = Vec::new();
    while let Some((field, Found::Bytes(mut file))) = next(&mut set) {
        while let Some((inner, found)) = next(&mut file) {
            if let (1, 4, Found::Bytes(described)) = (field, inner, found) {
                let (name, mut found) = one_message(described);
                if name == message {
                    fields.append(&mut found);
                }
            }
        }
    }
    fields
}

fn one_message(mut described: &[u8]) -> (String, Vec<(u64, Field)>) {
    let (mut name, mut fields) = (String::new(), Vec::new());
    while let Some((field, found)) = next(&mut described) {
        match (field, found) {
            (1, Found::Bytes(text)) => name = String::from_utf8_lossy(text).into(),
            (2, Found::Bytes(mut one)) => {
                let (mut name, mut number, mut kind) = (String::new(), 0, None);
                while let Some((part, found)) = next(&mut one) {
                    match (part, found) {
                        (1, Found::Bytes(text)) => name = String::from_utf8_lossy(text).into(),
                        (3, Found::Number(value)) => number = value,
                        (5, Found::Number(value)) => kind = Kind::ALL.into_iter().find(|kind| *kind as u64 == value),
                        _ => {}
                    }
                }
                fields.extend(kind.map(|kind| (number, (name, kind))));
            }
            _ => {}
        }
    }
    (name, fields)
}

/// A message's numbers in the order of `fields`: 0 where one is left out, as proto3 has it; NaN in the place of a text.
pub fn values(mut message: &[u8], fields: &[(u64, Field)]) -> Vec<f64> {
    let mut row: Vec<f64> =
        fields.iter().map(|(_, (_, kind))| if *kind == Kind::Text { f64::NAN } else { 0.0 }).collect();
    while let Some((field, found)) = next(&mut message) {
        let Some(column) = fields.iter().position(|(number, _)| *number == field) else { continue };
        row[column] = match (fields[column].1.1, found) {
            (Kind::Double, Found::Eight(bytes)) => f64::from_le_bytes(bytes),
            (Kind::Float, Found::Four(bytes)) => f32::from_le_bytes(bytes).into(),
            (Kind::Sfixed32, Found::Four(bytes)) => i32::from_le_bytes(bytes).into(),
            (Kind::Uint32 | Kind::Enum, Found::Number(value)) => f64::from(value as u32),
            _ => f64::NAN,
        };
    }
    row
}

/// The first text of a message.
pub fn first_text(mut message: &[u8]) -> Option<String> {
    while let Some((_, found)) = next(&mut message) {
        if let Found::Bytes(bytes) = found {
            return Some(String::from_utf8_lossy(bytes).into());
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_packed_is_unpacked_by_its_description() {
        let fields: Vec<Field> =
            [("step", Kind::Uint32), ("time_s", Kind::Double), ("q0", Kind::Float), ("n", Kind::Sfixed32)]
                .map(|(name, kind)| (name.to_string(), kind))
                .into();
        let set = describe("Row", &fields, ("State", &["Off", "On"]));
        let found = described(&set, "Row");
        assert_eq!(found.iter().map(|(_, field)| field.clone()).collect::<Vec<_>>(), fields);
        assert_eq!(described(&set, "Column"), []);
        let row = [4e9, -0.1, f64::from(0.1_f32), -2_147_483_648.0];
        let mut message = Vec::new();
        for ((number, (_, kind)), number_of_row) in found.iter().zip(row) {
            value(&mut message, *number, *kind, number_of_row);
        }
        assert_eq!(values(&message, &found), row);
        assert_eq!(values(&message[..3], &found)[1..], [0.0; 3], "what is not there is 0");
    }

    /// The bytes of docs.protobuf's own example: a message with field 1 set to 150 is 08 96 01.
    #[test]
    fn numbers_are_packed_as_the_format_says() {
        let mut out = Vec::new();
        value(&mut out, 1, Kind::Uint32, 150.0);
        assert_eq!(out, [0x08, 0x96, 0x01]);
        text(&mut out, 2, "testing");
        assert_eq!(out[3..], [0x12, 0x07, 0x74, 0x65, 0x73, 0x74, 0x69, 0x6e, 0x67]);
    }
}
