//! Sequences of images on disk: which files belong together, and when they were exposed.
//!
//! Understood are EuRoC's layout (`mav0/cam0/data.csv`), folders for left and right (KITTI's `image_0` and `image_1`,
//! `left` and `right`, …), one folder whose file names say `left` and `right`, and folders of depth images (TUM, 7-Scenes).
//! Times come from `data.csv`, from KITTI's `times.txt` or `timestamps.txt`, or from the file names where those are times;
//! else a rate is assumed. What has no counterpart in the other camera is counted, never guessed.

use super::times::{date_as_ns, seconds_as_ns, time_in};
use super::together;
use crate::pairs::{DepthImage, PairError, StereoPair, read_text, unusable};
use std::collections::HashMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// What a sequence is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Content {
    /// Stereo pairs.
    Pairs,
    /// Depth images, or ready-made disparity images.
    Depth,
}

/// Files exposed together.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SequenceFrame {
    /// Exposure, ns since the sequence's first.
    pub at_ns: i64,
    /// The left image, or the depth image.
    pub left: PathBuf,
    /// The right image of a pair.
    pub right: Option<PathBuf>,
}

/// A frame's pixels.
#[derive(Clone, Debug)]
pub enum FrameImage {
    /// Of a pair.
    Pair(StereoPair),
    /// Of a depth sensor.
    Depth(DepthImage),
}

impl FrameImage {
    /// Width and height of an image, px.
    pub fn size_px(&self) -> (u32, u32) {
        match self {
            Self::Pair(pair) => (pair.width_px, pair.height_px),
            Self::Depth(depth) => (depth.width_px, depth.height_px),
        }
    }
}

impl SequenceFrame {
    /// Reads the files.
    ///
    /// # Errors
    /// A file is missing or damaged, or the images of a pair differ in size.
    pub fn load(&self) -> Result<FrameImage, PairError> {
        match &self.right {
            Some(right) => StereoPair::load(&self.left, right).map(FrameImage::Pair),
            None => DepthImage::load(&self.left).map(FrameImage::Depth),
        }
    }
}

/// Images in the order of their exposure.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sequence {
    /// The frames; at least one.
    pub frames: Vec<SequenceFrame>,
    /// Images without a counterpart, and second images of the same instant.
    pub unpaired: usize,
    /// Time of the first exposure as the files give it, ns; `None` where they give none.
    pub first_ns: Option<i64>,
    /// Between the images of a pair, at most, ns; 0 where the files do not tell.
    pub apart_ns: i64,
}

/// One camera's image.
#[derive(Clone, Debug)]
struct Image {
    /// What its counterpart's name has in common with its own.
    key: String,
    at_ns: Option<i64>,
    path: PathBuf,
}

/// Folders of the left and of the right camera.
const SIDES: [(&str, &str); 8] = [
    ("mav0/cam0", "mav0/cam1"),
    ("cam0", "cam1"),
    ("left", "right"),
    ("image_0", "image_1"),
    ("image_2", "image_3"),
    ("image_00", "image_01"),
    ("colored_0", "colored_1"),
    ("infra1", "infra2"),
];
/// How file names of one folder tell left from right.
const WORDS: [(&str, &str); 4] = [("left", "right"), ("im0", "im1"), ("cam0", "cam1"), ("infra1", "infra2")];
/// Where depth images are, in a folder of other things.
const DEPTH_FOLDERS: [&str; 3] = ["depth", "disp_0", "disparity"];
/// Longer sequences than a week have wrong times.
const LONGEST_NS: i64 = 7 * 24 * 3600 * 1_000_000_000;
/// Largest list of times, bytes: a day at 20 Hz.
const LARGEST_LIST: u64 = 128 << 20;

impl Sequence {
    /// Finds the images: one or two files, one folder, or a folder for each camera. `rate_hz` is used where the files
    /// do not say when they were exposed.
    ///
    /// # Errors
    /// Nothing that could be played is there.
    pub fn open(paths: &[PathBuf], content: Content, rate_hz: f64) -> Result<Self, PairError> {
        let single = |path: &PathBuf| Image { key: String::new(), at_ns: None, path: path.clone() };
        match (content, paths) {
            (Content::Depth, [path]) if path.is_dir() => Self::of_depth(depth_images(path)?, path, rate_hz),
            (Content::Depth, [path]) => Self::of_depth(vec![single(path)], path, rate_hz),
            (Content::Pairs, [folder]) if folder.is_dir() => {
                let (left, right) = both_sides(folder)?;
                Self::of_pairs(left, right, folder, rate_hz)
            }
            (Content::Pairs, [left, right]) if left.is_dir() && right.is_dir() => {
                Self::of_pairs(one_side(left)?, one_side(right)?, left, rate_hz)
            }
            (Content::Pairs, [left, right]) => Self::of_pairs(vec![single(left)], vec![single(right)], left, rate_hz),
            (Content::Depth, _) => {
                Err(unusable(first(paths), "is one of several; expected one file or folder of depth"))
            }
            (Content::Pairs, _) => {
                Err(unusable(first(paths), "is not a pair; expected two files, two folders, or a folder of pairs"))
            }
        }
    }

    fn of_depth(images: Vec<Image>, path: &Path, rate_hz: f64) -> Result<Self, PairError> {
        let frames = images.into_iter().map(|image| (image.at_ns, image.path, None)).collect();
        Self::in_order(frames, 0, path, rate_hz)
    }

    fn of_pairs(left: Vec<Image>, right: Vec<Image>, path: &Path, rate_hz: f64) -> Result<Self, PairError> {
        let images = left.len() + right.len();
        let timed = left.iter().chain(&right).all(|image| image.at_ns.is_some());
        let pairs = if timed { by_time(left, right) } else { by_name(left, right) };
        let unpaired = images - 2 * pairs.len();
        let apart = |(a, b): &(Image, Image)| Some(a.at_ns?.saturating_sub(b.at_ns?).saturating_abs());
        let apart_ns = if timed { pairs.iter().filter_map(apart).max().unwrap_or_default() } else { 0 };
        let frames = pairs.into_iter().map(|(left, right)| (left.at_ns, left.path, Some(right.path))).collect();
        Ok(Self { apart_ns, ..Self::in_order(frames, unpaired, path, rate_hz)? })
    }

    fn in_order(
        mut found: Vec<(Option<i64>, PathBuf, Option<PathBuf>)>,
        mut unpaired: usize,
        path: &Path,
        rate_hz: f64,
    ) -> Result<Self, PairError> {
        found.sort();
        // Those without a time come first: if the first one has one, all have.
        let first_ns = found.first().and_then(|(at, ..)| *at);
        let mut frames: Vec<SequenceFrame> = Vec::with_capacity(found.len());
        for (index, (at, left, right)) in found.into_iter().enumerate() {
            let at_ns = match (first_ns, at) {
                (Some(first), Some(at)) => match at.checked_sub(first).filter(|since| *since <= LONGEST_NS) {
                    Some(since) => since,
                    None => {
                        let problem =
                            format!("was exposed at {at} ns, the first image at {first} ns; expected within a week");
                        return Err(unusable(&left, problem));
                    }
                },
                _ => (index as f64 * 1e9 / rate_hz) as i64,
            };
            if frames.last().is_some_and(|last| last.at_ns == at_ns) {
                unpaired += 1 + usize::from(right.is_some());
                continue;
            }
            frames.push(SequenceFrame { at_ns, left, right });
        }
        if frames.is_empty() {
            let problem = match unpaired {
                0 => "has no images".to_owned(),
                _ => format!("has no images that belong together; {unpaired} have no counterpart"),
            };
            return Err(unusable(path, problem));
        }
        Ok(Self { frames, unpaired, first_ns, apart_ns: 0 })
    }

    /// Longest time between two frames.
    pub fn longest_gap(&self) -> Duration {
        let gaps = self.frames.windows(2).map(|two| two[1].at_ns - two[0].at_ns);
        Duration::from_nanos(gaps.max().unwrap_or_default().unsigned_abs())
    }

    /// From the first exposure to the last, s.
    pub fn duration_s(&self) -> f64 {
        self.frames.last().map_or(0.0, |frame| frame.at_ns as f64 * 1e-9)
    }
}

fn first(paths: &[PathBuf]) -> &Path {
    paths.first().map_or(Path::new("(nothing)"), PathBuf::as_path)
}

/// The images of both cameras in a folder.
fn both_sides(folder: &Path) -> Result<(Vec<Image>, Vec<Image>), PairError> {
    for (left, right) in SIDES {
        let (left, right) = (folder.join(left), folder.join(right));
        if left.is_dir() && right.is_dir() {
            return Ok((one_side(&left)?, one_side(&right)?));
        }
    }
    let files = image_files(folder)?;
    for (left_word, right_word) in WORDS {
        let side = |word: &str, other: &str| -> Vec<Image> {
            let with = |path: &PathBuf| Image::named(path, word).filter(|_| Image::named(path, other).is_none());
            files.iter().filter_map(with).collect()
        };
        let (left, right) = (side(left_word, right_word), side(right_word, left_word));
        if !left.is_empty() && !right.is_empty() {
            return Ok((left, right));
        }
    }
    let sides: Vec<String> = SIDES.iter().map(|(left, right)| format!("{left} and {right}")).collect();
    let problem =
        format!("has no stereo pairs; looked for folders {}, and for files named left… and right…", sides.join(", "));
    Err(unusable(folder, problem))
}

/// The images of one camera.
fn one_side(folder: &Path) -> Result<Vec<Image>, PairError> {
    let data = folder.join("data");
    let images = if data.is_dir() { data } else { folder.to_owned() };
    let list = folder.join("data.csv");
    if list.is_file() {
        return listed(&list, &images);
    }
    let mut found: Vec<Image> = image_files(&images)?.iter().map(|path| Image::of(path)).collect();
    let lists = ["times.txt", "../times.txt", "timestamps.txt"].map(|name| folder.join(name));
    let times = lists.into_iter().find(|path| path.is_file());
    if let Some(times) = times {
        let text = read_text(&times, LARGEST_LIST)?;
        let lines = text.lines().filter(|line| !line.trim().is_empty());
        let seconds: Option<Vec<i64>> = lines.map(|line| date_as_ns(line).or_else(|| seconds_as_ns(line))).collect();
        let Some(seconds) = seconds.filter(|seconds| seconds.len() == found.len()) else {
            return Err(unusable(&times, format!("expected {} times in seconds or dates, one a line", found.len())));
        };
        found.iter_mut().zip(seconds).for_each(|(image, at_ns)| image.at_ns = Some(at_ns));
    }
    Ok(found)
}

/// EuRoC's list: time in nanoseconds, file name.
fn listed(list: &Path, images: &Path) -> Result<Vec<Image>, PairError> {
    let mut found = Vec::new();
    for (index, line) in read_text(list, LARGEST_LIST)?.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let entry = line.split_once(',').and_then(|(at, name)| Some((at.trim().parse::<i64>().ok()?, name.trim())));
        // A list must not lead out of its folder.
        let Some((at_ns, name)) = entry.filter(|(_, name)| !name.contains("..") && !name.starts_with('/')) else {
            return Err(unusable(list, format!("line {} is \"{line}\", expected: time in ns, file name", index + 1)));
        };
        found.push(Image { key: name.to_owned(), at_ns: Some(at_ns), path: images.join(name) });
    }
    Ok(found)
}

fn depth_images(folder: &Path) -> Result<Vec<Image>, PairError> {
    let inner = DEPTH_FOLDERS.iter().map(|name| folder.join(name)).find(|inner| inner.is_dir());
    let files = image_files(inner.as_deref().unwrap_or(folder))?;
    let is_depth = |path: &&PathBuf| has_extension(path, &["png", "pgm"]);
    let says_depth = |path: &&PathBuf| Image::named(path, "depth").is_some();
    let named: Vec<Image> = files.iter().filter(is_depth).filter(says_depth).map(|path| Image::of(path)).collect();
    if !named.is_empty() {
        return Ok(named);
    }
    Ok(files.iter().filter(is_depth).map(|path| Image::of(path)).collect())
}

/// Image files of a folder, in the order of their names.
fn image_files(folder: &Path) -> Result<Vec<PathBuf>, PairError> {
    let entries =
        fs::read_dir(folder).map_err(|source| PairError::Io { path: folder.display().to_string(), source })?;
    let is_image = |path: &PathBuf| has_extension(path, &["png", "jpg", "jpeg", "pgm", "ppm", "bmp"]);
    let mut files: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).filter(is_image).collect();
    files.sort();
    Ok(files)
}

/// Whether a file is of one of the kinds, in upper or lower case.
fn has_extension(path: &Path, extensions: &[&str]) -> bool {
    let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase());
    extension.is_some_and(|extension| extensions.contains(&extension.as_str()))
}

impl Image {
    fn of(path: &Path) -> Self {
        let key = path.file_stem().map(|stem| stem.to_string_lossy().to_lowercase()).unwrap_or_default();
        Self { at_ns: time_in(&key), key, path: path.to_owned() }
    }

    /// An image whose name contains a word; its key is the rest.
    fn named(path: &Path, word: &str) -> Option<Self> {
        let image = Self::of(path);
        let key = image.key.contains(word).then(|| image.key.replacen(word, "", 1))?;
        let key = key.trim_matches(['_', '-', '.', ' ']).to_owned();
        Some(Self { at_ns: time_in(&key), key, ..image })
    }
}

fn by_name(left: Vec<Image>, right: Vec<Image>) -> Vec<(Image, Image)> {
    let mut right: HashMap<String, Image> = right.into_iter().map(|image| (image.key.clone(), image)).collect();
    left.into_iter().filter_map(|image| right.remove(&image.key).map(|other| (image, other))).collect()
}

/// The nearest of the other camera's images, where it is near enough and has none that is nearer.
fn by_time(mut left: Vec<Image>, mut right: Vec<Image>) -> Vec<(Image, Image)> {
    left.sort_by_key(|image| image.at_ns);
    right.sort_by_key(|image| image.at_ns);
    let at = |image: &Image| image.at_ns.unwrap_or_default();
    let apart = |a: &Image, b: &Image| at(a).abs_diff(at(b));
    let mut intervals: Vec<i64> = left.windows(2).map(|two| at(&two[1]).saturating_sub(at(&two[0]))).collect();
    intervals.sort_unstable();
    let interval = intervals.get(intervals.len() / 2).map_or(u64::MAX, |interval| interval.unsigned_abs());
    let tolerance = together(Duration::from_nanos(interval)).as_nanos() as u64;
    let mut pairs = Vec::new();
    let (mut l, mut r) = (0, 0);
    while let (Some(a), Some(b)) = (left.get(l), right.get(r)) {
        let here = apart(a, b);
        if left.get(l + 1).is_some_and(|next| apart(next, b) < here) {
            l += 1;
        } else if right.get(r + 1).is_some_and(|next| apart(a, next) < here) {
            r += 1;
        } else if here <= tolerance {
            pairs.push((a.clone(), b.clone()));
            (l, r) = (l + 1, r + 1);
        } else if at(a) < at(b) {
            l += 1;
        } else {
            r += 1;
        }
    }
    pairs
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Folder(PathBuf);

    impl Folder {
        fn with(name: &str, files: &[(&str, &str)]) -> Self {
            let folder = std::env::temp_dir().join(format!("sparrowhawk-sequence-{name}-{}", std::process::id()));
            for (file, text) in files {
                let path = folder.join(file);
                fs::create_dir_all(path.parent().expect("a parent")).expect("writable");
                fs::write(path, text).expect("writable");
            }
            Self(folder)
        }

        fn open(&self, content: Content) -> Result<Sequence, PairError> {
            Sequence::open(std::slice::from_ref(&self.0), content, 10.0)
        }

        /// Exposures in ms, and the number of what has no counterpart.
        fn exposures(&self, content: Content) -> (Vec<i64>, usize) {
            let sequence = self.open(content).expect("a sequence");
            (sequence.frames.iter().map(|frame| frame.at_ns / 1_000_000).collect(), sequence.unpaired)
        }
    }

    impl Drop for Folder {
        fn drop(&mut self) {
            // Left behind in the temporary folder at worst.
            let _ = fs::remove_dir_all(&self.0);
        }
    }

    #[test]
    fn euroc_lists_are_paired_by_time() {
        let left = "#timestamp [ns],filename\n1000000000,a.png\r\n1050000000,b.png\n1100000000,c.png\n1100000000,c.png\n1150000000,d.png\n";
        let right = "#timestamp [ns],filename\n1000000100,x.png\n1100000000,y.png\n1170000000,z.png\n";
        let folder = Folder::with("euroc", &[("mav0/cam0/data.csv", left), ("mav0/cam1/data.csv", right)]);
        let sequence = folder.open(Content::Pairs).expect("a sequence");
        // b and the second c have no counterpart; d and z are too far apart.
        assert_eq!(sequence.unpaired, 4);
        assert_eq!(sequence.first_ns, Some(1_000_000_000));
        let names: Vec<_> = sequence
            .frames
            .iter()
            .map(|frame| (frame.at_ns, frame.right.as_ref().and_then(|path| path.file_name()).expect("a pair")))
            .collect();
        assert_eq!(names, [(0, "x.png".as_ref()), (100_000_000, "y.png".as_ref())]);
    }

    #[test]
    fn an_image_is_paired_with_the_nearest_and_times_must_be_possible() {
        let list = |times: &[i64]| times.iter().map(|ms| format!("{},{ms}.png\n", ms * 1_000_000)).collect::<String>();
        let (left, right) = (list(&[0, 50, 97, 100, 150]), list(&[0, 50, 100, 153, 170]));
        let folder = Folder::with("near", &[("cam0/data.csv", &left), ("cam1/data.csv", &right)]);
        assert_eq!(folder.exposures(Content::Pairs), (vec![0, 50, 100, 150], 2));
        assert_eq!(folder.open(Content::Pairs).expect("a sequence").apart_ns, 3_000_000);
        let far = format!("{},a.png\n0,b.png\n{},c.png\n", i64::MIN, i64::MAX);
        let folder = Folder::with("far", &[("cam0/data.csv", &far), ("cam1/data.csv", &far)]);
        let error = folder.open(Content::Pairs).expect_err("refused").to_string();
        assert!(error.contains("within a week"), "{error}");
        let one = |at: &str| format!("{at},a.png\n");
        let folder = Folder::with("one", &[("cam0/data.csv", &one("1000000")), ("cam1/data.csv", &one("1012000"))]);
        assert_eq!(folder.exposures(Content::Pairs), (vec![0], 0));
    }

    #[test]
    fn a_list_with_a_bad_line_or_a_way_out_of_its_folder_is_refused() {
        for line in ["soon,a.png", "12", "12,../../secret.png", "12,/etc/secret.png"] {
            let folder = Folder::with("bad", &[("cam0/data.csv", line), ("cam1/data.csv", line)]);
            let error = folder.open(Content::Pairs).expect_err("refused").to_string();
            assert!(error.contains("data.csv: line 1") && error.contains(line), "{error}");
        }
    }

    #[test]
    fn folders_and_names_tell_left_from_right() {
        let kitti =
            [("image_0/000.png", ""), ("image_0/001.png", ""), ("image_1/000.png", ""), ("image_1/002.png", "")];
        assert_eq!(Folder::with("kitti", &kitti).exposures(Content::Pairs), (vec![0], 2));
        let times = [
            ("left/a.png", ""),
            ("left/b.png", ""),
            ("right/a.png", ""),
            ("right/b.png", ""),
            ("times.txt", "0.0\n1.037\n"),
        ];
        assert_eq!(Folder::with("times", &times).exposures(Content::Pairs), (vec![0, 1037], 0));
        let flat = [
            ("left01.jpg", ""),
            ("right01.jpg", ""),
            ("left02.jpg", ""),
            ("right02.jpg", ""),
            ("right03.jpg", ""),
            ("calib.txt", ""),
        ];
        assert_eq!(Folder::with("flat", &flat).exposures(Content::Pairs), (vec![0, 100], 1));
    }

    #[test]
    fn depth_folders_are_told_from_what_lies_beside() {
        let scenes = [
            ("frame-000.depth.png", ""),
            ("frame-000.color.jpg", ""),
            ("frame-000.pose.txt", ""),
            ("frame-005.depth.png", ""),
        ];
        assert_eq!(Folder::with("scenes", &scenes).exposures(Content::Depth), (vec![0, 100], 0));
        let tum = [
            ("depth/1305031102.160407.png", ""),
            ("depth/1305031102.194330.png", ""),
            ("rgb/1305031102.175304.png", ""),
        ];
        let folder = Folder::with("tum", &tum);
        assert_eq!(folder.exposures(Content::Depth), (vec![0, 33], 0));
        assert_eq!(folder.open(Content::Depth).expect("a sequence").first_ns, Some(1_305_031_102_160_407_000));
    }

    #[test]
    fn what_cannot_be_played_is_named() {
        let folder = Folder::with("nothing", &[("notes.txt", ""), ("a.png", "")]);
        let error = folder.open(Content::Pairs).expect_err("refused").to_string();
        assert!(error.contains("no stereo pairs") && error.contains("image_0 and image_1"), "{error}");
        assert!(Sequence::open(&[], Content::Pairs, 10.0).is_err());
        let alone = Folder::with("alone", &[("left/a.png", ""), ("right/b.png", "")]);
        let error = alone.open(Content::Pairs).expect_err("refused").to_string();
        assert!(error.contains("2 have no counterpart"), "{error}");
    }
}
