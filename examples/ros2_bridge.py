#!/usr/bin/env python3
"""Publishes what a running lookout sees as vision_msgs/Detection2DArray.

In the settings of `lookout run`:      json = "udp:127.0.0.1:9870"
On the same machine, ROS 2 sourced:    python3 ros2_bridge.py --ros-args -p port:=9870 -p frame_id:=camera

Topics: ~/detections (every detection, its score as a probability) and ~/tracks (confirmed tracks; the id is the track's
number, the class its level: none, traffic, caution or warning).
"""

import json
import math
import socket

# The longest datagram there is.
LONGEST = 65_535


def detections(line):
    """Detections of a line: (class, score from 0 to 1, left, top, width and height in pixels, id) of each."""
    # Scores are log-odds.
    sure = [1.0 / (1.0 + math.exp(-max(-500.0, min(500.0, d["score"])))) for d in line["detections"]]
    return [("object", score, d["box"], "") for score, d in zip(sure, line["detections"])]


def tracks(line):
    """Confirmed tracks of a line, in the same form; their score is 1."""
    confirmed = [track for track in line.get("tracks") or [] if track["confirmed"]]
    return [(track["level"], 1.0, track["box"], str(track["id"])) for track in confirmed]


def stamp(line):
    """Seconds and nanoseconds since 1970 at which the frame was taken."""
    seconds, micros = divmod(line["time_us"], 1_000_000)
    return seconds, micros * 1000


def main():
    import rclpy
    from rclpy.node import Node
    from vision_msgs.msg import Detection2D, Detection2DArray, ObjectHypothesisWithPose

    rclpy.init()
    node = Node("lookout_bridge")
    port = node.declare_parameter("port", 9870).value
    frame_id = node.declare_parameter("frame_id", "camera").value
    publishers = [(node.create_publisher(Detection2DArray, f"~/{of.__name__}", 10), of) for of in (detections, tracks)]
    receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    receiver.bind(("127.0.0.1", port))
    receiver.settimeout(0.5)
    while rclpy.ok():
        rclpy.spin_once(node, timeout_sec=0)
        try:
            line = json.loads(receiver.recv(LONGEST))
        except socket.timeout:
            continue
        for publisher, of in publishers:
            message = Detection2DArray()
            message.header.frame_id = frame_id
            message.header.stamp.sec, message.header.stamp.nanosec = stamp(line)
            for name, score, (left, top, width, height), number in of(line):
                detection = Detection2D(header=message.header, id=number)
                detection.bbox.center.position.x, detection.bbox.center.position.y = left + width / 2, top + height / 2
                detection.bbox.size_x, detection.bbox.size_y = float(width), float(height)
                hypothesis = ObjectHypothesisWithPose()
                hypothesis.hypothesis.class_id, hypothesis.hypothesis.score = name, score
                detection.results.append(hypothesis)
                message.detections.append(detection)
            publisher.publish(message)


if __name__ == "__main__":
    main()
