# SPDX-License-Identifier: Apache-2.0
"""Mosquitto, the daemon, robots on both meshes and the subscriber, with functions to start, end and pause them. Used by acts and
run. Waits for conditions only, and fails when a program ends by itself."""
import contextlib
import json
import math
import pathlib
import random
import re
import signal
import socket
import struct
import subprocess
import time

from clock import MovedClock
from commands import UNKNOWN_ROBOT, Gap, Sent, read_received
from disk import Disk
from judge import Evidence, arrivals_in, outcomes_in
from program import PATIENCE_S, Failure, Program, free_port
from proxy import Mqtt311Proxy
from subscriber import USER, Subscriber, Witness
from verdict import Trouble, read_record

PREFIX = "ntnu-slam"
FLEETS = {"thread1_": 4, "thread2_": 4, "ble": 3}  # prefix of the robots' ids: how many
QOS = {"thread1_": 1, "thread2_": 2, "ble": 1}  # of their messages
FIRST_BLE_ADDRESS = 0x0100
LARGEST_PACKET = 268435455  # of MQTT
REST_S = 100  # between two `cmd` to one robot, so that their outcomes cannot be confused
# A bad radio. One request at a time, as MQTT-SN 1.2 demands: with more, the radio itself would change the order.
THREAD_OPTIONS = ("--loss=0.05 --duplicate=0.05 --reorder=0.05 --delay-ms=5 --outstanding=1 --retry=1 --keep-alive=5 "
                  "--give-up-s=0").split()


class World:
    def __init__(self, bin_directory, directory, seed, has_own_mounts, mqtt=5, client="paho"):
        self.bin, self.directory = pathlib.Path(bin_directory), pathlib.Path(directory)
        self.client = client  # the daemon's broker.client
        self.begin = time.time()
        self.troubles, self.gaps, self.commands = [], [], []
        self.random = random.Random(seed)  # for commands; acts have their own
        self.next_command_at = 0.0
        self.obeyed_at = {}  # robot: when it was last sent a `cmd`
        self.disk = Disk(self.directory / "store", has_own_mounts)
        self.broker_port, self.mqttsn_port = free_port(socket.SOCK_STREAM), free_port(socket.SOCK_DGRAM)
        self.mqtt = mqtt
        self.link_port = Mqtt311Proxy(self.broker_port).port if mqtt == 3 else self.broker_port
        self.subscriber, self.witness = Subscriber(self.broker_port, PREFIX), Witness(self.broker_port, PREFIX)
        self.robots_end = math.inf
        self.is_broker_there = self.is_daemon_wanted = self.are_robots_wanted = False
        self.broker = Program(self.directory, "broker", ["mosquitto", "-c", self.write_broker_configuration()])
        self.clock = MovedClock(self.directory)
        self.daemon = Program(self.directory, "daemon",
                              [*self.clock.prefix(), self.bin / "slam-gatewayd", "--config", self.write_daemon_configuration()])
        self.robots = {fleet: Program(self.directory, fleet, [self.bin / "slam-gateway-sim", *arguments, "--seed", seed,
                                                              "--id-prefix", fleet, "--robots", FLEETS[fleet],
                                                              "--record", self.directory / f"{fleet}.record"])
                       for fleet, arguments in self.fleet_arguments().items()}

    def fleet_arguments(self):
        thread = ["thread", "--gateway", f"127.0.0.1:{self.mqttsn_port}", *THREAD_OPTIONS]
        return {"thread1_": [*thread, "--qos", QOS["thread1_"]], "thread2_": [*thread, "--qos", QOS["thread2_"]],
                "ble": ["ble", "--tty", self.directory / "board", "--acknowledged", "--numbered", "--rate", 3]}

    def write_broker_configuration(self):
        path = self.directory / "mosquitto.conf"
        self.access = self.directory / "access"
        self.refuse_nothing()
        self.configuration = path
        self.take_packets_of(LARGEST_PACKET)
        return path

    def take_packets_of(self, octets):
        """Has the broker accept packets up to this size, from its start if it is not running."""
        self.configuration.write_text(f"listener {self.broker_port} 127.0.0.1\nallow_anonymous true\nset_tcp_nodelay true\n"
                                      f"max_queued_messages 0\nuser root\nacl_file {self.access}\n"
                                      f"max_packet_size {octets}\n")
        self.reload_broker()

    def refuse(self, robot):
        """Has the broker refuse this robot's messages, from its start if it is not running. Listeners keep their access: at QoS 2
        Mosquitto checks read access only after its PUBREC, and then drops the message."""
        self.access.write_text(f"topic deny {PREFIX}/robot/{robot}/#\ntopic readwrite #\nuser {USER}\ntopic readwrite #\n")
        self.reload_broker()

    def refuse_nothing(self):
        self.access.write_text(f"topic readwrite #\nuser {USER}\ntopic readwrite #\n")
        self.reload_broker()

    def reload_broker(self):
        if self.is_broker_there:
            self.broker.send(signal.SIGHUP)

    def write_daemon_configuration(self):
        path = self.directory / "gateway.json"
        ble_names = [{"id": f"ble{n}", "ble_address": f"0x{FIRST_BLE_ADDRESS + n - 1:04x}"}
                     for n in range(1, FLEETS["ble"] + 1)]
        path.write_text(json.dumps({
            "gateway": {"id": "soak"},
            # A short keep-alive, so that the daemon sometimes leaves a stalled broker.
            "broker": {"uri": f"mqtt://127.0.0.1:{self.link_port}", "client": self.client, "keep_alive_s": 5},
            "robots": ble_names,
            "ble_mesh": {"enabled": True, "device": str(self.directory / "board")},
            "mqttsn": {"listen": [f"127.0.0.1:{self.mqttsn_port}"], "multicast_group": None},
            "store": {"directory": str(self.disk.directory)},
            "log": {"traffic": "off"},
            "control": {"socket": str(self.directory / "control.sock")}}, indent=2))
        return path

    # Time

    def say(self, text):
        print(f"{time.time() - self.begin:7.1f} s  {text}", flush=True)

    def wait_for(self, what, condition):
        end = time.monotonic() + PATIENCE_S
        while not condition():
            self.check_programs()
            if time.monotonic() > end:
                raise Failure(f"{what}: not within {PATIENCE_S} s")
            time.sleep(0.02)

    def pass_time(self, seconds):
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            self.check_programs()
            if self.is_broker_there and time.monotonic() > self.next_command_at:
                self.next_command_at = time.monotonic() + 1
                self.send_some_command()
            time.sleep(min(0.05, max(left, 0)))

    def send_some_command(self):
        """Sends a `cmd`, which the robot obeys, or else a command of a new type."""
        robot = self.random.choice([*self.robot_ids(), UNKNOWN_ROBOT])
        payload = struct.pack("<hh", self.random.randint(-60, 60), self.random.randint(-60, 60))
        if robot == UNKNOWN_ROBOT or time.monotonic() - self.obeyed_at.get(robot, -math.inf) < REST_S:
            return self.send_command(robot, f"act{len(self.commands)}", payload)
        self.obeyed_at[robot] = time.monotonic()
        return self.send_command(robot, "cmd", payload)

    def check_programs(self):
        expected = [*self.robots.values()] if self.are_robots_wanted else []
        expected += [self.daemon] if self.is_daemon_wanted else []
        expected += [self.broker] if self.is_broker_there else []
        for program in expected:
            if not program.is_running():
                raise Failure(f"{program.name} has ended by itself: {program.tail()}")

    @contextlib.contextmanager
    def trouble(self, text, may_repeat):
        """Records a trouble. It may make up to `may_repeat` messages arrive twice. It may lose `may_lose` messages, which the act sets
        to the number that the daemon has reported."""
        self.say(text)
        trouble = Trouble(time.time(), float("inf"), may_repeat)
        self.troubles.append(trouble)
        yield trouble
        trouble.end = time.time()

    def connections(self):
        """Returns how often the daemon has connected to the broker."""
        return self.daemon.log.read_text().count(" connected (MQTT")

    def reported_as_lost(self, log_position):
        """Returns the number of messages that the daemon has reported as lost since this position in its log."""
        log = self.daemon.log.read_text()[log_position:]
        return sum(int(number) for number in re.findall(r"(\d+) messages are lost", log))

    # The programs

    def start_daemon(self):
        self.daemon.start()
        self.is_daemon_wanted = True

    def end_daemon(self, signal_number):
        self.is_daemon_wanted = False
        self.open_gap(is_kill=signal_number == signal.SIGKILL)
        status = self.daemon.end(signal_number)
        if signal_number == signal.SIGTERM and status != 0:
            raise Failure(f"the daemon did not shut down cleanly: {self.daemon.tail()}")

    def start_broker(self):
        """Starts the broker. The daemon is paused until the subscribers are connected."""
        is_paused = self.daemon.is_running()
        if is_paused:
            self.daemon.send(signal.SIGSTOP)
        self.broker.start()
        self.is_broker_there = True
        self.wait_for("the broker", self.accepts_connections)
        for listener in (self.subscriber, self.witness):
            if not listener.connect():
                raise Failure("a subscriber's subscription: not within 30 s")
        if is_paused:
            self.daemon.send(signal.SIGCONT)

    def end_broker(self, signal_number):
        self.is_broker_there = False
        self.open_gap(loses_queue=True)
        self.broker.end(signal_number)
        for listener in (self.subscriber, self.witness):
            if not listener.wait_for_end():
                raise Failure("a subscriber's connection outlives the broker")

    def pause_broker(self):
        self.is_broker_there = False
        self.open_gap()
        self.broker.send(signal.SIGSTOP)

    def resume_broker(self):
        self.broker.send(signal.SIGCONT)
        self.is_broker_there = True

    def accepts_connections(self):
        with contextlib.suppress(ConnectionError), socket.create_connection(("127.0.0.1", self.broker_port)):
            return True
        return False

    def open_gap(self, loses_queue=False, is_kill=False):
        """Records that a part is down. An MQTT 3.1.1 broker keeps no commands for an absent daemon."""
        self.gaps.append(Gap(time.time(), math.inf, loses_queue or self.mqtt == 3, is_kill))

    def close_gaps(self):
        for gap in self.gaps:
            gap.end = min(gap.end, time.time())

    def wait_for_daemon_at_broker(self, since):
        self.wait_for("the daemon at the broker", lambda: self.subscriber.online_at > since)
        self.close_gaps()

    def wait_for_link(self, since):
        """Waits until the daemon is connected, perhaps still by its old connection."""
        self.wait_for("traffic", lambda: self.status("broker", "state") == "up" and self.subscriber.messages
                      and self.subscriber.messages[-1][0] > since)
        self.close_gaps()

    def start_robots(self):
        for robots in self.robots.values():
            robots.start()
        self.are_robots_wanted = True

    def end_robots(self):
        self.are_robots_wanted = False
        self.robots_end = time.time()
        for robots in self.robots.values():
            robots.end(signal.SIGTERM)

    def end_all(self):
        for program in [*self.robots.values(), self.daemon, self.broker]:
            if program.is_running():
                program.send(signal.SIGKILL)
                program.process.wait()
        self.disk.unmount()

    # Commands and evidence

    def robot_ids(self):
        return [f"{fleet}{n}" for fleet, count in FLEETS.items() for n in range(1, count + 1)]

    def send_command(self, robot, kind, payload):
        result = subprocess.run(["mosquitto_pub", "-h", "127.0.0.1", "-p", str(self.broker_port), "-q", "1", "-s",
                                 "-t", f"{PREFIX}/server/{robot}/{kind}"], input=payload, timeout=PATIENCE_S, check=False)
        if result.returncode == 0:
            self.commands.append(Sent(robot, kind, time.time(), payload.hex()))

    def status(self, *path):
        """Returns a field of `slam-gatewayctl status`; None if the daemon does not answer."""
        result = subprocess.run([self.bin / "slam-gatewayctl", "--socket", self.directory / "control.sock", "--json",
                                 "status"], capture_output=True, timeout=PATIENCE_S, check=False)
        if result.returncode != 0:
            return None
        field = json.loads(result.stdout)
        for key in path:
            field = field[key]
        return field

    def said(self):
        return self.recorded(read_record)

    def recorded(self, read):
        found = []
        for fleet in FLEETS:
            with contextlib.suppress(FileNotFoundError), open(self.directory / f"{fleet}.record") as record:
                found += read(record)
        return found

    def arrivals(self):
        return arrivals_in(list(self.subscriber.messages))

    def outcomes(self):
        return outcomes_in(list(self.subscriber.messages))

    def evidence(self):
        return Evidence(said=self.said(), received=self.recorded(read_received), messages=list(self.subscriber.messages),
                        witnessed=list(self.witness.heard), commands=self.commands, troubles=self.troubles, gaps=self.gaps,
                        qos_of={robot: QOS[fleet_of(robot)] for robot in self.robot_ids()}, robots_end=self.robots_end,
                        until=time.time())


def fleet_of(robot):
    """Returns None for UNKNOWN_ROBOT."""
    return next((fleet for fleet in FLEETS if robot.startswith(fleet)), None)
