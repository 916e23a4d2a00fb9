//! Disparity on the wire: unsigned fixed point, and what an invalid pixel says.
//!
//! A disparity pixel is a `u16` in 1/[`SCALE`] px (so 0.015625 px steps up to 1023 px). Values below
//! [`MINIMUM`] are not disparities but reasons why there is none:
//!
//! | value | meaning |
//! |---|---|
//! | [`NO_MATCH`] (0) | no consistent match, and little texture right here; or an outlier; or nobody knows why |
//! | [`TEXTURELESS`] (1) | too little texture to match: clear sky, or a blank wall |
//! | [`MASKED`] (2) | outside the rectified image, or masked by the vehicle's own structure |
//! | [`TEXTURED`] (3) | no consistent match, though there is texture right here: ambiguous, or hidden from the right camera |
//!
//! Because every code is smaller than every disparity, "nearest" is `max` without a special case.
//! Unmatched is never "far": a code grants no free space by itself.

/// Fixed-point units per pixel of disparity.
pub const SCALE: f32 = 64.0;
/// No consistent match.
pub const NO_MATCH: u16 = 0;
/// Too little texture to match.
pub const TEXTURELESS: u16 = 1;
/// Outside the valid image.
pub const MASKED: u16 = 2;
/// No consistent match, though there is texture right here: no blank surface. Beside a nearer surface, in whose shadow it
/// lies, it is hidden from the right camera, as a rule.
pub const TEXTURED: u16 = 3;
/// Smallest valid disparity (0.25 px). Anything farther is reported as this near, which is the safe side.
pub const MINIMUM: u16 = 16;

/// Whether a pixel holds a disparity rather than a code.
#[inline]
pub const fn is_valid(pixel: u16) -> bool {
    pixel >= MINIMUM
}

/// Pixel for a disparity in px: rounded, saturated at both ends; NaN becomes [`NO_MATCH`].
#[inline]
pub fn encode(disparity_px: f32) -> u16 {
    if disparity_px.is_nan() {
        return NO_MATCH;
    }
    ((disparity_px * SCALE).round() as u16).max(MINIMUM)
}

/// Disparity in px, or `None` for a code.
#[inline]
pub fn decode(pixel: u16) -> Option<f32> {
    is_valid(pixel).then(|| f32::from(pixel) / SCALE)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn encoding_saturates_towards_the_near_side() {
        assert_eq!(encode(0.0), MINIMUM);
        assert_eq!(encode(-3.0), MINIMUM);
        assert_eq!(encode(1e9), u16::MAX);
        assert_eq!(encode(f32::NAN), NO_MATCH);
        assert_eq!(decode(encode(12.5)), Some(12.5));
        assert_eq!(decode(TEXTURELESS), None);
    }
}
