//! A camera's pixels to 8-bit grey, or to 16-bit values.

use crate::pairs::is_whole_jpeg;
use image::ImageReader;
use serde::{Deserialize, Serialize};
use std::io::Cursor;

/// Pixel formats, by the names that Video4Linux gives them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PixelFormat {
    /// 8-bit grey.
    Grey,
    /// 10-bit grey in the low bits of 16.
    Y10,
    /// 12-bit grey in the low bits of 16.
    Y12,
    /// 16-bit grey.
    Y16,
    /// Colour, 4:2:2: luma and chroma alternate.
    Yuyv,
    /// Colour, 4:2:2: chroma and luma alternate.
    Uyvy,
    /// Colour, 4:2:0: luma first.
    Nv12,
    /// Motion JPEG.
    Mjpeg,
    /// 16-bit depth.
    Z16,
}

/// Width and height of an image, px, and the bytes from row to row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Layout {
    pub(crate) width: usize,
    pub(crate) height: usize,
    /// 0: the rows follow each other.
    pub(crate) stride: usize,
}

/// Why a frame is of no use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Unusable {
    /// It ends early.
    Short,
    /// It does not decode to an image of the expected size.
    Undecodable,
}

impl PixelFormat {
    /// As Video4Linux names it.
    pub const fn four_cc(self) -> [u8; 4] {
        match self {
            Self::Grey => *b"GREY",
            Self::Y10 => *b"Y10 ",
            Self::Y12 => *b"Y12 ",
            Self::Y16 => *b"Y16 ",
            Self::Yuyv => *b"YUYV",
            Self::Uyvy => *b"UYVY",
            Self::Nv12 => *b"NV12",
            Self::Mjpeg => *b"MJPG",
            Self::Z16 => *b"Z16 ",
        }
    }

    /// Bytes of a row's pixels; `None` for a compressed format.
    pub(crate) const fn row_bytes(self, width: usize) -> Option<usize> {
        match self {
            Self::Grey | Self::Nv12 => Some(width),
            Self::Y10 | Self::Y12 | Self::Y16 | Self::Yuyv | Self::Uyvy | Self::Z16 => Some(2 * width),
            Self::Mjpeg => None,
        }
    }

    /// Bytes of a whole frame without gaps; `None` for a compressed format.
    pub(crate) fn frame_bytes(self, width: usize, height: usize) -> Option<usize> {
        let luma = self.row_bytes(width)? * height;
        Some(if self == Self::Nv12 { luma + luma / 2 } else { luma })
    }

    /// The rows' bytes, or why there are not enough of them.
    fn rows(self, bytes: &[u8], layout: Layout) -> Result<impl Iterator<Item = &[u8]>, Unusable> {
        let row = self.row_bytes(layout.width).ok_or(Unusable::Undecodable)?;
        let stride = layout.stride.max(row);
        let needed = stride * (layout.height - 1) + row;
        let all = bytes.get(..needed).ok_or(Unusable::Short)?;
        Ok(all.chunks(stride).map(move |line| &line[..row]))
    }

    /// Grey levels, row by row.
    pub(crate) fn grey(self, bytes: &[u8], layout: Layout, out: &mut [u8]) -> Result<(), Unusable> {
        if self == Self::Mjpeg {
            return decode_jpeg(bytes, layout, out);
        }
        let word = |pair: &[u8]| u16::from_le_bytes([pair[0], pair[1]]);
        for (line, out) in self.rows(bytes, layout)?.zip(out.chunks_exact_mut(layout.width)) {
            match self {
                Self::Grey | Self::Nv12 => out.copy_from_slice(line),
                Self::Yuyv => out.iter_mut().zip(line.chunks_exact(2)).for_each(|(out, pair)| *out = pair[0]),
                Self::Uyvy => out.iter_mut().zip(line.chunks_exact(2)).for_each(|(out, pair)| *out = pair[1]),
                _ => {
                    let unused = match self {
                        Self::Y10 => 2,
                        Self::Y12 => 4,
                        _ => 8,
                    };
                    let level = |pair: &[u8]| (word(pair) >> unused).min(255) as u8;
                    out.iter_mut().zip(line.chunks_exact(2)).for_each(|(out, pair)| *out = level(pair));
                }
            }
        }
        Ok(())
    }

    /// 16-bit values, row by row.
    pub(crate) fn values(self, bytes: &[u8], layout: Layout, out: &mut [u16]) -> Result<(), Unusable> {
        for (line, out) in self.rows(bytes, layout)?.zip(out.chunks_exact_mut(layout.width)) {
            let words = line.chunks_exact(2).map(|pair| u16::from_le_bytes([pair[0], pair[1]]));
            out.iter_mut().zip(words).for_each(|(out, value)| *out = value);
        }
        Ok(())
    }
}

fn decode_jpeg(bytes: &[u8], layout: Layout, out: &mut [u8]) -> Result<(), Unusable> {
    if !is_whole_jpeg(bytes) {
        return Err(Unusable::Short);
    }
    let reader = ImageReader::with_format(Cursor::new(bytes), image::ImageFormat::Jpeg);
    let image = reader.decode().map_err(|_| Unusable::Undecodable)?.into_luma8();
    if (image.width() as usize, image.height() as usize) != (layout.width, layout.height) {
        return Err(Unusable::Undecodable);
    }
    out.copy_from_slice(image.as_raw());
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const LAYOUT: Layout = Layout { width: 4, height: 2, stride: 0 };

    fn grey(format: PixelFormat, layout: Layout, bytes: &[u8]) -> Result<Vec<u8>, Unusable> {
        let mut out = vec![0; layout.width * layout.height];
        format.grey(bytes, layout, &mut out).map(|()| out)
    }

    #[test]
    fn luma_is_found_in_every_format() {
        let expected = vec![1, 2, 3, 4, 5, 6, 7, 8];
        let words = |shift: u32| expected.iter().flat_map(|&level| (u16::from(level) << shift).to_le_bytes()).collect();
        let chroma_after: Vec<u8> = expected.iter().flat_map(|&level| [level, 200]).collect();
        let chroma_before: Vec<u8> = expected.iter().flat_map(|&level| [200, level]).collect();
        let planar: Vec<u8> = expected.iter().copied().chain([200; 4]).collect();
        for (format, bytes) in [
            (PixelFormat::Grey, expected.clone()),
            (PixelFormat::Y10, words(2)),
            (PixelFormat::Y12, words(4)),
            (PixelFormat::Y16, words(8)),
            (PixelFormat::Yuyv, chroma_after),
            (PixelFormat::Uyvy, chroma_before),
            (PixelFormat::Nv12, planar),
        ] {
            assert_eq!(format.frame_bytes(4, 2), Some(bytes.len()), "{format:?}");
            assert_eq!(grey(format, LAYOUT, &bytes), Ok(expected.clone()), "{format:?}");
        }
    }

    #[test]
    fn gaps_between_rows_are_skipped_and_short_frames_refused() {
        let layout = Layout { stride: 6, ..LAYOUT };
        let bytes = [1, 2, 3, 4, 99, 99, 5, 6, 7, 8];
        assert_eq!(grey(PixelFormat::Grey, layout, &bytes), Ok(vec![1, 2, 3, 4, 5, 6, 7, 8]));
        assert_eq!(grey(PixelFormat::Grey, layout, &bytes[..9]), Err(Unusable::Short));
        assert_eq!(grey(PixelFormat::Yuyv, LAYOUT, &[]), Err(Unusable::Short));
        let mut values = [0; 8];
        assert_eq!(PixelFormat::Z16.values(&[0; 15], LAYOUT, &mut values), Err(Unusable::Short));
        assert_eq!(PixelFormat::Z16.values(&[0x34, 0x12].repeat(8), LAYOUT, &mut values), Ok(()));
        assert_eq!(values, [0x1234; 8]);
    }

    #[test]
    fn jpeg_of_another_size_or_damaged_is_refused() {
        let mut jpeg = Vec::new();
        let image = image::GrayImage::from_pixel(4, 2, image::Luma([77]));
        image.write_to(&mut Cursor::new(&mut jpeg), image::ImageFormat::Jpeg).expect("encoded");
        let found = grey(PixelFormat::Mjpeg, LAYOUT, &jpeg).expect("decoded");
        assert!(found.iter().all(|level| level.abs_diff(77) < 3), "{found:?}");
        assert_eq!(grey(PixelFormat::Mjpeg, Layout { width: 2, ..LAYOUT }, &jpeg), Err(Unusable::Undecodable));
        assert_eq!(grey(PixelFormat::Mjpeg, LAYOUT, &[&jpeg[..], &[0; 7]].concat()), Ok(found), "padded");
        assert_eq!(grey(PixelFormat::Mjpeg, LAYOUT, &jpeg[..jpeg.len() - 5]), Err(Unusable::Short));
        assert_eq!(grey(PixelFormat::Mjpeg, LAYOUT, &[1, 2, 0xff, 0xd9]), Err(Unusable::Undecodable));
        assert_eq!(grey(PixelFormat::Mjpeg, LAYOUT, &[]), Err(Unusable::Short));
    }
}
