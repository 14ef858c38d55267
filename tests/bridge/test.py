"""Runs examples/ros2_bridge.py on lines of `lookout replay --jsonl`: test.py LOOKOUT.

ROS 2 is not on PyPI: a stand-in for rclpy and vision_msgs takes what is published. Its messages have the fields that the
definitions name, refuse others, and refuse values of another type, as rclpy does.
"""

import importlib.util
import json
import pathlib
import socket
import subprocess
import sys
import tempfile
import types

EXAMPLE = pathlib.Path(__file__).resolve().parents[2] / "examples" / "ros2_bridge.py"
sys.dont_write_bytecode = True


def message(name, **fields):
    """A class with these fields and no others; a class as a value is made anew for each message."""

    def init(self, **given):
        for field, kind in fields.items():
            object.__setattr__(self, field, kind() if callable(kind) else kind)
        for field, value in given.items():
            setattr(self, field, value)

    def assign(self, field, value):
        assert field in fields, f"{name} has no field {field}"
        expected = fields[field]
        expected = expected if callable(expected) else type(expected)
        assert type(value) is expected, f"{name}.{field} = {value!r}"
        object.__setattr__(self, field, value)

    return type(name, (), {"__init__": init, "__setattr__": assign})


Time = message("Time", sec=0, nanosec=0)
Header = message("Header", stamp=Time, frame_id="")
Point2D = message("Point2D", x=0.0, y=0.0)
Pose2D = message("Pose2D", position=Point2D, theta=0.0)
BoundingBox2D = message("BoundingBox2D", center=Pose2D, size_x=0.0, size_y=0.0)
Hypothesis = message("ObjectHypothesis", class_id="", score=0.0)
ObjectHypothesisWithPose = message("ObjectHypothesisWithPose", hypothesis=Hypothesis, pose=object)
Detection2D = message("Detection2D", header=Header, results=list, bbox=BoundingBox2D, id="")
Detection2DArray = message("Detection2DArray", header=Header, detections=list)


class Stop(Exception):
    """Ends the bridge's loop."""


def modules(node, spin_once):
    """Stand-ins for rclpy and vision_msgs."""
    rclpy, rclpy_node = types.ModuleType("rclpy"), types.ModuleType("rclpy.node")
    rclpy.init, rclpy.ok, rclpy.spin_once = lambda: None, lambda: True, spin_once
    rclpy_node.Node = node
    msgs = types.ModuleType("vision_msgs.msg")
    for kind in (Detection2D, Detection2DArray, ObjectHypothesisWithPose):
        setattr(msgs, kind.__name__, kind)
    return {"rclpy": rclpy, "rclpy.node": rclpy_node, "vision_msgs": types.ModuleType("vision_msgs"), "vision_msgs.msg": msgs}


def main():
    lookout = sys.argv[1]
    with tempfile.TemporaryDirectory() as folder:
        file = pathlib.Path(folder, "lines")
        subprocess.run([lookout, "replay", "--simulate", "crossing", "--seed", "2", "--seconds", "3", "--jsonl", file],
                       check=True, stdout=subprocess.DEVNULL)
        lines = file.read_text().splitlines()
    published = {}
    probe = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    probe.bind(("127.0.0.1", 0))
    port = probe.getsockname()[1]
    probe.close()
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    class Node:
        def __init__(self, name):
            assert name == "lookout_bridge"

        def declare_parameter(self, name, value):
            return types.SimpleNamespace(value={"port": port}.get(name, value))

        def create_publisher(self, kind, topic, depth):
            assert kind is Detection2DArray and depth > 0
            published[topic] = []
            return types.SimpleNamespace(publish=published[topic].append)

    def spin_once(node, timeout_sec):
        """Sends the next line: the bridge listens already, and takes it after this."""
        done = {len(list_) for list_ in published.values()}
        assert len(done) == 1, done
        number = done.pop()
        if number == len(lines):
            raise Stop
        sender.sendto(lines[number].encode(), ("127.0.0.1", port))

    sys.modules.update(modules(Node, spin_once))
    spec = importlib.util.spec_from_file_location("bridge", EXAMPLE)
    bridge = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(bridge)
    try:
        bridge.main()
    except Stop:
        pass
    assert set(published) == {"~/detections", "~/tracks"}, published.keys()
    boxes = tracks = 0
    for line, found, followed in zip(map(json.loads, lines), published["~/detections"], published["~/tracks"]):
        assert found.header.frame_id == "camera"
        stamp = found.header.stamp
        assert stamp.sec * 1_000_000 + stamp.nanosec // 1000 == line["time_us"]
        assert len(found.detections) == len(line["detections"])
        for detection, own in zip(found.detections, line["detections"]):
            left, top, width, height = own["box"]
            centre = detection.bbox.center.position
            assert (centre.x, centre.y) == (left + width / 2, top + height / 2)
            assert (detection.bbox.size_x, detection.bbox.size_y) == (width, height)
            score = detection.results[0].hypothesis.score
            assert 0.0 <= score <= 1.0 and (score > 0.5) == (own["score"] > 0)
        confirmed = [str(track["id"]) for track in line["tracks"] if track["confirmed"]]
        assert [track.id for track in followed.detections] == confirmed
        boxes, tracks = boxes + len(line["detections"]), tracks + len(confirmed)
    assert boxes > 30 and tracks > 30, (boxes, tracks)
    print(f"bridge to ROS 2 (stand-in): {len(lines)} frames, {boxes} detections, {tracks} boxes of tracks")


main()
