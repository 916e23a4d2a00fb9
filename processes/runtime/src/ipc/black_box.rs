//! What a process received last, kept where it outlives the process.
//!
//! A process that is killed says nothing any more. So it notes, in memory that is a file, the sequence and the validity of
//! the last message of every topic as it receives it, and its flight time. Two numbers that belong together may be torn
//! apart by a death between them; it is an account for people, and nothing is decided by it.

use crate::run_dir::RunDir;
use bytemuck::{Pod, Zeroable};
use ipc_types::ProcessId;
use ipc_types::topics::TOPICS;
use ipc_types::wire::Stamp;
use memmap2::MmapMut;
use std::fs::{self, OpenOptions};
use std::io;

/// The last message of a topic.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
struct Entry {
    sequence: u64,
    valid_ns: i64,
}

const BYTES: usize = TOPICS.len() * size_of::<Entry>();

/// A process' black box.
#[derive(Debug)]
pub(super) struct BlackBox(MmapMut);

/// The last input of one topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LastInput {
    /// Name of the topic.
    pub topic: &'static str,
    /// Its sequence.
    pub sequence: u64,
    /// For which instant of flight time it was valid, ns.
    pub valid_ns: i64,
}

impl BlackBox {
    pub(super) fn create(run: &RunDir, process: ProcessId) -> io::Result<Self> {
        let path = run.black_box(process);
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder)?;
        }
        let file = OpenOptions::new().read(true).write(true).create(true).truncate(true).open(path)?;
        file.set_len(BYTES as u64)?;
        // Takes the memory now: a full file system would otherwise kill this process at the first note.
        rustix::fs::fallocate(&file, rustix::fs::FallocateFlags::empty(), 0, BYTES as u64)?;
        // SAFETY: the file is this incarnation's own; the supervisor reads it after this process' death, and its successor
        // truncates it only then. Any bytes are valid entries.
        unsafe { MmapMut::map_mut(&file) }.map(Self)
    }

    pub(super) fn note(&mut self, topic: usize, stamp: &Stamp) {
        let entries: &mut [Entry] = bytemuck::cast_slice_mut(&mut self.0);
        if let Some(entry) = entries.get_mut(topic) {
            *entry = Entry { sequence: stamp.sequence, valid_ns: stamp.valid_ns };
        }
    }
}

/// What a process of a run received last; empty if it left nothing.
pub fn last_inputs(run: &RunDir, process: ProcessId) -> Vec<LastInput> {
    let bytes = fs::read(run.black_box(process)).unwrap_or_default();
    let entries = bytes.chunks_exact(size_of::<Entry>()).map(bytemuck::pod_read_unaligned::<Entry>);
    let named = TOPICS.iter().zip(entries).filter(|(_, entry)| *entry != Entry::default());
    named
        .map(|(topic, entry)| LastInput { topic: topic.name, sequence: entry.sequence, valid_ns: entry.valid_ns })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_noted_is_there_when_the_box_is_gone() {
        let run = RunDir::named(&format!("box-{}", std::process::id())).expect("a good name");
        let _lock = run.take().expect("free");
        let mut noted = BlackBox::create(&run, ProcessId::Planner).expect("created");
        for sequence in [3, 4] {
            let stamp = Stamp { sequence, valid_ns: 7, published_ns: 8, incarnation: 0, producer: 4 };
            noted.note(1, &stamp);
            noted.note(usize::MAX, &stamp);
        }
        drop(noted);
        let topic = TOPICS[1].name;
        assert_eq!(last_inputs(&run, ProcessId::Planner), [LastInput { topic, sequence: 4, valid_ns: 7 }]);
        assert!(last_inputs(&run, ProcessId::Memory).is_empty());
    }
}
