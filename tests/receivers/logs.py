"""Logs of ArduPilot and PX4: written here, read by pymavlink and pyulog and by the lookout, with the same warnings.

    python logs.py LOOKOUT
"""

import math
import os
import pathlib
import struct
import subprocess
import sys
import tempfile
import time

os.environ["MAVLINK20"] = "1"
from pymavlink import DFReader, mavutil  # noqa: E402
from pyulog import ULog  # noqa: E402

LOOKOUT = os.path.abspath(sys.argv[1])


def messages_of(path):
    log = mavutil.mavlink_connection(str(path))
    while (message := log.recv_msg()) is not None:
        yield message


def texts(path):
    return [m.text for m in messages_of(path) if m.get_type() == "STATUSTEXT"]


def dataflash(path, samples):
    kinds = {"FMT": (128, "BBnNZ", "Type,Length,Name,Format,Columns"), "ATT": (1, "Qfff", "TimeUS,Roll,Pitch,Yaw"),
             "POS": (2, "QLLfff", "TimeUS,Lat,Lng,Alt,RelHomeAlt,RelOriginAlt"), "XKF1": (3, "QBfff", "TimeUS,C,VN,VE,VD")}
    sizes = {"B": 1, "n": 4, "N": 16, "Z": 64, "Q": 8, "f": 4, "L": 4}
    with open(path, "wb") as file:
        for name, (kind, form, labels) in kinds.items():
            length = 3 + sum(sizes[c] for c in form)
            file.write(struct.pack("<3BBB4s16s64s", 0xA3, 0x95, 128, kind, length, name.encode(), form.encode(), labels.encode()))
        for m in samples:
            us = m.time_boot_ms * 1000
            if m.get_type() == "ATTITUDE":
                angles = [math.degrees(v) for v in (m.roll, m.pitch, m.yaw % (2 * math.pi))]
                file.write(struct.pack("<3BQfff", 0xA3, 0x95, 1, us, *angles))
            else:
                velocity = [v / 100 for v in (m.vx, m.vy, m.vz)]
                file.write(struct.pack("<3BQBfff", 0xA3, 0x95, 3, us, 0, *velocity))
                file.write(struct.pack("<3BQiifff", 0xA3, 0x95, 2, us, m.lat, m.lon, m.alt / 1000, 0, 0))
    log = DFReader.DFReader_binary(str(path))
    count = 0
    while (m := log.recv_msg()) is not None:
        count += m.get_type() in ("ATT", "POS")
    assert count == len(samples), (count, len(samples))
    return count


def ulog(path, samples):
    def message(kind, content):
        return struct.pack("<HB", len(content), ord(kind)) + content

    with open(path, "wb") as file:
        file.write(b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0))
        file.write(message("B", bytes(40)))
        for name, fields in (("vehicle_attitude", "uint64_t timestamp;float[4] q;"),
                             ("vehicle_global_position", "uint64_t timestamp;double lat;double lon;float alt;"),
                             ("vehicle_local_position", "uint64_t timestamp;float vx;float vy;float vz;")):
            file.write(message("F", f"{name}:{fields}".encode()))
        for number, name in enumerate(("vehicle_attitude", "vehicle_global_position", "vehicle_local_position")):
            file.write(message("A", struct.pack("<BH", 0, number) + name.encode()))
        for m in samples:
            us = m.time_boot_ms * 1000
            if m.get_type() == "ATTITUDE":
                (sr, cr), (sp, cp), (sy, cy) = [(math.sin(a / 2), math.cos(a / 2)) for a in (m.roll, m.pitch, m.yaw)]
                q = (cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy)
                file.write(message("D", struct.pack("<HQ4f", 0, us, *q)))
            else:
                file.write(message("D", struct.pack("<HQ3f", 2, us, *(v / 100 for v in (m.vx, m.vy, m.vz)))))
                file.write(message("D", struct.pack("<HQddf", 1, us, m.lat / 1e7, m.lon / 1e7, m.alt / 1000)))
    log = ULog(str(path))
    sizes = {data.name: len(data.data["timestamp"]) for data in log.data_list}
    assert sizes["vehicle_attitude"] + sizes["vehicle_global_position"] == len(samples), sizes
    return len(samples)


def check(folder):
    run = lambda *words: subprocess.run([LOOKOUT, *words], check=True, capture_output=True)  # noqa: E731
    flight = folder / "flight"
    run("simulate", "--kind", "collision", "--seed", "1", "--out", flight)
    samples = [m for m in messages_of(flight / "flight.tlog") if m.get_type() in ("ATTITUDE", "GLOBAL_POSITION_INT")]
    assert samples and all(m.time_boot_ms for m in samples[1:])
    wanted = None
    for name, write in (("flight.tlog", None), ("flight.bin", dataflash), ("flight.ulg", ulog)):
        log = flight / name
        if write:
            write(log, samples)
        out = folder / f"{name}.out.tlog"
        run("replay", flight, "--tlog-in", log, "--tlog-out", out)
        said = [text for text in texts(out) if "VIS" in text]
        assert said and (wanted is None or said == wanted), (name, said, wanted)
        wanted = said
    return f"{len(samples)} samples in each log, texts: {wanted}"


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as name:
        start = time.time()
        try:
            result, failed = check(pathlib.Path(name)), False
        except Exception as error:
            result, failed = f"FAILED: {type(error).__name__}: {error}", True
        print(f"logs: {result} ({time.time() - start:.1f} s)", flush=True)
    sys.exit(failed)
