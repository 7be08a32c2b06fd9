# SPDX-License-Identifier: Apache-2.0
"""Observers on all nodes of a cluster, as one: a live one on each, and kept ones on some (streams explains both kinds). Two kept ones
are enough, because only one node fails at a time. Used by run."""
import functools
import operator

from observer import Observer
from streams import Stream, late_notes, messages_of, unobserved_s

MOST_UNCONFIRMED = 8


class Observers:
    def __init__(self, addresses, prefix, user, make_socket, name, kept, repeats_in_a_connection):
        self.prefix = prefix
        retry_s = 0.5 if len(addresses) > 1 else 0.01  # the only observer must reconnect before the gateways

        def make(address, client, stream):
            return Observer(address, prefix, client, user, make_socket, retry_s, stream)

        self.live = [make(address, f"{name}{i}", Stream(is_kept=False)) for i, address in enumerate(addresses)]
        self.all = self.live + [make(address, f"{name}-kept{i}", Stream(True, repeats_in_a_connection))
                                for i, address in enumerate(addresses[:kept])]

    def receive(self):
        for each in self.all:
            each.receive()

    def connected(self):
        return [each for each in self.all if each.socket]

    def are_subscribed(self):
        return all(each.is_subscribed for each in self.all)

    def publish(self, topic, payload, qos, key, random):
        """Publishes a message at a random node. Returns False if no node is ready."""
        able = [each for each in self.live if each.is_subscribed and len(each.unconfirmed) < MOST_UNCONFIRMED]
        if able:
            random.choice(able).publish(topic, payload, qos, key=key)
        return bool(able)

    def outcomes(self):
        """Returns by (robot, type) the approximate number of outcomes."""
        return functools.reduce(operator.or_, (each.outcomes for each in self.all))

    def confirmed(self):
        return set().union(*(each.confirmed for each in self.live))

    def retained(self, topic):
        """Returns the topic's retained message at each node."""
        return [each.retained.get(topic, b"") for each in self.live]

    def last(self, topic):
        """Returns the last published message on this topic of presence."""
        return max(each.last.get(topic, (0.0, b"")) for each in self.live)[1]

    def presence(self):
        return [each.presence for each in self.live]

    def streams(self):
        return [each.stream for each in self.all]

    def messages(self):
        return messages_of(self.streams())

    def arrived(self):
        """Returns (topic, payload) of all messages that any observer received."""
        return set().union(*(stream.arrived for stream in self.streams()))

    def late_notes(self):
        return late_notes(self.streams())

    def verdict(self):
        return {"sessions_lost": sum(len(stream.missed) for stream in self.streams()), "unobserved_s": unobserved_s(self.streams())}
