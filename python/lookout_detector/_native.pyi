"""The part that is written in Rust."""

import os
from typing import List, Optional, Sequence, Tuple, Union, final

import numpy
import numpy.typing

__version__: str

@final
class Model:
    """A model: the one in the program, or a file that `lookout train` wrote.

    Raises OSError where the file cannot be read, ValueError where it is no model of this version.
    """

    def __new__(cls, path: Optional[Union[str, os.PathLike[str]]] = None) -> "Model": ...
    @property
    def checksum(self) -> int:
        """CRC-32, as the model's card has it."""
    @property
    def provenance(self) -> str:
        """The settings that it was trained with, as JSON."""
    @property
    def precisions(self) -> List[Tuple[float, float]]:
        """Scores and the precision measured for detections of that score or more, by score."""

@final
class Detection:
    """A box and its score."""

    @property
    def box(self) -> Tuple[float, float, float, float]:
        """Left, top, width, height in pixels."""
    @property
    def score(self) -> float:
        """Log-odds; larger is surer."""

@final
class Detector:
    """Finds flying objects in the frames of one moving camera.

    Reports detections from the score on from which `min_precision` of them were right on flights held back from training;
    `threshold` asks for a score instead; with `threshold=None, min_precision=None` all are reported. The same frames and times
    give the same boxes as `lookout replay`, on every machine.

    Raises ValueError for a precision that the model does not reach.
    """

    def __new__(
        cls,
        model: Optional[Model] = None,
        *,
        threshold: Optional[float] = None,
        min_precision: Optional[float] = 0.9,
    ) -> "Detector": ...
    @property
    def model(self) -> Model:
        """The model in use."""
    @property
    def memory(self) -> int:
        """Bytes of the detector's memory; 0 before the first frame, whose size it depends on."""
    def process(self, frame: "numpy.typing.NDArray[numpy.uint8]", time_us: Optional[int] = None) -> List[Detection]:
        """Finds objects in a grey frame of shape (height, width), taken at `time_us` microseconds of any epoch.

        Without a time it counts as taken 1/30 s after the frame before. A contiguous array is read where it is; others are
        copied. Python's other threads run meanwhile; do not change the frame's pixels then. A step back in time, or a gap,
        begins anew. The first three frames have nothing to be compared with.

        Raises TypeError for anything but such an array, ValueError for a frame of another size than the first.
        """
    def reset(self) -> None:
        """Begins anew, as with the first frame of another flight."""

def run(words: Sequence[str]) -> int:
    """Runs the program with these words, the first of them its name; gives the exit status."""
