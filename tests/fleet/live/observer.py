# SPDX-License-Identifier: Apache-2.0
"""A client that subscribes to everything below the prefix and publishes commands. Used by observers."""
import json
import time
from collections import Counter

from client import ANSWER_S, Client
from streams import Stream


class Observer(Client):
    """An observer on one node, which reconnects. The broker keeps messages for a disconnected kept observer. A live one misses them."""

    def __init__(self, address, prefix, name, user, make_socket, retry_s, stream=None):
        self.stream = stream or Stream(is_kept=False)
        super().__init__(address, name, user, make_socket, is_clean=not self.stream.is_kept)
        self.prefix, self.retry_s = prefix, retry_s
        self.qos = 1 if self.stream.is_kept else 0
        self.retained, self.last = {}, {}  # since it is connected; last published presence, with its time
        self.presence = []  # (time, topic, payload, is_retained) from the node; without a topic for the end of a connection
        self.outcomes = Counter()  # by (robot, type), including repeats to a kept observer
        self.is_subscribed = False
        self.session_is_subscribed = False  # the session that the broker keeps

    def connect(self):
        self.is_subscribed, self.retained = False, {}
        super().connect()

    def end(self):
        if self.is_subscribed:
            now = time.monotonic()
            self.presence.append((now, None, None, False))
            self.stream.end_connection(now)
        self.is_subscribed = False
        super().end()

    def receive(self):
        if not self.socket and time.monotonic() - self.begun >= self.retry_s:
            self.connect()
        if self.socket:
            super().receive()
        if self.socket and not self.is_subscribed and time.monotonic() - self.begun > ANSWER_S:
            self.end()

    def on_connected(self):
        if self.has_session and self.session_is_subscribed:
            return self.begin(has_session=True)
        self.session_is_subscribed = False
        return self.subscribe(f"{self.prefix}/#", self.qos)

    def on_granted(self, qos):
        if qos != self.qos:
            return self.end()
        return self.begin(has_session=False)

    def begin(self, has_session):
        self.is_subscribed, self.session_is_subscribed = True, self.stream.is_kept
        self.stream.begin_connection(time.monotonic(), has_session)

    def on_message(self, topic, payload, is_retained, is_dup):
        self.retained[topic] = payload
        if "/robots/" in topic and "/gateway/" in topic:
            self.presence.append((time.monotonic(), topic, payload, is_retained))
            if not is_retained:
                self.last[topic] = time.monotonic(), payload
        if not is_retained:
            self.stream.add(time.monotonic(), topic, payload, is_dup)
        if "/commands/" in topic and not is_retained:
            self.outcomes[topic.split("/")[-1], json.loads(payload)["type"]] += 1
