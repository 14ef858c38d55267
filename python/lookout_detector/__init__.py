"""Finds other flying objects in the moving camera of a drone.

>>> import numpy
>>> from lookout_detector import Detector
>>> detector = Detector()
>>> for number in range(4):
...     detections = detector.process(numpy.full((120, 160), 90, numpy.uint8), time_us=number * 33_333)
>>> detections
[]

The program `lookout` comes with it, as does `python -m lookout_detector`; `read_result` reads what `lookout eval --manifest`
writes.
"""

import sys

from ._native import Detection, Detector, Model, __version__, run
from .results import Result, read_result

__all__ = ["Detection", "Detector", "Model", "Result", "__version__", "main", "read_result", "run"]


def main() -> int:
    """Runs the program with the words of the command line; gives its exit status."""
    return run(["lookout", *sys.argv[1:]])
