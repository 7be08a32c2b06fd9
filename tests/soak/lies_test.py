# SPDX-License-Identifier: Apache-2.0
"""The judge accepts a correct daemon, and detects each fault of a daemon in LIES. Run as a test (ctest -R Soak.Lies).

The evidence of a run of 20 s is made up, as the robots' record and the subscribers would have it. Three robots send an update five
times a second and get commands, and the daemon is killed once. Each lie changes the evidence.
"""
import copy
import dataclasses
import json
import math
import pathlib
import struct
import sys
import unittest

sys.path.insert(0, str(pathlib.Path(__file__).parent))
from commands import Gap, Sent, read_received  # noqa: E402
from forwarding import Heard  # noqa: E402
from judge import Evidence, judge_run  # noqa: E402
from verdict import Trouble, read_record  # noqa: E402

QOS = {"thread1": 1, "thread2": 2, "ble1": 1}
BEGIN, CONNECTED, KILL, BACK, END = 1000.0, 1000.4, 1010.0, 1011.0, 1020.0
OFFLINE = b'{"state":"offline"}'


def update_topic(robot):
    return f"slam/robot/{robot}/update"


def forms(topic):
    """Returns QoS and retain flag of a correct daemon's messages on this topic."""
    levels = topic.split("/")
    if levels[1] == "robot":
        return (0 if levels[3] == "will" else QOS[levels[2]]), False
    return 1, levels[3] in ("state", "robots")


class Run:
    """The evidence of a run, with functions to change it."""

    def __init__(self):
        self.record, self.messages, self.commands = [], [], []
        self.hear(CONNECTED, "slam/gateway/soak/state", b'{"state":"online"}')
        for number, robot in enumerate(QOS):
            self.hear(CONNECTED + 0.1, f"slam/gateway/soak/robots/{robot}", b'{"state":"online"}')
            self.say_updates(robot, number)
        self.hear(KILL + 0.01, "slam/gateway/soak/state", OFFLINE)
        self.hear(BACK, "slam/gateway/soak/state", b'{"state":"online"}')
        self.hear(BACK + 0.1, update_topic("thread1"), struct.pack("<hh", 47, 0))  # the message in flight is sent again
        self.send_commands()

    def say_updates(self, robot, number):
        for n in range(100):
            at = CONNECTED + 0.2 + n * 0.19
            payload = struct.pack("<hh", n, number)
            self.record.append((at, f"sent {robot} {n + 1} {payload.hex()}00 {at:.6f}\n"))
            if KILL <= at <= BACK:
                continue
            self.record.append((at, f"acknowledged {robot} {n + 1} {at + 0.01:.6f}\n"))
            self.hear(at + 0.005, update_topic(robot), payload)

    def send_commands(self):
        self.command("thread1", "cmd", "0a00ecff", 1003.0, "delivered", "cmd", 7)
        self.command("thread1", "cmd", "0b00ecff", 1013.0, "delivered", "cmd", 8)
        self.command("thread2", "run", b"start".hex(), 1004.0, "delivered", "run", 9)
        self.command("ble1", "act1", "0c00ecff", 1005.0, "delivered", "min_com", 0)
        self.command("ble1", "run", b"stop".hex(), 1006.0, "delivered", "run", 0, carried="00")
        self.command("ble1", "act6", "1000ecff", 1014.0, "delivered", "min_com", 0)
        self.command("thread2", "act2", "0d00ecff", 1007.0, "refused")
        self.command("nobody", "act3", "0e00ecff", 1007.5, "refused")
        self.reach("thread1", 7, "cmd", "0a00ecff", 1003.03)  # its PUBACK was lost
        self.commands.append(Sent("thread1", "act4", BEGIN + 0.1, "0f00ecff"))  # before the daemon's first connection

    def command(self, robot, kind, payload, at, result, as_kind=None, message_id=0, carried=None):
        self.commands.append(Sent(robot, kind, at, payload))
        if as_kind:
            self.reach(robot, message_id, as_kind, carried or payload, at + 0.02)
        self.report(robot, kind, result, at + 0.05)

    def reach(self, robot, message_id, kind, payload, at):
        self.record.append((at, f"received {robot} {message_id} {kind} {payload} {at:.6f}\n"))

    def report(self, robot, kind, result, at, after_ms=50):
        self.hear(at, f"slam/gateway/soak/commands/{robot}",
                  json.dumps({"type": kind, "outcome": result, "after_ms": after_ms}).encode())

    def hear(self, at, topic, payload):
        self.messages.append(Heard(at, topic, payload, *forms(topic)))

    def find(self, robot, number):
        """Returns the index of the message with this update."""
        payload = struct.pack("<hh", number, list(QOS).index(robot))
        return next(i for i, one in enumerate(self.messages) if (one.topic, one.payload) == (update_topic(robot), payload))

    def outcome(self, robot, kind):
        return next(i for i, one in enumerate(self.messages)
                    if one.topic.endswith(f"commands/{robot}") and json.loads(one.payload)["type"] == kind)

    def forget_received(self, robot):
        self.record = [line for line in self.record if not line[1].startswith(f"received {robot} ")]

    def change(self, change, only=lambda one: True):
        self.messages = [change(one) if only(one) else one for one in self.messages]

    def judge(self, unseen_by_witness=None, refused=()):
        lines = [line for _, line in sorted(self.record, key=lambda one: one[0])]
        messages = sorted(self.messages, key=lambda one: one.at)
        witnessed = [one for one in messages if unseen_by_witness is None or one.topic != update_topic(unseen_by_witness)]
        _, complaints = judge_run(Evidence(
            said=read_record(lines), received=read_received(lines),
            messages=[(one.at, one.topic, one.payload) for one in messages], witnessed=witnessed, commands=self.commands,
            troubles=[Trouble(KILL, BACK, 3), *refused], qos_of=QOS, robots_end=END, until=END + 60,
            gaps=[Gap(BEGIN, CONNECTED, True), Gap(KILL, BACK, False, True)]))
        return complaints


def is_of_robot(one):
    return one.topic.startswith("slam/robot/")


def with_form(qos=None, retain=None):
    def change(one):
        return dataclasses.replace(one, qos=one.qos if qos is None else qos, retain=one.retain if retain is None else retain)
    return change


def swap(run, first, second):
    messages = run.messages
    messages[first].at, messages[second].at = messages[second].at, messages[first].at


def late(one):
    return dataclasses.replace(one, at=one.at + 40)


# (name, what the daemon does, a part of the complaint)
LIES = [
    ("loses an acknowledged message", lambda run: run.messages.pop(run.find("thread1", 10)), "acknowledged and missing: number 11"),
    ("publishes a message twice", lambda run: run.messages.append(copy.copy(run.messages[run.find("thread2", 20)])),
     "duplicate without a reason: number 21"),
    ("publishes more duplicates than a crash explains",
     lambda run: [run.hear(BACK + 0.2, update_topic("ble1"), struct.pack("<hh", n, 2)) for n in range(44, 48)], "duplicate without a reason"),
    ("changes the order", lambda run: swap(run, run.find("ble1", 30), run.find("ble1", 31)), "out of order: number 31 after 32"),
    ("changes a payload", lambda run: run.change(lambda one: dataclasses.replace(one, payload=one.payload + b"\0"),
                                                 lambda one: one is run.messages[run.find("thread1", 12)]), "was never sent"),
    ("publishes under another robot's name", lambda run: run.hear(1003, update_topic("thread2"), struct.pack("<hh", 5, 0)), "was never sent"),
    ("publishes the will of a present robot", lambda run: run.hear(1005, "slam/robot/thread1/will", b"gone"),
     "thread1: declared gone by robot/will"),
    ("reports a present robot as offline", lambda run: run.hear(1005, "slam/gateway/soak/robots/ble1", OFFLINE),
     "ble1: declared gone by gateway/robots"),
    ("reports itself as offline", lambda run: run.hear(1005, "slam/gateway/soak/state", OFFLINE), "the gateway is declared offline"),
    ("publishes all with QoS 0", lambda run: run.change(with_form(qos=0), is_of_robot), "thread2: update: 95 messages with QoS 0, not retained instead of QoS 2"),
    ("publishes QoS 2 with QoS 1", lambda run: run.change(with_form(qos=1), is_of_robot), "QoS 1, not retained instead of QoS 2"),
    ("publishes one message with QoS 0", lambda run: run.change(with_form(qos=0), lambda one: one is run.messages[run.find("ble1", 9)]),
     "ble1: update: 1 messages with QoS 0"),
    ("marks all as retained", lambda run: run.change(with_form(retain=True), is_of_robot), "QoS 1, retained instead of QoS 1, not retained"),
    ("does not retain presence", lambda run: run.change(with_form(retain=False)), "gateway/soak/robots: 3 messages with QoS 1, not retained"),
    ("drops a command and reports delivered", lambda run: run.forget_received("ble1"), "act1 sent at 1005.000 is reported as delivered but"),
    ("sends a command after it reported delivered", lambda run: (run.forget_received("thread2"), run.reach(
        "thread2", 9, "run", "3031", 1008)), "is reported as delivered but"),
    ("sends a command to a robot twice", lambda run: run.reach("thread1", 21, "cmd", "0b00ecff", 1013.03), "again under another message id"),
    ("sends a command to a robot again later", lambda run: run.reach("ble1", 0, "min_com", "0c00ecff", 1009), "after delivered was reported"),
    ("sends a command that it refused", lambda run: run.reach("thread2", 33, "act2", "0d00ecff", 1009.5), "after refused was reported"),
    ("changes a command", lambda run: run.reach("thread1", 34, "cmd", "0a00ecfe", 1005), "got a command that was not sent"),
    ("sends a command to another robot", lambda run: run.reach("thread2", 35, "cmd", "0b00ecff", 1013.1), "got a command that was not sent"),
    ("turns stop into start", lambda run: (run.forget_received("ble1"), run.reach("ble1", 0, "run", "01", 1006.02)),
     "got a command that was not sent"),
    ("reports no outcome", lambda run: run.messages.pop(run.outcome("thread2", "run")), "the command run sent at 1004.000 has no outcome"),
    ("reports no outcome for an unknown robot", lambda run: run.messages.pop(run.outcome("nobody", "act3")), "has no outcome"),
    ("reports a second outcome", lambda run: run.report("thread2", "run", "timeout", 1008), "ended twice: delivered and timeout"),
    ("reports an outcome late", lambda run: run.change(late, lambda one: one is run.messages[run.outcome("ble1", "act6")]), "only after 40.0 s"),
    ("takes too long by its own account", lambda run: (run.messages.pop(run.outcome("thread2", "act2")), run.report(
        "thread2", "act2", "timeout", 1030, 31000)), "31000 ms by its own account"),
]


class Lies(unittest.TestCase):
    def test_accepts_a_correct_daemon(self):
        self.assertEqual(Run().judge(), [])

    def test_detects_each_lie(self):
        for name, lie, expected in LIES:
            with self.subTest(name):
                run = Run()
                lie(run)
                complaints = run.judge()
                self.assertTrue(any(expected in complaint for complaint in complaints), (name, complaints))

    def test_needs_an_outcome_for_each_command_after_the_first_connection(self):
        run = Run()
        run.commands.append(Sent("thread1", "act9", CONNECTED + 5, "00000000"))
        self.assertEqual(len(run.judge()), 1)
        self.assertIn("act9", run.judge()[0])

    def test_accepts_a_command_that_is_sent_again_after_a_crash(self):
        run = Run()
        run.command("thread1", "act5", "0101", KILL - 0.2, "delivered", "act5", 40)
        run.reach("thread1", 41, "act5", "0101", BACK + 0.3)
        run.report("thread1", "act5", "delivered", BACK + 0.4)
        self.assertEqual(run.judge(), [])

    def test_accepts_a_changed_order_for_a_robot_that_the_broker_refused(self):
        run = Run()
        swap(run, run.find("ble1", 30), run.find("ble1", 31))
        self.assertEqual(run.judge(refused=[Trouble(BEGIN, END, 0, refused="ble1")]), [])
        self.assertEqual(len(run.judge(refused=[Trouble(BEGIN, END, 0, refused="thread1")])), 1)
        self.assertEqual(len(run.judge(refused=[Trouble(BEGIN, BEGIN + 0.1, 0, refused="ble1")])), 1)

    def test_accepts_that_stopped_robots_are_declared_gone(self):
        run = Run()
        run.hear(math.nextafter(END, math.inf), "slam/gateway/soak/robots/ble1", OFFLINE)
        self.assertEqual(run.judge(), [])

    def test_reports_a_robot_that_the_witness_has_not_seen(self):
        run = Run()
        self.assertEqual(run.judge(unseen_by_witness="thread2"), ["thread2: the witness has seen none of its messages, so their QoS is unknown"])


if __name__ == "__main__":
    unittest.main()
