# SPDX-License-Identifier: Apache-2.0
"""Commands at the strict broker: equal ones, five a second to each robot, while robots' connections are cut with their PUBACKs, and the
daemon stands still or is killed. No robot obeys a command more often than it was published. Each command has at most one outcome, within
30 s; it has one unless it came within one round trip before its connection broke.
Run as a test (ctest -R StrictBroker.Commands): commands_test.py DIRECTORY-OF-PROGRAMS"""
import collections
import concurrent.futures
import json
import pathlib
import random
import signal
import socket
import sys
import tempfile
import threading
import time
import unittest

HERE = pathlib.Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent / "soak")]
from harness import Client, StrictBroker, wait_for  # noqa: E402
from packets import Kind  # noqa: E402
from program import Program, free_port  # noqa: E402

ROBOTS = ["r1", "r2", "r3"]
CUTS, PERIOD_S, PROMISE_S = 20, 0.2, 30
STILL_S = 6
STILL, KILLS = (5, 13), (9, 18)
# (packet, direction, then) on a robot's own connection
MOMENTS = [("PUBACK", "got", "cut"), ("PUBLISH", "gave", "cut_after"), ("PUBACK", "got", "cut_after")]


class Commander:
    """Publishes equal commands to each robot until it is ended."""

    def __init__(self, port, version):
        self.client, self.published, self.is_over = Client(port, version), collections.Counter(), threading.Event()
        self.client.connect("commander")
        self.thread = threading.Thread(target=self.run)

    def run(self):
        packet_id = 0
        while not self.is_over.wait(PERIOD_S):
            for robot in ROBOTS:
                packet_id = packet_id % 65535 + 1
                self.client.publish(f"ntnu-slam/server/{robot}/run", b"1", qos=1, packet_id=packet_id)
                self.client.expect_acknowledgement(Kind.PUBACK)
                self.published[robot] += 1

    def end(self):
        self.is_over.set()
        self.thread.join()
        self.client.close()


class World:
    def __init__(self, directory, programs, version):
        self.directory, self.broker = pathlib.Path(directory), StrictBroker(directory, "--mqtt", "3" if version == 4 else "5")
        port, path = free_port(socket.SOCK_DGRAM), self.directory / "gateway.json"
        path.write_text(json.dumps({
            "gateway": {"id": "strict"}, "broker": {"uri": f"mqtt://127.0.0.1:{self.broker.port}"},
            "mqttsn": {"listen": [f"127.0.0.1:{port}"], "multicast_group": None}, "store": {"directory": str(self.directory / "store")},
            "log": {"traffic": "off"}, "control": {"socket": str(self.directory / "control.sock")}}))
        self.daemon = Program(self.directory, "daemon", [programs / "slam-gatewayd", "--config", path])
        self.robots = Program(self.directory, "robots", [
            programs / "slam-gateway-sim", "thread", "--gateway", f"127.0.0.1:{port}", "--robots", len(ROBOTS), "--rate", 5, "--id-prefix", "r",
            "--retry", 1, "--keep-alive", 5, "--give-up-s", 0, "--no-clean", "--record", self.directory / "record"])
        self.commander = Commander(self.broker.port, version)

    def start(self):
        self.daemon.start()
        self.robots.start()
        wait_for(lambda: all(self.sessions(robot) for robot in ROBOTS), "sessions of all robots")
        wait_for(lambda: all(self.broker.journal("gave", packet="SUBACK", client=client_id(robot)) for robot in ROBOTS), "their filters")
        self.commander.thread.start()

    def sessions(self, robot):
        return len(self.broker.journal("connected", client=client_id(robot)))

    def break_something(self, number, chance):
        before = {robot: self.sessions(robot) for robot in ROBOTS}
        robots = [chance.choice(ROBOTS)]
        if number in STILL:
            self.daemon.send(signal.SIGSTOP)
            time.sleep(STILL_S)
            self.broker.order("cut", client=client_id(robots[0]))
            self.daemon.send(signal.SIGCONT)
        elif number in KILLS:
            self.await_pace()
            robots = ROBOTS
            self.daemon.end(signal.SIGKILL)
            self.daemon.start()
        else:
            packet, direction, then = MOMENTS[number % len(MOMENTS)]
            nth = chance.randrange(1, 4)
            self.broker.order("fault", packet=packet, direction=direction, then=then, nth=nth, client=client_id(robots[0]))
        wait_for(lambda: all(self.sessions(robot) > before[robot] for robot in robots), f"the robots' sessions after break {number}")

    def await_pace(self):
        """Waits until commands end as fast as they come, so that none of a former break is open at the next one."""
        deadline = time.monotonic() + PROMISE_S
        while time.monotonic() < deadline:
            published, ended = dict(self.commander.published), {robot: len(found) for robot, found in self.outcomes().items()}
            time.sleep(5 * PERIOD_S)
            now = self.outcomes()
            pace = {robot: len(now[robot]) - ended.get(robot, 0) - self.commander.published[robot] + published[robot] for robot in ROBOTS}
            if all(abs(more) <= 1 for more in pace.values()):
                return

    def outcomes(self):
        """Returns {robot: its outcomes}."""
        found = collections.defaultdict(list)
        for one in self.broker.journal("accepted"):
            if "/gateway/strict/commands/" in one["topic"]:
                found[one["topic"].rpartition("/")[2]].append(json.loads(bytes.fromhex(one["payload"])))
        return found

    def obeyed(self):
        """Returns {robot: commands that reached it}. A repeat on the radio has the message id of the one before it."""
        counts, last = collections.Counter(), {}
        for line in (self.directory / "record").read_text().splitlines():
            what, robot, message_id, *_ = line.split()
            if what == "received" and last.get(robot) != message_id:
                counts[robot] += 1
                last[robot] = message_id
        return counts

    def finish(self):
        self.commander.end()
        deadline = time.monotonic() + PROMISE_S + 5
        while time.monotonic() < deadline and any(len(self.outcomes()[robot]) < self.commander.published[robot] for robot in ROBOTS):
            time.sleep(0.2)

    def end(self):
        self.commander.is_over.set()
        for program in [self.daemon, self.robots]:
            if program.is_running():
                program.process.kill()
                program.process.wait()
        self.broker.end()


def client_id(robot):
    return f"ntnu-slam-robot-{robot}"


def run(version):
    """Returns {robot: (published, outcomes, obeyed)}."""
    chance = random.Random(version)
    with tempfile.TemporaryDirectory() as directory:
        world = World(directory, PROGRAMS, version)
        try:
            world.start()
            for number in range(CUTS):
                world.break_something(number, chance)
            world.finish()
            return {robot: (world.commander.published[robot], world.outcomes()[robot], world.obeyed()[robot]) for robot in ROBOTS}
        finally:
            world.end()


class CommandsAtAStrictBroker(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        with concurrent.futures.ThreadPoolExecutor() as threads:
            cls.runs = dict(zip((4, 5), threads.map(run, (4, 5))))

    def test_robots_obey_no_command_more_often_than_it_was_published(self):
        for version, robots in self.runs.items():
            for robot, (published, outcomes, obeyed) in robots.items():
                with self.subTest(version=version, robot=robot):
                    print(f"MQTT {version}, {robot}: {published} published, {len(outcomes)} outcomes, {obeyed} obeyed")
                    self.assertGreater(obeyed, published / 2)
                    self.assertLessEqual(obeyed, published)

    def test_each_command_has_one_outcome_unless_it_came_at_a_break(self):
        for version, robots in self.runs.items():
            for robot, (published, outcomes, _) in robots.items():
                with self.subTest(version=version, robot=robot):
                    self.assertLessEqual(len(outcomes), published)
                    self.assertGreaterEqual(len(outcomes), published - CUTS)

    def test_each_outcome_comes_within_the_promised_time(self):
        for robots in self.runs.values():
            for _, outcomes, _ in robots.values():
                self.assertLessEqual(max(one["after_ms"] for one in outcomes), PROMISE_S * 1000)


if __name__ == "__main__":
    PROGRAMS = pathlib.Path(sys.argv[1])
    unittest.main(argv=sys.argv[:1])
