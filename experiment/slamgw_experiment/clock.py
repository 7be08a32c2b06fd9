# SPDX-License-Identifier: Apache-2.0
"""Puts the sources' wall-clock times on one axis that stays continuous over a step of the clock.

The sources run on this host, so the wall clock that they read is the one that is compared here with the monotonic clock.
"""
import time

STEP_US = 20_000  # NTP slews slower than this between two looks; a larger change is a step
MOMENT_US = 1_000  # two clocks that are read within this time count as read together


class Axis:
    """`wall_us` and `monotonic_us` are functions, so that tests can step them."""

    def __init__(self, wall_us=lambda: time.time_ns() // 1000, monotonic_us=lambda: time.monotonic_ns() // 1000):
        self._wall_us = wall_us
        self._monotonic_us = monotonic_us
        self.begin_wall_us, self._begin_us = self._both_us()
        self._offset_us = self.begin_wall_us  # of the wall clock, against the axis
        self._previous_offset_us = None
        self.steps = []

    def now_us(self):
        return self._monotonic_us() - self._begin_us

    def _both_us(self):
        """Reads both clocks at one moment, because a pause between the two would look like a step of the clock."""
        readings = []
        while len(readings) < 10:
            before_us, wall_us = self._monotonic_us(), self._wall_us()
            readings.append((self._monotonic_us() - before_us, wall_us, before_us))
            if readings[-1][0] < MOMENT_US:
                break
        return min(readings)[1:]

    def look(self):
        """Returns a new step of the wall clock as (time, size in microseconds), or None."""
        wall_us, monotonic_us = self._both_us()
        now_us = monotonic_us - self._begin_us
        offset_us = wall_us - now_us
        by_us = offset_us - self._offset_us
        if abs(by_us) < STEP_US:
            if by_us:
                self._offset_us += by_us // 8  # follows a clock that is slewed
            return None
        self._previous_offset_us, self._offset_us = self._offset_us, offset_us
        self.steps.append({"t_us": now_us, "by_us": by_us})
        return now_us, by_us

    def place(self, wall_us, read_us):
        """Returns the place of a source's time on the axis; `read_us` is the time at which its line was read."""
        at_us = wall_us - self._offset_us
        if self._previous_offset_us is None:
            return at_us
        before_us = wall_us - self._previous_offset_us  # written before the step, read after it
        slack_us = 1000
        candidates = [t for t in (at_us, before_us) if t <= read_us + slack_us] or [at_us, before_us]
        return min(candidates, key=lambda t: abs(read_us - t))
