#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""The steps of ./dev system-test --vm, in the virtual machine and in their order; each describes itself in one line."""
import contextlib
import glob
import json
import pathlib
import sys
import time

import machine
from actors import PASSWORDS, Listener, set_up_broker
from hardware import PORT, SERIAL_NUMBER, RecordedRobots, Radios, UsbBoard
from machine import (CONFIG, demand, install, restart, run, service, status, wait_for_status, write_config,
                     write_credentials)
from stepping import Reboot, run_steps

BLE_UPDATES = {f"ntnu-slam/robot/ble{n}/update": 5 for n in (1, 2, 3)}
STOPPED_S = 120
LONGEST_GAP_S = 1.0  # between two acknowledgements of a Thread robot, while the board does not read
NOT_LOADED = pathlib.Path("/etc/modules-load.d/slam-gateway.conf")
AWAY_S = 1  # of the interface; a robot without an answer for 2.8 s searches for another gateway

world = {}


def driver_is_loaded():
    return pathlib.Path("/sys/module/cdc_acm").exists()


def robots_are_heard():
    listener = Listener()
    listener.wait_for(BLE_UPDATES)
    listener.end()


def install_service():
    """Installs the needs of all steps: the package, a broker, both meshes."""
    if CONFIG.exists():
        return
    run("systemctl", "start", "mosquitto")
    install(*glob.glob("/job/input/debs/*.deb"))
    set_up_broker()
    write_credentials(PASSWORDS["slam-gateway"])
    write_config(ble_mesh={"enabled": True, "device": "auto"})
    restart()
    wait_for_status("broker up, ble down, thread up")


def board():
    """Returns the board at its port; waits for the link."""
    install_service()
    if "board" not in world:
        world["board"] = UsbBoard(robots=3)
        world["board"].plug_in()
    wait_for_status("ble up")
    return world["board"]


def waits_for_a_board():
    """install without a board, and without its driver: the service runs, and reports that the BLE link is down"""
    demand(not driver_is_loaded(), "the driver was loaded before the package was there")
    install_service()
    demand(driver_is_loaded(), "the service has not loaded the driver")


def connects_to_a_board_that_is_plugged_in():
    """plugged in: the confined service opens /dev/ttyACM0, the link comes up, the robots are heard"""
    demand(not PORT.exists(), f"{PORT} was there before")
    board()
    demand(pathlib.Path(f"/dev/slam-gateway/{SERIAL_NUMBER}").resolve() == PORT, "the board has no stable name")
    robots_are_heard()


def reconnects_to_a_board_that_was_unplugged():
    """unplugged: the link is down at once; plugged in again it is up, three times"""
    for _ in range(3):
        board().unplug()
        wait_for_status("ble down")
        world["board"].plug_in()
    board()
    demand(PORT.exists(), "the port has another number: the service did not close the old one")
    robots_are_heard()
    demand(service("NRestarts") == "0", "the service was restarted")


def serves_thread_while_the_board_stops_reading():
    """board stops reading its USB port for two minutes: Thread robots and the control socket are served; then the link is up"""
    port = board()
    robots = RecordedRobots("127.0.0.1:47193", "--robots", "4", "--id-prefix", "steady")
    robots.wait_for_each(10)
    process, began = service("MainPID"), time.time()
    port.stop_reading()
    while time.time() < began + STOPPED_S:
        with contextlib.suppress(machine.Failure):  # refused, or without an outcome: the board does not read
            run("timeout", "20", "slam-gatewayctl", "send", "ble1", "cmd", "10,-20")
        demand(status()["broker"]["state"] == "up", "the broker link is down")
        time.sleep(1)
    ended = time.time()
    wait_for_status("ble down")
    port.read_again()
    wait_for_status("ble up")
    gap = robots.longest_gap(began, ended)
    result = robots.end()
    demand(result["lost"] == 0, f"the robots report: {result}")
    demand(service("MainPID") == process, "the service was restarted")
    demand(gap < LONGEST_GAP_S, f"a robot waited {gap:.2f} s")
    robots_are_heard()
    return f"longest wait of a Thread robot {gap:.2f} s"


def connects_to_a_board_after_a_boot_without_the_driver():
    """boot without the driver and without a board: the board is used when it is plugged in"""
    install_service()
    if not NOT_LOADED.is_symlink():
        if "board" in world:
            world.pop("board").end()
        NOT_LOADED.symlink_to("/dev/null")
        run("systemctl", "enable", "mosquitto")
        raise Reboot
    demand(not run("journalctl", "-b", "-q", "-u", "systemd-modules-load", "-g", "cdc_acm", status=None),
           "the driver was loaded at boot")
    wait_for_status("broker up, ble down, thread up")
    board()
    robots_are_heard()


def robots():
    return json.loads(run("slam-gatewayctl", "--json", "robots"))


def obeys(name):
    run("slam-gatewayctl", "send", name, "cmd", "10,-20")


NODES = ("n1", "n2", "n3")
FLEET = [f"{node}-{n}" for node in NODES for n in (1, 2)]


def fleets():
    """Returns two robots in each node; waits until they are heard."""
    install_service()
    if "fleets" not in world:
        world["radios"] = Radios(NODES)
        gateway = f"[{world['radios'].address()}]:47193"
        world["fleets"] = [RecordedRobots(gateway, "--robots", "2", "--rate", "2", "--keep-alive", "60", "--id-prefix",
                                          f"{node}-", node=node)
                           for node in NODES]
    for fleet in world["fleets"]:
        fleet.wait_for_each(5)
    return world["fleets"]


def carries_robots_behind_radios():
    """6LoWPAN: six robots in three nodes connect over 802.15.4 radios, are heard, and obey"""
    fleets()
    for name in FLEET:
        obeys(name)


def thread_counters():
    return status()["meshes"]["thread"]["counters"]


def demand_all_there(before):
    offline = [robot["id"] for robot in robots() if robot["id"] in FLEET and robot["state"] != "online"]
    demand(not offline, f"offline: {offline}")
    lost = thread_counters()["clients_lost"] - before["clients_lost"]
    demand(lost == 0, f"{lost} robots were lost")


def loses_no_robot_on_a_bad_radio():
    """6LoWPAN with 20 % of the frames lost each way: no robot is lost, and each obeys"""
    behind_radios, before, since = fleets(), thread_counters(), time.time()
    world["radios"].lose(20)
    try:
        for name in FLEET:
            obeys(name)
        for fleet in behind_radios:
            fleet.wait_for_each(60, since)
        demand_all_there(before)
    finally:
        world["radios"].lose(0)
    repeated = thread_counters()["repeats_suppressed"] - before["repeats_suppressed"]
    demand(repeated > 0, "no update was repeated: the radio lost nothing")
    return f"{repeated} updates were repeated after a lost acknowledgement"


def loses_no_robot_when_the_interface_is_made_again():
    """6LoWPAN interface deleted and made again under another index, as a border router's restart does: no robot is lost"""
    behind_radios, before, index = fleets(), thread_counters(), world["radios"].interface_index()
    world["radios"].delete_interface()
    deleted = time.time()
    while time.time() < deleted + AWAY_S:
        demand(status()["broker"]["state"] == "up", "the broker link is down")
    world["radios"].make_interface()
    since = time.time()
    demand(world["radios"].interface_index() != index, "the interface has its old index")
    for fleet in behind_radios:
        fleet.wait_for_each(5, since)
    for name in FLEET:
        obeys(name)
    demand_all_there(before)
    demand(thread_counters()["connects"] == before["connects"], "robots had to connect again")


STEPS = [
    waits_for_a_board,
    connects_to_a_board_that_is_plugged_in,
    reconnects_to_a_board_that_was_unplugged,
    serves_thread_while_the_board_stops_reading,
    connects_to_a_board_after_a_boot_without_the_driver,
    carries_robots_behind_radios,
    loses_no_robot_on_a_bad_radio,
    loses_no_robot_when_the_interface_is_made_again,
]

if __name__ == "__main__":
    sys.exit(run_steps(STEPS, sys.argv[1:]))
