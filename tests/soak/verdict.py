# SPDX-License-Identifier: Apache-2.0
"""Compares what robots said with what arrived upstream. Pure: lists in, numbers and complaints out. Called by run.

Robots' updates have no number on the wire, but the robots' record has one for each payload, and nearly every payload is said
only once. So an arrival stands for the number that its robot said it under. The few payloads that a robot said more than once
(it stood still) are compared by count and not looked at for order; which of them are missing follows from when the others came.

Missing: acknowledged to the robot, but it arrived less often than it was acknowledged. Allowed only where the store was damaged
    after it was said, for as many as the daemon has told as lost (Trouble.may_lose). At QoS 2 the gateway has it from its PUBREC
    on, and a robot's record has the time of the PUBCOMP.
Out of order: it arrived first after something that its robot said later. Allowed only for what was said before the end of a time
    in which the broker refused this robot (Trouble.refused).
Duplicate: it arrived more often than it was said. Each needs a reason, a trouble that did not end before it was said and began
    before the copy arrived; and a trouble is a reason for a bounded number of them (Trouble.may_repeat).
"""
import collections
import dataclasses


@dataclasses.dataclass
class Said:
    robot: str
    number: int
    payload: str  # hex, as it goes up
    at: float
    acknowledged_at: float | None = None


@dataclasses.dataclass
class Arrival:
    robot: str
    payload: str  # hex
    at: float


@dataclasses.dataclass
class Trouble:
    begin: float
    end: float
    may_repeat: int  # messages that can arrive once more because of it
    may_lose: int = 0  # messages that it has destroyed, as the daemon has told
    refused: str = ""  # the robot whose messages the broker refused


@dataclasses.dataclass
class Duplicate:
    said: Said
    at: float


@dataclasses.dataclass
class Tally:
    said: int = 0
    acknowledged: int = 0
    arrived: int = 0
    missing: int = 0
    duplicates: int = 0
    out_of_order: int = 0

    def __add__(self, other):
        return Tally(*(a + b for a, b in zip(dataclasses.astuple(self), dataclasses.astuple(other))))


def canonical(payload):
    """What `payload.update` makes of an update: without the robots' stray octet (thesis 6.3)."""
    return payload[:-2] if len(payload) % 8 == 2 else payload


def read_record(lines):
    """What `slam-gateway-sim --record` writes."""
    said = {}
    for line in lines:
        if not line.endswith("\n"):  # still being written
            break
        what, robot, number, *rest = line.split()
        if what == "received":  # a command: commands.py
            continue
        if what == "sent":
            said[robot, number] = Said(robot, int(number), canonical(rest[0]), float(rest[1]))
        else:
            said[robot, number].acknowledged_at = float(rest[0])
    return list(said.values())


def judge(said, arrivals, troubles):
    """(a Tally for each robot, complaints). The troubles are in the order in which they began."""
    said_by, arrived_by = collections.defaultdict(list), collections.defaultdict(list)
    for one in said:
        said_by[one.robot].append(one)
    for one in arrivals:
        arrived_by[one.robot].append(one)
    tallies, duplicates, missing, complaints = {}, [], [], []
    for robot in sorted(said_by.keys() | arrived_by.keys()):
        tallies[robot] = judge_robot(robot, said_by[robot], arrived_by[robot], troubles, duplicates, missing, complaints)
    for one in not_told(missing, troubles):
        complaints.append(f"{one.robot}: acknowledged and missing: number {one.number}, acknowledged at "
                          f"{one.acknowledged_at:.3f}: {one.payload}")
    for one in without_reason(duplicates, troubles):
        complaints.append(f"{one.said.robot}: duplicate without a reason: number {one.said.number}, said at "
                          f"{one.said.at:.3f}, again at {one.at:.3f}: {one.said.payload}")
    return tallies, complaints


def without_reason(duplicates, troubles):
    """Each trouble takes as many as it may, those first that have the fewest troubles left to take them."""
    left = sorted(duplicates, key=lambda one: one.at)
    for trouble in troubles:
        taken = [one for one in left if one.said.at < trouble.end and trouble.begin < one.at][:trouble.may_repeat]
        left = [one for one in left if one not in taken]
    return left


def not_told(missing, troubles):
    """Each trouble takes as many as it may of those that were said before its end."""
    left = sorted(missing, key=lambda one: one.at)
    for trouble in troubles:
        taken = [one for one in left if one.at < trouble.end][:trouble.may_lose]
        left = [one for one in left if one not in taken]
    return left


def without_arrival(acknowledged, times):
    """Those of equal updates that did not arrive, when too few did: each arrival is taken for the last one said before it."""
    missing = list(acknowledged)
    for time in sorted(times, reverse=True):
        before = [one for one in missing if one.at <= time]
        if before:
            missing.remove(before[-1])
    return missing[:max(0, len(acknowledged) - len(times))]


def judge_robot(robot, said, arrivals, troubles, duplicates, missing, complaints):
    tally = Tally(said=len(said))
    said_as, arrived_as = collections.defaultdict(list), collections.defaultdict(list)
    for one in said:
        said_as[one.payload].append(one)
    for one in arrivals:
        arrived_as[one.payload].append(one.at)
    for payload in arrived_as.keys() - said_as.keys():
        complaints.append(f"{robot}: arrived but was never said: {payload}")
    for payload, ones in said_as.items():
        times = arrived_as[payload]
        acknowledged = [one for one in ones if one.acknowledged_at is not None]
        tally.acknowledged += len(acknowledged)
        tally.arrived += min(len(times), len(ones))
        lost = without_arrival(acknowledged, times)
        tally.missing += len(lost)
        missing += lost
        copies = [Duplicate(ones[0], at) for at in times[len(ones):]]
        tally.duplicates += len(copies)
        duplicates += copies
    refusals = [trouble for trouble in troubles if trouble.refused == robot]
    tally.out_of_order = count_out_of_order(robot, said_as, arrivals, refusals, complaints)
    return tally


def count_out_of_order(robot, said_as, arrivals, refusals, complaints):
    newest, late, seen = 0, 0, set()
    for arrival in arrivals:
        ones = said_as.get(arrival.payload, [])
        if len(ones) != 1 or arrival.payload in seen:
            continue
        seen.add(arrival.payload)
        is_allowed = any(ones[0].at < refusal.end and refusal.begin < arrival.at for refusal in refusals)
        if ones[0].number < newest and not is_allowed:
            late += 1
            complaints.append(f"{robot}: out of order: number {ones[0].number} after {newest}, at {arrival.at:.3f}")
        newest = max(newest, ones[0].number)
    return late
