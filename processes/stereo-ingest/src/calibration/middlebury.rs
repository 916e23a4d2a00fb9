//! Middlebury's and ETH3D's `calib.txt`: lines of `key=value`; both cameras and the image size in px, baseline in mm.

use ipc_types::StereoRig;
use std::collections::HashMap;

/// A rectified rig.
pub(super) fn middlebury(text: &str) -> Result<StereoRig, String> {
    let entries: HashMap<&str, &str> =
        text.lines().filter_map(|line| line.split_once('=')).map(|(key, value)| (key.trim(), value.trim())).collect();
    let number = |key: &str| -> Result<f64, String> {
        let value =
            entries.get(key).ok_or(format!("has no \"{key}=\" line; expected .ron or Middlebury's calib.txt"))?;
        value.parse().map_err(|_| format!("{key} is \"{value}\", expected a number"))
    };
    let camera = |key: &str| -> Result<[f64; 3], String> {
        let value =
            entries.get(key).ok_or(format!("has no \"{key}=\" line; expected .ron or Middlebury's calib.txt"))?;
        let cells: Result<Vec<f64>, _> =
            value.trim_matches(['[', ']']).split([' ', ';']).filter(|cell| !cell.is_empty()).map(str::parse).collect();
        match cells.as_deref() {
            Ok([f, _, cx, _, _, cy, ..]) => Ok([*f, *cx, *cy]),
            _ => Err(format!("{key} is \"{value}\", expected [f 0 cx; 0 f cy; 0 0 1]")),
        }
    };
    let [focal_px, cx_px, cy_px] = camera("cam0")?;
    let [right_focal_px, right_cx_px, right_cy_px] = camera("cam1")?;
    if (right_focal_px, right_cy_px) != (focal_px, cy_px) {
        return Err("has cameras of different focal length or cy; expected a rectified pair".to_owned());
    }
    let doffs_px = right_cx_px - cx_px;
    let stated_px = if entries.contains_key("doffs") { number("doffs")? } else { doffs_px };
    if (stated_px - doffs_px).abs() > 0.01 {
        return Err(format!("has doffs={stated_px}, but its cameras' cx differ by {doffs_px:.3}"));
    }
    Ok(StereoRig {
        width_px: number("width")? as u32,
        height_px: number("height")? as u32,
        focal_px,
        cx_px,
        cy_px,
        baseline_m: number("baseline")? * 1e-3,
        doffs_px,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_middlebury_calibrations() {
        let left = "cam0=[542.019 0 458.5; 0 542.019 244.9; 0 0 1]";
        let right = "cam1=[542.019 0 460.0; 0 542.019 244.9; 0 0 1]";
        let rest = "baseline=59.5549\nwidth=940\nheight=490";
        let rig = middlebury(&[left, right, rest].join("\n")).expect("well-formed");
        assert_eq!((rig.focal_px, rig.cx_px, rig.cy_px, rig.width_px), (542.019, 458.5, 244.9, 940));
        assert!((rig.baseline_m - 0.0595549).abs() < 1e-9 && (rig.doffs_px - 1.5).abs() < 1e-9);
        let other_lens = right.replace("542.019", "541");
        for (lines, complaint) in [
            (vec!["baseline=1"], "cam0"),
            (vec![left, rest], "cam1"),
            (vec![left, right, "baseline=1"], "width"),
            (vec![left, right, rest, "doffs=0"], "doffs"),
            (vec![left, &other_lens, rest], "focal length"),
        ] {
            let message = middlebury(&lines.join("\n")).expect_err(complaint);
            assert!(message.contains(complaint), "{message}");
        }
    }
}
