//! Which pixels a sphere covers along one image axis.
//!
//! In the plane of the optical axis and one image axis, a sphere of radius r at slope x and depth z casts the shadow
//! of a circle. With q = r/z the slopes of the circle's two tangents through the camera are
//! (x ± q·√(1 + x² − q²)) / (1 − q²). They bound the sphere's silhouette whatever the other image coordinate is.

/// Tangent windows along one axis of the image.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Axis {
    pub(crate) focal_px: f32,
    pub(crate) centre_px: f32,
    pub(crate) length_px: usize,
}

impl Axis {
    /// Slope of a pixel's ray against the optical axis, without sign.
    #[inline(always)]
    pub(crate) fn slope(&self, pixel: usize) -> f32 {
        ((pixel as f32 - self.centre_px) / self.focal_px).abs()
    }

    /// Pixels from this one to the nearer border, itself included.
    pub(crate) fn to_border(self, pixel: usize) -> u16 {
        (pixel + 1).min(self.length_px - pixel) as u16
    }

    /// First and last pixel whose rays may touch a sphere of `q` = radius / depth centred anywhere in `pixel`.
    ///
    /// Half a pixel is added on both sides for where in the pixel the surface is. At q ≥ 1 the camera is inside
    /// the sphere: everything.
    #[inline(always)]
    pub(crate) fn window(&self, pixel: usize, q: f32) -> (i32, i32) {
        let x = (pixel as f32 - self.centre_px) / self.focal_px;
        let half = 0.5 / self.focal_px;
        let outside = q < 0.999;
        // Computed either way, without a branch, so that loops over pixels vectorise.
        let q = if outside { q } else { 0.5 };
        let denominator = 1.0 - q * q;
        let (left, right) = (x - half, x + half);
        let first = (left - q * (1.0 + left * left - q * q).sqrt()) / denominator;
        let last = (right + q * (1.0 + right * right - q * q).sqrt()) / denominator;
        let end = self.length_px as f32 - 1.0;
        // A query is looked up in the pixel nearest to it, so rounding of the tangents is to the nearest too;
        // the thousandth absorbs single-precision error. Not negative, so that truncation is rounding down.
        let first = (self.centre_px + self.focal_px * first + 0.499).clamp(0.0, end);
        let last = (self.centre_px + self.focal_px * last + 0.501).clamp(0.0, end);
        let (first, last) = if outside { (first, last) } else { (0.0, end) };
        (first as i32, last as i32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const AXIS: Axis = Axis { focal_px: 200.0, centre_px: 159.5, length_px: 320 };

    #[test]
    fn contains_the_projection_of_every_point_of_the_sphere() {
        for pixel in [0, 40, 159, 300, 319] {
            for q in [0.01_f32, 0.1, 0.5, 0.9] {
                let (first, last) = AXIS.window(pixel, q);
                let x = (pixel as f32 - AXIS.centre_px) / AXIS.focal_px;
                for step in 0..3600 {
                    let angle = step as f32 * 0.1_f32.to_radians();
                    let (dx, dz) = (q * angle.cos(), q * angle.sin());
                    let column = (AXIS.centre_px + AXIS.focal_px * (x + dx) / (1.0 + dz)).round();
                    if (0.0..320.0).contains(&column) {
                        assert!(
                            (first..=last).contains(&(column as i32)),
                            "{pixel} {q}: {column} not in {first}..={last}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn nearer_spheres_cover_what_farther_ones_do() {
        let mut previous = AXIS.window(100, 0.0);
        for q in (1..=1200).map(|i| i as f32 * 0.001) {
            let next = AXIS.window(100, q);
            assert!(next.0 <= previous.0 && next.1 >= previous.1);
            previous = next;
        }
        assert_eq!(previous, (0, 319));
    }
}
