# SPDX-License-Identifier: Apache-2.0
"""What observers were sent, each by itself, and what follows of them all: which messages came, how often, and in which order. Two
kinds of observers:

- live: QoS 0. The broker repeats nothing to it, so each copy is one that somebody has published, and comes at its time. It misses what
  is published while it is cut off.
- kept: QoS 1 in a session that the broker keeps. What is published while it is cut off comes later, and the broker repeats to it what
  it has not seen acknowledged.

So times, presence and order are those of live observers. Kept ones show what no live one was there for: that a message came, and how
often, but not when. Pure: lists in, lists out. Used by observer and judge."""
from collections import defaultdict
from typing import NamedTuple

FOREVER = float("inf")


class Copy(NamedTuple):
    """As one observer got it, on the connection with that number."""

    at: float
    topic: str
    payload: bytes
    connection: int = 0
    is_dup: bool = False


class Message(NamedTuple):
    """As it came to the fleet's observers. One that `is_late` came to kept observers only: it was published at any time before."""

    at: float
    topic: str
    payload: bytes
    is_late: bool = False


class Stream:
    """All that one observer was sent, in the order that it came."""

    def __init__(self, is_kept, repeats_in_a_connection=False):
        """`repeats_in_a_connection`: the broker does so when no acknowledgement comes for a while, and not only to one that is back."""
        self.is_kept, self.repeats_in_a_connection = is_kept, repeats_in_a_connection
        self.copies, self.arrived = [], set()
        self.connections = []  # [begin, end], from the moment that its subscription stands
        self.missed = []  # (begin, end) of what a kept one has missed for good: its session was lost

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
        """(begin, end) of each time of which it can know everything, in the end."""
        if not self.is_kept or not self.connections:
            return [tuple(each) for each in self.connections]
        begins = [self.connections[0][0], *(end for _, end in self.missed)]
        return list(zip(begins, [*(begin for begin, _ in self.missed), FOREVER]))

    def without_repetitions(self, copies):
        """`copies` of one message. A copy with DUP is a repetition by the broker if this observer has had the message on an earlier
        connection, or at all where the broker repeats within one. Otherwise it is the message itself, or a second one to which
        somebody else has given the flag: RabbitMQ before 3.12 passes on that of the publisher."""
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
    """A message has come as often as the live observer has seen it that saw it most often: others were cut off. If live observers were
    away, what is more than that came meanwhile: as often as each kept observer has it, for what one alone has more often was repeated to
    it (a broker whose node has died may do so without DUP)."""
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
    """Whether a live observer was there from the first copy of a message to the last one, at a node that was: of several nodes one at
    most is away at a time, so two observers are enough."""
    times = [copy.at for _, view in views for copy in view]
    were_there = [stream.was_connected(min(times), max(times)) for stream, _ in views if not stream.is_kept]
    return sum(were_there) >= min(2, len(were_there))


def kept_copies(views):
    """`views`: (kept observer, its copies of one message). Those agree that were connected all the time in which copies came; if there are
    none, all that have never lost their session. Without any, the message came once, if it came."""
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
    """(robot, number, copy) of each message of a Thread robot."""
    for copy in copies:
        levels = copy.topic.split("/")
        if levels[1] == "robot" and levels[3] == "note":
            yield levels[2], int(copy.payload), copy


def late_in(stream):
    """By (robot, number): the number before which it should have come, or None for one that came in order. Without repetitions, and
    without what came to a kept observer with DUP only: the first try lies where it belongs, and was lost."""
    newest, found = {}, {}
    for robot, number, copy in notes_of(stream.copies):
        if stream.is_kept and copy.is_dup:
            continue
        found.setdefault((robot, number), newest[robot] if number < newest.get(robot, 0) else None)
        newest[robot] = max(number, newest.get(robot, 0))
    return found


def late_notes(streams):
    """(robot, number, number before which it should have come): of messages of robots that came behind later ones at each live observer
    that saw them; at each kept one if no live one did. And how many are not judged, for they came with DUP only."""
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
    """For how long no observer was connected, and no session was kept that came back: of that time nothing is known."""
    total, known_until = 0.0, None
    for begin, end in sorted(each for stream in streams for each in stream.observed()):
        if known_until is not None:
            total += max(0.0, begin - known_until)
        known_until = max(end, known_until or end)
    return round(total, 3)
