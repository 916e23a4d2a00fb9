//! What may cross a process boundary: plain old data with a versioned name and a layout that can be hashed.

use bytemuck::{Pod, Zeroable};
use serde::{Serialize, Serializer};
use xxhash_rust::xxh3::xxh3_64;

/// A type that may be put in shared memory and in logs.
///
/// `Pod` already proves `repr(C)`, no padding, no pointers and no invalid bit pattern. The name carries a version,
/// and the layout (names, types, offsets) is hashed into every service, so that a process built with other messages is
/// refused instead of misread. The same description makes the messages readable outside: schemas are generated from it.
pub trait Wire: Pod {
    /// What it is made of.
    const KIND: Kind;

    /// One line for the type, then one per field: `offset name: type`; then the same of the types within.
    fn layout() -> String {
        Self::KIND.layout()
    }
}

/// What a wire type is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A byte.
    U8,
    /// Two bytes.
    U16,
    /// Four bytes.
    U32,
    /// Eight bytes.
    U64,
    /// Eight bytes, signed.
    I64,
    /// Single precision.
    F32,
    /// Double precision.
    F64,
    /// A [`Text`].
    Text,
    /// So many of one kind.
    Array(&'static Kind, usize),
    /// Fields.
    Struct(&'static Shape),
}

/// The fields of a wire struct.
#[derive(Debug, PartialEq, Eq)]
pub struct Shape {
    /// Versioned name, e.g. `sparrowhawk/Goal/1`.
    pub name: &'static str,
    /// Size, bytes.
    pub bytes: usize,
    /// In order; without gaps.
    pub fields: &'static [Field],
}

/// A field of a wire struct.
#[derive(Debug, PartialEq, Eq)]
pub struct Field {
    /// Name.
    pub name: &'static str,
    /// First byte.
    pub offset: usize,
    /// What it holds.
    pub kind: Kind,
}

impl Kind {
    /// Name of the type; a struct's is versioned, an array's is that of what it is an array of.
    pub const fn name(&self) -> &'static str {
        match self {
            Self::U8 => "u8",
            Self::U16 => "u16",
            Self::U32 => "u32",
            Self::U64 => "u64",
            Self::I64 => "i64",
            Self::F32 => "f32",
            Self::F64 => "f64",
            Self::Text => "Text",
            Self::Array(kind, _) => kind.name(),
            Self::Struct(shape) => shape.name,
        }
    }

    /// Size, bytes.
    pub const fn bytes(&self) -> usize {
        match self {
            Self::U8 => 1,
            Self::U16 => 2,
            Self::U32 | Self::F32 => 4,
            Self::U64 | Self::I64 | Self::F64 => 8,
            Self::Text => Text::CAPACITY,
            Self::Array(kind, length) => kind.bytes() * *length,
            Self::Struct(shape) => shape.bytes,
        }
    }

    /// The fields of a struct; none of anything else.
    pub const fn fields(&self) -> &'static [Field] {
        match self {
            Self::Struct(shape) => shape.fields,
            _ => &[],
        }
    }

    fn layout(&self) -> String {
        let mut text = format!("{} ({} bytes)", self.name(), self.bytes());
        for field in self.fields() {
            let name = match field.kind {
                Self::Array(kind, length) => format!("[{}; {length}]", kind.name()),
                kind => kind.name().to_owned(),
            };
            text += &format!("\n  {:4} {}: {name}", field.offset, field.name);
        }
        for field in self.fields().iter().filter(|field| !field.kind.fields().is_empty()) {
            text += &format!("\n{}", field.kind.layout());
        }
        text
    }
}

macro_rules! primitive {
    ($($ty:ident = $kind:ident),*) => {$(
        impl Wire for $ty {
            const KIND: Kind = Kind::$kind;
        }
    )*};
}
primitive!(u8 = U8, u16 = U16, u32 = U32, u64 = U64, i64 = I64, f32 = F32, f64 = F64, Text = Text);

impl<T: Wire, const N: usize> Wire for [T; N]
where
    Self: Pod,
{
    const KIND: Kind = Kind::Array(&T::KIND, N);
}

/// Hash of a message's header and element layouts.
pub fn schema_hash<H: Wire, E: Wire>() -> u64 {
    xxh3_64(format!("{}\n{}", H::layout(), E::layout()).as_bytes())
}

/// Declares a wire struct: `repr(C)`, plain old data, serialisable as JSON, with its layout on record.
macro_rules! wire {
    ($(#[$meta:meta])* $name:ident = $type_name:literal { $($(#[$field_meta:meta])* $field:ident: $ty:ty,)* }) => {
        $(#[$meta])*
        #[repr(C)]
        #[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable, serde::Serialize)]
        pub struct $name {
            $($(#[$field_meta])* pub $field: $ty,)*
        }

        impl $crate::wire::Wire for $name {
            const KIND: $crate::wire::Kind = $crate::wire::Kind::Struct(&$crate::wire::Shape {
                name: $type_name,
                bytes: size_of::<Self>(),
                fields: &[$($crate::wire::Field {
                    name: stringify!($field),
                    offset: std::mem::offset_of!(Self, $field),
                    kind: <$ty as $crate::wire::Wire>::KIND,
                }),*],
            });
        }
    };
}
pub(crate) use wire;

wire! {
    /// Who wrote a message, in which incarnation, when, and for which instant it is valid.
    Stamp = "sparrowhawk/Stamp/1" {
        /// Counts this producer's messages on this topic from 1, across its restarts never reused within an incarnation.
        sequence: u64,
        /// Flight time for which the content is valid (for anything derived from an image: its exposure), ns.
        valid_ns: i64,
        /// Flight time of publication, ns.
        published_ns: i64,
        /// Which restart of the producer wrote this; 0 is the first.
        incarnation: u32,
        /// [`crate::ProcessId`] of the producer.
        producer: u32,
    }
}

/// A message header: anything that begins with a [`Stamp`].
pub trait Header: Wire + Serialize {
    /// The stamp.
    fn stamp(&self) -> &Stamp;
    /// The stamp, to be filled by the transport.
    fn stamp_mut(&mut self) -> &mut Stamp;
}

macro_rules! stamped {
    ($($name:ident),*) => {$(
        impl $crate::wire::Header for $name {
            fn stamp(&self) -> &$crate::wire::Stamp {
                &self.stamp
            }
            fn stamp_mut(&mut self) -> &mut $crate::wire::Stamp {
                &mut self.stamp
            }
        }
    )*};
}
pub(crate) use stamped;

/// A short UTF-8 text in a fixed-size message, cut at a character boundary.
#[repr(transparent)]
#[derive(Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct Text([u8; Text::CAPACITY]);

impl Text {
    /// Bytes that fit.
    pub const CAPACITY: usize = 64;

    /// As text; bytes that are not UTF-8 (a hostile or torn message) are replaced.
    pub fn to_string_lossy(self) -> String {
        let end = self.0.iter().position(|&byte| byte == 0).unwrap_or(Self::CAPACITY);
        String::from_utf8_lossy(&self.0[..end]).into_owned()
    }
}

impl From<&str> for Text {
    fn from(text: &str) -> Self {
        let mut bytes = [0; Self::CAPACITY];
        let end = text.floor_char_boundary(Self::CAPACITY);
        bytes[..end].copy_from_slice(&text.as_bytes()[..end]);
        Self(bytes)
    }
}

impl std::fmt::Debug for Text {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:?}", self.to_string_lossy())
    }
}

impl Serialize for Text {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&self.to_string_lossy())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_cut_at_a_character() {
        let long = "é".repeat(40);
        assert_eq!(Text::from(long.as_str()).to_string_lossy(), "é".repeat(32));
        assert_eq!(Text::from("hover").to_string_lossy(), "hover");
    }

    #[test]
    fn text_from_a_hostile_message_is_readable() {
        assert_eq!(Text([0xff; 64]).to_string_lossy().chars().count(), 64);
    }
}
