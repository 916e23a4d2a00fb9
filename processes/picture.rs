//! Disparities as colours.

use image::{Rgb, RgbImage};
use ipc_types::disparity::{SCALE, is_valid};
use std::error::Error;
use std::path::Path;

/// Writes a picture: from blue (far) to red (near), black where unmatched.
pub(crate) fn save_disparity_picture(
    path: &Path,
    width_px: u32,
    height_px: u32,
    disparity: &[u16],
) -> Result<(), Box<dyn Error>> {
    // What saturates at the nearest range would leave the rest one colour: it is drawn as the nearest that does not.
    let saturated = u16::MAX - 1;
    let measured = || disparity.iter().copied().filter(|&pixel| pixel < saturated);
    let largest = measured().max().unwrap_or(0).max(SCALE as u16);
    let colour = |column: u32, row: u32| {
        let pixel = disparity[(row * width_px + column) as usize];
        let colour = colorous::TURBO.eval_continuous((f64::from(pixel) / f64::from(largest)).min(1.0));
        if is_valid(pixel) { Rgb([colour.r, colour.g, colour.b]) } else { Rgb([0; 3]) }
    };
    let image = RgbImage::from_fn(width_px, height_px, colour);
    image.save(path).map_err(|error| format!("{}: {error}", path.display()).into())
}
