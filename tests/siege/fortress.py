# SPDX-License-Identifier: Apache-2.0
"""The programs under attack: Mosquitto, the daemon, the page and honest robots; and the bounds that hold for every attack."""
import contextlib
import http.client
import json
import signal
import socket
import subprocess
import time

import subscriber
from program import Failure, Program, free_port
from stranger import connect_packet

PREFIX = "ntnu-slam"
PATIENCE_S = 60  # only a failure takes this long
MOST_GROWTH = 96 << 20  # octets of memory in one attack; the services may take 512 and 256 MiB
MOST_LINES, MOST_LINES_A_SECOND = 160, 40  # of the log in one attack, docs/journal.md: 100 and 40 are for clients that have not answered
HONEST = {"good": 3, "ble": 2}  # robots by the beginning of their ids
TOKEN = "a-token-of-the-siege-0123456789"


class Listening(subscriber.Subscriber):
    """A subscriber that also receives hostile documents, so it parses none."""

    def on_publish(self, flags, topic, payload):
        if not flags & 1:
            self.messages.append((time.time(), topic, payload))


class Fortress:
    def __init__(self, programs, directory):
        self.bin, self.directory = programs, directory
        self.broker_port, self.web_port = free_port(socket.SOCK_STREAM), free_port(socket.SOCK_STREAM)
        self.mqttsn_port = free_port(socket.SOCK_DGRAM)
        self.access = directory / "access"
        self.allow_topics()
        (directory / "mosquitto.conf").write_text(
            f"listener {self.broker_port} 127.0.0.1\nallow_anonymous true\nset_tcp_nodelay true\nacl_file {self.access}\n"
            f"max_queued_messages 0\nuser root\n")
        (directory / "token").write_text(TOKEN + "\n")
        (directory / "token").chmod(0o600)
        self.write_configuration("gateway.json", self.broker_port)
        self.broker = Program(directory, "broker", ["mosquitto", "-c", directory / "mosquitto.conf"])
        self.daemon = self.program("slam-gatewayd", "daemon", "--config", directory / "gateway.json")
        self.page = self.program("slam-gateway-web", "page", "--config", directory / "gateway.json")
        self.robots = [
            self.program("slam-gateway-sim", "thread", "thread", "--gateway", f"127.0.0.1:{self.mqttsn_port}", "--qos", 1,
                         "--seed", 1, "--id-prefix", "good", "--robots", HONEST["good"], "--give-up-s=0"),
            self.program("slam-gateway-sim", "board", "ble", "--tty", directory / "board", "--seed", 1, "--id-prefix", "ble",
                         "--robots", HONEST["ble"], "--rate", 2)]
        self.subscriber = Listening(self.broker_port, PREFIX)
        self.newcomers = 0

    def program(self, name, log, *arguments):
        return Program(self.directory, log, [self.bin / name, *arguments])

    def write_configuration(self, name, broker_port, **more):
        path = self.directory / name
        path.write_text(json.dumps({
            "gateway": {"id": path.stem}, "broker": {"uri": f"mqtt://127.0.0.1:{broker_port}", **more},
            "robots": [{"id": f"ble{n}", "ble_address": f"0x{0x00ff + n:04x}"} for n in range(1, HONEST["ble"] + 1)],
            "ble_mesh": {"enabled": path.stem == "gateway", "device": str(self.directory / "board")},
            "mqttsn": {"listen": [f"127.0.0.1:{self.mqttsn_port if path.stem == 'gateway' else free_port(socket.SOCK_DGRAM)}"],
                       "multicast_group": None},
            "store": {"directory": str(self.directory / f"{path.stem}-store")},
            "control": {"socket": str(self.directory / f"{path.stem}.sock")},
            "log": {"traffic": "off"},
            "web": {"listen": f"127.0.0.1:{self.web_port if path.stem == 'gateway' else free_port(socket.SOCK_STREAM)}",
                    "token_file": str(self.directory / "token")}}))
        return path

    # ---- start and end

    def start(self):
        self.broker.start()
        self.wait_for("the broker", lambda: can_connect(self.broker_port))
        self.subscriber.connect()
        for program in (self.daemon, self.page, *self.robots):
            program.start()
        self.wait_for("the page", lambda: can_connect(self.web_port))
        self.wait_for_honest_robots()

    def end(self):
        for program in (*self.robots, self.page, self.daemon, self.broker):
            if program.is_running():
                program.process.kill()
                program.process.wait()

    def mend(self):
        """Restarts programs that have ended, after a failed attack and before the next one."""
        for program in (self.daemon, self.page, *self.robots):
            if not program.is_running():
                program.start()
        self.wait_for_honest_robots()

    def restart_daemon(self):
        self.daemon.end(signal.SIGTERM)
        self.daemon.start()
        self.wait_for("the daemon", lambda: self.ctl("status").returncode == 0)

    def wait_for(self, what, condition):
        end = time.monotonic() + PATIENCE_S
        while not condition():
            if time.monotonic() > end:
                raise Failure(f"{what}: not within {PATIENCE_S} s")
            time.sleep(0.05)

    def ctl(self, *arguments):
        return subprocess.run([self.bin / "slam-gatewayctl", "--socket", self.directory / "gateway.sock", *arguments],
                              capture_output=True, text=True, timeout=PATIENCE_S, check=False)

    def status(self):
        answer = self.ctl("status", "--json")
        if answer.returncode != 0:
            raise Failure(f"slam-gatewayctl status: {answer.stderr.strip() or answer.stdout.strip()}")
        return json.loads(answer.stdout)

    # ---- bounds

    def judge(self, attack):
        """Runs the attack. Returns a description of it and of its cost; raises Failure if a bound is exceeded."""
        watched = (self.daemon, self.page)
        memory = {program.name: resident(program) for program in watched}
        lines = {program.name: count_lines(program) for program in watched}
        begin = time.monotonic()
        description = attack()
        self.wait_for_honest_robots()
        self.serve_newcomer()
        for program in watched:
            if not program.is_running():
                raise Failure(f"{program.name} has ended: {program.tail()}")
        growth = {program.name: resident(program) - memory[program.name] for program in watched}
        logged = {program.name: count_lines(program) - lines[program.name] for program in watched}
        for name in memory:
            if growth[name] > MOST_GROWTH:
                raise Failure(f"{name} has grown by {growth[name] >> 20} MiB")
            if logged[name] > MOST_LINES + MOST_LINES_A_SECOND * (time.monotonic() - begin):
                raise Failure(f"{name} has logged {logged[name]} lines")
        return (f"passed: {description}; daemon {growth['daemon'] >> 10:+d} KiB, {logged['daemon']} lines; "
                f"page {growth['page'] >> 10:+d} KiB, {logged['page']} lines")

    def wait_for_honest_robots(self):
        since = time.time()

        def silent():
            heard = {topic.split("/")[2] for at, topic, _ in self.subscriber.messages
                     if at > since and topic.startswith(f"{PREFIX}/robot/")}
            return [f"{kind}{n}" for kind, count in HONEST.items() for n in range(1, count + 1) if f"{kind}{n}" not in heard]

        try:
            self.wait_for("honest robots", lambda: not silent())
        except Failure:
            raise Failure(f"messages of honest robots no longer arrive: {', '.join(silent())}") from None

    def serve_newcomer(self):
        """Connects a new robot from a new address. It repeats its CONNECT, as MQTT-SN clients do."""
        self.newcomers += 1
        name = f"new{self.newcomers}"
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as robot:
            robot.bind((f"127.1.{self.newcomers // 250}.{1 + self.newcomers % 250}", 0))
            robot.connect(("127.0.0.1", self.mqttsn_port))
            robot.settimeout(1)
            for _ in range(PATIENCE_S):
                with contextlib.suppress(OSError):
                    robot.send(connect_packet(name))
                    if robot.recv(1024) == b"\x03\x05\x00":
                        robot.send(b"\x02\x18")
                        return
        raise Failure(f"a new robot ({name}) is not served")

    # ---- the page

    def get(self, path, source="127.0.0.1", patience=PATIENCE_S):
        """Requests a page from this source address. Returns (status, text)."""
        asking = http.client.HTTPConnection("127.0.0.1", self.web_port, timeout=patience, source_address=(source, 0))
        with contextlib.closing(asking):
            asking.request("GET", path)
            answer = asking.getresponse()
            return answer.status, answer.read().decode()

    def publish(self, topic, payload, retain=False):
        subprocess.run(["mosquitto_pub", "-p", str(self.broker_port), "-t", f"{PREFIX}/{topic}", "-m", payload,
                        *(["-r"] if retain else [])], check=True)

    def refuse_topics_of(self, robot):
        """Has the broker refuse the topics of this robot; `None`: of no robot."""
        self.allow_topics(f"topic deny {PREFIX}/robot/{robot}/#\n" if robot else "")
        self.broker.send(signal.SIGHUP)

    def allow_topics(self, but=""):
        """Writes the broker's access list. The first lines are for clients without a user name. The subscriber has one and may read all."""
        self.access.write_text(f"{but}topic readwrite #\nuser {subscriber.USER}\ntopic read #\n")


def can_connect(port):
    with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 1):
        return True
    return False


def resident(program):
    try:
        with open(f"/proc/{program.process.pid}/statm", encoding="ascii") as numbers:
            return int(numbers.read().split()[1]) * 4096
    except (FileNotFoundError, IndexError):
        raise Failure(f"{program.name} has ended: {program.tail()}") from None


def count_lines(program):
    return program.log.read_bytes().count(b"\n")
