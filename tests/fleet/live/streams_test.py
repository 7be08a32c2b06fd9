# SPDX-License-Identifier: Apache-2.0
"""What follows from what live and kept observers were sent. Run as a test (ctest -R Fleet.Streams)."""
import pathlib
import sys
import unittest

sys.path.insert(0, str(pathlib.Path(__file__).parent))
from streams import Stream, late_notes, messages_of, unobserved_s  # noqa: E402

TOPIC = "p/robot/r1/note"


def stream(*events, is_kept=False, anytime=False):
    """`events`: (time, "up"), (time, "up anew": the session was lost), (time, "down"), or (time, number) with "dup" behind it perhaps."""
    made = Stream(is_kept, anytime)
    for at, what, *flags in events:
        if what in ("up", "up anew"):
            made.begin_connection(at, has_session=what == "up" and bool(made.connections))
        elif what == "down":
            made.end_connection(at)
        else:
            made.add(at, TOPIC, str(what).encode(), "dup" in flags)
    return made


def live(*events):
    return stream(*events)


def kept(*events, anytime=False):
    return stream(*events, is_kept=True, anytime=anytime)


def came(*streams):
    """(time, number, whether it came late) of each copy."""
    return [(each.at, int(each.payload), each.is_late) for each in messages_of(streams)]


UP = (0, "up")


class Messages(unittest.TestCase):
    def test_what_all_have_came_once_at_the_time_of_the_live_one(self):
        self.assertEqual(came(live(UP, (1, 7)), kept(UP, (1.2, 7)), kept(UP, (1.3, 7))), [(1, 7, False)])

    def test_what_came_while_no_live_observer_was_there_came_late(self):
        self.assertEqual(came(live(UP, (1, "down"), (5, "up")), kept(UP, (1, "down"), (6, "up"), (6.1, 7))), [(6.1, 7, True)])

    def test_live_observers_know_best_how_often(self):
        self.assertEqual(len(came(live(UP, (1, 7), (2, 7)), live(UP, (1, 7), (1.5, "down")))), 2)
        self.assertEqual(came(live(UP, (1, 7)), kept(UP, (1, 7), (3, 7))), [(1, 7, False)])

    def test_a_second_copy_that_came_while_they_were_away_is_not_hidden(self):
        away = live(UP, (1, 7), (1.5, "down"), (5, "up"))
        self.assertEqual(came(away, kept(UP, (1, 7), (3, 7))), [(1, 7, False), (3, 7, True)])
        self.assertEqual(came(away, kept(UP, (1, 7), (1.5, "down"), (6, "up"), (6.1, 7))), [(1, 7, False), (6.1, 7, True)])

    def test_two_live_observers_at_different_nodes_have_seen_all_while_a_third_was_away(self):
        there, away, twice = live(UP, (1, 7)), live(UP, (1.5, "down"), (5, "up")), kept(UP, (1, 7), (3, 7))
        self.assertEqual(came(there, there, away, twice), [(1, 7, False)])
        self.assertEqual(came(there, away, away, twice), [(1, 7, False), (3, 7, True)], "its node may have stood still")


class Repetitions(unittest.TestCase):
    away = live(UP, (0.5, "down"), (9, "up"))

    def test_what_the_broker_repeats_to_an_observer_that_is_back_is_no_second_message(self):
        self.assertEqual(len(came(self.away, kept(UP, (1, 7), (1.1, "down"), (5, "up"), (5.1, 7, "dup")))), 1)

    def test_a_copy_that_it_has_had_never_before_is_the_message(self):
        back = kept(UP, (1.1, "down"), (5, "up"), (5.1, 7, "dup"))
        self.assertEqual(len(came(self.away, back)), 1)
        twice = kept(UP, (1.1, "down"), (5, "up"), (5.1, 7, "dup"), (5.2, 7))
        self.assertEqual(len(came(self.away, twice)), 2)

    def test_within_a_connection_dup_is_the_publishers_unless_the_broker_repeats_there(self):
        events = (UP, (1, 7), (31, 7, "dup"))
        self.assertEqual(len(came(live(UP, (0.5, "down"), (40, "up")), kept(*events))), 2)
        self.assertEqual(len(came(live(UP, (0.5, "down"), (40, "up")), kept(*events, anytime=True))), 1)

    def test_to_a_live_observer_nothing_is_repeated(self):
        self.assertEqual(len(came(live(UP, (1, 7), (1.5, "down"), (2, "up"), (3, 7, "dup")))), 2)

    def test_what_one_alone_has_twice_without_dup_was_repeated_to_it(self):
        self.assertEqual(len(came(self.away, kept(UP, (1, 7), (6, 7)), kept(UP, (1, 7)))), 1)
        self.assertEqual(len(came(self.away, kept(UP, (1, 7), (6, 7)), kept(UP, (1, 7), (6, 7)))), 2)

    def test_one_that_was_cut_off_does_not_outvote_one_that_was_there(self):
        there, back = kept(UP, (1, 7), (6, 7)), kept(UP, (1, 7), (2, "down"), (8, "up"), (8.1, 7, "dup"))
        self.assertEqual(len(came(self.away, there, back)), 2)
        self.assertEqual(len(came(self.away, there, kept(UP, (1, 7), (2, "down")))), 2)

    def test_one_that_has_lost_its_session_shows_that_a_message_came_and_not_how_often(self):
        self.assertEqual(len(came(self.away, kept(UP, (1, 7), (2, "down"), (5, "up anew"), (6, 7)))), 1)


class Order(unittest.TestCase):
    def test_behind_a_later_one_at_each_live_observer(self):
        self.assertEqual(late_notes([live(UP, (1, 2), (2, 1)), live(UP, (1, 2), (2, 1))]), ([("r1", 1, 2)], 0))
        self.assertEqual(late_notes([live(UP, (1, 2), (2, 1)), live(UP, (1, 1), (2, 2))]), ([], 0))

    def test_kept_ones_are_asked_only_about_what_no_live_one_saw(self):
        self.assertEqual(late_notes([live(UP, (1, 1), (2, 2)), kept(UP, (1, 2), (2, 1))]), ([], 0))
        self.assertEqual(late_notes([live(UP, (1, 2)), kept(UP, (1, 1), (2, 2))]), ([], 0))
        self.assertEqual(late_notes([live(UP, (1, 2)), kept(UP, (1, 2), (2, 1))]), ([("r1", 1, 2)], 0))

    def test_what_came_with_dup_only_is_not_judged(self):
        self.assertEqual(late_notes([live(UP, (1, 2)), kept(UP, (1, 2), (2, "down"), (3, "up"), (33, 1, "dup"))]), ([], 1))

    def test_a_repetition_is_not_out_of_order(self):
        self.assertEqual(late_notes([kept(UP, (1, 1), (2, 2), (2.1, "down"), (3, "up"), (3.1, 1, "dup"))]), ([], 0))


class Observation(unittest.TestCase):
    def test_a_session_that_is_kept_misses_nothing(self):
        self.assertEqual(unobserved_s([live(UP, (2, "down"), (5, "up")), kept(UP, (2, "down"), (6, "up"))]), 0)

    def test_one_that_was_lost_has_missed_what_came_since_it_was_cut_off(self):
        self.assertEqual(unobserved_s([live(UP, (2, "down"), (5, "up")), kept(UP, (3, "down"), (6, "up anew"))]), 2)
        self.assertEqual(unobserved_s([live(UP, (2, "down"), (5, "up"))]), 3)


if __name__ == "__main__":
    unittest.main()
