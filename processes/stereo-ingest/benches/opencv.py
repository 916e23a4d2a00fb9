"""Stereo matching against OpenCV's, in one run on one machine: time and error.

    python3 -m venv venv && venv/bin/pip install opencv-python-headless
    cargo build --release
    venv/bin/python processes/stereo-ingest/benches/opencv.py [--data FOLDER] [--sparrowhawk BINARY]

Both match the same grey images with the same disparity range. OpenCV: block 5, P1 200, P2 800, disp12MaxDiff 1,
preFilterCap 31, uniqueness 10, speckles 100/2. Ours: what `sparrowhawk stereo` does unless told otherwise. Times are
medians of the repetitions, without reading files; the two take turns, round by round, and the ratio is of the medians
of a round (median over the rounds; least and largest behind it). Errors count unmatched pixels as bad (all2), over the
pixels that are not occluded.
"""
import argparse, json, pathlib, statistics, subprocess, tempfile, time
import cv2, numpy

MODES = {"SGBM": cv2.STEREO_SGBM_MODE_SGBM, "3WAY": cv2.STEREO_SGBM_MODE_SGBM_3WAY}
TRUTHS = [("mid2001_tsukuba", "imL2l.bmp", "imL2.bmp", 16), ("mid2003_cones", "im2.png", "im6.png", 64),
          ("mid2006_aloe_full", "aloeL.jpg", "aloeR.jpg", 256), ("mid2014_motorcycle_perfect_q", "motorcycle_left.png", "motorcycle_right.png", 64),
          ("eth3d_playground", "im0.png", "im1.png", 64), ("kitti2012_pair_gt", "kittiL.png", "kittiR.png", 96)]


def matcher(mode, disparities):
    return cv2.StereoSGBM_create(0, disparities, 5, 200, 800, 1, 31, 10, 100, 2, mode)


def opencv_ms(mode, left, right, disparities, threads, repeat):
    cv2.setNumThreads(threads)
    engine, times = matcher(mode, disparities), []
    engine.compute(left, right)
    for _ in range(repeat):
        begun = time.perf_counter()
        engine.compute(left, right)
        times.append((time.perf_counter() - begun) * 1e3)
    return statistics.median(times)


def ours(binary, left, right, disparities, threads, repeat, *more):
    with tempfile.NamedTemporaryFile(suffix=".json") as summary:
        command = [binary, "stereo", left, right, "--max-disparity", disparities, "--threads", threads, "--repeat", repeat,
                   "--summary", summary.name, *more]
        subprocess.run([str(part) for part in command], check=True, capture_output=True)
        return json.load(open(summary.name))


def speed(binary, data, rounds, repeat):
    pairs = [("320x240", "oakd_indoor_nogt/living_room", 64, (320, 240)), ("640x480", "oakd_indoor_nogt/living_room", 64, None),
             ("KITTI", "kitti2012_pair_gt/kitti", 128, None)]
    print(f"{'size':>9} {'threads':>7} {'ours ms':>8} " + " ".join(f"{name + ' ms':>9} {'ratio':>18}" for name in MODES))
    with tempfile.TemporaryDirectory() as folder:
        for size, name, disparities, shrink in pairs:
            ends = ("L.png", "R.png") if size == "KITTI" else ("_left.png", "_right.png")
            images = [cv2.imread(str(data / (name + end)), cv2.IMREAD_GRAYSCALE) for end in ends]
            if shrink:
                images = [cv2.resize(image, shrink, interpolation=cv2.INTER_AREA) for image in images]
            files = [pathlib.Path(folder) / f"{side}.png" for side in ("left", "right")]
            for image, file in zip(images, files):
                cv2.imwrite(str(file), image)
            for threads in (1, 2):
                mine, theirs = [], {mode: [] for mode in MODES}
                for _ in range(rounds):
                    mine.append(ours(binary, *files, disparities, threads, repeat)["match_ms"])
                    for mode in MODES:
                        theirs[mode].append(opencv_ms(MODES[mode], *images, disparities, threads, repeat))
                line = f"{size:>9} {threads:>7} {statistics.median(mine):8.2f} "
                for mode in MODES:
                    ratios = sorted(their / my for my, their in zip(mine, theirs[mode]))
                    spread = f"{statistics.median(ratios):.1f} ({ratios[0]:.1f}..{ratios[-1]:.1f})"
                    line += f"{statistics.median(theirs[mode]):9.2f} {spread:>18} "
                print(line, flush=True)


def errors(binary, data):
    print(f"\n{'pair':<30} {'ours all2 %':>11} {'SGBM all2 %':>11}   with a gain of 0.8 on the right image")
    for folder, left, right, disparities in TRUTHS:
        folder = data / folder
        truth = cv2.imread(str(folder / "derived_gt_u16x256.png"), cv2.IMREAD_UNCHANGED) / 256.0
        scored = (cv2.imread(str(folder / "derived_nocc.png"), cv2.IMREAD_GRAYSCALE) >= 128) & (truth > 0)
        grey = [cv2.imread(str(folder / name), cv2.IMREAD_GRAYSCALE) for name in (left, right)]
        line = f"{folder.name:<30} "
        for gain in (1.0, 0.8):
            images = [grey[0], (grey[1] * gain).astype(numpy.uint8)]
            with tempfile.TemporaryDirectory() as scratch:
                files = [pathlib.Path(scratch) / f"{side}.png" for side in ("left", "right")]
                for image, file in zip(images, files):
                    cv2.imwrite(str(file), image)
                result = ours(binary, *files, disparities, 1, 1, "--ground-truth", folder / "derived_gt_u16x256.png",
                              "--mask", folder / "derived_nocc.png")["error"]["bad_or_unmatched_percent"][1]
            padded = [cv2.copyMakeBorder(image, 0, 0, disparities, 0, cv2.BORDER_REPLICATE) for image in images]
            found = matcher(MODES["SGBM"], disparities).compute(*padded)[:, disparities:] / 16.0
            bad = scored & ((found < 0) | (numpy.abs(found - truth) > 2.0))
            line += f"{result:11.2f} {100.0 * bad.sum() / scored.sum():11.2f}   "
        print(line, flush=True)


if __name__ == "__main__":
    root = pathlib.Path(__file__).resolve().parents[3]
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=pathlib.Path, default=root / "../shared/data")
    parser.add_argument("--sparrowhawk", type=pathlib.Path, default=root / "target/release/sparrowhawk")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--repeat", type=int, default=21)
    options = parser.parse_args()
    print(f"OpenCV {cv2.__version__}")
    speed(options.sparrowhawk, options.data, options.rounds, options.repeat)
    errors(options.sparrowhawk, options.data)
