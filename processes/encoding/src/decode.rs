//! Protobuf → wire messages.

use crate::encode::wire_type;
use crate::schema::ELEMENTS;
use ipc_types::topics::Topic;
use ipc_types::wire::{Field, Kind};
use prost::encoding::{DecodeContext, WireType, decode_key, decode_varint, skip_field};

/// Elements of a message of whatever topic, at most: more than any has.
pub const MOST_ELEMENTS: usize = 4096;

/// Why bytes are not a message.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
    /// Not protobuf, or cut off.
    #[error("not protobuf, or cut off: {0}")]
    Malformed(String),
    /// A field of another type.
    #[error("{field}: {found:?} where {expected} is")]
    WrongType {
        /// Which.
        field: &'static str,
        /// What was found.
        found: WireType,
        /// What is to be there.
        expected: &'static str,
    },
    /// A number that does not fit.
    #[error("{field}: {value} does not fit {kind}")]
    TooLarge {
        /// Which.
        field: &'static str,
        /// The number.
        value: u64,
        /// What it is to fit.
        kind: &'static str,
    },
    /// So many numbers where so many are.
    #[error("{field}: {found} values or bytes where {expected} fit")]
    WrongLength {
        /// Which.
        field: &'static str,
        /// Found.
        found: usize,
        /// Expected.
        expected: usize,
    },
    /// Text that is none.
    #[error("{field}: not UTF-8")]
    NotText {
        /// Which.
        field: &'static str,
    },
    /// More elements than a message may have.
    #[error("more than {most} elements")]
    TooMany {
        /// How many may be.
        most: usize,
    },
}

/// The bytes of a header, and those of its elements, at most so many. Fields that are not known are skipped, those that are
/// absent are zero, of those that come twice the last counts.
///
/// # Errors
/// What is wrong, and with which field. Nothing is taken of such a message.
pub fn decode(header: Kind, element: Kind, most: usize, message: &[u8]) -> Result<(Vec<u8>, Vec<u8>), DecodeError> {
    let (mut bytes, mut elements) = (vec![0; header.bytes()], Vec::new());
    let has_elements = matches!(element, Kind::Struct(_));
    each_field(message, |number, found, content| {
        if has_elements && number == ELEMENTS {
            expect("elements", found, Kind::Struct(&ANY), "a message")?;
            if elements.len() >= most * element.bytes() {
                return Err(DecodeError::TooMany { most });
            }
            let start = elements.len();
            elements.resize(start + element.bytes(), 0);
            return take_fields(element.fields(), content.bytes, &mut elements[start..]);
        }
        take_field(header.fields(), number, found, content, &mut bytes)
    })?;
    Ok((bytes, elements))
}

/// A message of a topic: header and elements, at most so many.
///
/// # Errors
/// As [`decode`].
pub fn decode_message<T: Topic>(most: usize, message: &[u8]) -> Result<(T::Header, Vec<T::Element>), DecodeError> {
    let (header, elements) = decode(T::INFO.header, T::INFO.element, most, message)?;
    let elements = elements.chunks_exact(size_of::<T::Element>()).map(bytemuck::pod_read_unaligned).collect();
    Ok((bytemuck::pod_read_unaligned(&header), elements))
}

/// Stands for any struct.
static ANY: ipc_types::wire::Shape = ipc_types::wire::Shape { name: "a message", bytes: 0, fields: &[] };

/// Of a field: the number, or the bytes.
struct Content<'a> {
    value: u64,
    bytes: &'a [u8],
}

fn malformed(error: impl std::fmt::Display) -> DecodeError {
    DecodeError::Malformed(error.to_string())
}

fn each_field<'a>(
    mut message: &'a [u8],
    mut take: impl FnMut(u32, WireType, &Content<'a>) -> Result<(), DecodeError>,
) -> Result<(), DecodeError> {
    while !message.is_empty() {
        let (number, found) = decode_key(&mut message).map_err(malformed)?;
        let mut content = Content { value: 0, bytes: &[] };
        match found {
            WireType::Varint => content.value = decode_varint(&mut message).map_err(malformed)?,
            WireType::SixtyFourBit => content.bytes = split(&mut message, 8)?,
            WireType::ThirtyTwoBit => content.bytes = split(&mut message, 4)?,
            WireType::LengthDelimited => {
                let length = decode_varint(&mut message).map_err(malformed)?;
                content.bytes = split(&mut message, usize::try_from(length).unwrap_or(usize::MAX))?;
            }
            // Groups have gone from protobuf; one that is well-formed is skipped.
            WireType::StartGroup | WireType::EndGroup => {
                skip_field(found, number, &mut message, DecodeContext::default()).map_err(malformed)?;
                continue;
            }
        }
        take(number, found, &content)?;
    }
    Ok(())
}

fn split<'a>(message: &mut &'a [u8], length: usize) -> Result<&'a [u8], DecodeError> {
    let (head, rest) =
        message.split_at_checked(length).ok_or_else(|| malformed("a field is longer than its message"))?;
    *message = rest;
    Ok(head)
}

fn take_fields(fields: &'static [Field], message: &[u8], bytes: &mut [u8]) -> Result<(), DecodeError> {
    each_field(message, |number, found, content| take_field(fields, number, found, content, bytes))
}

fn take_field(
    fields: &'static [Field],
    number: u32,
    found: WireType,
    content: &Content<'_>,
    bytes: &mut [u8],
) -> Result<(), DecodeError> {
    let field = (number as usize).checked_sub(1).and_then(|index| fields.get(index));
    let Some(field) = field else { return Ok(()) };
    let bytes = &mut bytes[field.offset..field.offset + field.kind.bytes()];
    expect(field.name, found, field.kind, field.kind.name())?;
    match field.kind {
        Kind::Struct(shape) => take_fields(shape.fields, content.bytes, bytes),
        Kind::Array(kind, length) => take_packed(field.name, *kind, length, content.bytes, bytes),
        Kind::Text => take_text(field.name, content.bytes, bytes),
        kind => take_scalar(field.name, kind, content, bytes),
    }
}

fn expect(field: &'static str, found: WireType, kind: Kind, expected: &'static str) -> Result<(), DecodeError> {
    let is_expected = found == wire_type(kind);
    is_expected.then_some(()).ok_or(DecodeError::WrongType { field, found, expected })
}

fn take_packed(
    field: &'static str,
    kind: Kind,
    expected: usize,
    mut content: &[u8],
    bytes: &mut [u8],
) -> Result<(), DecodeError> {
    let mut found = 0;
    while !content.is_empty() {
        let mut one = Content { value: 0, bytes: &[] };
        match wire_type(kind) {
            WireType::Varint => one.value = decode_varint(&mut content).map_err(malformed)?,
            _ => one.bytes = split(&mut content, kind.bytes())?,
        }
        let place = bytes.chunks_exact_mut(kind.bytes()).nth(found);
        found += 1;
        take_scalar(field, kind, &one, place.ok_or(DecodeError::WrongLength { field, found, expected })?)?;
    }
    (found == expected).then_some(()).ok_or(DecodeError::WrongLength { field, found, expected })
}

fn take_text(field: &'static str, content: &[u8], bytes: &mut [u8]) -> Result<(), DecodeError> {
    let (found, expected) = (content.len(), bytes.len());
    let place = bytes.get_mut(..found).ok_or(DecodeError::WrongLength { field, found, expected })?;
    // One that ends before its end would have two meanings.
    let is_text = std::str::from_utf8(content).is_ok() && !content.contains(&0);
    is_text.then_some(()).ok_or(DecodeError::NotText { field })?;
    place.copy_from_slice(content);
    bytes[found..].fill(0);
    Ok(())
}

fn take_scalar(field: &'static str, kind: Kind, content: &Content<'_>, bytes: &mut [u8]) -> Result<(), DecodeError> {
    match (kind, content.bytes) {
        (Kind::F32, &[a, b, c, d]) => bytes.copy_from_slice(&f32::from_le_bytes([a, b, c, d]).to_ne_bytes()),
        (Kind::F64, &[a, b, c, d, e, f, g, h]) => {
            bytes.copy_from_slice(&f64::from_le_bytes([a, b, c, d, e, f, g, h]).to_ne_bytes());
        }
        _ => {
            let value = content.value;
            let too_large = |_| DecodeError::TooLarge { field, value, kind: kind.name() };
            match kind {
                Kind::U8 => bytes.copy_from_slice(&u8::try_from(value).map_err(too_large)?.to_ne_bytes()),
                Kind::U16 => bytes.copy_from_slice(&u16::try_from(value).map_err(too_large)?.to_ne_bytes()),
                Kind::U32 => bytes.copy_from_slice(&u32::try_from(value).map_err(too_large)?.to_ne_bytes()),
                _ => bytes.copy_from_slice(&value.to_ne_bytes()),
            }
        }
    }
    Ok(())
}
