//! Cells asked for before they are needed.
//!
//! Ten keyframes of 640 × 480 are 25 MB, and what a batch asks lies far apart: without this, most of its time is waiting.

#![allow(unsafe_code)]

/// Begins to load a cell into the first-level cache; changes nothing else. Does nothing but on x86-64.
#[inline(always)]
pub(crate) fn prefetch(cells: &[[u16; 4]], index: u32) {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        let cell = cells.as_ptr().wrapping_add(index as usize);
        // SAFETY: a prefetch accesses nothing: any address will do, and none faults. Every x86-64 has the instruction.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(cell.cast()) }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (cells, index);
}
