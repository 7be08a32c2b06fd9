# SPDX-License-Identifier: Apache-2.0
"""The daemon at the strict broker: robots talk with QoS 1 and 2 while the connection is cut 20 times, at chosen packets too, and the
daemon is killed. All acknowledged messages arrive, in order, and twice only within the bounds of the soak (acts.py).
Run as a test (ctest -R StrictBroker.Gateway): gateway_test.py DIRECTORY-OF-PROGRAMS CLIENT, with broker.client `paho` or `mosquitto`."""
import concurrent.futures
import contextlib
import json
import pathlib
import random
import re
import signal
import socket
import sys
import tempfile
import time
import unittest

HERE = pathlib.Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent / "soak")]
from acts import DAEMON_KILLED, LINK_LOST  # noqa: E402
from harness import StrictBroker, wait_for  # noqa: E402
from program import Program, free_port  # noqa: E402
from verdict import Arrival, Tally, Trouble, judge, read_record  # noqa: E402

CLIENT_ID = "slam-gateway-strict"
CUTS, KILLS = 20, (4, 9, 14, 19)
FLEETS = {"one": 1, "two": 2}  # prefix of the robots' ids: QoS
# Moments at which a cut may lose or repeat a message: (packet, direction, then)
MOMENTS = [("PUBREC", "gave", "cut"), ("PUBREL", "got", "cut"), ("PUBCOMP", "gave", "cut"), ("PUBLISH", "got", "cut"),
           ("PUBACK", "gave", "cut"), ("PUBREL", "got", "cut_after"), ("PUBREC", "gave", "cut_after")]


class Gateway:
    """Broker, daemon and robots, and ways to break them."""

    def __init__(self, directory, programs, client, version):
        self.directory, self.broker = pathlib.Path(directory), StrictBroker(directory, "--mqtt", "3" if version == 4 else "5")
        self.troubles = []
        port, path = free_port(socket.SOCK_DGRAM), self.directory / "gateway.json"
        path.write_text(json.dumps({
            "gateway": {"id": "strict"}, "broker": {"uri": f"mqtt://127.0.0.1:{self.broker.port}", "client": client},
            "mqttsn": {"listen": [f"127.0.0.1:{port}"], "multicast_group": None}, "store": {"directory": str(self.directory / "store")},
            "log": {"traffic": "off"}, "control": {"socket": str(self.directory / "control.sock")}}))
        self.daemon = Program(self.directory, "daemon", [programs / "slam-gatewayd", "--config", path])
        self.robots = [Program(self.directory, fleet, [
            programs / "slam-gateway-sim", "thread", "--gateway", f"127.0.0.1:{port}", "--qos", qos, "--robots", 3, "--rate", 10,
            "--id-prefix", fleet, "--outstanding", 1, "--retry", 1, "--keep-alive", 5, "--give-up-s", 0, "--record",
            self.directory / f"{fleet}.record"]) for fleet, qos in FLEETS.items()]

    def start(self):
        self.daemon.start()
        wait_for(lambda: self.connections() == 1)
        for robots in self.robots:
            robots.start()

    def connections(self):
        return len(self.broker.journal("connected", client=CLIENT_ID))

    def cut(self, moment=None, nth=1, kills=False):
        """Cuts the connection, or kills the daemon, and waits until it is connected again."""
        before, trouble = self.connections(), Trouble(time.time(), float("inf"), DAEMON_KILLED if kills else LINK_LOST)
        self.troubles.append(trouble)
        if moment:
            packet, direction, then = moment
            self.broker.order("fault", packet=packet, direction=direction, then=then, nth=nth, client=CLIENT_ID)
            wait_for(lambda: len(self.broker.journal("closed", client=CLIENT_ID)) >= before, f"{moment}")
        else:
            self.broker.order("cut", client=CLIENT_ID)
        if kills:
            self.daemon.end(signal.SIGKILL)
            self.daemon.start()
        wait_for(lambda: self.connections() > before, "the next connection")
        trouble.end = time.time()

    def finish(self):
        for robots in self.robots:
            robots.end(signal.SIGTERM)
        with contextlib.suppress(AssertionError):  # the judge reports missing messages
            wait_for(lambda: sum(tally.missing for tally in self.judge()[0].values()) <= len(self.swallowed()))
        tallies, complaints = self.judge()
        blamed = self.blamed()
        return sum(tallies.values(), Tally()), [one for one in complaints if not (" out of order:" in one and one.split(":")[0] in blamed)], blamed

    def blamed(self):
        """Returns robots with topics that the daemon reports as refused. Two cuts at the same message look like a refusal;
        later messages may then overtake it (docs/topics.md, promise 3)."""
        return set(re.findall(r"refuses messages on \S+/robot/([^/]+)/", self.daemon.log.read_text(encoding="utf-8")))

    def judge(self):
        return judge(self.sent(), [self.arrival(one) for one in self.broker.journal("accepted", client=CLIENT_ID) if is_update(one["topic"])],
                     self.troubles)

    def sent(self):
        sent = []
        for fleet in FLEETS:
            with open(self.directory / f"{fleet}.record", encoding="utf-8") as record:
                sent += read_record(record)
        return sent

    @staticmethod
    def arrival(entry):
        return Arrival(entry["topic"].split("/")[2], entry["payload"], entry["at"])

    def swallowed(self):
        """Returns robots' messages under an id whose handshake was open for another message. The broker dropped them as repeats."""
        payloads = {(one["topic"].split("/")[2], one["payload"]) for one in self.broker.journal("repeat", client=CLIENT_ID, differs=True)}
        return [one for one in self.sent() if (one.robot, one.payload) in payloads]

    def end(self):
        for program in [self.daemon, *self.robots]:
            if program.is_running():
                program.process.kill()
                program.process.wait()
        self.broker.end()


def is_update(topic):
    return topic.endswith("/update")


def run(client, version):
    """Returns (a Tally, complaints, robots whose order is not judged, swallowed messages) after all cuts and kills."""
    chance = random.Random(version)
    with tempfile.TemporaryDirectory() as directory:
        gateway = Gateway(directory, PROGRAMS, client, version)
        try:
            gateway.start()
            for number in range(CUTS):
                moment = MOMENTS[number % (len(MOMENTS) + 1)] if number % (len(MOMENTS) + 1) < len(MOMENTS) else None
                gateway.cut(moment, nth=chance.randrange(5, 40), kills=number in KILLS)
            return *gateway.finish(), gateway.swallowed()
        finally:
            gateway.end()


class AtAStrictBroker(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        with concurrent.futures.ThreadPoolExecutor() as threads:
            cls.runs = dict(zip((4, 5), threads.map(run, (CLIENT, CLIENT), (4, 5))))

    def test_loses_no_acknowledged_message_over_cuts_and_kills_with_mqtt_3_1_1(self):
        self.expect_all(*self.runs[4])

    def test_loses_no_acknowledged_message_over_cuts_and_kills_with_mqtt_5(self):
        """Each connection of the gateway starts clean. A session that a client library resumes without its packet ids loses new
        QoS 2 messages (MQTT-4.3.3)."""
        self.expect_all(*self.runs[5])

    def expect_all(self, tally, complaints, blamed, swallowed):
        print(tally, f"robots with refused topics: {sorted(blamed)}")
        self.assertLess(len(blamed), 4, "of six: the order of the others is judged")
        self.assertEqual((complaints, swallowed), ([], []))
        self.assertGreater(tally.acknowledged, 300)


if __name__ == "__main__":
    PROGRAMS, CLIENT = pathlib.Path(sys.argv[1]), sys.argv[2]
    unittest.main(argv=sys.argv[:1])
