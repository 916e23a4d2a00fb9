//! What processes leave to their successors, in the run's image store: written whole or not at all, checked when read.

use crate::images::ImageStore;
use ipc_types::ProcessId;
use ipc_types::wire::{Wire, schema_hash};
use std::io;

/// Leaves an estate, instead of the one before. `buffer` is reused from call to call.
///
/// # Errors
/// The store is full; the estate before is then still there.
pub fn leave<H: Wire, E: Wire>(
    images: &mut ImageStore,
    process: ProcessId,
    header: &H,
    elements: &[E],
    buffer: &mut Vec<u16>,
) -> io::Result<()> {
    buffer.clear();
    let mut push = |bytes: &[u8]| {
        let pairs = bytes.chunks_exact(2).map(|pair| u16::from_le_bytes([pair[0], pair[1]]));
        buffer.extend(pairs);
    };
    push(&schema_hash::<H, E>().to_le_bytes());
    push(bytemuck::bytes_of(header));
    push(bytemuck::cast_slice(elements));
    images.put(ImageStore::estate(process), buffer).map(drop)
}

/// What a predecessor left; `None` where there is nothing, or nothing of this version.
pub fn inherit<H: Wire, E: Wire>(images: &ImageStore, process: ProcessId) -> Option<(H, Vec<E>)> {
    let stored = images.get(ImageStore::estate(process))?;
    let bytes: Vec<u8> = stored.iter().flat_map(|word| word.to_le_bytes()).collect();
    let (hash, rest) = bytes.split_first_chunk()?;
    let (header, elements) = rest.split_at_checked(size_of::<H>())?;
    if u64::from_le_bytes(*hash) != schema_hash::<H, E>() || elements.len() % size_of::<E>() != 0 {
        return None;
    }
    let elements = elements.chunks_exact(size_of::<E>()).map(bytemuck::pod_read_unaligned).collect();
    Some((bytemuck::pod_read_unaligned(header), elements))
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use ipc_types::estates::{ControllerEstate, EstatePlace, PlannerEstate};
    use ipc_types::messages::TrajectoryPoint;

    #[test]
    fn what_was_left_is_inherited_once_whole_and_by_the_right_heir() {
        let mut images = ImageStore::in_memory();
        let (header, mut buffer) = (PlannerEstate { replans: 7, ..PlannerEstate::zeroed() }, Vec::new());
        let places = [EstatePlace { position_m: [1.0, 2.0, 3.0], dwelt_s: 4.0 }; 3];
        leave(&mut images, ProcessId::Planner, &header, &places[..], &mut buffer).expect("stored");
        assert_eq!(inherit(&images, ProcessId::Planner), Some((header, places.to_vec())));
        assert_eq!(inherit::<PlannerEstate, EstatePlace>(&images, ProcessId::Controller), None);
        assert_eq!(inherit::<ControllerEstate, TrajectoryPoint>(&images, ProcessId::Planner), None, "another layout");
        assert!(images.ids().is_empty(), "it is no image");
        images.put(ImageStore::estate(ProcessId::Planner), &buffer[..buffer.len() - 1]).expect("stored");
        assert_eq!(inherit::<PlannerEstate, EstatePlace>(&images, ProcessId::Planner), None, "cut");
    }
}
