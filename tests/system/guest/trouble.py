# SPDX-License-Identifier: Apache-2.0
"""Steps: reload, kill and watchdog of the running service."""
import contextlib
import os
import pathlib
import re
import signal
import socket
import time

from actors import Listener, Robots, demand_nothing_lost, retained
from machine import (CONFIG, demand, logged, now, restart, run, service, wait_for, wait_for_status, write_config)

SO_RCVBUFFORCE = 33  # <asm-generic/socket.h>; the module socket has no name for it
DROP_IN = pathlib.Path("/etc/systemd/system/slam-gateway.service.d/system-test.conf")


def reload_applies_a_good_configuration():
    """reload: a good configuration is in force, in the same process"""
    process, since = service("MainPID"), now()
    write_config(log={"level": "debug"}, mqttsn={"gateway_id": 7})
    run("systemctl", "reload", "slam-gateway")
    wait_for("the reload in the journal", lambda: logged("configuration read again", *since))
    demand(logged("only a restart changes: mqttsn.*", *since), "the keys that need a restart are not reported")
    demand(service("MainPID") == process, "it is another process")


def reload_refuses_a_bad_configuration():
    """reload: a bad configuration is refused with file, line and key, and the old one stays in force"""
    process, since = service("MainPID"), now()
    CONFIG.write_text('{\n  "brokr": {}\n}\n', encoding="utf-8")
    run("systemctl", "reload", "slam-gateway", status=1)
    demand(logged("gateway.json:2: brokr", *since, "SYSLOG_IDENTIFIER=slam-gatewayd"), "the journal does not name the problem")
    # Sends the signal without the check that the service makes before it.
    run("systemctl", "kill", "-s", "HUP", "slam-gateway")
    wait_for("the refusal", lambda: logged("configuration was not changed", *since))
    demand(service("MainPID") == process, "it is another process")
    wait_for_status("broker up")
    write_config()
    run("systemctl", "reload", "slam-gateway")


def kill_loses_no_message_or_session():
    """kill -9: systemd restarts the service; sessions continue, no message is lost, and retained states are right"""
    listener = Listener()
    restarts = int(service("NRestarts"))
    robots = Robots("thread", "--robots", 4, "--id-prefix", "killed", "--messages", 100, "--linger-s", 15)
    listener.wait_for({"ntnu-slam/robot/killed4/update": 10})
    since = now()
    run("systemctl", "kill", "--kill-whom=main", "-s", "KILL", "slam-gateway")
    wait_for("the restart", lambda: int(service("NRestarts")) > restarts and service("ActiveState") == "active")
    wait_for_status("broker up")
    restored = re.search(r"restored (\d+) MQTT-SN sessions", logged("MQTT-SN sessions", *since) or "")
    demand(restored and int(restored[1]) >= 4, "the sessions were not restored")
    wait_for("the robots' presence", lambda: all(retained(f"robots/killed{n}") == "online" for n in (1, 2, 3, 4)))
    demand(retained("state") == "online", "the gateway's retained state")
    run("slam-gatewayctl", "send", "killed3", "cmd", "5,6")  # the robot has not connected again
    result = robots.result()
    demand_nothing_lost(result)
    demand(result["commands_received"] == 1, f"commands received: {result}")
    listener.wait_for({f"ntnu-slam/robot/killed{n}/update": 100 for n in (1, 2, 3, 4)})
    listener.end()
    wait_for("the robots' leave", lambda: all(retained(f"robots/killed{n}") == "offline" for n in (1, 2, 3, 4)))


def restarts_lose_no_datagram():
    """restart and kill -9: the port is never refused, and datagrams that arrive during the restart are answered"""
    for how in (("restart", "slam-gateway"), ("kill", "--kill-whom=main", "-s", "KILL", "slam-gateway")):
        robot = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        robot.settimeout(60)
        # All answers after the restart may arrive at once: more than the default buffer of 212 992 bytes holds.
        robot.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, 4 << 20)
        robot.connect(("127.0.0.1", 47193))  # a refusal shows as an error of send or recv
        robot.send(b"\x0a\x04\x04\x01\x00\x3ckept")
        demand(robot.recv(100) == b"\x03\x05\x00", "no CONNACK")
        time.sleep(1)  # the session is on disk
        process = service("MainPID")
        run("systemctl", "--no-block", *how)
        sent = answered = 0
        robot.settimeout(0.01)
        while sent == 0 or service("MainPID") in ("0", process) or service("ActiveState") != "active":
            robot.send(b"\x02\x16")
            sent += 1
            with contextlib.suppress(TimeoutError):
                answered += robot.recv(100) == b"\x02\x17"
        robot.settimeout(60)
        while answered < sent:
            answered += robot.recv(100) == b"\x02\x17"
        robot.close()


def watchdog_restarts_a_stopped_daemon():
    """watchdog: a daemon that hangs is restarted"""
    DROP_IN.parent.mkdir(exist_ok=True)
    DROP_IN.write_text("[Service]\nWatchdogSec=2s\nRestartSec=1s\n", encoding="utf-8")
    run("systemctl", "daemon-reload")
    restart()
    wait_for_status("broker up")
    process, since = int(service("MainPID")), now()
    os.kill(process, signal.SIGSTOP)
    wait_for("the watchdog", lambda: logged("Watchdog timeout", *since))
    wait_for("the restart", lambda: service("MainPID") not in ("0", str(process)))
    wait_for_status("broker up")
    DROP_IN.unlink()
    run("systemctl", "daemon-reload")
    restart()
