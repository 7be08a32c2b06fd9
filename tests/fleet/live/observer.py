# SPDX-License-Identifier: Apache-2.0
"""A small MQTT 3.1.1 client that hears everything below the prefix and publishes commands, and several of them, one on each
node of a cluster, as one. Used by run."""
import socket
import time
from collections import Counter, defaultdict

ANSWER_S = 10
CONNACK, PUBLISH, PUBACK, SUBACK = 2, 3, 4, 9


def text(value):
    return len(value.encode()).to_bytes(2, "big") + value.encode()


def frame(kind, body):
    size, length = bytearray(), len(body)
    while True:
        size.append(length % 128 | (0x80 if length > 127 else 0))
        length //= 128
        if not length:
            return bytes([kind]) + bytes(size) + body


class Observer:
    """On one node. It connects again when that breaks; what came meanwhile it has missed."""

    def __init__(self, address, prefix, name, user, make_socket, retry_s):
        self.address, self.prefix, self.name, self.user, self.make_socket = address, prefix, name, user, make_socket
        self.retry_s = retry_s
        self.messages, self.retained = [], {}
        self.presence = []  # (time, topic, payload): what the node says, and (time, None, None) when it does not say
        self.socket, self.begun = None, 0.0
        self.confirmed, self.unconfirmed, self.msg_id = set(), {}, 0
        self.is_subscribed = False

    def connect(self):
        self.socket, self.buffer, self.begun = self.make_socket(socket.SOCK_STREAM), bytearray(), time.monotonic()
        self.unconfirmed, self.is_subscribed, self.retained = {}, False, {}
        self.socket.settimeout(0.5)
        self.socket.connect(self.address)
        flags, login = (0xC2, text(self.user) + text("any")) if self.user else (0x02, b"")
        self.socket.sendall(frame(0x10, text("MQTT") + bytes([4, flags, 0, 0]) + text(self.name) + login))
        self.socket.setblocking(False)

    def fileno(self):
        return self.socket.fileno()

    def end(self):
        if self.socket:
            self.socket.close()
        if self.is_subscribed:
            self.presence.append((time.monotonic(), None, None))
        self.socket, self.is_subscribed = None, False

    def publish(self, topic, payload, key):
        """`key` is in `confirmed` as soon as the broker has it."""
        self.msg_id = self.msg_id % 65535 + 1
        self.unconfirmed[self.msg_id] = key
        self.write(frame(0x32, text(topic) + self.msg_id.to_bytes(2, "big") + payload.encode()))

    def write(self, octets):
        try:
            self.socket.settimeout(0.5)
            self.socket.sendall(octets)
            self.socket.setblocking(False)
        except OSError:
            self.end()

    def receive(self):
        """To be called again and again."""
        try:
            if not self.socket:
                if time.monotonic() - self.begun < self.retry_s:
                    return
                self.connect()
            while octets := self.socket.recv(1 << 16):
                self.buffer += octets
            self.end()
            return
        except BlockingIOError:
            pass
        except OSError:
            self.end()
            return
        while self.socket and self.take():
            pass
        if self.socket and not self.is_subscribed and time.monotonic() - self.begun > ANSWER_S:
            self.end()

    def take(self):
        length, shift, at = 0, 0, 1
        while True:
            if at >= len(self.buffer):
                return False
            length |= (self.buffer[at] & 127) << shift
            shift, at = shift + 7, at + 1
            if self.buffer[at - 1] < 128:
                break
        if len(self.buffer) < at + length:
            return False
        kind, body = self.buffer[0], bytes(self.buffer[at:at + length])
        del self.buffer[:at + length]
        self.on_packet(kind, body)
        return True

    def on_packet(self, kind, body):
        if kind >> 4 == CONNACK:
            if body[1] != 0:
                return self.end()
            self.write(frame(0x82, b"\x00\x01" + text(f"{self.prefix}/#") + b"\x00"))
        elif kind >> 4 == SUBACK:
            if body[2] >= 0x80:
                return self.end()
            self.is_subscribed = True
        elif kind >> 4 == PUBACK:
            self.confirmed.add(self.unconfirmed.pop(int.from_bytes(body[:2], "big"), None))
        elif kind >> 4 == PUBLISH:
            size = int.from_bytes(body[:2], "big")
            topic, payload = body[2:2 + size].decode(), body[2 + size:]
            self.retained[topic] = payload
            if "/robots/" in topic:
                self.presence.append((time.monotonic(), topic, payload))
            if not kind & 1:
                self.messages.append((time.monotonic(), topic, payload))


class Observers:
    """A message has come as often as the observer has seen it that saw it most often: others were cut off."""

    def __init__(self, addresses, prefix, user, make_socket, name="observer"):
        self.prefix = prefix
        retry_s = 0.5 if len(addresses) > 1 else 0.01  # the only one must be there before the gateways are
        self.all = [Observer(address, prefix, f"{name}{i}", user(f"{name}{i}") if user else None, make_socket, retry_s)
                    for i, address in enumerate(addresses)]

    def receive(self):
        for each in self.all:
            each.receive()

    def connected(self):
        return [each for each in self.all if each.socket]

    def are_subscribed(self):
        return all(each.is_subscribed for each in self.all)

    def publish(self, topic, payload, key, random):
        """False when no node takes anything just now."""
        able = [each for each in self.all if each.is_subscribed and not each.unconfirmed]
        if able:
            random.choice(able).publish(topic, payload, key)
        return bool(able)

    def confirmed(self):
        return set().union(*(each.confirmed for each in self.all))

    def retained(self, topic):
        """What the nodes say it is."""
        return [each.retained.get(topic, b"") for each in self.all]

    def presence(self):
        return [each.presence for each in self.all]

    def messages(self):
        counts = [Counter(message[1:] for message in each.messages) for each in self.all]
        best = {}
        for i, count in enumerate(counts):
            for key, number in count.items():
                if number > best.get(key, (0, 0))[0]:
                    best[key] = (number, i)
        return sorted(message for i, each in enumerate(self.all) for message in each.messages if best[message[1:]][1] == i)

    def notes(self):
        return {key for each in self.all for key in self.notes_at(each)}

    def late_notes(self):
        """(robot, number, number before which it should have come): of messages of robots that came behind later ones at each
        observer that saw them."""
        late = [dict(self.late_at(each)) for each in self.all]
        seen = defaultdict(set)
        for i, each in enumerate(self.all):
            for robot, number in self.notes_at(each):
                seen[robot, number].add(i)
        return [(*key, max(late[i][key] for i in places)) for key, places in seen.items()
                if all(key in late[i] for i in places)]

    @staticmethod
    def notes_at(observer):
        for _, topic, payload in observer.messages:
            levels = topic.split("/")
            if levels[1] == "robot" and levels[3] == "note":
                yield levels[2], int(payload)

    def late_at(self, observer):
        newest, seen = {}, set()
        for key in self.notes_at(observer):
            robot, number = key
            if key not in seen and number < newest.get(robot, 0):
                yield key, newest[robot]
            seen.add(key)
            newest[robot] = max(number, newest.get(robot, 0))
