//! Rounding that vectorises: a cast from float to integer saturates, which compilers do one number at a time.

/// A number from 0 to 2²² rounded to the nearest integer, halves to even. What is no such number gives some integer.
#[inline(always)]
pub fn to_nearest(value: f32) -> u32 {
    const SHIFT: f32 = 8_388_608.0;
    // From 2²³ to 2²⁴ a float's steps are integers, and its lower bits count them.
    (value + SHIFT).to_bits().wrapping_sub(SHIFT.to_bits())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounds_as_the_standard_library_does() {
        for value in (0..200_000).map(|i| i as f32 * 20.971_52).chain([0.0, 0.49, 0.5, 1.5, 2.5, 4_194_303.5]) {
            assert_eq!(to_nearest(value), value.round_ties_even() as u32, "{value}");
        }
        for hostile in [f32::NAN, f32::INFINITY, -1e30] {
            to_nearest(hostile);
        }
    }
}
