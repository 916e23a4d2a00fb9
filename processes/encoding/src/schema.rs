//! The schema of wire messages, generated from what describes their layout.

use ipc_types::wire::{Field, Kind, Shape};
use prost::Message;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet};

/// Number of the field that holds a message's elements.
pub const ELEMENTS: u32 = 100;

const PACKAGE: &str = "sparrowhawk";

/// Full name of a message: `sparrowhawk/Goal/2` is `sparrowhawk.Goal`. Its version stands beside it where it is stored.
pub fn message_name(kind: Kind) -> String {
    format!("{PACKAGE}.{}", short_name(kind))
}

fn short_name(kind: Kind) -> &'static str {
    kind.name().split('/').nth(1).unwrap_or_else(|| kind.name())
}

/// A protobuf `FileDescriptorSet` that describes messages (header, element), as MCAP and Foxglove want it.
pub fn descriptor_set(messages: &[(Kind, Kind)]) -> Vec<u8> {
    let mut described: Vec<DescriptorProto> = Vec::new();
    for (header, element) in messages {
        if let Kind::Struct(element) = element {
            describe(element, None, &mut described);
        }
        if let Kind::Struct(header) = header {
            describe(header, Some(*element), &mut described);
        }
    }
    let file = FileDescriptorProto {
        name: Some(format!("{PACKAGE}.proto")),
        package: Some(PACKAGE.to_owned()),
        syntax: Some("proto3".to_owned()),
        message_type: described,
        ..FileDescriptorProto::default()
    };
    FileDescriptorSet { file: vec![file] }.encode_to_vec()
}

fn describe(shape: &'static Shape, element: Option<Kind>, described: &mut Vec<DescriptorProto>) {
    let name = short_name(Kind::Struct(shape));
    if described.iter().any(|message| message.name.as_deref() == Some(name)) {
        return;
    }
    for field in shape.fields {
        if let Kind::Struct(within) = field.kind {
            describe(within, None, described);
        }
    }
    let mut fields: Vec<_> = (1..).zip(shape.fields).map(|(number, field)| field_of(number, field)).collect();
    if let Some(element @ Kind::Struct(_)) = element {
        let mut field = field_proto("elements", ELEMENTS as i32, element);
        field.set_label(Label::Repeated);
        fields.push(field);
    }
    described.push(DescriptorProto { name: Some(name.to_owned()), field: fields, ..DescriptorProto::default() });
}

fn field_of(number: i32, field: &Field) -> FieldDescriptorProto {
    match field.kind {
        Kind::Array(kind, _) => {
            let mut proto = field_proto(field.name, number, *kind);
            proto.set_label(Label::Repeated);
            proto
        }
        kind => field_proto(field.name, number, kind),
    }
}

fn field_proto(name: &str, number: i32, kind: Kind) -> FieldDescriptorProto {
    let mut proto =
        FieldDescriptorProto { name: Some(name.to_owned()), number: Some(number), ..FieldDescriptorProto::default() };
    proto.set_label(Label::Optional);
    let field_type = match kind {
        Kind::U8 | Kind::U16 | Kind::U32 => Type::Uint32,
        Kind::U64 => Type::Uint64,
        Kind::I64 => Type::Int64,
        Kind::F32 => Type::Float,
        Kind::F64 => Type::Double,
        Kind::Text => Type::String,
        Kind::Struct(_) | Kind::Array(..) => {
            proto.type_name = Some(format!(".{}", message_name(kind)));
            Type::Message
        }
    };
    proto.set_type(field_type);
    proto
}
