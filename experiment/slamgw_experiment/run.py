# SPDX-License-Identifier: Apache-2.0
"""One run: reads the sources until enough messages have come, and leaves a result folder at any end."""
import collections
import datetime
import json
import os
import platform
import queue
import sys
import time

import matplotlib
import numpy

from slamgw_experiment import events, figures, folder, mcap, measure
from slamgw_experiment.clock import Axis
from slamgw_experiment.programs import new_queue
from slamgw_experiment.sites import SiteFailure

STATUS_INTERVAL_S = 2
MOST_ELSEWHERE = 10    # messages of a robot on the other mesh before one on the measured mesh
QUIET_END_S = 1.0      # after the robots have ended, for messages in flight
# Time for the last messages of real robots: two repeats of a Thread client, 8 s apart, and its timeout.
SETTLE_S = {"ble": 1.0, "thread": 25.0}


class Progress:
    """One line on a terminal, a line now and then elsewhere."""

    def __init__(self, title, file=sys.stderr):
        self._title = title
        self._file = file
        self._is_terminal = file.isatty()
        self._next_s = 0.0
        self._width = 0

    def show(self, done, of, seconds_left, passed_s):
        if passed_s < self._next_s:
            return
        self._next_s = passed_s + (0.5 if self._is_terminal else 15)
        left = f", {seconds_left:.0f} s left" if seconds_left is not None else ""
        self._write(f"{self._title}: {done} of {of} messages{left}")

    def _write(self, text):
        if self._is_terminal:
            self._put("\r" + text.ljust(self._width))
            self._width = len(text)
        else:
            self._put(text + "\n")

    def _put(self, text):
        """Writes the text; a closed terminal or pipe must not end a run."""
        try:
            self._file.write(text)
            self._file.flush()
        except OSError:
            pass

    def say(self, text):
        """Prints a separate line."""
        if self._is_terminal and self._width:
            text = "\n" + text
            self._width = 0
        self._put(text + "\n")


class Run:
    """`asked`: messages, period_ms, wait_s, compress, message_type. `stop` is a function that returns whether Ctrl-C came."""

    def __init__(self, experiment, mesh, site, directory, asked, programs, stop, axis=None):
        self._experiment = experiment
        self._mesh = mesh
        self._site = site
        self._directory = directory
        self._asked = asked
        self._programs = programs
        self._stop = stop
        self._axis = axis or Axis()
        self._progress = Progress(experiment.name if len(experiment.meshes) == 1 else f"{experiment.name} ({mesh})")
        self._lines = new_queue()
        self._incidents = []
        self._heard = {}         # robot: arrivals
        self._first_us = None
        self._sent = 0           # by simulated robots
        self._is_broker_up = True
        self._robots_ended_us = None
        self._settles_until_s = None
        self._end_us = None      # messages made later may still be on their way
        self._trouble = None
        self._elsewhere = collections.Counter()  # arrivals on the other mesh
        self._misplaced = None   # why a robot cannot be measured
        self._daemon = {}        # its status at the start
        self._begun = datetime.datetime.now(datetime.timezone.utc)

    def measure(self):
        """Runs, writes the folder, returns the exit status: 0, or 1 when the run is not complete."""
        try:
            recorder = folder.Recorder(self._directory)
            folder.write_result(self._directory, self._result(None, False, {}))
            ended = self._record(recorder)
        finally:
            self._site.close()
        return self._finish(ended)

    def _record(self, recorder):
        """Records events. Returns None when the run is complete, else the reason. Closes the recorder."""
        try:
            self._site.start()
            self._daemon = self._site.status() or {}
            self._check_broker(self._daemon, at_start=True)
            sources = self._site.open_sources(self._lines, self._axis.now_us)
            self._site.start_robots()
            return self._read(recorder, sources)
        except SiteFailure as failure:
            return str(failure)
        except folder.CannotWrite as error:
            return str(error)
        finally:
            self._end_us = self._axis.now_us() - round(self._settle_s() * 1e6)
            recorder.close()

    def _finish(self, ended):
        ones = folder.read_events(self._directory)
        counted = measure.counted(ones, self._asked.message_type, self._asked.messages, self._period_ms(), self._end_us)
        measured = measure.measured(counted, self._asked.message_type, self._period_ms(), self._experiment.is_in_ring())
        if not ended and not measured["counts"]["arrived"]:
            ended = "no message of the wanted type arrived"
        if not ended and self._site.simulator_arguments is not None and measure.has_unsent_arrivals(ones, self._asked.message_type):
            ended = "the robots' record is incomplete: more messages arrived than it says were sent"
        self._incidents += measure.restarts_of_robots(counted)
        is_complete = not ended and not self._incidents
        result = self._result(measured, is_complete, self._daemon)
        if ended:
            result["ended_early"] = ended
            told = "" if ended == self._trouble else f"{ended}. "
            self._progress.say(f"{self._experiment.name}: {told}What came so far is in {self._directory}")
        folder.write_result(self._directory, result)
        figures.draw(self._directory, result, counted)
        if self._asked.format == "mcap":
            mcap.write(os.path.join(self._directory, "events.mcap"), ones, self._axis.begin_wall_us)
        return 0 if is_complete else 1

    def _settle_s(self):
        return 0.0 if self._site.simulator_arguments is not None else self._asked.settle_s

    def _period_ms(self):
        return self._asked.period_ms / self._asked.compress

    # Reading

    def _read(self, recorder, sources):
        """Reads until the end. Returns None when the run is complete, else the reason."""
        next_status_s = 0.0
        while True:
            self._take(recorder)
            recorder.flush()
            passed_s = self._axis.now_us() / 1e6
            if self._stop():
                return "interrupted"
            if self._misplaced:
                return self._misplaced
            if passed_s >= next_status_s:
                next_status_s = passed_s + STATUS_INTERVAL_S
                self._check_broker(self._site.status() or {})
            trouble = self._site.trouble()
            if trouble and trouble != self._trouble:
                self._trouble = trouble
                self._note(trouble)
            if sources[events.GATEWAY].has_ended:
                self._take(recorder)
                return self._trouble or self._site.why_trace_ended()
            end = self._end(passed_s)
            if end is not False:
                self._take(recorder)
                return end
            self._progress.show(self._done(), self._expected(), self._seconds_left(passed_s), passed_s)

    def _take(self, recorder):
        """Records the lines read so far; waits a moment for the first line."""
        try:
            line = self._lines.get(timeout=0.05)
        except queue.Empty:
            self._look_at_clock()
            return
        while True:
            self._on_line(recorder, *line)
            try:
                line = self._lines.get_nowait()
            except queue.Empty:
                return

    def _on_line(self, recorder, source, text, read_us):
        self._look_at_clock()
        members = parse(source, text)
        if members is None:
            return
        if members.get("event") == "lost":
            self._note(f"the daemon left out {members.get('lost', 'some')} events, for this program did not read fast enough")
        event = events.from_members(source, members)
        wall_us = events.microseconds_since_1970(event.at) if event.at else None
        event.t_us = self._axis.place(wall_us, read_us) if wall_us is not None else read_us
        if event.robot and event.robot not in self._site.robots:
            return
        if event.mesh not in ("", self._mesh):
            self._on_other_mesh(event)
            return
        recorder.write(event)
        if event.is_arrival_of(self._asked.message_type):
            self._heard[event.robot] = self._heard.get(event.robot, 0) + 1
            self._first_us = self._first_us if self._first_us is not None else event.t_us
        self._sent += 1 if source == events.ROBOTS and event.event in ("sent", "refused") else 0

    def _on_other_mesh(self, event):
        """Notes robots that are on the other mesh. A robot on both meshes may be heard first on the other one."""
        if event.is_arrival_of(self._asked.message_type) and event.robot not in self._heard:
            self._elsewhere[event.robot] += 1
            if self._elsewhere[event.robot] <= MOST_ELSEWHERE:
                return
            names = figures.MESH_NAMES
            choice = f" unless --mesh says {event.mesh}" if event.mesh in self._experiment.meshes else ""
            self._misplaced = (f"{event.robot} is on {names.get(event.mesh, event.mesh)}; "
                               f"{self._experiment.name} measures {names[self._mesh]}{choice}")

    def _look_at_clock(self):
        step = self._axis.look()
        if step:
            self._note(f"the clock was set by {step[1] / 1e6:+.3f} s; times in events.csv leave it out")

    # Ends

    def _expected(self):
        return self._asked.messages * len(self._site.robots)

    def _done(self):
        """Returns the number of expected messages that arrived. Real robots go on while the run waits for the last repeats."""
        if self._site.simulator_arguments is not None:
            return self._sent
        return sum(min(count, self._asked.messages) for count in self._heard.values())

    def _seconds_left(self, passed_s):
        if self._first_us is None:
            return None
        if self._settles_until_s is not None:
            return max(0.0, self._settles_until_s - passed_s)
        whole_s = self._asked.messages * self._period_ms() / 1000
        return max(0.0, whole_s - (passed_s - self._first_us / 1e6))

    def _end(self, passed_s):
        """Returns False to go on, None at a complete end, else the reason of an incomplete one."""
        if self._first_us is None and passed_s > self._asked.wait_s:
            return self._nobody_came()
        if self._site.simulator_arguments is not None:
            return self._end_of_simulation(passed_s)
        missing = [robot for robot in self._site.robots if robot not in self._heard]
        if missing and self._first_us is not None and passed_s > self._asked.wait_s:
            note = f"{', '.join(missing)} did not appear in {self._asked.wait_s:g} s"
            if note not in [incident["what"] for incident in self._incidents]:
                self._note(note)
        if self._first_us is None:
            return False
        has_all = all(self._heard.get(robot, 0) >= self._asked.messages for robot in self._site.robots)
        whole_s = self._asked.messages * self._period_ms() / 1000
        is_over = passed_s - self._first_us / 1e6 > whole_s  # lost messages never come
        if (has_all or is_over) and self._settles_until_s is None:
            self._settles_until_s = passed_s + self._settle_s()
        return None if self._settles_until_s is not None and passed_s >= self._settles_until_s else False

    def _end_of_simulation(self, passed_s):
        if not self._site.have_robots_ended():
            return False
        if self._trouble:
            return self._trouble
        self._robots_ended_us = self._robots_ended_us or passed_s
        return None if passed_s - self._robots_ended_us > QUIET_END_S else False

    def _nobody_came(self):
        known = self._site.known_robots()
        return (f"nothing of type {self._asked.message_type} came from {', '.join(self._site.robots)} in "
                f"{self._asked.wait_s:g} s; the daemon knows {', '.join(known) if known else 'no robots'}")

    def _check_broker(self, status, at_start=False):
        broker = status.get("broker", {})
        is_up = not broker or broker.get("state") == "up"
        if is_up != self._is_broker_up and not is_up:
            self._note(f"the daemon has lost the broker: {broker.get('why') or 'no reason told'}; what it acknowledges meanwhile "
                       "is on its disk, so times until then say nothing about the broker")
        elif is_up != self._is_broker_up:
            self._note("the broker is back")
        self._is_broker_up = is_up
        if at_start and not is_up:
            raise SiteFailure(f"the daemon has no broker: {broker.get('why') or broker.get('uri', '')}")

    def _note(self, what):
        self._incidents.append({"t_us": self._axis.now_us(), "what": what})
        self._progress.say(f"{self._experiment.name}: {what}")

    # The result

    def _result(self, measured, is_complete, daemon):
        experiment, asked = self._experiment, self._asked
        return {
            "format": folder.FORMAT,
            "program": f"slam-gateway-experiment {self._asked.version}",
            "experiment": experiment.name,
            "title": experiment.title,
            "mesh": self._mesh,
            "complete": is_complete,
            "simulated": self._site.simulator_arguments is not None,
            "conditions": self._conditions(daemon),
            "incidents": self._incidents,
            "measured": measured,
            "thesis": {"where": experiment.where(), "result": experiment.thesis, "numbers": experiment.thesis_numbers,
                       "unknown": experiment.unknown, "chosen": experiment.chosen,
                       "messages": experiment.messages, "period_ms": experiment.period_ms},
            "differs": self._differences(asked),
        }

    def _differences(self, asked):
        """Returns the settings that differ from the defaults."""
        differences = []
        if asked.messages < self._experiment.messages:
            differences.append(f"{asked.messages} messages in place of {self._experiment.messages}")
        if self._site.simulator_arguments and len(self._site.robots) != self._experiment.robots:
            differences.append(f"{len(self._site.robots)} robots in place of {self._experiment.robots}")
        if asked.compress != 1:
            differences.append(f"time compressed {asked.compress:g} times: the period and the client's repeats; "
                               "the radio's own times are not")
        if asked.period_ms != self._experiment.period_ms:
            differences.append(f"a period of {asked.period_ms:g} ms in place of {self._experiment.period_ms:g}")
        if asked.sim_args:
            differences.append(f"the simulator with {asked.sim_args}")
        return differences

    def _conditions(self, daemon):
        asked = self._asked
        now = datetime.datetime.now(datetime.timezone.utc)
        simulator = self._site.simulator_arguments
        return {
            "begun": self._begun.isoformat(timespec="microseconds"),
            "written": now.isoformat(timespec="microseconds"),
            "robots": self._site.robots,
            "messages": asked.messages,
            "period_ms": self._period_ms(),
            "time_compressed": asked.compress,
            "settle_s": self._settle_s(),
            "end_us": self._end_us,
            "type": asked.message_type,
            "seed": asked.seed if simulator is not None else None,
            "simulator": simulator,
            "simulated_as": self._experiment.simulated if simulator is not None else None,
            "daemon": {key: daemon.get(key) for key in ("version", "gateway", "uptime_s")},
            "versions": {
                "slam-gatewayd": daemon.get("version"),
                "slam-gateway-sim": self._programs.version("slam-gateway-sim") if simulator is not None else None,
                "mosquitto": self._programs.version("mosquitto", "-h") if simulator is not None else None,
                "python": platform.python_version(), "numpy": numpy.__version__, "matplotlib": matplotlib.__version__,
                "system": f"{platform.system()} {platform.release()} {platform.machine()}",
            },
            "clock": {"source": "this host's wall clock, steps taken out by its monotonic clock",
                      "resolution_us": max(1, round(time.get_clock_info("time").resolution * 1e6)),
                      "steps": self._axis.steps},
        }


def parse(source, text):
    """Returns the members of a line, or None for an invalid one."""
    if source == events.BROKER:
        return parse_broker_line(text)
    try:
        members = json.loads(text)
    except ValueError:
        return None
    return members if isinstance(members, dict) else None


def parse_broker_line(text):
    """`<seconds since 1970>`, `<payload in hex>` and `<topic>` of mosquitto_sub, with tabs between them; a topic may have any character."""
    try:
        seconds, payload, topic = text.removesuffix("\n").split("\t", 2)
        at = datetime.datetime.fromtimestamp(float(seconds), datetime.timezone.utc)
    except (ValueError, OverflowError, OSError):
        return None
    levels = topic.split("/")
    return {"at": at.isoformat(timespec="microseconds"), "event": "received", "direction": "up", "topic": topic,
            "robot": levels[-2] if len(levels) > 1 else "", "type": levels[-1], "payload": payload}
