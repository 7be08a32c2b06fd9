#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""The steps of ./dev system-test --first-hour: an operator in the virtual machine types the commands of docs/first-hour.md,
taken from the page that is in the package, in their order."""
import re
import subprocess
import sys

from first_hour import OPERATOR, commands, make_operator, operator, page, type_in
from hardware import INTERFACE, RecordedRobots, Radios, UsbBoard
from machine import Failure, demand, run, wait_for
from stepping import run_steps

LONGEST_S = 1000  # for a command that keeps running

world = {}


def in_a_sentence(before, after=""):
    """Returns the command between these words of the page."""
    found = re.search(re.escape(before) + "`([^`]+)`" + re.escape(after), page())
    demand(found, f"the page has no command between '{before}' and '{after}'")
    return found[1]


class Terminal:
    """A second terminal, in which a command keeps running."""

    def __init__(self, line):
        self.process = subprocess.Popen(operator(f"exec timeout --foreground -s INT {LONGEST_S} stdbuf -oL {line}"),
                                        text=True, errors="replace", bufsize=1, stdin=subprocess.DEVNULL,
                                        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True)

    def wait_for(self, pattern):
        for text in self.process.stdout:
            if re.search(pattern, text):
                return
        raise Failure(f"the command ended without printing '{pattern}'")

    def end(self):
        run("pkill", "-INT", "-s", self.process.pid, status=None)
        self.process.communicate()


def installs_the_package():
    """2 The package: installed from the operator's home, the operator in the group, status shows that broker and Thread are up"""
    make_operator()
    run("sh", "-c", f"cp /job/input/debs/*.deb /job/input/debs/more/*.deb /home/{OPERATOR}/")
    run("systemctl", "start", "mosquitto")  # the page installs it first
    for line in commands("## 2 The package"):
        type_in(line)


def shows_simulated_robots():
    """3 Watch: what robots send runs through the second terminal; the page in a browser"""
    watching = Terminal(commands("## 3 Watch")[0])
    at_broker = Terminal(in_a_sentence("at the broker: "))
    robots = Terminal(commands("### Without robots")[0])
    for name in ("robot1", "robot2"):
        watching.wait_for(rf"{name} +update +x=-?\d+ y=-?\d+")
        at_broker.wait_for(f"ntnu-slam/robot/{name}/update")
    for terminal in (robots, at_broker, watching):
        terminal.end()
    wait_for("the page", lambda: "<html" in run("python3", "-c", "import urllib.request as r;"
                                                "print(r.urlopen('http://127.0.0.1:8321/').read().decode())"))


def lines_about(step, findings):
    return [line for line in findings.splitlines() if line[9:].startswith(step)]


def serves_thread():
    """4 Thread: on its interface only; doctor's lines about it begin with ok; a robot connects there"""
    world["radios"] = Radios(["n1"])
    typed = {line.split("  ")[0]: type_in(line) for line in commands("## 4 Thread")}
    findings = typed["sleep 5; sudo slam-gatewayctl doctor"]
    about = lines_about("thread", findings)
    demand(len(about) > 2 and all(line.startswith("ok") for line in about), findings)
    demand(INTERFACE in findings, "doctor does not name the interface")
    world["robot"] = RecordedRobots(f"[{world['radios'].address()}]:47193", "--robots", "1", node="n1")
    world["robot"].wait_for_each(3)


def provisions_a_robot_with_a_board():
    """5 BLE Mesh: the board is plugged in, doctor's line begins with ok, a new robot joins and is listed"""
    world["board"] = UsbBoard(1, "--unprovisioned")
    world["board"].plug_in()
    lines = commands("## 5 BLE Mesh")
    for line in lines[:-1]:
        type_in(line)
    wait_for("a healthy board",
             lambda: [line for line in lines_about("ble: board", type_in(lines[-1])) if line.startswith("ok")])
    listing = in_a_sentence("it joins within seconds. ", " lists it")
    wait_for("a robot that has joined", lambda: re.search(r"^ble-[0-9a-f]{4} .*configured", type_in(listing), re.MULTILINE))


def commands_a_robot():
    """6 Command a robot: list, send, watch"""
    listing, sending, watching = commands("## 6 Command a robot")
    wait_for("the robot again", lambda: re.search(r"^robot1 .* online", type_in(listing), re.MULTILINE))
    promised = re.escape(sending.partition(" # ")[2].strip()).replace(r"\.\.\.", r"\d+")
    output = type_in(sending)
    demand(re.search(promised, output), f"{output}, not {promised}")
    watcher = Terminal(watching)
    watcher.wait_for("robot1")
    watcher.end()
    type_in(in_a_sentence("make a backup: "))


STEPS = [
    installs_the_package,
    shows_simulated_robots,
    serves_thread,
    provisions_a_robot_with_a_board,
    commands_a_robot,
]

if __name__ == "__main__":
    sys.exit(run_steps(STEPS, sys.argv[1:]))
