//! Wire messages → protobuf.

use crate::schema::ELEMENTS;
use ipc_types::topics::Topic;
use ipc_types::wire::{Field, Kind};
use prost::encoding::{WireType, encode_key, encode_varint};

/// Appends a message: a header's bytes, and those of its elements where they are structs. Pixels are left out.
///
/// Zeros are left out, as proto3 has it; a zero with a sign is not one.
pub fn encode(header: Kind, header_bytes: &[u8], element: Kind, elements: &[u8], out: &mut Vec<u8>) {
    put_fields(header.fields(), header_bytes, out);
    if matches!(element, Kind::Struct(_)) {
        for bytes in elements.chunks_exact(element.bytes()) {
            put_message(ELEMENTS, element.fields(), bytes, out);
        }
    }
}

/// Appends a message of a topic.
pub fn encode_message<T: Topic>(header: &T::Header, elements: &[T::Element], out: &mut Vec<u8>) {
    let (header, elements) = (bytemuck::bytes_of(header), bytemuck::cast_slice(elements));
    encode(T::INFO.header, header, T::INFO.element, elements, out);
}

fn put_fields(fields: &[Field], bytes: &[u8], out: &mut Vec<u8>) {
    for (number, field) in (1..).zip(fields) {
        if let Some(bytes) = bytes.get(field.offset..field.offset + field.kind.bytes()) {
            put(number, field.kind, bytes, out);
        }
    }
}

fn put(number: u32, kind: Kind, bytes: &[u8], out: &mut Vec<u8>) {
    match kind {
        Kind::Struct(shape) => put_message(number, shape.fields, bytes, out),
        Kind::Array(kind, _) => {
            let mut packed = Vec::with_capacity(bytes.len());
            bytes.chunks_exact(kind.bytes()).for_each(|bytes| put_scalar(*kind, bytes, &mut packed));
            put_delimited(number, &packed, out);
        }
        Kind::Text => {
            let end = bytes.iter().position(|&byte| byte == 0).unwrap_or(bytes.len());
            if end > 0 {
                // What is no text is replaced, which may need more room than there is.
                let text = String::from_utf8_lossy(&bytes[..end]);
                put_delimited(number, &text.as_bytes()[..text.floor_char_boundary(bytes.len())], out);
            }
        }
        _ if bytes.iter().all(|&byte| byte == 0) => {}
        _ => {
            encode_key(number, wire_type(kind), out);
            put_scalar(kind, bytes, out);
        }
    }
}

fn put_message(number: u32, fields: &[Field], bytes: &[u8], out: &mut Vec<u8>) {
    let mut message = Vec::with_capacity(bytes.len());
    put_fields(fields, bytes, &mut message);
    put_delimited(number, &message, out);
}

fn put_delimited(number: u32, content: &[u8], out: &mut Vec<u8>) {
    encode_key(number, WireType::LengthDelimited, out);
    encode_varint(content.len() as u64, out);
    out.extend_from_slice(content);
}

/// How a scalar is written.
pub(crate) fn wire_type(kind: Kind) -> WireType {
    match kind {
        Kind::F32 => WireType::ThirtyTwoBit,
        Kind::F64 => WireType::SixtyFourBit,
        Kind::U8 | Kind::U16 | Kind::U32 | Kind::U64 | Kind::I64 => WireType::Varint,
        Kind::Text | Kind::Array(..) | Kind::Struct(_) => WireType::LengthDelimited,
    }
}

fn put_scalar(kind: Kind, bytes: &[u8], out: &mut Vec<u8>) {
    if matches!(kind, Kind::F32 | Kind::F64) {
        // Protobuf is little-endian whatever the machine is.
        match *bytes {
            [a, b, c, d] => out.extend_from_slice(&f32::from_ne_bytes([a, b, c, d]).to_le_bytes()),
            [a, b, c, d, e, f, g, h] => {
                out.extend_from_slice(&f64::from_ne_bytes([a, b, c, d, e, f, g, h]).to_le_bytes());
            }
            _ => {}
        }
        return;
    }
    let value = match *bytes {
        [a] => u64::from(a),
        [a, b] => u64::from(u16::from_ne_bytes([a, b])),
        [a, b, c, d] => u64::from(u32::from_ne_bytes([a, b, c, d])),
        [a, b, c, d, e, f, g, h] => u64::from_ne_bytes([a, b, c, d, e, f, g, h]),
        _ => 0,
    };
    encode_varint(value, out);
}
