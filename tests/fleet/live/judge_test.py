# SPDX-License-Identifier: Apache-2.0
"""How the judge of a live run counts outcomes, obeyed commands, messages of BLE robots, and false wills. Run as a test (ctest -R
Fleet.Judge)."""
import json
import pathlib
import sys
import unittest
from types import SimpleNamespace

sys.path[:0] = [str(pathlib.Path(__file__).parent), str(pathlib.Path(__file__).parents[2] / "soak")]
from acts import has_second_outcome  # noqa: E402
from ble_mesh import BleMesh  # noqa: E402
from bounds import Absence, Bounds  # noqa: E402
from commands import Command, Commands, outcomes_of  # noqa: E402
from judge import Findings, judge_order, judge_will  # noqa: E402
from robot import Robot  # noqa: E402
from streams import Message  # noqa: E402

END = float("inf")
WHOLE = [(0.0, END)]
BROKE_AT_20 = [(0.0, 20.0), (21.0, END)]


def outcome(at, gateway, what="delivered", after_ms=100, is_late=False, kind="c1", why=""):
    payload = json.dumps({"type": kind, "outcome": what, "after_ms": after_ms, "why": why}).encode()
    return Message(at, f"p/gateway/gw-{gateway}/commands/r1", payload, is_late)


def counted(commanded, *messages, connections=(BROKE_AT_20, WHOLE)):
    """Returns (outcomes that count, outcomes that are forgiven) of one command."""
    commands, findings = Commands("p", None, None), Findings()
    commands.bounds, commands.findings = Bounds([], list(connections), subscribed_s=1), findings
    kept = commands.without_repetitions(commanded, outcomes_of(messages, {("r1", "c1"): commanded})["r1", "c1"])
    return len(kept), findings.counts["outcomes_repeated_when_broker_broke"]


class Repetitions(unittest.TestCase):
    def test_forgives_an_equal_outcome_after_the_connection_broke(self):
        self.assertEqual(counted(19.5, outcome(19.6, 0), outcome(21.5, 0)), (1, 1))

    def test_forgives_an_equal_outcome_whose_first_copy_was_in_a_closed_socket(self):
        self.assertEqual(counted(19.5, outcome(21.5, 0), outcome(25, 0)), (1, 1))

    def test_counts_an_equal_outcome_if_no_connection_broke(self):
        self.assertEqual(counted(19.5, outcome(19.6, 0), outcome(21.5, 0), connections=(WHOLE, WHOLE)), (2, 0))
        self.assertEqual(counted(30, outcome(30.1, 0), outcome(30.5, 0)), (2, 0), "published after the break")

    def test_counts_an_equal_outcome_if_another_gateways_connection_broke(self):
        self.assertEqual(counted(19.5, outcome(19.6, 1), outcome(21.5, 1)), (2, 0))

    def test_forgives_one_equal_outcome_for_each_break(self):
        self.assertEqual(counted(19.5, outcome(19.6, 0), outcome(21.5, 0), outcome(21.9, 0)), (2, 1))

    def test_counts_a_different_outcome(self):
        self.assertEqual(counted(19.5, outcome(19.6, 0), outcome(21.5, 0, after_ms=101)), (2, 0))
        self.assertEqual(counted(19.5, outcome(19.6, 0), outcome(21.5, 0, "refused")), (2, 0))

    def test_counts_an_equal_outcome_of_another_gateway(self):
        self.assertEqual(counted(19.5, outcome(19.6, 0), outcome(21.5, 1)), (2, 0))


class Obedience(unittest.TestCase):
    """A robot that was at gateway 0 all the time, without faults."""

    def kinds(self, sent, messages, obeyed, places=((0.0, 0),), is_clean=False, bare=(), hears_all=True):
        """Returns the findings. `sent`: (type, when) of commands that the broker has confirmed. `obeyed`: (when, payload)."""
        commands, findings = Commands("p", SimpleNamespace(confirmed=lambda: set(range(100))), None), Findings()
        for number, (kind, at) in enumerate(sent):
            command = Command("r1", kind, at, number)
            if kind == "run":
                commands.equal["r1"].append(command)
            else:
                commands.distinct["r1", kind] = command
        commands.count = 100
        robot = SimpleNamespace(name="r1", places=list(places), bare=list(bare), is_clean=is_clean, commands=[(at, 0, payload) for at, payload in obeyed],
                                obeyed=lambda payload: sum(1 for _, each in obeyed if each == payload))
        bounds = Bounds([], [WHOLE, WHOLE], subscribed_s=1, hears_all=hears_all)
        self.verdict = commands.judge({"r1": robot}, {}, outcomes_of(messages, commands.times()), bounds, findings, again_s=0)
        return dict(findings.counts)

    def test_accepts_a_command_obeyed_once_with_one_outcome(self):
        self.assertEqual(self.kinds([("c1", 10)], [outcome(10.1, 0)], [(10.05, "c1")]), {})
        self.assertEqual(self.verdict["outcomes"], {"delivered": 1})

    def test_reports_a_command_obeyed_twice(self):
        self.assertEqual(self.kinds([("c1", 10)], [outcome(10.1, 0)], [(10.05, "c1"), (10.5, "c1")]), {"obeyed_twice": 1})

    def test_reports_two_outcomes(self):
        self.assertEqual(self.kinds([("c1", 10)], [outcome(10.1, 0), outcome(40, 1, "timeout")], [(10.05, "c1")]), {"outcomes_doubled": 1})

    def test_reports_a_missing_outcome(self):
        self.assertEqual(self.kinds([("c1", 10)], [], []), {"outcomes_missing": 1})
        self.assertEqual(self.verdict["without_outcome"], 1)

    def test_forgives_a_missing_outcome_when_the_robot_moved_just_then(self):
        self.assertEqual(self.kinds([("c1", 10)], [], [], places=[(0.0, 0), (10.1, 1)]), {"lost_at_a_move": 1})
        self.assertEqual(self.verdict["without_outcome"], 1)

    def test_forgives_a_missing_outcome_on_mqtt_3_while_the_robot_had_no_subscription(self):
        bare = {"places": [(0.0, 0), (9.9, 1)], "bare": [(9.9, 10.4)]}
        self.assertEqual(self.kinds([("c1", 10)], [], [], hears_all=False, **bare), {"without_subscription": 1})
        self.assertEqual(self.kinds([("c1", 10)], [], [], **bare), {"lost_at_a_move": 1})
        self.assertEqual(self.kinds([("c1", 10.5)], [], [], hears_all=False, **bare), {"lost_at_a_move": 1})

    def test_reports_a_late_outcome(self):
        self.assertEqual(self.kinds([("c1", 10)], [outcome(42, 0)], [(10, "c1")]), {})
        self.assertEqual(self.kinds([("c1", 10)], [outcome(44, 0)], [(10, "c1")]), {"outcomes_late": 1})

    def test_reports_delivered_if_the_robot_did_not_obey(self):
        self.assertEqual(self.kinds([("c1", 10)], [outcome(10.1, 0)], []), {"delivered_but_not_obeyed": 1})

    def test_reports_an_outcome_sent(self):
        self.assertEqual(self.kinds([("c1", 10)], [outcome(10.1, 0, "sent")], [(10.05, "c1")]), {"sent_at_qos_0": 1})

    def test_reports_a_refused_command_that_was_obeyed(self):
        moved = [(0.0, 0), (10.07, 1)]
        self.assertEqual(self.kinds([("c1", 10)], [outcome(10.1, 0, "refused")], [(10.05, "c1")], moved), {"obeyed_though_refused": 1})
        self.assertEqual(self.kinds([("c1", 10)], [outcome(10.1, 0, "timeout")], [(10.05, "c1")], moved), {"obeyed_despite_timeout": 1})
        self.assertEqual(self.kinds([("c1", 10)], [outcome(10.1, 0, "timeout")], [(10.05, "c1")]), {"obeyed_though_refused": 1})

    def test_counts_equal_commands_and_their_outcomes(self):
        sent, reported = [("run", 10), ("run", 10.5)], [outcome(10.1, 0, kind="run"), outcome(10.6, 0, kind="run")]
        self.assertEqual(self.kinds(sent, reported, [(10.05, "1"), (10.55, "1")]), {})
        self.assertEqual(self.kinds(sent, reported, [(10.05, "1"), (10.55, "1"), (10.6, "1")]), {"obeyed_twice": 1, "obeyed_though_refused": 1})
        self.assertEqual(self.kinds(sent, [*reported, outcome(11, 1, kind="run")], [(10.05, "1"), (10.55, "1")]),
                         {"outcomes_doubled": 1, "delivered_but_not_obeyed": 1})
        self.assertEqual(self.kinds(sent, reported[:1], [(10.05, "1")]), {"outcomes_missing": 1})
        self.assertEqual(self.kinds(sent, reported, [(10.05, "1")]), {"delivered_but_not_obeyed": 1})

    def test_finds_which_of_equal_commands_has_no_outcome(self):
        moved, sent = [(0.0, 0), (20.2, 1)], [("run", 10), ("run", 15), ("run", 20)]
        reported = [outcome(10.1, 0, kind="run"), outcome(15.1, 0, kind="run")]
        self.assertEqual(self.kinds(sent, reported, [(10, "1"), (15, "1")], moved), {"lost_at_a_move": 1})
        reported = [outcome(10.1, 0, kind="run"), outcome(20.4, 1, kind="run")]
        self.assertEqual(self.kinds(sent, reported, [(10, "1"), (20.3, "1")], moved), {"outcomes_missing": 1})

    def test_assigns_outcomes_to_waiting_equal_commands_in_order(self):
        moved = {"places": [(0.0, 0), (12.9, 1)], "bare": [(12.9, 14.2)], "hears_all": False}
        sent = [("run", 10), ("run", 11), ("run", 12), ("run", 13), ("run", 14), ("run", 15)]
        waited = [outcome(13.5 + i / 10, 1, "refused", kind="run", why="waited at the broker until ...") for i in range(3)]
        reported = [outcome(10.1, 0, kind="run"), *waited, outcome(15.1, 1, kind="run")]
        self.assertEqual(self.kinds(sent, reported, [(10, "1"), (15, "1")], **moved), {"without_subscription": 1})
        self.assertEqual(self.kinds(sent, reported[:1] + reported[2:], [(10, "1"), (15, "1")], **moved), {"without_subscription": 2})

    def test_reports_a_refused_equal_command_that_was_obeyed(self):
        sent, reported = [("run", 10), ("run", 10.5)], [outcome(10.1, 0, kind="run"), outcome(10.6, 0, "refused", kind="run")]
        self.assertEqual(self.kinds(sent, reported, [(10.05, "1")]), {})
        self.assertEqual(self.kinds(sent, reported, [(10.05, "1"), (10.55, "1")]), {"obeyed_though_refused": 1})

    def test_reports_a_kept_session_without_its_subscription(self):
        refused = [outcome(10.1, 0, "refused", why="the robot has not subscribed to p/server/r1/c1")]
        self.assertEqual(self.kinds([("c1", 10)], refused, []), {"subscription_lost": 1})
        self.assertEqual(self.kinds([("c1", 10)], refused, [], is_clean=True), {})

    def test_bounds_the_commands_without_an_outcome(self):
        sent = [(f"c{number}", 10) for number in range(3)]
        self.assertEqual(self.kinds(sent, [], [], places=[(0.0, 0), (10.1, 1)]), {"lost_at_a_move": 3, "too_many_lost_at_moves": 1})


class Cuts(unittest.TestCase):
    """Outcomes of one command, as (payload, cuts before it came)."""

    def test_accepts_one_equal_outcome_for_each_cut(self):
        self.assertFalse(has_second_outcome([], 3))
        self.assertFalse(has_second_outcome([(b"a", 3)], 3))
        self.assertFalse(has_second_outcome([(b"a", 3), (b"a", 4)], 3))
        self.assertFalse(has_second_outcome([(b"a", 4), (b"a", 4)], 3), "both copies came after the cut")

    def test_detects_more_equal_outcomes_than_cuts(self):
        self.assertTrue(has_second_outcome([(b"a", 3), (b"a", 3)], 3))
        self.assertTrue(has_second_outcome([(b"a", 3), (b"a", 4), (b"a", 4)], 3))

    def test_detects_a_different_outcome(self):
        self.assertTrue(has_second_outcome([(b"a", 3), (b"b", 4)], 3))


class LateOutcomes(unittest.TestCase):
    def test_calculates_the_time_of_a_late_outcome(self):
        said = outcomes_of([outcome(40, 0, after_ms=500, is_late=True)], {("r1", "c1"): 10})["r1", "c1"]
        self.assertEqual((said[0].at, said[0].is_late), (10.5, True))

    def test_takes_the_time_of_a_live_outcome_from_its_arrival(self):
        said = outcomes_of([outcome(40, 0, after_ms=500)], {("r1", "c1"): 10})["r1", "c1"]
        self.assertEqual((said[0].at, said[0].is_late), (40, False))


class Order(unittest.TestCase):
    """Gateway 0 was cut off from 20 to 21, and its robot moved to another one."""

    @staticmethod
    def kinds(sent, came):
        robot = SimpleNamespace(name="r1", sent=sent, acknowledged_by=dict.fromkeys(sent, 0), tries={9: [(22.5, 1, 1)]})
        findings, number = Findings(), max(sent)
        judge_order(Bounds([], [BROKE_AT_20, WHOLE], subscribed_s=1), robot, number, 9, {("r1", each): [at] for each, at in came.items()},
                    findings)
        return dict(findings.counts)

    def test_forgives_a_message_overtaken_while_on_disk(self):
        self.assertEqual(self.kinds({1: 20.5}, {1: 23}), {"overtaken_at_a_roam": 1})

    def test_forgives_messages_queued_behind_it_after_the_cut(self):
        self.assertEqual(self.kinds({1: 20.5, 2: 21.2, 3: 21.6}, {1: 23, 2: 23.1, 3: 23.2}), {"overtaken_at_a_roam": 1})

    def test_reports_an_overtaken_message_after_the_queue_was_empty(self):
        self.assertEqual(self.kinds({1: 20.5, 2: 22}, {1: 21.5, 2: 23}), {"out_of_order": 1})


class Wills(unittest.TestCase):
    """Gateway 0 was cut off from 20 to 26."""

    @staticmethod
    def kinds(at, *places):
        robot, findings = Robot.__new__(Robot), Findings()
        robot.name, robot.places = "r1", list(places)
        judge_will(Bounds([], [[(0.0, 20.0), (26.0, END)], WHOLE], subscribed_s=1), robot, at, findings)
        return dict(findings.counts)

    def test_forgives_the_will_of_a_robot_at_a_cut_off_gateway(self):
        self.assertEqual(self.kinds(25, (0, 0)), {"wills_at_cut_off_gateways": 1})
        self.assertEqual(self.kinds(25, (0, 1)), {"false_wills": 1})

    def test_forgives_the_will_of_a_robot_that_has_just_left_it(self):
        self.assertEqual(self.kinds(25, (0, 0), (24.5, 1)), {"wills_at_cut_off_gateways": 1})
        self.assertEqual(self.kinds(25, (0, 0), (23.5, 1)), {"false_wills": 1})


class CopiesOfBleRobots(unittest.TestCase):
    stands_still = Absence("node stopped", 1, 10, 13)

    @staticmethod
    def kinds(changes, came, *absences):
        mesh, findings = BleMesh.__new__(BleMesh), Findings()
        mesh.gateways, mesh.names = range(2), {"robot0": "ble-0100"}
        bounds = Bounds(list(absences), [WHOLE, WHOLE], subscribed_s=1)
        mesh.judge_copies({("ble-0100", 1): ("aa", 10.1)}, {("ble-0100", "aa"): came}, {"ble-0100": changes}, bounds, findings)
        return dict(findings.counts)

    def test_forgives_a_second_copy_when_another_gateway_serves_the_robot(self):
        self.assertEqual(self.kinds([11.0], [10.2, 11.5]), {"ble_doubled": 1})
        self.assertEqual(self.kinds([], [10.2, 11.5]), {"ble_doubled_beyond_bound": 1})

    def test_forgives_one_copy_for_each_change(self):
        self.assertEqual(self.kinds([11.0], [10.2, 11.5, 11.6]), {"ble_doubled": 1, "ble_doubled_beyond_bound": 1})

    def test_forgives_copies_behind_presence_while_a_node_is_stopped(self):
        self.assertEqual(self.kinds([11.3], [12.7, 13.2], self.stands_still), {"ble_doubled": 1})
        self.assertEqual(self.kinds([11.3], [12.7, 13.2]), {"ble_doubled_beyond_bound": 1})
        self.assertEqual(self.kinds([9.0], [12.7, 13.2], self.stands_still), {"ble_doubled_beyond_bound": 1}, "the change was long before")


if __name__ == "__main__":
    unittest.main()
