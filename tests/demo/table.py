#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""table.py BROKER CTL SOCKET FOOT: the messages of robots, as a table that is redrawn each second, until Ctrl-C.

BROKER is the file that mosquitto_sub -F '%I %t %x' writes; FOOT is a file whose text stays below the table.
"""
import json
import signal
import struct
import subprocess
import sys
import time

broker, ctl, socket, foot = sys.argv[1:]
HOME, CLEAR_LINE, CLEAR_BELOW = "\033[H", "\033[K", "\033[J"


class Robots:
    """The last message of each robot, read from the end of the file on."""

    def __init__(self, path):
        self.file = open(path, encoding="utf-8", errors="replace")
        self.said = {}

    def read(self):
        for line in self.file:
            words = line.split()
            levels = words[1].split("/") if len(words) > 2 else []
            if len(levels) < 4:
                continue
            row = self.said.setdefault(levels[2], {"count": 0, "at": "", "x": None, "y": None})
            row["count"] += 1
            row["at"] = words[0][11:19]
            if levels[3] == "update" and len(words[2]) >= 8:
                row["x"], row["y"] = struct.unpack("<hh", bytes.fromhex(words[2][:8]))
        return self.said


def states():
    """Returns the gateway's list of robots by id; empty while it does not answer."""
    try:
        answer = subprocess.run([ctl, "--socket", socket, "--json", "robots"], capture_output=True, timeout=5, check=True)
        return {row["id"]: row for row in json.loads(answer.stdout)}
    except (subprocess.SubprocessError, ValueError, KeyError):
        return {}


def lines(said, known):
    yield f"{'ROBOT':10}{'MESH':8}{'STATE':10}{'X cm':>7}{'Y cm':>7}{'MESSAGES':>10}  LAST"
    for robot in sorted(set(said) | set(known)):
        row, state = said.get(robot, {}), known.get(robot, {})
        place = [str(row[axis]) if row.get(axis) is not None else "-" for axis in "xy"]
        yield (f"{robot:10}{state.get('mesh', '-'):8}{state.get('state', '-'):10}{place[0]:>7}{place[1]:>7}"
               f"{row.get('count', 0):>10}  {row.get('at', '-')}")
    yield ""
    yield from open(foot, encoding="utf-8").read().splitlines()


signal.signal(signal.SIGINT, signal.SIG_DFL)
robots = Robots(broker)
print("\033[2J", end="")
while True:
    drawn = "".join(line + CLEAR_LINE + "\n" for line in lines(robots.read(), states()))
    print(HOME + drawn + CLEAR_BELOW, end="", flush=True)
    time.sleep(1)
