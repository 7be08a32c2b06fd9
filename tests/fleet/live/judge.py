# SPDX-License-Identifier: Apache-2.0
"""What a run has come to: every message of a robot, every command, and where the broker said that each robot is. What it forgives is
in bounds. Used by run.

Of a message that came late (streams: no live observer was there) it is not known when it was published. It counts as come, and its
copies and its order are judged, with the time of its arrival as the latest possible one. Left out: whether a will was false
(`wills_of_unknown_time`), whether an outcome came in time, how long the message took, the order of messages of BLE robots
(`ble_order_unknown`). Presence is what live observers saw."""
import datetime
import time
from collections import Counter, defaultdict

from bounds import HURRY_S, Bounds
from commands import outcomes_of
from presence import longest_contradiction
from robot import KEEP_ALIVE_S

SERVICE_S = 5  # the promise for p99 of the time without service, each time that it was interrupted
JUDGED_S = 30  # a shorter run says nothing about p99
CONTRADICTION_S = 2  # the promise for two `online` at a time
BROKEN = ("lost", "doubled", "out_of_order", "false_wills", "obeyed_twice", "obeyed_unasked", "delivered_nowhere", "obeyed_though_refused",
          "outcomes_missing", "outcomes_late", "outcomes_doubled", "too_many_cut_short", "sent_at_qos_0", "deaf", "act_failed", "strange_presence",
          "contradicting_presence", "silence_too_long", "ended", "ble_lost", "ble_doubled_beyond", "ble_out_of_order", "ble_unknown",
          "ble_commands_wrong", "ble_obeyed_though_refused", "ble_silence_too_long")


def percentile(values, part):
    ordered = sorted(values)
    return round(ordered[min(len(ordered) - 1, len(ordered) * part // 100)], 3) if ordered else None


def connections(log):
    """(from, to), of each connection of a gateway to a broker."""
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
    """Each thing that is wrong or forgiven: counted by its kind for the verdict, and told with its time for the log."""

    def __init__(self):
        self.counts, self.told = Counter(), []

    def add(self, kind, at, what):
        self.counts[kind] += 1
        self.tell(kind, at, what)

    def tell(self, kind, at, what):
        self.told.append((at, f"{kind}: {what}", b""))


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
            "came_late": len(late), "order_unknown": unjudged,
            "arrival_p99_s": percentile([times[0] - robots[name].sent[number] for (name, number), times in came.items()
                                         if times and number in robots[name].sent and (name, number) not in late], 99),
            "sessions_begun_anew": sum(robot.refused_topics for robot in fleet.robots)}


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
    """It may have been published a moment before it came, when the robot had not yet gone on."""
    places = robot.places_between(at - HURRY_S, at)
    is_bound = any(bounds.may_have_a_will(place, at) for place in places)
    findings.add("wills_of_cut_off" if is_bound else "false_wills", at, f"{robot.name} at {sorted(f'gw{place}' for place in places)}")


def waits_since(robot, number, came):
    """When the robot said the first one of those before it that were still on their way by the same gateway, which keeps their order."""
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
            findings.tell("silence_too_long", asked[0][0], f"{name} for {seconds:.1f} s: {asked}")
    return {"interruptions": len(interruptions), "silence_p50_s": percentile(interruptions, 50),
            "silence_p99_s": percentile(interruptions, 99), "silence_max_s": percentile(interruptions, 100),
            "silence_too_long": int(fleet.options.seconds >= JUDGED_S and (percentile(interruptions, 99) or 0) > SERVICE_S)}


def judge_obedience(fleet, findings):
    """What a robot has obeyed that nobody has sent."""
    sent = {command.kind for command in fleet.commands.distinct.values()} | {"1"}
    for robot in fleet.robots:
        for at, gateway, payload in robot.commands:
            if payload not in sent:
                findings.add("obeyed_unasked", at, f"{robot.name} by gw{gateway}: {payload}")


def judge_presence(fleet, bounds, findings):
    """At the end, and all the time that it was observed."""
    for line in fleet.presence:
        findings.add("strange_presence", time.monotonic(), line)
    for line in fleet.stale_presence:
        findings.add("stale_presence_at_a_node", time.monotonic(), line)
    longest, longest_at_return = 0.0, 0.0

    def is_bound(begin, seconds, places, earliest):
        return bounds.may_announce_anew([int(place.removeprefix("gw-")) for place in places], begin, seconds, earliest)

    for name in fleet.names():
        begin, seconds, places, _ = longest_contradiction(fleet.observers.presence(), name, is_bound)
        longest = max(longest, seconds)
        longest_at_return = max(longest_at_return, longest_contradiction(fleet.observers.presence(), name,
                                                                         lambda *each: not is_bound(*each))[1])
        if seconds > CONTRADICTION_S:
            findings.add("contradicting_presence", begin, f"{name} is said to be at {places} for {seconds:.3f} s")
    return {"two_online_max_s": round(longest, 3), "two_online_at_a_return_max_s": round(longest_at_return, 3)}


def bounds_of(fleet):
    engine = fleet.engine
    return Bounds(fleet.trouble.absences, [connections(daemon.log) for daemon in fleet.daemons], engine.subscribed_s, engine.settle_s,
                  engine.change_s, loses_all=len(engine.nodes) == 1, hears_all=engine.takes_mqtt5 and fleet.options.mqtt == 5)


def judge_commands(fleet, messages, bounds, findings):
    told = outcomes_of(messages, fleet.commands.times())
    robots = {robot.name: robot for robot in fleet.robots}
    breaks = defaultdict(list)
    for at, client in fleet.engine.broken_connections():
        breaks[client.removeprefix(f"{fleet.prefix}-robot-")].append(at)
    return told, fleet.commands.judge(robots, fleet.places_of_ble(), told, bounds, findings, fleet.engine.again_s, breaks)


def are_outcomes_missing(fleet):
    """As far as the run has come."""
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
    told, commands = judge_commands(fleet, messages, bounds, findings)
    verdict.update({**commands, **judge_presence(fleet, bounds, findings),
                    **(fleet.ble.judge(fleet, messages, told, bounds, findings) if fleet.ble else {}), "acts": fleet.acts.verdict()})
    for what in fleet.ended:
        findings.add("ended", time.monotonic(), what)
    verdict.update(sorted(findings.counts.items()))
    verdict["fleet_messages"] = sum(1 for _, topic, *_ in messages if topic.split("/")[1] == "fleet")
    verdict.update(fleet.machine.verdict())
    verdict["broken"] = [key for key in BROKEN if verdict.get(key)]
    return verdict, findings
