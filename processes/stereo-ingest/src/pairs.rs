//! Files: image pairs, depth images (16-bit PNG), disparity images (16-bit PNG × 256, PFM).

use image::{DynamicImage, ImageReader, Luma};
use ipc_types::StereoRig;
use ipc_types::disparity::{NO_MATCH, SCALE, decode};
use std::fs;
use std::io::{self, Cursor, Write};
use std::path::Path;

/// Largest calibration, bytes.
pub(crate) const LARGEST_CALIBRATION: u64 = 1 << 20;
/// Largest file that is read whole, bytes.
const LARGEST_FILE: u64 = 256 << 20;

/// Why a file was refused. Every message names the file, what was found, and what was expected.
#[derive(Debug, thiserror::Error)]
pub enum PairError {
    /// Cannot be read.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: String,
        /// Why.
        source: io::Error,
    },
    /// Not an image that can be decoded.
    #[error("{path}: {source}")]
    Image {
        /// The file.
        path: String,
        /// Why.
        source: image::ImageError,
    },
    /// Decoded, but not what was needed.
    #[error("{path}: {problem}")]
    Unusable {
        /// The file.
        path: String,
        /// What was found and what was expected.
        problem: String,
    },
}

pub(crate) fn unusable(path: &Path, problem: impl Into<String>) -> PairError {
    PairError::Unusable { path: path.display().to_string(), problem: problem.into() }
}

fn io_error(path: &Path) -> impl FnOnce(io::Error) -> PairError {
    let path = path.display().to_string();
    move |source| PairError::Io { path, source }
}

/// A text file of at most so many bytes.
pub(crate) fn read_text(path: &Path, most: u64) -> Result<String, PairError> {
    let bytes = fs::metadata(path).map_err(io_error(path))?.len();
    if bytes > most {
        return Err(unusable(path, format!("has {bytes} bytes, allowed are {most}")));
    }
    fs::read_to_string(path).map_err(io_error(path))
}

fn read_image(path: &Path) -> Result<DynamicImage, PairError> {
    let bytes = fs::read(path).map_err(io_error(path))?;
    let reader = ImageReader::new(Cursor::new(&bytes)).with_guessed_format().map_err(io_error(path))?;
    if reader.format() == Some(image::ImageFormat::Jpeg) && !is_whole_jpeg(&bytes) {
        return Err(unusable(path, "is a JPEG file without an end: cut short"));
    }
    reader.decode().map_err(|source| PairError::Image { path: path.display().to_string(), source })
}

/// Whether an image's end is there; decoders fill with grey what is missing. Cameras pad frames with zeros.
pub(crate) fn is_whole_jpeg(bytes: &[u8]) -> bool {
    let end = bytes.iter().rposition(|&byte| byte != 0).map_or(0, |last| last + 1);
    bytes[..end].ends_with(&[0xff, 0xd9])
}

/// Both images as 8-bit grey. 16-bit files hold 8 to 16 bits, as many as the brightest pixel of either needs: they are
/// scaled alike, so that what differs between the cameras goes on to differ.
fn read_grey(left: &Path, right: &Path) -> Result<[image::GrayImage; 2], PairError> {
    let images = [read_image(left)?, read_image(right)?];
    let is_deep = |image: &DynamicImage| image.color().bytes_per_pixel() / image.color().channel_count() > 1;
    if !images.iter().any(is_deep) {
        return Ok(images.map(DynamicImage::into_luma8));
    }
    let deep = images.map(DynamicImage::into_luma16);
    let brightest = deep.iter().flat_map(|image| image.as_raw()).copied().max().unwrap_or(0);
    let bits = [8, 10, 12, 14].into_iter().find(|bits| brightest >> bits == 0).unwrap_or(16);
    let level = |value: u16| (value >> (bits - 8)) as u8;
    Ok(deep.map(|image| {
        let (width, height) = image.dimensions();
        image::GrayImage::from_fn(width, height, |column, row| Luma([level(image.get_pixel(column, row).0[0])]))
    }))
}

/// A pair of equal size, converted to 8-bit grey.
#[derive(Clone, Debug, PartialEq)]
pub struct StereoPair {
    /// Width of each image, px.
    pub width_px: u32,
    /// Height of each image, px.
    pub height_px: u32,
    /// The left image's pixels, then the right one's.
    pub pixels: Vec<u8>,
}

impl StereoPair {
    /// Reads two image files (PNG, JPEG, PGM/PPM, BMP; 8 or 16 bits; colour is converted).
    ///
    /// # Errors
    /// A file is missing or damaged, or the images differ in size.
    pub fn load(left: &Path, right: &Path) -> Result<Self, PairError> {
        let [left_image, right_image] = read_grey(left, right)?;
        let (size, other) = (left_image.dimensions(), right_image.dimensions());
        if size != other {
            let problem =
                format!("is {} x {} px, but {} is {} x {} px", other.0, other.1, left.display(), size.0, size.1);
            return Err(unusable(right, problem));
        }
        let mut pixels = left_image.into_raw();
        pixels.extend_from_slice(&right_image);
        Ok(Self { width_px: size.0, height_px: size.1, pixels })
    }
}

/// A depth image, or one of ready-made disparity, as the sensor delivered it.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthImage {
    /// Width, px.
    pub width_px: u32,
    /// Height, px.
    pub height_px: u32,
    /// The pixels, in the sensor's units.
    pub values: Vec<u16>,
}

impl DepthImage {
    /// Reads a 16-bit grey PNG or PGM.
    ///
    /// # Errors
    /// The file is missing, damaged, or of another type.
    pub fn load(path: &Path) -> Result<Self, PairError> {
        match read_image(path)? {
            DynamicImage::ImageLuma16(image) => {
                let (width_px, height_px) = image.dimensions();
                Ok(Self { width_px, height_px, values: image.into_raw() })
            }
            other => {
                let problem = format!("has pixels of type {:?}, expected 16-bit grey", other.color());
                Err(unusable(path, problem))
            }
        }
    }
}

/// Reads a disparity image: 16-bit PNG (KITTI: px × 256, 0 = none) or PFM (px; infinite, NaN or ≤ 0 = none).
///
/// # Errors
/// The file is missing, damaged, of another type, or not of the given size.
pub fn load_disparity(path: &Path, width_px: u32, height_px: u32) -> Result<Vec<Option<f32>>, PairError> {
    let is_pfm = path.extension().is_some_and(|extension| extension == "pfm");
    let (size, disparities) = if is_pfm {
        read_pfm(path)?
    } else {
        match read_image(path)? {
            DynamicImage::ImageLuma16(image) => {
                let disparities = image.pixels().map(|Luma([raw])| f32::from(*raw) / 256.0).collect();
                (image.dimensions(), disparities)
            }
            other => {
                let problem = format!("has pixels of type {:?}, expected 16-bit grey (px × 256) or PFM", other.color());
                return Err(unusable(path, problem));
            }
        }
    };
    if size != (width_px, height_px) {
        let problem = format!("is {} x {} px, expected {width_px} x {height_px} px", size.0, size.1);
        return Err(unusable(path, problem));
    }
    Ok(disparities.into_iter().map(|d: f32| (d.is_finite() && d > 0.0).then_some(d)).collect())
}

/// Reads a mask: pixels of 128 and more are set.
///
/// # Errors
/// The file is missing, damaged, or not of the given size.
pub fn load_mask(path: &Path, width_px: u32, height_px: u32) -> Result<Vec<bool>, PairError> {
    let image = read_image(path)?.into_luma8();
    if image.dimensions() != (width_px, height_px) {
        let (width, height) = image.dimensions();
        return Err(unusable(path, format!("is {width} x {height} px, expected {width_px} x {height_px} px")));
    }
    Ok(image.into_raw().into_iter().map(|pixel| pixel >= 128).collect())
}

fn read_pfm(path: &Path) -> Result<((u32, u32), Vec<f32>), PairError> {
    let bytes_on_disk = fs::metadata(path).map_err(io_error(path))?.len();
    if bytes_on_disk > LARGEST_FILE {
        return Err(unusable(path, format!("has {bytes_on_disk} bytes, allowed are {LARGEST_FILE}")));
    }
    let bytes = fs::read(path).map_err(io_error(path))?;
    let not_pfm = || unusable(path, "is not a grey PFM file (Pf, width height, scale, 32-bit rows bottom up)");
    let mut lines = bytes.splitn(4, |&byte| byte == b'\n');
    let mut line = || lines.next().and_then(|line| std::str::from_utf8(line).ok()).map(str::trim);
    let (magic, size, scale) = (line().ok_or_else(not_pfm)?, line().ok_or_else(not_pfm)?, line().ok_or_else(not_pfm)?);
    let data = lines.next().ok_or_else(not_pfm)?;
    let (width, height) = size.split_once(' ').ok_or_else(not_pfm)?;
    let (width, height): (u32, u32) =
        (width.parse().map_err(|_| not_pfm())?, height.trim().parse().map_err(|_| not_pfm())?);
    let little_endian = scale.parse::<f32>().map_err(|_| not_pfm())? < 0.0;
    let side = 1..=StereoRig::MAX_SIDE_PX;
    let fits = side.contains(&width) && side.contains(&height) && data.len() == width as usize * height as usize * 4;
    if magic != "Pf" || !fits {
        return Err(not_pfm());
    }
    let value = |cell: &[u8]| {
        let cell = [cell[0], cell[1], cell[2], cell[3]];
        if little_endian { f32::from_le_bytes(cell) } else { f32::from_be_bytes(cell) }
    };
    let rows = data.chunks_exact(width as usize * 4).rev();
    Ok(((width, height), rows.flat_map(|row| row.chunks_exact(4)).map(value).collect()))
}

/// Writes fixed-point disparities as a file of the kind its extension asks for: `.pfm` (px, infinite where
/// unmatched) or `.png` (16 bit, px × 256, 0 where unmatched).
///
/// # Errors
/// Another extension, or the file cannot be written.
pub fn save_disparity(path: &Path, width_px: u32, height_px: u32, disparity: &[u16]) -> Result<(), PairError> {
    match path.extension().and_then(|extension| extension.to_str()) {
        Some("pfm") => {
            let mut bytes = format!("Pf\n{width_px} {height_px}\n-1.0\n").into_bytes();
            for row in disparity.chunks_exact(width_px as usize).rev() {
                row.iter().for_each(|&d| bytes.extend(decode(d).unwrap_or(f32::INFINITY).to_le_bytes()));
            }
            let mut file = fs::File::create(path).map_err(io_error(path))?;
            file.write_all(&bytes).map_err(io_error(path))
        }
        Some("png") => {
            let kitti = |&d: &u16| decode(d).map_or(NO_MATCH, |_| d.saturating_mul((256.0 / SCALE) as u16));
            let pixels: Vec<u16> = disparity.iter().map(kitti).collect();
            let image = image::ImageBuffer::<Luma<u16>, _>::from_raw(width_px, height_px, pixels);
            let image = image.ok_or_else(|| unusable(path, "the image is not of the stated size"))?;
            image.save(path).map_err(|source| PairError::Image { path: path.display().to_string(), source })
        }
        _ => Err(unusable(path, "has no known extension; expected .png or .pfm")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ipc_types::disparity::encode;

    #[test]
    fn deep_images_are_scaled_alike_whatever_their_bits() {
        let folder = std::env::temp_dir().join(format!("sparrowhawk-deep-{}", std::process::id()));
        fs::create_dir_all(&folder).expect("writable");
        let (left, right) = (folder.join("left.png"), folder.join("right.png"));
        let save = |path: &Path, pixels: [u16; 4]| {
            let image = image::ImageBuffer::<Luma<u16>, _>::from_raw(4, 1, pixels.to_vec()).expect("of that size");
            image.save(path).expect("written");
        };
        for bits in [8, 10, 12, 14, 16] {
            save(&left, [1, 20, 150, 255].map(|level: u16| level << (bits - 8)));
            save(&right, [1, 10, 75, 128].map(|level: u16| level << (bits - 8)));
            let pair = StereoPair::load(&left, &right).expect("read");
            assert_eq!(pair.pixels, [1, 20, 150, 255, 1, 10, 75, 128], "{bits} bits");
        }
        fs::remove_dir_all(&folder).expect("removable");
    }

    #[test]
    fn disparity_files_round_trip() {
        let folder = std::env::temp_dir().join(format!("sparrowhawk-pairs-{}", std::process::id()));
        fs::create_dir_all(&folder).expect("writable");
        let image = [encode(3.5), NO_MATCH, encode(63.25), encode(1.0), encode(0.5), NO_MATCH];
        let expected: Vec<Option<f32>> = image.iter().map(|&d| decode(d)).collect();
        for name in ["d.pfm", "d.png"] {
            let path = folder.join(name);
            save_disparity(&path, 3, 2, &image).expect("written");
            assert_eq!(load_disparity(&path, 3, 2).expect("read"), expected, "{name}");
            assert!(load_disparity(&path, 2, 3).is_err(), "{name} of another size");
        }
        fs::write(folder.join("torn.pfm"), b"Pf\n3 2\n-1.0\nabc").expect("writable");
        assert!(load_disparity(&folder.join("torn.pfm"), 3, 2).is_err());
        fs::remove_dir_all(&folder).expect("removable");
    }
}
