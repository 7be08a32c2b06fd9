# SPDX-License-Identifier: Apache-2.0
"""The messages to each observer, and the conclusion from all of them: which messages arrived, how often, and in which order. Two kinds
of observers:

- live: QoS 0. The broker repeats nothing to it, so each copy was published separately, and arrives at its time. It misses messages
  while it is cut off.
- kept: QoS 1 in a session that the broker keeps. Messages from while it was cut off arrive later, and the broker repeats
  unacknowledged messages to it.

So times, presence and order are those of live observers. While no live observer is connected, kept ones show that a message arrived
and how often, but not when. Pure: lists in, lists out. Used by observer and judge."""
from collections import defaultdict
from typing import NamedTuple

FOREVER = float("inf")


class Copy(NamedTuple):
    """A message as one observer got it, with the number of its connection."""

    at: float
    topic: str
    payload: bytes
    connection: int = 0
    is_dup: bool = False


class Message(NamedTuple):
    """A message as all observers together got it. If `is_late`, only kept observers got it: it was published at any time before."""

    at: float
    topic: str
    payload: bytes
    is_late: bool = False


class Stream:
    """All messages to one observer in their order."""

    def __init__(self, is_kept, repeats_in_a_connection=False):
        """`repeats_in_a_connection`: the broker repeats unacknowledged messages after a while, and not only to a client that reconnects."""
        self.is_kept, self.repeats_in_a_connection = is_kept, repeats_in_a_connection
        self.copies, self.arrived = [], set()
        self.connections = []  # [begin, end], from SUBACK on
        self.missed = []  # (begin, end) of times that a kept one has missed, because its session was lost

    def begin_connection(self, now, has_session):
        if self.is_kept and self.connections and not has_session:
            self.missed.append((self.connections[-1][1], now))
        self.connections.append([now, FOREVER])

    def end_connection(self, now):
        self.connections[-1][1] = now

    def add(self, at, topic, payload, is_dup=False):
        self.arrived.add((topic, payload))
        self.copies.append(Copy(at, topic, payload, len(self.connections), is_dup))

    def was_connected(self, begin, end):
        return any(since <= begin and end <= until for since, until in self.connections)

    def observed(self):
        """Returns (begin, end) of each time of which it gets all messages in the end."""
        if not self.is_kept or not self.connections:
            return [tuple(each) for each in self.connections]
        begins = [self.connections[0][0], *(end for _, end in self.missed)]
        return list(zip(begins, [*(begin for begin, _ in self.missed), FOREVER]))

    def without_repetitions(self, copies):
        """Returns the copies of one message without the broker's repetitions. A copy with DUP is a repetition if this observer got
        the message on an earlier connection. If the broker repeats within a connection, any former copy is enough. Otherwise it is
        the message itself, or a second one whose DUP is the publisher's: RabbitMQ before 3.12 passes that flag on."""
        own = []
        for copy in copies:
            is_repetition = copy.is_dup and any(self.repeats_in_a_connection or one.connection < copy.connection for one in own)
            if not (self.is_kept and is_repetition):
                own.append(copy)
        return own


def by_message(stream):
    copies = defaultdict(list)
    for copy in stream.copies:
        copies[copy.topic, copy.payload].append(copy)
    return copies


def messages_of(streams):
    """Returns the messages of all observers. A message came as often as the live observer with most copies has seen it, because others were
    cut off. If live observers were cut off, further copies count as often as all kept observers have them. A copy at one kept observer
    alone was repeated to it (a broker whose node has died may repeat without DUP)."""
    copies = [(stream, by_message(stream)) for stream in streams]
    found = []
    for key in set().union(*(each for _, each in copies)):
        views = [(stream, each.get(key, [])) for stream, each in copies]
        live = max((view for stream, view in views if not stream.is_kept), key=len, default=[])
        found += [Message(copy.at, *key) for copy in live]
        if not (live and could_see(views)):
            late = kept_copies([view for view in views if view[0].is_kept])
            found += [Message(copy.at, *key, True) for copy in late[len(live):]]
    return sorted(found)


def could_see(views):
    """Returns True if live observers were connected from the first to the last copy of a message. Only one of several nodes fails at a
    time, so two observers are enough."""
    times = [copy.at for _, view in views for copy in view]
    were_there = [stream.was_connected(min(times), max(times)) for stream, _ in views if not stream.is_kept]
    return sum(were_there) >= min(2, len(were_there))


def kept_copies(views):
    """Returns the copies of a message on which the kept observers agree. Observers that were connected while copies came count; if there
    are none, those that never lost their session; otherwise one copy. `views`: (kept observer, its copies of one message)."""
    own = [(stream, stream.without_repetitions(copies)) for stream, copies in views]
    times = [copy.at for _, copies in own for copy in copies]
    if not times:
        return []
    whole = [(stream, copies) for stream, copies in own if not stream.missed]
    throughout = [copies for stream, copies in whole if stream.was_connected(min(times), max(times))]
    agreed = min((len(copies) for copies in throughout or [copies for _, copies in whole]), default=1)
    most = max((copies for _, copies in own), key=len)
    return most[:max(1, agreed)]


def notes_of(copies):
    """Yields (robot, number, copy) of each message of a Thread robot."""
    for copy in copies:
        levels = copy.topic.split("/")
        if levels[1] == "robot" and levels[3] == "note":
            yield levels[2], int(copy.payload), copy


def late_in(stream):
    """Returns by (robot, number) the number before which it should have come; None for one in order. Leaves out repetitions, and messages
    that a kept observer got only with DUP: the first try was in order, and was lost."""
    newest, found = {}, {}
    for robot, number, copy in notes_of(stream.copies):
        if stream.is_kept and copy.is_dup:
            continue
        found.setdefault((robot, number), newest[robot] if number < newest.get(robot, 0) else None)
        newest[robot] = max(number, newest.get(robot, 0))
    return found


def late_notes(streams):
    """Returns (robot, number, number before which it should have come) of late messages. A message is late if it came behind later
    ones at each live observer with it. If no live observer has it, the kept ones decide. Also returns how many are not judged,
    because they came only with DUP."""
    live = [late_in(stream) for stream in streams if not stream.is_kept]
    kept = [late_in(stream) for stream in streams if stream.is_kept]
    seen = {(robot, number) for stream in streams for robot, number, _ in notes_of(stream.copies)}
    late, unjudged = [], 0
    for key in sorted(seen):
        views = [each[key] for each in live if key in each] or [each[key] for each in kept if key in each]
        unjudged += not views
        if views and None not in views:
            late.append((*key, max(views)))
    return late, unjudged


def unobserved_s(streams):
    """Returns for how long no observer was connected and no session was kept. Messages from that time are unknown."""
    total, known_until = 0.0, None
    for begin, end in sorted(each for stream in streams for each in stream.observed()):
        if known_until is not None:
            total += max(0.0, begin - known_until)
        known_until = max(end, known_until or end)
    return round(total, 3)
