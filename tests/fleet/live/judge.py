# SPDX-License-Identifier: Apache-2.0
"""Judges a run: every message of a robot, every command, and the presence of each robot at the broker. bounds.py has what it forgives.
Used by run.

The time of publication is unknown for a message that came late (streams: no live observer was connected). It counts as arrived. Its
copies and order are judged with its arrival as the latest possible time. Not judged: false wills (`wills_of_unknown_time`), the delay
of outcomes and messages, the order of messages of BLE robots (`ble_order_unknown`). Presence is that of live observers."""
import datetime
import time
from collections import Counter, defaultdict

from bounds import HURRY_S, Bounds
from commands import outcomes_of
from presence import longest_contradiction
from robot import KEEP_ALIVE_S

SERVICE_S = 5  # the promise for p99 of the time without service, each time that it was interrupted
JUDGED_S = 30  # a shorter run has too few values for p99
CONTRADICTION_S = 2  # the promise for two `online` at a time
BROKEN = ("lost", "doubled", "out_of_order", "false_wills", "obeyed_twice", "obeyed_without_command", "delivered_but_not_obeyed",
          "obeyed_though_refused", "outcomes_missing", "outcomes_late", "outcomes_doubled", "too_many_lost_at_moves", "sent_at_qos_0",
          "subscription_lost", "act_failed", "wrong_presence", "contradicting_presence", "silence_too_long", "programs_ended",
          "ble_lost", "ble_doubled_beyond_bound", "ble_out_of_order", "ble_unknown_robot", "ble_commands_wrong",
          "ble_obeyed_though_refused", "ble_silence_too_long")


def percentile(values, part):
    ordered = sorted(values)
    return round(ordered[min(len(ordered) - 1, len(ordered) * part // 100)], 3) if ordered else None


def connections(log):
    """Returns (from, to) of each connection of a gateway to a broker."""
    to_monotonic = time.monotonic() - time.time()
    begun, found = None, []
    for line in log.read_text().splitlines():
        is_up = " connected (MQTT" in line
        if not is_up and not any(word in line for word in ("cannot reach broker ", "leaving broker ", " starts as gateway ")):
            continue
        at = datetime.datetime.fromisoformat(line.split()[0]).timestamp() + to_monotonic
        if begun:
            found.append((begun, at))
        begun = at if is_up else None
    return found + ([(begun, float("inf"))] if begun else [])


class Findings:
    """Faults and forgiven events: counted by kind for the verdict, and listed with their times for the log."""

    def __init__(self):
        self.counts, self.reported = Counter(), []

    def add(self, kind, at, what):
        self.counts[kind] += 1
        self.note(kind, at, what)

    def note(self, kind, at, what):
        self.reported.append((at, f"{kind}: {what}", b""))


def judge_messages(fleet, bounds, messages, findings):
    came, robots = defaultdict(list), {robot.name: robot for robot in fleet.robots}
    late = set()
    for at, topic, payload, is_late in messages:
        levels = topic.split("/")
        if levels[1] == "robot" and levels[3] == "note":
            came[levels[2], int(payload)].append(at)
            late |= {(levels[2], int(payload))} if is_late else set()
        elif levels[1] == "robot" and levels[3] == "gone" and is_late:
            findings.add("wills_of_unknown_time", at, levels[2])
        elif levels[1] == "robot" and levels[3] == "gone" and at < robots[levels[2]].ended + KEEP_ALIVE_S:
            judge_will(bounds, robots[levels[2]], at, findings)
    for robot in fleet.robots:
        for number, at in robot.acknowledged.items():
            if not came[robot.name, number]:
                findings.add("lost", at, f"{robot.name} {number}, acknowledged by gw{robot.acknowledged_by[number]}")
    for (name, number), times in came.items():
        judge_copies(bounds, name, number, robots[name].tries.get(number, []), times, findings)
    behind, unjudged = fleet.observers.late_notes()
    for name, number, later in behind:
        judge_order(bounds, robots[name], number, later, came, findings)
    return {"messages": sum(len(robot.acknowledged) for robot in fleet.robots),
            "arrived_late": len(late), "order_unknown": unjudged,
            "arrival_p99_s": percentile([times[0] - robots[name].sent[number] for (name, number), times in came.items()
                                         if times and number in robots[name].sent and (name, number) not in late], 99),
            "sessions_restarted": sum(robot.refused_topics for robot in fleet.robots)}


def judge_copies(bounds, name, number, tries, times, findings):
    if len(times) < 2:
        return
    said, broken = bounds.copies(tries, times[0], times[-1])
    kind = "doubled"
    if len(times) <= said:
        kind = "doubled_when_repeated"
    elif len(times) <= said + broken:
        kind = "doubled_when_broker_broke"
    findings.add(kind, times[-1], f"{name} {number}: said at {[(round(at, 3), f'gw{to}') for at, to, _ in tries]}, "
                 f"came at {[round(at, 3) for at in times]}")


def judge_will(bounds, robot, at, findings):
    """Judges a will. It may have been published a moment before it arrived, when the robot had not moved yet."""
    places = robot.places_between(at - HURRY_S, at)
    is_bound = any(bounds.may_have_a_will(place, at) for place in places)
    findings.add("wills_at_cut_off_gateways" if is_bound else "false_wills", at,
                 f"{robot.name} at {sorted(f'gw{place}' for place in places)}")


def waits_since(robot, number, came):
    """Returns when the robot sent the first of the messages that were still under way by the same gateway, which keeps their order."""
    since = robot.sent[number]
    for before in range(number - 1, 0, -1):
        times = came.get((robot.name, before))
        if robot.acknowledged_by.get(before) != robot.acknowledged_by[number] or not times or times[0] < since:
            break
        since = robot.sent[before]
    return since


def judge_order(bounds, robot, number, later, came, findings):
    arrived = came[robot.name, number][0]
    by, others = robot.acknowledged_by.get(number), {gateway for _, gateway, _ in robot.tries[later]}
    since = waits_since(robot, number, came) if by is not None else arrived
    is_bound = by is not None and any(bounds.may_be_overtaken(by, other, since, arrived) for other in others)
    findings.add("overtaken_at_a_roam" if is_bound else "out_of_order", arrived,
                 f"{robot.name} {number} by gw{by}, sent at {robot.sent[number]:.3f}, behind {later}, said at {sorted(others)}")


def judge_silence(fleet, findings):
    found = [(robot.name, *each) for robot in fleet.robots for each in robot.interruptions]
    interruptions = [seconds for _, seconds, _ in found]
    for name, seconds, asked in found:
        if seconds > SERVICE_S:
            findings.note("silence_too_long", asked[0][0], f"{name} for {seconds:.1f} s: {asked}")
    return {"interruptions": len(interruptions), "silence_p50_s": percentile(interruptions, 50),
            "silence_p99_s": percentile(interruptions, 99), "silence_max_s": percentile(interruptions, 100),
            "silence_too_long": int(fleet.options.seconds >= JUDGED_S and (percentile(interruptions, 99) or 0) > SERVICE_S)}


def judge_obedience(fleet, findings):
    """Reports commands that a robot has obeyed although they were not sent."""
    sent = {command.kind for command in fleet.commands.distinct.values()} | {"1"}
    for robot in fleet.robots:
        for at, gateway, payload in robot.commands:
            if payload not in sent:
                findings.add("obeyed_without_command", at, f"{robot.name} by gw{gateway}: {payload}")


def judge_presence(fleet, bounds, findings):
    """Judges presence at the end, and for all the time that it was observed."""
    for line in fleet.presence:
        findings.add("wrong_presence", time.monotonic(), line)
    for line in fleet.stale_presence:
        findings.add("stale_presence_at_a_node", time.monotonic(), line)
    longest, longest_at_return = 0.0, 0.0

    def is_bound(begin, seconds, places, earliest):
        return bounds.may_show_former_robots([int(place.removeprefix("gw-")) for place in places], begin, seconds, earliest)

    for name in fleet.names():
        begin, seconds, places, _ = longest_contradiction(fleet.observers.presence(), name, is_bound)
        longest = max(longest, seconds)
        longest_at_return = max(longest_at_return, longest_contradiction(fleet.observers.presence(), name,
                                                                         lambda *each: not is_bound(*each))[1])
        if seconds > CONTRADICTION_S:
            findings.add("contradicting_presence", begin, f"{name} is shown at {places} for {seconds:.3f} s")
    return {"two_online_max_s": round(longest, 3), "two_online_at_a_return_max_s": round(longest_at_return, 3)}


def bounds_of(fleet):
    engine = fleet.engine
    return Bounds(fleet.trouble.absences, [connections(daemon.log) for daemon in fleet.daemons], engine.subscribed_s, engine.settle_s,
                  engine.change_s, loses_all=len(engine.nodes) == 1, hears_all=engine.takes_mqtt5 and fleet.options.mqtt == 5)


def judge_commands(fleet, messages, bounds, findings):
    reported = outcomes_of(messages, fleet.commands.times())
    robots = {robot.name: robot for robot in fleet.robots}
    breaks = defaultdict(list)
    for at, client in fleet.engine.broken_connections():
        breaks[client.removeprefix(f"{fleet.prefix}-robot-")].append(at)
    return reported, fleet.commands.judge(robots, fleet.places_of_ble(), reported, bounds, findings, fleet.engine.again_s, breaks)


def are_outcomes_missing(fleet):
    """Returns True if an outcome is missing so far."""
    findings = Findings()
    judge_commands(fleet, fleet.observers.messages(), bounds_of(fleet), findings)
    return findings.counts["outcomes_missing"] > 0


def judge(fleet):
    findings, messages, bounds = Findings(), fleet.observers.messages(), bounds_of(fleet)
    judge_obedience(fleet, findings)
    for at, what in fleet.acts.failures:
        findings.add("act_failed", at, what)
    verdict = {"seed": fleet.options.seed, "engine": fleet.options.engine, **fleet.trouble.acts, **fleet.observers.verdict(),
               **judge_messages(fleet, bounds, messages, findings), **judge_silence(fleet, findings)}
    reported, commands = judge_commands(fleet, messages, bounds, findings)
    verdict.update({**commands, **judge_presence(fleet, bounds, findings),
                    **(fleet.ble.judge(fleet, messages, reported, bounds, findings) if fleet.ble else {}), "acts": fleet.acts.verdict()})
    for what in fleet.ended:
        findings.add("programs_ended", time.monotonic(), what)
    verdict.update(sorted(findings.counts.items()))
    verdict["fleet_messages"] = sum(1 for _, topic, *_ in messages if topic.split("/")[1] == "fleet")
    verdict.update(fleet.machine.verdict())
    verdict["broken"] = [key for key in BROKEN if verdict.get(key)]
    return verdict, findings
