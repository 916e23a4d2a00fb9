//! Previews of images, as JPEG.

use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, ImageEncoder};
use ipc_types::disparity;

/// Quality, percent.
const QUALITY: u8 = 50;
/// Rows and columns are left out until an image is no wider, px.
const WIDEST_PX: usize = 320;

/// A grey image, made smaller.
pub(crate) fn grey(width_px: usize, pixels: &[u8]) -> Option<Vec<u8>> {
    let (width, small) = smaller(width_px, pixels);
    jpeg(width, &small, ExtendedColorType::L8, 1)
}

/// A disparity image in colours: near is red, far is blue, and what was not matched is black.
pub(crate) fn disparity(width_px: usize, pixels: &[u16], most_px: f32) -> Option<Vec<u8>> {
    let (width, small) = smaller(width_px, pixels);
    let colours: Vec<u8> = small.iter().flat_map(|&pixel| colour(disparity::decode(pixel), most_px)).collect();
    jpeg(width, &colours, ExtendedColorType::Rgb8, 3)
}

fn smaller<T: Copy>(width_px: usize, pixels: &[T]) -> (usize, Vec<T>) {
    let step = width_px.div_ceil(WIDEST_PX).max(1);
    let rows = pixels.chunks_exact(width_px.max(1)).step_by(step);
    (width_px.div_ceil(step), rows.flat_map(|row| row.iter().copied().step_by(step)).collect())
}

fn colour(disparity_px: Option<f32>, most_px: f32) -> [u8; 3] {
    let Some(d) = disparity_px else { return [0; 3] };
    // Hue from blue (far) over green to red (near).
    let share = (d / most_px.max(1.0)).clamp(0.0, 1.0).sqrt();
    let ramp = |middle: f32| ((1.0 - (share - middle).abs() * 2.0).clamp(0.0, 1.0) * 255.0) as u8;
    [ramp(1.0), ramp(0.5), ramp(0.0)]
}

fn jpeg(width: usize, bytes: &[u8], colour: ExtendedColorType, channels: usize) -> Option<Vec<u8>> {
    let height = bytes.len() / (channels * width).max(1);
    let mut out = Vec::new();
    let encoder = JpegEncoder::new_with_quality(&mut out, QUALITY);
    encoder.write_image(bytes, width as u32, height as u32, colour).ok().map(|()| out)
}
