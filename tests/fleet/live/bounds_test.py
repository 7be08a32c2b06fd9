# SPDX-License-Identifier: Apache-2.0
"""What the judge of a live run forgives, and what it does not. Run as a test (ctest -R Fleet.Bounds)."""
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
    def test_a_message_that_was_repeated_at_one_gateway_comes_once(self):
        self.assertEqual(bounds().copies([(10, 0, 0), (10.7, 0, 0)], 10, 11), (1, 0))

    def test_at_another_gateway_it_may_come_twice(self):
        self.assertEqual(bounds().copies([(10, 0, 0), (10.7, 0, 0), (13, 1, 0)], 10, 13), (2, 0))

    def test_and_back_from_another_one(self):
        self.assertEqual(bounds().copies([(10, 0, 3), (13, 0, 5)], 10, 13), (2, 0))

    def test_at_the_same_gateway_if_that_died_between(self):
        dies = Absence("gateway killed", 0, 10.3, 10.6)
        self.assertEqual(bounds(dies).copies([(10, 0, 0), (10.7, 0, 0)], 10, 11)[0], 2)
        self.assertEqual(bounds(dies).copies([(10.4, 0, 0), (10.7, 0, 0)], 10, 11)[0], 1)

    def test_a_connection_that_broke_under_it(self):
        broken = bounds(connections=([(0, 20), (21, END)], WHOLE))
        self.assertEqual(broken.copies([(19.5, 0, 0)], 19.6, 21.5), (1, 1))
        self.assertEqual(broken.copies([(19.5, 1, 0)], 19.6, 21.5), (1, 0), "the other gateway's")
        self.assertEqual(broken.copies([(10, 0, 0)], 10.1, 21.5), (1, 0), "it had come long before")
        self.assertEqual(broken.copies([(20.5, 0, 0)], 21.2, 21.5), (1, 0), "it was said after that")

    def test_a_cut_link_is_noticed_later(self):
        cut = bounds(Absence("link cut", 0, 15, 22), connections=([(0, 25), (26, END)], WHOLE))
        self.assertEqual(cut.copies([(14.9, 0, 0)], 14.95, 26.5), (1, 1))
        self.assertEqual(cut.copies([(10, 0, 0)], 10.1, 26.5), (1, 0))

    def test_a_gateway_that_died_has_not_logged_that_its_connection_broke(self):
        dies = bounds(Absence("gateway killed", 0, 15, 18), connections=([(0, 18), (18.1, END)], WHOLE))
        self.assertEqual(dies.copies([(14.9, 0, 0)], 14.95, 18.5), (1, 1))
        self.assertEqual(dies.copies([(10, 0, 0)], 10.1, 18.5), (1, 0))

    def test_a_node_that_was_away_may_harm_the_connection_after_it_as_well(self):
        twice = {"connections": ([(0, 25), (28, 36), (37, END)], WHOLE)}
        stopped = Absence("node stopped", 1, 10, 21)
        self.assertEqual(bounds(stopped, **twice, settle_s=16).copies([(21, 0, 0)], 21.1, 38), (1, 2))
        self.assertEqual(bounds(stopped, **twice).copies([(21, 0, 0)], 21.1, 38), (1, 1))


class Order(unittest.TestCase):
    cut = Absence("link cut", 0, 10, 12)

    def test_whom_a_cut_off_gateway_has_acknowledged_is_overtaken_at_another_one(self):
        self.assertTrue(bounds(self.cut).may_be_overtaken(0, 1, 11, 13))

    def test_not_at_the_same_one_nor_by_way_of_a_whole_one(self):
        self.assertFalse(bounds(self.cut).may_be_overtaken(0, 0, 11, 13))
        self.assertFalse(bounds(self.cut).may_be_overtaken(1, 0, 11, 13))
        self.assertFalse(bounds(self.cut).may_be_overtaken(0, 1, 40, 41))
        self.assertFalse(bounds().may_be_overtaken(0, 1, 40, 41))


class Wills(unittest.TestCase):
    def test_nobody_hears_a_robot_at_a_gateway_that_is_cut_off(self):
        cut = bounds(Absence("link cut", 0, 10, 22), connections=([(0, 18), (23, END)], WHOLE))
        self.assertTrue(cut.may_have_a_will(0, 20))
        self.assertFalse(cut.may_have_a_will(0, 12), "it was asked when the gateway could hear it")
        self.assertFalse(cut.may_have_a_will(0, 24))
        self.assertFalse(cut.may_have_a_will(1, 20))


class Announcements(unittest.TestCase):
    def test_a_gateway_that_is_back_names_its_robots_of_before_until_it_has_read_where_they_are(self):
        back = bounds(connections=([(0, 18), (23, END)], WHOLE))
        self.assertTrue(back.may_announce_anew([0, 1], 23.2, 2.5, earliest=23.2))
        self.assertFalse(back.may_announce_anew([0, 1], 23.2, 6, earliest=23.2))
        self.assertFalse(back.may_announce_anew([0, 1], 30, 2.5, earliest=30))
        self.assertFalse(back.may_announce_anew([0, 1], 0.5, 2.5, earliest=0.5), "it had none before")
        self.assertFalse(back.may_announce_anew([1], 23.2, 2.5, earliest=23.2))

    def test_so_does_one_that_was_stopped_and_whose_connection_stood_it(self):
        back = bounds(Absence("gateway stopped", 0, 10, 20))
        self.assertTrue(back.may_announce_anew([0, 1], 20.3, 2.5, earliest=20.3))
        self.assertFalse(back.may_announce_anew([1], 20.3, 2.5, earliest=20.3))

    def test_it_may_have_done_so_before_an_observer_was_back_to_see_it(self):
        back = bounds(connections=([(0, 18), (23, END)], WHOLE))
        self.assertTrue(back.may_announce_anew([0, 1], 29, 2.5, earliest=22))
        self.assertFalse(back.may_announce_anew([0, 1], 35, 2.5, earliest=29))

    def test_it_cannot_withdraw_them_while_it_has_no_connection_that_lasts(self):
        flaps = bounds(connections=([(0, 18), (23, 24), (30, 30.5), (32, END)], WHOLE))
        self.assertTrue(flaps.may_announce_anew([0, 1], 23.2, 12, earliest=23.2))
        self.assertFalse(flaps.may_announce_anew([0, 1], 23.2, 16, earliest=23.2))
        self.assertFalse(bounds(connections=([(0, 18), (23, END)], WHOLE)).may_announce_anew([0, 1], 23.2, 12, earliest=23.2))

    def test_gateways_that_have_waited_for_a_node_return_with_it(self):
        stopped = bounds(Absence("node stopped", 2, 10, 20))
        self.assertTrue(stopped.may_announce_anew([0, 1], 20.1, 4, earliest=20.1))
        self.assertFalse(stopped.may_announce_anew([0, 1], 20.1, 7, earliest=20.1))
        self.assertFalse(bounds(Absence("gateway killed", 2, 10, 20)).may_announce_anew([0, 1], 20.1, 4, earliest=20.1))

    def test_time_in_which_both_were_away_counts_once(self):
        away = bounds(Absence("node stopped", 0, 10, 14), connections=([(0, 12), (15, END)], [(0, 13), (16, END)]))
        self.assertEqual(away.away_s([0, 1], 8, 20), 6)


class Commands(unittest.TestCase):
    """The robot went from gateway 0 to gateway 1 after 20 s."""

    moved = [(0.0, 0), (20.0, 1)]
    killed = Absence("gateway killed", 0, 18, 24)

    def test_one_that_comes_as_its_robot_goes_may_have_no_outcome(self):
        self.assertTrue(bounds().may_have_no_outcome(19.9, self.moved))
        self.assertTrue(bounds().may_have_no_outcome(20.5, self.moved), "the other gateway has just taken the session")

    def test_not_one_that_had_a_round_trip(self):
        self.assertFalse(bounds().may_have_no_outcome(19, self.moved))
        self.assertFalse(bounds().may_have_no_outcome(25, self.moved))
        self.assertFalse(bounds().may_have_no_outcome(19.9, [(0.0, 0)]))

    def test_so_may_one_that_comes_as_its_gateway_dies(self):
        self.assertTrue(bounds(self.killed).may_have_no_outcome(17.9, self.moved))
        self.assertFalse(bounds(self.killed).may_have_no_outcome(17, self.moved))
        self.assertFalse(bounds(self.killed).may_have_no_outcome(17.9, [(0.0, 1)]), "another one died")

    def test_one_that_waited_for_a_gateway_comes_when_that_is_there(self):
        self.assertFalse(bounds(self.killed).may_have_no_outcome(18.5, self.moved))
        self.assertTrue(bounds(self.killed).may_have_no_outcome(18.5, [*self.moved, (20.8, 0)]), "it has moved on at once")
        self.assertFalse(bounds(self.killed).may_have_no_outcome(9, [*self.moved, (20.8, 0)]), "its gateway was there")

    def test_nor_one_that_comes_as_the_broker_breaks_the_session(self):
        self.assertTrue(bounds().may_have_no_outcome(9.9, [(0.0, 0)], breaks=[10]))
        self.assertFalse(bounds().may_have_no_outcome(9, [(0.0, 0)], breaks=[10]))
        self.assertFalse(bounds().may_have_no_outcome(10.1, [(0.0, 0)], breaks=[10]), "it waits at the broker")

    def test_a_broker_without_a_disk_forgets_everything_when_it_dies(self):
        dies = Absence("node killed", 0, 10, 12)
        self.assertTrue(bounds(dies, loses_all=True).may_be_forgotten(11))
        self.assertFalse(bounds(dies, loses_all=True).may_be_forgotten(50))
        self.assertFalse(bounds(dies).may_be_forgotten(11), "a cluster does not")

    def test_one_that_was_on_the_air_when_the_robot_went_may_be_obeyed(self):
        self.assertTrue(bounds().may_be_obeyed_all_the_same(0, 10, 11, moves=[10.5]))
        self.assertFalse(bounds().may_be_obeyed_all_the_same(0, 10, 11, moves=[9, 12]))

    def test_or_when_its_gateway_was_away(self):
        stopped = bounds(Absence("gateway stopped", 0, 10.2, 14))
        self.assertTrue(stopped.may_be_obeyed_all_the_same(0, 10, 15, moves=[]))
        self.assertFalse(stopped.may_be_obeyed_all_the_same(1, 10, 15, moves=[]))

    def test_an_outcome_comes_again_only_if_that_gateways_connection_broke(self):
        broken = bounds(connections=([(0, 20), (21, END)], WHOLE))
        self.assertEqual(broken.may_come_again(0, 19.4, 19.5, 21.5), 1)
        self.assertEqual(broken.may_come_again(1, 19.4, 19.5, 21.5), 0)
        self.assertEqual(broken.may_come_again(0, 30, 30, 31), 0)

    def test_the_first_copy_may_lie_in_a_socket_that_the_gateway_has_given_up(self):
        broken = bounds(connections=([(0, 20), (21, END)], WHOLE))
        self.assertEqual(broken.may_come_again(0, 19.4, 21.5, 24), 1)
        self.assertEqual(broken.may_come_again(0, 20.5, 21.5, 24), 0, "it was said after that")
        self.assertEqual(broken.may_come_again(0, 10, 10.1, 24), 0, "it had come long before")

    def test_once_more_for_each_connection_that_broke(self):
        twice = bounds(connections=([(0, 20), (21, 21.4), (22, END)], WHOLE))
        self.assertEqual(twice.may_come_again(0, 19.9, 21.5, 24), 2)

    def test_time_in_which_something_was_taken_away(self):
        self.assertEqual(bounds(self.killed, Absence("node stopped", 1, 30, 31)).taken_away_s(20, 40), 5)


class Presence(unittest.TestCase):
    @staticmethod
    def view(at, gateway, state, is_retained=False):
        return at, f"p/gateway/{gateway}/robots/r1", f'{{"state":"{state}"}}'.encode() if state else b"", is_retained

    def test_two_at_a_time_are_a_contradiction_until_one_goes(self):
        views = [self.view(1, "a", "online"), self.view(5, "b", "online"), self.view(8, "a", "")]
        self.assertEqual(list(contradictions(views, "r1")), [(5, 3, ["a", "b"], 5)])
        self.assertEqual(list(contradictions(views, "r2")), [])

    def test_who_leaves_first_or_is_offline_is_none(self):
        self.assertEqual(list(contradictions([self.view(1, "a", "online"), self.view(2, "a", "offline"),
                                              self.view(5, "b", "online")], "r1")), [])

    def test_it_ends_when_the_observer_is_cut_off(self):
        views = [self.view(1, "a", "online"), self.view(5, "b", "online"), (6, None, None, False)]
        self.assertEqual(list(contradictions(views, "r1")), [(5, 1, ["a", "b"], 5)])

    def test_what_was_retained_may_have_begun_while_the_observer_was_cut_off(self):
        views = [(2, None, None, False), self.view(6, "a", "online", True), self.view(6, "b", "online", True), self.view(7, "a", "")]
        self.assertEqual(list(contradictions(views, "r1")), [(6, 1, ["a", "b"], 2)])

    def test_a_gateway_shows_a_robot_when_it_names_it_anew(self):
        views = [self.view(1, "gw-0", "online"), self.view(3, "gw-0", "online"), self.view(5, "gw-1", "online"), self.view(5.1, "gw-0", ""),
                 (6, None, None, False), self.view(7, "gw-1", "online", True), self.view(9, "gw-0", "online")]
        seen_by_another = [(at + 0.1, *rest) for at, *rest in views]
        self.assertEqual(showings([views, seen_by_another], ["r1"]), {"r1": [(1, 0), (5, 1), (9, 0)]})


if __name__ == "__main__":
    unittest.main()
