# SPDX-License-Identifier: Apache-2.0
"""Results with known values: those of the thesis, and those of constructed events."""
import math
import random
import tempfile
import unittest

import numpy
import recount

from slamgw_experiment import folder, measure
from slamgw_experiment.events import BROKER, GATEWAY, ROBOTS, Event

PERIOD_US = 200_000


def arrival(t_us, robot="r", kind="update", number=None, **more):
    return Event(t_us=t_us, source=GATEWAY, event="arrived", robot=robot, mesh="ble", type=kind, direction="up", number=number, **more)


def at_robot(t_us, event, number, robot="r", payload=""):
    return Event(t_us=t_us, source=ROBOTS, event=event, robot=robot, mesh="ble", direction="up", number=number, payload=payload)


class Thesis(unittest.TestCase):
    def test_figure_8_6(self):
        """9.4: 72 received, 42 lost, counted from delayed arrivals: 36.8 %."""
        choose = random.Random(1)
        places = sorted([0, 113, *choose.sample(range(1, 113), 70)])
        found = measure.estimated_loss(measure.intervals_ms([arrival(place * PERIOD_US) for place in places], "update"), 200)
        self.assertEqual((found["sent"], found["lost"]), (114, 42))
        self.assertAlmostEqual(found["share"], 0.368, 3)
        self.assertAlmostEqual(found["share_95_percent"][0], 0.286, 3)
        self.assertAlmostEqual(found["share_95_percent"][1], 0.460, 3)

    def test_figure_8_13(self):
        """9.2: 1000 of 1000, so at most 0.3-0.4 % loss."""
        events = [event for n in range(1, 1001) for event in (at_robot(n, "sent", n), arrival(n, kind="probe", number=n))]
        found = measure.exact_loss(events, "probe")
        self.assertEqual((found["sent"], found["lost"]), (1000, 0))
        self.assertLess(found["share_95_percent"][1], 0.004)

    def test_figure_8_14(self):
        angles = numpy.arange(0, 360, 5) / 180 * math.pi
        circle = measure.fitted_circle(numpy.column_stack([3 + 80 * numpy.cos(angles), -2 + 80 * numpy.sin(angles)]))
        self.assertEqual((circle["radius_cm"], circle["x_cm"], circle["y_cm"], circle["rms_error_cm"]), (80, 3, -2, 0))


class Loss(unittest.TestCase):
    def test_robots_do_not_mix(self):
        gaps = measure.intervals_ms([arrival(0, "a"), arrival(1, "b"), arrival(200_000, "a"), arrival(400_001, "b")], "update")
        self.assertEqual([list(gaps["a"]), list(gaps["b"])], [[200], [400]])

    def test_doubles_do_not_hide_lost_messages(self):
        """A robot sends the payload ..04 twice, and appends a stray octet. One of ..02 and one of ..04 are lost; ..01 comes three times."""
        events = [at_robot(n, "sent", n, payload=f"{number:08x}0a") for n, number in enumerate((1, 2, 3, 4, 4))]
        events += [at_robot(9, "sent", 1, "s", payload="00000002"), arrival(10, "s", payload="00000002")]
        events += [arrival(20 + n, payload=f"{number:08x}") for n, number in enumerate((1, 3, 4, 1, 1))]
        found = measure.measured(events, "update", 200)
        exact = found["loss"]["exact"]
        self.assertEqual((exact["sent"], exact["lost"], exact["doubled"]), (6, 2, 2))
        self.assertEqual((found["not_arrived"]["found"], found["not_arrived"]["of"]), (2, 6))

    def test_probes_without_the_robots_record(self):
        numbers = [65534, 65535, 1, 0, 1, 5]  # wraps, comes out of order, doubled; 2, 3, 4 are lost
        events = [arrival(n, kind="probe", number=number, sender_ms=0) for n, number in enumerate(numbers)]
        found = measure.exact_loss(events, "probe")
        self.assertEqual((found["sent"], found["lost"]), (8, 3))
        self.assertIn("sequence numbers", found["how"])
        self.assertEqual(measure.counts(events, "probe")["probes_doubled"], 1)

    def test_repeats_from_before_the_run_and_messages_still_on_their_way_are_not_lost(self):
        """Number 5 was made 8 s before the run began, 61 is not there yet when it ends 9 s after it was made."""
        made_ms = {number: 200 * number for number in range(1, 120)}
        def came(number, t_us):
            return arrival(t_us, kind="probe", number=number, sender_ms=made_ms[number])
        begin_ms = made_ms[45]
        events = [came(number, (made_ms[number] - begin_ms) * 1000) for number in range(45, 106) if number not in (50, 61)]
        events.append(came(5, 20_000))
        found = measure.exact_loss(measure.counted(sorted(events, key=lambda event: event.t_us), "probe", 60, 200, 3_000_000), "probe")
        self.assertEqual((found["sent"], found["lost"]), (61 - 45, 1))

    def probes(self, begin, clock_ms, restart=None, robot="r"):
        """400 probes of which each tenth gets lost; after `restart` of them, 5 s after its start, the robot begins with number 0."""
        events = []
        for n in range(400):
            number, ms = begin + n, clock_ms + n * 200
            if restart is not None and n >= restart:
                number, ms = n - restart, 5000 + (n - restart) * 200
            if n % 10 != 5:
                more = {"number": number % 2 ** 16, "sender_ms": ms % 2 ** 32, "payload": f"{number % 2 ** 16:04x}{ms % 2 ** 32:08x}"}
                events += [arrival(1_000_000 + n * PERIOD_US, robot, "probe", **more),
                           Event(t_us=1_000_500 + n * PERIOD_US, source=BROKER, event="received", robot=robot, type="probe", **more)]
        return measure.counted(events, "probe", 400, 200, 399 * PERIOD_US + 500)

    def check_probes(self, events, sent, lost, restarts=0):
        found = measure.measured(events, "probe", 200)
        self.assertEqual((found["loss"]["exact"]["sent"], found["loss"]["exact"]["lost"]), (sent, lost))
        self.assertEqual(found["counts"]["received_at_broker"], found["counts"]["arrived"])
        self.assertEqual(found["probe_delay_ms"]["max"], 0)
        self.assertEqual([one["t_us"] for one in measure.restarts_of_robots(events)], [41_000_000] * restarts)

    def test_probes_count_on_when_number_or_clock_wraps(self):
        for begin, clock_ms in ((100, 5000), (65500, 5000), (100, 2 ** 32 - 20_000)):
            with self.subTest(begin=begin, clock_ms=clock_ms):
                self.check_probes(self.probes(begin, clock_ms), 395, 39)

    def test_a_restarted_robot_counts_from_its_start(self):
        """A robot whose numbers began again showed 98 % loss, or 300 probes in place of 400."""
        for begin, clock_ms in ((40_000, 5000), (100, 5000), (100, 2 ** 31 + 60_000)):
            with self.subTest(begin=begin, clock_ms=clock_ms):
                self.check_probes(self.probes(begin, clock_ms, restart=200), 395, 39, restarts=1)
        both = sorted(self.probes(100, 5000) + self.probes(100, 5000, 200, "s"), key=lambda event: event.t_us)
        self.check_probes(both, 790, 78, restarts=1)

    def test_a_late_probe_is_no_restart(self):
        events = self.probes(100, 5000)
        late = events.pop(20)
        late.t_us += 24_000_000
        self.assertEqual(measure.restarts_of_robots(sorted(events + [late], key=lambda event: event.t_us)), [])

    def test_counts_leave_out_messages_made_after_the_end(self):
        """Figure 8.13 showed 40 sent and 165 received: a real robot goes on in the last 25 s."""
        events = []
        for number in range(165):
            t_us, more = number * PERIOD_US + 5000, {"robot": "r", "type": "probe", "direction": "up"}
            message_id = str(number % 90)  # comes again
            probe = {"number": number, "sender_ms": 200 * number, "payload": f"{number:012x}"}
            repeated_us = 8_000_000 if number == 30 else 0
            events += [arrival(t_us + repeated_us, kind="probe", message_id=message_id, **probe),
                       Event(t_us + repeated_us + 100, source=GATEWAY, event="published", message_id=message_id, **more),
                       Event(t_us + repeated_us + 200, source=BROKER, event="received", **more, **probe)]
        events = measure.counted(sorted(events, key=lambda event: event.t_us), "probe", 40, 200, 164 * PERIOD_US + 5200 - 25_000_000)
        found = measure.measured(events, "probe", 200)
        self.assertEqual((found["loss"]["exact"]["sent"], found["loss"]["exact"]["lost"]), (40, 0))
        self.assertEqual([found["counts"][name] for name in ("arrived", "published", "received_at_broker")], [40, 40, 40])
        self.assertEqual(found["interval_ms"]["count"], 39)

    def test_counts_of_updates_are_limited_to_the_requested_number(self):
        """As above, without sequence numbers. Robot b starts later and loses each tenth; c sends faster than specified."""
        events = [Event(900, source=GATEWAY, event="published", type="update", robot="a", direction="up", message_id="7")]  # arrived before the run
        for robot, begin_us, period_us, lost_each in (("a", 5000, PERIOD_US, 0), ("b", 1_000_000, PERIOD_US, 10), ("c", 0, 50_000, 0)):
            for number in range(165):
                if lost_each and number % lost_each == 5:
                    continue
                t_us, more = begin_us + number * period_us, {"robot": robot, "direction": "up"}
                more_of_gateway = {"source": GATEWAY, "message_id": str(number % 90)}
                payload = {"payload": f"{number:08x}"}
                events += [arrival(t_us, robot, message_id=str(number % 90), **payload),
                           Event(t_us + 100, event="published", type="update", **more, **more_of_gateway),
                           Event(t_us + 300_000, event="acknowledged", latency_us=300_000, **more, **more_of_gateway),
                           Event(t_us + 200, source=BROKER, event="received", type="update", **more, **payload)]
        events = measure.counted(sorted(events, key=lambda event: event.t_us), "update", 40, 200, 8_000_000)
        for robot, wanted in (("a", 40), ("b", 36), ("c", 40)):
            of_robot = [event for event in events if event.robot == robot]
            found = measure.measured(of_robot, "update", 200)
            self.assertEqual([found["counts"][name] for name in ("arrived", "published", "received_at_broker")], [wanted] * 3)
            self.assertEqual(found["acknowledged_after_ms"]["gateway"]["count"], wanted)

    def test_updates_without_the_robots_record_have_an_estimate_only(self):
        found = measure.measured([arrival(0), arrival(PERIOD_US)], "update", 200)["loss"]
        self.assertIsNone(found["exact"])
        self.assertIn("estimate", found["estimate"]["how"])

    def test_late_message_on_thread_is_not_counted_as_estimated_loss(self):
        events = [arrival(0), arrival(1_000_000)]
        for event in events:
            event.mesh = "thread"
        self.assertIsNone(measure.measured(events, "update", 200)["loss"]["estimate"])


class Latency(unittest.TestCase):
    def test_from_the_first_sending_to_the_acknowledgement(self):
        events = [at_robot(0, "sent", 1), at_robot(8_000_000, "repeat", 1), at_robot(8_030_000, "acknowledged", 1),
                  at_robot(9_000_000, "sent", 2)]
        self.assertEqual(list(measure.robot_latencies_ms(events)["r"]), [8030])

    def test_repeats_that_the_gateway_saw_stand_in_for_the_robots_record(self):
        events = [arrival(0, message_id="1"), arrival(9, message_id="2"),
                  Event(t_us=20, source=GATEWAY, event="repeat", robot="r", type="update", direction="up", message_id="2")]
        self.assertEqual(measure.repeats_by_message(events), ({("r", "1"): 0, ("r", "2"): 1}, {}))

    def test_probes_need_no_common_clock(self):
        events = [arrival(1_000_000 * n + late, kind="probe", number=n, sender_ms=77_000 + 1000 * n)
                  for n, late in enumerate((5000, 3000, 9000))]
        self.assertEqual(list(measure.probe_delays_ms(events)["r"]), [2, 0, 6])


class Intervals(unittest.TestCase):
    def test_a_percentile_needs_five_values_beyond_it(self):
        self.assertIsNone(measure.statistics(range(49))["p90"])
        self.assertIsNotNone(measure.statistics(range(50))["p90"])
        self.assertIsNone(measure.statistics(range(499))["p99"])
        self.assertIsNotNone(measure.statistics(range(500))["p99"])

    def test_of_a_mean_as_theory_has_it(self):
        values = numpy.random.default_rng(5).normal(50, 10, 400)
        low, high = measure.bootstrap(numpy.mean, values)
        self.assertAlmostEqual(high - low, 2 * 1.96 * values.std() / 20, delta=0.15)
        self.assertTrue(low < values.mean() < high)
        self.assertEqual([low, high], measure.bootstrap(numpy.mean, values), "plot makes the same numbers again")
        self.assertIsNone(measure.bootstrap(numpy.mean, values[:1]))

    def test_of_a_difference(self):
        values = numpy.random.default_rng(6).normal(50, 10, 400)
        more, (low, high) = measure.difference_of_means(values + 10, values)
        self.assertAlmostEqual(more, 10)
        self.assertTrue(8 < low < 10 < high < 12)

    def test_the_thesis_read_loss_off_the_bins_of_two_and_three_periods(self):
        gaps = numpy.array([200.0] * 90 + [395.0] * 5 + [610.0] * 4 + [1000.0])
        self.assertEqual(measure.two_or_three_periods(gaps, 200)["share"], 0.09)
        self.assertEqual(measure.shares_of_periods(gaps, 200)["400"]["found"], 5)

    def test_unsent_and_late_messages_are_shares_of_made_and_sent_ones(self):
        events = [at_robot(0, "sent", 1), at_robot(100_000, "acknowledged", 1), at_robot(200_000, "sent", 2),
                  at_robot(450_000, "acknowledged", 2), at_robot(600_000, "sent", 3), *(at_robot(800_000, "refused", n) for n in range(4, 8))]
        found = measure.measured([*events, arrival(1), arrival(200_001)], "update", 200)
        self.assertEqual((found["never_left"]["found"], found["never_left"]["of"]), (4, 7))
        self.assertEqual((found["not_arrived"]["found"], found["not_arrived"]["of"]), (5, 7))
        self.assertEqual((found["late"]["found"], found["late"]["of"]), (2, 3))


class Whole(unittest.TestCase):
    def test_an_empty_run_has_numbers_too(self):
        found = measure.measured([], "update", 200)
        self.assertEqual(found["counts"]["arrived"], 0)
        self.assertIsNone(found["interval_ms"])

    def test_results_follow_from_the_events(self):
        choose = random.Random(2)
        events = []
        for robot in ("a", "b"):
            for number in range(1, 300):
                t_us = number * PERIOD_US + choose.randrange(3000)
                events.append(at_robot(t_us, "sent", number, robot, payload=f"{number:016x}"))
                if choose.random() < 0.1:
                    continue
                events.append(arrival(t_us + choose.randrange(20_000), robot, bytes=8, payload=f"{number:016x}"))
                if choose.random() < 0.9:
                    events.append(at_robot(t_us + choose.randrange(20_000, 60_000), "acknowledged", number, robot))
        with tempfile.TemporaryDirectory() as directory:
            recorder = folder.Recorder(directory)
            for event in events:
                recorder.write(event)
            recorder.close()
            folder.write_result(directory, recount.WHOLE)
            result, _ = folder.measure_again(directory)
            folder.write_result(directory, result)
            recount.check(self, directory)


if __name__ == "__main__":
    unittest.main()
