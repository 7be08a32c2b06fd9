# SPDX-License-Identifier: Apache-2.0
"""The evidence of a run, and its judgement. Pure: lists in, numbers and complaints out. Called by run, and by lies_test with
the evidence of a faulty daemon."""
import dataclasses
import json

from commands import Gap, Outcome, Received, Sent, judge_commands, judge_obedience
from forwarding import Heard, judge_forwarding, judge_presence
from verdict import Arrival, Said, Trouble, judge


@dataclasses.dataclass
class Evidence:
    said: list[Said]  # the robots' record of their messages and acknowledgements
    received: list[Received]  # the robots' record: the commands that reached them
    messages: list[tuple]  # (at, topic, payload): all messages of the broker
    witnessed: list[Heard]  # most of them, with QoS and retain flag
    commands: list[Sent]
    troubles: list[Trouble]
    gaps: list[Gap]
    qos_of: dict[str, int]  # robot: the QoS of its messages
    robots_end: float  # when the robots were stopped
    until: float


def judge_run(evidence):
    """Returns (a Tally for each robot, complaints)."""
    tallies, complaints = judge(evidence.said, arrivals_in(evidence.messages), evidence.troubles)
    outcomes = outcomes_in(evidence.messages)
    complaints += judge_commands(evidence.commands, outcomes, evidence.gaps, evidence.until)
    complaints += judge_obedience(evidence.commands, outcomes, evidence.received, evidence.gaps)
    complaints += judge_forwarding(evidence.witnessed, evidence.qos_of)
    complaints += judge_presence(evidence.messages, evidence.said, evidence.troubles, evidence.gaps, evidence.robots_end)
    return tallies, complaints + silent_witness(evidence)


def silent_witness(evidence):
    """Returns a complaint for each robot whose messages the witness has not seen, because their QoS is unknown."""
    witnessed = {one.topic.split("/")[2] for one in evidence.witnessed}
    arrived = {one.robot for one in arrivals_in(evidence.messages)}
    return [f"{robot}: the witness has seen none of its messages, so their QoS is unknown" for robot in sorted(arrived - witnessed)]


def arrivals_in(messages):
    arrivals = []
    for at, topic, payload in messages:
        levels = topic.split("/")
        if levels[1] == "robot" and levels[3] == "update":
            arrivals.append(Arrival(levels[2], payload.hex(), at))
    return arrivals


def outcomes_in(messages):
    outcomes = []
    for at, topic, payload in messages:
        levels = topic.split("/")
        if levels[1] == "gateway" and levels[3] == "commands":
            said = json.loads(payload)
            outcomes.append(Outcome(levels[4], said["type"], said["outcome"], said["after_ms"], at))
    return outcomes
