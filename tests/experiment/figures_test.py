# SPDX-License-Identifier: Apache-2.0
"""Every kind of figure is drawn, from full, single and empty runs; captions have the required facts."""
import dataclasses
import os
import tempfile
import unittest

import numpy

from slamgw_experiment import catalogue, figures, folder, measure, page
from slamgw_experiment.events import GATEWAY, ROBOTS, Event


def some_events(count, kind):
    events = []
    for n in range(1, count + 1):
        payload = f"{n % 65536:04x}"[2:] + f"{n:04x}"[:2] + "c8000000" if kind == "probe" else "0a00ecff64002c01"
        events.append(Event(t_us=n * 200_000, source=ROBOTS, event="sent", robot="robot1", mesh="ble", direction="up", number=n,
                            payload=payload))
        events.append(Event(t_us=n * 200_000 + 5000, source=GATEWAY, event="arrived", robot="robot1", mesh="ble", type=kind,
                            direction="up", number=n if kind == "probe" else None, sender_ms=n * 200 if kind == "probe" else None,
                            bytes=len(payload) // 2, payload=payload))
        events.append(Event(t_us=n * 200_000 + 9000 + 37 * n, source=ROBOTS, event="acknowledged", robot="robot1", mesh="ble",
                            direction="up", number=n))
    return events


def result_of(experiment, mesh, events, is_simulated=True, complete=True):
    kind = experiment.message_type()
    return {"format": folder.FORMAT, "program": "slam-gateway-experiment 0.1.0", "experiment": experiment.name,
            "title": experiment.title, "mesh": mesh, "complete": complete, "simulated": is_simulated, "incidents": [], "differs": [],
            "conditions": {"period_ms": 200, "type": kind, "time_compressed": 1, "seed": 3, "messages": 1000,
                           "robots": ["robot1"], "begun": "2026-11-28T04:00:00+00:00"},
            "measured": measure.measured(events, kind, 200),
            "thesis": {"where": experiment.where(), "result": experiment.thesis, "numbers": experiment.thesis_numbers,
                       "unknown": experiment.unknown, "chosen": experiment.chosen}}


class Figures(unittest.TestCase):
    def test_each_kind_can_be_drawn_from_any_number_of_messages(self):
        of_each_kind = {experiment.kind: experiment for experiment in catalogue.EXPERIMENTS}
        for experiment in of_each_kind.values():
            for count in (0, 1, 30):
                with self.subTest(experiment=experiment.name, count=count), tempfile.TemporaryDirectory() as directory:
                    events = some_events(count, experiment.message_type())
                    figures.draw(directory, result_of(experiment, experiment.meshes[0], events), events)
                    with open(os.path.join(directory, "figure.png"), "rb") as file:
                        self.assertEqual(file.read(8), b"\x89PNG\r\n\x1a\n")
                    with open(os.path.join(directory, "figure.svg"), encoding="utf-8") as file:
                        self.assertIn("</svg>", file.read())

    def test_captions_have_the_thesiss_result_and_the_measured_one(self):
        for experiment in catalogue.EXPERIMENTS:
            events = some_events(10, experiment.message_type())
            caption = figures.caption(result_of(experiment, experiment.meshes[0], events)).replace("\n", " ")
            self.assertIn(f"{experiment.where()}: {experiment.thesis}.", caption)
            self.assertIn("Here: 10 arrived", caption)
            self.assertIn("Simulated robots and radio, seed 3.", caption)

    def test_outliers_stand_apart_and_are_in_no_bin(self):
        axes = figures.plt.figure().add_subplot()
        values = numpy.array([10.0, 30.0, 350.0, 410.0])
        figures._histogram(axes, [values], 100, numpy.arange(0, 101, 20), ["red"])  # pylint: disable=protected-access
        *bins, apart = [(bar.get_x(), bar.get_height()) for bar in axes.patches]
        self.assertEqual([height for _, height in bins], [1, 1, 0, 0, 0])
        self.assertGreater(apart[0], 100)
        self.assertEqual(apart[1], 2)
        self.assertIn("2 beyond,\nup to 410 ms", [text.get_text() for text in axes.texts])
        figures.plt.close()

    def test_caption_names_messages_that_were_never_sent(self):
        events = some_events(5, "update") + [Event(t_us=n, source=ROBOTS, event="refused", robot="robot1", mesh="ble", direction="up", number=n)
                                             for n in range(10, 65)]
        caption = figures.caption(result_of(catalogue.find("ble-reliable"), "ble", events)).replace("\n", " ")
        self.assertIn("55 of 60 never left the robot, 91.7 % (81.9 to 96.4 %); 0 of 5 sent were lost, 0.0 % (0.0 to 43.4 %)", caption)

    def test_loss_is_compared_in_the_quantity_of_the_thesis(self):
        caption = figures.caption(result_of(catalogue.find("ble-one-obstacle"), "ble", some_events(10, "update"))).replace("\n", " ")
        self.assertIn("0.0 % (0.0 to 29.9 %) at 400 and 600 ms, as the thesis read it", caption)

    def test_only_what_is_simulated_is_marked_as_such(self):
        experiment = catalogue.find("ble-hop")
        events = some_events(10, "update")
        sizes = []
        for is_simulated in (True, False):
            with tempfile.TemporaryDirectory() as directory:
                result = result_of(experiment, "ble", events, is_simulated)
                self.assertEqual("Simulated" in figures.caption(result), is_simulated)
                figures.draw(directory, result, events)
                with open(os.path.join(directory, "figure.svg"), encoding="utf-8") as file:
                    sizes.append("<!-- SIMULATED -->" in file.read())
        self.assertEqual(sizes, [True, False])

    def test_caption_of_an_interrupted_run_says_so(self):
        events = some_events(5, "update")
        caption = figures.caption(result_of(catalogue.find("ble-hop"), "ble", events, complete=False))
        self.assertIn("NOT COMPLETE", caption)


    def test_names_of_robots_are_text(self):
        """Names are not formulas of Matplotlib, and no name is left out of the legend."""
        names = ["$\\frac{x$", "_hidden", "<img src=x onerror=alert(1)>" + "x" * 40, "机器人"]
        experiment = catalogue.find("ble-two-robots")
        for count in (2, 4, 9):
            events = [dataclasses.replace(event, robot=(names + list("abcde"))[n])
                      for n in range(count) for event in some_events(5, "update")]
            with self.subTest(count=count), tempfile.TemporaryDirectory() as directory:
                result = result_of(experiment, "ble", events)
                result["differs"] = ["the simulator with $\\int"]
                figures.draw(directory, result, events)
                self.assertGreater(os.path.getsize(os.path.join(directory, "figure.png")), 1000)

    def test_one_outlier_does_not_make_millions_of_bins(self):
        for name in ("ble-one-obstacle", "ble-latency", "thread-hop"):
            experiment = catalogue.find(name)
            events = some_events(20, "update")
            for event in events[-3:]:
                event.t_us += 2 ** 50
            with self.subTest(name=name), tempfile.TemporaryDirectory() as directory:
                figures.draw(directory, result_of(experiment, experiment.meshes[0], events), events)
                self.assertLess(os.path.getsize(os.path.join(directory, "figure.svg")), 1_000_000)

    def test_only_the_experiment_in_the_ring_fits_a_circle(self):
        events = some_events(9, "update")
        for n, event in enumerate(events):
            event.payload = event.payload and f"00000000{n + 1:02x}00{n * n % 250:02x}00"
        self.assertNotIn("ring", measure.measured(events, "update", 200))
        self.assertIn("ring", measure.measured(events, "update", 200, in_ring=True))


class Page(unittest.TestCase):
    def make(self, directory, name, mesh, compressed=1):
        experiment = catalogue.find(name)
        events = some_events(20, experiment.message_type())
        inner = os.path.join(directory, name)
        os.makedirs(inner)
        recorder = folder.Recorder(inner)
        for event in events:
            recorder.write(event)
        recorder.close()
        result = result_of(experiment, mesh, events)
        result["conditions"]["time_compressed"] = compressed
        folder.write_result(inner, result)
        figures.draw(inner, result, events)
        return inner

    def test_both_meshes_on_one_page_that_needs_nothing_else(self):
        with tempfile.TemporaryDirectory() as directory:
            ble, thread = self.make(directory, "ble-latency", "ble"), self.make(directory, "thread-puback", "thread")
            out = os.path.join(directory, "index.html")
            page.write_both(out, directory)
            with open(out, encoding="utf-8") as file:
                text = file.read()
            self.assertEqual(text.count('src="data:image/svg+xml;base64,'), 2)
            self.assertNotIn("http", text.replace("http-equiv", ""))
            self.assertIn("SIMULATED", text)
            table = page.compare([ble, thread], out)
            self.assertIn("ble-latency on BLE Mesh", table)
            self.assertIn("thread-puback on Thread", table)

    def test_compressed_times_never_stand_beside_real_ones(self):
        with tempfile.TemporaryDirectory() as directory:
            ble, thread = self.make(directory, "ble-latency", "ble"), self.make(directory, "thread-puback", "thread", compressed=8)
            out = os.path.join(directory, "index.html")
            table = page.compare([ble, thread], out)
            self.assertIn("not compared: compressed 8 times", table)
            self.assertNotIn(" ms", table)
            page.write_both(out, directory)
            with open(out, encoding="utf-8") as file:
                real, compressed = file.read().split("<h2>Time compressed 8 times")
            self.assertNotIn("<td>thread-puback", real.split("In real time")[1])
            self.assertNotIn("<td>ble-latency", compressed)

    def test_missing_figure_of_a_folder_is_named_on_the_page(self):
        with tempfile.TemporaryDirectory() as directory:
            inner = self.make(directory, "ble-latency", "ble")
            os.remove(os.path.join(inner, "figure.svg"))
            out = os.path.join(directory, "compare.html")
            page.compare([inner, inner], out)
            with open(out, encoding="utf-8") as file:
                self.assertIn("slam-gateway-experiment plot", file.read())


if __name__ == "__main__":
    unittest.main()
