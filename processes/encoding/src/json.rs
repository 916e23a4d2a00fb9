//! Wire messages → JSON, for scripts and for tests.

use ipc_types::wire::{Field, Kind};
use serde_json::{Map, Value};

/// A message as JSON: a header's fields, and `elements` where they are structs.
pub fn to_json(header: Kind, header_bytes: &[u8], element: Kind, elements: &[u8]) -> Value {
    let mut value = fields_of(header.fields(), header_bytes);
    if matches!(element, Kind::Struct(_)) {
        let elements =
            elements.chunks_exact(element.bytes()).map(|bytes| Value::Object(fields_of(element.fields(), bytes)));
        value.insert("elements".to_owned(), elements.collect());
    }
    Value::Object(value)
}

fn fields_of(fields: &[Field], bytes: &[u8]) -> Map<String, Value> {
    let value = |field: &Field| {
        let bytes = bytes.get(field.offset..field.offset + field.kind.bytes());
        (field.name.to_owned(), bytes.map_or(Value::Null, |bytes| value_of(field.kind, bytes)))
    };
    fields.iter().map(value).collect()
}

/// Numbers that JSON has none of (infinite ones, those that are not a number) are null.
fn value_of(kind: Kind, bytes: &[u8]) -> Value {
    match (kind, bytes) {
        (Kind::U8, &[a]) => a.into(),
        (Kind::U16, &[a, b]) => u16::from_ne_bytes([a, b]).into(),
        (Kind::U32, &[a, b, c, d]) => u32::from_ne_bytes([a, b, c, d]).into(),
        (Kind::F32, &[a, b, c, d]) => f32::from_ne_bytes([a, b, c, d]).into(),
        (Kind::U64, &[a, b, c, d, e, f, g, h]) => u64::from_ne_bytes([a, b, c, d, e, f, g, h]).into(),
        (Kind::I64, &[a, b, c, d, e, f, g, h]) => i64::from_ne_bytes([a, b, c, d, e, f, g, h]).into(),
        (Kind::F64, &[a, b, c, d, e, f, g, h]) => f64::from_ne_bytes([a, b, c, d, e, f, g, h]).into(),
        (Kind::Text, bytes) => {
            let end = bytes.iter().position(|&byte| byte == 0).unwrap_or(bytes.len());
            String::from_utf8_lossy(&bytes[..end]).into_owned().into()
        }
        (Kind::Array(kind, _), bytes) => bytes.chunks_exact(kind.bytes()).map(|bytes| value_of(*kind, bytes)).collect(),
        (Kind::Struct(shape), bytes) => Value::Object(fields_of(shape.fields, bytes)),
        _ => Value::Null,
    }
}
