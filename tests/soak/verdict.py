# SPDX-License-Identifier: Apache-2.0
"""Compares robots' messages with the arrivals at the broker. Pure: lists in, numbers and complaints out. Called by run.

Robots' updates have no number on the wire, but the robots' record has one for each payload, and nearly every payload is sent
only once. So the payload of an arrival identifies its number. The few payloads that a robot sent more than once (it stood still)
are compared by count and not checked for order. Which of them are missing follows from the times of the others.

Missing: it arrived less often than it was acknowledged to the robot. Allowed only if the store was damaged after it was sent,
    up to the number that the daemon has reported as lost (Trouble.may_lose). At QoS 2 the gateway has it from its PUBREC on,
    but a robot's record has the time of the PUBCOMP.
Out of order: its first arrival is after a message that its robot sent later. Allowed only for messages that were sent before the
    end of a time in which the broker refused this robot (Trouble.refused).
Duplicate: it arrived more often than it was sent. Each needs a reason: a trouble that did not end before it was sent and began
    before the copy arrived. A trouble is a reason for a bounded number of duplicates (Trouble.may_repeat).
"""
import collections
import dataclasses


@dataclasses.dataclass
class Said:
    robot: str
    number: int
    payload: str  # hex, as it arrives at the broker
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
    may_repeat: int  # messages that can arrive twice because of it
    may_lose: int = 0  # messages that the daemon has reported as lost
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
    """Returns an update without the robots' stray octet (thesis 6.3), as `payload.update` does."""
    return payload[:-2] if len(payload) % 8 == 2 else payload


def read_record(lines):
    """Reads the file of `slam-gateway-sim --record`."""
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
    """Returns (a Tally for each robot, complaints). The troubles are in the order of their beginning."""
    said_by, arrived_by = collections.defaultdict(list), collections.defaultdict(list)
    for one in said:
        said_by[one.robot].append(one)
    for one in arrivals:
        arrived_by[one.robot].append(one)
    tallies, duplicates, missing, complaints = {}, [], [], []
    for robot in sorted(said_by.keys() | arrived_by.keys()):
        tallies[robot] = judge_robot(robot, said_by[robot], arrived_by[robot], troubles, duplicates, missing, complaints)
    for one in unexplained_losses(missing, troubles):
        complaints.append(f"{one.robot}: acknowledged and missing: number {one.number}, acknowledged at "
                          f"{one.acknowledged_at:.3f}: {one.payload}")
    for one in unexplained_duplicates(duplicates, troubles):
        complaints.append(f"{one.said.robot}: duplicate without a reason: number {one.said.number}, sent at "
                          f"{one.said.at:.3f}, again at {one.at:.3f}: {one.said.payload}")
    return tallies, complaints


def unexplained_duplicates(duplicates, troubles):
    """Returns the duplicates that no trouble explains. Each trouble explains up to `may_repeat`, in the order of their arrival."""
    left = sorted(duplicates, key=lambda one: one.at)
    for trouble in troubles:
        taken = [one for one in left if one.said.at < trouble.end and trouble.begin < one.at][:trouble.may_repeat]
        left = [one for one in left if one not in taken]
    return left


def unexplained_losses(missing, troubles):
    """Returns the missing messages that no trouble explains. Each explains up to `may_lose` that were sent before its end."""
    left = sorted(missing, key=lambda one: one.at)
    for trouble in troubles:
        taken = [one for one in left if one.at < trouble.end][:trouble.may_lose]
        left = [one for one in left if one not in taken]
    return left


def without_arrival(acknowledged, times):
    """Returns the equal updates that did not arrive. Each arrival counts for the last one that was sent before it."""
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
        complaints.append(f"{robot}: arrived but was never sent: {payload}")
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
