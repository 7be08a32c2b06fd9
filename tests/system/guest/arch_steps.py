#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""The steps of ./dev system-test --arch, in a virtual machine with that processor and in their order: the packages with a
board at a USB port and robots behind 6LoWPAN radios, from install to purge."""
import pathlib
import platform
import re
import sys

import hardware_steps
import install_and_remove
import trouble
from actors import Listener
from machine import restart, run, service, wait_for_status, write_config
from stepping import run_steps

CLIENTS = ("mosquitto", "paho")  # broker.client; the last one, the default, stays
HEARD = hardware_steps.BLE_UPDATES | {f"ntnu-slam/robot/{node}-1/update": 5 for node in hardware_steps.NODES}


def use_client(client):
    write_config(ble_mesh={"enabled": True, "device": "auto"}, broker={"client": client})
    run("slam-gatewayd", "--check-config")
    restart()
    wait_for_status("broker up, ble up, thread up")


def resident_mib():
    process = pathlib.Path("/proc", service("MainPID"), "status").read_text(encoding="ascii")
    return int(re.search(r"^VmRSS:\s+(\d+) kB$", process, re.MULTILINE)[1]) / 1024


def ready_after_ms():
    started, ready = (int(service(f"{event}TimestampMonotonic")) for event in ("ExecMainStart", "ActiveEnter"))
    return (ready - started) / 1000


def each_broker_client_carries_both_meshes():
    """broker.client: each of the two carries updates of both meshes up, and a command down to each; memory and start"""
    hardware_steps.board()
    hardware_steps.fleets()
    figures = []
    for client in CLIENTS:
        use_client(client)
        listener = Listener()
        listener.wait_for(HEARD)
        listener.end()
        for name in ("ble1", "n1-1"):
            hardware_steps.obeys(name)
        figures.append(f"{client} {resident_mib():.1f} MiB, READY after {ready_after_ms():.0f} ms")
    return f"{platform.machine()}: {'; '.join(figures)}"


STEPS = [
    hardware_steps.waits_for_a_board,
    install_and_remove.is_confined,
    hardware_steps.connects_to_a_board_that_is_plugged_in,
    hardware_steps.carries_robots_behind_radios,
    each_broker_client_carries_both_meshes,
    trouble.kill_loses_no_message_or_session,
    install_and_remove.upgrade_keeps_what_is_undelivered,
    install_and_remove.remove_keeps_the_state,
    install_and_remove.purge_removes_everything,
]

if __name__ == "__main__":
    sys.exit(run_steps(STEPS, sys.argv[1:]))
