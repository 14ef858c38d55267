"""MCAP files against PyPI's mcap and mcap-ros2-support, by the program in the wheel."""

import base64
import io
import json
import pathlib
import subprocess
import sysconfig

import numpy
import pytest
from mcap.reader import make_reader
from mcap_ros2.writer import Writer
from PIL import Image

LOOKOUT = pathlib.Path(sysconfig.get_path("scripts"), "lookout")
FLIGHT = ["--kind", "collision", "--seed", "8", "--seconds", "4", "--width", "320", "--height", "240"]
HEADER = """std_msgs/Header header
{fields}
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
IMAGE = HEADER.format(fields="uint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\nuint8[] data")
COMPRESSED = HEADER.format(fields="string format\nuint8[] data")
# Flights do not begin at time 0 in ROS.
START_US = 1_700_000_000_000_000


def run(folder, *arguments):
    done = subprocess.run([LOOKOUT, *arguments], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done


def lines(folder, *arguments):
    run(folder, "replay", *arguments, "--jsonl", "out.jsonl")
    return [json.loads(line) for line in (folder / "out.jsonl").read_text().splitlines()]


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    """A flight, its frames, and the program's lines on them."""
    folder = tmp_path_factory.mktemp("flight")
    run(folder, "simulate", "--out", "clip", *FLIGHT)
    frames = [numpy.asarray(Image.open(path)) for path in sorted((folder / "clip/frames").iterdir())]
    return folder, frames, lines(folder, "clip")


def write(path, frames, times_us, kind, topic="/camera/image_raw"):
    """Frames as a ROS 2 log: `kind` is an encoding of Image, or png for CompressedImage."""
    with open(path, "wb") as file:
        writer = Writer(file)
        compressed = kind == "png"
        name = "sensor_msgs/msg/CompressedImage" if compressed else "sensor_msgs/msg/Image"
        schema = writer.register_msgdef(name, COMPRESSED if compressed else IMAGE)
        other = writer.register_msgdef("std_msgs/msg/String", "string data")
        for frame, time_us in zip(frames, times_us):
            stamp = {"sec": (START_US + time_us) // 1_000_000, "nanosec": (START_US + time_us) % 1_000_000 * 1000}
            message = {"header": {"stamp": stamp, "frame_id": "camera"}}
            height, width = frame.shape
            if compressed:
                bytes_ = io.BytesIO()
                Image.fromarray(frame).save(bytes_, "png")
                message |= {"format": "mono8; png compressed", "data": bytes_.getvalue()}
            else:
                data = {"mono8": frame, "mono16": frame.astype("<u2") << 8, "rgb8": numpy.repeat(frame[..., None], 3, 2)}[kind]
                message |= {"height": height, "width": width, "encoding": kind, "is_bigendian": 0,
                            "step": data.nbytes // height, "data": data.tobytes()}
            log_time = (START_US + time_us) * 1000
            writer.write_message("/chatter", other, {"data": "text between pictures"}, log_time)
            writer.write_message(topic, schema, message, log_time)
        writer.finish()


@pytest.mark.parametrize("kind", ["mono8", "mono16", "rgb8", "png"])
def test_pictures_of_ros_are_read(flight, kind):
    folder, frames, expected = flight
    write(folder / "flight.mcap", frames, [line["time_us"] for line in expected], kind)
    found = lines(folder, "flight.mcap", "--camera", "clip/camera.json")
    assert [line["time_us"] for line in found] == [line["time_us"] for line in expected]
    assert [line["detections"] for line in found] == [line["detections"] for line in expected]
    assert sum(len(line["detections"]) for line in found) > 10


def test_topics_are_chosen(flight):
    folder, frames, expected = flight
    write(folder / "a.mcap", frames[:5], [line["time_us"] for line in expected], "mono8", "/left/image_raw")
    assert len(lines(folder, "a.mcap#/left/image_raw")) == 5
    for name, words in [("a.mcap#/right", "no picture of /right in it"), ("broken.mcap", "broken.mcap: frame 1")]:
        (folder / "broken.mcap").write_bytes((folder / "a.mcap").read_bytes()[:-300_000])
        done = subprocess.run([LOOKOUT, "replay", name], cwd=folder, capture_output=True, text=True)
        if name == "broken.mcap":
            # Cut off in the middle: what came before was read.
            assert "broken.mcap: frame" in done.stderr or done.returncode == 0, done.stderr
        else:
            assert done.returncode == 1 and words in done.stderr, done.stderr
    (folder / "no.mcap").write_bytes(b"not a log at all")
    done = subprocess.run([LOOKOUT, "replay", "no.mcap"], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 1 and "no.mcap: frame 1: " in done.stderr, done.stderr


def test_what_is_written_is_read_by_others(flight):
    folder, frames, expected = flight
    run(folder, "replay", "clip", "--mcap", "out.mcap")
    topics, schemas = {}, {}
    with open(folder / "out.mcap", "rb") as file:
        reader = make_reader(file, validate_crcs=True)
        for schema, channel, message in reader.iter_messages():
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            described = json.loads(schema.data)
            value = json.loads(message.data)
            # Every field that is written is described.
            assert described["title"] == schema.name and described["type"] == "object"
            if schema.name.startswith("foxglove."):
                assert set(value) == set(described["properties"]), schema.name
            schemas[channel.topic] = schema.name
            topics.setdefault(channel.topic, []).append((message.log_time, value))
    assert schemas == {"/lookout/image": "foxglove.CompressedImage", "/lookout/boxes": "foxglove.ImageAnnotations",
                       "/lookout/alerts": "foxglove.Log", "/lookout/bearings": "lookout.Bearings",
                       "/lookout/frame": "lookout.Frame"}
    assert [value for _, value in topics["/lookout/frame"]] == expected
    for (time, value), frame, line in zip(topics["/lookout/image"], frames, expected):
        assert time == line["time_us"] * 1000
        assert value["timestamp"]["sec"] * 1_000_000_000 + value["timestamp"]["nsec"] == time
        picture = Image.open(io.BytesIO(base64.b64decode(value["data"])))
        assert numpy.array_equal(numpy.asarray(picture), frame)
    for (_, value), line in zip(topics["/lookout/boxes"], expected):
        confirmed = [track for track in line["tracks"] if track["confirmed"]]
        assert len(value["points"]) == len(value["texts"]) == len(line["detections"]) + len(confirmed)
        for points, found in zip(value["points"], line["detections"]):
            left, top, width, height = found["box"]
            assert points["points"][0] == {"x": left, "y": top}
            assert points["points"][2] == {"x": left + width, "y": top + height}
    confirmed = [[t["id"] for t in line["tracks"] if t["confirmed"]] for line in expected]
    assert [[t["id"] for t in value["tracks"]] for _, value in topics["/lookout/bearings"]] == confirmed
    assert topics["/lookout/alerts"] and all("track" in value["message"] for _, value in topics["/lookout/alerts"])
    # It is a log to replay, too.
    again = lines(folder, "out.mcap", "--camera", "clip/camera.json")
    assert [line["detections"] for line in again] == [line["detections"] for line in expected]
