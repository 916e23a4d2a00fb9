//! The pure core: one rectified pair in, one disparity image out, in place.

use crate::Config;
use crate::aggregate::{Penalties, SENTINEL, advance, array, array_mut};
use crate::census::{census, distances, padded_len};
use crate::select::{Consistency, RightMatches, select_row};
use crate::speckle::{Least, Speckles};
use crate::texture::Texture;
use ipc_types::StereoRig;
use ipc_types::disparity::{SCALE, TEXTURELESS, is_valid};
use multiversion::multiversion;

/// Why a pair was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{what} has {found} pixels, the rig's has {expected}")]
pub struct MatchError {
    /// Which image.
    pub what: &'static str,
    /// Pixels received.
    pub found: usize,
    /// Pixels of the rig.
    pub expected: usize,
}

/// What a match found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MatchStatistics {
    /// Pixels with a disparity.
    pub valid: usize,
    /// Pixels without texture.
    pub textureless: usize,
}

/// Matches the pairs of one rig. All memory is allocated here, once.
#[derive(Debug)]
pub struct Matcher {
    config: Config,
    width: usize,
    pixels: usize,
    padded: Vec<u8>,
    left: Vec<u32>,
    right: Vec<u32>,
    volume: Volume,
    texture: Texture,
    speckles: Speckles,
    least: Least,
}

/// The cost volume and the path costs that are being followed through it.
#[derive(Debug)]
struct Volume {
    width: usize,
    penalties: Penalties,
    rules: Consistency,
    /// Matching costs: rows × columns × disparities.
    costs: Vec<u8>,
    /// Sums over the paths, laid out alike.
    sums: Vec<u16>,
    /// Path costs of the row above (or below): columns × (disparities + 2).
    column_paths: Vec<u8>,
    column_least: Vec<u8>,
    /// Two lines of path costs along the row.
    row_path: [Vec<u8>; 2],
    right_matches: RightMatches,
}

impl Matcher {
    /// Allocates for a rig and a disparity range; `config` is as checked by [`Config::check`].
    pub fn new(rig: &StereoRig, config: Config) -> Self {
        let (width, height) = (rig.width_px as usize, rig.height_px as usize);
        let pixels = width * height;
        let range = config.max_disparity_px as usize;
        Self {
            config,
            width,
            pixels,
            padded: vec![0; padded_len(width, height)],
            left: vec![0; pixels],
            right: vec![0; pixels],
            volume: Volume {
                width,
                penalties: Penalties { small: config.small_step_penalty, large: config.large_step_penalty },
                rules: Consistency {
                    uniqueness_percent: config.uniqueness_percent,
                    left_right_px: config.left_right_px,
                },
                costs: vec![0; pixels * range],
                sums: vec![0; pixels * range],
                column_paths: vec![SENTINEL; width * (range + 2)],
                column_least: vec![0; width],
                row_path: [vec![SENTINEL; range + 2], vec![SENTINEL; range + 2]],
                right_matches: RightMatches::new(width),
            },
            texture: Texture::new(width),
            speckles: Speckles::new(pixels),
            least: Least {
                area_px: config.speckle_area_px as usize,
                side_baselines: config.speckle_size_m / rig.baseline_m as f32,
                doffs_px: rig.doffs_px as f32,
            },
        }
    }

    /// Matches `left` with `right` (row-major grey) into `disparity`, encoded as [`ipc_types::disparity`].
    ///
    /// # Errors
    /// A slice is not of the rig's size; `disparity` is then untouched.
    pub fn step(&mut self, left: &[u8], right: &[u8], disparity: &mut [u16]) -> Result<MatchStatistics, MatchError> {
        let expected = self.pixels;
        for (what, found) in [("left", left.len()), ("right", right.len()), ("disparity", disparity.len())] {
            if found != expected {
                return Err(MatchError { what, found, expected });
            }
        }
        census(left, self.width, &mut self.padded, &mut self.left);
        census(right, self.width, &mut self.padded, &mut self.right);
        self.right.chunks_exact_mut(self.width).for_each(<[u32]>::reverse);
        let (left_census, right_census, volume) = (&self.left, &self.right, &mut self.volume);
        match self.config.max_disparity_px {
            32 => volume.run::<32>(left_census, right_census, disparity),
            64 => volume.run::<64>(left_census, right_census, disparity),
            96 => volume.run::<96>(left_census, right_census, disparity),
            128 => volume.run::<128>(left_census, right_census, disparity),
            192 => volume.run::<192>(left_census, right_census, disparity),
            _ => volume.run::<256>(left_census, right_census, disparity),
        }
        let width = self.width;
        let blank = |row: usize, column: usize| disparity[row * width + column] = TEXTURELESS;
        self.texture.find_blank(left, self.config.least_texture, blank);
        let step = (self.config.speckle_step_px * SCALE) as u16;
        self.speckles.remove(disparity, width, self.least, step);
        Ok(MatchStatistics {
            valid: disparity.iter().filter(|&&pixel| is_valid(pixel)).count(),
            textureless: disparity.iter().filter(|&&pixel| pixel == TEXTURELESS).count(),
        })
    }
}

impl Volume {
    /// Down: costs, both paths along each row, the path from above. Up: the path from below, and selection.
    fn run<const D: usize>(&mut self, left: &[u32], right_reversed: &[u32], disparity: &mut [u16]) {
        let width = self.width;
        let rows = left.len() / width;
        self.restart_columns();
        for row in 0..rows {
            let line = row * width..(row + 1) * width;
            let costs = &mut self.costs[row * width * D..(row + 1) * width * D];
            let sums = &mut self.sums[row * width * D..(row + 1) * width * D];
            distances::<D>(&left[line.clone()], &right_reversed[line], costs);
            sums.fill(0);
            along_row::<D>(costs, sums, self.penalties, &mut self.row_path);
            along_columns::<D>(costs, sums, self.penalties, &mut self.column_paths, &mut self.column_least);
        }
        self.restart_columns();
        for row in (0..rows).rev() {
            let costs = &self.costs[row * width * D..(row + 1) * width * D];
            let sums = &mut self.sums[row * width * D..(row + 1) * width * D];
            along_columns::<D>(costs, sums, self.penalties, &mut self.column_paths, &mut self.column_least);
            let out = &mut disparity[row * width..(row + 1) * width];
            select_row::<D>(sums, self.rules, &mut self.right_matches, out);
        }
    }

    /// Before the first row of a direction every path cost is zero.
    fn restart_columns(&mut self) {
        let line = self.column_paths.len() / self.width;
        for path in self.column_paths.chunks_exact_mut(line) {
            path[1..line - 1].fill(0);
        }
        self.column_least.fill(0);
    }
}

/// Follows the two paths along a row, rightwards and leftwards.
#[multiversion(targets("x86_64+avx512f+avx512bw", "x86_64+avx2", "aarch64+neon"))]
fn along_row<const D: usize>(costs: &[u8], sums: &mut [u16], penalties: Penalties, path: &mut [Vec<u8>; 2]) {
    let pixels = costs.len() / D;
    for leftwards in [false, true] {
        let [before, here] = path;
        let (mut before, mut here) = (before, here);
        before[1..=D].fill(0);
        let mut least = 0;
        for step in 0..pixels {
            let pixel = if leftwards { pixels - 1 - step } else { step };
            let costs: &[u8; D] = array(&costs[pixel * D..]);
            let sums = array_mut(&mut sums[pixel * D..]);
            least = advance(costs, before, least, penalties, here, sums);
            std::mem::swap(&mut before, &mut here);
        }
    }
}

/// Takes the paths that run along the columns one row further.
#[multiversion(targets("x86_64+avx512f+avx512bw", "x86_64+avx2", "aarch64+neon"))]
fn along_columns<const D: usize>(
    costs: &[u8],
    sums: &mut [u16],
    penalties: Penalties,
    paths: &mut [u8],
    least: &mut [u8],
) {
    let mut here = [SENTINEL; 258];
    let pixels = costs.chunks_exact(D).zip(sums.chunks_exact_mut(D)).zip(paths.chunks_exact_mut(D + 2)).zip(least);
    for (((costs, sums), path), least) in pixels {
        *least = advance(array(costs), path, *least, penalties, &mut here, array_mut::<_, D>(sums));
        path[1..=D].copy_from_slice(&here[1..=D]);
    }
}
