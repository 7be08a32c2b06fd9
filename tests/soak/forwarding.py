# SPDX-License-Identifier: Apache-2.0
"""Whether messages go up as docs/topics.md says: their QoS, their retain flag, and no robot or gateway declared gone that is there.
Pure: lists in, complaints out. Called by judge.

QoS and retain are those of the publisher, as a subscriber with QoS 2 and "retain as published" sees them (subscriber.Witness).
A robot is there while its gateway acknowledges its messages. It may be declared gone in a trouble and shortly after one.
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
    """`qos_of`: the QoS with which each robot publishes. One complaint for each kind of topic and fault, with its count."""
    faults = collections.Counter()
    for one in heard:
        expected = expected_form(one.topic.split("/"), qos_of)
        if expected and (one.qos, one.retain) != expected:
            faults[kind_of(one.topic), one.qos, one.retain, *expected] += 1
    return [f"{topic}: {count} messages with {form(qos, retain)} instead of {form(*expected)}"
            for (topic, qos, retain, *expected), count in sorted(faults.items())]


def expected_form(levels, qos_of):
    """(QoS, retain) of what goes up under this topic; None where nothing is promised."""
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
    """`messages`: (at, topic, payload) in order. Robots that end in order are gone from `robots_end` on."""
    acknowledged = collections.defaultdict(list)
    for one in said:
        if one.acknowledged_at is not None:
            acknowledged[one.robot].append(one.acknowledged_at)
    complaints = []
    for at, topic, payload in messages:
        levels = topic.split("/")
        if levels[1] == "gateway" and levels[3] == "state":
            if is_offline(payload) and not touched(at - MOMENT_S, at, gaps):
                complaints.append(f"the gateway is declared offline at {at:.3f} although its connection stands")
            continue
        robot = robot_declared_gone(levels, payload)
        if robot is None or at > robots_end or touched(at - SILENCE_S - MOMENT_S, at, troubles):
            continue
        if any(at - SILENCE_S <= heard <= at for heard in acknowledged[robot]):
            complaints.append(f"{robot}: declared gone by {'/'.join(levels[1:2] + levels[3:4])} at {at:.3f} although it is heard")
    return complaints


def robot_declared_gone(levels, payload):
    """Its id; None when the message says nothing like that."""
    if levels[1] == "robot" and levels[3] == "will":
        return levels[2]
    if levels[1] == "gateway" and levels[3] == "robots" and is_offline(payload):
        return levels[4]
    return None


def is_offline(payload):
    return bool(payload) and json.loads(payload)["state"] == "offline"


def touched(begin, end, troubles):
    return any(trouble.begin <= end and trouble.end >= begin for trouble in troubles)
