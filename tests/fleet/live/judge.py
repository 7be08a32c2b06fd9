# SPDX-License-Identifier: Apache-2.0
"""What a run has come to: every message of a robot, every command, and where the broker said that each robot is. What it forgives is
in bounds. Used by run.

Of a message that came late (streams: no live observer was there) it is not known when it was published. It counts as come, and its
copies and its order are judged, with the time of its arrival as the latest possible one. Left out: whether a will was false
(`wills_of_unknown_time`), whether an outcome came in time, how long the message took, the order of messages of BLE robots
(`ble_order_unknown`). Presence is what live observers saw."""
import datetime
import json
import time
from collections import Counter, defaultdict
from typing import NamedTuple

from bounds import HURRY_S, Bounds
from presence import longest_contradiction
from robot import KEEP_ALIVE_S

SERVICE_S = 5  # the promise for p99 of the time without service, each time that it was interrupted
CONTRADICTION_S = 2  # the promise for two `online` at a time
# Promise 6 of docs/topics.md, 30 s; 31 s after the last word that it was taken, of whom a gateway died, and turns after that.
OUTCOME_S = 45
BROKEN = ("lost", "doubled", "out_of_order", "false_wills", "delivered_twice", "delivered_nowhere", "obeyed_though_refused",
          "outcomes_missing", "outcomes_late", "outcomes_doubled", "strange_presence", "contradicting_presence", "silence_too_long", "ended",
          "ble_lost", "ble_doubled_beyond", "ble_out_of_order", "ble_unknown", "ble_commands_wrong", "ble_obeyed_though_refused",
          "ble_silence_too_long")


def percentile(values, part):
    ordered = sorted(values)
    return round(ordered[min(len(ordered) - 1, len(ordered) * part // 100)], 3) if ordered else None


def connections(log):
    """(from, to), of each connection of a gateway to a broker."""
    to_monotonic = time.monotonic() - time.time()
    begun, found = None, []
    for line in log.read_text().splitlines():
        is_up = " connected (MQTT" in line
        if not is_up and not any(word in line for word in (" is not reached: ", "leaves broker ", " starts as gateway ")):
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


class Outcome(NamedTuple):
    at: float
    gateway: int
    payload: bytes
    is_late: bool = False  # it came late (streams), and `at` is reckoned


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
            "silence_too_long": int(fleet.options.seconds >= 30 and (percentile(interruptions, 99) or 0) > SERVICE_S)}


def outcomes_of(messages, commands):
    """By (robot, type): the Outcomes, in the order of their times. `commands`: when each was published. That of an outcome which came late
    is reckoned: it says how long the command took."""
    told = defaultdict(list)
    for at, topic, payload, is_late in messages:
        levels = topic.split("/")
        if levels[1] == "gateway" and levels[3] == "commands":
            key = levels[4], json.loads(payload)["type"]
            when = min(at, said_at(commands.get(key, at), payload)) if is_late else at
            told[key].append(Outcome(when, int(levels[2].removeprefix("gw-")), payload, is_late))
    return {key: sorted(said) for key, said in told.items()}


def said_at(commanded, payload):
    """When an outcome was published, at the earliest: the gateway may have got the command late."""
    return commanded + json.loads(payload)["after_ms"] / 1000


def taken_in(messages):
    """By (robot, type): when gateways said that they take the command."""
    taken = defaultdict(list)
    for at, topic, payload, _ in messages:
        if topic.split("/")[1] == "fleet" and b'"taken"' in payload:
            message = json.loads(payload)
            taken[message["robot"], message["type"]].append(at)
    return taken


def judge_commands(fleet, bounds, told, taken, findings):
    """One that no broker has confirmed may be lost; it is not carried out twice either, and has no two outcomes."""
    confirmed = fleet.observers.confirmed()
    carried_out, robots = Counter((robot.name, kind) for robot in fleet.robots for _, _, kind in robot.commands), {
        robot.name: robot for robot in fleet.robots}
    outcomes = Counter()
    for key, at in fleet.commands.items():
        name = f"{key[0]} {key[1]}"
        if carried_out[key] > 1:
            findings.add("delivered_twice", at, name)
        said = without_repetitions(bounds, at, told.get(key, []), findings)
        results = [json.loads(each.payload)["outcome"] for each in said]
        outcomes.update(results)
        if len(said) > 1:
            findings.add(twice_told(bounds, at, said), said[-1].at, f"{name} of {at:.3f}: {described(said)}")
        if not said and key in confirmed:
            findings.add(missing(bounds, at), at, name)
        if said and not said[0].is_late and said[0].at > max([at, *(each for each in taken[key] if each < said[0].at)]) + OUTCOME_S:
            findings.add("outcomes_late", said[0].at, f"{name} of {at:.3f}: {described(said)}")
        if key[0] in fleet.thread_names() and "delivered" in results and not carried_out[key]:
            findings.add("delivered_nowhere", at, name)
        if carried_out[key] and results and "delivered" not in results:
            is_bound = may_be_obeyed(bounds, robots[key[0]], key[1], said[-1].at)
            findings.add("obeyed_all_the_same" if is_bound else "obeyed_though_refused", at, f"{name}: {described(said)}")
    return {"commands": len(fleet.commands), "unconfirmed": sum(1 for key in fleet.commands if key not in confirmed),
            "outcomes": dict(outcomes)}


def described(said):
    return "; ".join(f"{each.at:.3f} gw{each.gateway} {each.payload.decode()}" + (" (late)" if each.is_late else "") for each in said)


def may_be_obeyed(bounds, robot, kind, told):
    moves = [since for since, _ in robot.places]
    return all(bounds.may_be_obeyed_all_the_same(gateway, obeyed, told, moves)
               for obeyed, gateway, other in robot.commands if other == kind)


def twice_told(bounds, at, said):
    """One `timeout` by another gateway, and the outcome of the gateway that took the command, whichever came first."""
    own, other = sorted(said[:2], key=lambda each: json.loads(each.payload)["outcome"] == "timeout")
    is_bound = (len(said) == 2 and own.gateway != other.gateway and json.loads(own.payload)["outcome"] != "timeout" and
                json.loads(other.payload)["outcome"] == "timeout" and bounds.may_be_told_twice(own.gateway, at, own.at))
    return "outcomes_doubled_when_all_were_cut_off" if is_bound else "outcomes_doubled"


def missing(bounds, at):
    if bounds.may_be_unheard(at):
        return "unheard"
    return "orphaned" if bounds.may_be_orphaned(at) else "outcomes_missing"


def without_repetitions(bounds, commanded, said, findings):
    """Without copies, word for word, of what the same gateway said: as many as connections broke under it."""
    kept, copies = [], Counter()
    for each in said:
        before = next((other for other in kept if (other.gateway, other.payload) == (each.gateway, each.payload)), None)
        if before and copies[before] < bounds.may_come_again(each.gateway, said_at(commanded, each.payload), before.at, each.at):
            copies[before] += 1
            findings.add("outcomes_repeated_when_broker_broke", each.at, described([before, each]))
        else:
            kept.append(each)
    return kept


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


def judge(fleet):
    findings = Findings()
    messages = fleet.observers.messages()
    bounds = Bounds(fleet.trouble.absences, [connections(daemon.log) for daemon in fleet.daemons], fleet.engine.subscribed_s,
                    fleet.lapses.found, fleet.engine.settle_s)
    told = outcomes_of(messages, fleet.commands)
    verdict = {"seed": fleet.options.seed, "engine": fleet.options.engine, **fleet.trouble.acts, **fleet.observers.verdict(),
               **judge_messages(fleet, bounds, messages, findings), **judge_silence(fleet, findings),
               **judge_commands(fleet, bounds, told, taken_in(messages), findings), **judge_presence(fleet, bounds, findings),
               **(fleet.ble.judge(messages, told, bounds, findings) if fleet.ble else {})}
    for what in fleet.ended:
        findings.add("ended", time.monotonic(), what)
    verdict.update(sorted(findings.counts.items()))
    verdict["fleet_messages"] = sum(1 for _, topic, *_ in messages if topic.split("/")[1] == "fleet")
    verdict["lease_lapses"] = len(fleet.lapses.found)
    verdict.update(fleet.machine.verdict())
    verdict["broken"] = [key for key in BROKEN if verdict.get(key)]
    return verdict, findings
