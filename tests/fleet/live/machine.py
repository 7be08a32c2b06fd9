# SPDX-License-Identifier: Apache-2.0
"""Measures whether the machine was too slow. One measure is how long threads of gateways and brokers waited for a processor. The
other is how long a round of this process took. The fleet is not to blame for such delays. Used by run."""
import contextlib
import pathlib

LATE_S = 0.3  # of each second


class Machine:
    def __init__(self, programs):
        self.programs = programs
        self.waited = {}  # by thread: seconds, since it began
        self.next_look, self.last_step = 0.0, None
        self.round_s = 0.0  # the longest round of this process since the last look
        self.seconds, self.late_seconds, self.worst_s, self.worst = 0, 0, 0.0, ""

    def step(self, now):
        if self.last_step is not None:
            self.round_s = max(self.round_s, now - self.last_step)
        self.last_step = now
        if now < self.next_look:
            return
        self.next_look = now + 1
        lateness, who = max([*self.look(), (self.round_s, "the harness")])
        self.round_s = 0.0
        self.seconds += 1
        self.late_seconds += lateness > LATE_S
        if lateness > self.worst_s:
            self.worst_s, self.worst = lateness, who

    def look(self):
        """Yields for each thread how long it has waited for a processor since the last look."""
        for program in self.programs:
            if not program.is_running():
                continue
            for thread in pathlib.Path(f"/proc/{program.process.pid}/task").glob("*"):
                with contextlib.suppress(OSError):
                    waited = int((thread / "schedstat").read_text().split()[1]) / 1e9
                    yield waited - self.waited.get(thread.name, waited), program.name
                    self.waited[thread.name] = waited

    def verdict(self):
        return {"machine_late_seconds": self.late_seconds, "machine_seconds": self.seconds,
                "machine_late_max_s": round(self.worst_s, 3), "machine_late_who": self.worst}
