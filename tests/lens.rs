//! Lenses of calibration files against OpenCV's own functions (tests/lens/opencv.csv, written by opencv.py beside it).
#![cfg(feature = "std")]

use fixed::types::I28F4;
use lookout::camera::attitude::Attitude;
use lookout::shell::formats::calibration;

/// A file as ROS has it for the camera of opencv.py.
fn file(lens: &str, coefficients: &[&str]) -> String {
    let model = match lens {
        "plumb_bob" | "fisheye" => lens,
        // ROS has this name for all longer ones.
        _ => "rational_polynomial",
    };
    format!(
        "image_width: 320\nimage_height: 256\ncamera_matrix: {{rows: 3, cols: 3, data: [300.0, 0, 160.5, 0, 310.0, 127.0, 0, 0, \
         1]}}\ndistortion_model: {model}\ndistortion_coefficients: {{rows: 1, cols: {}, data: [{}]}}\n",
        coefficients.len(),
        coefficients.join(", "),
    )
}

#[test]
fn rays_and_pixels_are_those_of_opencv() {
    let text = include_str!("lens/opencv.csv");
    let mut counts = std::collections::BTreeMap::new();
    for line in text.lines().filter(|line| !line.starts_with('#')) {
        let fields: Vec<&str> = line.split(',').collect();
        let coefficients: Vec<&str> = fields[1].split(' ').collect();
        let camera = calibration::parse(&file(fields[0], &coefficients)).unwrap();
        let camera = camera.mounted(Attitude::IDENTITY);
        let numbers: Vec<f64> = fields[2..].iter().map(|field| field.parse().unwrap()).collect();
        let &[x, y, u, v, back_x, back_y] = numbers.as_slice() else { panic!("{line}") };
        let ray = [x, y, 1.0].map(fixed::types::I32F32::from_num);
        // OpenCV puts the centre of the first pixel at 0, pictures here at 1/2; places are sixteenths of a pixel.
        let (got_u, got_v) = camera.project(ray).unwrap();
        let apart = (got_u.to_num::<f64>() - u - 0.5).hypot(got_v.to_num::<f64>() - v - 0.5);
        assert!(apart < 0.08, "{line}: {apart} px");
        let pixel = [u + 0.5, v + 0.5].map(I28F4::from_num::<f64>);
        let [rx, ry, rz] = camera.direction(pixel[0], pixel[1]).map(|v| v.to_num::<f64>());
        let length = (back_x * back_x + back_y * back_y + 1.0).sqrt();
        let turned = ((rx - back_x / length).powi(2)
            + (ry - back_y / length).powi(2)
            + (rz - 1.0 / length).powi(2))
        .sqrt();
        // A sixteenth of a pixel is 2e-4 radians of these lenses, more at the edge of the fisheye.
        assert!(turned < 6e-4, "{line}: {turned} radians");
        *counts.entry(fields[0]).or_insert(0) += 1;
    }
    assert_eq!(counts.len(), 5);
    assert!(counts.values().all(|count| *count == 25), "{counts:?}");
}
