//! Which obstacle each pixel sees, and how far: analytic intersection within each obstacle's screen rectangle.
//!
//! A ray is o + t·d with d = (x, y, 1) in the camera, so t is the depth along the optical axis. Rows of a rectangle
//! are intersected in straight loops that vectorise, against a depth buffer.

use multiversion::multiversion;

/// A capsule in camera coordinates relative to one eye.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EyeCapsule {
    pub(crate) from: [f32; 3],
    pub(crate) to: [f32; 3],
    pub(crate) radius: f32,
}

/// The pinhole of one eye.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pinhole {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) focal: f32,
    pub(crate) centre: (f32, f32),
}

/// Pixels from..to, columns and rows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Rectangle {
    pub(crate) columns: (usize, usize),
    pub(crate) rows: (usize, usize),
}

/// Nearest depth that is rendered, m.
pub(crate) const NEAREST: f32 = 0.05;

impl Pinhole {
    /// Rectangle that contains the projections of balls of `radius` around `corners`, or `None` when out of view.
    pub(crate) fn rectangle(&self, corners: &[[f32; 3]], radius: f32) -> Option<Rectangle> {
        if self.is_outside(corners, radius) {
            return None;
        }
        let (mut least, mut most) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
        for corner in corners {
            let z = corner[2];
            if z <= radius * 1.01 + NEAREST {
                // Too close for tangents: the whole image.
                (least, most) = ([-1e9; 2], [1e9; 2]);
                continue;
            }
            let q = radius / z;
            for axis in 0..2 {
                let x = corner[axis] / z;
                let spread = q * (1.0 + x * x - q * q).sqrt();
                least[axis] = least[axis].min((x - spread) / (1.0 - q * q));
                most[axis] = most[axis].max((x + spread) / (1.0 - q * q));
            }
        }
        let clip =
            |value: f32, centre: f32, length: usize| (value * self.focal + centre).clamp(-1.0, length as f32) as isize;
        let span = |axis: usize, centre: f32, length: usize| {
            let from = clip(least[axis], centre, length).max(0) as usize;
            let to = (clip(most[axis], centre, length) + 2).clamp(0, length as isize) as usize;
            (from, to)
        };
        let columns = span(0, self.centre.0, self.width);
        let rows = span(1, self.centre.1, self.height);
        (columns.0 < columns.1 && rows.0 < rows.1).then_some(Rectangle { columns, rows })
    }

    /// Whether all balls lie beyond one of the planes that bound the view.
    fn is_outside(&self, corners: &[[f32; 3]], radius: f32) -> bool {
        let (left, top) = ((self.centre.0 + 1.0) / self.focal, (self.centre.1 + 1.0) / self.focal);
        let right = (self.width as f32 - self.centre.0) / self.focal;
        let bottom = (self.height as f32 - self.centre.1) / self.focal;
        let planes = [[1.0, 0.0, left], [-1.0, 0.0, right], [0.0, 1.0, top], [0.0, -1.0, bottom], [0.0, 0.0, 1.0]];
        planes.iter().any(|&plane| {
            let reach = -radius * dot(plane, plane).sqrt();
            corners.iter().all(|&corner| dot(plane, corner) < reach)
        })
    }
}

/// Pixels that are intersected together; rows are padded to a multiple of it.
pub(crate) const LANES: usize = 8;

/// Length of a row in the buffers, px.
pub(crate) const fn stride(width: usize) -> usize {
    width.next_multiple_of(LANES)
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Draws a capsule into the depth and identity buffers.
///
/// Whole groups of [`LANES`] pixels are intersected: those beside the rectangle simply miss.
#[expect(clippy::needless_range_loop, reason = "several arrays are indexed by the same lane")]
#[multiversion(targets("x86_64+avx512f+avx512bw", "x86_64+avx2+fma", "aarch64+neon"))]
pub(crate) fn draw_capsule(
    pinhole: Pinhole,
    rectangle: Rectangle,
    capsule: EyeCapsule,
    identity: u32,
    depths: &mut [f32],
    identities: &mut [u32],
) {
    let EyeCapsule { from, to, radius } = capsule;
    let axis = [to[0] - from[0], to[1] - from[1], to[2] - from[2]];
    // The eye is the origin, so the vector from an end to the eye is minus that end.
    let (axis2, axis_from, from2) = (dot(axis, axis), -dot(axis, from), dot(from, from));
    let (to_c, from_c) = (dot(to, to) - radius * radius, from2 - radius * radius);
    let is_ball = axis2 < 1e-9;
    let side_c = axis2 * from2 - axis_from * axis_from - radius * radius * axis2;
    let (first, last) = (rectangle.columns.0 / LANES * LANES, rectangle.columns.1.next_multiple_of(LANES));
    let scale = 1.0 / pinhole.focal;
    for row in rectangle.rows.0..rectangle.rows.1 {
        let y = (row as f32 - pinhole.centre.1) * scale;
        let line = row * stride(pinhole.width);
        let depths = depths[line + first..line + last].as_chunks_mut::<LANES>().0;
        let identities = identities[line + first..line + last].as_chunks_mut::<LANES>().0;
        for (group, (depths, seen)) in depths.iter_mut().zip(identities).enumerate() {
            let left = (first + group * LANES) as f32 - pinhole.centre.0;
            let mut hits = [0.0_f32; LANES];
            for lane in 0..LANES {
                let x = (left + lane as f32) * scale;
                let ray2 = x * x + y * y + 1.0;
                let ray_from = -(from[0] * x + from[1] * y + from[2]);
                // A missed root is NaN, and every comparison with it false.
                hits[lane] = (-ray_from - (ray_from * ray_from - ray2 * from_c).sqrt()) / ray2;
            }
            if !is_ball {
                for lane in 0..LANES {
                    let x = (left + lane as f32) * scale;
                    let ray2 = x * x + y * y + 1.0;
                    let axis_ray = axis[0] * x + axis[1] * y + axis[2];
                    let ray_from = -(from[0] * x + from[1] * y + from[2]);
                    let ray_to = -(to[0] * x + to[1] * y + to[2]);
                    let a = axis2 * ray2 - axis_ray * axis_ray;
                    let b = axis2 * ray_from - axis_from * axis_ray;
                    let side = (-b - (b * b - a * side_c).sqrt()) / a;
                    let along = axis_from + side * axis_ray;
                    let on_side = (along > 0.0) & (along < axis2);
                    let cap_to = (-ray_to - (ray_to * ray_to - ray2 * to_c).sqrt()) / ray2;
                    let cap_from = hits[lane];
                    let nearest_cap = if (cap_to < cap_from) | cap_from.is_nan() { cap_to } else { cap_from };
                    hits[lane] = if on_side { side } else { nearest_cap };
                }
            }
            for lane in 0..LANES {
                let nearer = (hits[lane] > NEAREST) & (hits[lane] < depths[lane]);
                depths[lane] = if nearer { hits[lane] } else { depths[lane] };
                seen[lane] = if nearer { identity } else { seen[lane] };
            }
        }
    }
}

/// An upright box in its own axes: where the eye is, how its rays run, and the box's half extents.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EyeCuboid {
    pub(crate) eye: [f32; 3],
    /// Per axis of the box: change with the column's slope, with the row's slope, and the constant part.
    pub(crate) rays: [[f32; 3]; 3],
    pub(crate) half: [f32; 3],
}

/// Draws a box into the depth and identity buffers.
pub(crate) fn draw_cuboid(
    pinhole: Pinhole,
    rectangle: Rectangle,
    cuboid: EyeCuboid,
    identity: u32,
    depths: &mut [f32],
    identities: &mut [u32],
) {
    let EyeCuboid { eye, rays, half } = cuboid;
    for row in rectangle.rows.0..rectangle.rows.1 {
        let y = (row as f32 - pinhole.centre.1) / pinhole.focal;
        for column in rectangle.columns.0..rectangle.columns.1 {
            let x = (column as f32 - pinhole.centre.0) / pinhole.focal;
            let (mut enter, mut leave) = (0.0_f32, f32::INFINITY);
            for axis in 0..3 {
                let along = rays[axis][0] * x + rays[axis][1] * y + rays[axis][2];
                let (a, b) = ((-half[axis] - eye[axis]) / along, (half[axis] - eye[axis]) / along);
                enter = enter.max(a.min(b));
                leave = leave.min(a.max(b));
            }
            let index = row * stride(pinhole.width) + column;
            if enter <= leave && enter > NEAREST && enter < depths[index] {
                depths[index] = enter;
                identities[index] = identity;
            }
        }
    }
}
