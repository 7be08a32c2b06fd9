#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""The steps of ./dev system-test --vm bluez: the confined service, a bluetooth-meshd as docs/bluez.md sets it up, and robots
with meshds of their own on virtual controllers that hear each other."""
import contextlib
import glob
import json
import pathlib
import subprocess
import sys

from actors import PASSWORDS, Listener, set_up_broker
from machine import (CONFIG, STATE, demand, install, now, restart, run, says, status, wait_for, wait_for_status, write_config,
                     write_credentials)
from stepping import run_steps

ROBOTS = 10
PERIOD_MS = 4000
GATEWAYS_CONTROLLER = "hci0"
DROP_IN = pathlib.Path("/etc/systemd/system/bluetooth-mesh.service.d/override.conf")
MODULES = ["hci_vhci", "algif_skcipher", "algif_hash", "ecb", "cmac", "ccm"]
FACTS = pathlib.Path("/run/robots.json")

world = {}


def doctor():
    """What it says of BLE: health, detail and remedy by step."""
    rows = json.loads(run("slam-gatewayctl", "--json", "doctor", status=None))
    return {row["step"]: row for row in rows if row["step"].startswith("ble")}


def controllers():
    return [path.name for path in pathlib.Path("/sys/class/bluetooth").glob("hci*")]


def install_service():
    """What all steps need: controllers, the package, a broker."""
    if "btvirt" in world:
        return
    run("modprobe", "-a", *MODULES)
    world["btvirt"] = subprocess.Popen(["btvirt", "-L", f"-l{ROBOTS + 1}"], stdout=subprocess.DEVNULL)
    wait_for("the controllers", lambda: len(controllers()) == ROBOTS + 1)
    run("systemctl", "start", "mosquitto")
    install(*glob.glob("/job/input/debs/*.deb"))
    set_up_broker()
    write_credentials(PASSWORDS["slam-gateway"])
    write_config(ble_mesh={"enabled": True, "radio": "bluez", "controller": GATEWAYS_CONTROLLER}, robots=[])
    restart()


def meshd():
    """bluetooth-meshd as docs/bluez.md sets it up; the link is up."""
    install_service()
    if not DROP_IN.exists():
        run("systemctl", "mask", "--now", "bluetooth")
        wait_for("controllers that nobody holds", lambda: "UP RUNNING" not in run("hciconfig"))
        DROP_IN.parent.mkdir()
        DROP_IN.write_text("[Service]\nExecStart=\nExecStart=/usr/libexec/bluetooth/bluetooth-meshd --nodetach --io "
                           f"generic:{GATEWAYS_CONTROLLER}\n", encoding="ascii")
        run("systemctl", "daemon-reload")
        run("systemctl", "enable", "--now", "bluetooth-mesh")
    wait_for_status("ble up")


def facts():
    return json.loads(FACTS.read_text(encoding="utf-8")) if FACTS.exists() else []


def nodes():
    return json.loads(run("slam-gatewayctl", "--json", "ble", "nodes"))


def robots():
    """In the mesh, configured, and acknowledged."""
    meshd()
    if "robots" not in world:
        script = pathlib.Path(__file__).with_name("bluez_robots.py")
        world["robots"] = subprocess.Popen(["python3", script, "1", str(ROBOTS), str(PERIOD_MS), FACTS])
    wait_for("robots in the mesh", lambda: [node["state"] for node in nodes()] == ["configured"] * ROBOTS)
    wait_for("acknowledged updates", lambda: all(robot["acknowledged"] > 1 for robot in facts()))


def robots_are_heard():
    before = [robot["acknowledged"] for robot in facts()]
    listener = Listener()
    listener.wait_for({f"ntnu-slam/robot/{node['robot']}/update": 2 for node in nodes()})
    listener.end()
    wait_for("acknowledged updates",
             lambda: all(robot["acknowledged"] > earlier for robot, earlier in zip(facts(), before)))


def life():
    return json.loads((STATE / "mesh.json").read_text(encoding="utf-8"))["life"]


def says_what_meshd_lacks():
    """doctor names what keeps bluetooth-meshd from its controller, one after the other, until the link is up"""
    install_service()
    wait_for("bluetooth.service, which udev starts", lambda: run("systemctl", "is-active", "bluetooth", status=None) == "active")
    demand("bluetooth.service holds" in doctor()["ble: controller"]["detail"], f"doctor says {doctor()}")
    run("systemctl", "mask", "--now", "bluetooth")
    demand("does not start meshd with" in doctor()["ble: controller"]["detail"], f"doctor says {doctor()}")
    meshd()
    demand(all(row["health"] == "ok" for row in doctor().values()), f"doctor says {doctor()}")


def takes_in_ten_robots():
    """ten robots join by themselves, are configured, and their updates reach the broker and are acknowledged"""
    robots()
    robots_are_heard()
    sent, acknowledged = (sum(robot[what] for robot in facts()) for what in ("sent", "acknowledged"))
    return f"{acknowledged} of {sent} updates acknowledged"


def commands_reach_each_robot():
    """a command to each robot is delivered, and the robot has it once"""
    robots()
    for number, node in enumerate(nodes()):
        answer = json.loads(run("slam-gatewayctl", "--json", "send", node["robot"], "cmd", f"{number},7"))
        demand(answer["outcome"] == "delivered", f"{node['robot']}: {answer}")
    wanted = sorted([f"{number:02x}000700"] for number in range(ROBOTS))
    wait_for("commands at the robots", lambda: sorted(robot["obeyed"] for robot in facts()) == wanted)


def goes_on_after_restarts():
    """meshd killed, the daemon killed, both killed: same node, same address, and robots hear the gateway each time"""
    robots()
    before = life()
    for victims in (["bluetooth-mesh"], ["slam-gateway"], ["bluetooth-mesh", "slam-gateway"]):
        since = now()
        for victim in victims:
            run("systemctl", "kill", "-s", "KILL", victim)
        wait_for("the link", lambda: says("ble link up", *since))
        robots_are_heard()
        node = nodes()[0]["robot"]
        answer = json.loads(run("slam-gatewayctl", "--json", "send", node, "cmd", "1,1"))
        demand(answer["outcome"] == "delivered", f"after {victims}: {answer}")
        demand((life()["number"], life()["source"]) == (before["number"], before["source"]), f"another life: {life()}")
    demand(status()["meshes"]["ble"]["counters"]["robots_deaf"] == 0, "robots do not hear the gateway")


STEPS = [
    says_what_meshd_lacks,
    takes_in_ten_robots,
    commands_reach_each_robot,
    goes_on_after_restarts,
]

if __name__ == "__main__":
    with contextlib.ExitStack() as at_end:
        at_end.callback(lambda: [process.kill() for process in world.values()])
        sys.exit(run_steps(STEPS, sys.argv[1:]))
