//! Matching one rectified pair: the pure core.

mod census;
mod gradient;
mod matcher;
mod simd;
mod speckle;
mod strip;
mod texture;
mod winners;
mod worker;

pub use matcher::{MatchError, MatchStatistics, Matcher};
pub use simd::SimdLevel;
pub(crate) use strip::{Cost, Weights};
