# SPDX-License-Identifier: Apache-2.0
"""Checks messages to the broker against docs/topics.md: their QoS and retain flag, and that no present robot or gateway is declared
gone. Pure: lists in, complaints out. Called by judge.

QoS and retain are those of the publisher, as a subscriber with QoS 2 and "retain as published" sees them (subscriber.Witness).
A robot is present while its gateway acknowledges its messages. It may be declared gone during a trouble and shortly after it.
"""
import collections
import dataclasses
import json

SILENCE_S = 3  # below each limit after which a silent robot counts as gone
MOMENT_S = 1.5  # from the end of a trouble to the last consequence of it
ROBOTS_TYPES = ("adv", "update")
WILL_QOS = 0  # of the simulated robots' wills


@dataclasses.dataclass
class Heard:
    at: float
    topic: str
    payload: bytes
    qos: int
    retain: bool


def judge_forwarding(heard, qos_of):
    """Returns one complaint for each kind of topic and fault, with its count. `qos_of`: the QoS with which each robot publishes."""
    faults = collections.Counter()
    for one in heard:
        expected = expected_form(one.topic.split("/"), qos_of)
        if expected and (one.qos, one.retain) != expected:
            faults[kind_of(one.topic), one.qos, one.retain, *expected] += 1
    return [f"{topic}: {count} messages with {form(qos, retain)} instead of {form(*expected)}"
            for (topic, qos, retain, *expected), count in sorted(faults.items())]


def expected_form(levels, qos_of):
    """Returns (QoS, retain) of messages on this topic; None where docs/topics.md promises nothing."""
    if levels[1] == "robot" and levels[2] in qos_of:
        if levels[3] in ROBOTS_TYPES:
            return qos_of[levels[2]], False
        return (WILL_QOS, False) if levels[3] == "will" else None
    if levels[1] != "gateway":
        return None
    return {"state": (1, True), "robots": (1, True), "commands": (1, False), "stats": (0, False), "numbers": (0, False)}.get(levels[3])


def kind_of(topic):
    levels = topic.split("/")
    return f"{levels[2]}: {levels[3]}" if levels[1] == "robot" else "/".join(levels[1:4])


def form(qos, retain):
    return f"QoS {qos}, {'retained' if retain else 'not retained'}"


def judge_presence(messages, said, troubles, gaps, robots_end):
    """Returns complaints. `messages`: (at, topic, payload) in order. Robots stop at `robots_end`."""
    acknowledged = collections.defaultdict(list)
    for one in said:
        if one.acknowledged_at is not None:
            acknowledged[one.robot].append(one.acknowledged_at)
    complaints = []
    for at, topic, payload in messages:
        levels = topic.split("/")
        if levels[1] == "gateway" and levels[3] == "state":
            if is_offline(payload) and not touched(at - MOMENT_S, at, gaps):
                complaints.append(f"the gateway is declared offline at {at:.3f} although it is connected")
            continue
        robot = robot_declared_gone(levels, payload)
        if robot is None or at > robots_end or touched(at - SILENCE_S - MOMENT_S, at, troubles):
            continue
        if any(at - SILENCE_S <= heard <= at for heard in acknowledged[robot]):
            complaints.append(f"{robot}: declared gone by {'/'.join(levels[1:2] + levels[3:4])} at {at:.3f} although its "
                              "messages are acknowledged")
    return complaints


def robot_declared_gone(levels, payload):
    """Returns the id of the robot that this message declares gone; otherwise None."""
    if levels[1] == "robot" and levels[3] == "will":
        return levels[2]
    if levels[1] == "gateway" and levels[3] == "robots" and is_offline(payload):
        return levels[4]
    return None


def is_offline(payload):
    return bool(payload) and json.loads(payload)["state"] == "offline"


def touched(begin, end, troubles):
    return any(trouble.begin <= end and trouble.end >= begin for trouble in troubles)
