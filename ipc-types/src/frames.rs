//! Typed coordinate frames, in Drake's monogram notation.
//!
//! ```text
//!   World (ENU, z up)        Body (FLU)               Camera (left, rectified)
//!        z up                     z up                      z forward (optical axis)
//!        |  y north               |  x forward             /
//!        | /                      | /                     o---- x right
//!        o---- x east      y -----o                       |
//!                          left                           y down
//! ```
//!
//! All lengths are metres. A pose is named `to_from_frame`: `world_from_camera` takes camera coordinates to world
//! coordinates, and when two poses are multiplied the adjacent words must match:
//!
//! ```
//! use ipc_types::{Body, Camera, Pose, World};
//! let world_from_body = Pose::<World, Body>::IDENTITY;
//! let body_from_camera = Pose::<Body, Camera>::IDENTITY;
//! let world_from_camera: Pose<World, Camera> = world_from_body * body_from_camera;
//! ```
//!
//! Frames that do not match do not compile:
//!
//! ```compile_fail
//! use ipc_types::{Body, Camera, Pose, World};
//! let world_from_body = Pose::<World, Body>::IDENTITY;
//! let world_from_camera = Pose::<World, Camera>::IDENTITY;
//! let nonsense = world_from_body * world_from_camera;
//! ```
//!
//! ```compile_fail
//! use ipc_types::{Body, Point, World};
//! let gap = Point::<World>::new(0.0, 0.0, 0.0) - Point::<Body>::new(0.0, 0.0, 0.0);
//! ```

use nalgebra::{Quaternion, Unit, UnitQuaternion, Vector3};
use std::marker::PhantomData;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub};

/// Fixed to the ground: x east, y north, z up; origin where the flight's map begins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum World {}
/// Fixed to the vehicle: x forward, y left, z up; origin at its centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Body {}
/// Rectified left camera: x right, y down, z along the optical axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Camera {}

macro_rules! triple {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        pub struct $name<F> {
            /// First coordinate, metres (or metres per second for a velocity).
            pub x: f64,
            /// Second coordinate.
            pub y: f64,
            /// Third coordinate.
            pub z: f64,
            frame: PhantomData<F>,
        }

        // Derives would demand the same of the marker `F`, which has no values.
        impl<F> Clone for $name<F> {
            fn clone(&self) -> Self {
                *self
            }
        }
        impl<F> Copy for $name<F> {}
        impl<F> PartialEq for $name<F> {
            fn eq(&self, other: &Self) -> bool {
                self.to_array() == other.to_array()
            }
        }
        impl<F> std::fmt::Debug for $name<F> {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                write!(f, "({:.3}, {:.3}, {:.3})", self.x, self.y, self.z)
            }
        }
        impl<F> $name<F> {
            /// All coordinates zero.
            pub const ZERO: Self = Self::new(0.0, 0.0, 0.0);

            /// From coordinates.
            pub const fn new(x: f64, y: f64, z: f64) -> Self {
                Self { x, y, z, frame: PhantomData }
            }

            /// From `[x, y, z]`.
            pub const fn from_array(xyz: [f64; 3]) -> Self {
                Self::new(xyz[0], xyz[1], xyz[2])
            }

            /// As `[x, y, z]`.
            pub const fn to_array(self) -> [f64; 3] {
                [self.x, self.y, self.z]
            }

            /// Whether no coordinate is NaN or infinite.
            pub fn is_finite(self) -> bool {
                self.x.is_finite() && self.y.is_finite() && self.z.is_finite()
            }
        }
    };
}

triple!(
    /// A position in frame `F`.
    Point
);
triple!(
    /// A displacement, velocity or acceleration expressed in frame `F`.
    Vector
);

impl<F> Point<F> {
    /// Distance to `other`, metres.
    pub fn distance(self, other: Self) -> f64 {
        (self - other).norm()
    }

    /// The point `share` of the way to `other` (0: self, 1: other).
    pub fn lerp(self, other: Self, share: f64) -> Self {
        self + (other - self) * share
    }
}

impl<F> Vector<F> {
    /// Euclidean length.
    pub fn norm(self) -> f64 {
        self.dot(self).sqrt()
    }

    /// Length of the horizontal part (x, y).
    pub fn horizontal_norm(self) -> f64 {
        self.x.hypot(self.y)
    }

    /// Scalar product.
    pub fn dot(self, other: Self) -> f64 {
        self.x * other.x + self.y * other.y + self.z * other.z
    }

    /// Vector product.
    pub fn cross(self, other: Self) -> Self {
        Self::new(
            self.y * other.z - self.z * other.y,
            self.z * other.x - self.x * other.z,
            self.x * other.y - self.y * other.x,
        )
    }

    /// Unit vector, or `None` when shorter than a nanometre.
    pub fn direction(self) -> Option<Self> {
        let norm = self.norm();
        (norm > 1e-9).then(|| self / norm)
    }

    /// Same direction, no longer than `limit`.
    pub fn clamp_norm(self, limit: f64) -> Self {
        let norm = self.norm();
        if norm > limit { self * (limit / norm) } else { self }
    }
}

impl<F> Sub for Point<F> {
    type Output = Vector<F>;
    fn sub(self, rhs: Self) -> Vector<F> {
        Vector::new(self.x - rhs.x, self.y - rhs.y, self.z - rhs.z)
    }
}
impl<F> Add<Vector<F>> for Point<F> {
    type Output = Self;
    fn add(self, rhs: Vector<F>) -> Self {
        Self::new(self.x + rhs.x, self.y + rhs.y, self.z + rhs.z)
    }
}
impl<F> AddAssign<Vector<F>> for Point<F> {
    fn add_assign(&mut self, rhs: Vector<F>) {
        *self = *self + rhs;
    }
}
impl<F> Sub<Vector<F>> for Point<F> {
    type Output = Self;
    fn sub(self, rhs: Vector<F>) -> Self {
        self + -rhs
    }
}
impl<F> Add for Vector<F> {
    type Output = Self;
    fn add(self, rhs: Self) -> Self {
        Self::new(self.x + rhs.x, self.y + rhs.y, self.z + rhs.z)
    }
}
impl<F> AddAssign for Vector<F> {
    fn add_assign(&mut self, rhs: Self) {
        *self = *self + rhs;
    }
}
impl<F> Sub for Vector<F> {
    type Output = Self;
    fn sub(self, rhs: Self) -> Self {
        self + -rhs
    }
}
impl<F> Neg for Vector<F> {
    type Output = Self;
    fn neg(self) -> Self {
        Self::new(-self.x, -self.y, -self.z)
    }
}
impl<F> Mul<f64> for Vector<F> {
    type Output = Self;
    fn mul(self, rhs: f64) -> Self {
        Self::new(self.x * rhs, self.y * rhs, self.z * rhs)
    }
}
impl<F> Div<f64> for Vector<F> {
    type Output = Self;
    fn div(self, rhs: f64) -> Self {
        Self::new(self.x / rhs, self.y / rhs, self.z / rhs)
    }
}

/// A rotation that takes coordinates in `From` to coordinates in `To`.
pub struct Rotation<To, From> {
    quaternion: UnitQuaternion<f64>,
    frames: PhantomData<(To, From)>,
}

impl<T, F> Clone for Rotation<T, F> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<T, F> Copy for Rotation<T, F> {}
impl<T, F> std::fmt::Debug for Rotation<T, F> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:?}", self.to_wxyz())
    }
}

impl<T, F> Rotation<T, F> {
    /// No rotation.
    pub const IDENTITY: Self =
        Self { quaternion: Unit::new_unchecked(Quaternion::new(1.0, 0.0, 0.0, 0.0)), frames: PhantomData };

    fn new(quaternion: UnitQuaternion<f64>) -> Self {
        Self { quaternion, frames: PhantomData }
    }

    /// From the rows of a matrix, or `None` when it is no rotation, but for rounding.
    pub fn from_matrix(rows: [[f64; 3]; 3]) -> Option<Self> {
        let matrix = nalgebra::Matrix3::from_fn(|row, column| rows[row][column]);
        let off = (matrix * matrix.transpose() - nalgebra::Matrix3::identity()).norm();
        // Written so that what is not a number is refused, too.
        let is_rotation = off < 1e-2 && matrix.determinant() > 0.0;
        let quaternion = || nalgebra::UnitQuaternion::from_matrix(&matrix);
        is_rotation.then(quaternion).and_then(|q| Self::from_wxyz([q.w, q.i, q.j, q.k]))
    }

    /// From a quaternion `[w, x, y, z]`, normalised here; `None` when it is not finite or nearly zero.
    pub fn from_wxyz(wxyz: [f64; 4]) -> Option<Self> {
        let [w, x, y, z] = wxyz;
        let quaternion = Quaternion::new(w, x, y, z);
        let norm = quaternion.norm();
        (norm.is_finite() && norm > 1e-6).then(|| Self::new(UnitQuaternion::from_quaternion(quaternion)))
    }

    /// As a unit quaternion `[w, x, y, z]`.
    pub fn to_wxyz(self) -> [f64; 4] {
        let q = self.quaternion;
        [q.w, q.i, q.j, q.k]
    }

    /// Rotation about the frame's x, then y, then z axis (roll, pitch, yaw), radians, right-handed.
    pub fn from_roll_pitch_yaw(roll_rad: f64, pitch_rad: f64, yaw_rad: f64) -> Self {
        Self::new(UnitQuaternion::from_euler_angles(roll_rad, pitch_rad, yaw_rad))
    }

    /// Roll, pitch and yaw, radians.
    pub fn roll_pitch_yaw(self) -> (f64, f64, f64) {
        self.quaternion.euler_angles()
    }

    /// The opposite rotation.
    pub fn inverse(self) -> Rotation<F, T> {
        Rotation::new(self.quaternion.inverse())
    }

    /// Angle of the rotation that separates `self` from `other`, radians in 0..π.
    pub fn angle_to(self, other: Self) -> f64 {
        self.quaternion.angle_to(&other.quaternion)
    }

    /// Spherical interpolation along the shorter arc.
    pub fn slerp(self, other: Self, share: f64) -> Self {
        Self::new(self.quaternion.try_slerp(&other.quaternion, share, 1e-12).unwrap_or(self.quaternion))
    }

    /// Row-major 3×3 matrix.
    pub fn to_matrix(self) -> [[f64; 3]; 3] {
        let m = self.quaternion.to_rotation_matrix();
        [0, 1, 2].map(|row| [0, 1, 2].map(|column| m[(row, column)]))
    }
}

impl<T, M, F> Mul<Rotation<M, F>> for Rotation<T, M> {
    type Output = Rotation<T, F>;
    fn mul(self, rhs: Rotation<M, F>) -> Rotation<T, F> {
        Rotation::new(self.quaternion * rhs.quaternion)
    }
}

impl<T, F> Mul<Vector<F>> for Rotation<T, F> {
    type Output = Vector<T>;
    fn mul(self, rhs: Vector<F>) -> Vector<T> {
        let v = self.quaternion.transform_vector(&Vector3::new(rhs.x, rhs.y, rhs.z));
        Vector::new(v.x, v.y, v.z)
    }
}

impl Rotation<Body, Camera> {
    /// A camera that looks along the body's x axis, its optical axis raised by `pitch_up_rad`.
    pub fn camera_mount(pitch_up_rad: f64) -> Self {
        // Columns are the camera axes in body coordinates: x right = -y, y down = -z, z forward = +x.
        let looking_ahead = Self::new(UnitQuaternion::from_quaternion(Quaternion::new(0.5, -0.5, 0.5, -0.5)));
        // A positive rotation about y (left) tips the nose down, hence the sign.
        Rotation::<Body, Body>::from_roll_pitch_yaw(0.0, -pitch_up_rad, 0.0) * looking_ahead
    }
}

/// Position and orientation: takes coordinates in `From` to coordinates in `To`.
pub struct Pose<To, From> {
    /// Orientation of `From` in `To`.
    pub rotation: Rotation<To, From>,
    /// Origin of `From` in `To`.
    pub translation: Vector<To>,
}

impl<T, F> Clone for Pose<T, F> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<T, F> Copy for Pose<T, F> {}
impl<T, F> std::fmt::Debug for Pose<T, F> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:?} @ {:?}", self.translation, self.rotation)
    }
}

impl<T, F> Pose<T, F> {
    /// The two frames coincide.
    pub const IDENTITY: Self = Self { rotation: Rotation::IDENTITY, translation: Vector::ZERO };

    /// The origin of `From`, in `To`.
    pub fn origin(self) -> Point<T> {
        Point::ZERO + self.translation
    }

    /// The opposite transform.
    pub fn inverse(self) -> Pose<F, T> {
        let rotation = self.rotation.inverse();
        Pose { rotation, translation: -(rotation * self.translation) }
    }

    /// Linear interpolation of position, spherical of orientation.
    pub fn interpolate(self, other: Self, share: f64) -> Self {
        Self {
            rotation: self.rotation.slerp(other.rotation, share),
            translation: self.translation + (other.translation - self.translation) * share,
        }
    }
}

impl<T, M, F> Mul<Pose<M, F>> for Pose<T, M> {
    type Output = Pose<T, F>;
    fn mul(self, rhs: Pose<M, F>) -> Pose<T, F> {
        Pose { rotation: self.rotation * rhs.rotation, translation: self.translation + self.rotation * rhs.translation }
    }
}

impl<T, F> Mul<Point<F>> for Pose<T, F> {
    type Output = Point<T>;
    fn mul(self, rhs: Point<F>) -> Point<T> {
        self.origin() + self.rotation * (rhs - Point::ZERO)
    }
}

/// The angle equivalent to `angle_rad` in (-π, π].
pub fn wrap_angle_rad(angle_rad: f64) -> f64 {
    let turn = std::f64::consts::TAU;
    let wrapped = angle_rad.rem_euclid(turn);
    if wrapped > std::f64::consts::PI { wrapped - turn } else { wrapped }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{FRAC_PI_2, FRAC_PI_6, PI};

    fn assert_close<F>(a: Vector<F>, b: Vector<F>) {
        assert!((a - b).norm() < 1e-12, "{a:?} is not {b:?}");
    }

    #[test]
    fn camera_axes_sit_in_the_body_as_drawn() {
        let mount = Rotation::camera_mount(0.0);
        assert_close(mount * Vector::new(0.0, 0.0, 1.0), Vector::new(1.0, 0.0, 0.0));
        assert_close(mount * Vector::new(1.0, 0.0, 0.0), Vector::new(0.0, -1.0, 0.0));
        assert_close(mount * Vector::new(0.0, 1.0, 0.0), Vector::new(0.0, 0.0, -1.0));
    }

    #[test]
    fn positive_mount_pitch_looks_up() {
        let axis = Rotation::camera_mount(FRAC_PI_6) * Vector::new(0.0, 0.0, 1.0);
        assert!((axis.z - 0.5).abs() < 1e-12, "{axis:?}");
    }

    #[test]
    fn inverse_undoes_a_pose() {
        let pose = Pose::<World, Body> {
            rotation: Rotation::from_roll_pitch_yaw(0.1, -0.2, 2.0),
            translation: Vector::new(1.0, -2.0, 3.0),
        };
        let point = Point::<Body>::new(0.3, 0.4, -0.5);
        assert!((pose.inverse() * (pose * point)).distance(point) < 1e-12);
    }

    #[test]
    fn interpolation_takes_the_shorter_arc() {
        let at = |yaw| Pose::<World, Body> {
            rotation: Rotation::from_roll_pitch_yaw(0.0, 0.0, yaw),
            translation: Vector::ZERO,
        };
        let middle = at(PI - 0.1).interpolate(at(-PI + 0.1), 0.5);
        assert!((middle.rotation.roll_pitch_yaw().2.abs() - PI).abs() < 1e-9);
    }

    #[test]
    fn quaternions_from_the_wire_are_checked() {
        assert!(Rotation::<World, Body>::from_wxyz([0.0; 4]).is_none());
        assert!(Rotation::<World, Body>::from_wxyz([f64::NAN, 0.0, 0.0, 1.0]).is_none());
        assert!(Rotation::<World, Body>::from_wxyz([2.0, 0.0, 0.0, 0.0]).is_some());
    }

    #[test]
    fn angles_wrap_into_half_turns() {
        assert!((wrap_angle_rad(3.0 * FRAC_PI_2) + FRAC_PI_2).abs() < 1e-12);
        assert!((wrap_angle_rad(-PI) - PI).abs() < 1e-12);
    }
}
