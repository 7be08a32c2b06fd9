# SPDX-License-Identifier: Apache-2.0
"""The measured site: a running daemon with real robots, or a broker, daemon and simulator that this program starts."""
import json
import os
import shutil
import socket
import subprocess
import tempfile
import time

from slamgw_experiment import events
from slamgw_experiment.catalogue import BLE
from slamgw_experiment.programs import Child, Lines, lines_of_growing_file, lines_of_pipe

START_PATIENCE_S = 20
DEFAULT_SOCKET = "/run/slam-gateway/control.sock"
DEFAULT_PREFIX = "ntnu-slam"


class SiteFailure(Exception):
    """A required program does not run; the text names the remedy."""


class RunningDaemon:
    """The daemon of this host, with real robots."""

    simulator_arguments = None

    def __init__(self, programs, socket_path, robots, broker=None, topic_prefix=DEFAULT_PREFIX):
        """`broker`: (host, port) of a broker at which a subscriber counts messages, too."""
        self._directory = tempfile.mkdtemp(prefix="slam-gateway-experiment-")
        self._programs = programs
        self._socket = socket_path or self._path("control.sock")
        self._broker = broker
        self._topic_prefix = topic_prefix
        self.robots = robots
        self._children = []
        self._watch = self._subscriber = None

    def start(self):
        if not self.status():
            raise SiteFailure(f"the daemon does not answer at {self._socket}: is slam-gateway running (systemctl status "
                              "slam-gateway), and are you in the group slam-gateway? Without hardware use --sim")

    def start_robots(self):
        pass

    def have_robots_ended(self):
        return False

    def trouble(self):
        """Returns a text that names a program that has ended; None while all run."""
        if self._subscriber and self._subscriber.has_ended():
            return (f"the subscriber at {':'.join(self._broker)} has ended: {self._subscriber.last_words() or 'it says nothing'}; "
                    "what the broker got is not counted")
        return None

    def why_trace_ended(self):
        words = self._watch.last_words() if self._watch else ""
        return "the daemon's trace has ended: " + (words or "the daemon was stopped, or cut this program off")

    def _ctl(self, *command):
        try:
            said = subprocess.run([self._programs.find("slam-gatewayctl"), "--socket", self._socket, "--json", *command],
                                  capture_output=True, text=True, timeout=5, check=False)
            return json.loads(said.stdout)
        except (OSError, subprocess.SubprocessError, ValueError):
            return None

    def status(self):
        """`slam-gatewayctl --json status`, or None."""
        answer = self._ctl("status")
        return answer if isinstance(answer, dict) else None

    def known_robots(self):
        answer = self._ctl("robots")
        rows = answer if isinstance(answer, list) else []
        return sorted(str(row.get("id", row.get("robot", ""))) for row in rows if isinstance(row, dict))

    def open_sources(self, lines, now_us):
        """Starts to read; returns the sources by name."""
        self._watch = self._child("slam-gatewayctl", "--socket", self._socket, "--json", "watch", stdout=subprocess.PIPE)
        sources = {events.GATEWAY: Lines(events.GATEWAY, lines, now_us).start(lines_of_pipe(self._watch.process.stdout))}
        if self._broker:
            sources[events.BROKER] = self._subscribe(lines, now_us)
        return sources

    def _subscribe(self, lines, now_us):
        host, port = self._broker
        self._subscriber = self._child("mosquitto_sub", "-h", host, "-p", port, "-q", "1", "-t", f"{self._topic_prefix}/robot/+/+",
                                       "-F", "%U\t%x\t%t", stdout=subprocess.PIPE)
        return Lines(events.BROKER, lines, now_us).start(lines_of_pipe(self._subscriber.process.stdout))

    def _path(self, name):
        return os.path.join(self._directory, name)

    def _log(self, name):
        return self._path(name + ".log")

    def _child(self, name, *arguments, **more):
        child = Child([self._programs.find(name), *arguments], self._log(name), **more)
        self._children.append(child)
        return child

    def close(self):
        try:
            for child in reversed(self._children):
                child.end()
        finally:
            shutil.rmtree(self._directory, ignore_errors=True)


class SimulatedSite(RunningDaemon):
    """Mosquitto, slam-gatewayd and slam-gateway-sim on free loopback ports, in a temporary folder that is removed with them."""

    def __init__(self, programs, mesh, robots, simulator_options, daemon_keys, message_type, stop=lambda: False):
        """`stop` is a function that returns whether Ctrl-C came."""
        super().__init__(programs, None, [f"robot{n + 1}" for n in range(robots)])
        self._stop = stop
        self._mesh = mesh
        self._keys = daemon_keys
        self._min_com = "probe" if message_type == "probe" else "adv"
        self._mqtt_port, self._mqttsn_port = free_port(socket.SOCK_STREAM), free_port(socket.SOCK_DGRAM)
        self._broker = "127.0.0.1", str(self._mqtt_port)
        self._where = (["--tty", self._path("board")] if mesh == BLE else ["--gateway", f"127.0.0.1:{self._mqttsn_port}"])
        self.simulator_arguments = [mesh, "--robots", str(robots), *simulator_options]
        self._mosquitto = self._daemon = self._simulator = None

    def start(self):
        for name in ("mosquitto", "mosquitto_sub", "slam-gatewayd", "slam-gatewayctl", "slam-gateway-sim"):
            self._programs.find(name)
        # A process that changes its user is no longer ended with this program.
        user = "user root\n" if os.geteuid() == 0 else ""
        self._write("mosquitto.conf", f"{user}listener {self._mqtt_port} 127.0.0.1\nallow_anonymous true\nset_tcp_nodelay true\n")
        self._write("gateway.json", json.dumps(self._configuration(), indent=2))
        self._mosquitto = self._child("mosquitto", "-c", self._path("mosquitto.conf"))
        self._await(self._is_broker_there, self._mosquitto)
        self._daemon = self._child("slam-gatewayd", "--config", self._path("gateway.json"))
        self._await(lambda: (self.status() or {}).get("broker", {}).get("state") == "up", self._daemon)

    def _configuration(self):
        keys = {
            "gateway": {"id": "experiment"},
            "broker": {"uri": f"mqtt://127.0.0.1:{self._mqtt_port}"},
            "mqttsn": {"listen": [f"127.0.0.1:{self._mqttsn_port}"], "multicast_group": None},
            "store": {"directory": self._path("store")},
            "control": {"socket": self._socket},
        }
        if self._mesh == BLE:
            keys["ble_mesh"] = {"enabled": True, "device": self._path("board"),
                                "types": {"min_com": self._min_com, "sensor_update": "update", "pos_cmd": "cmd"}}
            keys["robots"] = [{"id": robot, "ble_address": f"0x{0x0100 + n:04x}"} for n, robot in enumerate(self.robots)]
        return keys | self._keys

    def start_robots(self):
        self._simulator = self._child("slam-gateway-sim", *self.simulator_arguments, *self._where, "--trace", self._path("trace"))

    def have_robots_ended(self):
        return self._simulator is not None and self._simulator.has_ended()

    def open_sources(self, lines, now_us):
        sources = super().open_sources(lines, now_us)
        robots = lines_of_growing_file(self._path("trace"), self.have_robots_ended)
        sources[events.ROBOTS] = Lines(events.ROBOTS, lines, now_us).start(robots)
        return sources

    def trouble(self):
        for child in (self._mosquitto, self._daemon):
            if child and child.has_ended():
                return f"{child.name} has ended with status {child.process.returncode}: {child.last_words()}"
        if self.have_robots_ended() and self._simulator.process.returncode not in (0, 3):
            words = self._simulator.last_words() or f"it says nothing; is there room in {self._directory}?"
            return f"slam-gateway-sim has ended with status {self._simulator.process.returncode}: {words}"
        return super().trouble()

    def _is_broker_there(self):
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", self._mqtt_port)) == 0

    def _await(self, is_there, child):
        end = time.monotonic() + START_PATIENCE_S
        while not is_there():
            if self._stop():
                raise SiteFailure("interrupted")
            if child.has_ended() or time.monotonic() > end:
                raise SiteFailure(f"{child.name} did not start: {child.last_words() or 'it says nothing'}")
            time.sleep(0.05)

    def _write(self, name, text):
        with open(self._path(name), "w", encoding="utf-8") as file:
            file.write(text)

def free_port(kind):
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]
