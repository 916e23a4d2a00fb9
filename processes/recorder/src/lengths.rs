//! Whether the lengths inside a record fit into it.
//!
//! The crate's parser makes room for as many bytes as a length says before it reads them: up to 4 GiB for a few damaged bytes.

use mcap::records::op;

/// Whether a record may be parsed; of kinds that are not read it does not matter.
pub(crate) fn are_possible(opcode: u8, body: &[u8]) -> bool {
    let rest = match opcode {
        op::SCHEMA => fixed(body, 2).and_then(text).and_then(text).and_then(text),
        op::CHANNEL => fixed(body, 4).and_then(text).and_then(text).and_then(map),
        op::METADATA => text(body).and_then(map),
        op::CHUNK => fixed(body, 28).and_then(text).and_then(data),
        // A checksum follows, on which the crate relies.
        op::ATTACHMENT => fixed(body, 16).and_then(text).and_then(text).and_then(data).and_then(|rest| fixed(rest, 4)),
        _ => Some(body),
    };
    rest.is_some()
}

/// What is behind so many bytes.
fn fixed(bytes: &[u8], count: usize) -> Option<&[u8]> {
    bytes.get(count..)
}

/// What is behind a text, or behind bytes whose number takes four.
fn text(bytes: &[u8]) -> Option<&[u8]> {
    let (length, rest) = bytes.split_first_chunk()?;
    rest.get(usize::try_from(u32::from_le_bytes(*length)).ok()?..)
}

/// What is behind bytes whose number takes eight.
fn data(bytes: &[u8]) -> Option<&[u8]> {
    let (length, rest) = bytes.split_first_chunk()?;
    rest.get(usize::try_from(u64::from_le_bytes(*length)).ok()?..)
}

/// What is behind names and values.
fn map(bytes: &[u8]) -> Option<&[u8]> {
    let rest = text(bytes)?;
    let mut entries = &bytes[4..bytes.len() - rest.len()];
    while !entries.is_empty() {
        entries = text(entries).and_then(text)?;
    }
    Some(rest)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_beyond_their_record_are_refused() {
        let text = |text: &[u8]| [&(text.len() as u32).to_le_bytes()[..], text].concat();
        let entries = text(&[text(b"layout"), text(b"ab")].concat());
        let channel = [&[1, 0, 1, 0][..], &text(b"goal"), &text(b"protobuf"), &entries].concat();
        assert!(are_possible(op::CHANNEL, &channel));
        for at in [4, 12, channel.len() - 20, channel.len() - 6] {
            let mut damaged = channel.clone();
            damaged[at + 3] = 0x7f;
            assert!(!are_possible(op::CHANNEL, &damaged), "{at}");
        }
        (0..channel.len()).for_each(|end| assert!(!are_possible(op::CHANNEL, &channel[..end]), "{end}"));
        assert!(!are_possible(op::CHUNK, &[0xff; 60]) && !are_possible(op::ATTACHMENT, &[0; 30]));
    }
}
