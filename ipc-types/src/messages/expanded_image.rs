//! The configuration-space image: where the vehicle's centre may be, seen from one exposure.

use crate::disparity::SCALE;
use crate::rig::StereoRig;
use crate::wire::{Stamp, stamped, wire};
use serde::{Deserialize, Serialize};

/// Front of a pixel of which nothing is known.
pub const UNKNOWN_FRONT: u16 = u16::MAX;
/// Back of a pixel behind whose front nothing is known to be occupied (far background).
pub const NEVER_OCCUPIED: u16 = u16::MAX;

wire! {
    /// Expanded image. It is larger than the camera's by `margin_px` on every side, with the same focal length.
    ///
    /// Elements: `width × height` row-major cells of four fixed-point disparities ([`crate::disparity::SCALE`]): near limit,
    /// front, back, gap limit. With four layers there follow as many cells of two: second front, second back. What a cell
    /// says about a point is defined by [`ExpandedCells::at`]. Valid at the instant of exposure.
    ExpandedImage = "sparrowhawk/ExpandedImage/2" {
        /// Origin.
        stamp: Stamp,
        /// Width, margins included, px.
        width_px: u32,
        /// Height, margins included, px.
        height_px: u32,
        /// Pixels added on every side of the camera's image.
        margin_px: u32,
        /// Layers: 2 or 4.
        layers: u32,
        /// Radius by which obstacles were inflated, m.
        radius_m: f32,
        /// Share of the camera's pixels that vouch for free space at no distance.
        unknown_share: f32,
    }
}
stamped!(ExpandedImage);

/// How many surfaces an expanded image holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Layers {
    /// Front and back of the nearest group of surfaces.
    Two,
    /// Those, and front and back of the next group behind it (DROAN, sections 5.5 and 6.2).
    Four,
}

impl Layers {
    /// 2 or 4.
    pub const fn count(self) -> u32 {
        match self {
            Self::Two => 2,
            Self::Four => 4,
        }
    }
}

/// Size and layers of an expanded image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ExpandedLayout {
    /// Width, margins included, px.
    pub width_px: u32,
    /// Height, margins included, px.
    pub height_px: u32,
    /// Pixels added on every side of the camera's image.
    pub margin_px: u32,
    /// Layers.
    pub layers: Layers,
}

impl ExpandedLayout {
    /// Widest margin, px.
    pub const MOST_MARGIN_PX: u32 = 128;

    /// The largest of a rig's images.
    pub const fn largest(rig: &StereoRig) -> Self {
        Self::new(rig, Self::MOST_MARGIN_PX, Layers::Four)
    }

    /// Of a rig's images with a margin.
    pub const fn new(rig: &StereoRig, margin_px: u32, layers: Layers) -> Self {
        let (width_px, height_px) = (rig.width_px + 2 * margin_px, rig.height_px + 2 * margin_px);
        Self { width_px, height_px, margin_px, layers }
    }

    /// Number of cells.
    pub const fn cells(&self) -> usize {
        self.width_px as usize * self.height_px as usize
    }

    /// Number of elements of the message.
    pub const fn elements(&self) -> usize {
        match self.layers {
            Layers::Two => 4 * self.cells(),
            Layers::Four => 6 * self.cells(),
        }
    }

    /// The cell that a camera pixel lies in.
    pub const fn cell_of(&self, column: u32, row: u32) -> usize {
        ((row + self.margin_px) * self.width_px + column + self.margin_px) as usize
    }
}

impl ExpandedImage {
    /// Size and layers that the header states, or `None` if there is no such image.
    pub fn expanded_layout(&self) -> Option<ExpandedLayout> {
        let layers = [Layers::Two, Layers::Four].into_iter().find(|layers| layers.count() == self.layers)?;
        let (width_px, height_px, margin_px) = (self.width_px, self.height_px, self.margin_px);
        Some(ExpandedLayout { width_px, height_px, margin_px, layers })
    }
}

/// What one expanded image says about the vehicle's centre being at a point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Seen {
    /// Nothing was measured there, or the vehicle's body would reach what was not measured.
    Unmeasured,
    /// Free.
    Free,
    /// Free by the far-background rule.
    FarBackground,
    /// Within the inflation of something measured.
    Occupied,
    /// Behind something.
    Occluded,
}

/// The cells of an expanded image.
#[derive(Clone, Copy, Debug)]
pub struct ExpandedCells<'a> {
    /// Near limit, front, back, gap limit.
    pub nearest: &'a [[u16; 4]],
    /// Second front and back; empty with two layers.
    pub next: &'a [[u16; 2]],
}

impl<'a> ExpandedCells<'a> {
    /// Cells of an image, or `None` when it has another length than its layout.
    pub fn split(elements: &'a [u16], layout: ExpandedLayout) -> Option<Self> {
        if elements.len() != layout.elements() {
            return None;
        }
        let (nearest, next) = elements.split_at(4 * layout.cells());
        Some(Self { nearest: nearest.as_chunks().0, next: next.as_chunks().0 })
    }

    /// What the cell at `index` says about a fixed-point disparity `d` on its ray. From near to far:
    ///
    /// | condition | answer |
    /// |---|---|
    /// | front = [`UNKNOWN_FRONT`] | unmeasured |
    /// | d > front and d > near limit | unmeasured |
    /// | d > front | free; if back = [`NEVER_OCCUPIED`], by the far-background rule |
    /// | front ≥ d > back | occupied |
    /// | back ≥ d > gap limit | occluded |
    /// | gap limit ≥ d > second front | free; if second back = [`NEVER_OCCUPIED`], by the far-background rule |
    /// | second front ≥ d > second back | occupied |
    /// | otherwise | occluded |
    #[inline]
    pub fn at(&self, index: usize, d: f32) -> Seen {
        let [near, front, back, gap] = self.nearest[index];
        let (near, front, back, gap) = (f32::from(near), f32::from(front), f32::from(back), f32::from(gap));
        let never = f32::from(NEVER_OCCUPIED);
        let free = |back: f32| if back == never { Seen::FarBackground } else { Seen::Free };
        if front == f32::from(UNKNOWN_FRONT) || d > front && d > near {
            Seen::Unmeasured
        } else if d > front {
            free(back)
        } else if d > back && back != never {
            Seen::Occupied
        } else if d > gap || self.next.is_empty() {
            Seen::Occluded
        } else {
            let [front, back] = self.next[index];
            let (front, back) = (f32::from(front), f32::from(back));
            if d > front {
                free(back)
            } else if d > back && back != never {
                Seen::Occupied
            } else {
                Seen::Occluded
            }
        }
    }

    /// Front and back of a cell in px, `None` where unknown.
    pub fn interval_px(&self, index: usize) -> Option<(f32, f32)> {
        let [_, front, back, _] = self.nearest[index];
        (front != UNKNOWN_FRONT).then(|| (f32::from(front) / SCALE, f32::from(back) / SCALE))
    }
}
