"""Faults that users met on commit a9acc21, through the program alone: cameras, streams, times, vehicles, stations.

    python users.py LOOKOUT [NAME...]

Every check fails with the program of a9acc21 and holds with this one; CONTRIBUTING.md has the list. Needs ffmpeg. With
another program in LOOKOUT_SIMULATOR that one renders the flights: an old LOOKOUT is shown the same ones.
"""

import concurrent.futures
import contextlib
import json
import math
import os
import pathlib
import re
import shutil
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request

os.environ["MAVLINK20"] = "1"
from pymavlink.dialects.v20 import ardupilotmega as mavlink  # noqa: E402

LOOKOUT = os.path.abspath(sys.argv[1])
SIMULATOR = os.environ.get("LOOKOUT_SIMULATOR", LOOKOUT)
LATITUDE, LONGITUDE = 473769000, 85417000
GENERIC, ARDUPILOT = mavlink.MAV_AUTOPILOT_GENERIC, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
ROOT = pathlib.Path(tempfile.mkdtemp(prefix="lookout-users-"))
CHECKS = []


def check(function):
    CHECKS.append(function)
    return function


def lookout(*words, ok=True, program=LOOKOUT, **options):
    """Runs the program to its end; what it printed on standard output and error."""
    done = subprocess.run([program, *map(os.fspath, words)], capture_output=True, timeout=300, **options)
    out, err = done.stdout.decode(errors="replace"), done.stderr.decode(errors="replace")
    if ok is not None:
        assert (done.returncode == 0) == ok, f"status {done.returncode}: {(err or out).strip()[-300:]}"
    return out, err


def ffmpeg(*words):
    subprocess.run(["ffmpeg", "-v", "error", "-y", "-nostdin", *map(os.fspath, words)], check=True)


def replayed(source, *more):
    """Lines of JSON of a replay."""
    with tempfile.NamedTemporaryFile(suffix=".jsonl") as file:
        lookout("replay", source, "--jsonl", file.name, *more)
        return [json.loads(line) for line in open(file.name)]


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


_made, _lock = {}, threading.Lock()


def made(name, make):
    """A folder or file that several checks use, made once."""
    with _lock:
        if name not in _made:
            make(ROOT / name)
            _made[name] = ROOT / name
        return _made[name]


def hover():
    """A flight whose object stays in view, ahead of a vehicle that looks north."""
    words = ["simulate", "--kind", "hover", "--seed", "1", "--seconds", "6", "--fps", "15", "--width", "320", "--height", "240"]
    return made("hover", lambda path: lookout(*words, "--out", path, program=SIMULATOR))


def collision():
    words = ["simulate", "--kind", "collision", "--seed", "1"]
    return made("collision", lambda path: lookout(*words, "--out", path, program=SIMULATOR))


class Net:
    """A UDP port on which many systems and components speak to what calls there."""

    def __init__(self):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(0.05)
        self.port = self.socket.getsockname()[1]
        self.link = f"udpout:127.0.0.1:{self.port}"
        self.peers, self.heard, self.stop, self.lock = set(), [], False, threading.Lock()
        self.parser = mavlink.MAVLink(None)
        self.parser.robust_parsing = True
        self.threads = []
        self.again(self.listen, 0)

    def listen(self):
        try:
            data, peer = self.socket.recvfrom(4096)
        except TimeoutError:
            return
        self.peers.add(peer)
        for message in self.parser.parse_buffer(data) or []:
            self.heard.append((time.time(), message))

    def write(self, data):
        for peer in list(self.peers):
            with contextlib.suppress(OSError):
                self.socket.sendto(data, peer)

    def again(self, action, seconds):
        """Repeats an action until the end."""
        def run():
            while not self.stop:
                action()
                time.sleep(seconds)
        self.threads.append(threading.Thread(target=run, daemon=True))
        self.threads[-1].start()

    def speaker(self, system, component):
        return mavlink.MAVLink(self, srcSystem=system, srcComponent=component)

    def of(self, kind, since=0.0):
        return [m for t, m in list(self.heard) if m.get_type() == kind and t >= since]

    def until(self, condition, seconds, what):
        end = time.time() + seconds
        while time.time() < end:
            if found := condition():
                return found
            time.sleep(0.05)
        raise AssertionError(f"{what}: not in {seconds} s; texts: {[m.text for m in self.of('STATUSTEXT')]}")

    def text(self, words, seconds, since=0.0):
        return self.until(lambda: [m for m in self.of("STATUSTEXT", since) if words in m.text], seconds, words)

    def close(self):
        self.stop = True
        for thread in self.threads:
            thread.join(2)
        self.socket.close()


class Vehicle:
    """An autopilot on a net, level and looking north, until it is switched off."""

    def __init__(self, net, system=1, kind=2, autopilot=ARDUPILOT, rate=20):
        self.mav, self.on, self.count, self.start = net.speaker(system, 1), True, 0, time.time()
        self.kind, self.autopilot, self.rate = kind, autopilot, rate
        net.again(self.step, 1 / rate)

    def step(self):
        if not self.on:
            return
        boot = int((time.time() - self.start) * 1000) + 5000
        if self.count % self.rate == 0:
            self.mav.heartbeat_send(self.kind, self.autopilot, 81, 4, 4)
        self.mav.attitude_quaternion_send(boot, 1, 0, 0, 0, 0, 0, 0)
        if self.count % 4 == 0:
            self.mav.global_position_int_send(boot, LATITUDE, LONGITUDE, 500000, 100000, 0, 0, 0, 0)
        self.count += 1


class Run:
    """`lookout run` with these settings."""

    def __init__(self, folder, settings):
        self.log = folder / "run.log"
        (folder / "lookout.toml").write_text(settings)
        with open(self.log, "w") as log:
            self.process = subprocess.Popen([LOOKOUT, "run", "--config", folder / "lookout.toml"], stdout=log, stderr=log)

    def said(self, words, seconds=20):
        end = time.time() + seconds
        while words not in self.log.read_text(errors="replace"):
            assert time.time() < end, f"no '{words}' in: {self.log.read_text(errors='replace')[-400:]}"
            time.sleep(0.05)

    def end(self):
        if self.process.poll() is None:
            self.process.terminate()
            try:
                self.process.wait(15)
            except subprocess.TimeoutExpired:
                self.process.kill()
        return self.process.wait()


@contextlib.contextmanager
def flying(settings="", source=None, vehicle=True):
    """A lookout on a recorded flight, linked to a net with a vehicle."""
    folder, net = pathlib.Path(tempfile.mkdtemp(dir=ROOT)), Net()
    source = source or f'"file:{hover()}"\nrepeat = true'
    head = f'source = {source}\nlinks = ["{net.link}"]\nthreads = 1\n'
    run = Run(folder, head + settings)
    try:
        net.until(lambda: net.of("HEARTBEAT") or run.process.poll() is not None, 30, "heartbeat")
        assert run.process.poll() is None, run.log.read_text(errors="replace").strip()[-300:]
        yield (net, run, Vehicle(net) if vehicle else None)
    finally:
        run.end()
        net.close()


def lookouts(messages):
    """Those of the lookout, not of what else speaks here."""
    return [m for m in messages if m.get_srcComponent() == 196]


# Streams and times


@check
def stream_of_a_program():
    """a program that writes y4m is a source; its rate is its own, its frames have the latency that was given"""
    words = ["ffmpeg", "-nostdin", "-v", "error", "-re", "-f", "lavfi", "-i", "testsrc=size=160x120:rate=20", "-vf",
             "setpts=N/15/TB,format=gray", "-r", "15", "-f", "yuv4mpegpipe", "-strict", "-1", "-"]
    with flying("stream.latency_ms = 80\n", source=f"{{ exec = {json.dumps(words)} }}", vehicle=False) as (net, run, _):
        active = lambda: [m for m in net.of("HEARTBEAT") if m.system_status == mavlink.MAV_STATE_ACTIVE]  # noqa: E731
        net.until(active, 20, "active")
        begun = time.time()
        time.sleep(5)
        seconds = time.time() - begun
        assert run.end() == 0
        log = run.log.read_text()
    frames = sum(int(found) for found in re.search(r"(\d+) frames looked at.*?(\d+) left out", log, re.S).groups())
    age = float(re.search(r"exposure to detector\s+([\d.]+)", log)[1])
    assert frames > seconds * 17.5 and 80 <= age < 300, (frames, seconds, age)
    return f"{frames} frames in {seconds:.0f} s under a header of 15 a second, {age} ms old"


@check
def no_stream_as_a_file():
    """a live thing never goes through the pacer of recorded files"""
    for source in ("file:-", "file:rtsp://127.0.0.1:1/x"):
        path = ROOT / "asfile.toml"
        path.write_text(f'source = "{source}"\n')
        out, err = lookout("run", "--config", path, ok=False, stdin=subprocess.DEVNULL)
        assert "plays recordings" in err, err
    return "file:- and file:rtsp:// are refused with the way out"


@check
def look_at_a_source():
    """doctor --source: one picture, size, rate, jitter; why it cannot"""
    out, _ = lookout("doctor", "--source", f"file:{hover()}", "--seconds", "2")
    assert "320x240" in out and "frames a second" in out and "jitter" in out and out.count("\n") > 20, out
    _, err = lookout("doctor", "--source", "v4l2:/dev/video-nosuch", "--seconds", "1", ok=False)
    assert "No such file" in err or "no such" in err, err
    return out.splitlines()[1].strip()


@check
def variable_rate():
    """a browser's recording keeps its frames and their times"""
    video = ROOT / "browser.webm"
    ffmpeg("-f", "lavfi", "-i", "testsrc=size=160x120:rate=1000:duration=0.04", "-vf",
           "setpts='(N*40+10*mod(N,2))/1000/TB'", "-vsync", "passthrough", "-c:v", "libvpx", video)
    times = [line["time_us"] for line in replayed(video)]
    wanted = [(n * 40 + 10 * (n % 2)) * 1000 for n in range(40)]
    assert len(times) == 40, f"{len(times)} frames"
    assert max(abs(a - b) for a, b in zip(times, wanted)) <= 1000, times
    return "40 frames, each within 1 ms"


@check
def folder_with_a_rate():
    """a folder takes its rate from camera.json or --fps"""
    flight = hover()
    assert json.loads((flight / "camera.json").read_text())["fps"] == 15
    times = [line["time_us"] for line in replayed(flight)]
    assert abs(times[15] - 1_000_000) < 10, times[:16]
    return "15 frames a second"


@check
def interlaced():
    """interlaced video is split into fields"""
    video = ROOT / "interlaced.y4m"
    # Rows of the later field are black: no comb may be left.
    ffmpeg("-f", "lavfi", "-i", "color=c=white:size=160x120:rate=25:duration=0.2", "-vf",
           "geq=lum='if(mod(Y,2),16,235)':cb=128:cr=128,setfield=tff,format=yuv420p", "-f", "yuv4mpegpipe", video)
    header = video.read_bytes().split(b"\n", 1)[0]
    assert b" It" in header, header
    pictures = ROOT / "interlaced"
    lookout("replay", video, "--annotate", pictures)
    grey = ROOT / "interlaced.raw"
    ffmpeg("-i", sorted(pictures.glob("*.png"))[0], "-pix_fmt", "gray", "-f", "rawvideo", grey)
    pixels = grey.read_bytes()
    column = pixels[80::160][40:80]
    assert max(column) - min(column) < 10, list(column)
    return "one field a frame, no comb"


@check
def joined_between_key_frames():
    """H.264 that was joined between key frames gives what can be decoded, with a warning"""
    whole, joined = ROOT / "whole.h264", ROOT / "joined.h264"
    ffmpeg("-f", "lavfi", "-i", "testsrc=size=160x120:rate=25:duration=2", "-c:v", "libx264", "-g", "20", "-bf", "0", "-f", "h264", whole)
    data = whole.read_bytes()
    slices = [at.start() for at in re.finditer(rb"\x00\x00\x01", data) if data[at.end()] & 31 == 1]
    joined.write_bytes(data[slices[9]:])
    _, err = lookout("replay", joined)
    assert "between key frames" in err and "30 frames" in err, err
    return "30 of the 50 frames"


@check
def samples_of_more_bits():
    """10-bit y4m, 16-bit grey and 4:1:1 are read"""
    for form in ("yuv420p10le", "gray16le", "yuv411p"):
        video = ROOT / f"{form}.y4m"
        ffmpeg("-f", "lavfi", "-i", "testsrc=size=160x120:rate=25:duration=0.2", "-pix_fmt", form, "-strict", "-1", "-f", "yuv4mpegpipe", video)
        assert len(replayed(video)) == 5
    return "yuv420p10le, gray16le, yuv411p"


@check
def names_and_marks():
    """names that are no UTF-8, byte-order marks"""
    video = os.fsencode(ROOT) + b"/caf\xe9.mp4"
    ffmpeg("-f", "lavfi", "-i", "testsrc=size=160x120:rate=25:duration=0.2", video)
    assert subprocess.run([os.fsencode(LOOKOUT), b"replay", video], capture_output=True).returncode == 0
    settings = ROOT / "mark.toml"
    settings.write_bytes(b"\xef\xbb\xbf" + b'source = "simulate:hover"\nlinks = ["udpin:127.0.0.1:24999"]\n')
    lookout("run", "--config", settings, "--print-config")
    return "caf\\xe9.mp4; settings with a mark"


@check
def frames_too_large_for_the_machine():
    """one plain advice, not "no frames" and "watching" in turn"""
    video = made("large.y4m", lambda path: ffmpeg("-f", "lavfi", "-i", "testsrc=size=4000x3000:rate=30:duration=0.3", "-pix_fmt", "gray",
                                                  "-strict", "-1", "-f", "yuv4mpegpipe", path))
    with flying(source=f'"file:{video}"\nrepeat = true', vehicle=False) as (net, run, _):
        run.said("would keep up", 60)
        begun = time.time()
        time.sleep(15)
        turns = len(re.findall("(no frames|no pictures|watching for traffic)", run.log.read_text()))
        states = [m.system_status for m in net.of("HEARTBEAT", begun)]
    changes = sum(a != b for a, b in zip(states, states[1:]))
    assert turns <= 2 and changes <= 1, (turns, states)
    advice = re.findall(r"WARN .*?: (.*would keep up.*)", run.log.read_text())
    assert len(advice) == 1, advice
    return advice[0]


# Geometry


def calibration(name, text):
    path = ROOT / name
    path.write_text(text)
    return path


def ros(model, coefficients, key="distortion_model", size=(320, 240), factor=1.0):
    numbers = [str(250 * factor), "0", str(size[0] / 2), "0", str(250 * factor), str(size[1] / 2), "0", "0", "1"]
    return (f"image_width: {size[0]}\nimage_height: {size[1]}\n{key}: {model}\n"
            f"camera_matrix: {{rows: 3, cols: 3, data: [{', '.join(numbers)}]}}\n"
            f"distortion_coefficients: {{rows: 1, cols: {len(coefficients)}, data: {coefficients}}}\n")


def azimuths(camera):
    """Directions of the tracks of the hovering object with a calibration."""
    flight = ROOT / f"with-{camera.stem}"
    if not flight.exists():
        flight.mkdir()
        shutil.copytree(hover() / "frames", flight / "frames")
    with tempfile.NamedTemporaryFile(suffix=".jsonl") as file:
        lookout("replay", flight, "--camera", camera, "--jsonl", file.name)
        lines = [json.loads(line) for line in open(file.name)]
    return [part for line in lines for track in line["tracks"] if track["confirmed"] for part in track["body"]]


@check
def fisheye_under_its_names():
    """a fisheye is one under every spelling, and never read as something else"""
    found = {}
    for key, model in (("distortion_model", "fisheye"), ("distortion_model", "equidistant"), ("camera_model", "fisheye"), ("fisheye_model", "1")):
        path = calibration(f"{key}-{model}.yaml", ros(model, [-0.02, 0.01, -0.005, 0.001], key))
        found[key, model] = azimuths(path)
    assert all(found.values()) and len({tuple(a) for a in found.values()}) == 1, {k: v[:2] for k, v in found.items()}
    return f"{len(found)} spellings, the same {len(found['distortion_model', 'fisheye'])} directions"


@check
def calibrations_of_many_tools():
    """rational_polynomial, 12 and 14 coefficients, Kalibr, ros2 topic echo, half and double size"""
    many = [0.05, -0.02, 0.001, -0.002, 0.005, 0.08, -0.01, 0.003, 0.001, 0.0, 0.001, 0.0, 0.002, 0.003]
    plain = [-0.03, 0.01, 0.001, -0.002, 0.0]
    matrix = "[250.0, 0.0, 160.0, 0.0, 250.0, 120.0, 0.0, 0.0, 1.0]"
    wanted = azimuths(calibration("plain.yaml", ros("plumb_bob", plain)))
    same = {
        "kalibr": "cam0:\n  camera_model: pinhole\n  distortion_coeffs: [-0.03, 0.01, 0.001, -0.002]\n  distortion_model: radtan\n"
                  "  intrinsics: [250.0, 250.0, 160.0, 120.0]\n  resolution: [320, 240]\n",
        "echo": f"height: 240\nwidth: 320\ndistortion_model: plumb_bob\nd: {plain}\nk: {matrix}\nbinning_x: 0\n---\n",
        "double": ros("plumb_bob", plain, size=(640, 480), factor=2.0),
    }
    for name, text in same.items():
        found = azimuths(calibration(f"{name}.yaml", text))
        assert len(found) == len(wanted) and max(abs(a - b) for a, b in zip(found, wanted)) < 2e-3, (name, found[:2], wanted[:2])
    for count in (8, 12, 14):
        assert azimuths(calibration(f"many{count}.yaml", ros("rational_polynomial", many[:count])))
    return f"{', '.join(same)}, 8, 12 and 14 coefficients"


@check
def rare_attitudes():
    """attitudes three times a second keep the traffic; what is lost is said"""
    flight, counts = collision(), {}
    records = read_tlog(flight / "flight.tlog")
    for rate in (1000, 3):
        thinned, out, last = ROOT / f"rate{rate}.tlog", ROOT / f"rate{rate}.out.tlog", 0
        with open(thinned, "wb") as file:
            for time_us, frame in records:
                number = int.from_bytes(frame[7:10], "little")
                if number == 31:
                    if time_us - last < 1e6 / rate:
                        continue
                    last = time_us
                # The angles would come where the quaternion does not.
                if number != 30:
                    file.write(struct.pack(">Q", time_us) + frame)
        lookout("replay", flight, "--tlog-in", thinned, "--tlog-out", out)
        counts[rate] = sum(int.from_bytes(frame[7:10], "little") == 246 for _, frame in read_tlog(out))
    assert counts[1000] >= 3 and counts[3] >= counts[1000] * 0.8, counts
    return f"ADSB_VEHICLE: {counts[1000]} with all attitudes, {counts[3]} with 3 a second"


def read_tlog(path):
    """Times in microseconds and frames of a log of MAVLink 2 without signatures."""
    data, at, records = path.read_bytes(), 0, []
    while at < len(data):
        length = data[at + 9] + 12
        records.append((struct.unpack_from(">Q", data, at)[0], data[at + 8:at + 8 + length]))
        at += 8 + length
    return records


@check
def camera_on_a_gimbal():
    """camera.gimbal: positions by GIMBAL_DEVICE_ATTITUDE_STATUS, none without, and that is said"""
    with flying("camera.gimbal = true\n") as (net, _, vehicle):
        gimbal, half, nan, on = net.speaker(1, 154), math.sqrt(0.5), math.nan, [True]
        send = gimbal.gimbal_device_attitude_status_send
        boot = lambda: int((time.time() - vehicle.start) * 1000) + 5000  # noqa: E731
        north = mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME
        net.again(lambda: on[0] and send(0, 0, boot(), north, [half, 0, 0, half], nan, nan, nan, 0, nan, nan, 1), 0.1)
        report = net.until(lambda: net.of("ADSB_VEHICLE"), 60, "traffic")[-1]
        bearing = math.degrees(math.atan2((report.lon - LONGITUDE) * math.cos(math.radians(47.4)), report.lat - LATITUDE))
        assert abs(bearing - 90) < 40, bearing
        on[0], gone = False, time.time()
        net.text("gimbal silent", 10, gone)
        late = net.of("ADSB_VEHICLE", gone + 1)
        assert not late, late
    return f"traffic at {bearing:.0f} degrees while the gimbal looks east, none while it is silent"


# Vehicles


@check
def no_gimbal_or_station_as_vehicle():
    """a gimbal and a station with GENERIC are no vehicle; one with GENERIC is"""
    with flying(vehicle=False) as (net, _, __):
        speakers = [(net.speaker(7, 154), mavlink.MAV_TYPE_GIMBAL), (net.speaker(255, 190), mavlink.MAV_TYPE_GCS),
                    (net.speaker(7, 100), mavlink.MAV_TYPE_CAMERA), (net.speaker(7, 191), mavlink.MAV_TYPE_ONBOARD_CONTROLLER)]
        net.again(lambda: [s.heartbeat_send(kind, GENERIC, 0, 0, 4) for s, kind in speakers], 0.5)
        time.sleep(3)
        asked = net.of("COMMAND_LONG")
        assert not asked, f"taken for the vehicle: asked {asked[0].target_system}/{asked[0].target_component}"
        Vehicle(net, system=9, kind=1, autopilot=GENERIC)
        net.until(lambda: [m for m in net.of("HEARTBEAT") if m.get_srcSystem() == 9], 10, "served: system 9")
    return "four refused, the vehicle with GENERIC is served"


@check
def the_one_it_served_comes_back():
    """a silence of the vehicle does not make another one its own for good"""
    with flying() as (net, _, home):
        beat = lambda system, since: [m for m in net.of("HEARTBEAT", since) if m.get_srcSystem() == system]  # noqa: E731
        net.until(lambda: beat(1, 0), 10, "system 1")
        time.sleep(1)
        home.on = False
        other = Vehicle(net, system=2)
        time.sleep(5)
        home.on, back = True, time.time()
        net.until(lambda: beat(1, back), 6, "system 1 is served again")
        time.sleep(2)
        assert not beat(2, time.time() - 1), "two served"
        other.on = False
    return "home again within 6 s"


@check
def autopilot_gone():
    """log, text, page and heartbeat say within 3 s that the autopilot is gone, and that it is back"""
    page = free_port()
    with flying(f'preview = "127.0.0.1:{page}"\n') as (net, run, vehicle):
        state = lambda: json.load(urllib.request.urlopen(f"http://127.0.0.1:{page}/state.json", timeout=5))  # noqa: E731
        net.until(lambda: state()["autopilot"], 20, "autopilot on the page")
        time.sleep(1)
        vehicle.on, gone = False, time.time()
        net.text("autopilot lost", 3.5, gone)
        took = time.time() - gone
        assert took < 3.2, took
        net.until(lambda: [m for m in lookouts(net.of("HEARTBEAT", gone)) if m.system_status == 5], 2, "state")
        net.until(lambda: state().get("autopilot_lost") is True, 1, "page")
        run.said("autopilot lost", 1)
        vehicle.on, back = True, time.time()
        net.text("autopilot is back", 4, back)
        net.until(lambda: state().get("autopilot_lost") is False, 1, "page")
        run.said("autopilot is back", 1)
    return f"after {took:.1f} s"


@check
def drones_by_emitter():
    """the emitter says UAV, or what traffic.assume says, with ids to match"""
    with flying() as (net, _, __):
        found = net.until(lambda: net.of("ADSB_VEHICLE"), 60, "traffic")[0]
        assert found.emitter_type == mavlink.ADSB_EMITTER_TYPE_UAV and found.ICAO_address <= 0xBFFF, found
    with flying('traffic.assume = "aircraft"\n') as (net, _, __):
        aircraft = net.until(lambda: net.of("ADSB_VEHICLE"), 60, "traffic")[0]
        assert aircraft.emitter_type == mavlink.ADSB_EMITTER_TYPE_LIGHT and aircraft.ICAO_address > 0xBFFF, aircraft
    return f"ids {found.ICAO_address:#x} and {aircraft.ICAO_address:#x}"


@check
def two_lookouts():
    """two lookouts on one vehicle have different ids and callsigns"""
    names = []
    for component in (196, 197):
        with flying(f"component_id = {component}\n") as (net, _, __):
            found = net.until(lambda: net.of("ADSB_VEHICLE"), 60, "traffic")[0]
            names.append((found.ICAO_address, found.callsign))
    (id1, name1), (id2, name2) = names
    assert id1 != id2 and name1 != name2, names
    return str(names)


@check
def type_of_the_heartbeat():
    """the heartbeat's type is settable for PX4's traffic check"""
    with flying('heartbeat_type = "adsb"\n', vehicle=False) as (net, _, __):
        assert net.of("HEARTBEAT")[0].type == mavlink.MAV_TYPE_ADSB
    return "ADSB"


@check
def callsign_of_an_aircraft_and_fleet():
    """a track takes the callsign of an ADSB_VEHICLE in its direction; the own fleet is muted"""
    results = []
    for fleet in ("", 'traffic.fleet = ["SWR12"]\n'):
        with flying(fleet) as (net, _, vehicle):
            first = net.until(lambda: net.of("ADSB_VEHICLE"), 60, "traffic")[0]
            flags = 1 | 2 | 4 | 8 | 16 | 256
            net.again(lambda: vehicle.mav.adsb_vehicle_send(0x4B1A2C, first.lat, first.lon, 1, first.altitude, 0, 0, 0,
                                                            flags=flags, squawk=0, callsign=b"SWR12", emitter_type=1, tslc=0), 0.5)
            if fleet:
                time.sleep(3)
                quiet = time.time()
                time.sleep(3)
                assert not lookouts(net.of("ADSB_VEHICLE", quiet)), "the fleet is reported"
                results.append("muted")
            else:
                named = lambda: [m for m in lookouts(net.of("ADSB_VEHICLE")) if m.callsign == "SWR12"]  # noqa: E731
                net.until(named, 10, "SWR12")
                results.append(f"{first.callsign} became SWR12")
    return ", ".join(results)


@check
def answers_to_clients():
    """files, missions and unknown parameters are answered"""
    with flying() as (net, _, __):
        net.until(lambda: [m for m in net.of("HEARTBEAT") if m.get_srcSystem() == 1], 10, "system 1")
        station = net.speaker(255, 190)
        payload = bytearray(251)
        payload[3], payload[4] = 4, 1
        station.file_transfer_protocol_send(0, 1, 196, payload)
        station.mission_request_list_send(1, 196, 0)
        station.param_request_read_send(1, 196, b"NO_SUCH_NAME", -1)
        net.until(lambda: net.of("FILE_TRANSFER_PROTOCOL"), 3, "file")
        net.until(lambda: net.of("MISSION_COUNT"), 3, "mission")
        net.until(lambda: [m for _, m in net.heard if m.get_msgId() == 345], 3, "parameter")
    return "FILE_TRANSFER_PROTOCOL, MISSION_COUNT, PARAM_ERROR"


@check
def parameters_by_the_program():
    """lookout params get and set"""
    port = free_port()
    folder = pathlib.Path(tempfile.mkdtemp(dir=ROOT))
    run = Run(folder, f'source = "simulate:hover"\nrepeat = true\nthreads = 1\nlinks = ["udpin:127.0.0.1:{port}"]\n')
    try:
        link = f"--link=udpout:127.0.0.1:{port}"
        time.sleep(1)
        # The service may start late where other checks take the processors.
        lookout("params", "set", "LK_WINGSPAN", "2.5", link, "--seconds=30")
        out, _ = lookout("params", "get", link)
        assert "LK_WINGSPAN 2.5" in out and len(out.splitlines()) >= 12, out
        _, err = lookout("params", "get", "LK_NOSUCH", link, ok=False)
        assert "LK_NOSUCH" in err, err
    finally:
        run.end()
    return f"{len(out.splitlines())} parameters"


@check
def doctor_reads_more_parameters():
    """doctor reads AVD_WCLR_*, AVD_NMAC_*, ADSB_TYPE, SCR_ENABLE"""
    net = Net()
    values = {"ADSB_TYPE": 1, "AVD_ENABLE": 1, "SCR_ENABLE": 0, "AVD_WCLR_XY": 609.6, "AVD_WCLR_Z": 76.2, "AVD_NMAC_XY": 152.4, "AVD_NMAC_Z": 30.5}
    vehicle, answered = Vehicle(net, kind=1), set()

    def answer():
        for _, m in list(net.heard):
            if m.get_type() == "PARAM_REQUEST_READ" and m.param_id in values and (m.param_id, m.get_seq()) not in answered:
                answered.add((m.param_id, m.get_seq()))
                vehicle.mav.param_value_send(m.param_id.encode(), values[m.param_id], 9, 900, 1)

    net.again(answer, 0.02)
    out, err = lookout("doctor", "--link", net.link, "--seconds", "4", ok=None)
    net.close()
    missing = [name for name in values if name not in out]
    assert not missing, f"{missing} not in {out}{err}"
    return f"{len(values)} parameters"


@check
def why_a_port_cannot_be_opened():
    """doctor gives the system's reason and what to do"""
    _, err = lookout("doctor", "--link", "serial:/dev/nosuch:57600", "--seconds", "1", ok=False)
    assert "No such file" in err and "plugged in" in err, err
    _, refused = lookout("doctor", "--link", f"tcpout:127.0.0.1:{free_port()}", "--seconds", "1", ok=False)
    assert "refused" in refused, refused
    return err.strip().splitlines()[-1]


@check
def all_faults_of_the_settings():
    """run --print-config checks every file that it names; nothing to do is said"""
    path = ROOT / "bad.toml"
    path.write_text('source = "v4l2:/dev/video-nosuch"\nlinks = ["serial:/dev/nosuch:57600"]\nmodel = "/nope/model.lkm"\n'
                    'signing_key = "/nope/key"\nparameters = "/nope/dir/p.txt"\nevent_log = "/dev/null/ev"\ncamera.calibration = "/nope/camera.yaml"\n')
    out, err = lookout("run", "--config", path, "--print-config", ok=None)
    text = out + err
    wanted = ["/nope/model.lkm", "/nope/key", "/nope/dir", "/dev/null", "/nope/camera.yaml", "/dev/nosuch"]
    # Each stands in the settings that are printed, and once more in what is wrong with them.
    missing = [name for name in wanted if sum(name in line for line in err.splitlines()) < 1]
    assert not missing, (missing, err)
    path.write_text('source = "simulate:hover"\n')
    _, idle = lookout("run", "--config", path, "--print-config", ok=None)
    assert "nothing to do" in idle, idle
    return f"{len(wanted)} faults at once"


@check
def log_with_a_clock_that_jumps():
    """a clock that jumps back keeps the rest of a tlog; another byte order is refused"""
    flight = collision()
    records = read_tlog(flight / "flight.tlog")
    texts = {}
    for name, step in (("steady", 0), ("jumps", -3_600_000_000)):
        log, out = ROOT / f"{name}.tlog", ROOT / f"{name}.out.tlog"
        with open(log, "wb") as file:
            for number, (time_us, frame) in enumerate(records):
                file.write(struct.pack(">Q", time_us + (step if number > len(records) // 3 else 0)) + frame)
        lookout("replay", flight, "--tlog-in", log, "--tlog-out", out)
        texts[name] = [frame[11:].rstrip(b"\0")[:40] for _, frame in read_tlog(out) if frame[7] == 253]
    assert texts["steady"] and texts["jumps"] == texts["steady"], texts
    swapped = ROOT / "swapped.tlog"
    swapped.write_bytes(b"".join(struct.pack("<Q", time_us) + frame for time_us, frame in records))
    _, err = lookout("replay", flight, "--tlog-in", swapped, ok=False)
    assert "little-endian" in err, err
    return f"{len(texts['jumps'])} texts in both"


# Page, station, pictures


@check
def link_without_an_answer():
    """a link that nobody answers is not up; a missing autopilot stands out; BlueOS finds the page"""
    page = free_port()
    with flying(f'preview = "127.0.0.1:{page}"\n', vehicle=False) as (net, _, __):
        get = lambda path: urllib.request.urlopen(f"http://127.0.0.1:{page}{path}", timeout=5)  # noqa: E731
        time.sleep(2)
        state = json.load(get("/state.json"))
        link = state["links"][0]
        # A field of its own in the program of a9acc21.
        assert link.get("state") not in ("up", None) or link.get("up") is False, link
        assert "LK_WINGSPAN" in [parameter["name"] for parameter in state["parameters"]], state["parameters"]
        service = json.load(get("/register_service"))
        assert service["name"] and service["api"] is not None, service
        html = get("/").read().decode()
        assert "No autopilot heard" in html
    return f"{link['state']}; /register_service: {service['name']}"


@check
def colour_and_words():
    """replay --annotate keeps colour; directions have a side, scores a unit; progress without a terminal"""
    flight = collision()
    # A tint over the flight: the pictures must have it.
    video = ROOT / "tinted.mp4"
    ffmpeg("-framerate", "30", "-pattern_type", "glob", "-i", flight / "frames" / "*.png", "-vf",
           "format=yuv420p,geq=lum='lum(X,Y)':cb=100:cr=170", "-c:v", "libx264", "-crf", "10", video)
    pictures, small = ROOT / "tinted", ROOT / "tinted.raw"
    out, err = lookout("replay", video, "--annotate", pictures, "--camera", flight / "camera.json")
    ffmpeg("-i", sorted(pictures.glob("*.png"))[0], "-pix_fmt", "rgb24", "-f", "rawvideo", small)
    pixels = small.read_bytes()
    middle = len(pixels) // 6 * 3
    spread = max(pixels[middle:middle + 3]) - min(pixels[middle:middle + 3])
    assert spread > 20, f"grey: {list(pixels[middle:middle + 3])}"
    out2, err2 = lookout("replay", flight)
    text = out + err + out2 + err2
    assert "(log-odds)" in text, text[:400]
    assert not re.search(r"-\d[\d.]* degrees (right|left)", text), "a negative angle to a side"
    assert "not looked at" not in text
    return f"colours {spread} apart"


@check
def progress_in_a_log():
    """a replay says how far it is where there is no terminal"""
    video = ROOT / "long.mp4"
    ffmpeg("-f", "lavfi", "-i", "testsrc2=size=1920x1080:rate=30:duration=7", "-preset", "ultrafast", video)
    _, err = lookout("replay", video, "--threads", "1")
    lines = [line for line in err.splitlines() if re.search(r"frame \d+.*frames a second", line)]
    assert lines, err[-300:]
    return lines[0].strip()


def run_check(function):
    start = time.time()
    try:
        result, failed = function(), False
    except Exception as error:
        result, failed = f"FAILED: {type(error).__name__}: {str(error)[:600]}", True
    print(f"{function.__name__}: {result} ({time.time() - start:.1f} s)", flush=True)
    return failed


if __name__ == "__main__":
    chosen = [f for f in CHECKS if not sys.argv[2:] or f.__name__ in sys.argv[2:]]
    with concurrent.futures.ThreadPoolExecutor(int(os.environ.get("LOOKOUT_JOBS", "2"))) as pool:
        failed = sum(pool.map(run_check, chosen))
    shutil.rmtree(ROOT, ignore_errors=True)
    print(f"users: {len(chosen) - failed} of {len(chosen)} hold", flush=True)
    os._exit(failed > 0)
