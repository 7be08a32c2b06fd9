# SPDX-License-Identifier: Apache-2.0
"""What the judge of a live run takes outcomes for. Run as a test (ctest -R Fleet.Judge)."""
import json
import pathlib
import sys
import unittest

sys.path[:0] = [str(pathlib.Path(__file__).parent), str(pathlib.Path(__file__).parents[2] / "soak")]
from judge import outcomes_of  # noqa: E402
from streams import Message  # noqa: E402


def outcome(at, gateway, what="delivered", after_ms=100, is_late=False):
    payload = json.dumps({"type": "c1", "outcome": what, "after_ms": after_ms, "why": ""}).encode()
    return Message(at, f"p/gateway/gw-{gateway}/commands/r1", payload, is_late)


class LateOutcomes(unittest.TestCase):
    def test_the_time_of_one_that_came_late_is_reckoned(self):
        said = outcomes_of([outcome(40, 0, after_ms=500, is_late=True)], {("r1", "c1"): 10})["r1", "c1"]
        self.assertEqual((said[0].at, said[0].is_late), (10.5, True))

    def test_that_of_a_live_one_is_its_own(self):
        said = outcomes_of([outcome(40, 0, after_ms=500)], {("r1", "c1"): 10})["r1", "c1"]
        self.assertEqual((said[0].at, said[0].is_late), (40, False))


if __name__ == "__main__":
    unittest.main()
