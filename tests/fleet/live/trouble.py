# SPDX-License-Identifier: Apache-2.0
"""The random faults of a run, one at a time. Gateways and nodes are killed or stopped, links to the broker are cut, and boards are
unplugged. Faults of explicit options come first. Used by run."""
import signal
import time
from collections import Counter

from bounds import Absence

PAUSE_S = 65  # longer than a keep-alive: the broker has published the gateway's will, and others serve its robots


class Trouble:
    def __init__(self, fleet):
        self.fleet, self.random, self.options = fleet, fleet.random, fleet.options
        self.acts = Counter()
        self.reported = []  # the faults, for the log
        self.away = None  # (which gateway or None, how to bring it back, when)
        self.next_act = 0.0
        self.absences = []
        self.chosen = [act for act, is_wanted in ((self.pause_gateway, self.options.pause_minute),
                                                  (self.restart_broker, self.options.restart_broker)) if is_wanted]
        self.kinds = [] if self.options.calm else self.kinds_of(fleet)

    def kinds_of(self, fleet):
        if self.options.stops:
            return [(self.stop_gateway, 1)]
        kinds = [(self.take_gateway, 6)]
        if fleet.ble:
            kinds.append((self.unplug_board, 2))
        if self.options.kill_nodes:
            kinds.append((self.take_node, 8))
        if self.options.netns:
            kinds.append((self.cut_link, 6))
        if self.options.restart_broker:
            kinds.append((self.restart_broker, 2))
        return kinds

    def step(self, now):
        if self.away and now >= self.away[2]:
            self.bring_back()
        elif (self.chosen or self.kinds) and not self.away and now >= self.next_act and self.fleet.are_nodes_well():
            act = self.chosen.pop(0) if self.chosen else self.random.choices(*zip(*self.kinds))[0]
            act(now)

    def note(self, now, what):
        self.reported.append((now, what, b""))

    def gateway_is_away(self, gateway):
        return self.away is not None and self.away[0] == gateway

    def unplug_board(self, now):
        self.note(now, "unplug a board")
        self.fleet.ble.unplug()
        self.acts["unplugged"] += 1
        self.next_act = now + self.random.uniform(3, 8)

    def take_gateway(self, now):
        victim = self.random.randrange(self.options.gateways)
        self.take_program(self.fleet.daemons[victim], "gateway", victim, now)

    def stop_gateway(self, now):
        victim = self.random.randrange(self.options.gateways)
        self.stop(self.fleet.daemons[victim], "gateway", victim, now, self.random.uniform(4, 10))
        self.acts["stops"] += 1

    def take_node(self, now):
        victim = self.random.randrange(len(self.fleet.engine.nodes))
        self.take_program(self.fleet.engine.nodes[victim], "node", victim, now)

    def take_program(self, program, kind, number, now):
        prefix = "" if kind == "gateway" else "node_"
        if self.random.random() < 0.5:
            self.kill(program, kind, number, now)
            self.acts[f"{prefix}kills"] += 1
        else:
            self.stop(program, kind, number, now, self.random.uniform(1, 12))
            self.acts[f"{prefix}stops"] += 1

    def kill(self, program, kind, number, now):
        self.note(now, f"kill {program.name}")
        self.absences.append(Absence(f"{kind} killed", number, now))
        program.end(signal.SIGKILL)
        self.away = (number if kind == "gateway" else None, program.start, now + self.random.uniform(0.5, 8))

    def stop(self, program, kind, number, now, seconds):
        self.note(now, f"stop {program.name}")
        self.absences.append(Absence(f"{kind} stopped", number, now))
        program.send(signal.SIGSTOP)
        self.away = (number if kind == "gateway" else None, lambda: program.send(signal.SIGCONT), now + seconds)

    def pause_gateway(self, now):
        """Stops a gateway for PAUSE_S. No other fault happens during that time."""
        victim = self.random.randrange(self.options.gateways)
        self.stop(self.fleet.daemons[victim], "gateway", victim, now, PAUSE_S)
        self.acts["pauses"] += 1

    def restart_broker(self, now):
        """Kills the broker. It has no persistence file, so sessions and retained messages are lost."""
        self.kill(self.fleet.engine.nodes[0], "node", 0, now)
        self.acts["broker_restarts"] += 1

    def cut_link(self, now):
        victim = self.random.randrange(self.options.gateways)
        self.note(now, f"cut gw{victim} from the broker")
        self.fleet.network.cut(victim)
        self.absences.append(Absence("link cut", victim, now))
        # Robots still reach it, so they continue there.
        self.away = (None, lambda: self.fleet.network.join(victim), now + self.random.uniform(1, 12))
        self.acts["cuts"] += 1

    def bring_back(self):
        now = time.monotonic()
        self.note(now, "bring back")
        self.away[1]()
        self.absences[-1].end = now
        self.away, self.next_act = None, now + self.random.uniform(2, 6)

    def end(self):
        if self.away:
            self.bring_back()
