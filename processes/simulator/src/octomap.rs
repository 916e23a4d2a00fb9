//! OctoMap's binary files (`.bt`) as worlds: occupied voxels, merged to boxes. Unknown space is empty.
//!
//! The format: a text header with the resolution, then the tree in depth-first order, two bits for each of a node's
//! eight children (Hornung et al. 2013, `OcTreeBaseImpl::readBinaryNode`).

use ipc_types::{Point, World};
use std::path::Path;

/// Levels of the tree.
const LEVELS: u32 = 16;
/// Voxels along an edge of it.
const SIDE: i32 = 1 << LEVELS;
/// Largest file, bytes.
const LARGEST_FILE: u64 = 1 << 28;
/// Most occupied leaves.
const MOST_LEAVES: usize = 1 << 24;
/// Most voxels of the box around all that is occupied.
const MOST_VOXELS: u64 = 1 << 27;

/// Why a file is no map.
#[derive(Debug, thiserror::Error)]
pub enum OctomapError {
    /// It cannot be read.
    #[error(transparent)]
    Io(#[from] std::io::Error),
    /// It is too large to be one of ours.
    #[error("has {0} bytes, a map may have {LARGEST_FILE}")]
    LargeFile(u64),
    /// The header lacks something.
    #[error("no OctoMap: {0}")]
    Header(&'static str),
    /// The tree ends before its nodes do.
    #[error("the tree is cut off after {0} bytes")]
    CutOff(usize),
    /// The tree is not what the header says.
    #[error("the header states {stated} nodes, the tree has {nodes} and is followed by {left_over} bytes")]
    Size {
        /// By the header.
        stated: usize,
        /// Read.
        nodes: usize,
        /// Bytes after the tree.
        left_over: usize,
    },
    /// The tree is deeper than there are levels.
    #[error("the tree is deeper than 16 levels")]
    TooDeep,
    /// The occupied part is too large.
    #[error("what is occupied spans {0} voxels, allowed are {MOST_VOXELS}")]
    TooLarge(u64),
    /// Nothing is occupied.
    #[error("nothing is occupied")]
    Empty,
}

/// An occupied cube of the tree: its lowest voxel and its edge, voxels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Leaf {
    least: [i32; 3],
    edge: i32,
}

/// What is occupied.
#[derive(Clone, Debug)]
pub struct Octomap {
    resolution_m: f64,
    leaves: Vec<Leaf>,
    free_leaves: usize,
}

impl Octomap {
    /// Reads a file.
    ///
    /// # Errors
    /// It cannot be read, or is none.
    pub fn read(path: &Path) -> Result<Self, OctomapError> {
        let size = std::fs::metadata(path)?.len();
        if size > LARGEST_FILE {
            return Err(OctomapError::LargeFile(size));
        }
        Self::parse(&std::fs::read(path)?)
    }

    /// Reads a file's bytes.
    ///
    /// # Errors
    /// It is none, or damaged.
    pub fn parse(bytes: &[u8]) -> Result<Self, OctomapError> {
        let (resolution_m, size, mut tree) = header(bytes)?;
        let mut inner = 0;
        let mut map = Self { resolution_m, leaves: Vec::new(), free_leaves: 0 };
        // Nodes to be read, the next one last.
        let mut nodes = vec![(Leaf { least: [-SIDE / 2; 3], edge: SIDE }, 0)];
        while let Some((node, level)) = nodes.pop() {
            let Some((&children, rest)) = tree.split_first_chunk::<2>() else {
                return Err(OctomapError::CutOff(bytes.len()));
            };
            tree = rest;
            inner += 1;
            if map.leaves.len() > MOST_LEAVES {
                return Err(OctomapError::TooLarge(map.leaves.len() as u64));
            }
            if level == LEVELS {
                return Err(OctomapError::TooDeep);
            }
            let children = u16::from_le_bytes(children);
            let edge = node.edge / 2;
            for child in (0..8_u16).rev() {
                let upper = |axis: u16| i32::from(child >> axis & 1) * edge;
                let least = [node.least[0] + upper(0), node.least[1] + upper(1), node.least[2] + upper(2)];
                match children >> (2 * child) & 3 {
                    1 => map.free_leaves += 1,
                    2 => map.leaves.push(Leaf { least, edge }),
                    3 => nodes.push((Leaf { least, edge }, level + 1)),
                    _ => {}
                }
            }
        }
        let nodes = inner + map.leaves.len() + map.free_leaves;
        if nodes != size || !tree.is_empty() {
            return Err(OctomapError::Size { stated: size, nodes, left_over: tree.len() });
        }
        if map.leaves.is_empty() { Err(OctomapError::Empty) } else { Ok(map) }
    }

    /// Number of occupied leaves, and of free ones.
    pub fn leaves(&self) -> [usize; 2] {
        [self.leaves.len(), self.free_leaves]
    }

    /// Corners of the box around all that is occupied, m.
    pub fn bounds_m(&self) -> [Point<World>; 2] {
        let (least, most) = self.bounds();
        [least, most].map(|corner| Point::from_array(corner.map(|voxel| f64::from(voxel) * self.resolution_m)))
    }

    /// Height of the floor, m: the top of the lowest layer, if more than half of it is occupied; else the lowest height.
    pub fn floor_m(&self) -> f64 {
        let (least, most) = self.bounds();
        let covers = |leaf: &&Leaf| leaf.least[2] == least[2];
        let occupied: u64 = self.leaves.iter().filter(covers).map(|leaf| (leaf.edge as u64).pow(2)).sum();
        let area = (most[0] - least[0]) as u64 * (most[1] - least[1]) as u64;
        f64::from(least[2] + i32::from(2 * occupied > area)) * self.resolution_m
    }

    fn bounds(&self) -> ([i32; 3], [i32; 3]) {
        self.leaves.iter().fold(([SIDE; 3], [-SIDE; 3]), |(least, most), leaf| {
            let axes = [0, 1, 2];
            let least = axes.map(|axis: usize| least[axis].min(leaf.least[axis]));
            (least, axes.map(|axis| most[axis].max(leaf.least[axis] + leaf.edge)))
        })
    }

    /// Boxes that together are all that is occupied, none of which overlap: two opposite corners each, m.
    ///
    /// # Errors
    /// They span too much.
    pub fn boxes(&self) -> Result<Vec<[Point<World>; 2]>, OctomapError> {
        let mut voxels = Voxels::of(self)?;
        let mut boxes = Vec::new();
        for index in 0..voxels.occupied.len() {
            if voxels.occupied[index] {
                let (least, size) = voxels.take_box(index);
                let corner = |voxel: [i32; 3]| Point::from_array(voxel.map(|v| f64::from(v) * self.resolution_m));
                boxes.push([corner(least), corner([0, 1, 2].map(|axis| least[axis] + size[axis]))]);
            }
        }
        Ok(boxes)
    }
}

/// The resolution, the number of nodes, and what follows the header.
fn header(bytes: &[u8]) -> Result<(f64, usize, &[u8]), OctomapError> {
    const DATA: &[u8] = b"\ndata\n";
    if !bytes.starts_with(b"# Octomap OcTree binary file") {
        return Err(OctomapError::Header("it does not begin with \"# Octomap OcTree binary file\""));
    }
    let end = bytes.windows(DATA.len()).position(|window| window == DATA);
    let end = end.ok_or(OctomapError::Header("no line \"data\" ends the header"))?;
    let text = String::from_utf8_lossy(&bytes[..end]);
    let size = text.lines().find_map(|line| line.strip_prefix("size ")?.trim().parse().ok());
    let size = size.ok_or(OctomapError::Header("no line \"size\" with the number of nodes"))?;
    let resolution = text.lines().find_map(|line| line.strip_prefix("res "));
    let resolution_m = resolution.and_then(|value| value.trim().parse().ok());
    match resolution_m.filter(|value| (0.001..=10.0).contains(value)) {
        Some(resolution_m) => Ok((resolution_m, size, &bytes[end + DATA.len()..])),
        None => Err(OctomapError::Header("no line \"res\" with a resolution of 0.001 to 10 m")),
    }
}

/// The box around all that is occupied, voxel by voxel; z runs fastest, so that trunks become few boxes.
struct Voxels {
    least: [i32; 3],
    size: [i32; 3],
    occupied: Vec<bool>,
}

impl Voxels {
    fn of(map: &Octomap) -> Result<Self, OctomapError> {
        let (least, most) = map.bounds();
        let size = [0, 1, 2].map(|axis| most[axis] - least[axis]);
        let count = size.iter().map(|&voxels| voxels as u64).product::<u64>();
        if count > MOST_VOXELS {
            return Err(OctomapError::TooLarge(count));
        }
        let mut voxels = Self { least, size, occupied: vec![false; count as usize] };
        for leaf in &map.leaves {
            let from = [0, 1, 2].map(|axis| leaf.least[axis] - least[axis]);
            voxels.fill(from, [leaf.edge; 3], true);
        }
        Ok(voxels)
    }

    fn index(&self, [x, y, z]: [i32; 3]) -> usize {
        (x as usize * self.size[1] as usize + y as usize) * self.size[2] as usize + z as usize
    }

    fn rows(from: [i32; 3], size: [i32; 3]) -> impl Iterator<Item = [i32; 3]> {
        (0..size[0]).flat_map(move |x| (0..size[1]).map(move |y| [from[0] + x, from[1] + y, from[2]]))
    }

    fn fill(&mut self, from: [i32; 3], size: [i32; 3], value: bool) {
        for row in Self::rows(from, size) {
            let index = self.index(row);
            self.occupied[index..index + size[2] as usize].fill(value);
        }
    }

    fn is_full(&self, from: [i32; 3], size: [i32; 3]) -> bool {
        let fits = (0..3).all(|axis| from[axis] + size[axis] <= self.size[axis]);
        fits && Self::rows(from, size).all(|row| {
            let index = self.index(row);
            self.occupied[index..index + size[2] as usize].iter().all(|&voxel| voxel)
        })
    }

    /// Empties the box that grows from a voxel: upwards as far as it goes, then along y, then along x.
    fn take_box(&mut self, index: usize) -> ([i32; 3], [i32; 3]) {
        let (rows, layers) = (self.size[2] as usize, self.size[1] as usize);
        let from = [index / rows / layers, index / rows % layers, index % rows].map(|value| value as i32);
        let mut size = [1; 3];
        for axis in [2, 1, 0] {
            let mut next = [from[0], from[1], from[2]];
            let mut slab = size;
            slab[axis] = 1;
            loop {
                next[axis] = from[axis] + size[axis];
                if !self.is_full(next, slab) {
                    break;
                }
                size[axis] += 1;
            }
        }
        self.fill(from, size, false);
        ([0, 1, 2].map(|axis| from[axis] + self.least[axis]), size)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A tree whose only branch descends to the voxel in the middle, with the given children there.
    fn file(children: u16) -> Vec<u8> {
        let leaves = (0..8).filter(|child| matches!(children >> (2 * child) & 3, 1 | 2)).count();
        let header = format!("# Octomap OcTree binary file\nid OcTree\nsize {}\nres 0.5\ndata\n", 16 + leaves);
        let mut bytes = header.into_bytes();
        // The upper octant first, then always the lowest one.
        bytes.extend((3_u16 << 14).to_le_bytes());
        (0..LEVELS - 2).for_each(|_| bytes.extend(3_u16.to_le_bytes()));
        bytes.extend(children.to_le_bytes());
        bytes
    }

    #[test]
    fn voxels_lie_where_they_should_and_merge() {
        // Occupied: 0 (least), 1 (x), 4 (z); free: 2 (y).
        let map = Octomap::parse(&file(0b10_00_00_00_10 | 0b01 << 4 | 0b10 << 2)).expect("a map");
        assert_eq!(map.leaves(), [3, 1]);
        assert_eq!(map.bounds_m(), [Point::ZERO, Point::new(1.0, 0.5, 1.0)]);
        let boxes = map.boxes().expect("small");
        assert_eq!(
            boxes,
            [[Point::ZERO, Point::new(0.5, 0.5, 1.0)], [Point::new(0.5, 0.0, 0.0), Point::new(1.0, 0.5, 0.5)],]
        );
        assert_eq!(map.floor_m(), 0.5, "two of two columns");
        let all = Octomap::parse(&file(0xaaaa)).expect("a map").boxes().expect("small");
        assert_eq!(all, [[Point::ZERO, Point::new(1.0, 1.0, 1.0)]]);
    }

    #[test]
    fn damaged_files_are_refused_each_with_its_reason() {
        let whole = file(0xaaaa);
        for length in 0..whole.len() {
            assert!(Octomap::parse(&whole[..length]).is_err(), "cut off at {length}");
        }
        let said = |bytes: &[u8]| Octomap::parse(bytes).and_then(|map| map.boxes()).expect_err("refused").to_string();
        assert!(said(b"# OctoMap").contains("does not begin"));
        assert!(said(&whole[..whole.len() - 1]).contains("cut off"));
        assert!(said(&file(0)).contains("nothing is occupied"));
        let mut deep = file(3);
        deep.extend([0, 0]);
        assert!(said(&deep).contains("deeper than 16"));
        // The root's own children.
        let huge = [b"# Octomap OcTree binary file\nsize 9\nres 0.5\ndata\n".as_slice(), &[0xaa, 0xaa]].concat();
        assert!(said(&huge).contains("spans"), "{}", said(&huge));
        assert!(said(&[&whole[..], &[0]].concat()).contains("followed by 1 bytes"));
        let coarse = String::from_utf8_lossy(&whole).replace("res 0.5", "res nan").into_bytes();
        assert!(said(&coarse).contains("resolution"));
    }
}
