# SPDX-License-Identifier: Apache-2.0
"""Runs on a faulty site: every end of a run leaves a folder that can be plotted."""
import contextlib
import io
import json
import os
import resource
import signal
import subprocess
import tempfile
import threading
import time
import unittest
import unittest.mock

import recount

from slamgw_experiment import catalogue, events, figures, folder, main
from slamgw_experiment.clock import Axis
from slamgw_experiment.programs import Programs
from slamgw_experiment.run import Progress, Run

PROGRAM = os.environ["SLAMGW_EXPERIMENT"]


class Source:
    has_ended = False


class Site:
    """Plays a daemon with real robots; `script` produces its events."""

    simulator_arguments = None

    def __init__(self, script, robots=("r1",), broker="up"):
        self.robots = list(robots)
        self.closed = False
        self._script = script
        self.broker = broker
        self.source = Source()

    def start(self):
        pass

    def status(self):
        return {"version": "0.1.0", "broker": {"state": self.broker, "why": "Connection refused"}}

    def known_robots(self):
        return ["robot7", "robot8"]

    def start_robots(self):
        threading.Thread(target=self._script, args=(self,), daemon=True).start()

    def have_robots_ended(self):
        return False

    def trouble(self):
        return None

    def why_trace_ended(self):
        return "the daemon's trace has ended"

    def open_sources(self, lines, now_us):
        self.lines, self.now_us = lines, now_us
        return {events.GATEWAY: self.source}

    def close(self):
        self.closed = True

    def say(self, source=events.GATEWAY, **members):
        line = {"event": "arrived", "robot": "r1", "mesh": "ble", "type": "update", "direction": "up", "payload": "0a00ecff", **members}
        self.lines.put((source, json.dumps(line), self.now_us()))


class SimulatedSite(Site):
    """Simulated robots that end with `is_over`."""

    simulator_arguments = ["ble"]
    is_over = False

    def have_robots_ended(self):
        return self.is_over


def arrive(site, count, interval_s=0.01, **members):
    for _ in range(count):
        site.say(**members)
        time.sleep(interval_s)


class Runs(unittest.TestCase):
    def setUp(self):
        self.directory = tempfile.TemporaryDirectory()
        self.addCleanup(self.directory.cleanup)
        self.is_stopped = False

    def run_on(self, site, messages=10, wait_s=5, axis=None, draws_again=False, settle_s=0.0, said=None, kind="update"):
        """Returns (status, result.json, printed text)."""
        asked = main.Asked(messages, 200, kind, 1, wait_s, 1, "csv", "0.1.0", settle_s=settle_s)
        said = said or io.StringIO()
        with contextlib.redirect_stderr(said):
            run = Run(catalogue.find("ble-unreliable"), "ble", site, self.directory.name, asked, Programs(),
                      lambda: self.is_stopped, axis)
            run._progress._file = said
            status = run.measure()
        self.assertTrue(site.closed)
        for name in ("events.csv", "result.json", "figure.svg", "figure.png"):
            self.assertTrue(os.path.getsize(os.path.join(self.directory.name, name)) > 100, name)
        if draws_again:
            with contextlib.redirect_stdout(io.StringIO()):
                self.assertEqual(main.plot(self.directory.name), 0)
        return status, recount.check(self, self.directory.name), said.getvalue()

    def test_run_ends_when_all_messages_have_arrived(self):
        status, result, _ = self.run_on(Site(lambda site: arrive(site, 10)))
        self.assertEqual((status, result["complete"], result["simulated"]), (0, True, False))
        self.assertEqual(result["measured"]["counts"]["arrived"], 10)
        self.assertEqual(result["conditions"]["robots"], ["r1"])

    def test_progress_stops_at_the_requested_number(self):
        with unittest.mock.patch.object(Progress, "show", autospec=True) as show:
            _, result, _ = self.run_on(Site(lambda site: arrive(site, 60)), messages=20, settle_s=0.5, draws_again=True)
        self.assertEqual(result["measured"]["counts"]["arrived"], 20)
        shown = [call.args[1:3] for call in show.call_args_list]
        self.assertEqual(shown[-1], (20, 20))
        self.assertEqual(shown, sorted(shown))

    def test_probes_count_until_the_end_of_the_run_although_nothing_came_later(self):
        def script(site):
            for number in range(10):
                sender_ms = site.now_us() // 1000
                site.say(type="probe", payload=(number.to_bytes(2, "little") + sender_ms.to_bytes(4, "little")).hex())
        status, result, said = self.run_on(Site(script), settle_s=1.0, draws_again=True, kind="probe")
        self.assertEqual(status, 0, said)
        self.assertEqual(result["measured"]["loss"]["exact"]["sent"], 10)
        self.assertGreaterEqual(result["conditions"]["end_us"], 0)

    def test_robot_that_never_appears_is_reported(self):
        status, result, said = self.run_on(Site(lambda site: None), wait_s=0.3, draws_again=True)
        self.assertEqual((status, result["complete"]), (1, False))
        self.assertIn("nothing of type update came from r1 in 0.3 s; the daemon knows robot7, robot8", said)

    def test_missing_one_of_two_robots_is_reported(self):
        status, result, said = self.run_on(Site(lambda site: arrive(site, 10, 0.1), robots=("r1", "r2")), wait_s=0.3)
        self.assertEqual((status, result["complete"], result["measured"]["counts"]["arrived"]), (1, False, 10))
        self.assertIn("r2 did not appear", said)
        caption = figures.caption(result).replace("\n", " ")
        self.assertRegex(caption, "NOT COMPLETE: see below. At [01] s: r2 did not appear in 0.3 s.")

    def test_messages_of_other_robots_do_not_count(self):
        def script(site):
            arrive(site, 5, robot="stranger")
            arrive(site, 10)
        _, result, _ = self.run_on(Site(script))
        self.assertEqual(result["measured"]["counts"]["arrived"], 10)

    def test_robot_on_the_other_mesh_ends_the_run(self):
        status, result, said = self.run_on(Site(lambda site: arrive(site, 20, mesh="thread")))
        self.assertEqual((status, result["complete"], result["measured"]["counts"]["arrived"]), (1, False, 0))
        self.assertIn("r1 is on Thread; ble-unreliable measures BLE Mesh", said)

    def test_a_robot_may_be_on_both_meshes(self):
        def script(site):
            for _ in range(5):
                arrive(site, 1, mesh="thread")
                arrive(site, 2)
        status, result, _ = self.run_on(Site(script))
        self.assertEqual((status, result["complete"], result["measured"]["counts"]["arrived"]), (0, True, 10))

    def test_absence_of_the_broker_is_reported_and_makes_the_run_incomplete(self):
        def script(site):
            arrive(site, 3)
            site.broker = "down"
            time.sleep(2.5)
            site.broker = "up"
            time.sleep(2.5)
            arrive(site, 57)
        status, result, said = self.run_on(Site(script), messages=60)
        self.assertEqual((status, result["complete"], result["measured"]["counts"]["arrived"]), (1, False, 60))
        self.assertIn("the daemon has lost the broker: Connection refused", said)
        self.assertEqual([one["what"].split(":")[0] for one in result["incidents"]], ["the daemon has lost the broker", "the broker is back"])

    def test_run_without_a_broker_fails(self):
        status, _, said = self.run_on(Site(lambda site: None, broker="down"))
        self.assertEqual(status, 1)
        self.assertIn("the daemon has no broker: Connection refused", said)

    def test_end_of_the_daemon_ends_the_run(self):
        def script(site):
            arrive(site, 4)
            site.source.has_ended = True
        status, result, said = self.run_on(Site(script))
        self.assertEqual((status, result["complete"], result["measured"]["counts"]["arrived"]), (1, False, 4))
        self.assertIn("the daemon's trace has ended", said)

    def test_ctrl_c_ends_the_run_with_its_folder(self):
        def script(site):
            arrive(site, 4)
            self.is_stopped = True
        status, result, _ = self.run_on(Site(script), draws_again=True)
        self.assertEqual((status, result["ended_early"], result["measured"]["counts"]["arrived"]), (1, "interrupted", 4))

    def test_full_disk_keeps_received_events_and_ends_the_run(self):
        """A limit on the size of files plays the full disk; it is lifted when the site is closed."""
        soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)

        class FullDisk(Site):
            def close(self):
                resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
                super().close()

        def script(site):
            resource.setrlimit(resource.RLIMIT_FSIZE, (6000, hard))
            arrive(site, 300, 0.002)
        status, result, said = self.run_on(FullDisk(script), messages=300, draws_again=True)
        self.assertEqual((status, result["complete"]), (1, False))
        self.assertIn("events.csv cannot be written: File too large", said)
        self.assertGreater(result["measured"]["counts"]["arrived"], 20)

    def run_recorded(self, is_whole):
        """Three messages and a copy arrive; a record that is not whole lacks the first line."""
        def script(site):
            for number in range(3):
                if number > 0 or is_whole:
                    site.say(events.ROBOTS, event="sent", number=number, payload=f"0{number}00ecff")
                site.say(payload=f"0{number}00ecff")
            site.say(payload="0200ecff")
            site.is_over = True
        status, result, _ = self.run_on(SimulatedSite(script))
        return status, result["complete"], result.get("ended_early")

    def test_complete_record_of_the_robots_is_accepted(self):
        self.assertEqual(self.run_recorded(is_whole=True), (0, True, None))

    def test_incomplete_record_of_the_robots_is_reported(self):
        """After a disk was full for a while, 2 sent and 3 arrived messages gave a loss of 0."""
        self.assertEqual(self.run_recorded(is_whole=False),
                         (1, False, "the robots' record is incomplete: more messages arrived than it says were sent"))

    def test_closed_terminal_does_not_end_the_run(self):
        class Closed(io.StringIO):
            def write(self, _):
                raise OSError(5, "Input/output error")
        status, result, _ = self.run_on(Site(lambda site: arrive(site, 10)), said=Closed())
        self.assertEqual((status, result["complete"], result["measured"]["counts"]["arrived"]), (0, True, 10))

    def test_two_runs_do_not_write_into_one_folder(self):
        recorder = folder.Recorder(self.directory.name)
        self.addCleanup(recorder.close)
        with self.assertRaisesRegex(folder.BadFolder, "another run writes to this folder"):
            self.run_on(Site(lambda site: None))

    def test_step_of_the_clock_is_reported_and_corrected(self):
        step_us = [0]
        axis = Axis(lambda: time.time_ns() // 1000 + step_us[0])

        def script(site):
            for n in range(10):
                if n == 5:
                    step_us[0] = -3_600_000_000
                wall = (time.time_ns() // 1000 + step_us[0]) / 1e6
                site.say(at=time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(wall)) + f"{wall % 1:.6f}Z"[1:])
                time.sleep(0.1)
        status, result, said = self.run_on(Site(script), axis=axis)
        self.assertEqual((status, result["complete"]), (1, False))
        self.assertIn("the clock was set by -3600.", said)
        self.assertEqual(len(result["conditions"]["clock"]["steps"]), 1)
        self.assertLess(result["measured"]["interval_ms"]["max"], 5000)
        self.assertGreater(result["measured"]["interval_ms"]["min"], 0)


def write_program(directory, name, text):
    path = os.path.join(directory, name)
    with open(path, "w", encoding="utf-8") as file:
        file.write(f"#!/bin/sh\n{text}\n")
    os.chmod(path, 0o755)


def eventually(is_so, patience_s=30):
    end = time.monotonic() + patience_s
    while time.monotonic() < end:
        if is_so():
            return True
        time.sleep(0.02)
    return False


def is_alive(pid_file):
    """Returns whether the process runs whose id is in the file; a zombie does not run."""
    try:
        with open(pid_file, encoding="utf-8") as file:
            pid = file.read().strip()
        if not pid:
            return False  # it is being written
        with open(f"/proc/{pid}/stat", encoding="utf-8") as file:
            return file.read().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


class Program(unittest.TestCase):
    """The program itself, as a user starts it."""

    def run_program(self, *arguments):
        said = subprocess.run([PROGRAM, *arguments], capture_output=True, text=True, timeout=60, check=False)
        return said.returncode, said.stdout, said.stderr

    def test_lists_every_experiment_and_figure_of_the_thesis(self):
        status, out, _ = self.run_program("list")
        self.assertEqual(status, 0)
        for figure in [f"8.{n}" for n in (1, 2, 3, 4, 5, 6, 7, 8, 9, 13, 14)] + ["8.10-8.12"]:
            self.assertIn(f"figure {figure} ", out)

    def test_wrong_arguments_end_with_two(self):
        for arguments, words in ((["run", "ble-latency"], "--robots ID,... and --sim"), (["run", "nothing", "--sim"], "there is no experiment"),
                                 (["run", "ble-hop", "--sim", "--mesh", "thread"], "on BLE Mesh only"),
                                 (["run", "ring", "--sim", "--messages", "-1"], "not above 0"), ([], "required"),
                                 (["run", "ring", "--sim", "--messages", "1000000000"], "below 1e9"),
                                 (["run", "ring", "--sim", "--period-ms", "nan"], "not above 0"),
                                 (["run", "ring", "--sim", "--seed", "-1"], "not 0 to"),
                                 (["run", "ring", "--sim", "--sim-args", "'"], "cannot be split into options"),
                                 (["run", "ring", "--robots", "r1", "--compress", "1", "--sim-args=--x"], "only with --sim: --compress, --sim-args"),
                                 (["run", "ring", "--robots", "r1", "--seed", "0"], "only with --sim: --seed"),
                                 (["run", "ring", "--robots", " ,"], "no robot is named"),
                                 (["run", "ring", "--sim", "--robots", "r1"], "a number, 1 to"), (["run", "ring", "--sim", "--robots", "0"], "a number, 1 to"),
                                 (["run", "limits", "--sim", "--robots", "3"], "leave --robots out"),
                                 (["run", "ring", "--sim", "--broker", "127.0.0.1:1883"], "leave --broker out"),
                                 (["run", "ring", "--robots", "r1", "--broker", "here"], "not HOST:PORT")):
            status, _, err = self.run_program(*arguments)
            self.assertEqual((status, words in err), (2, True), err)

    def test_a_simulator_that_refuses_its_options_is_quoted(self):
        with tempfile.TemporaryDirectory() as directory:
            status, _, err = self.run_program("run", "ring", "--sim", "--messages", "3", "--sim-args", "--qos 7", "--out", f"{directory}/out")
        self.assertEqual(status, 1)
        self.assertRegex(err, "slam-gateway-sim has ended with status 2: .*7")
        self.assertEqual(err.count("has ended with status 2"), 1)

    def test_options_of_the_simulator_replace_those_of_the_experiment(self):
        words = catalogue.simulator_options(catalogue.find("ble-hop"), "ble", ["--on-busy=refuse", "--hop-loss", "0.1", "--hops", "3"])
        self.assertEqual(words, ["--segment-timing", "--no-stray", "--max-obstacles", "1", "--bearer-interval-ms", "20", "--hop-delay-ms",
                                 "2", "--on-busy=refuse", "--hop-loss", "0.1", "--hops", "3"])
        with tempfile.TemporaryDirectory() as directory:
            status, _, err = self.run_program("run", "ble-one-obstacle", "--sim", "--messages", "3", "--sim-args", "--on-busy refuse",
                                              "--out", f"{directory}/out")
        self.assertEqual(status, 0, err)

    def test_options_of_the_simulator_may_be_one_word(self):
        for words in (["--sim-args", "--no-such-option"], ["--sim-args=--no-such-option"]):
            with tempfile.TemporaryDirectory() as directory:
                status, _, err = self.run_program("run", "ring", "--sim", "--messages", "3", *words, "--out", f"{directory}/out")
            self.assertEqual(status, 1)
            self.assertRegex(err, "slam-gateway-sim has ended with status 2: .*--no-such-option")

    def test_ctrl_c_while_the_broker_starts(self):
        with tempfile.TemporaryDirectory() as directory:
            write_program(directory, "mosquitto", f"[ $1 = -h ] || echo $$ >{directory}/pid; [ $1 = -h ] || exec sleep 60")
            program = subprocess.Popen([PROGRAM, "run", "ring", "--sim", "--out", f"{directory}/out"], stderr=subprocess.PIPE, text=True,
                                       stdout=subprocess.DEVNULL, env={**os.environ, "PATH": f"{directory}:{os.environ['PATH']}"})
            self.addCleanup(lambda: program.poll() is None and program.kill())
            self.assertTrue(eventually(lambda: os.path.exists(f"{directory}/pid")))
            program.send_signal(signal.SIGINT)
            _, err = program.communicate(timeout=15)
            self.assertEqual(program.returncode, 1)
            self.assertIn("interrupted. What came so far is in", err)
            self.assertTrue(eventually(lambda: not is_alive(f"{directory}/pid")))

    def test_killed_program_ends_its_children(self):
        with tempfile.TemporaryDirectory() as directory:
            write_program(directory, "mosquitto", f"[ $1 = -h ] || echo $$ >{directory}/pid; [ $1 = -h ] || exec sleep 60")
            program = subprocess.Popen([PROGRAM, "run", "ring", "--sim", "--out", f"{directory}/out"], stderr=subprocess.DEVNULL,
                                       stdout=subprocess.DEVNULL, env={**os.environ, "PATH": f"{directory}:{os.environ['PATH']}",
                                                                       "TMPDIR": directory})
            self.addCleanup(lambda: program.poll() is None and program.kill())
            self.assertTrue(eventually(lambda: os.path.exists(f"{directory}/pid") and is_alive(f"{directory}/pid")))
            program.kill()
            program.wait(15)
            self.assertTrue(eventually(lambda: not is_alive(f"{directory}/pid")))

    def test_broker_that_refuses_the_subscriber_is_reported(self):
        """With robots of a daemon that is played by a script."""
        line = {"event": "arrived", "robot": "r1", "mesh": "ble", "type": "update", "direction": "up", "payload": "0a00ecff"}
        with tempfile.TemporaryDirectory() as directory:
            write_program(directory, "slam-gatewayctl", "case \"$*\" in *status*) echo '{\"broker\": {\"state\": \"up\"}}' ;; "
                          f"*watch*) for n in 1 2 3 4 5; do echo '{json.dumps(line)}'; sleep 1; done; sleep 60 ;; esac")
            with contextlib.redirect_stderr(io.StringIO()), contextlib.redirect_stdout(io.StringIO()):
                status = main.main("0.1.0", directory, ["run", "ble-unreliable", "--robots", "r1", "--messages", "3", "--broker",
                                                        "127.0.0.1:1", "--out", f"{directory}/out"])
            self.assertEqual(status, 1)
            with open(f"{directory}/out/result.json", encoding="utf-8") as file:
                incidents = [one["what"] for one in json.load(file)["incidents"]]
            self.assertEqual(len(incidents), 1)
            self.assertRegex(incidents[0], "the subscriber at 127.0.0.1:1 has ended: .*refused")

    def test_folder_without_write_permission_is_reported(self):
        status, _, err = self.run_program("run", "ring", "--sim", "--out", "/proc/self/out")
        self.assertEqual(status, 1)
        self.assertRegex(err, "^slam-gateway-experiment: /proc/self/out cannot be used: .*\n$")

    def test_closed_pipe_ends_the_list_without_a_message(self):
        program = subprocess.Popen([PROGRAM, "list"], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        program.stdout.close()
        with program.stderr:
            self.assertEqual(program.stderr.read(), b"")
        self.assertEqual(program.wait(15), 1)

    def test_missing_daemon_is_reported(self):
        with tempfile.TemporaryDirectory() as directory:
            status, _, err = self.run_program("run", "ble-hop", "--robots", "r1", "--socket", f"{directory}/none", "--out", f"{directory}/out")
            self.assertEqual(status, 1)
            self.assertIn("the daemon does not answer at", err)
            with open(f"{directory}/out/result.json", encoding="utf-8") as file:
                self.assertFalse(json.load(file)["complete"])
            self.assertEqual(self.run_program("plot", f"{directory}/out")[0], 0)

    def test_folders_without_results_are_reported(self):
        with tempfile.TemporaryDirectory() as directory:
            self.assertIn("has no result.json", self.run_program("plot", directory)[2])
            self.assertEqual(self.run_program("compare", directory, directory)[0], 1)


if __name__ == "__main__":
    unittest.main()
