use super::*;
use std::format;
use std::string::ToString;
use std::vec;

/// A ROS file.
fn ros(model: &str, coefficients: &str) -> String {
    format!(
        "image_width: 320\nimage_height: 256\ncamera_name: narrow\ncamera_matrix:\n  rows: 3\n  cols: 3\n  data: [300.0, \
         0, 160.0, 0, 310.0, 128.0, 0, 0, 1]\n{model}\ndistortion_coefficients:\n  rows: 1\n  cols: {}\n  data: \
         [{coefficients}]\nprojection_matrix: {{rows: 3, cols: 4, data: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]}}\n",
        coefficients.split(',').filter(|text| !text.trim().is_empty()).count(),
    )
}

fn polynomial(k: &[f64]) -> Lens {
    let mut all = [ZERO; 14];
    for (to, from) in all.iter_mut().zip(k) {
        *to = Real::from_num(*from);
    }
    Lens::Polynomial(all)
}

const FIVE: &str = "-0.3, 0.1, 0.001, -0.002, 0.0";
const FOUR: &str = "-0.02, 0.01, -0.005, 0.001";

#[test]
fn models_under_all_their_names() {
    let five = polynomial(&[-0.3, 0.1, 0.001, -0.002]);
    let fisheye = Lens::Fisheye([-0.02, 0.01, -0.005, 0.001].map(Real::from_num));
    let many = [0.5, -0.2, 0.001, -0.002, 0.05, 0.8, -0.1, 0.03, 0.01, 0.0, 0.01, 0.0, 0.02, 0.03];
    let list = |count| many[..count].iter().map(f64::to_string).collect::<Vec<_>>().join(", ");
    for (model, coefficients, lens) in [
        ("distortion_model: plumb_bob", FIVE.to_owned(), five),
        ("distortion_model: plumb_bob", "-0.3, 0.1, 0.001, -0.002".into(), five),
        ("distortion_model: plumb_bob", format!("{FIVE}, 0.0, 0.0, 0.0"), five),
        ("camera_model: plumb_bob", FIVE.into(), five),
        ("flags: 0", FIVE.into(), five),
        ("distortion_model: rational_polynomial", list(8), polynomial(&many[..8])),
        ("distortion_model: rational_polynomial", list(12), polynomial(&many[..12])),
        ("flags: 0", list(14), polynomial(&many)),
        ("distortion_model: fisheye", FOUR.into(), fisheye),
        ("distortion_model: equidistant", FOUR.into(), fisheye),
        ("camera_model: fisheye", FOUR.into(), fisheye),
        ("fisheye_model: 1", FOUR.into(), fisheye),
        ("camera_model: pinhole\ndistortion_model: equidistant", FOUR.into(), fisheye),
        ("distortion_model: none", String::new(), Lens::PINHOLE),
        ("distortion_model: \"\"", "0.0, 0.0, 0.0, 0.0, 0.0".into(), Lens::PINHOLE),
    ] {
        let camera = parse(&ros(model, &coefficients)).unwrap_or_else(|e| panic!("{model}: {e}"));
        assert_eq!(camera.intrinsics().lens, lens, "{model}");
        assert_eq!(camera.intrinsics().focal, [300, 310].map(Real::from_num));
    }
}

#[test]
fn forms_of_many_tools() {
    let wanted = parse(&ros("distortion_model: plumb_bob", FIVE)).unwrap();
    let k = "[300.0, 0.0, 160.0, 0.0, 310.0, 128.0, 0.0, 0.0, 1.0]";
    let rows = "[[300.0, 0.0, 160.0], [0.0, 310.0, 128.0], [0.0, 0.0, 1.0]]";
    let opencv = |matrix: &str, distortion: &str| {
        format!(
            "image_width: 320\nimage_height: 256\nboard_width: 9\n{matrix}: !!opencv-matrix\n   rows: 3\n   cols: 3\n   \
             dt: d\n   data: [ 3.0e+02, 0., 160., 0., 310.,\n       128., 0., 0., 1. ]\n{distortion}: !!opencv-matrix\n   \
             rows: 5\n   cols: 1\n   dt: d\n   data: [ -0.3, 0.1, 1.0e-3, -2.0e-3, 0. ]\n"
        )
    };
    let mut texts = vec![
        format!("\u{feff}{}", ros("distortion_model: plumb_bob", FIVE)),
        ros("distortion_model: plumb_bob", FIVE).replace('\n', "\r\n"),
        // rostopic echo and ros2 topic echo.
        format!("height: 256\nwidth: 320\ndistortion_model: \"plumb_bob\"\nD: [{FIVE}]\nK: {k}\nbinning_x: 0\n"),
        format!(
            "header:\n  frame_id: camera\nheight: 256\nwidth: 320\ndistortion_model: plumb_bob\nd:\n- -0.3\n- 0.1\n- \
             0.001\n- -0.002\n- 0.0\nk: {k}\nbinning_x: 0\nroi:\n  x_offset: 0\n  y_offset: 0\n  height: 0\n  width: 0\n  \
             do_rectify: false\n---\nheight: 1\n"
        ),
        // Kalibr.
        "cam0:\n  camera_model: pinhole\n  distortion_coeffs: [-0.3, 0.1, 0.001, -0.002]\n  distortion_model: radtan\n  \
         intrinsics: [300.0, 310.0, 160.0, 128.0]\n  resolution: [320, 256]\n  rostopic: /cam0/image_raw\n"
            .to_owned(),
        // Python's yaml and json of numpy's lists.
        format!("{{\"camera_matrix\": {rows}, \"dist_coeff\": [[{FIVE}]], \"image_size\": [320, 256]}}"),
        format!("mtx: {rows}\ndist: [[{FIVE}]]\nwidth: 320\nheight: 256\n"),
    ];
    for (matrix, distortion) in [
        ("camera_matrix", "distortion_coefficients"),
        ("Camera_Matrix", "Distortion_Coefficients"),
        ("cameraMatrix", "distCoeffs"),
        ("K", "D"),
        ("mtx", "dist"),
    ] {
        texts.push(format!("%YAML:1.0\n---\n{}", opencv(matrix, distortion)));
        texts.push(format!("%YAML 1.2\n---\n{}", opencv(matrix, distortion)));
        texts.push(opencv(matrix, distortion));
    }
    for text in texts {
        assert_eq!(parse(&text).unwrap_or_else(|e| panic!("{text}: {e}")), wanted, "{text}");
    }
}

#[test]
fn what_is_not_understood_is_refused() {
    let good = ros("distortion_model: plumb_bob", FIVE);
    let fisheye = ros("distortion_model: fisheye", FOUR);
    for (text, wanted) in [
        (
            ros("distortion_model: thin_prism_fisheye", FOUR),
            "'thin_prism_fisheye' is not supported",
        ),
        (ros("camera_model: omni", FOUR), "camera_model: 'omni' is not supported"),
        (ros("distortion_model: 3", FOUR), "distortion_model: '?' is not supported"),
        (ros("distortion_model: fisheye", FIVE), "5 coefficients, but a fisheye has 4"),
        (
            ros("distortion_model: plumb_bob", "1, 2, 3"),
            "3 coefficients, but a polynomial lens has",
        ),
        (ros("flags: 0", FOUR), "4 coefficients, but a file that names no model has 5 or more"),
        (ros("distortion_model: ''", FIVE), "5 coefficients, but no model has none but zeros"),
        (ros("distortion_model: plumb_bob\ncamera_model: fisheye", FOUR), "say different things"),
        (ros("distortion_model: plumb_bob\nfisheye_model: 1", FOUR), "say different things"),
        (ros("fisheye_model: yes please", FOUR), "fisheye_model: expected 0 or 1"),
        (good.replace("image_width: 320\n", ""), "image_width is missing"),
        (good.replace("rows: 3\n", "rows: 2\n"), "camera_matrix: 2x3, but 9 numbers"),
        (good.replace("300.0, 0,", "300.0, 1,"), "skew of 1"),
        (good.replace("300.0", ".nan"), "fx: NaN is out of range"),
        (good.replace("300.0", "0.5"), "focal length"),
        (good.replace("160.0", "1e4"), "optical axis"),
        (
            good.replace(
                "[300.0, 0, 160.0, 0, 310.0, 128.0, 0, 0, 1]",
                "[0, 0, 0, 0, 0, 0, 0, 0, 1]",
            ),
            "not calibrated",
        ),
        (good.replace("-0.3", "x"), "distortion_coefficients: expected a list"),
        (
            good.replace("distortion_coefficients", "my_coefficients"),
            "distortion_coefficients is missing",
        ),
        (good.replace("camera_matrix", "my_matrix"), "camera_matrix is missing; known names"),
        (format!("{good}K: [1, 0, 0, 0, 1, 0, 0, 0, 1]\n"), "camera_matrix and K say different"),
        (format!("{fisheye}binning_x: 2\n"), "binning_x: cut or binned"),
        (
            format!("{fisheye}roi: {{x_offset: 8, y_offset: 0, height: 256, width: 200}}\n"),
            "roi: cut",
        ),
        ("cam0: {a: 1}\ncam1: {a: 1}\n".into(), "several cameras (cam0, cam1)"),
        ("a: [1".into(), "not YAML or JSON"),
        (String::new(), "image_width is missing"),
        ("5".into(), "image_width is missing"),
    ] {
        let error = parse(&text).map(drop).unwrap_err().to_string();
        assert!(error.contains(wanted), "{wanted}: {error}");
    }
    let whole = format!("{good}roi: {{x_offset: 0, y_offset: 0, height: 256, width: 320}}\n");
    assert!(parse(&whole).is_ok());
}
