# SPDX-License-Identifier: Apache-2.0
"""The conclusions from the messages to live and kept observers. Run as a test (ctest -R Fleet.Streams)."""
import pathlib
import sys
import unittest

sys.path.insert(0, str(pathlib.Path(__file__).parent))
from streams import Stream, late_notes, messages_of, unobserved_s  # noqa: E402

TOPIC = "p/robot/r1/note"


def stream(*events, is_kept=False, anytime=False):
    """`events`: (time, "up"), (time, "up new": the session was lost), (time, "down"), or (time, number), perhaps followed by "dup"."""
    made = Stream(is_kept, anytime)
    for at, what, *flags in events:
        if what in ("up", "up new"):
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
    """Returns (time, number, whether it came late) of each copy."""
    return [(each.at, int(each.payload), each.is_late) for each in messages_of(streams)]


UP = (0, "up")


class Messages(unittest.TestCase):
    def test_takes_the_time_of_the_live_observer(self):
        self.assertEqual(came(live(UP, (1, 7)), kept(UP, (1.2, 7)), kept(UP, (1.3, 7))), [(1, 7, False)])

    def test_marks_a_message_without_a_live_observer_as_late(self):
        self.assertEqual(came(live(UP, (1, "down"), (5, "up")), kept(UP, (1, "down"), (6, "up"), (6.1, 7))), [(6.1, 7, True)])

    def test_counts_copies_by_the_live_observer_with_most(self):
        self.assertEqual(len(came(live(UP, (1, 7), (2, 7)), live(UP, (1, 7), (1.5, "down")))), 2)
        self.assertEqual(came(live(UP, (1, 7)), kept(UP, (1, 7), (3, 7))), [(1, 7, False)])

    def test_counts_a_second_copy_from_while_live_observers_were_cut_off(self):
        away = live(UP, (1, 7), (1.5, "down"), (5, "up"))
        self.assertEqual(came(away, kept(UP, (1, 7), (3, 7))), [(1, 7, False), (3, 7, True)])
        self.assertEqual(came(away, kept(UP, (1, 7), (1.5, "down"), (6, "up"), (6.1, 7))), [(1, 7, False), (6.1, 7, True)])

    def test_relies_on_two_live_observers_while_a_third_is_cut_off(self):
        there, away, twice = live(UP, (1, 7)), live(UP, (1.5, "down"), (5, "up")), kept(UP, (1, 7), (3, 7))
        self.assertEqual(came(there, there, away, twice), [(1, 7, False)])
        self.assertEqual(came(there, away, away, twice), [(1, 7, False), (3, 7, True)], "its node may have been stopped")


class Repetitions(unittest.TestCase):
    away = live(UP, (0.5, "down"), (9, "up"))

    def test_ignores_a_repetition_to_an_observer_that_reconnects(self):
        self.assertEqual(len(came(self.away, kept(UP, (1, 7), (1.1, "down"), (5, "up"), (5.1, 7, "dup")))), 1)

    def test_counts_a_copy_with_dup_that_is_the_first(self):
        back = kept(UP, (1.1, "down"), (5, "up"), (5.1, 7, "dup"))
        self.assertEqual(len(came(self.away, back)), 1)
        twice = kept(UP, (1.1, "down"), (5, "up"), (5.1, 7, "dup"), (5.2, 7))
        self.assertEqual(len(came(self.away, twice)), 2)

    def test_counts_dup_within_a_connection_unless_the_broker_repeats_there(self):
        events = (UP, (1, 7), (31, 7, "dup"))
        self.assertEqual(len(came(live(UP, (0.5, "down"), (40, "up")), kept(*events))), 2)
        self.assertEqual(len(came(live(UP, (0.5, "down"), (40, "up")), kept(*events, anytime=True))), 1)

    def test_counts_all_copies_to_a_live_observer(self):
        self.assertEqual(len(came(live(UP, (1, 7), (1.5, "down"), (2, "up"), (3, 7, "dup")))), 2)

    def test_ignores_a_second_copy_at_one_kept_observer_alone(self):
        self.assertEqual(len(came(self.away, kept(UP, (1, 7), (6, 7)), kept(UP, (1, 7)))), 1)
        self.assertEqual(len(came(self.away, kept(UP, (1, 7), (6, 7)), kept(UP, (1, 7), (6, 7)))), 2)

    def test_prefers_kept_observers_that_were_connected(self):
        there, back = kept(UP, (1, 7), (6, 7)), kept(UP, (1, 7), (2, "down"), (8, "up"), (8.1, 7, "dup"))
        self.assertEqual(len(came(self.away, there, back)), 2)
        self.assertEqual(len(came(self.away, there, kept(UP, (1, 7), (2, "down")))), 2)

    def test_counts_one_copy_if_the_only_kept_observer_lost_its_session(self):
        self.assertEqual(len(came(self.away, kept(UP, (1, 7), (2, "down"), (5, "up new"), (6, 7)))), 1)


class Order(unittest.TestCase):
    def test_reports_a_message_behind_a_later_one_at_each_live_observer(self):
        self.assertEqual(late_notes([live(UP, (1, 2), (2, 1)), live(UP, (1, 2), (2, 1))]), ([("r1", 1, 2)], 0))
        self.assertEqual(late_notes([live(UP, (1, 2), (2, 1)), live(UP, (1, 1), (2, 2))]), ([], 0))

    def test_uses_kept_observers_only_for_messages_without_a_live_one(self):
        self.assertEqual(late_notes([live(UP, (1, 1), (2, 2)), kept(UP, (1, 2), (2, 1))]), ([], 0))
        self.assertEqual(late_notes([live(UP, (1, 2)), kept(UP, (1, 1), (2, 2))]), ([], 0))
        self.assertEqual(late_notes([live(UP, (1, 2)), kept(UP, (1, 2), (2, 1))]), ([("r1", 1, 2)], 0))

    def test_does_not_judge_the_order_of_messages_with_dup_only(self):
        self.assertEqual(late_notes([live(UP, (1, 2)), kept(UP, (1, 2), (2, "down"), (3, "up"), (33, 1, "dup"))]), ([], 1))

    def test_accepts_a_repetition_behind_later_messages(self):
        self.assertEqual(late_notes([kept(UP, (1, 1), (2, 2), (2.1, "down"), (3, "up"), (3.1, 1, "dup"))]), ([], 0))


class Observation(unittest.TestCase):
    def test_counts_no_gap_with_a_kept_session(self):
        self.assertEqual(unobserved_s([live(UP, (2, "down"), (5, "up")), kept(UP, (2, "down"), (6, "up"))]), 0)

    def test_counts_the_gap_of_a_lost_session_from_the_cut_on(self):
        self.assertEqual(unobserved_s([live(UP, (2, "down"), (5, "up")), kept(UP, (3, "down"), (6, "up new"))]), 2)
        self.assertEqual(unobserved_s([live(UP, (2, "down"), (5, "up"))]), 3)


if __name__ == "__main__":
    unittest.main()
