# SPDX-License-Identifier: Apache-2.0
"""Whether each command had its one outcome, also while everything was broken, and whether the robot got what the outcome says.
Pure: lists in, complaints out. Called by judge.

A command is told apart by its robot and its type: most have a type of their own, and those of the type `cmd`, which robots obey, go
to one robot so far apart that an outcome belongs to the last one before it.

None: the broker, or the gateway's session there, died with it (Gap), or the daemon was killed in the moment when it came, or no
    robot has that name and the gateway was away: nothing at the broker waits for a name that nobody has.
Twice: the connection to the broker ended, so that the same message was published again; or a kill -9 in between, after which the
    daemon tells again what it was told in its last moment, with other numbers perhaps. Else two outcomes are a broken promise.
Late: by its own account, or on arrival while nothing was broken.

The robots' record tells each command that reached a robot, repeats on the radio too. `delivered` needs one that the robot had before
that was told, whatever was broken. No robot gets what nobody sent. A repeat on Thread has the message id of the first; under another
id, or after the outcome was told, a command reaches its robot only when the connection or the daemon was lost in between.
"""
import collections
import dataclasses

PATIENCE_S = 30  # docs/topics.md, promise 6
SLACK_S = 5  # a busy host; how long it takes to publish the outcome
MOMENT_S = 1.5  # a command that came so short before a kill need not be on disk
NOBODY = "nobody"  # a name that no robot has; commands to it have an outcome too
HURRY_S = 0.1  # the robots' record and the subscriber are two processes


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
    """From the moment when something died to when the daemon was at the broker again."""
    begin: float
    end: float
    loses_queue: bool  # commands that wait at the broker are gone
    is_kill: bool = False  # of the daemon


def match(sent, outcomes):
    """[(command, its outcomes)]"""
    by_name, ended = collections.defaultdict(list), collections.defaultdict(list)
    for one in sorted(sent, key=lambda one: one.at):
        by_name[one.robot, one.kind].append(one)
    for outcome in outcomes:
        # The clock that a command is stamped with is read when the broker has acknowledged it.
        before = [one for one in by_name[outcome.robot, outcome.kind] if one.at - SLACK_S <= outcome.at]
        if before:
            ended[id(before[-1])].append(outcome)
    return [(one, ended[id(one)]) for one in sent]


def judge_commands(sent, outcomes, gaps, until):
    """Those that were sent less than the longest wait before `until` may still be under way."""
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
            complaints.append(f"{name} had its outcome after {first.at - one.at:.1f} s only")
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
               (gap.loses_queue or one.robot == NOBODY or gap.is_kill and one.at <= gap.begin + MOMENT_S) for gap in gaps)


def read_received(lines):
    """Of what `slam-gateway-sim --record` writes, the commands."""
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
            complaints.append(f"{name} is told as delivered but the robot never got it")
        for copy in copies:
            if touched(one.at - MOMENT_S, copy.at, gaps):
                continue
            if copy.message_id != copies[0].message_id:
                complaints.append(f"{name} reached the robot again under another message id at {copy.at:.3f}")
            elif ends and copy.at > ends[0].at + MOMENT_S:
                complaints.append(f"{name} reached the robot at {copy.at:.3f}, after {ends[0].result} was told at {ends[0].at:.3f}")
    return complaints


def reached_by(sent, received):
    """({id of a command: what reached its robot}, complaints). A copy belongs to the last command before it that is equal."""
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
            complaints.append(f"{copy.robot}: got a command that nobody sent: {copy.kind} {copy.payload} at {copy.at:.3f}")
    return reached, complaints


def as_carried_out(command):
    """The same for a command as it was sent and as either mesh carries it."""
    if command.kind == "run":
        return "run", bytes.fromhex(command.payload) in (b"\1", b"1", b"on", b"start", b"unpause")
    return "cmd" if command.kind == "cmd" else "other", command.payload
