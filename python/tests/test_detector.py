"""The wheel against the program: pytest, with LOOKOUT naming a program built by cargo."""

import json
import os
import pathlib
import subprocess
import sys
import sysconfig
import threading
import time

import lookout_detector
import numpy
import pytest
from lookout_detector import Detector, Model, read_result

LOOKOUT = os.environ["LOOKOUT"]
FLIGHT = ["--kind", "crossing", "--seed", "1", "--seconds", "2", "--width", "320", "--height", "240"]


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    """Frames of a simulated flight, their times, and the program's lines on them."""
    folder = tmp_path_factory.mktemp("flight")
    subprocess.run([LOOKOUT, "simulate", "--out", "data/clip", *FLIGHT], cwd=folder, check=True)
    subprocess.run([LOOKOUT, "replay", "data/clip", "--jsonl", "lines", "--threshold=-2"], cwd=folder, check=True,
                   stdout=subprocess.DEVNULL)
    lines = [json.loads(line) for line in (folder / "lines").read_text().splitlines()]
    frames = [grey(path) for path in sorted((folder / "data/clip/frames").iterdir())]
    assert len(frames) == len(lines) == 60
    return folder, frames, lines


def grey(path):
    from PIL import Image

    picture = numpy.asarray(Image.open(path))
    assert picture.dtype == numpy.uint8 and picture.ndim == 2
    return picture


def plain(detections):
    return [(list(detection.box), detection.score) for detection in detections]


def expected(line):
    return [(detection["box"], detection["score"]) for detection in line["detections"]]


def test_boxes_are_the_programs(flight):
    _, frames, lines = flight
    detector = Detector(threshold=-2.0)
    count = 0
    for frame, line in zip(frames, lines):
        found = plain(detector.process(frame, line["time_us"]))
        assert found == expected(line)
        count += len(found)
    assert count > 60
    assert detector.memory > 1_000_000


def test_other_layouts_give_the_same(flight):
    _, frames, lines = flight
    detector = Detector(threshold=-2.0)
    wide = numpy.zeros((240, 400), numpy.uint8)
    for number, (frame, line) in enumerate(zip(frames[:20], lines)):
        if number % 2:
            frame = numpy.asfortranarray(frame)
        else:
            wide[:, 40:360] = frame
            frame = wide[:, 40:360]
        assert not frame.flags.c_contiguous
        assert plain(detector.process(frame, line["time_us"])) == expected(line)


def test_a_contiguous_frame_is_not_copied(flight):
    import resource

    _, frames, _ = flight
    detector = Detector()
    for _ in range(2):
        detector.process(frames[0])
    # 64 megabytes, of which a copy would show; the detector refuses the size before it takes memory for it.
    large = numpy.zeros((8000, 8000), numpy.uint8)
    large[:] = 1
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(ValueError, match="8000x8000 after frames of 320x240"):
        detector.process(large)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 16_000
    with pytest.raises(ValueError, match="8000x8000"):
        detector.process(large.T)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before > 32_000


def test_other_threads_run_meanwhile(flight):
    _, frames, _ = flight
    detector = Detector()
    counted, stop = [0], threading.Event()

    def count():
        while not stop.is_set():
            counted[0] += 1
            time.sleep(0.0002)

    thread = threading.Thread(target=count)
    thread.start()
    interval = sys.getswitchinterval()
    # Nobody takes Python's lock from a thread that does not give it away: it counts only where `process` does.
    sys.setswitchinterval(1000)
    advanced = 0
    for frame in frames[:20]:
        before = counted[0]
        detector.process(frame)
        advanced += counted[0] > before
    sys.setswitchinterval(interval)
    stop.set()
    thread.join()
    assert advanced > 10, advanced


def test_two_detectors_on_two_threads(flight):
    _, frames, lines = flight
    results = [[], []]

    def work(into):
        detector = Detector(threshold=-2.0)
        for frame, line in zip(frames[:20], lines):
            into.append(plain(detector.process(frame, line["time_us"])) == expected(line))

    threads = [threading.Thread(target=work, args=[into]) for into in results]
    [thread.start() for thread in threads]
    [thread.join() for thread in threads]
    assert results == [[True] * 20] * 2


def test_what_is_refused():
    detector = Detector()
    for wrong in [None, [[1]], numpy.zeros((4, 4, 3), numpy.uint8), numpy.zeros((4, 4)), numpy.zeros(4, numpy.uint8)]:
        with pytest.raises(TypeError, match="grey frame"):
            detector.process(wrong)
    with pytest.raises(ValueError, match="without pixels"):
        detector.process(numpy.zeros((0, 9), numpy.uint8))
    for wrong in [{"min_precision": 0.0}, {"min_precision": 1.5}, {"threshold": float("nan")}]:
        with pytest.raises(ValueError, match="threshold is a finite score"):
            Detector(**wrong)
    with pytest.raises(OSError, match="nowhere.lkm"):
        Model("nowhere.lkm")
    with pytest.raises(ValueError, match="__init__.py"):
        Model(pathlib.Path(lookout_detector.__file__))


def test_the_model_says_what_it_is():
    model = Model()
    assert Detector(model).model.checksum == model.checksum > 0
    assert json.loads(model.provenance)["method"] == "ours"
    scores, precisions = zip(*model.precisions)
    assert list(scores) == sorted(scores) and list(precisions) == sorted(precisions) and max(precisions) <= 1.0


def test_the_program_comes_with_it(flight):
    folder, _, _ = flight
    own = pathlib.Path(sysconfig.get_path("scripts"), "lookout")
    for command in [[own], [sys.executable, "-m", "lookout_detector"]]:
        version = subprocess.run([*command, "--version"], capture_output=True, text=True, check=True).stdout
        assert version == f"lookout {lookout_detector.__version__}\n"
    replays = [subprocess.run([program, "replay", "data/clip", "--digest"], cwd=folder, capture_output=True, text=True,
                              check=True).stdout for program in (own, LOOKOUT)]
    assert replays[0] == replays[1] and replays[0]
    assert subprocess.run([own, "replay", "nowhere"], capture_output=True).returncode == 1


def test_results_are_arrays(flight):
    folder, _, _ = flight
    subprocess.run([LOOKOUT, "manifest", "data", "--out", "m.csv"], cwd=folder, check=True)
    subprocess.run([LOOKOUT, "eval", "--manifest", "m.csv", "--out", "run"], cwd=folder, check=True)
    (path,) = (folder / "run/clips").iterdir()
    result = read_result(path)
    assert (result.clip, len(result.times_ms), result.about["frames"]) == ("clip", 60, 60)
    assert result.detections.shape[1] == 6 and len(result.detections) > 60
    assert set(result.detections[:, 0]) <= set(range(1, 61))
    (folder / "other").write_text("[1]\n")
    with pytest.raises(ValueError, match="other: not the result of a clip"):
        read_result(folder / "other")
