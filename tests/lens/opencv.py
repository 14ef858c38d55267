#!/usr/bin/env python3
"""Writes opencv.csv: what OpenCV's own functions make of rays and pixels, for tests/lens.rs.

    python3 -m venv VENV && VENV/bin/pip install opencv-python-headless==5.0.0.93 && VENV/bin/python tests/lens/opencv.py

Lines: lens, coefficients (blanks between), ray x, y (z is 1), its pixel u, v (projectPoints), and the point x, y of focal
length 1 that undistortPoints finds for that pixel, iterated until it moves by less than 1e-12.
"""
import pathlib

import cv2
import numpy as np

K = np.array([[300.0, 0, 160.5], [0, 310.0, 127.0], [0, 0, 1]])
LENSES = {
    "plumb_bob": [-0.3, 0.1, 0.001, -0.002, 0.01],
    "rational_polynomial": [0.5, -0.2, 0.001, -0.002, 0.05, 0.8, -0.1, 0.03],
    "thin_prism": [0.5, -0.2, 0.001, -0.002, 0.05, 0.8, -0.1, 0.03, 0.01, -0.002, 0.015, 0.001],
    "tilted": [0.1, -0.05, 0.001, -0.002, 0.01, 0.05, 0.0, 0.0, 0.01, 0.0, 0.01, 0.0, 0.08, -0.05],
    "fisheye": [-0.02, 0.01, -0.005, 0.001],
}
out = ["# opencv " + cv2.__version__]
zero = np.zeros(3)
for name, coefficients in LENSES.items():
    d = np.array(coefficients)
    reach = 3.0 if name == "fisheye" else 0.55
    for x in np.linspace(-reach, reach, 5):
        for y in np.linspace(-reach * 0.8, reach * 0.8, 5):
            ray = np.array([[[x, y, 1.0]]])
            if name == "fisheye":
                pixel, _ = cv2.fisheye.projectPoints(ray, zero, zero, K, d)
                point = cv2.fisheye.undistortPoints(pixel, K, d)
            else:
                pixel, _ = cv2.projectPoints(ray, zero, zero, K, d)
                criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
                point = cv2.undistortPoints(pixel, K, d, criteria=criteria)
            (u, v), (px, py) = pixel.ravel(), point.ravel()
            words = " ".join(str(c) for c in coefficients)
            out.append(f"{name},{words},{x:.6f},{y:.6f},{u:.6f},{v:.6f},{px:.8f},{py:.8f}")
pathlib.Path(__file__).with_name("opencv.csv").write_text("\n".join(out) + "\n")
