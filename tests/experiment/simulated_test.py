# SPDX-License-Identifier: Apache-2.0
"""All experiments with simulated robots, shortened: their expected results, and that every number follows from events.csv."""
import json
import os
import signal
import subprocess
import tempfile
import time
import unittest

import recount

PROGRAM = os.environ["SLAMGW_EXPERIMENT"]
MESSAGES, COMPRESS = 40, 8


def leftovers():
    """Temporary folders of simulated sites."""
    return {name for name in os.listdir(tempfile.gettempdir()) if name.startswith("slam-gateway-experiment-")}


class All(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.directory = tempfile.TemporaryDirectory()
        cls.out = os.path.join(cls.directory.name, "all")
        cls.ended = subprocess.run([PROGRAM, "run", "all", "--sim", "--mesh", "both", "--messages", str(MESSAGES), "--compress",
                                    str(COMPRESS), "--format", "mcap", "--out", cls.out], capture_output=True, text=True, timeout=280,
                                   check=False)
        cls.results = {}

    @classmethod
    def tearDownClass(cls):
        cls.directory.cleanup()

    def result(self, name):
        return recount.check(self, os.path.join(self.out, name))

    def counts(self, name):
        return self.result(name)["measured"]["counts"]

    def test_all_experiments_succeed_and_their_numbers_follow_from_their_events(self):
        self.assertEqual(self.ended.returncode, 0, self.ended.stderr)
        names = sorted(name for name in os.listdir(self.out) if os.path.isdir(os.path.join(self.out, name)))
        self.assertEqual(len(names), 15)
        for name in names:
            with self.subTest(name=name):
                result = self.result(name)
                self.assertTrue(result["complete"] and result["simulated"])
                self.assertEqual(result["incidents"], [])
                self.assertTrue(any("messages in place of" in text for text in result["differs"]))
                self.assertEqual(any("compressed" in text for text in result["differs"]), result["mesh"] == "thread")
                for file in ("figure.svg", "figure.png", "events.mcap"):
                    self.assertGreater(os.path.getsize(os.path.join(self.out, name, file)), 1000)
        self.assertGreater(os.path.getsize(os.path.join(self.out, "index.html")), 100_000)

    def test_segmented_messages_to_a_group_block_the_next(self):
        """Thesis 9.1: about 2.6 s between them, so that 12 of 13 never leave."""
        measured = self.result("ble-reliable")["measured"]
        self.assertGreater(measured["interval_ms"]["p50"], 2500)
        self.assertLess(measured["counts"]["sent"], MESSAGES / 8)
        self.assertEqual(measured["payload_octets"], {"13": measured["counts"]["arrived"]})

    def test_one_obstacle_fits_one_segment(self):
        self.assertTrue(set(self.result("ble-one-obstacle")["measured"]["payload_octets"]) <= {"4", "8"})

    def test_a_relay_at_the_edge_of_its_range_loses(self):
        lost = self.result("ble-hop")["measured"]["loss"]["exact"]["lost"]
        self.assertTrue(4 <= lost <= 28, lost)

    def test_probes_count_exactly(self):
        loss = self.result("probe-ble")["measured"]["loss"]["exact"]
        counts = self.counts("probe-ble")
        self.assertEqual(loss["sent"], MESSAGES)
        self.assertEqual(loss["lost"], MESSAGES - counts["arrived"])
        self.assertEqual(counts["received_at_broker"], counts["arrived"])

    def test_thread_delivers_all_of_it_once(self):
        counts = self.counts("thread-1000")
        self.assertEqual((counts["sent"], counts["received_at_broker"], counts["doubled_at_broker"]), (MESSAGES, MESSAGES, 0))

    def test_a_relay_on_thread_repeats_and_loses_nothing(self):
        counts = self.counts("thread-hop")
        self.assertGreater(counts["link_repeats"], MESSAGES)
        self.assertEqual(counts["acknowledged"] + counts["given_up"], MESSAGES)

    def test_the_ring_has_its_radius_on_either_mesh(self):
        for name in ("ring-ble", "ring-thread"):
            self.assertAlmostEqual(self.result(name)["measured"]["ring"]["radius_cm"], 79, delta=2.5)


class Several(unittest.TestCase):
    def test_as_many_robots_as_asked_for_speak(self):
        with tempfile.TemporaryDirectory() as directory:
            out = os.path.join(directory, "run")
            ended = subprocess.run([PROGRAM, "run", "ring", "--sim", "--seed", "4", "--robots", "3", "--messages", "5", "--out", out],
                                   capture_output=True, text=True, timeout=120, check=False)
            self.assertEqual(ended.returncode, 0, ended.stderr)
            result = recount.check(self, out)
        self.assertEqual(result["conditions"]["robots"], ["robot1", "robot2", "robot3"])
        self.assertEqual(result["measured"]["counts"]["arrived"], 15)
        self.assertIn("3 robots in place of 1", result["differs"])


class Repeated(unittest.TestCase):
    def test_two_seeds_leave_two_results_and_their_spread(self):
        with tempfile.TemporaryDirectory() as directory:
            out = os.path.join(directory, "repeated")
            ended = subprocess.run([PROGRAM, "run", "thread-puback", "--sim", "--repeat", "2", "--seed", "7", "--messages", str(MESSAGES),
                                    "--compress", str(COMPRESS), "--out", out], capture_output=True, text=True, timeout=120, check=False)
            self.assertEqual(ended.returncode, 0, ended.stderr)
            self.assertEqual([recount.check(self, os.path.join(out, name))["conditions"]["seed"] for name in ("seed-7", "seed-8")], [7, 8])
            self.assertIn("thread-puback on Thread, 2 runs", ended.stdout)
            self.assertGreater(os.path.getsize(os.path.join(out, "figure.png")), 1000)


def children_of(parent):
    """Returns {process id: name} of running processes; a name has 15 characters at most."""
    found = {}
    for entry in filter(str.isdecimal, os.listdir("/proc")):
        try:
            with open(f"/proc/{entry}/stat", encoding="utf-8") as file:
                name, rest = file.read().split("(", 1)[1].rsplit(")", 1)
        except OSError:
            continue
        state, of = rest.split()[:2]
        if int(of) == parent and state != "Z":
            found[int(entry)] = name
    return found


def is_alive(pid):
    try:
        with open(f"/proc/{pid}/stat", encoding="utf-8") as file:
            return file.read().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


class Interrupted(unittest.TestCase):
    def start(self, out, *more, **environment):
        program = subprocess.Popen([PROGRAM, "run", "ble-unreliable", "--sim", "--out", out, *more], stderr=subprocess.DEVNULL,
                                   stdout=subprocess.DEVNULL, env={**os.environ, **environment})
        self.addCleanup(lambda: program.poll() is None and program.kill())
        end = time.monotonic() + 60
        while time.monotonic() < end and self.arrived(out) < 5:
            time.sleep(0.1)
        self.assertGreaterEqual(self.arrived(out), 5)
        return program

    def arrived(self, out):
        try:
            return len(recount.arrivals(recount.rows_of(out), "update"))
        except (OSError, ValueError, TypeError):
            return 0

    def test_ctrl_c_leaves_a_folder_that_can_be_plotted_and_nothing_else(self):
        before = leftovers()
        with tempfile.TemporaryDirectory() as directory:
            out = os.path.join(directory, "run")
            program = self.start(out)
            program.send_signal(signal.SIGINT)
            self.assertEqual(program.wait(30), 1)
            result = recount.check(self, out)
            self.assertEqual((result["complete"], result["ended_early"]), (False, "interrupted"))
            self.assertEqual(subprocess.run([PROGRAM, "plot", out], stdout=subprocess.DEVNULL, check=False).returncode, 0)
            with open(os.path.join(out, "result.json"), encoding="utf-8") as file:
                self.assertGreaterEqual(json.load(file)["measured"]["counts"]["arrived"], 5)
        self.assertEqual(leftovers() - before, set())

    def test_killed_program_ends_its_children(self):
        """Also as root, where Mosquitto would change its user."""
        with tempfile.TemporaryDirectory() as directory:
            out = os.path.join(directory, "run")
            program = self.start(out, TMPDIR=directory)
            children = children_of(program.pid)
            # It asks slam-gatewayctl for the status now and then, so there may be one more.
            self.assertEqual({"mosquitto", "mosquitto_sub", "slam-gateway-si", "slam-gatewayctl", "slam-gatewayd"} - set(children.values()), set())
            program.kill()
            program.wait(15)
            end = time.monotonic() + 30
            while time.monotonic() < end and any(map(is_alive, children)):
                time.sleep(0.1)
            left = {pid: name for pid, name in children.items() if is_alive(pid)}
            for pid in left:
                os.kill(pid, signal.SIGKILL)
            self.assertEqual(left, {})

    def test_record_that_cannot_be_written_ends_the_run(self):
        with tempfile.TemporaryDirectory() as directory:
            out = os.path.join(directory, "run")
            ended = subprocess.run([PROGRAM, "run", "thread-publish", "--sim", "--messages", "20", "--sim-args", "--record /dev/full",
                                    "--out", out], capture_output=True, text=True, timeout=60, check=False)
            self.assertEqual(ended.returncode, 1)
            result = recount.check(self, out)
            self.assertFalse(result["complete"])
            self.assertIn("slam-gateway-sim has ended with status 1: slam-gateway-sim: /dev/full cannot be written: No space left on device",
                          result["ended_early"])

    def test_lost_broker_leaves_received_events(self):
        with tempfile.TemporaryDirectory() as directory:
            out = os.path.join(directory, "run")
            program = self.start(out, "--messages", "40")
            os.kill(next(pid for pid, name in children_of(program.pid).items() if name == "mosquitto"), signal.SIGKILL)
            self.assertEqual(program.wait(60), 1)
            result = recount.check(self, out)
            self.assertFalse(result["complete"])
            self.assertIn("mosquitto has ended", result["ended_early"])
            self.assertTrue(any("lost the broker" in one["what"] for one in result["incidents"]))


if __name__ == "__main__":
    unittest.main()
