//! The matcher finds what is there, and finds the same with every instruction set and any number of threads.

use ipc_types::StereoRig;
use ipc_types::disparity::{decode, is_valid};
use rand::{RngExt, SeedableRng};
use stereo_ingest::{Config, Matcher, Method, SimdLevel};

fn rig(width_px: u32, height_px: u32) -> StereoRig {
    let (cx_px, cy_px) = (f64::from(width_px) / 2.0, f64::from(height_px) / 2.0);
    StereoRig { width_px, height_px, focal_px: 200.0, cx_px, cy_px, baseline_m: 0.3, doffs_px: 0.0 }
}

/// A textured pair: a slanted background from 4 px, a square at `near` px before it.
fn pair(width: usize, height: usize, near: usize) -> (Vec<u8>, Vec<u8>, Vec<usize>) {
    let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(7);
    let texture: Vec<u8> = (0..(width + 300) * height).map(|_| random.random()).collect();
    let smooth = |x: usize, y: usize| {
        let cell = |dx: usize| u32::from(texture[y * (width + 300) + x + dx]);
        ((cell(0) + 2 * cell(1) + cell(2)) / 4) as u8
    };
    let square = |x: usize, y: usize| (width / 3..width / 2).contains(&x) && (height / 3..2 * height / 3).contains(&y);
    let truth: Vec<usize> = (0..width * height)
        .map(|i| if square(i % width, i / width) { near } else { 4 + 4 * (i / width) / height })
        .collect();
    let right: Vec<u8> = (0..width * height).map(|i| smooth(i % width, i / width)).collect();
    let left = (0..width * height)
        .map(|i| {
            let (x, y) = (i % width, i / width);
            // The left pixel x shows what the right image has at x - d; beyond its border, anything.
            if x >= truth[i] { right[y * width + x - truth[i]] } else { smooth(x + 290 - truth[i], y) }
        })
        .collect();
    (left, right, truth)
}

fn methods() -> [Method; 5] {
    let semi_global =
        |paths, window_px| Method::SemiGlobal { paths, window_px, small_step_penalty: 14, large_step_penalty: 65 };
    [semi_global(3, 5), semi_global(5, 3), semi_global(3, 1), semi_global(3, 7), Method::Block { window_px: 9 }]
}

#[test]
fn surfaces_are_found_at_their_disparity() {
    let (width, height) = (200, 131);
    let (left, right, truth) = pair(width, height, 24);
    for method in methods() {
        let config = Config { method, ..Config::dense(64) };
        let mut disparity = vec![0; width * height];
        let mut matcher = Matcher::new(&rig(width as u32, height as u32), config);
        let found = matcher.step(&left, &right, &mut disparity).expect("sizes agree");
        assert_eq!(found.valid, disparity.iter().filter(|&&pixel| is_valid(pixel)).count());
        let inner = |i: &usize| (30..width - 10).contains(&(i % width)) && (10..height - 10).contains(&(i / width));
        let scored: Vec<usize> = (0..width * height).filter(inner).collect();
        let right_ones =
            scored.iter().filter(|&&i| decode(disparity[i]).is_some_and(|d| (d - truth[i] as f32).abs() < 1.0));
        let share = right_ones.count() as f64 / scored.len() as f64;
        // The rest lies around the square: its shadow in the right image, and what its border blurs.
        assert!(share > 0.85, "{method:?}: {share:.3}");
    }
}

#[test]
fn instructions_and_threads_do_not_matter() {
    for (width, height) in [(97, 61), (330, 251)] {
        let (left, right, _) = pair(width, height, 13);
        let rig = rig(width as u32, height as u32);
        for (method, max_disparity_px) in methods().into_iter().zip([16, 32, 64, 96, 64]).chain([
            (methods()[0], 128),
            (methods()[0], 192),
            (methods()[4], 256),
        ]) {
            if max_disparity_px as usize >= width {
                continue;
            }
            let base = Config { method, least_texture: 2.0, uniqueness_percent: 5, ..Config::dense(max_disparity_px) };
            let run = |level: SimdLevel, threads: u32| {
                let mut disparity = vec![0; width * height];
                let mut matcher = Matcher::with_level(&rig, Config { threads, ..base }, level);
                // Twice: nothing of the first pair may be left.
                matcher.step(&right, &left, &mut disparity).expect("sizes agree");
                matcher.step(&left, &right, &mut disparity).expect("sizes agree");
                disparity
            };
            let expected = run(SimdLevel::Portable, 1);
            for level in SimdLevel::ALL {
                if !level.is_available() {
                    eprintln!("SKIPPED: this machine has no {level:?}");
                    continue;
                }
                for threads in [1, 2, 3] {
                    assert!(run(level, threads) == expected, "{level:?}, {threads} threads, {base:?}, {width} px");
                }
            }
        }
    }
}

#[test]
fn gain_and_offset_between_the_cameras_hardly_matter() {
    let (width, height) = (200, 120);
    let (left, right, truth) = pair(width, height, 24);
    let darker: Vec<u8> = right.iter().map(|&p| (f32::from(p) * 0.6 + 20.0) as u8).collect();
    let mut disparity = vec![0; width * height];
    let mut matcher = Matcher::new(&rig(width as u32, height as u32), Config::dense(64));
    matcher.step(&left, &darker, &mut disparity).expect("sizes agree");
    let found =
        (0..width * height).filter(|&i| decode(disparity[i]).is_some_and(|d| (d - truth[i] as f32).abs() < 1.0));
    let share = found.count() as f64 / (width * height) as f64;
    assert!(share > 0.75, "{share:.3}");
}
