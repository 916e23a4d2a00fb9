//! The map as a voxel grid, to be looked at (DROAN, section 5.2): asked in one batch, drawn from above and from the side.

use colorous::{TURBO, VIRIDIS};
use image::{Rgb, RgbImage};
use ipc_types::{Point, World};
use memory::{Occupancy, Points, Scratch, View};
use std::error::Error;
use std::fmt::Write as _;
use std::path::Path;

/// Occupancy on a regular grid.
#[derive(Clone, Debug)]
pub struct VoxelGrid {
    /// Centre of the first voxel.
    least: Point<World>,
    voxel_m: f64,
    /// Voxels east, north, up.
    counts: [usize; 3],
    /// East runs fastest, then north, then up.
    voxels: Vec<Occupancy>,
}

impl VoxelGrid {
    /// Asks a map about a box of `size_m` around a point.
    ///
    /// # Errors
    /// The box has no voxels, or more than 10⁸.
    pub fn ask(
        view: &View,
        centre: Point<World>,
        size_m: [f64; 3],
        voxel_m: f64,
        threshold: f32,
    ) -> Result<Self, Box<dyn Error>> {
        let counts = size_m.map(|size| (size / voxel_m).round().max(0.0) as usize);
        let total = counts.iter().try_fold(1_usize, |total, &count| total.checked_mul(count));
        let total = total.filter(|total| (1..=100_000_000).contains(total));
        let total = total.ok_or_else(|| format!("a grid of {counts:?} voxels; expected 1 to 100 million"))?;
        let half = |axis: usize| (counts[axis] as f64 - 1.0) / 2.0 * voxel_m;
        let least = Point::new(centre.x - half(0), centre.y - half(1), centre.z - half(2));
        let mut grid = Self { least, voxel_m, counts, voxels: vec![Occupancy::Occupied; total] };
        let axis = |axis: usize| (0..total).map(|index| grid.place(index).to_array()[axis]).collect::<Vec<f64>>();
        let (x, y, z) = (axis(0), axis(1), axis(2));
        let points = Points { x_m: &x, y_m: &y, z_m: &z };
        view.occupancies(points, threshold, &mut Scratch::default(), &mut grid.voxels)?;
        Ok(grid)
    }

    fn place(&self, index: usize) -> Point<World> {
        let [wide, deep, _] = self.counts;
        let at = |steps: usize| steps as f64 * self.voxel_m;
        let (east, north, up) = (at(index % wide), at(index / wide % deep), at(index / wide / deep));
        Point::new(self.least.x + east, self.least.y + north, self.least.z + up)
    }

    /// How many voxels are free, occupied, unknown.
    pub fn tally(&self) -> [usize; 3] {
        let count = |which: fn(&Occupancy) -> bool| self.voxels.iter().filter(|voxel| which(voxel)).count();
        [
            count(|voxel| *voxel == Occupancy::Free),
            count(|voxel| *voxel == Occupancy::Occupied),
            count(|voxel| matches!(voxel, Occupancy::Unknown(_))),
        ]
    }

    /// The centres of the occupied voxels as a PLY file, coloured by height.
    pub fn save_points(&self, path: &Path) -> Result<(), Box<dyn Error>> {
        let occupied = || (0..self.voxels.len()).filter(|&index| self.voxels[index] == Occupancy::Occupied);
        let mut text = format!(
            "ply\nformat ascii 1.0\ncomment centres of occupied voxels of {} m; x east, y north, z up\nelement vertex {}\n\
             property float x\nproperty float y\nproperty float z\n\
             property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n",
            self.voxel_m,
            occupied().count()
        );
        for index in occupied() {
            let (place, Rgb([red, green, blue])) = (self.place(index), self.colour(index));
            writeln!(text, "{:.3} {:.3} {:.3} {red} {green} {blue}", place.x, place.y, place.z)?;
        }
        std::fs::write(path, text).map_err(|error| format!("{}: {error}", path.display()).into())
    }

    /// By height.
    fn colour(&self, index: usize) -> Rgb<u8> {
        let [wide, deep, high] = self.counts;
        let colour = TURBO.eval_continuous((index / wide / deep) as f64 / (high.max(2) - 1) as f64);
        Rgb([colour.r, colour.g, colour.b])
    }

    /// From above, north up: the highest occupied voxel by its height, else how much of the column is free (dark blue to
    /// yellow), black where nothing is known.
    pub fn save_top(&self, path: &Path) -> Result<(), Box<dyn Error>> {
        let [wide, deep, high] = self.counts;
        let scale = (1000 / wide.max(deep)).clamp(1, 8);
        let pixel = |x: u32, y: u32| {
            let (column, row) = (x as usize / scale, deep - 1 - y as usize / scale);
            let index = |level: usize| (level * deep + row) * wide + column;
            let levels = || (0..high).map(index);
            if let Some(top) = levels().rev().find(|&index| self.voxels[index] == Occupancy::Occupied) {
                return self.colour(top);
            }
            let free = levels().filter(|&index| self.voxels[index] == Occupancy::Free).count();
            let colour = VIRIDIS.eval_continuous(free as f64 / high as f64);
            if free > 0 { Rgb([colour.r, colour.g, colour.b].map(|part| part / 3)) } else { Rgb([0; 3]) }
        };
        save(path, RgbImage::from_fn((wide * scale) as u32, (deep * scale) as u32, pixel))
    }

    /// Obliquely from the south, cabinet projection: occupied voxels, the farther ones darker.
    pub fn save_oblique(&self, path: &Path) -> Result<(), Box<dyn Error>> {
        let [wide, deep, high] = self.counts;
        let scale = (1200 / (wide + deep / 2)).clamp(2, 12);
        let half = scale / 2;
        let (width, height) = (wide * scale + deep * half + 1, high * scale + deep * half + 1);
        let mut image = RgbImage::from_pixel(width as u32, height as u32, Rgb([18; 3]));
        // From the back to the front and upwards: the nearer covers the farther.
        for row in (0..deep).rev() {
            for level in 0..high {
                for column in 0..wide {
                    let index = (level * deep + row) * wide + column;
                    if self.voxels[index] != Occupancy::Occupied {
                        continue;
                    }
                    let shade = 1.0 - 0.6 * row as f64 / deep as f64;
                    let front = self.colour(index).0.map(|part| (f64::from(part) * shade * 0.8) as u8);
                    let top = self.colour(index).0.map(|part| (f64::from(part) * shade) as u8);
                    let (left, bottom) = (column * scale + row * half, height - 1 - level * scale - row * half);
                    for y in 0..scale {
                        for x in 0..scale {
                            image.put_pixel((left + x) as u32, (bottom - y) as u32, Rgb(front));
                        }
                    }
                    // The upper face, sheared.
                    for step in 0..half {
                        for x in 0..scale {
                            let (x, y) = (left + x + step, bottom.saturating_sub(scale + step));
                            if x < width {
                                image.put_pixel(x as u32, y as u32, Rgb(top));
                            }
                        }
                    }
                }
            }
        }
        save(path, image)
    }
}

fn save(path: &Path, image: RgbImage) -> Result<(), Box<dyn Error>> {
    image.save(path).map_err(|error| format!("{}: {error}", path.display()).into())
}
