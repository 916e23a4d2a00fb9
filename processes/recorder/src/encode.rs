//! Messages as JSON.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use ipc_types::messages::{ExpandedImage, Keyframe, PathPoint, TrajectoryPoint};
use ipc_types::topics::Topic;
use ipc_types::wire::{Header, Wire};
use serde_json::{Map, Value, json};
use std::any::Any;

/// JSON schema of every topic but images: an object whose fields are listed by the wire layout.
pub(crate) fn schema<T: Topic>() -> String {
    let fields = T::Header::layout();
    let description = format!("{fields}\nelements: {}", T::Element::layout());
    json!({ "type": "object", "title": T::INFO.header_type, "description": description, "properties": properties::<T>() }).to_string()
}

/// The fields' types, as a header of zeros shows them.
fn properties<T: Topic>() -> Value {
    let header: T::Header = bytemuck::Zeroable::zeroed();
    describe(&serde_json::to_value(header).unwrap_or(Value::Null))["properties"].clone()
}

fn describe(value: &Value) -> Value {
    match value {
        Value::Object(fields) => {
            let properties: Map<String, Value> =
                fields.iter().map(|(key, value)| (key.clone(), describe(value))).collect();
            json!({ "type": "object", "properties": properties })
        }
        Value::Array(items) => json!({ "type": "array", "items": items.first().map_or(json!({}), describe) }),
        Value::String(_) => json!({ "type": "string" }),
        _ => json!({ "type": "number" }),
    }
}

/// A message as JSON text.
pub(crate) fn message<T: Topic>(header: &T::Header, elements: &[T::Element]) -> Vec<u8> {
    let mut value = serde_json::to_value(header).unwrap_or(Value::Null);
    if let (Value::Object(fields), Some(elements)) = (&mut value, elements_of::<T>(elements)) {
        fields.insert("elements".to_owned(), elements);
    }
    value.to_string().into_bytes()
}

/// Elements that are structures, not pixels.
fn elements_of<T: Topic>(elements: &[T::Element]) -> Option<Value> {
    fn list<T: Topic, E: Wire + serde::Serialize>(elements: &[T::Element]) -> Option<Value> {
        // The same type under another name, or not: asked of the type system, no bytes are reinterpreted.
        let same = (&bytemuck::Zeroable::zeroed() as &T::Element as &dyn Any).is::<E>();
        same.then(|| serde_json::to_value(bytemuck::cast_slice::<T::Element, E>(elements)).unwrap_or(Value::Null))
    }
    list::<T, Keyframe>(elements)
        .or_else(|| list::<T, PathPoint>(elements))
        .or_else(|| list::<T, TrajectoryPoint>(elements))
}

/// JSON schema of Foxglove's `RawImage`.
pub(crate) const IMAGE_SCHEMA: &str = r#"{"title":"foxglove.RawImage","type":"object","properties":{"timestamp":{"type":"object","title":"time","properties":{"sec":{"type":"integer","minimum":0},"nsec":{"type":"integer","minimum":0}}},"frame_id":{"type":"string"},"width":{"type":"integer"},"height":{"type":"integer"},"encoding":{"type":"string"},"step":{"type":"integer"},"data":{"type":"string","contentEncoding":"base64"}}}"#;

/// An image message: planes are stacked one above the other. Cells of several numbers lie beside each other.
pub(crate) fn image<T: Topic>(header: &T::Header, elements: &[T::Element], width: usize) -> Vec<u8> {
    let expanded = (header as &dyn Any).downcast_ref::<ExpandedImage>();
    let width = expanded.map_or(width, |image| 4 * image.width_px as usize);
    let bytes: &[u8] = bytemuck::cast_slice(elements);
    let pixel = size_of::<T::Element>();
    let nanos = header.stamp().valid_ns.max(0);
    json!({
        "timestamp": { "sec": nanos / 1_000_000_000, "nsec": nanos % 1_000_000_000 },
        "frame_id": "camera",
        "width": width,
        "height": elements.len() / width.max(1),
        "encoding": if pixel == 1 { "mono8" } else { "mono16" },
        "step": width * pixel,
        "data": STANDARD.encode(bytes),
    })
    .to_string()
    .into_bytes()
}
