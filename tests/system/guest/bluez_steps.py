#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""The steps of ./dev system-test --vm bluez: the confined service, a bluetooth-meshd as docs/first-hour.md sets it up, and robots
with meshds of their own on virtual controllers that hear each other."""
import contextlib
import glob
import json
import pathlib
import shutil
import struct
import subprocess
import sys
import time

from actors import PASSWORDS, Listener, Robots, demand_nothing_lost, set_up_broker
from first_hour import commands, make_operator, type_in
from machine import (BOARD, CONFIG, STATE, demand, install, logged, now, restart, run, status, wait_for,
                     wait_for_status, write_config, write_credentials)
from stepping import PowerCut, run_steps

ROBOTS = 10
PERIOD_MS = 2000
GATEWAYS_CONTROLLER = "hci0"
MODULES = ["hci_vhci", "algif_skcipher", "algif_hash", "ecb", "cmac", "ccm"]
CONTROLLERS = f"""[Unit]
Before=bluetooth-mesh.service
[Service]
ExecStartPre=/usr/sbin/modprobe -a {" ".join(MODULES)}
ExecStart=/usr/bin/btvirt -L -l{ROBOTS + 1}
[Install]
WantedBy=multi-user.target
"""
FACTS = pathlib.Path("/job/robots/facts.json")  # on the host: a power cut does not affect the state and keys of robots
BEFORE = pathlib.Path("/job/before.json")  # the state before a power cut
LATE = pathlib.Path("/job/late.json")  # the state before the other power cut
WRITTEN_AFTER_S = 45  # the kernel has written a file by then at the latest
NOTEBOOK = pathlib.Path("/job/notebook")
PLAY = FACTS.with_suffix(".play")
SETS = 500
ALIKE = 3  # robots that send the same on each mesh
UPDATES = 20  # of each

world = {}


def doctor():
    """Returns its findings about BLE: health, detail and remedy by step."""
    rows = json.loads(run("slam-gatewayctl", "--json", "doctor", status=None))
    return {row["step"]: row for row in rows if row["step"].startswith("ble")}


def controllers():
    return [path.name for path in pathlib.Path("/sys/class/bluetooth").glob("hci*")]


def install_service():
    """Installs the needs of all steps: controllers, the package, a broker."""
    unit = pathlib.Path("/etc/systemd/system/controllers.service")
    if unit.exists():
        return
    unit.write_text(CONTROLLERS, encoding="ascii")
    run("systemctl", "enable", "--now", "controllers")
    wait_for("the controllers", lambda: len(controllers()) == ROBOTS + 1)
    run("systemctl", "enable", "--now", "mosquitto")
    install(*glob.glob("/job/input/debs/*.deb"))
    set_up_broker()
    write_credentials(PASSWORDS["slam-gateway"])
    make_operator()
    write_config(ble_mesh={"enabled": True, "radio": "bluez", "controller": GATEWAYS_CONTROLLER}, robots=[])
    restart()


def meshd():
    """Types the commands of docs/first-hour.md for a Pi without a board; waits for the link."""
    install_service()
    if run("systemctl", "is-enabled", "bluetooth-mesh", status=None) != "enabled":
        for line in commands("### Without a board"):
            type_in(line)
    wait_for_status("ble up")


def facts():
    return json.loads(FACTS.read_text(encoding="utf-8")) if FACTS.exists() else []


def nodes():
    return json.loads(run("slam-gatewayctl", "--json", "ble", "nodes"))


def switch_robots_on():
    if "robots" not in world:
        FACTS.parent.mkdir(exist_ok=True)
        script = pathlib.Path(__file__).with_name("bluez_robots.py")
        world["robots"] = subprocess.Popen(["python3", script, "1", str(ROBOTS), str(PERIOD_MS), FACTS])


def robots():
    """Waits until all robots are in the mesh, configured, and acknowledged."""
    meshd()
    switch_robots_on()
    wait_for("robots in the mesh", lambda: [node["state"] for node in nodes()] == ["configured"] * ROBOTS)
    wait_for("acknowledged updates", lambda: all(robot["acknowledged"] > 1 for robot in facts()))


def acknowledgements():
    return sum(robot["acknowledged"] for robot in facts())


def robots_are_heard():
    before = [robot["acknowledged"] for robot in facts()]
    listener = Listener()
    listener.wait_for({f"ntnu-slam/robot/{node['robot']}/update": 2 for node in nodes()})
    listener.end()
    wait_for("acknowledged updates",
             lambda: all(robot["acknowledged"] > earlier for robot, earlier in zip(facts(), before)))


def life():
    return json.loads((STATE / "mesh.json").read_text(encoding="utf-8"))["life"]


def doctor_names_what_meshd_lacks():
    """doctor names what keeps bluetooth-meshd from its controller, one after the other, until the link is up"""
    install_service()
    wait_for("bluetooth.service, which udev starts", lambda: run("systemctl", "is-active", "bluetooth", status=None) == "active")
    demand("bluetooth.service holds" in doctor()["ble: controller"]["detail"], f"doctor reports {doctor()}")
    run("systemctl", "mask", "--now", "bluetooth")
    demand("does not start meshd with" in doctor()["ble: controller"]["detail"], f"doctor reports {doctor()}")
    meshd()
    demand(all(row["health"] == "ok" for row in doctor().values()), f"doctor reports {doctor()}")


def provisions_ten_robots():
    """ten robots join by themselves, are configured, and their updates reach the broker and are acknowledged"""
    robots()
    robots_are_heard()


def robot_names():
    return {node["uuid"]: node["robot"] for node in nodes()}


def acknowledged_since(before):
    """Returns the updates acknowledged since these facts, in the format of Listener.lines()."""
    names = robot_names()
    return {f"ntnu-slam/robot/{names[late['uuid']]}/update {struct.pack('<hh', number, 0).hex()}"
            for early, late in zip(before, facts())
            for number in range(early["acknowledged"] + 2, late["acknowledged"] + 1)}  # the first may have been in flight


def acknowledges_500_updates():
    """500 updates: each is acknowledged in the end, and each acknowledged one is at the broker"""
    robots()
    listener = Listener()
    before = facts()
    wait_for(f"{SETS} acknowledgements", lambda: acknowledgements() - sum(robot["acknowledged"] for robot in before) >= SETS)
    wanted = acknowledged_since(before)
    wait_for("all of them at the broker", lambda: wanted <= set(listener.lines()))
    listener.end()
    return f"{len(wanted)} of {len(wanted)} at the broker"


def commands_reach_each_robot():
    """a command to each robot is delivered, and the robot receives it once"""
    robots()
    for number, node in enumerate(nodes()):
        answer = json.loads(run("slam-gatewayctl", "--json", "send", node["robot"], "cmd", f"{number},7"))
        demand(answer["outcome"] == "delivered", f"{node['robot']}: {answer}")
    wanted = sorted([f"{number:02x}000700"] for number in range(ROBOTS))
    wait_for("commands at the robots", lambda: sorted(robot["obeyed"] for robot in facts()) == wanted)


def keeps_its_node_after_restarts():
    """meshd killed, the daemon killed, both killed: same node, same address, and robots hear the gateway each time"""
    robots()
    before = life()
    for victims in (["bluetooth-mesh"], ["slam-gateway"], ["bluetooth-mesh", "slam-gateway"]):
        since = now()
        for victim in victims:
            run("systemctl", "kill", "-s", "KILL", victim)
        wait_for("the link", lambda: logged("ble link up", *since))
        robots_are_heard()
        node = nodes()[0]["robot"]
        answer = json.loads(run("slam-gatewayctl", "--json", "send", node, "cmd", "1,1"))
        demand(answer["outcome"] == "delivered", f"after {victims}: {answer}")
        demand((life()["number"], life()["source"]) == (before["number"], before["source"]), f"another life: {life()}")
    demand(status()["meshes"]["ble"]["counters"]["robots_deaf"] == 0, "robots do not hear the gateway")


def each_obeys_once(word, before):
    """Sends a command to each robot, and checks that it is the only one since these facts."""
    wanted = [robot["obeyed"] + [f"{number:02x}00{word:02x}00"] for number, robot in enumerate(before)]
    names = robot_names()
    for number, robot in enumerate(facts()):
        answer = json.loads(run("slam-gatewayctl", "--json", "send", names[robot["uuid"]], "cmd", f"{number},{word}"))
        demand(answer["outcome"] == "delivered", f"{names[robot['uuid']]}: {answer}")
    robots_are_heard()
    demand([robot["obeyed"] for robot in facts()] == wanted, f"robots obeyed {facts()} instead of {wanted}")


def meshds_file():
    """Returns the stat of its node's file, which it replaces at each write."""
    return next(pathlib.Path("/var/lib/bluetooth/mesh").glob("*/node.json")).stat()


def survives_a_power_cut():
    """the power is cut while robots send and the broker is away: all recovers by itself, and no acknowledged update is lost"""
    if not BEFORE.exists():
        robots()
        each_obeys_once(8, facts())
        Listener(notebook=NOTEBOOK)
        before = {"facts": facts(), "life": life()}
        robots_are_heard()
        run("systemctl", "stop", "mosquitto")
        early = facts()
        wait_for("updates that only the disk has",
                 lambda: all(late["acknowledged"] > robot["acknowledged"] + 2 for late, robot in zip(facts(), early)))
        # docs/bluez.md, "Backups": if meshd's last write is lost, the gateway gets another node.
        wait_for("meshd's sequence number on the disk", lambda: time.time() - meshds_file().st_mtime > WRITTEN_AFTER_S)
        BEFORE.write_text(json.dumps(before), encoding="utf-8")
        raise PowerCut
    before = json.loads(BEFORE.read_text(encoding="utf-8"))
    wait_for_status("broker up, ble up")
    listener = Listener(notebook=NOTEBOOK)
    stored = acknowledged_since(before["facts"])
    wait_for("updates acknowledged before the cut", lambda: stored <= set(listener.lines()))
    switch_robots_on()
    robots_are_heard()
    wanted = acknowledged_since(before["facts"])
    wait_for("updates acknowledged after it", lambda: wanted <= set(listener.lines()))
    listener.end()
    each_obeys_once(9, before["facts"])
    after = life()
    demand((after["number"], after["source"]) == (before["life"]["number"], before["life"]["source"]), f"another life: {after}")
    demand([robot["joined"] for robot in facts()] == [1] * ROBOTS, f"robots have joined again: {facts()}")
    return f"{len(stored)} updates before the cut, {len(wanted) - len(stored)} after it"


def survives_a_power_cut_that_loses_meshds_number():
    """the power is cut while only the kernel has meshd's last sequence number: robots hear the gateway again"""
    if not LATE.exists():
        robots()
        run("systemctl", "restart", "bluetooth-mesh")
        robots_are_heard()
        stored = meshds_file().st_ino
        wait_for("meshd to store its sequence number", lambda: meshds_file().st_ino != stored)
        early = acknowledgements()
        wait_for("updates with higher ones", lambda: acknowledgements() > early + 100)
        LATE.write_text(json.dumps(facts()), encoding="utf-8")
        raise PowerCut
    before = json.loads(LATE.read_text(encoding="utf-8"))
    wait_for_status("broker up, ble up")
    switch_robots_on()
    robots_are_heard()
    each_obeys_once(10, before)
    demand([robot["joined"] for robot in facts()] == [1] * ROBOTS, f"robots have joined again: {facts()}")
    return f"node {life()['number']} of the gateway"


def updates_of(names, listener):
    """Waits for all updates of these robots; returns them sorted: number of the robot, payload."""
    def lines():
        found = [line.split() for line in listener.lines()]
        return sorted((names.index(topic.split("/")[-2]), payload) for topic, payload in found
                      if topic.split("/")[-2] in names and topic.endswith("/update"))
    wait_for(f"updates of {names}", lambda: len(lines()) >= ALIKE * UPDATES)
    listener.end()
    return lines()


def names_of(mesh):
    return [f"{mesh}{number}" for number in range(1, ALIKE + 1)]


def hear_simulated(mesh, listener, *options):
    alike = ["--robots", ALIKE, "--messages", UPDATES, "--seed", 7, "--id-prefix", mesh, "--max-obstacles", 2]
    demand_nothing_lost(Robots("ble" if mesh == "board" else "thread", *alike, *options).result())
    return updates_of(names_of(mesh), listener)


def with_radio(radio, robots_of_it):
    (CONFIG.parent / "gateway.d/ble.json").unlink(missing_ok=True)  # typed by an earlier step
    write_config(ble_mesh={"enabled": True, "radio": radio, "controller": GATEWAYS_CONTROLLER, "device": BOARD},
                 robots=robots_of_it)
    restart()


def robots_send_the_same_on_three_radios():
    """the same robots send the same updates on Thread, over a board, and over BlueZ"""
    robots()
    PLAY.write_text("{}", encoding="ascii")  # robots stop sending
    members = sorted(nodes(), key=lambda node: node["uuid"])[:ALIKE]
    thread = hear_simulated("thread", Listener())
    demand(len(set(thread)) > ALIKE * UPDATES / 2, "the robots stand still")

    run("systemctl", "stop", "slam-gateway")
    shutil.move(STATE / "mesh.json", "/root/mesh.json")  # the board's robots are in another mesh
    with_radio("nordic", [{"id": name, "ble_address": 0x100 + n} for n, name in enumerate(names_of("board"))])
    board = hear_simulated("board", Listener(), "--acknowledged")
    run("systemctl", "stop", "slam-gateway")
    shutil.move("/root/mesh.json", STATE / "mesh.json")

    with_radio("bluez", [{"id": name, "ble_address": node["address"]} for name, node in zip(names_of("bluez"), members)])
    wait_for_status("ble up")
    listener = Listener()
    by_robot = {node["uuid"]: [payload for number, payload in thread if number == n] for n, node in enumerate(members)}
    PLAY.write_text(json.dumps(by_robot), encoding="ascii")
    bluez = updates_of(names_of("bluez"), listener)
    demand(thread == board, f"Thread and board differ: {set(thread) ^ set(board)}")
    demand(thread == bluez, f"Thread and BlueZ differ: {set(thread) ^ set(bluez)}")
    return f"{len(bluez)} updates of {ALIKE} robots"


STEPS = [
    doctor_names_what_meshd_lacks,
    provisions_ten_robots,
    acknowledges_500_updates,
    commands_reach_each_robot,
    keeps_its_node_after_restarts,
    survives_a_power_cut,
    survives_a_power_cut_that_loses_meshds_number,
    robots_send_the_same_on_three_radios,
]

if __name__ == "__main__":
    with contextlib.ExitStack() as at_end:
        at_end.callback(lambda: "robots" in world and world["robots"].kill())
        sys.exit(run_steps(STEPS, sys.argv[1:]))
