# SPDX-License-Identifier: Apache-2.0
"""Runs that belong together: repeated ones and their spread, and the sweep that ends where a mesh breaks."""
import contextlib
import dataclasses
import io
import os
import tempfile
import unittest
import unittest.mock

from figures_test import result_of

from slamgw_experiment import catalogue, folder, main, measure, series
from slamgw_experiment.events import GATEWAY, ROBOTS, Event


def events_of(robots, messages, period_ms, lost_each=0):
    """Each `lost_each`th update gets lost; acknowledgements take 10 ms."""
    events = []
    for robot in range(robots):
        for n in range(1, messages + 1):
            at_us = round(n * period_ms * 1000)
            common = {"robot": f"robot{robot + 1}", "mesh": "ble", "direction": "up", "number": n}
            events.append(Event(t_us=at_us, source=ROBOTS, event="sent", payload="0a00ecff", **common))
            if lost_each and n % lost_each == 0:
                continue
            events.append(Event(t_us=at_us + 4000, source=GATEWAY, event="arrived", type="update", payload="0a00ecff", **common))
            events.append(Event(t_us=at_us + 10_000, source=ROBOTS, event="acknowledged", **common))
    return events


class Series(unittest.TestCase):
    def setUp(self):
        self.directory = tempfile.TemporaryDirectory()
        self.addCleanup(self.directory.cleanup)
        self.out = self.directory.name

    def add(self, name, experiment, mesh="ble", robots=1, period_ms=200, lost_each=0, messages=40, is_simulated=True, seed=1):
        inner = os.path.join(self.out, name)
        os.makedirs(inner, exist_ok=True)
        events = events_of(robots, messages, period_ms, lost_each)
        recorder = folder.Recorder(inner)
        for event in events:
            recorder.write(event)
        recorder.close()
        result = result_of(catalogue.find(experiment), mesh, events, is_simulated)
        result["conditions"] |= {"robots": [f"robot{n + 1}" for n in range(robots)], "period_ms": period_ms, "seed": seed,
                                 "messages": messages, "begun": "2026-11-28T04:00:00+00:00"}
        result["measured"] = measure.measured(events, "update", period_ms)
        folder.write_result(inner, result)
        return inner

    def asked(self, *arguments):
        return main.parser("0.1.0").parse_args(["run", *arguments])

    def test_the_spread_of_three_runs_is_students(self):
        mean, (low, high) = series.over_runs([1, 2, 3])
        self.assertEqual(mean, 2)
        self.assertAlmostEqual(high - mean, 4.303 / 3 ** 0.5, 3)
        self.assertAlmostEqual(mean - low, 4.303 / 3 ** 0.5, 3)
        self.assertIsNone(series.over_runs([5])[1])

    def test_repeated_runs_are_drawn_with_mean_and_the_thesiss_number(self):
        series.write(self.out, series.REPEATED)
        for seed, lost_each in ((1, 4), (2, 5), (3, 10)):
            self.add(f"seed-{seed}", "ble-one-obstacle", lost_each=lost_each, seed=seed)
        text = series.draw(self.out)
        self.assertIn("ble-one-obstacle on BLE Mesh, 3 runs", text)
        lost = next(line for line in text.splitlines() if line.startswith("made and not arrived"))
        self.assertEqual(lost.split()[6:8], ["18.3", "0.0"], lost)
        self.assertIn("8 to 10", text)
        for name in ("figure.svg", "figure.png"):
            self.assertGreater(os.path.getsize(os.path.join(self.out, name)), 1000)

    def test_run_without_a_member_is_named(self):
        """`plot` of such a folder ended in a traceback."""
        for kind in (series.REPEATED, series.LIMITS):
            series.write(self.out, kind)
            for name in ("seed", "messages", "robots", "mesh"):
                inner = self.add("seed-1", "ble-one-obstacle")
                result = folder.read_result(inner)
                if name == "mesh":
                    result["mesh"] = "wifi"
                else:
                    del result["conditions"][name]
                folder.write_result(inner, result)
                said = io.StringIO()
                with contextlib.redirect_stderr(said):
                    self.assertEqual(main.main("0.1.0", arguments=["plot", self.out]), 1)
                self.assertRegex(said.getvalue(), f"seed-1/result.json: (conditions.)?{name} is missing, or not what")
                os.unlink(os.path.join(inner, "events.csv"))

    def test_limits_name_where_each_mesh_breaks(self):
        series.write(self.out, series.LIMITS)
        for robots, lost_each in ((1, 0), (4, 10), (16, 1)):
            self.add(f"ble-{robots}-robots-200-ms", "limits", robots=robots, lost_each=lost_each)
        self.add("ble-4-robots-100-ms", "limits", robots=4, period_ms=100, lost_each=10)
        text = series.draw(self.out)
        self.assertEqual(len(text.splitlines()), 2 + 3 + 2, "the line of faster robots begins with the four that are there")
        with open(os.path.join(self.out, "figure.svg"), encoding="utf-8") as file:
            self.assertIn("<!-- SIMULATED -->", file.read())
        results = series.results_in(self.out)
        self.assertEqual([series.is_broken(one) for one in sorted(results, key=series.load_of)], [False, False, False, True])

    def test_real_robots_and_simulated_ones_on_one_axis(self):
        series.write(self.out, series.LIMITS)
        self.add("ble-1-robots-200-ms", "limits")
        simulated, self.out = self.out, os.path.join(self.out, "real")
        self.add("ble", "limits", robots=3, is_simulated=False)
        series.write(self.out, series.LIMITS)
        said = io.StringIO()
        with contextlib.redirect_stdout(said):
            status = main.main("0.1.0", arguments=["compare", simulated, self.out, "--out", os.path.join(simulated, "both")])
        self.assertEqual(status, 0)
        self.assertIn("BLE Mesh, real", said.getvalue())

    def test_a_sweep_ends_with_the_first_run_that_breaks(self):
        runs = []

        def run_one(asked, experiment, mesh, out, *_):
            runs.append((experiment.robots, asked.period_ms, asked.messages))
            os.rmdir(out)
            load = experiment.robots * 1000 / asked.period_ms
            self.add(os.path.basename(out), "limits", mesh, experiment.robots, asked.period_ms, 2 if load > 30 else 0, messages=10)
            return 0

        with unittest.mock.patch.object(main, "run_one", run_one), contextlib.redirect_stdout(io.StringIO()), \
                contextlib.redirect_stderr(io.StringIO()):
            asked = self.asked("limits", "--sim", "--messages", "20")
            self.assertEqual(main.run_limits(asked, [(catalogue.find("limits"), "ble")], self.out, "0.1.0", None, lambda: False), 0)
        self.assertEqual(runs, [(1, 200, 20), (2, 200, 20), (4, 200, 20), (8, 200, 20), (4, 100, 40)])

    def test_repeats_count_the_seed_up(self):
        seeds = []

        def run_one(asked, experiment, mesh, out, *_):
            seeds.append(asked.seed)
            os.rmdir(out)
            self.add(os.path.basename(out), experiment.name, mesh, seed=asked.seed)
            return 0

        with unittest.mock.patch.object(main, "run_one", run_one), contextlib.redirect_stdout(io.StringIO()), \
                contextlib.redirect_stderr(io.StringIO()):
            experiment = dataclasses.replace(catalogue.find("ble-hop"))
            asked = self.asked("ble-hop", "--sim", "--repeat", "3", "--seed", "7")
            self.assertEqual(main.run_repeated(asked, experiment, "ble", self.out, "0.1.0", None, lambda: False), 0)
            self.assertEqual(main.main("0.1.0", arguments=["plot", self.out]), 0)
            self.assertEqual(main.main("0.1.0", arguments=["run", "all", "--sim", "--repeat", "2"]), main.WRONG_ARGUMENTS)
        self.assertEqual(seeds, [7, 8, 9])

    def test_invalid_series_file_is_reported(self):
        with open(os.path.join(self.out, series.SERIES), "w", encoding="utf-8") as file:
            file.write("[]")
        with self.assertRaises(folder.BadFolder):
            series.kind_of(self.out)
        self.assertIsNone(series.kind_of(tempfile.gettempdir()))


if __name__ == "__main__":
    unittest.main()
