//! Every topic's messages go to protobuf and back without a change, others can read them, and whatever else comes is refused.

use encoding::{decode, descriptor_set, encode, message_name, to_json};
use ipc_types::topics::{TOPICS, TopicInfo};
use ipc_types::wire::Kind;
use proptest::prelude::*;
use prost_reflect::{DescriptorPool, DynamicMessage, ReflectMessage};

/// Bytes of a struct: whatever, but text where text is.
fn filled(kind: Kind, random: &[u8]) -> Vec<u8> {
    match kind {
        Kind::Struct(shape) => {
            let mut bytes = vec![0; shape.bytes];
            let mut rest = random;
            for field in shape.fields {
                let size = field.kind.bytes();
                bytes[field.offset..field.offset + size].copy_from_slice(&filled(field.kind, &rest[..size]));
                rest = &rest[size..];
            }
            bytes
        }
        Kind::Text => {
            let length = usize::from(random[0]) % kind.bytes();
            let letters = random.iter().map(|byte| b'a' + byte % 26).take(length);
            letters.chain(std::iter::repeat(0)).take(kind.bytes()).collect()
        }
        _ => random[..kind.bytes()].to_vec(),
    }
}

/// A message of a topic: header and elements.
fn message(topic: &TopicInfo, random: &[u8], elements: usize) -> (Vec<u8>, Vec<u8>) {
    let part = |index: usize| random.iter().copied().cycle().skip(13 * index).take(2048).collect::<Vec<u8>>();
    let element = |index| filled(topic.element, &part(index));
    let has_elements = matches!(topic.element, Kind::Struct(_));
    let elements = (1..=elements).filter(|_| has_elements).flat_map(element).collect();
    (filled(topic.header, &part(0)), elements)
}

fn encoded(topic: &TopicInfo, header: &[u8], elements: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    encode(topic.header, header, topic.element, elements, &mut out);
    out
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn nothing_is_lost(random in prop::collection::vec(any::<u8>(), 256..512), elements in 0_usize..5) {
        for topic in TOPICS {
            let (header, elements) = message(topic, &random, elements);
            let bytes = encoded(topic, &header, &elements);
            prop_assert_eq!(decode(topic.header, topic.element, 4, &bytes), Ok((header, elements)), "{}", topic.name);
        }
    }

    #[test]
    fn whatever_comes_is_read_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..256)) {
        for topic in TOPICS {
            if let Ok((header, elements)) = decode(topic.header, topic.element, 16, &bytes) {
                prop_assert_eq!(header.len(), topic.header.bytes());
                prop_assert!(elements.is_empty() || elements.len() <= 16 * topic.element.bytes());
            }
        }
    }

    #[test]
    fn cut_and_damaged_messages_are_read_or_refused(
        random in prop::collection::vec(any::<u8>(), 256), cut in 0.0..1.0, at in 0.0..1.0, bit in 0_u8..8,
    ) {
        for topic in TOPICS {
            let (header, elements) = message(topic, &random, 2);
            let mut bytes = encoded(topic, &header, &elements);
            let place = |share: f64, bytes: &[u8]| (share * bytes.len() as f64) as usize;
            if let Some(byte) = bytes.len().checked_sub(1).map(|_| place(at, &bytes)) {
                bytes[byte] ^= 1_u8 << bit;
            }
            bytes.truncate(place(cut, &bytes));
            // Whether it is still a message is chance; that it is handled is not.
            let _ = decode(topic.header, topic.element, 16, &bytes);
        }
    }
}

/// By a reader that knows nothing but the schema.
#[test]
fn others_read_every_field() {
    let random: Vec<u8> = (0..=255).map(|i: u8| i.wrapping_mul(37) ^ 0x5a).collect();
    for topic in TOPICS {
        let (header, elements) = message(topic, &random, 2);
        let pool =
            DescriptorPool::decode(descriptor_set(&[(topic.header, topic.element)]).as_slice()).expect("a schema");
        let descriptor = pool.get_message_by_name(&message_name(topic.header)).expect("described");
        let read = DynamicMessage::decode(descriptor, encoded(topic, &header, &elements).as_slice()).expect("readable");
        let ours = to_json(topic.header, &header, topic.element, &elements);
        for field in read.descriptor().fields() {
            let theirs = read.get_field(&field);
            match (&ours[field.name()], theirs.as_ref()) {
                (ours, prost_reflect::Value::U32(theirs)) => assert_eq!(ours.as_u64(), Some(u64::from(*theirs))),
                (ours, prost_reflect::Value::U64(theirs)) => assert_eq!(ours.as_u64(), Some(*theirs)),
                (ours, prost_reflect::Value::I64(theirs)) => assert_eq!(ours.as_i64(), Some(*theirs)),
                (ours, prost_reflect::Value::F64(theirs)) if theirs.is_finite() => {
                    assert_eq!(ours.as_f64(), Some(*theirs));
                }
                (ours, prost_reflect::Value::String(theirs)) => assert_eq!(ours.as_str(), Some(theirs.as_str())),
                (ours, prost_reflect::Value::List(theirs)) => {
                    assert_eq!(ours.as_array().map(Vec::len), Some(theirs.len()), "{}: {}", topic.name, field.name());
                }
                (ours, prost_reflect::Value::Message(theirs)) => {
                    let sequence = theirs.get_field_by_name("sequence").and_then(|value| value.as_u64());
                    assert_eq!(ours["sequence"].as_u64(), sequence, "{}", topic.name);
                }
                _ => {}
            }
        }
    }
}

#[test]
fn what_is_wrong_is_named() {
    let goal = TOPICS.iter().find(|topic| topic.name == "goal").expect("a topic");
    let refused = |bytes: &[u8]| decode(goal.header, goal.element, 0, bytes).expect_err("refused").to_string();
    // position_m as a number, with two of three values, and a task that fits no u32.
    assert!(refused(&[2 << 3, 1]).contains("position_m"));
    assert!(refused(&[[2 << 3 | 2, 16].as_slice(), &[0; 16]].concat()).contains("2 values"));
    assert!(refused(&[4 << 3, 0xff, 0xff, 0xff, 0xff, 0xff, 1]).contains("does not fit u32"));
    assert!(refused(&[2 << 3 | 2, 24, 0]).contains("longer"));
    // A text that ends before its end is another one for who stops there.
    let command = TOPICS.iter().find(|topic| topic.name == "command").expect("a topic");
    let with_zero = [&[7 << 3 | 2, 5][..], b"ann\0b"].concat();
    let error = decode(command.header, command.element, 0, &with_zero).expect_err("refused").to_string();
    assert!(error.contains("operator"), "{error}");
    // Arrays are of numbers: the encoding knows no others.
    let is_of_numbers =
        |kind: &Kind| !matches!(kind, &Kind::Array(&(Kind::Struct(_) | Kind::Array(..) | Kind::Text), _));
    for kind in TOPICS.iter().flat_map(|topic| [topic.header, topic.element]) {
        assert!(kind.fields().iter().all(|field| is_of_numbers(&field.kind)), "{}", kind.name());
    }
}
