# SPDX-License-Identifier: Apache-2.0
"""The verdict detects each kind of broken promise. Run as a test (ctest -R Soak.Verdict)."""
import pathlib
import sys
import unittest

sys.path.insert(0, str(pathlib.Path(__file__).parent))
from verdict import Arrival, Trouble, judge, read_record  # noqa: E402

RECORD = [
    "sent r1 1 0a00ecff17 10.0\n",
    "acknowledged r1 1 10.1\n",
    "sent r1 2 0b00ecff63 11.0\n",
    "sent r1 3 0c00ecff01 12.0\n",
    "acknowledged r1 3 12.1\n",
    "sent r1 4 0d00",  # its line is not complete yet
]
FIRST, SECOND, THIRD = "0a00ecff", "0b00ecff", "0c00ecff"


def verdict(*arrived, troubles=(), record=RECORD):
    arrivals = [Arrival("r1", payload, at) for payload, at in arrived]
    tallies, complaints = judge(read_record(record), arrivals, troubles)
    return tallies["r1"], complaints


class Verdict(unittest.TestCase):
    def test_accepts_a_run_whose_acknowledged_messages_arrived(self):
        tally, complaints = verdict((FIRST, 10.2), (THIRD, 12.2))
        self.assertEqual(complaints, [])
        self.assertEqual((tally.said, tally.acknowledged, tally.arrived), (3, 2, 2))

    def test_reports_an_acknowledged_message_that_did_not_arrive(self):
        tally, complaints = verdict((FIRST, 10.2), (SECOND, 11.2))
        self.assertEqual(tally.missing, 1)
        self.assertIn("number 3", complaints[0])

    def test_accepts_missing_messages_up_to_the_number_reported_as_lost(self):
        for may_lose, complaints_expected in ((0, 2), (1, 1), (2, 0), (9, 0)):
            tally, complaints = verdict((SECOND, 11.2), troubles=[Trouble(12.5, 13, 0, may_lose)])
            self.assertEqual(tally.missing, 2)
            self.assertEqual(len(complaints), complaints_expected)
        _, complaints = verdict((FIRST, 10.2), troubles=[Trouble(11, 12, 0, 5)])
        self.assertEqual(len(complaints), 1)  # sent after the damage
        _, complaints = verdict((FIRST, 10.2), troubles=[Trouble(11, 12.05, 0, 5)])
        self.assertEqual(complaints, [])  # between PUBREC and PUBCOMP

    def test_compares_the_order_of_first_arrivals(self):
        tally, complaints = verdict((THIRD, 12.2), (FIRST, 12.3))
        self.assertEqual(tally.out_of_order, 1)
        self.assertIn("number 1 after 3", complaints[0])
        tally, _ = verdict((FIRST, 10.2), (THIRD, 12.2), (FIRST, 12.3), troubles=[Trouble(10, 12, 1)])
        self.assertEqual(tally.out_of_order, 0)

    def test_accepts_a_duplicate_only_with_a_trouble_before_its_copy(self):
        arrived = (FIRST, 10.2), (THIRD, 12.2), (THIRD, 13)
        for trouble in Trouble(10, 11, 1), Trouble(13.5, 14, 1), Trouble(12.3, 12.9, 0):
            tally, complaints = verdict(*arrived, troubles=[trouble])
            self.assertEqual(tally.duplicates, 1)
            self.assertIn("duplicate without a reason: number 3", complaints[0])
        _, complaints = verdict(*arrived, troubles=[Trouble(12.3, 12.9, 1)])
        self.assertEqual(complaints, [])

    def test_bounds_the_duplicates_that_a_trouble_explains(self):
        arrived = (FIRST, 10.2), (FIRST, 12.1), (THIRD, 12.2), (THIRD, 13)
        _, complaints = verdict(*arrived, troubles=[Trouble(9, 14, 1)])
        self.assertEqual(len(complaints), 1)
        _, complaints = verdict(*arrived, troubles=[Trouble(11, 12.05, 1), Trouble(12.05, 14, 1)])
        self.assertEqual(complaints, [])

    def test_counts_arrivals_of_a_payload_that_was_sent_twice(self):
        record = RECORD[:5] + ["sent r1 4 0a00ecff18 13.0\n", "acknowledged r1 4 13.1\n"]
        tally, complaints = verdict((FIRST, 10.2), (THIRD, 12.2), (FIRST, 13.2), record=record)
        self.assertEqual((tally.arrived, tally.duplicates, complaints), (3, 0, []))
        tally, _ = verdict((FIRST, 10.2), (THIRD, 12.2), record=record)
        self.assertEqual(tally.missing, 1)

    def test_finds_which_of_two_equal_messages_is_missing(self):
        record = RECORD[:5] + ["sent r1 4 0a00ecff18 13.0\n", "acknowledged r1 4 13.1\n"]
        damage = Trouble(12.5, 12.9, 0, 1)
        _, complaints = verdict((THIRD, 12.2), (FIRST, 13.2), troubles=[damage], record=record)
        self.assertEqual(complaints, [])
        _, complaints = verdict((FIRST, 10.2), (THIRD, 12.2), troubles=[damage], record=record)
        self.assertEqual(len(complaints), 1)
        self.assertIn("number 4", complaints[0])

    def test_reports_an_arrival_that_was_not_sent(self):
        _, complaints = verdict((FIRST, 10.2), (THIRD, 12.2), ("ffff", 12.3))
        self.assertEqual(complaints, ["r1: arrived but was never sent: ffff"])


if __name__ == "__main__":
    unittest.main()
