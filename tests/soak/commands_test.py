# SPDX-License-Identifier: Apache-2.0
"""The judge detects each broken promise about commands. Run as a test (ctest -R Soak.Commands)."""
import pathlib
import sys
import unittest

sys.path.insert(0, str(pathlib.Path(__file__).parent))
from commands import Gap, Outcome, Sent, judge_commands  # noqa: E402

SENT = [Sent("r1", "act1", 100.0)]
DELIVERED = Outcome("r1", "act1", "delivered", 120, 100.2)
TIMEOUT = Outcome("r1", "act1", "timeout", 29000, 129.1)


def complaints(*outcomes, gaps=(), sent=SENT, until=1000.0):
    return judge_commands(sent, outcomes, gaps, until)


class Commands(unittest.TestCase):
    def test_accepts_one_outcome_in_time(self):
        self.assertEqual(complaints(DELIVERED), [])
        self.assertEqual(complaints(TIMEOUT), [])

    def test_reports_a_missing_outcome(self):
        self.assertIn("no outcome", complaints()[0])
        self.assertEqual(complaints(until=120.0), [], "the command may still be under way")

    def test_reports_two_outcomes(self):
        self.assertIn("twice", complaints(DELIVERED, TIMEOUT)[0])
        self.assertIn("twice", complaints(DELIVERED, DELIVERED)[0])

    def test_accepts_only_an_equal_second_outcome_after_a_lost_connection(self):
        gap = Gap(100.1, 105.0, False)
        self.assertEqual(complaints(DELIVERED, DELIVERED, gaps=[gap]), [])
        self.assertIn("twice", complaints(DELIVERED, TIMEOUT, gaps=[gap])[0])
        self.assertEqual(complaints(DELIVERED, TIMEOUT, gaps=[Gap(100.1, 105.0, False, True)]), [])

    def test_reports_a_late_outcome(self):
        late = Outcome("r1", "act1", "delivered", 120, 140.0)
        self.assertIn("only after", complaints(late)[0])
        self.assertEqual(complaints(late, gaps=[Gap(101.0, 139.0, False)]), [])
        self.assertIn("by its own account", complaints(Outcome("r1", "act1", "delivered", 31000, 131.2))[0])

    def test_accepts_a_missing_outcome_if_the_command_was_lost_with_a_queue(self):
        self.assertEqual(complaints(gaps=[Gap(110.0, 115.0, True)]), [])
        self.assertNotEqual(complaints(gaps=[Gap(110.0, 115.0, False, True)]), [], "a daemon that was killed later must report")
        self.assertEqual(complaints(gaps=[Gap(101.0, 102.0, False, True)]), [], "killed when the command arrived")
        self.assertNotEqual(complaints(gaps=[Gap(99.0, 102.0, False)]), [], "the robot's session at the broker keeps it")
        unknown = [Sent("nobody", "act1", 100.0)]
        self.assertEqual(complaints(gaps=[Gap(99.0, 102.0, False)], sent=unknown), [], "no session at the broker keeps it")
        self.assertNotEqual(complaints(gaps=[Gap(102.0, 105.0, False)], sent=unknown), [])

    def test_assigns_an_outcome_to_the_last_command_of_its_type(self):
        sent = [Sent("r1", "cmd", 100.0), Sent("r1", "cmd", 200.0)]
        first, second = Outcome("r1", "cmd", "delivered", 90, 100.1), Outcome("r1", "cmd", "delivered", 90, 200.1)
        self.assertEqual(complaints(first, second, sent=sent), [])
        self.assertIn("200.000 has no outcome", complaints(first, sent=sent)[0])


if __name__ == "__main__":
    unittest.main()
