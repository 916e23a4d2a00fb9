//! Images that must outlive the process that made them.
//!
//! A new subscriber cannot get samples out of a dead publisher, so keyframes lie in checksummed files on the
//! run's shared-memory file system, written as `.tmp` and renamed, and are read where they lie. In lockstep the
//! same store is a map in memory. A file that is torn, truncated or of another id is refused, never half used.

use ipc_types::ProcessId;
use memmap2::Mmap;
use std::cell::RefCell;
use std::collections::HashMap;
use std::fs;
use std::io::{self, Write};
use std::path::PathBuf;
use std::rc::Rc;
use std::sync::Arc;
use xxhash_rust::xxh3::xxh3_64;

/// From here on numbers name no images, but what processes leave to their successors.
const FIRST_ESTATE: u64 = u64::MAX - 255;
const MAGIC: u64 = u64::from_le_bytes(*b"SPHWKIM1");
/// Bytes before the pixels; a multiple of a cache line, so that pixels stay aligned for SIMD.
const HEADER: usize = 64;

/// A read-only image.
#[derive(Clone, Debug)]
pub struct StoredImage(Source);

#[derive(Clone, Debug)]
enum Source {
    Memory(Arc<[u16]>),
    Mapped(Arc<Mmap>),
}

impl std::ops::Deref for StoredImage {
    type Target = [u16];
    fn deref(&self) -> &[u16] {
        match &self.0 {
            Source::Memory(pixels) => pixels,
            // A mapping is page-aligned and HEADER is even, and `open` checked that the length is even.
            Source::Mapped(map) => bytemuck::cast_slice(&map[HEADER..]),
        }
    }
}

impl From<Vec<u16>> for StoredImage {
    fn from(pixels: Vec<u16>) -> Self {
        Self(Source::Memory(pixels.into()))
    }
}

/// What tells an image from any other, in all likelihood.
pub fn checksum(pixels: &[u16]) -> u64 {
    xxh3_64(bytemuck::cast_slice(pixels))
}

/// Where the images of a run lie.
#[derive(Clone, Debug)]
pub enum ImageStore {
    /// In this process, shared by clones of the store.
    Memory(Rc<RefCell<HashMap<u64, StoredImage>>>),
    /// In files under this folder, shared by all processes of the run.
    Folder(PathBuf),
}

impl ImageStore {
    /// Where a process leaves what its successor needs.
    pub const fn estate(process: ProcessId) -> u64 {
        FIRST_ESTATE + process as u64
    }

    /// A store within one process.
    pub fn in_memory() -> Self {
        Self::Memory(Rc::default())
    }

    /// Stores an image under `id`, replacing what was there. Returns its [`checksum`].
    ///
    /// # Errors
    /// The file cannot be written, for instance because the file system is full; nothing then exists under `id`
    /// that did not before.
    pub fn put(&mut self, id: u64, pixels: &[u16]) -> io::Result<u64> {
        let checksum = checksum(pixels);
        match self {
            Self::Memory(images) => {
                images.borrow_mut().insert(id, StoredImage(Source::Memory(pixels.into())));
                Ok(checksum)
            }
            Self::Folder(folder) => {
                let bytes: &[u8] = bytemuck::cast_slice(pixels);
                let mut header = [0_u8; HEADER];
                for (field, value) in [MAGIC, id, bytes.len() as u64, checksum].into_iter().enumerate() {
                    header[field * 8..field * 8 + 8].copy_from_slice(&value.to_le_bytes());
                }
                // What others leave is theirs to finish.
                let suffix = if id < FIRST_ESTATE { "tmp" } else { "new" };
                let temporary = folder.join(format!("{id}.{suffix}"));
                let mut file = fs::File::create(&temporary)?;
                let written = file.write_all(&header).and_then(|()| file.write_all(bytes));
                let named = written.and_then(|()| fs::rename(&temporary, folder.join(id.to_string())));
                named.map(|()| checksum).inspect_err(|_| {
                    // Best effort: the next image of this id overwrites it anyway.
                    let _ = fs::remove_file(&temporary);
                })
            }
        }
    }

    /// The image under `id`, or `None` when there is none or it is damaged.
    pub fn get(&self, id: u64) -> Option<StoredImage> {
        match self {
            Self::Memory(images) => images.borrow().get(&id).cloned(),
            Self::Folder(folder) => {
                let file = fs::File::open(folder.join(id.to_string())).ok()?;
                // SAFETY: files of the store are complete before they get their name, and are afterwards only
                // renamed over or unlinked, never written or truncated; the mapping keeps the pages alive.
                let map = unsafe { Mmap::map(&file) }.ok()?;
                let field = |index: usize| -> Option<u64> {
                    Some(u64::from_le_bytes(map.get(index * 8..index * 8 + 8)?.try_into().ok()?))
                };
                let bytes = map.get(HEADER..)?;
                let intact = field(0)? == MAGIC
                    && field(1)? == id
                    && field(2)? == bytes.len() as u64
                    && bytes.len() % 2 == 0
                    && field(3)? == xxh3_64(bytes);
                intact.then(|| StoredImage(Source::Mapped(Arc::new(map))))
            }
        }
    }

    /// Forgets the image under `id`. Readers that hold it keep it.
    pub fn remove(&mut self, id: u64) {
        match self {
            Self::Memory(images) => {
                images.borrow_mut().remove(&id);
            }
            Self::Folder(folder) => {
                // Absent is as good as removed.
                let _ = fs::remove_file(folder.join(id.to_string()));
            }
        }
    }

    /// Removes images that a writer began and did not finish. Nobody else may be writing any.
    pub fn remove_unfinished(&mut self) {
        let Self::Folder(folder) = self else { return };
        for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
            if entry.path().extension().is_some_and(|extension| extension == "tmp") {
                // Absent is as good as removed.
                let _ = fs::remove_file(entry.path());
            }
        }
    }

    /// Every image in the store, ascending: but what processes left to their successors.
    pub fn ids(&self) -> Vec<u64> {
        let mut ids: Vec<u64> = match self {
            Self::Memory(images) => images.borrow().keys().copied().collect(),
            Self::Folder(folder) => {
                let entries = fs::read_dir(folder).into_iter().flatten().flatten();
                entries.filter_map(|entry| entry.file_name().to_str()?.parse().ok()).collect()
            }
        };
        ids.retain(|&id| id < FIRST_ESTATE);
        ids.sort_unstable();
        ids
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn round_trip(mut store: ImageStore) {
        store.put(7, &[1, 2, 3]).expect("written");
        store.put(3, &[9]).expect("written");
        assert_eq!(store.ids(), [3, 7]);
        let held = store.get(7).expect("stored");
        store.put(7, &[4, 5]).expect("written");
        store.remove(3);
        assert_eq!((&held[..], &store.get(7).expect("stored")[..]), (&[1, 2, 3][..], &[4, 5][..]));
        assert!(store.get(3).is_none());
    }

    #[test]
    fn both_stores_keep_replace_and_remove() {
        round_trip(ImageStore::in_memory());
        let folder = tempfile::tempdir().expect("temporary folder");
        let mut store = ImageStore::Folder(folder.path().to_owned());
        round_trip(store.clone());
        fs::write(folder.path().join("9.tmp"), b"half").expect("writable");
        store.remove_unfinished();
        assert!(!folder.path().join("9.tmp").exists() && store.get(7).is_some());
    }

    #[test]
    fn a_damaged_file_is_refused() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let mut store = ImageStore::Folder(folder.path().to_owned());
        store.put(1, &[10, 20, 30, 40]).expect("written");
        let path = folder.path().join("1");
        let intact = fs::read(&path).expect("readable");
        for damage in 0..intact.len() {
            let mut bytes = intact.clone();
            bytes[damage] ^= 1;
            fs::write(&path, &bytes).expect("writable");
            let unused = (32..HEADER).contains(&damage);
            assert_eq!(store.get(1).is_some(), unused, "byte {damage}");
        }
        for length in [0, 7, 63, 64, 71] {
            fs::write(&path, &intact[..length]).expect("writable");
            assert!(store.get(1).is_none(), "{length} bytes");
        }
    }
}
