//! How much is recorded into how many files.

use ipc_types::bounds::Bounds;
use serde::{Deserialize, Serialize};

/// Limits of a recording.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecorderConfig {
    /// A file that is larger is followed by another, MiB.
    pub file_mib: u64,
    /// A file that is older is followed by another, s.
    pub file_s: f64,
    /// While less is free on the disk, nothing is recorded, MiB.
    pub least_free_mib: u64,
}

impl RecorderConfig {
    /// Reports what cannot be.
    pub fn check(&self, bounds: &mut Bounds) {
        bounds.range("file_mib", self.file_mib, 1..=65_536);
        bounds.range("file_s", self.file_s, 1.0..=86_400.0);
        bounds.range("least_free_mib", self.least_free_mib, 0..=1_048_576);
    }
}
