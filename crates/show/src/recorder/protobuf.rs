//! Protocol buffers of a recording's numbers and texts, and the `FileDescriptorSet` that describes them.

use prost_reflect::prost::Message as _;
use prost_reflect::prost_types::field_descriptor_proto::Label;
use prost_reflect::prost_types::{
    DescriptorProto, EnumDescriptorProto, EnumValueDescriptorProto, FieldDescriptorProto, FileDescriptorProto,
};
use prost_reflect::{DescriptorPool, DynamicMessage, Kind, MessageDescriptor, Value};

pub use prost_reflect::prost_types::field_descriptor_proto::Type;

/// Full name of a time's message.
const TIMESTAMP: &str = "google.protobuf.Timestamp";

/// Name and type of a message's field. Fields are numbered from 1 in their order.
pub type Field = (String, Type);

/// Describes a message `PACKAGE.NAME`. A field of type [`Type::Message`] is a timestamp; fields of type [`Type::Enum`]
/// are of the enum `PACKAGE.ENUM`, with these words.
///
/// # Errors
///
/// Returns an error for names that are not identifiers of the format, and for duplicate names.
pub fn describe(message: &str, fields: &[Field], (kind, words): (&str, &[&str])) -> Result<MessageDescriptor, String> {
    let (package, name) = message.split_once('.').unwrap_or(("haptic", message));
    let has_time = fields.iter().any(|(_, kind)| *kind == Type::Message);
    let field = |(index, (name, field_kind)): (usize, &Field)| FieldDescriptorProto {
        name: Some(name.clone()),
        number: Some(index as i32 + 1),
        label: Some(Label::Optional.into()),
        r#type: Some((*field_kind).into()),
        type_name: match field_kind {
            Type::Enum => Some(format!(".{package}.{kind}")),
            Type::Message => Some(format!(".{TIMESTAMP}")),
            _ => None,
        },
        json_name: Some(name.clone()),
        ..FieldDescriptorProto::default()
    };
    let word = |(number, word): (usize, &&str)| EnumValueDescriptorProto {
        name: Some((*word).into()),
        number: Some(number as i32),
        options: None,
    };
    let words_of_kind = EnumDescriptorProto {
        name: Some(kind.into()),
        value: words.iter().enumerate().map(word).collect(),
        ..EnumDescriptorProto::default()
    };
    let file = FileDescriptorProto {
        name: Some(format!("{package}/{name}.proto")),
        package: Some(package.into()),
        dependency: if has_time { vec!["google/protobuf/timestamp.proto".into()] } else { Vec::new() },
        message_type: vec![DescriptorProto {
            name: Some(name.into()),
            field: fields.iter().enumerate().map(field).collect(),
            ..DescriptorProto::default()
        }],
        enum_type: if words.is_empty() { Vec::new() } else { vec![words_of_kind] },
        // proto2 writes every field that is set, also 0 and -0; proto3 leaves them out.
        syntax: Some("proto2".into()),
        ..FileDescriptorProto::default()
    };
    let mut pool = if has_time { DescriptorPool::global() } else { DescriptorPool::new() };
    pool.add_file_descriptor_proto(file).map_err(|error| error.to_string())?;
    pool.get_message_by_name(message).ok_or_else(|| format!("{message} is not described"))
}

/// Returns the message with this full name from a schema.
pub fn find_message(set: &[u8], message: &str) -> Option<MessageDescriptor> {
    DescriptorPool::decode(set).ok()?.get_message_by_name(message)
}

/// Returns the names of a message's fields, in the order of their numbers.
pub fn field_names(message: &MessageDescriptor) -> Vec<String> {
    message.fields().map(|field| field.name().to_owned()).collect()
}

/// Encodes a message from one number per field, in the order of field numbers, each in its field's type.
pub fn encode_numbers(message: &MessageDescriptor, numbers: impl IntoIterator<Item = f64>) -> Vec<u8> {
    let mut packed = DynamicMessage::new(message.clone());
    for (field, number) in message.fields().zip(numbers) {
        packed.set_field(
            &field,
            match field.kind() {
                Kind::Float => Value::F32(number as f32),
                Kind::Uint32 => Value::U32(number as u32),
                Kind::Sfixed32 => Value::I32(number as i32),
                Kind::Enum(_) => Value::EnumNumber(number as i32),
                _ => Value::F64(number),
            },
        );
    }
    packed.encode_to_vec()
}

/// Encodes a `foxglove.Log`: its time since 1970 (ns), its level and its text.
pub fn pack_log(log: &MessageDescriptor, time_ns: u64, level: i32, text: &str) -> Vec<u8> {
    let mut packed = DynamicMessage::new(log.clone());
    let (seconds, nanos) = ((time_ns / 1_000_000_000) as i64, (time_ns % 1_000_000_000) as i32);
    let decode_numbers = log.fields().map(|field| match field.kind() {
        Kind::Message(timestamp) => {
            let mut time = DynamicMessage::new(timestamp);
            time.set_field_by_name("seconds", Value::I64(seconds));
            time.set_field_by_name("nanos", Value::I32(nanos));
            (field, Value::Message(time))
        }
        Kind::Enum(_) => (field, Value::EnumNumber(level)),
        _ => (field, Value::String(text.into())),
    });
    decode_numbers.for_each(|(field, value)| packed.set_field(&field, value));
    packed.encode_to_vec()
}

/// Decodes the numbers of a message, in the order of field numbers: 0 for a missing field; NaN for a field that is not
/// a number, and for all fields of an incomplete message.
pub fn decode_numbers(message: &MessageDescriptor, bytes: &[u8]) -> Vec<f64> {
    let decoded = DynamicMessage::decode(message.clone(), bytes);
    let number = |field| match decoded.as_ref().ok().map(|message| message.get_field(&field).into_owned()) {
        Some(Value::F64(number)) => number,
        Some(Value::F32(number)) => number.into(),
        Some(Value::U32(number)) => number.into(),
        Some(Value::I32(number) | Value::EnumNumber(number)) => number.into(),
        _ => f64::NAN,
    };
    message.fields().map(number).collect()
}

/// Decodes the first text of a message.
pub fn first_text(message: &MessageDescriptor, bytes: &[u8]) -> Option<String> {
    let decoded = DynamicMessage::decode(message.clone(), bytes).ok()?;
    message.fields().find_map(|field| decoded.get_field(&field).as_str().map(Into::into))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fields(fields: &[(&str, Type)]) -> Vec<Field> {
        fields.iter().map(|(name, kind)| (name.to_string(), *kind)).collect()
    }

    #[test]
    fn packed_messages_are_decoded_with_their_description() {
        let kinds = [("step", Type::Uint32), ("time_s", Type::Double), ("q0", Type::Float), ("n", Type::Sfixed32)];
        let written = describe("haptic.Row", &fields(&kinds), ("", &[])).unwrap();
        let set = written.parent_pool().encode_to_vec();
        let read = find_message(&set, "haptic.Row").unwrap();
        assert_eq!(field_names(&read), kinds.map(|(name, _)| name));
        assert!(find_message(&set, "haptic.Column").is_none());
        for row in [[4e9, -0.1, f64::from(0.1_f32), -2_147_483_648.0], [0.0, -0.0, -0.0, 0.0]] {
            let bits = |row: &[f64]| row.iter().map(|number| number.to_bits()).collect::<Vec<_>>();
            assert_eq!(bits(&decode_numbers(&read, &encode_numbers(&written, row))), bits(&row));
        }
        assert_eq!(decode_numbers(&read, &[])[1..], [0.0; 3], "a missing field is 0");
    }

    /// The example of the protocol buffers documentation: a message with field 1 set to 150 is 08 96 01.
    #[test]
    fn numbers_are_packed_as_in_the_documentation() {
        let row = describe("haptic.Row", &fields(&[("a", Type::Uint32)]), ("", &[])).unwrap();
        assert_eq!(encode_numbers(&row, [150.0]), [0x08, 0x96, 0x01]);
        // Seconds and nanoseconds of a timestamp, an enum's number, a text.
        let kinds = [("timestamp", Type::Message), ("level", Type::Enum), ("message", Type::String)];
        let log = describe("foxglove.Log", &fields(&kinds), ("Level", &["UNKNOWN", "DEBUG"])).unwrap();
        let packed = pack_log(&log, 150_000_000_001, 1, "testing");
        let bytes = [0x0a, 5, 0x08, 0x96, 0x01, 0x10, 1, 0x10, 1, 0x1a, 7, 0x74, 0x65, 0x73, 0x74, 0x69, 0x6e, 0x67];
        assert_eq!(packed, bytes);
        assert_eq!(first_text(&log, &packed).as_deref(), Some("testing"));
    }
}
