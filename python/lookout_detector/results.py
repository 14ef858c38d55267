"""Results of `lookout eval --manifest M --out DIR` as arrays."""

import json
import os
from typing import Any, NamedTuple, Union

import numpy
import numpy.typing


class Result(NamedTuple):
    """The result of one clip."""

    clip: str
    """Its name."""
    detections: "numpy.typing.NDArray[numpy.float64]"
    """A row each: frame (from 1), left, top, width, height (pixels), score (log-odds)."""
    times_ms: "numpy.typing.NDArray[numpy.float64]"
    """Time of each frame in the detector."""
    about: "dict[str, Any]"
    """What else the file holds: ground truth, facts, tracks, counts of the scan; `broken` says why nothing was measured."""


def read_result(path: "Union[str, os.PathLike[str]]") -> Result:
    """Reads a file of the folder `clips` of a run.

    Raises OSError where it cannot be read, ValueError where it is no such file.
    """
    with open(path, encoding="utf-8") as file:
        lines = [json.loads(line) for line in file]
    if not lines or not isinstance(lines[0], dict) or "clip" not in lines[0]:
        raise ValueError(f"{path}: not the result of a clip")
    found = [line for line in lines[1:] if isinstance(line, list)]
    times = [line["ms"] for line in lines[1:] if isinstance(line, dict)]
    detections = numpy.array(found, numpy.float64).reshape(-1, 6)
    return Result(lines[0]["clip"], detections, numpy.array(times, numpy.float64), lines[0])
