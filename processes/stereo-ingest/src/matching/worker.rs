//! One strip's work behind one face, whatever the instructions and the disparity range it is compiled for.

use super::census::{PLANES, Window};
use super::gradient::gradient;
#[cfg(target_arch = "x86_64")]
use super::simd::{Avx2, Avx512};
use super::simd::{Kernel, Lanes, Portable, SimdLevel};
use super::strip::{Cost, Features, Strip, Weights};
use super::texture::Texture;
use super::winners::Consistency;
use crate::Config;
use ipc_types::disparity::{NO_MATCH, TEXTURED, TEXTURELESS};

/// What a strip does.
pub(super) trait Work: Send {
    /// Features of the strip's rows of both images, from row `first` on, laid out as [`Features`].
    fn describe(&mut self, images: [&[u8]; 2], first: usize, out: [&mut [u8]; 2], strides: [usize; 2]);
    /// Disparities of the strip's rows.
    fn run(&mut self, features: &Features, images: [&[u8]; 2], first: usize, disparity: &mut [u16]);
}

/// Rows above a strip from which its paths start: after as many, what lies farther up no longer matters.
const WARM_UP_ROWS: usize = 16;
/// So many times the least texture, right at a pixel, are no noise, and so it is no blank surface (ARCHITECTURE.md, Holes).
const CLEARLY: f32 = 1.5;
/// And no less than this, grey levels, however little texture is asked for: noise of 1.5 makes a mean difference of 1.7.
const NOISE: f32 = 3.0;

struct Worker<S, const K: usize> {
    strip: Strip<S, K>,
    window: Window,
    /// Of the left and the right image.
    textures: [Texture; 2],
    /// Right columns without texture, marked.
    blank: Vec<u16>,
    cost: Cost,
    width: usize,
    rules: Consistency,
    least_texture: f32,
}

/// A worker for the instructions of `level`, which the machine has, and the range of `weights`.
pub(super) fn worker(level: SimdLevel, width: usize, config: &Config) -> Box<dyn Work> {
    let weights = config.weights();
    /// Picks the number of vectors that a pixel's costs take.
    macro_rules! of_length {
        ($lanes:ty, $($vectors:literal)*) => {
            match weights.range.div_ceil(<$lanes>::COUNT) {
                $($vectors => Worker::<$lanes, $vectors>::boxed(width, config, weights),)*
                vectors => unreachable!("the range was checked, {vectors} vectors are not compiled"),
            }
        };
    }
    match level {
        SimdLevel::Portable => of_length!(Portable, 1 2 4 6 8 12 16),
        #[cfg(target_arch = "x86_64")]
        SimdLevel::Avx2 => of_length!(Avx2, 1 2 3 4 6 8),
        #[cfg(target_arch = "x86_64")]
        SimdLevel::Avx512 => of_length!(Avx512, 1 2 3 4),
        #[cfg(not(target_arch = "x86_64"))]
        _ => unreachable!("only available levels are asked for"),
    }
}

impl<S: Lanes, const K: usize> Worker<S, K> {
    fn boxed(width: usize, config: &Config, weights: Weights) -> Box<dyn Work> {
        let rules = Consistency { left_right_px: config.left_right_px as u16, bridge_px: config.bridge_px as usize };
        let strip = Strip::<S, K>::new(width, weights);
        let window = Window::new(width, S::COUNT);
        Box::new(Self {
            strip,
            window,
            textures: [Texture::new(width), Texture::new(width)],
            blank: vec![0; width],
            cost: weights.cost,
            width,
            rules,
            least_texture: config.least_texture,
        })
    }

    #[inline(always)]
    fn describe_rows(&mut self, image: &[u8], first: usize, out: &mut [u8], stride: usize) {
        match self.cost {
            Cost::Hamming => {
                for (row, planes) in (first..).zip(out.chunks_exact_mut(stride * PLANES)) {
                    let (first, rest) = planes.split_at_mut(stride);
                    let (second, rest) = rest.split_at_mut(stride);
                    let (third, fourth) = rest.split_at_mut(stride);
                    self.window.describe::<S>(image, self.width, row, [first, second, third, fourth]);
                }
            }
            Cost::AbsoluteDifference => {
                for (row, out) in (first..).zip(out.chunks_exact_mut(stride)) {
                    gradient(image, self.width, row, &mut out[..self.width]);
                }
            }
        }
    }
}

impl<S: Lanes, const K: usize> Work for Worker<S, K> {
    fn describe(&mut self, images: [&[u8]; 2], first: usize, out: [&mut [u8]; 2], strides: [usize; 2]) {
        S::enter(Describe { worker: self, images, first, out, strides });
    }

    fn run(&mut self, features: &Features, images: [&[u8]; 2], first: usize, disparity: &mut [u16]) {
        S::enter(Match { worker: self, features, images, first, disparity });
    }
}

struct Describe<'a, S, const K: usize> {
    worker: &'a mut Worker<S, K>,
    images: [&'a [u8]; 2],
    first: usize,
    out: [&'a mut [u8]; 2],
    strides: [usize; 2],
}

impl<S: Lanes, const K: usize> Kernel for Describe<'_, S, K> {
    #[inline(always)]
    fn run(self) {
        let Self { worker, images, first, out: [left, right], strides } = self;
        worker.describe_rows(images[0], first, left, strides[0]);
        worker.describe_rows(images[1], first, right, strides[1]);
        for plane in right.chunks_exact_mut(strides[1]) {
            plane[..worker.width].reverse();
            let border = plane[worker.width - 1];
            plane[worker.width..].fill(border);
        }
    }
}

struct Match<'a, S, const K: usize> {
    worker: &'a mut Worker<S, K>,
    features: &'a Features,
    images: [&'a [u8]; 2],
    first: usize,
    disparity: &'a mut [u16],
}

impl<S: Lanes, const K: usize> Kernel for Match<'_, S, K> {
    #[inline(always)]
    fn run(self) {
        let Self { worker, features, images, first, disparity } = self;
        let Worker { strip, textures: [left, right], blank, width, rules, least_texture, .. } = worker;
        let width = *width;
        let rows = first..first + disparity.len() / width;
        strip.run(features, rows, WARM_UP_ROWS, |row, winners| {
            let out = &mut disparity[(row - first) * width..(row - first + 1) * width];
            if *least_texture > 0.0 {
                blank.fill(0);
                right.take_in(images[1], row);
                right.mark_blank(*least_texture, TEXTURELESS, blank);
            }
            winners.finish(*rules, blank, out);
            if *least_texture > 0.0 {
                left.take_in(images[0], row);
                left.mark_blank(*least_texture, TEXTURELESS, out);
                left.mark_textured((CLEARLY * *least_texture).max(NOISE), NO_MATCH, TEXTURED, out);
            }
        });
    }
}
