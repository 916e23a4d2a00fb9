//! Messages of every topic, as they come over the network and out of logs: whatever the bytes, they are refused, or what is
//! decoded is encoded and decoded to the same again.

#![no_main]

use ipc_types::topics::TOPICS;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let Some((&topic, bytes)) = data.split_first() else { return };
    let topic = TOPICS[topic as usize % TOPICS.len()];
    let most = 64;
    let Ok((header, elements)) = encoding::decode(topic.header, topic.element, most, bytes) else { return };
    assert!(elements.len() <= most * topic.element.bytes().max(1));
    let mut again = Vec::new();
    encoding::encode(topic.header, &header, topic.element, &elements, &mut again);
    let decoded = encoding::decode(topic.header, topic.element, most, &again).expect("what was encoded is decoded");
    assert_eq!(decoded, (header, elements), "{}", topic.name);
    encoding::to_json(topic.header, &decoded.0, topic.element, &decoded.1);
});
