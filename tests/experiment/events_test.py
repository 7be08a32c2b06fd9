# SPDX-License-Identifier: Apache-2.0
"""Reading the sources, the clock that is stepped, and events.csv."""
import itertools
import json
import os
import tempfile
import unittest

import recount

from slamgw_experiment import events, folder
from slamgw_experiment.clock import Axis
from slamgw_experiment.run import parse

# As `slam-gatewayctl --json watch` and `slam-gateway-sim --trace` have written them.
ARRIVED = ('{"at":"2026-11-22T05:12:36.225772Z","event":"arrived","robot":"robot1","mesh":"ble","address":"0x0100",'
           '"topic":"ntnu-slam/robot/robot1/probe","type":"probe","direction":"up","qos":1,"message_id":"17","dup":false,'
           '"bytes":6,"rssi_dbm":-61,"ttl":3,"hops":2,"payload":"1300100e0000","a_new_member":[1]}')
WITHOUT_EVENT = ('{"direction":"up","mesh":"ble","payload_hex":"0a00ecff","qos":1,"robot":"ble-0100",'
                 '"time":"2026-11-22T05:12:28Z","topic":"ntnu-slam/robot/ble-0100/update","type":"update"}')
REFUSED = '{"at":"2026-11-22T05:12:28.264621Z","event":"refused","robot":"robot1","mesh":"ble","direction":"up","number":7}'


class Sources(unittest.TestCase):
    def test_an_arrived_probe_has_its_number_and_the_senders_clock(self):
        event = events.from_members(events.GATEWAY, parse(events.GATEWAY, ARRIVED))
        self.assertTrue(event.is_arrival_of("probe"))
        self.assertEqual((event.number, event.sender_ms), (0x13, 0x0e10))
        self.assertEqual((event.rssi_dbm, event.hops, event.dup, event.message_id), (-61.0, 2, 0, "17"))

    def test_a_line_without_an_event_is_an_arrival(self):
        event = events.from_members(events.GATEWAY, parse(events.GATEWAY, WITHOUT_EVENT))
        self.assertTrue(event.is_arrival_of("update"))
        self.assertEqual((event.payload, event.bytes, event.at), ("0a00ecff", 4, ""))

    def test_downlink_event_is_not_an_arrival(self):
        event = events.from_members(events.GATEWAY, parse(events.GATEWAY, WITHOUT_EVENT.replace('"up"', '"down"')))
        self.assertEqual(event.event, "command")
        self.assertFalse(event.is_arrival_of("update"))

    def test_hops_are_relays(self):
        """As the gateway reports them: daemon/core/messages.hpp, RadioFacts."""
        self.assertEqual(events.COLUMNS["hops"][1], "BLE Mesh: relays that it passed; 0: none")

    def test_members_of_the_wrong_type_are_left_out(self):
        members = {"event": "arrived", "qos": "many", "bytes": None, "rssi_dbm": "x", "robot": 7, "payload": "zz", "type": "probe"}
        event = events.from_members(events.GATEWAY, members)
        self.assertEqual((event.qos, event.rssi_dbm, event.robot, event.number), (None, None, "7", None))

    def test_invalid_lines_are_left_out(self):
        for text in ("", "{", "[]", "7", '"x"', "\x00"):
            self.assertIsNone(parse(events.GATEWAY, text))
        for text in ("", "x", "1795324356\t00", "nan\t00\ttopic", "1e300\t00\ttopic"):
            self.assertIsNone(parse(events.BROKER, text))

    def test_a_broker_line(self):
        for robot in ("robot1", "a b", "tab\tx", " "):
            for payload in ("010000000000", ""):
                members = parse(events.BROKER, f"1795324356.225772\t{payload}\tntnu-slam/robot/{robot}/probe\n")
                self.assertEqual((members["robot"], members["type"], members["payload"]), (robot, "probe", payload))

    def test_times_have_microseconds(self):
        self.assertEqual(events.microseconds_since_1970("1970-01-01T00:00:01.000002Z"), 1_000_002)
        self.assertEqual(events.microseconds_since_1970("1970-01-01T01:00:01+01:00"), 1_000_000)
        self.assertIsNone(events.microseconds_since_1970("yesterday"))


class SteppedClock:
    def __init__(self):
        self.wall = 1_000_000_000_000_000
        self.monotonic = 5_000_000

    def pass_us(self, by):
        self.wall += by
        self.monotonic += by

    def axis(self):
        return Axis(lambda: self.wall, lambda: self.monotonic)


class Clock(unittest.TestCase):
    def test_clock_step_is_noticed_once_and_keeps_the_axis_continuous(self):
        for step in (3_600_000_000, -3_600_000_000, 100_000, -100_000):
            clock = SteppedClock()
            axis = clock.axis()
            clock.pass_us(1_000_000)
            self.assertIsNone(axis.look())
            before = clock.wall
            clock.pass_us(10_000)
            clock.wall += step
            self.assertEqual(axis.look(), (1_010_000, step))
            self.assertIsNone(axis.look())
            clock.pass_us(200_000)
            # One line was written before the step and read after it, one was written after it.
            self.assertEqual(axis.place(before, axis.now_us()) if abs(step) > 1e6 else 1_000_000, 1_000_000)
            self.assertEqual(axis.place(clock.wall - 1000, axis.now_us()), 1_209_000)
            self.assertEqual([one["by_us"] for one in axis.steps], [step])

    def test_pause_between_two_clock_readings_is_not_a_step(self):
        clock = SteppedClock()
        paused = [True]

        def late_wall():
            if paused[0]:
                clock.pass_us(50_000)
                paused[0] = False
            return clock.wall

        axis = Axis(late_wall, lambda: clock.monotonic)
        self.assertIsNone(axis.look())
        paused[0] = True
        self.assertIsNone(axis.look())
        self.assertEqual(axis.place(clock.wall, axis.now_us()), axis.now_us())

    def test_slewed_clock_is_not_a_step(self):
        clock = SteppedClock()
        axis = clock.axis()
        for _ in range(200):
            clock.pass_us(1_000_000)
            clock.wall += 500
            self.assertIsNone(axis.look())


class Csv(unittest.TestCase):
    def setUp(self):
        self.directory = tempfile.TemporaryDirectory()
        self.addCleanup(self.directory.cleanup)

    def path(self, name="events.csv"):
        return os.path.join(self.directory.name, name)

    def test_written_events_are_read_back(self):
        recorder = folder.Recorder(self.directory.name)
        first = events.from_members(events.GATEWAY, parse(events.GATEWAY, ARRIVED))
        second = events.from_members(events.ROBOTS, parse(events.ROBOTS, REFUSED))
        first.t_us, second.t_us = 20, 10
        second.outcome = 'a "word", and\nanother'
        recorder.write(first)
        recorder.write(second)
        recorder.close()
        self.assertEqual(folder.read_events(self.directory.name), [second, first])

    def test_cells_escape_formulas_and_deceptive_names(self):
        for text, cell in (("=1+1", "'=1+1"), ("-5", "'-5"), ("'@a", "''@a"), ("\t=1", "'\\u0009=1"), ("\r=1", "'\\u000d=1"),
                           ("r\u043ebot", "r\\u043ebot"), ("a\u202eb\u200b", "a\\u202eb\\u200b"), ("b\u20111", "b\\u20111"),
                           ("\u0440\u043e\u0431\u043e\u0442", "\u0440\u043e\u0431\u043e\u0442"), ("it's", "it's"),
                           ("\\u0041", "\\u0041"), ("", "")):
            self.assertEqual(events.to_cell(text), cell)
            self.assertEqual(events.from_cell(cell), text)
        self.assertEqual(events.to_cell(-5), -5)

    def test_a_cell_shows_names_as_the_page_and_the_daemon_do(self):
        vectors = os.path.join(os.path.dirname(__file__), "..", "vectors", "shown.json")
        with open(vectors, encoding="utf-8") as file:
            for text, shown in json.load(file):
                self.assertEqual(events.to_cell(text), shown)
                self.assertEqual(events.from_cell(shown), text)

    def test_a_last_line_that_was_cut_is_left_out(self):
        recorder = folder.Recorder(self.directory.name)
        for t_us in (1, 2):
            event = events.from_members(events.GATEWAY, parse(events.GATEWAY, ARRIVED))
            event.t_us = t_us
            recorder.write(event)
        recorder.close()
        with open(self.path(), encoding="utf-8") as file:
            text = file.read()
        with open(self.path(), "w", encoding="utf-8") as file:
            file.write(text[:-60])
        self.assertEqual([event.t_us for event in folder.read_events(self.directory.name)], [1])

    def test_folder_of_another_version_is_reported(self):
        with open(self.path(), "w", encoding="utf-8") as file:
            file.write("time,what\n1,2\n")
        with self.assertRaisesRegex(folder.BadFolder, "does not begin with the columns of this version"):
            folder.read_events(self.directory.name)
        folder.write_result(self.directory.name, {"format": 7, "program": "slam-gateway-experiment 9.0"})
        with self.assertRaisesRegex(folder.BadFolder, "has format 7, and this program reads 1; .*experiment 9.0"):
            folder.read_result(self.directory.name)

    def test_folder_without_a_result_is_reported(self):
        with self.assertRaisesRegex(folder.BadFolder, "has no result.json"):
            folder.read_result(self.directory.name)
        for text in ("", "{", "[]", '{"a": 1}'):
            with open(self.path("result.json"), "w", encoding="utf-8") as file:
                file.write(text)
            with self.assertRaises(folder.BadFolder):
                folder.read_result(self.directory.name)

    def test_result_without_a_member_is_reported(self):
        whole = recount.WHOLE
        folder.check_members("result.json", whole)
        for name, wrong in itertools.product(folder.MEMBERS, (None, "absent", [[]], -1)):
            with self.subTest(name=name, wrong=wrong):
                broken = json.loads(json.dumps(whole))
                *above, last = name.split(".")
                inner = broken[above[0]] if above else broken
                inner.pop(last) if wrong == "absent" else inner.update({last: wrong})
                if wrong == -1 or wrong == "absent" or not isinstance(wrong, folder.MEMBERS[name]):
                    with self.assertRaisesRegex(folder.BadFolder, "is missing, or not what"):
                        folder.check_members("result.json", broken)
        for member in ({"incidents": [1]}, {"incidents": [{"what": "w"}]}, {"differs": [1]}):
            with self.assertRaisesRegex(folder.BadFolder, "incidents|differs"):
                folder.check_members("result.json", whole | member)

    def test_wrong_mesh_end_and_simulation_without_seed_are_reported(self):
        for member in ({"mesh": "wifi"}, {"simulated": True}, {"conditions": recount.WHOLE["conditions"] | {"end_us": "soon"}}):
            with self.assertRaisesRegex(folder.BadFolder, "(mesh|conditions.seed|conditions.end_us) is missing, or not what"):
                folder.check_members("result.json", recount.WHOLE | member)

    def test_invalid_values_in_the_file_are_left_out_or_reported(self):
        recorder = folder.Recorder(self.directory.name)
        for payload, t_us in (("zz", 1), ("abc", 2), ("0a00ecff", 3)):
            recorder.write(events.Event(t_us=t_us, source="gateway", event="arrived", robot="r", type="update", payload=payload))
        recorder.close()
        with open(self.path(), "a", encoding="utf-8") as file:
            file.write("9" * 30 + "," * 20 + "\n" + "nan" + "," * 20 + "\n" + "1e400" + "," * 20 + "\n")
        read = folder.read_events(self.directory.name)
        self.assertEqual([(one.t_us, one.payload) for one in read], [(1, ""), (2, ""), (3, "0a00ecff")])
        self.assertEqual(events.from_members(events.GATEWAY, {"bytes": float("inf"), "rssi_dbm": float("nan")}).rssi_dbm, None)
        with open(self.path(), "a", encoding="utf-8") as file:
            file.write('"' + "x" * 200_000)
        with self.assertRaisesRegex(folder.BadFolder, "cannot be read: .*field"):
            folder.read_events(self.directory.name)

    def test_a_default_folder_is_always_a_new_one(self):
        first, second = (folder.make_new(self.path("ring-1")) for _ in range(2))
        self.assertEqual(second, first + "-2")

    def test_results_are_never_overwritten(self):
        with open(self.path("precious"), "w", encoding="utf-8"):
            pass
        with self.assertRaisesRegex(folder.BadFolder, "is not empty"):
            folder.make(self.directory.name)


if __name__ == "__main__":
    unittest.main()
