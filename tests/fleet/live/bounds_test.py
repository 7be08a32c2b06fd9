# SPDX-License-Identifier: Apache-2.0
"""The bounds of a live run: what the judge forgives, and what it does not. Run as a test (ctest -R Fleet.Bounds)."""
import pathlib
import sys
import unittest

sys.path.insert(0, str(pathlib.Path(__file__).parent))
from bounds import SETTLE_S, Absence, Bounds  # noqa: E402
from presence import contradictions, showings  # noqa: E402

END = float("inf")
WHOLE = [(0.0, END)]


def bounds(*absences, connections=(WHOLE, WHOLE), settle_s=SETTLE_S, **more):
    return Bounds(list(absences), list(connections), subscribed_s=1, settle_s=settle_s, **more)


class Copies(unittest.TestCase):
    def test_expects_one_copy_of_a_message_repeated_at_one_gateway(self):
        self.assertEqual(bounds().copies([(10, 0, 0), (10.7, 0, 0)], 10, 11), (1, 0))

    def test_allows_two_copies_of_a_message_repeated_at_another_gateway(self):
        self.assertEqual(bounds().copies([(10, 0, 0), (10.7, 0, 0), (13, 1, 0)], 10, 13), (2, 0))

    def test_allows_two_copies_after_a_return_to_the_gateway(self):
        self.assertEqual(bounds().copies([(10, 0, 3), (13, 0, 5)], 10, 13), (2, 0))

    def test_allows_two_copies_if_the_gateway_died_in_between(self):
        dies = Absence("gateway killed", 0, 10.3, 10.6)
        self.assertEqual(bounds(dies).copies([(10, 0, 0), (10.7, 0, 0)], 10, 11)[0], 2)
        self.assertEqual(bounds(dies).copies([(10.4, 0, 0), (10.7, 0, 0)], 10, 11)[0], 1)

    def test_allows_one_copy_more_for_a_broken_connection(self):
        broken = bounds(connections=([(0, 20), (21, END)], WHOLE))
        self.assertEqual(broken.copies([(19.5, 0, 0)], 19.6, 21.5), (1, 1))
        self.assertEqual(broken.copies([(19.5, 1, 0)], 19.6, 21.5), (1, 0), "another gateway's connection broke")
        self.assertEqual(broken.copies([(10, 0, 0)], 10.1, 21.5), (1, 0), "it arrived long before")
        self.assertEqual(broken.copies([(20.5, 0, 0)], 21.2, 21.5), (1, 0), "it was sent after the break")

    def test_counts_a_cut_link_from_the_cut_on(self):
        cut = bounds(Absence("link cut", 0, 15, 22), connections=([(0, 25), (26, END)], WHOLE))
        self.assertEqual(cut.copies([(14.9, 0, 0)], 14.95, 26.5), (1, 1))
        self.assertEqual(cut.copies([(10, 0, 0)], 10.1, 26.5), (1, 0))

    def test_counts_a_killed_gateways_connection_from_the_kill_on(self):
        dies = bounds(Absence("gateway killed", 0, 15, 18), connections=([(0, 18), (18.1, END)], WHOLE))
        self.assertEqual(dies.copies([(14.9, 0, 0)], 14.95, 18.5), (1, 1))
        self.assertEqual(dies.copies([(10, 0, 0)], 10.1, 18.5), (1, 0))

    def test_counts_connections_that_break_soon_after_a_node_is_back(self):
        twice = {"connections": ([(0, 25), (28, 36), (37, END)], WHOLE)}
        stopped = Absence("node stopped", 1, 10, 21)
        self.assertEqual(bounds(stopped, **twice, settle_s=16).copies([(21, 0, 0)], 21.1, 38), (1, 2))
        self.assertEqual(bounds(stopped, **twice).copies([(21, 0, 0)], 21.1, 38), (1, 1))


class Order(unittest.TestCase):
    cut = Absence("link cut", 0, 10, 12)

    def test_allows_overtaking_a_message_at_a_cut_off_gateway(self):
        self.assertTrue(bounds(self.cut).may_be_overtaken(0, 1, 11, 13))

    def test_allows_no_overtaking_at_the_same_or_at_a_connected_gateway(self):
        self.assertFalse(bounds(self.cut).may_be_overtaken(0, 0, 11, 13))
        self.assertFalse(bounds(self.cut).may_be_overtaken(1, 0, 11, 13))
        self.assertFalse(bounds(self.cut).may_be_overtaken(0, 1, 40, 41))
        self.assertFalse(bounds().may_be_overtaken(0, 1, 40, 41))


class Wills(unittest.TestCase):
    def test_allows_the_will_of_a_robot_at_a_cut_off_gateway(self):
        cut = bounds(Absence("link cut", 0, 10, 22), connections=([(0, 18), (23, END)], WHOLE))
        self.assertTrue(cut.may_have_a_will(0, 20))
        self.assertFalse(cut.may_have_a_will(0, 12), "the gateway was still connected")
        self.assertFalse(cut.may_have_a_will(0, 24))
        self.assertFalse(cut.may_have_a_will(1, 20))


class Announcements(unittest.TestCase):
    def test_allows_a_returning_gateway_to_show_its_former_robots_for_a_while(self):
        back = bounds(connections=([(0, 18), (23, END)], WHOLE))
        self.assertTrue(back.may_show_former_robots([0, 1], 23.2, 2.5, earliest=23.2))
        self.assertFalse(back.may_show_former_robots([0, 1], 23.2, 6, earliest=23.2))
        self.assertFalse(back.may_show_former_robots([0, 1], 30, 2.5, earliest=30))
        self.assertFalse(back.may_show_former_robots([0, 1], 0.5, 2.5, earliest=0.5), "its first connection")
        self.assertFalse(back.may_show_former_robots([1], 23.2, 2.5, earliest=23.2))

    def test_allows_that_for_a_stopped_gateway_that_kept_its_connection(self):
        back = bounds(Absence("gateway stopped", 0, 10, 20))
        self.assertTrue(back.may_show_former_robots([0, 1], 20.3, 2.5, earliest=20.3))
        self.assertFalse(back.may_show_former_robots([1], 20.3, 2.5, earliest=20.3))

    def test_counts_from_the_earliest_possible_time_for_an_observer_that_was_cut_off(self):
        back = bounds(connections=([(0, 18), (23, END)], WHOLE))
        self.assertTrue(back.may_show_former_robots([0, 1], 29, 2.5, earliest=22))
        self.assertFalse(back.may_show_former_robots([0, 1], 35, 2.5, earliest=29))

    def test_allows_more_time_while_its_connections_break(self):
        flaps = bounds(connections=([(0, 18), (23, 24), (30, 30.5), (32, END)], WHOLE))
        self.assertTrue(flaps.may_show_former_robots([0, 1], 23.2, 12, earliest=23.2))
        self.assertFalse(flaps.may_show_former_robots([0, 1], 23.2, 16, earliest=23.2))
        self.assertFalse(bounds(connections=([(0, 18), (23, END)], WHOLE)).may_show_former_robots([0, 1], 23.2, 12, earliest=23.2))

    def test_counts_the_return_of_a_node_as_one_of_all_gateways(self):
        stopped = bounds(Absence("node stopped", 2, 10, 20))
        self.assertTrue(stopped.may_show_former_robots([0, 1], 20.1, 4, earliest=20.1))
        self.assertFalse(stopped.may_show_former_robots([0, 1], 20.1, 7, earliest=20.1))
        self.assertFalse(bounds(Absence("gateway killed", 2, 10, 20)).may_show_former_robots([0, 1], 20.1, 4, earliest=20.1))

    def test_counts_overlapping_absences_once(self):
        away = bounds(Absence("node stopped", 0, 10, 14), connections=([(0, 12), (15, END)], [(0, 13), (16, END)]))
        self.assertEqual(away.away_s([0, 1], 8, 20), 6)


class Commands(unittest.TestCase):
    """The robot moved from gateway 0 to gateway 1 after 20 s."""

    moved = [(0.0, 0), (20.0, 1)]
    killed = Absence("gateway killed", 0, 18, 24)

    def test_allows_no_outcome_for_a_command_during_a_move(self):
        self.assertTrue(bounds().may_have_no_outcome(19.9, self.moved))
        self.assertTrue(bounds().may_have_no_outcome(20.5, self.moved), "the other gateway takes over the session")

    def test_needs_an_outcome_for_a_command_a_round_trip_before_a_move(self):
        self.assertFalse(bounds().may_have_no_outcome(19, self.moved))
        self.assertFalse(bounds().may_have_no_outcome(25, self.moved))
        self.assertFalse(bounds().may_have_no_outcome(19.9, [(0.0, 0)]))

    def test_allows_no_outcome_for_a_command_as_its_gateway_dies(self):
        self.assertTrue(bounds(self.killed).may_have_no_outcome(17.9, self.moved))
        self.assertFalse(bounds(self.killed).may_have_no_outcome(17, self.moved))
        self.assertFalse(bounds(self.killed).may_have_no_outcome(17.9, [(0.0, 1)]), "another one died")

    def test_needs_an_outcome_for_a_command_that_waited_for_a_gateway(self):
        self.assertFalse(bounds(self.killed).may_have_no_outcome(18.5, self.moved))
        self.assertTrue(bounds(self.killed).may_have_no_outcome(18.5, [*self.moved, (20.8, 0)]), "the robot moved on at once")
        self.assertFalse(bounds(self.killed).may_have_no_outcome(9, [*self.moved, (20.8, 0)]), "its gateway was running")

    def test_allows_no_outcome_for_a_command_as_the_broker_breaks_the_session(self):
        self.assertTrue(bounds().may_have_no_outcome(9.9, [(0.0, 0)], breaks=[10]))
        self.assertFalse(bounds().may_have_no_outcome(9, [(0.0, 0)], breaks=[10]))
        self.assertFalse(bounds().may_have_no_outcome(10.1, [(0.0, 0)], breaks=[10]), "it waits at the broker")

    def test_allows_a_broker_without_a_disk_to_lose_commands_when_it_dies(self):
        dies = Absence("node killed", 0, 10, 12)
        self.assertTrue(bounds(dies, loses_all=True).may_be_lost_by_broker(11))
        self.assertFalse(bounds(dies, loses_all=True).may_be_lost_by_broker(50))
        self.assertFalse(bounds(dies).may_be_lost_by_broker(11), "a cluster loses no commands")

    def test_allows_a_timed_out_command_to_be_obeyed_during_a_move(self):
        self.assertTrue(bounds().may_be_obeyed_despite_timeout(0, 10, 11, moves=[10.5]))
        self.assertFalse(bounds().may_be_obeyed_despite_timeout(0, 10, 11, moves=[9, 12]))

    def test_allows_a_timed_out_command_to_be_obeyed_while_its_gateway_fails(self):
        stopped = bounds(Absence("gateway stopped", 0, 10.2, 14))
        self.assertTrue(stopped.may_be_obeyed_despite_timeout(0, 10, 15, moves=[]))
        self.assertFalse(stopped.may_be_obeyed_despite_timeout(1, 10, 15, moves=[]))

    def test_allows_an_outcome_again_only_if_that_gateways_connection_broke(self):
        broken = bounds(connections=([(0, 20), (21, END)], WHOLE))
        self.assertEqual(broken.may_come_again(0, 19.4, 19.5, 21.5), 1)
        self.assertEqual(broken.may_come_again(1, 19.4, 19.5, 21.5), 0)
        self.assertEqual(broken.may_come_again(0, 30, 30, 31), 0)

    def test_allows_an_outcome_again_from_a_socket_that_the_gateway_closed(self):
        broken = bounds(connections=([(0, 20), (21, END)], WHOLE))
        self.assertEqual(broken.may_come_again(0, 19.4, 21.5, 24), 1)
        self.assertEqual(broken.may_come_again(0, 20.5, 21.5, 24), 0, "it was published after the break")
        self.assertEqual(broken.may_come_again(0, 10, 10.1, 24), 0, "it arrived long before")

    def test_allows_an_outcome_once_more_for_each_broken_connection(self):
        twice = bounds(connections=([(0, 20), (21, 21.4), (22, END)], WHOLE))
        self.assertEqual(twice.may_come_again(0, 19.9, 21.5, 24), 2)

    def test_adds_up_the_time_of_faults(self):
        self.assertEqual(bounds(self.killed, Absence("node stopped", 1, 30, 31)).fault_s(20, 40), 5)


class Presence(unittest.TestCase):
    @staticmethod
    def view(at, gateway, state, is_retained=False):
        return at, f"p/gateway/{gateway}/robots/r1", f'{{"state":"{state}"}}'.encode() if state else b"", is_retained

    def test_finds_two_gateways_that_show_a_robot_until_one_withdraws(self):
        views = [self.view(1, "a", "online"), self.view(5, "b", "online"), self.view(8, "a", "")]
        self.assertEqual(list(contradictions(views, "r1")), [(5, 3, ["a", "b"], 5)])
        self.assertEqual(list(contradictions(views, "r2")), [])

    def test_finds_no_contradiction_if_one_gateway_shows_offline_first(self):
        self.assertEqual(list(contradictions([self.view(1, "a", "online"), self.view(2, "a", "offline"),
                                              self.view(5, "b", "online")], "r1")), [])

    def test_ends_a_contradiction_when_the_observer_is_cut_off(self):
        views = [self.view(1, "a", "online"), self.view(5, "b", "online"), (6, None, None, False)]
        self.assertEqual(list(contradictions(views, "r1")), [(5, 1, ["a", "b"], 5)])

    def test_begins_a_retained_contradiction_at_the_cut_at_the_earliest(self):
        views = [(2, None, None, False), self.view(6, "a", "online", True), self.view(6, "b", "online", True), self.view(7, "a", "")]
        self.assertEqual(list(contradictions(views, "r1")), [(6, 1, ["a", "b"], 2)])

    def test_lists_each_time_that_a_gateway_begins_to_show_a_robot(self):
        views = [self.view(1, "gw-0", "online"), self.view(3, "gw-0", "online"), self.view(5, "gw-1", "online"), self.view(5.1, "gw-0", ""),
                 (6, None, None, False), self.view(7, "gw-1", "online", True), self.view(9, "gw-0", "online")]
        seen_by_another = [(at + 0.1, *rest) for at, *rest in views]
        self.assertEqual(showings([views, seen_by_another], ["r1"]), {"r1": [(1, 0), (5, 1), (9, 0)]})


if __name__ == "__main__":
    unittest.main()
