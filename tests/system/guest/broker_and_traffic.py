# SPDX-License-Identifier: Apache-2.0
"""Steps: the broker with users and an access control list, robots on both meshes, and the journal's entries about them."""
import time

from actors import (PASSWORDS, WRONG_PASSWORD, Listener, Robots, demand_nothing_lost, publish_nonsense, retained,
                    set_up_broker)
from machine import (demand, journal, logged, now, restart, run, service, status, wait_for, wait_for_status,
                     write_config, write_credentials)

LOAD = {"robots": 50, "rate": 20, "messages": 200}


def starts_without_a_broker():
    """start order: without a broker the service starts and waits, and connects when one is available"""
    run("systemctl", "stop", "mosquitto")
    restart()
    wait_for_status("broker down, thread up")
    wait_for("the reason", lambda: "refused" in status()["broker"]["why"])
    run("systemctl", "start", "mosquitto")
    wait_for_status("broker up")
    demand(service("NRestarts") == "0", "the service was restarted for that")


def reports_a_wrong_password():
    """credentials: a wrong password is reported in one line, which does not show it"""
    set_up_broker()
    write_credentials(WRONG_PASSWORD)
    since = now()
    restart()
    line = wait_for("a line about the refused user",
                    lambda: logged("user name or password", *since, "-p", "warning")
                    or logged("authorise", *since, "-p", "warning"))
    wait_for_status("broker down")
    return f'"{line}"'


def logs_in_with_the_right_password():
    """credentials: with the right password the broker is up, within its access control list"""
    write_credentials(PASSWORDS["slam-gateway"])
    write_config()
    since = now()
    restart()
    wait_for_status("broker up")
    demand(retained("state") == "online", "the retained state is not online")
    demand(not logged("refuses", *since), "the access control list of the example refuses the gateway something")


def carries_both_meshes():
    """traffic: three robots on each mesh are heard at the broker, under the same topics, and obey"""
    listener = Listener()
    robots = [Robots("ble", "--acknowledged", "--robots", 3, "--id-prefix", "ble", "--messages", 40, "--linger-s", 8),
              Robots("thread", "--robots", 3, "--id-prefix", "thread", "--messages", 40, "--linger-s", 8)]
    names = [f"{mesh}{n}" for mesh in ("ble", "thread") for n in (1, 2, 3)]
    listener.wait_for({f"ntnu-slam/robot/{name}/update": 5 for name in names})
    wait_for_status("6 robots online")
    for name in ("ble1", "thread1"):
        run("slam-gatewayctl", "send", name, "cmd", "10,-20")
    results = [fleet.result() for fleet in robots]
    for result in results:
        demand_nothing_lost(result)
        demand(result["commands_received"] == 1, f"commands received: {result}")
    listener.wait_for({f"ntnu-slam/robot/{name}/update": 40 for name in names})
    listener.end()
    others = {topic for topic in listener.heard() if not topic.startswith("ntnu-slam/robot/")}
    demand(not others, f"other topics: {others}")


def journal_has_the_documented_fields():
    """journal: a robot's messages are found by ROBOT_ID=, with every documented field"""
    for robot, mesh in (("thread2", "thread"), ("ble2", "ble")):
        up = journal(f"ROBOT_ID={robot}", "MESSAGE_TYPE=update")
        demand(up, f"no entry of {robot}")
        entry = up[-1]
        wanted = {"MESSAGE_ID": "484a36d2a3e146a38d044d92fa5db048", "ROBOT_ID": robot, "MESH": mesh, "DIRECTION": "up",
                  "MESSAGE_TYPE": "update", "TOPIC": f"ntnu-slam/robot/{robot}/update", "QOS": "1", "PRIORITY": "6"}
        found = {field: entry.get(field) for field in wanted}
        demand(found == wanted, f"fields of {robot}: {found}")
        for field in ("X_CM", "Y_CM", "PAYLOAD_BYTES"):
            demand(entry[field].lstrip("-").isdigit(), f"{field} is {entry[field]}")
        demand(int(entry["PAYLOAD_BYTES"]) % 4 == 0, f"PAYLOAD_BYTES is {entry['PAYLOAD_BYTES']}")
    for robot in ("thread1", "ble1"):
        down = journal(f"ROBOT_ID={robot}", "DIRECTION=down")
        demand(down and down[-1]["MESSAGE_TYPE"] == "cmd", f"no command to {robot}")
        outcome = journal(f"ROBOT_ID={robot}", "MESSAGE_ID=3e090f5168f446d1bdd92c7835c03661")
        demand(outcome and outcome[-1]["LATENCY_US"].isdigit(), f"no outcome of the command to {robot}")


def warning_is_found_under_load():
    """load: 50 robots at 20 messages a second each; all arrive, and a warning among them is found in the journal"""
    listener = Listener()
    since = now()
    began = time.monotonic()
    robots = Robots("thread", "--robots", LOAD["robots"], "--rate", LOAD["rate"], "--messages", LOAD["messages"],
                    "--id-prefix", "load")
    listener.wait_for({f"ntnu-slam/robot/load{LOAD['robots']}/update": LOAD["messages"] // 3})
    publish_nonsense("odd-one", b"\x01\x02\x03")
    result = robots.result()
    seconds = time.monotonic() - began
    demand_nothing_lost(result)
    listener.wait_for({f"ntnu-slam/robot/load{n + 1}/update": LOAD["messages"] for n in range(LOAD["robots"])})
    listener.end()
    warnings = journal(*since, "ROBOT_ID=odd-one", "MESSAGE_ID=7214773655d5405f9a3a199f9f4eed84")
    demand(len(warnings) == 1 and warnings[0]["PRIORITY"] == "4", f"warnings: {warnings}")
    demand(not logged("Suppressed", *since), "journald has suppressed entries")
    return f"{result['acknowledged'] / seconds:.0f} acknowledged messages/s"
