# SPDX-License-Identifier: Apache-2.0
"""Checks that each command had exactly one outcome, also during faults, and that the robot got what the outcome states.
Pure: lists in, complaints out. Called by judge.

Robot and type identify a command. Most commands have a unique type. Those of type `cmd`, which robots obey, are far enough apart for
each robot that an outcome belongs to the last one before it.

No outcome is allowed in three cases. The broker, or the gateway's session there, died with the command (Gap). The daemon was killed
    when it arrived. No robot has that name and the gateway was away: no session at the broker keeps it.
Two outcomes are allowed in two cases. The connection to the broker ended, and the same message was published again. The daemon was
    killed with -9 in between, and repeats its last outcomes, perhaps with other numbers.
An outcome is late by its own account, or on arrival while nothing was broken.

The robots' record has each command that reached a robot, including repeats on the radio. `delivered` needs one that the robot got
before the outcome was published, even during faults. No robot may get a command that was not sent. A repeat on Thread has the message
id of the first. Under another id, or after the outcome, a command may reach its robot only if the connection or the daemon was lost
in between.
"""
import collections
import dataclasses

PATIENCE_S = 30  # docs/topics.md, promise 6
SLACK_S = 5  # a busy host; how long it takes to publish the outcome
MOMENT_S = 1.5  # a command that arrived this shortly before a kill may not be on disk
UNKNOWN_ROBOT = "nobody"  # commands to it must have an outcome, too
HURRY_S = 0.1  # between the clocks of the robots' record and of the subscriber


@dataclasses.dataclass
class Sent:
    robot: str
    kind: str
    at: float
    payload: str = ""  # hex


@dataclasses.dataclass
class Received:
    robot: str
    message_id: int  # MQTT-SN's; 0 on BLE
    kind: str  # on BLE "min_com" for every type but `cmd` and `run`
    payload: str  # hex
    at: float


@dataclasses.dataclass
class Outcome:
    robot: str
    kind: str
    result: str
    after_ms: int
    at: float


@dataclasses.dataclass
class Gap:
    """The time from a failure until the daemon was connected to the broker again."""
    begin: float
    end: float
    loses_queue: bool  # commands that wait at the broker are lost
    is_kill: bool = False  # of the daemon


def match(sent, outcomes):
    """Returns [(command, its outcomes)]."""
    by_name, ended = collections.defaultdict(list), collections.defaultdict(list)
    for one in sorted(sent, key=lambda one: one.at):
        by_name[one.robot, one.kind].append(one)
    for outcome in outcomes:
        # A command's time is taken after the broker has acknowledged it.
        before = [one for one in by_name[outcome.robot, outcome.kind] if one.at - SLACK_S <= outcome.at]
        if before:
            ended[id(before[-1])].append(outcome)
    return [(one, ended[id(one)]) for one in sent]


def judge_commands(sent, outcomes, gaps, until):
    """Returns complaints. A command that was sent less than the longest wait before `until` may still be under way."""
    complaints = []
    for one, ends in match(sent, outcomes):
        name = f"{one.robot}: the command {one.kind} sent at {one.at:.3f}"
        if not ends:
            is_open = one.at + PATIENCE_S + SLACK_S > until
            if not is_open and not may_be_lost(one, gaps):
                complaints.append(f"{name} has no outcome")
            continue
        complaints += [f"{name} took {end.after_ms} ms by its own account" for end in ends if end.after_ms > PATIENCE_S * 1000]
        first = ends[0]
        if first.at - one.at > PATIENCE_S + SLACK_S and not touched(one.at - MOMENT_S, first.at, gaps):
            complaints.append(f"{name} had its outcome only after {first.at - one.at:.1f} s")
        for again in ends[1:]:
            is_same = (again.result, again.after_ms) == (first.result, first.after_ms)
            reasons = gaps if is_same else [gap for gap in gaps if gap.is_kill]
            if not touched(one.at - MOMENT_S, again.at, reasons):
                complaints.append(f"{name} ended twice: {first.result} and {again.result}")
    return complaints


def touched(begin, end, gaps):
    return any(gap.begin <= end and gap.end >= begin for gap in gaps)


def may_be_lost(one, gaps):
    return any(gap.begin - MOMENT_S - (PATIENCE_S if gap.loses_queue else 0) <= one.at <= gap.end + MOMENT_S and
               (gap.loses_queue or one.robot == UNKNOWN_ROBOT or gap.is_kill and one.at <= gap.begin + MOMENT_S) for gap in gaps)


def read_received(lines):
    """Reads the commands from the file of `slam-gateway-sim --record`."""
    received = []
    for line in lines:
        if not line.endswith("\n"):  # still being written
            break
        what, robot, message_id, *rest = line.split()
        if what == "received":
            kind, payload, at = rest
            received.append(Received(robot, int(message_id), kind, "" if payload == "-" else payload, float(at)))
    return received


def judge_obedience(sent, outcomes, received, gaps):
    reached, complaints = reached_by(sent, received)
    for one, ends in match(sent, outcomes):
        copies = reached[id(one)]
        name = f"{one.robot}: the command {one.kind} sent at {one.at:.3f}"
        if any(end.result == "delivered" and not any(copy.at <= end.at + HURRY_S for copy in copies) for end in ends):
            complaints.append(f"{name} is reported as delivered but the robot never got it")
        for copy in copies:
            if touched(one.at - MOMENT_S, copy.at, gaps):
                continue
            if copy.message_id != copies[0].message_id:
                complaints.append(f"{name} reached the robot again under another message id at {copy.at:.3f}")
            elif ends and copy.at > ends[0].at + MOMENT_S:
                complaints.append(f"{name} reached the robot at {copy.at:.3f}, after {ends[0].result} was reported at {ends[0].at:.3f}")
    return complaints


def reached_by(sent, received):
    """Returns ({id of a command: the copies that reached its robot}, complaints). A copy belongs to the last equal command before it."""
    reached, complaints = collections.defaultdict(list), []
    by_name = collections.defaultdict(list)
    for one in sorted(sent, key=lambda one: one.at):
        by_name[one.robot, as_carried_out(one)].append(one)
    for copy in sorted(received, key=lambda copy: copy.at):
        equal = by_name[copy.robot, as_carried_out(copy)]
        before = [one for one in equal if one.at - SLACK_S <= copy.at]
        if before:
            reached[id(before[-1])].append(copy)
        else:
            complaints.append(f"{copy.robot}: got a command that was not sent: {copy.kind} {copy.payload} at {copy.at:.3f}")
    return reached, complaints


def as_carried_out(command):
    """Returns a form that is equal for a command as sent and as each mesh carries it."""
    if command.kind == "run":
        return "run", bytes.fromhex(command.payload) in (b"\1", b"1", b"on", b"start", b"unpause")
    return "cmd" if command.kind == "cmd" else "other", command.payload
