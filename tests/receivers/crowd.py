"""A vehicle, a gimbal, a station and two lookouts on one network, heard by pymavlink, MAVSDK and MAVProxy at once.

The second lookout's camera is on the gimbal.

    python crowd.py LOOKOUT
"""

import math
import os
import pathlib
import re
import select
import socket
import subprocess
import sys
import tempfile
import threading
import time

os.environ["MAVLINK20"] = "1"
from pymavlink.dialects.v20 import ardupilotmega as mavlink  # noqa: E402

LOOKOUT = os.path.abspath(sys.argv[1])
VEHICLE, STATION = 7, 255
LOOKOUTS = (196, 197)
# The camera of the second one is on the gimbal, which looks east.
ON_GIMBAL = LOOKOUTS[1]
LATITUDE, LONGITUDE = 473769000, 85417000
GENERIC = mavlink.MAV_AUTOPILOT_GENERIC
PLACE = 26000 + os.getpid() % 2000


class Network:
    """A router: every datagram goes to all other peers. What passes is parsed by pymavlink."""

    def __init__(self):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", PLACE))
        self.peers, self.heard, self.stop = set(), [], threading.Event()
        self.parser = mavlink.MAVLink(None)
        self.parser.robust_parsing = True
        threading.Thread(target=self.run, daemon=True).start()

    def run(self):
        while not self.stop.is_set():
            if not select.select([self.socket], [], [], 0.1)[0]:
                continue
            data, peer = self.socket.recvfrom(4096)
            self.peers.add(peer)
            self.write(data, peer)

    def write(self, data, sender=None):
        for m in self.parser.parse_buffer(bytes(data)) or []:
            self.heard.append((time.time(), m))
        for peer in list(self.peers):
            if peer != sender:
                self.socket.sendto(data, peer)

    def speaker(self, system, component):
        return mavlink.MAVLink(self, srcSystem=system, srcComponent=component)

    def of(self, kind, component=None, since=0.0):
        with_kind = [(t, m) for t, m in list(self.heard) if m.get_type() == kind and t >= since]
        return [(t, m) for t, m in with_kind if component in (None, m.get_srcComponent())]

    def until(self, condition, seconds, what):
        end = time.time() + seconds
        while time.time() < end:
            if found := condition():
                return found
            time.sleep(0.05)
        raise AssertionError(f"{what}: not in {seconds} s")


class Beats:
    """Sends again and again until it is stopped."""

    def __init__(self, *steps):
        self.on, self.stop = True, False
        threading.Thread(target=self.run, args=(steps,), daemon=True).start()

    def run(self, steps):
        count = 0
        while not self.stop:
            for every, send in steps:
                if self.on and count % every == 0:
                    send()
            count += 1
            time.sleep(0.05)


def start_lookout(folder, component):
    settings = folder / f"{component}.toml"
    settings.write_text(
        f'source = "file:{folder / "flight"}"\nrepeat = true\nthreads = 1\ncomponent_id = {component}\n'
        f'links = ["udpout:127.0.0.1:{PLACE}"]\ncamera.gimbal = {"true" if component == ON_GIMBAL else "false"}\n'
    )
    log = open(folder / f"{component}.log", "w")
    return subprocess.Popen([LOOKOUT, "run", "--config", settings], stdout=log, stderr=log)


def start_mavproxy(folder):
    program = pathlib.Path(sys.executable).parent / "mavproxy.py"
    # With the vehicle's system it does not lock to the autopilot's component, and shows the texts of others: README.md says so.
    words = [f"--master=udpout:127.0.0.1:{PLACE}", f"--target-system={VEHICLE}", "--default-modules=", "--daemon", f"--state-basedir={folder}"]
    log = open(folder / "mavproxy.log", "w")
    words += ["--load-module=adsb"]
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    return subprocess.Popen([sys.executable, program, *words], stdout=log, stderr=log, stdin=subprocess.DEVNULL, cwd=folder, env=environment)


def check(folder):
    flight = ["simulate", "--kind", "hover", "--seed", "1", "--seconds", "8", "--out", folder / "flight"]
    subprocess.run([LOOKOUT, *flight], check=True, capture_output=True)
    net = Network()
    gimbal, station, vehicle = net.speaker(VEHICLE, 154), net.speaker(STATION, 190), net.speaker(VEHICLE, 1)
    stopped = []
    # A gimbal and a station that say GENERIC where INVALID belongs, before the vehicle speaks.
    stopped.append(Beats((20, lambda: gimbal.heartbeat_send(mavlink.MAV_TYPE_GIMBAL, GENERIC, 0, 0, 4))))
    stopped.append(Beats((20, lambda: station.heartbeat_send(mavlink.MAV_TYPE_GCS, GENERIC, 0, 0, 4))))
    processes = [start_lookout(folder, component) for component in LOOKOUTS]
    try:
        for component in LOOKOUTS:
            net.until(lambda: net.of("HEARTBEAT", component), 30, f"heartbeat of {component}")
        time.sleep(2)
        asked = net.of("COMMAND_LONG")
        assert not asked, f"asked before there was a vehicle: {asked[0]}"
        begun = time.time()
        boot = lambda: int((time.time() - begun) * 1000) + 5000  # noqa: E731
        flying = Beats(
            (20, lambda: vehicle.heartbeat_send(2, 3, 81, 4, 4)),
            (1, lambda: vehicle.attitude_quaternion_send(boot(), 1, 0, 0, 0, 0, 0, 0)),
            (4, lambda: vehicle.global_position_int_send(boot(), LATITUDE, LONGITUDE, 500000, 100000, 0, 0, 0, 0)),
        )
        stopped.append(flying)
        half, nan = math.sqrt(0.5), math.nan
        in_earth_frame = mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME
        pointing = Beats(
            (2, lambda: gimbal.gimbal_device_attitude_status_send(
                0, 0, boot(), in_earth_frame, [half, 0, 0, half], nan, nan, nan, 0, nan, nan, 1)),
        )
        stopped.append(pointing)
        names = {}
        for component in LOOKOUTS:
            net.until(lambda: net.of("ADSB_VEHICLE", component), 60, f"traffic of {component}")
            names[component] = {(m.ICAO_address, m.callsign) for _, m in net.of("ADSB_VEHICLE", component)}
            messages = net.of("ADSB_VEHICLE", component)
            assert all(m.emitter_type == mavlink.ADSB_EMITTER_TYPE_UAV for _, m in messages)
            assert all(m.get_srcSystem() == VEHICLE for _, m in messages)
        ours, theirs = (names[component] for component in LOOKOUTS)
        assert not {i for i, _ in ours} & {i for i, _ in theirs}, names
        assert not {c for _, c in ours} & {c for _, c in theirs}, names
        results = [f"ids of two lookouts: {sorted(ours)[0]}, {sorted(theirs)[0]}"]
        results.append(check_gimbal(net, pointing))
        results.append(check_requests(net, station))
        results.append(check_clients(net, folder, processes))
        gone = time.time()
        flying.on = False
        for component in LOOKOUTS:
            lost = lambda: [t for t, m in net.of("STATUSTEXT", component, gone) if "autopilot lost" in m.text]  # noqa: E731
            took = net.until(lost, 10, "autopilot lost")[0] - gone
            assert took < 3.2, took
            state = lambda: [m for _, m in net.of("HEARTBEAT", component, gone) if m.system_status == 5]  # noqa: E731
            net.until(state, 3, "state of the heartbeat")
        flying.on = True
        back = time.time()
        for component in LOOKOUTS:
            found = lambda: [t for t, m in net.of("STATUSTEXT", component, back) if "is back" in m.text]  # noqa: E731
            net.until(found, 5, "autopilot is back")
        results.append(f"loss said after {took:.1f} s")
        for words in ("autopilot lost", "is back"):
            shown = lambda: re.search(rf"^AP: .*{words}", (folder / "mavproxy.log").read_text(errors="replace"), re.M)  # noqa: E731, B023
            net.until(shown, 5, f"MAVProxy shows '{words}'")
        # The echo of our own traffic by an autopilot confirms nothing and is not taken for an aircraft.
        return "; ".join(results)
    finally:
        for beats in stopped:
            beats.stop = True
        for process in processes:
            process.terminate()
        for process in processes:
            process.wait(15)
        net.stop.set()


def bearings(net, component, since):
    """Degrees from north of the traffic that a lookout reports, seen from the vehicle."""
    narrow = math.cos(math.radians(LATITUDE / 1e7))
    for _, m in net.of("ADSB_VEHICLE", component, since):
        yield math.degrees(math.atan2((m.lon - LONGITUDE) * narrow, m.lat - LATITUDE))


def check_gimbal(net, pointing):
    """Traffic is where the gimbal looks; nothing is on the map while it is silent, and that is said."""
    fixed, turned = (list(bearings(net, component, 0)) for component in LOOKOUTS)
    assert fixed and all(abs(b) < 40 for b in fixed), fixed
    assert turned and all(abs(b - 90) < 40 for b in turned), turned
    pointing.on = False
    gone = time.time()
    said = lambda: [t for t, m in net.of("STATUSTEXT", ON_GIMBAL, gone) if "gimbal silent" in m.text]  # noqa: E731
    took = net.until(said, 10, "gimbal silent")[0] - gone
    late = [t - gone for t, _ in net.of("ADSB_VEHICLE", ON_GIMBAL, gone + 1)]
    assert not late, late
    pointing.on = True
    back = time.time()
    net.until(lambda: net.of("ADSB_VEHICLE", ON_GIMBAL, back), 30, "traffic by the gimbal again")
    return f"gimbal: {len(fixed)} reports ahead, {len(turned)} to the east, its silence said after {took:.1f} s"


def check_requests(net, station):
    """What clients ask of every component is answered, by both lookouts."""
    for component in LOOKOUTS:
        since = time.time()
        station.param_request_list_send(VEHICLE, component)
        count = lambda: len({m.param_id for _, m in net.of("PARAM_VALUE", component, since)}) >= 12  # noqa: E731
        net.until(count, 5, "list of parameters")
        payload = bytearray(251)
        payload[3], payload[4] = 4, 1
        station.file_transfer_protocol_send(0, VEHICLE, component, payload)
        answer = net.until(lambda: net.of("FILE_TRANSFER_PROTOCOL", component, since), 3, "file")[0][1]
        assert (answer.payload[3], answer.payload[12]) == (129, 10), answer
        station.mission_request_list_send(VEHICLE, component, 0)
        answer = net.until(lambda: net.of("MISSION_COUNT", component, since), 3, "mission")[0][1]
        assert answer.count == 0 and answer.target_system == STATION, answer
        station.param_request_read_send(VEHICLE, component, b"NO_SUCH_NAME", -1)
        net.until(lambda: [m for _, m in net.heard[-400:] if m.get_msgId() == 345], 3, "unknown parameter")
    return "parameters, files and missions answered"


def check_clients(net, folder, processes):
    """MAVSDK and MAVProxy see the traffic of both lookouts."""
    from mavsdk import ComponentType, Configuration, Mavsdk
    from mavsdk.plugins.mavlink_direct import MavlinkDirect

    processes.append(start_mavproxy(folder))
    with Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION)) as sdk:
        sdk.add_any_connection(f"udpout://127.0.0.1:{PLACE}")
        system = sdk.first_autopilot(20)
        assert system is not None, "MAVSDK: no system"
        heard = set()
        direct = MavlinkDirect(system)
        direct.subscribe_message("ADSB_VEHICLE", lambda message, _: heard.add(message.component_id))
        net.until(lambda: heard >= set(LOOKOUTS), 40, "MAVSDK: traffic of both")
        direct.destroy()
    log = folder / "mavproxy.log"
    detected = f"Detected vehicle {VEHICLE}:1 on link"
    net.until(lambda: detected in log.read_text(errors="replace"), 40, f"MAVProxy: {log.read_text(errors='replace')}")
    return "MAVSDK and MAVProxy serve system 7"


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as name:
        start = time.time()
        try:
            result, failed = check(pathlib.Path(name)), False
        except Exception as error:
            result, failed = f"FAILED: {type(error).__name__}: {error}", True
        print(f"crowd: {result} ({time.time() - start:.1f} s)", flush=True)
    # Threads of the clients shall not delay the end.
    os._exit(failed)
