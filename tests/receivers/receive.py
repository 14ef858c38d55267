"""What the lookout says, as independent receivers hear it: pymavlink and MAVSDK.

    python receive.py LOOKOUT

LOOKOUT is the program. Ends with a line for every check; the exit status says whether all held.
"""

import json
import math
import os
import select
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
import tty

os.environ["MAVLINK20"] = "1"
from pymavlink import mavutil  # noqa: E402
from pymavlink.dialects.v20 import ardupilotmega as mavlink  # noqa: E402

LOOKOUT = os.path.abspath(sys.argv[1])
FLIGHT = ["--kind", "collision", "--seed", "1"]
REPLAY = ["replay", "--simulate", "collision", "--seed", "1"]
START = 1767225600.0  # the first frame of a simulated flight
US, COMPONENT, STATION = 1, 196, 255
folder = tempfile.TemporaryDirectory()


def path(name):
    return os.path.join(folder.name, name)


def lookout(*words, **options):
    return subprocess.Popen([LOOKOUT, *words], stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True, **options)


def finished(process):
    out, err = process.communicate(timeout=80)
    assert process.returncode == 0, err
    return out


def read_log(name):
    """Every message of a log, as MAVExplorer reads it; a byte that is no message fails."""
    log = mavutil.mavlink_connection(name)
    messages = []
    while (message := log.recv_msg()) is not None:
        assert message.get_type() != "BAD_DATA", message
        messages.append(message)
    return messages


def of(messages, *types):
    return [m for m in messages if m.get_type() in types]


def texts(messages):
    return [m.text for m in of(messages, "STATUSTEXT")]


def check_log():
    """A whole encounter in a log: decodes to the last byte, order, rates, fields, units."""
    name = path("out.tlog")
    finished(lookout(*REPLAY, "--tlog-out", name))
    messages = read_log(name)
    assert sum(8 + len(m.get_msgbuf()) for m in messages) == os.path.getsize(name)
    times = [m._timestamp for m in messages]
    assert times == sorted(times) and START <= times[0] < START + 0.2, times[0]
    assert all(m.get_srcSystem() == US and m.get_srcComponent() == COMPONENT for m in messages)
    sequence = [m.get_seq() for m in messages]
    assert all((b - a) % 256 == 1 for a, b in zip(sequence, sequence[1:]))

    beats = of(messages, "HEARTBEAT")
    assert all(m.type == 18 and m.autopilot == 8 and m.base_mode == 0 for m in beats)
    assert 5 <= len(beats) <= 7 and beats[-1].system_status == mavlink.MAV_STATE_ACTIVE, len(beats)

    # How far it rises is the model's; that it only rises is not.
    alerts = [m for m in of(messages, "STATUSTEXT") if "VIS" in m.text]
    severities = [m.severity for m in alerts]
    assert len(severities) >= 2 and severities[-1] <= mavlink.MAV_SEVERITY_WARNING, texts(messages)
    assert severities == sorted(set(severities), reverse=True), severities

    vehicles = of(messages, "ADSB_VEHICLE")
    assert len({m.ICAO_address for m in vehicles}) == 1 and 0x100 <= vehicles[0].ICAO_address <= 0x3FFF
    flown = read_flight("flight.tlog")
    for m in vehicles:
        own = min(of(flown, "GLOBAL_POSITION_INT"), key=lambda o: abs(o._timestamp - m._timestamp))
        truth = truth_at(m._timestamp - START)
        north = (m.lat - own.lat) * 1e-7 * 111319.49
        east = (m.lon - own.lon) * 1e-7 * 111319.49 * math.cos(math.radians(own.lat * 1e-7))
        down = (own.alt - m.altitude) / 1000
        azimuth = math.atan2(east, north)
        elevation = math.atan2(down, math.hypot(north, east))
        off = math.hypot(wrap(azimuth - truth["azimuth_rad"]), elevation - truth["elevation_rad"])
        assert math.degrees(off) < 3, (math.degrees(off), m)
        assert m.altitude_type == mavlink.ADSB_ALTITUDE_TYPE_GEOMETRIC and m.tslc <= 1, m
        assert m.flags & 0b11 == 0b11 and m.callsign.startswith("VIS"), m
    span = vehicles[-1]._timestamp - vehicles[0]._timestamp
    rate = (len(vehicles) - 1) / span
    assert 1.8 <= rate <= 2.2, rate

    collisions = of(messages, "COLLISION")
    assert collisions and all(m.id == vehicles[0].ICAO_address and m.src == 0 for m in collisions)
    assert not of(messages, "OBSTACLE_DISTANCE", "OBSTACLE_DISTANCE_3D"), "off by default"
    alert = alerts[-1]._timestamp - START
    contact = truth_at(alert)["time_to_contact_s"]
    return f"{len(messages)} messages, '{alerts[-1].text}' {contact:.1f} s before contact"


def wrap(angle):
    return (angle + math.pi) % (2 * math.pi) - math.pi


def read_flight(name):
    return read_log(os.path.join(path("flight"), name))


def truth_at(seconds):
    with open(os.path.join(path("flight"), "truth.csv")) as file:
        names = file.readline().strip().split(",")
        rows = [dict(zip(names, map(float, line.strip().split(",")))) for line in file]
    return min(rows, key=lambda row: abs(row["time_s"] - seconds))


def check_flight():
    """The simulated vehicle's telemetry, as pymavlink reads it."""
    finished(lookout("simulate", *FLIGHT, "--out", path("flight")))
    messages = read_flight("flight.tlog")
    for quaternion, truth in ((m, truth_at(m._timestamp - START)) for m in of(messages, "ATTITUDE")):
        if abs(quaternion._timestamp - START - truth["time_s"]) < 1e-3:
            for field in ("yaw", "pitch", "roll"):
                assert abs(getattr(quaternion, field) - truth[field + "_rad"]) < 2e-3, (quaternion, truth)
    return f"{len(messages)} messages"


def check_foreign_log():
    """A log that pymavlink wrote, with both versions of MAVLink and a damaged place, replays with the same warnings."""
    with open(path("foreign.tlog"), "wb") as file:
        v2, v1 = mavlink.MAVLink(None, 1, 1), mavlink.MAVLink(None, 1, 1)
        for number, m in enumerate(read_flight("flight.tlog")):
            old = m.get_type() == "ATTITUDE"
            packed = m.pack(v1 if old else v2, force_mavlink1=old)
            # Lowest two bits: MAVProxy's number of the link.
            file.write(struct.pack(">Q", int(m._timestamp * 1e6) & ~3 | 1) + packed)
            if number == 40:
                file.write(b"\xfd\x09\xfeno message" * 20)
    finished(lookout("replay", path("flight"), "--tlog-in", path("foreign.tlog"), "--tlog-out", path("again.tlog")))
    first, again = texts(read_log(path("out.tlog"))), texts(read_log(path("again.tlog")))
    assert first == again, (first, again)
    # Another place in the log: the attitudes do not fit the pictures, and nothing of it is in the past.
    late = ["--tlog-in", path("foreign.tlog"), "--tlog-start", "-2", "--tlog-out", path("late.tlog")]
    finished(lookout("replay", path("flight"), *late))
    beats = of(read_log(path("late.tlog")), "HEARTBEAT")
    assert beats[0]._timestamp >= START - 2 - 0.001, beats[0]._timestamp
    return f"texts: {again}"


class Station:
    """A ground station on UDP: hears everything, and can ask."""

    def __init__(self, port, key=None):
        self.link = mavutil.mavlink_connection(f"udpin:127.0.0.1:{port}", source_system=STATION, dialect="ardupilotmega")
        if key:
            self.link.setup_signing(key, sign_outgoing=True, allow_unsigned_callback=lambda *_: False)
        self.heard = []

    def until(self, condition, seconds):
        end = time.time() + seconds
        while time.time() < end:
            m = self.link.recv_match(blocking=True, timeout=0.2)
            if m is None:
                continue
            assert m.get_type() != "BAD_DATA", m
            self.heard.append(m)
            if condition(m):
                return m
        return None


def port():
    port.next += 1
    return port.next


port.next = 24500 + os.getpid() % 1000 * 8


def check_services():
    """Commands and parameters, asked for while a flight is replayed in real time."""
    place = port()
    station = Station(place)
    flight = lookout(*REPLAY, "--link", f"udpout:127.0.0.1:{place}")
    mav = station.link.mav
    assert station.until(lambda m: m.get_type() == "HEARTBEAT" and m.get_srcSystem() == US, 30)
    mav.param_request_list_send(US, COMPONENT)
    found = {}

    def collect(m):
        if m.get_type() == "PARAM_VALUE":
            found[m.param_id] = (m.param_value, m.param_count)
        return found and len(found) == next(iter(found.values()))[1]

    assert station.until(collect, 5), found
    assert found["LK_PROXIMITY"][0] == 0, found
    mav.param_set_send(US, COMPONENT, b"LK_WINGSPAN", 2.5, mavlink.MAV_PARAM_TYPE_REAL32)
    echo = station.until(lambda m: m.get_type() == "PARAM_VALUE" and m.param_id == "LK_WINGSPAN", 3)
    assert echo and echo.param_value == 2.5, echo
    mav.command_long_send(US, COMPONENT, mavlink.MAV_CMD_REQUEST_MESSAGE, 0, 148, 0, 0, 0, 0, 0, 0)
    assert station.until(lambda m: m.get_type() == "AUTOPILOT_VERSION", 3)
    mav.command_long_send(US, COMPONENT, mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 0, 0)
    ack = station.until(lambda m: m.get_type() == "COMMAND_ACK" and m.command == mavlink.MAV_CMD_NAV_TAKEOFF, 3)
    assert ack.result == mavlink.MAV_RESULT_UNSUPPORTED and ack.target_system == STATION, ack
    asked = time.time_ns()
    mav.timesync_send(0, asked)
    answer = station.until(lambda m: m.get_type() == "TIMESYNC" and m.ts1 == asked, 3)
    assert answer and answer.tc1 > 0, answer
    mav.command_long_send(US, COMPONENT, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 0, 251, 200_000, 0, 0, 0, 0, 0)
    ack = station.until(lambda m: m.get_type() == "COMMAND_ACK" and m.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 3)
    assert ack.result == mavlink.MAV_RESULT_ACCEPTED, ack
    before = len(station.heard)

    def boots():
        named = of(station.heard[before:], "NAMED_VALUE_FLOAT")
        return [m.time_boot_ms for m in named if m.name == "LK_FPS"]

    # By the lookout's own clock: a machine that is slower than the flight stretches the time of the wall.
    assert station.until(lambda _: len(boots()) == 5, 15), boots()
    steps = [b - a for a, b in zip(boots()[1:], boots()[2:])]
    assert all(180 <= step <= 220 for step in steps), steps
    flight.kill()
    flight.wait()
    station.link.close()
    return f"{len(found)} parameters, LK_FPS every {steps} ms when asked for 200"


def check_signing():
    """With a key every frame is signed; who has none may not set parameters."""
    key = bytes(range(32))
    with open(path("key"), "w") as file:
        file.write(key.hex())
    os.chmod(path("key"), 0o600)
    place = port()
    station = Station(place, key)
    flight = lookout(*REPLAY, "--link", f"udpout:127.0.0.1:{place}", "--signing-key", path("key"))
    first = station.until(lambda m: m.get_type() == "HEARTBEAT", 30)
    assert first and first.get_signed(), first
    mav = station.link.mav

    def wingspan(m):
        return m.get_type() == "PARAM_VALUE" and m.param_id == "LK_WINGSPAN" and m.param_value

    # Unsigned and wrongly signed: no echo of the new value. These share the socket, not the key.
    for wrong in (None, bytes(range(1, 33))):
        other = mavlink.MAVLink(station.link, STATION, 1)
        other.signing.secret_key, other.signing.sign_outgoing = wrong, wrong is not None
        other.signing.timestamp = mav.signing.timestamp + 1000
        other.param_set_send(US, COMPONENT, b"LK_WINGSPAN", 7.5, mavlink.MAV_PARAM_TYPE_REAL32)
        other.command_long_send(US, COMPONENT, mavlink.MAV_CMD_REQUEST_MESSAGE, 0, 148, 0, 0, 0, 0, 0, 0)
        taken = station.until(lambda m: wingspan(m) == 7.5 or m.get_type() == "AUTOPILOT_VERSION", 0.7)
        assert taken is None, taken
    mav.param_set_send(US, COMPONENT, b"LK_WINGSPAN", 3.5, mavlink.MAV_PARAM_TYPE_REAL32)
    assert station.until(lambda m: wingspan(m) == 3.5, 3)
    flight.kill()
    flight.wait()
    assert all(m.get_signed() for m in station.heard)
    station.link.close()
    # A board without a clock of its own: signatures go on from the time that was kept, here a day ahead.
    ahead = int(open(path("key") + ".time").readline()) + 24 * 3600 * 100_000
    with open(path("key") + ".time", "w") as file:
        file.write(str(ahead))
    place = port()
    receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    receiver.bind(("127.0.0.1", place))
    receiver.settimeout(30)
    flight = lookout(*REPLAY, "--link", f"udpout:127.0.0.1:{place}", "--signing-key", path("key"))
    stamp = int.from_bytes(receiver.recv(300)[-12:-6], "little")
    flight.kill()
    flight.wait()
    receiver.close()
    assert stamp >= ahead, (stamp, ahead)
    return f"{len(station.heard)} frames, all signed"


def check_serial():
    """The same bytes over a serial line: a pair of pseudo-terminals."""
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    flight = lookout(*REPLAY, "--link", f"serial:{os.ttyname(theirs)}:57600")
    parser = mavlink.MAVLink(None)
    heard, end = [], time.time() + 30
    while len(of(heard, "HEARTBEAT")) < 2 and time.time() < end:
        if select.select([ours], [], [], 0.2)[0]:
            heard += parser.parse_buffer(os.read(ours, 4096)) or []
    flight.kill()
    flight.wait()
    os.close(ours)
    os.close(theirs)
    assert not of(heard, "BAD_DATA"), heard
    assert len(of(heard, "HEARTBEAT")) == 2, heard
    return f"{len(heard)} messages"


def check_mavsdk():
    """A client application: sees the component, its state and its texts."""
    from mavsdk import Mavsdk, Configuration, ComponentType
    from mavsdk.plugins.mavlink_direct import MavlinkDirect
    from mavsdk.plugins.telemetry import Telemetry

    place = port()
    with Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION)) as sdk:
        sdk.add_any_connection(f"udpin://127.0.0.1:{place}")
        # The autopilot itself, on the same port.
        autopilot = mavutil.mavlink_connection(f"udpout:127.0.0.1:{place}", source_system=US, source_component=1)
        stop = threading.Event()

        def beat():
            while not stop.wait(0.5):
                autopilot.mav.heartbeat_send(2, 3, 0, 0, mavlink.MAV_STATE_ACTIVE)

        threading.Thread(target=beat, daemon=True).start()
        system = sdk.first_autopilot(10)
        assert system is not None, "no system"
        heard, states = [], []
        telemetry, direct = Telemetry(system), MavlinkDirect(system)
        telemetry.subscribe_status_text(lambda text, _: heard.append((text.type, text.text)))

        def state(message, _):
            if message.component_id == COMPONENT:
                states.append(json.loads(message.fields_json)["system_status"])

        direct.subscribe_message("HEARTBEAT", state)
        finished(lookout(*REPLAY, "--link", f"udpout:127.0.0.1:{place}"))
        time.sleep(0.3)
        stop.set()
        assert any(text.startswith(("Caution VIS", "WARNING VIS")) for _, text in heard), heard
        assert mavlink.MAV_STATE_ACTIVE in states, states
        telemetry.destroy()
        direct.destroy()
        return f"{len(heard)} texts, {len(states)} heartbeats"


def check_doctor():
    """The doctor's words about an autopilot that pymavlink plays, and about a silent link."""
    place = port()
    stop = threading.Event()
    parameters = {"ADSB_TYPE": 0, "AVD_ENABLE": 1, "PRX1_TYPE": 2, "AVOID_ENABLE": 7, "OA_TYPE": 0}

    def play():
        link = mavutil.mavlink_connection(f"udpout:127.0.0.1:{place}", source_system=7, source_component=1, dialect="ardupilotmega")
        mav, started, beats = link.mav, time.time(), 0
        while not stop.is_set():
            boot = int((time.time() - started) * 1000)
            if boot >= beats * 500:
                beats += 1
                mav.heartbeat_send(2, 3, 0, 0, 3)
                mav.system_time_send(int(time.time() * 1e6), boot)
            mav.attitude_quaternion_send(boot, 1, 0, 0, 0, 0, 0, 0)
            if boot // 20 % 10 == 0:
                mav.global_position_int_send(boot, 470000000, 80000000, 600000, 100000, 0, 0, 0, 0)
            m = link.recv_match(blocking=True, timeout=0.02)
            while m is not None:
                if m.get_type() == "PARAM_REQUEST_READ" and m.param_id in parameters:
                    mav.param_value_send(m.param_id.encode(), parameters[m.param_id], 2, 900, 1)
                if m.get_type() == "TIMESYNC" and m.tc1 == 0:
                    mav.timesync_send(time.time_ns(), m.ts1)
                if m.get_type() == "COMMAND_LONG" and m.command == mavlink.MAV_CMD_REQUEST_MESSAGE:
                    mav.autopilot_version_send(0, 0x040601FF, 0, 0, 0, b"3fc7011a", b"\0" * 8, b"\0" * 8, 0, 0, 0)
                m = link.recv_match(blocking=False)

    player = threading.Thread(target=play)
    player.start()
    words = ["doctor", "--link", f"udpin:127.0.0.1:{place}", "--seconds"]
    off = subprocess.run([LOOKOUT, *words, "4"], capture_output=True, text=True)
    parameters["ADSB_TYPE"] = 1
    on = subprocess.run([LOOKOUT, *words, "4"], capture_output=True, text=True)
    stop.set()
    player.join()
    silent = subprocess.run([LOOKOUT, *words, "1"], capture_output=True, text=True)
    assert off.returncode == 1 and "missing  ADSB_VEHICLE: ADSB_TYPE is 0" in off.stdout, (off.stdout, off.stderr)
    assert off.stderr == "lookout: missing: 1, see above\n", off.stderr
    assert on.returncode == 0, (on.stdout, on.stderr)
    assert "ok       autopilot: ArduPilot 4.6.1 (official, 3fc7011a); quadrotor, system 7" in on.stdout, on.stdout
    assert "ok       time sync" in on.stdout, on.stdout
    assert silent.returncode == 1 and "nothing was heard in 1 s" in silent.stderr, silent.stderr
    return next(line.strip() for line in on.stdout.splitlines() if "time sync" in line)


failed = 0
for check in (check_flight, check_log, check_foreign_log, check_services, check_signing, check_serial, check_mavsdk, check_doctor):
    start = time.time()
    try:
        result = check()
    except Exception as error:  # every check is told
        failed += 1
        result = f"FAILED: {type(error).__name__}: {error}"
    print(f"{check.__name__[6:]}: {result} ({time.time() - start:.1f} s)", flush=True)
# Threads of the clients shall not delay the end.
sys.stdout.flush()
os._exit(failed > 0)
