//! Whether two images can be a rectified pair at all: what is wrong with cameras or cables shows before it is matched.
//!
//! Blindness (covered, black, saturated) is seen in a frame's statistics. Swapped images and rows that do not match are
//! seen by following a textured patch of each frame into the other image: votes of the last few dozen decide. Such a pair
//! must not be matched: what would be found is not there. Rows less than 3/4 px apart pass, as many real rigs' are; so do
//! those more than 7 px apart, and images of different moments: where little can be followed, sound pairs look the same.
//! Until there are a dozen votes nothing is said; most first frames give so many at once.

use ipc_types::StereoRig;

/// What is wrong with a pair.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PairFault {
    /// The left image shows nothing: covered, black or saturated.
    LeftBlind,
    /// The right image shows nothing.
    RightBlind,
    /// Neither shows anything: night, or nothing but bright sky. The matcher calls that textureless by itself.
    BothBlind,
    /// One image has much less texture than the other: a covered, fogged or unfocused lens.
    Unequal,
    /// What is in the left image lies farther right in the right image.
    Swapped,
    /// The images are shifted against each other by rows.
    RowsShifted,
}

impl PairFault {
    /// For reports.
    pub const fn note(self) -> &'static str {
        match self {
            Self::LeftBlind => "left image is blind: covered, black or saturated",
            Self::RightBlind => "right image is blind: covered, black or saturated",
            Self::BothBlind => "both images are black or saturated",
            Self::Unequal => "one lens is covered, fogged or out of focus",
            Self::Swapped => "left and right images are swapped",
            Self::RowsShifted => "rows of the images do not match: calibration?",
        }
    }

    /// Whether matching would only find what is not there.
    pub const fn forbids_matching(self) -> bool {
        !matches!(self, Self::BothBlind)
    }
}

/// Follows patches between the images of one rig.
#[derive(Debug)]
pub struct PairCheck {
    width: usize,
    height: usize,
    reach: usize,
    /// Column shift of what is infinitely far, px.
    infinity: f64,
    /// The next probe's place in the pattern.
    probe: usize,
    /// The last votes: column shift and row shift, px.
    votes: [Vote; MEMORY],
    count: usize,
    /// Patches followed so far.
    followed: usize,
}

#[derive(Clone, Copy, Debug, Default)]
struct Vote {
    shift: i32,
    rows: f32,
}

/// Votes that count.
const MEMORY: usize = 48;
/// Fewer decide nothing.
const QUORUM: usize = 12;
/// Patches followed, where there is no quorum yet, before one a frame must do, and in each frame until then: following one
/// takes long enough.
const FIRST: usize = 8 * QUORUM;
const EAGER: usize = 32;
/// So many times in a row no patch to follow, and a frame has none.
const BLANK: usize = 8;
/// Places looked at in each frame for a patch to follow.
const PROBES: usize = 24;
/// Half of a patch's side, px.
const HALF: usize = 4;
/// Rows searched above and below.
const ROWS: i32 = 8;
/// Row shift that is reported, px.
const ROWS_LIMIT: f32 = 0.75;

impl PairCheck {
    /// For a rig's images and disparities up to `reach_px`.
    pub fn new(rig: &StereoRig, reach_px: u32) -> Self {
        Self {
            width: rig.width_px as usize,
            height: rig.height_px as usize,
            reach: reach_px as usize,
            infinity: -rig.doffs_px,
            probe: 0,
            votes: [Vote::default(); MEMORY],
            count: 0,
            followed: 0,
        }
    }

    /// Looks at the next pair: row-major grey images of the rig's size.
    pub fn step(&mut self, left: &[u8], right: &[u8]) -> Option<PairFault> {
        let (a, b) = (Statistics::of(left, self.width), Statistics::of(right, self.width));
        match (a.is_blind(), b.is_blind()) {
            (true, true) => Some(PairFault::BothBlind),
            (true, false) => Some(PairFault::LeftBlind),
            (false, true) => Some(PairFault::RightBlind),
            _ if a.texture.max(b.texture) > 3.0 * a.texture.min(b.texture) + 1.0 => Some(PairFault::Unequal),
            _ => {
                // The first frames must not be trusted for want of votes.
                let eager = if self.count < QUORUM { FIRST.saturating_sub(self.followed) } else { 0 };
                let patches = eager.clamp(1, EAGER);
                let mut blank = 0;
                for _ in 0..patches {
                    blank = if (0..PROBES).any(|_| self.follow_next(left, right)) { 0 } else { blank + 1 };
                    if blank == BLANK || self.count >= QUORUM {
                        break;
                    }
                }
                self.verdict()
            }
        }
    }

    /// Takes the next patch of a pattern that covers the image evenly, and votes if it is found in the other image.
    /// Whether there was a patch that could be followed.
    fn follow_next(&mut self, left: &[u8], right: &[u8]) -> bool {
        let margin = HALF + ROWS as usize + 1;
        let (columns, rows) = (self.width.saturating_sub(2 * margin), self.height.saturating_sub(2 * margin));
        if columns == 0 || rows == 0 {
            return false;
        }
        // Weyl's sequence with two irrational steps: even however long it goes on.
        let place = self.probe as f64 + 1.0;
        self.probe = (self.probe + 1) % 65_536;
        let x = margin + ((place * 0.754_877_666).fract() * columns as f64) as usize;
        let y = margin + ((place * 0.569_840_291).fract() * rows as f64) as usize;
        let Some(patch) = Patch::at(left, self.width, x, y).filter(Patch::is_corner) else { return false };
        self.followed += 1;
        if let Some(vote) = self.follow(&patch, right, x, y) {
            self.votes[self.count % MEMORY] = vote;
            self.count += 1;
        }
        true
    }

    fn follow(&self, patch: &Patch, right: &[u8], x: usize, y: usize) -> Option<Vote> {
        let reach = self.reach as i32;
        // The least difference of each column shift, with its row shift.
        let candidate = |shift: i32| -> Option<(f32, i32)> {
            let column = x.checked_add_signed(-shift as isize).filter(|c| (HALF..self.width - HALF).contains(c))?;
            let differences = (-ROWS..=ROWS).filter_map(|rows| {
                let row = y.checked_add_signed(rows as isize)?;
                Some((Patch::at(right, self.width, column, row)?.difference(patch), rows))
            });
            differences.min_by(|a, b| a.0.total_cmp(&b.0))
        };
        let mut best = (f32::INFINITY, 0, 0);
        let mut second = f32::INFINITY;
        for shift in -reach..=reach {
            let Some((least, rows)) = candidate(shift) else { continue };
            if least < best.0 {
                if shift - best.1 > 2 {
                    second = best.0;
                }
                best = (least, shift, rows);
            } else if shift - best.1 > 2 {
                second = second.min(least);
            }
        }
        let (least, shift, rows) = best;
        // Found: much better than anywhere else, and not merely the least bad.
        if least > 0.6 * second || least > 0.5 * patch.contrast || rows.abs() == ROWS {
            return None;
        }
        let column = x.checked_add_signed(-shift as isize)?;
        let beside = |step: i32| {
            let row = y.checked_add_signed((rows + step) as isize)?;
            Some(Patch::at(right, self.width, column, row)?.difference(patch))
        };
        let (above, below) = (beside(-1)?, beside(1)?);
        let slope = above.max(below) - least;
        let part = if slope > 0.0 { (above - below) / (2.0 * slope) } else { 0.0 };
        Some(Vote { shift, rows: rows as f32 + part })
    }

    fn verdict(&self) -> Option<PairFault> {
        let votes = &self.votes[..self.count.min(MEMORY)];
        if votes.len() < QUORUM {
            return None;
        }
        // Beyond infinity, and a pixel more.
        let backwards = votes.iter().filter(|vote| f64::from(vote.shift) < self.infinity - 1.5).count();
        if 2 * backwards > votes.len() {
            return Some(PairFault::Swapped);
        }
        let mut rows = [0.0; MEMORY];
        for (rows, vote) in rows.iter_mut().zip(votes) {
            *rows = vote.rows;
        }
        let rows = &mut rows[..votes.len()];
        rows.sort_by(f32::total_cmp);
        (rows[rows.len() / 2].abs() > ROWS_LIMIT).then_some(PairFault::RowsShifted)
    }
}

/// Of every eighth row.
struct Statistics {
    /// Mean absolute difference between neighbours, grey levels.
    texture: f32,
    /// Shares of nearly black and nearly white pixels.
    dark: f32,
    bright: f32,
}

impl Statistics {
    fn of(image: &[u8], width: usize) -> Self {
        let (mut count, mut gradient, mut dark, mut bright) = (0_u64, 0_u64, 0_u64, 0_u64);
        for row in image.chunks_exact(width).step_by(8) {
            for pair in row.windows(2) {
                let value = pair[0];
                count += 1;
                gradient += u64::from(pair[0].abs_diff(pair[1]));
                dark += u64::from(value < 16);
                bright += u64::from(value > 247);
            }
        }
        let share = |part: u64| part as f32 / count.max(1) as f32;
        Self { texture: share(gradient), dark: share(dark), bright: share(bright) }
    }

    fn is_blind(&self) -> bool {
        self.dark > 0.95 || self.bright > 0.95
    }
}

/// A square of pixels less their mean.
struct Patch {
    pixels: [f32; SIDE * SIDE],
    /// Mean absolute value.
    contrast: f32,
}

const SIDE: usize = 2 * HALF + 1;

impl Patch {
    fn at(image: &[u8], width: usize, x: usize, y: usize) -> Option<Self> {
        let mut pixels = [0.0; SIDE * SIDE];
        for (dy, line) in pixels.chunks_exact_mut(SIDE).enumerate() {
            let start = (y.checked_sub(HALF)? + dy) * width + x.checked_sub(HALF)?;
            let row = image.get(start..start + SIDE)?;
            line.iter_mut().zip(row).for_each(|(pixel, &value)| *pixel = f32::from(value));
        }
        let mean = pixels.iter().sum::<f32>() / pixels.len() as f32;
        pixels.iter_mut().for_each(|pixel| *pixel -= mean);
        let contrast = pixels.iter().map(|pixel| pixel.abs()).sum::<f32>() / pixels.len() as f32;
        Some(Self { pixels, contrast })
    }

    /// Changes along both axes: a place that is not repeated along an edge.
    fn is_corner(&self) -> bool {
        let (mut along, mut across) = (0.0, 0.0);
        for y in 0..SIDE - 1 {
            for x in 0..SIDE - 1 {
                let here = self.pixels[y * SIDE + x];
                along += (self.pixels[y * SIDE + x + 1] - here).abs();
                across += (self.pixels[(y + 1) * SIDE + x] - here).abs();
            }
        }
        along.min(across) > 4.0 * ((SIDE - 1) * (SIDE - 1)) as f32
    }

    /// Mean absolute difference, contrasts made equal.
    fn difference(&self, other: &Self) -> f32 {
        let gain = if self.contrast > 0.0 { (other.contrast / self.contrast).clamp(0.5, 2.0) } else { 1.0 };
        let pairs = self.pixels.iter().zip(&other.pixels);
        pairs.map(|(a, b)| (a * gain - b).abs()).sum::<f32>() / self.pixels.len() as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    const RIG: StereoRig = StereoRig {
        width_px: 320,
        height_px: 240,
        focal_px: 200.0,
        cx_px: 160.0,
        cy_px: 120.0,
        baseline_m: 0.1,
        doffs_px: 0.0,
    };
    const WIDTH: usize = 320;
    const HEIGHT: usize = 240;

    /// Random blobs, seen with a disparity of 12 px.
    fn pair() -> (Vec<u8>, Vec<u8>) {
        let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(5);
        let wide = WIDTH + 40;
        let noise: Vec<u8> = (0..wide * (HEIGHT + 8)).map(|_| random.random()).collect();
        let smooth = |x: usize, y: usize| {
            let sum: u32 = (0..9).map(|i| u32::from(noise[(y + i / 3) * wide + x + i % 3])).sum();
            (sum / 9) as u8
        };
        let view = |shift: usize| (0..WIDTH * HEIGHT).map(|i| smooth(i % WIDTH + shift, i / WIDTH)).collect();
        (view(0), view(12))
    }

    fn verdict(left: &[u8], right: &[u8]) -> Option<PairFault> {
        let mut check = PairCheck::new(&RIG, 64);
        (0..80).fold(None, |_, _| check.step(left, right))
    }

    #[test]
    fn a_sound_pair_passes_whatever_the_exposure() {
        let (left, right) = pair();
        assert_eq!(verdict(&left, &right), None);
        let darker: Vec<u8> = right.iter().map(|&p| (f32::from(p) * 0.6) as u8).collect();
        assert_eq!(verdict(&left, &darker), None);
    }

    #[test]
    fn faults_are_named() {
        let (left, right) = pair();
        assert_eq!(verdict(&right, &left), Some(PairFault::Swapped));
        for rows in [1, 2, 4, 6] {
            let lower = [&right[rows * WIDTH..], &right[..rows * WIDTH]].concat();
            assert_eq!(verdict(&left, &lower), Some(PairFault::RowsShifted), "{rows} rows");
        }
        let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(6);
        let covered: Vec<u8> = right.iter().map(|_| 10 + random.random_range(0..4_u8)).collect();
        assert_eq!(verdict(&left, &covered), Some(PairFault::RightBlind));
        assert_eq!(verdict(&[255; WIDTH * HEIGHT], &right), Some(PairFault::LeftBlind));
        assert_eq!(verdict(&[0; WIDTH * HEIGHT], &[0; WIDTH * HEIGHT]), Some(PairFault::BothBlind));
        let fogged: Vec<u8> = right.iter().map(|&p| 100 + p / 8).collect();
        assert_eq!(verdict(&left, &fogged), Some(PairFault::Unequal));
    }

    #[test]
    fn the_first_frame_is_judged_already() {
        let (left, right) = pair();
        assert_eq!(PairCheck::new(&RIG, 64).step(&right, &left), Some(PairFault::Swapped));
        let lower = [&right[WIDTH..], &right[..WIDTH]].concat();
        assert_eq!(PairCheck::new(&RIG, 64).step(&left, &lower), Some(PairFault::RowsShifted));
        assert_eq!(PairCheck::new(&RIG, 64).step(&left, &right), None);
    }

    #[test]
    fn a_blank_view_is_no_fault_of_the_cameras() {
        let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(8);
        let mut wall = || -> Vec<u8> { (0..WIDTH * HEIGHT).map(|_| 120 + random.random_range(0..4_u8)).collect() };
        assert_eq!(verdict(&wall(), &wall()), None);
    }

    #[test]
    fn what_is_mended_is_forgotten() {
        let (left, right) = pair();
        let mut check = PairCheck::new(&RIG, 64);
        let mut after = |left: &[u8], right: &[u8]| (0..80).fold(None, |_, _| check.step(left, right));
        assert_eq!(after(&right, &left), Some(PairFault::Swapped));
        assert_eq!(after(&left, &right), None);
    }
}
