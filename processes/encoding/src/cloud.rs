//! What is seen, as a cloud of points in the camera's frame: made of a disparity image, and read again.

use crate::views::{pose, timestamp};
use foxglove::messages::{PackedElementField, PointCloud, packed_element_field};
use ipc_types::messages::DisparityImage;
use ipc_types::wire::Stamp;
use ipc_types::{Camera, FlightTime, Point, StereoRig, disparity};
use prost::Message;

/// Every so-many-th pixel of a row, and every so-many-th row, is a point.
const THINNED: usize = 8;
/// x, y and z, in single precision.
const POINT_BYTES: usize = 12;

/// Pixels with a disparity, thinned, as points. `bytes` are the image's.
pub(crate) fn cloud(rig: &StereoRig, stamp: &Stamp, found: &DisparityImage, bytes: &[u8]) -> PointCloud {
    let width = (found.width_px as usize).max(1);
    let mut data = Vec::new();
    for (row, pixels) in bytes.chunks_exact(2 * width).enumerate().step_by(THINNED) {
        for (column, pixel) in pixels.as_chunks::<2>().0.iter().enumerate().step_by(THINNED) {
            if let Some(d) = disparity::decode(u16::from_ne_bytes(*pixel)) {
                let point = rig.back_project(column as f64, row as f64, f64::from(d));
                [point.x, point.y, point.z].iter().for_each(|&x| data.extend_from_slice(&(x as f32).to_le_bytes()));
            }
        }
    }
    let field = |(name, offset): (&str, u32)| PackedElementField {
        name: name.to_owned(),
        offset,
        r#type: packed_element_field::NumericType::Float32.into(),
    };
    PointCloud {
        timestamp: timestamp(stamp.valid_ns),
        frame_id: "camera".to_owned(),
        pose: Some(pose([0.0; 3])),
        point_stride: POINT_BYTES as u32,
        fields: [("x", 0), ("y", 4), ("z", 8)].map(field).to_vec(),
        data: data.into(),
    }
}

/// Of [`crate::View::Obstacles`]: when it was seen, and the points, m; `None` if the bytes are no cloud.
pub fn points(bytes: &[u8]) -> Option<(FlightTime, Vec<Point<Camera>>)> {
    let cloud = PointCloud::decode(bytes).ok()?;
    let at_ns = i64::try_from(cloud.timestamp.unwrap_or_default().total_nanos()).ok()?;
    let number = |bytes: [u8; 4]| f64::from(f32::from_le_bytes(bytes));
    let point = |bytes: &[u8; POINT_BYTES]| {
        let [x0, x1, x2, x3, y0, y1, y2, y3, z0, z1, z2, z3] = *bytes;
        Point::new(number([x0, x1, x2, x3]), number([y0, y1, y2, y3]), number([z0, z1, z2, z3]))
    };
    Some((FlightTime::from_nanos(at_ns), cloud.data.as_chunks().0.iter().map(point).collect()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;

    #[test]
    fn what_is_made_a_cloud_is_where_it_was_seen() {
        let rig = StereoRig {
            width_px: 32,
            height_px: 24,
            focal_px: 30.0,
            cx_px: 15.5,
            cy_px: 11.5,
            baseline_m: 0.3,
            doffs_px: 0.0,
        };
        let stamp = Stamp { valid_ns: 1_500_000_000, ..Stamp::zeroed() };
        let found = DisparityImage { stamp, width_px: 32, height_px: 24, ..DisparityImage::zeroed() };
        let mut pixels = vec![disparity::NO_MATCH; rig.pixels()];
        pixels[8 * 32 + 16] = disparity::encode(3.0);
        // Between the rows and columns that are taken.
        pixels[9 * 32 + 17] = disparity::encode(3.0);
        let bytes = cloud(&rig, &stamp, &found, bytemuck::cast_slice(&pixels)).encode_to_vec();
        let (at, points) = points(&bytes).expect("a cloud");
        let expected = rig.back_project(16.0, 8.0, 3.0);
        assert_eq!((at.as_nanos(), points.len()), (1_500_000_000, 1));
        assert!(points[0].distance(expected) < 1e-5, "{:?} for {expected:?}", points[0]);
        assert!(super::points(&[0xff; 9]).is_none());
    }
}
