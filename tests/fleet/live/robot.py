# SPDX-License-Identifier: Apache-2.0
"""One robot on the Thread mesh that walks between gateways: an MQTT-SN 1.2 client of its own, which shares no code with the
gateway. One request at a time, repeated until it is answered. Used by run."""
import random
import socket
import time

CONNECT, CONNACK, WILLTOPICREQ, WILLTOPIC, WILLMSGREQ, WILLMSG = 0x04, 0x05, 0x06, 0x07, 0x08, 0x09
REGISTER, REGACK, PUBLISH, PUBACK, SUBSCRIBE, SUBACK, DISCONNECT = 0x0A, 0x0B, 0x0C, 0x0D, 0x12, 0x13, 0x18
DUP, QOS1, RETAIN, WILL, CLEAN = 0x80, 0x20, 0x10, 0x08, 0x04
REPEAT_S, TRIES, KEEP_ALIVE_S = 0.7, 4, 4


def packet(kind, body):
    return bytes([len(body) + 2, kind]) + body


class Robot:
    def __init__(self, name, prefix, gateways, make_socket, is_clean, period_s, seed):
        self.name, self.prefix, self.gateways, self.is_clean, self.period_s = name, prefix, gateways, is_clean, period_s
        self.make_socket = make_socket
        self.random = random.Random(seed)
        self.place = self.random.randrange(len(gateways))
        self.places = []  # (since when, gateway)
        self.socket = None
        self.sent, self.acknowledged = {}, {}  # by number: when
        self.tries = {}  # by number: (when, gateway, moves before) of each time that it was said
        self.acknowledged_by = {}  # by number: which gateway
        self.commands = []  # (time, gateway, type) of each that is not the repetition of one
        self.heard = {}  # by (gateway, message id): the last command's type
        # (seconds, [(time, gateway, what it asked)]) of each move and of each message that was not acknowledged at the first try
        self.interruptions, self.asked = [], []
        self.waits_since, self.is_interrupted = None, False
        self.number, self.msg_id, self.moves, self.refused_topics = 0, 0, 0, 0
        self.topic_id = 0
        self.ended = float("inf")
        self.has_session = False  # its topic ids and subscriptions are believed to stand at the gateway
        self.move_to(self.place)

    def fileno(self):
        return self.socket.fileno()

    def acknowledged_messages(self):
        """(topic, payload) of each."""
        return {(f"{self.prefix}/robot/{self.name}/note", str(number).encode()) for number in self.acknowledged}

    def place_at(self, when):
        return [place for since, place in self.places if since <= when][-1]

    def places_between(self, begin, end):
        """Each gateway that it was at."""
        return {self.place_at(begin if self.places[0][0] <= begin else end), self.place_at(end),
                *(place for since, place in self.places if begin <= since <= end)}

    def wait(self):
        if self.waits_since is None:
            self.waits_since = time.monotonic()

    def end_wait(self):
        """It is served, or nothing more is asked of it."""
        if self.is_interrupted and self.waits_since is not None:
            self.interruptions.append((time.monotonic() - self.waits_since, self.asked))
        self.waits_since, self.is_interrupted, self.asked = None, False, []

    def move_to(self, place):
        self.place = place
        self.places.append((time.monotonic(), place))
        if self.socket:
            self.socket.close()
        self.socket = self.make_socket(socket.SOCK_DGRAM)
        self.socket.setblocking(False)
        self.socket.connect(self.gateways[place])
        self.moves += 1
        self.connect()

    def connect(self):
        self.wait()
        self.is_interrupted = True
        flags = WILL | (CLEAN if self.is_clean else 0)
        if self.is_clean:
            self.has_session = False
        self.ask("connect", packet(CONNECT, bytes([flags, 1]) + KEEP_ALIVE_S.to_bytes(2, "big") + self.name.encode()))

    def ask(self, step, request):
        self.step, self.request, self.attempt, self.repeat_at = step, request, 0, 0.0
        self.asked.append((round(time.monotonic(), 3), f"gw{self.place}", step))
        if step == "publish" and self.number not in self.sent:
            self.sent[self.number] = time.monotonic()

    def next_id(self):
        self.msg_id = self.msg_id % 65535 + 1
        return self.msg_id.to_bytes(2, "big")

    def next_step(self):
        """After CONNACK: what the session lacks, then messages."""
        root = f"{self.prefix}/server/{self.name}/+".encode()
        if not self.has_session and self.step == "connect":
            return self.ask("subscribe", packet(SUBSCRIBE, bytes([QOS1]) + self.next_id() + root))
        if not self.has_session and self.step == "subscribe":
            topic = f"{self.prefix}/robot/{self.name}/note".encode()
            return self.ask("register", packet(REGISTER, b"\0\0" + self.next_id() + topic))
        self.has_session = True
        self.step, self.request = "idle", None
        self.next_at = time.monotonic() + self.random.uniform(0.5, 1.5) * self.period_s
        if self.number in self.sent and self.number not in self.acknowledged:
            return self.say()  # what was not acknowledged is said again
        self.end_wait()

    def say(self):
        self.wait()
        body = self.topic_id.to_bytes(2, "big") + self.next_id() + str(self.number).encode()
        self.ask("publish", packet(PUBLISH, bytes([QOS1]) + body))

    def on_time(self, now):
        if self.step == "idle":
            if now >= self.next_at:
                self.number += 1
                self.say()
            return
        if now < self.repeat_at:
            return
        if self.attempt == TRIES:  # nobody answers: another gateway
            others = [place for place in range(len(self.gateways)) if place != self.place]
            return self.move_to(self.random.choice(others))
        if self.step == "publish" and self.attempt > 0:
            self.is_interrupted = True
            self.request = self.request[:2] + bytes([self.request[2] | DUP]) + self.request[3:]
        self.attempt += 1
        if self.step == "publish":
            self.tries.setdefault(self.number, []).append((now, self.place, self.moves))
        self.repeat_at = now + REPEAT_S
        self.send(self.request)

    def send(self, octets):
        try:
            self.socket.send(octets)
        except OSError:
            pass  # the gateway is dead; the repetition shows it

    def receive(self, now):
        while True:
            try:
                octets = self.socket.recv(2048)
            except OSError:
                return
            offset = 3 if octets[0] == 1 else 1
            self.on_packet(octets[offset], octets[offset + 1:], now)

    def on_packet(self, kind, body, now):
        if kind == CONNACK and self.step == "connect" and body[0] == 0:
            self.next_step()
        elif kind == WILLTOPICREQ:
            self.send(packet(WILLTOPIC, bytes([QOS1]) + f"{self.prefix}/robot/{self.name}/gone".encode()))
        elif kind == WILLMSGREQ:
            self.send(packet(WILLMSG, b"will"))
        elif kind == SUBACK and self.step == "subscribe" and body[-1] == 0:
            self.next_step()
        elif kind == REGACK and self.step == "register" and body[-1] == 0:
            self.topic_id = int.from_bytes(body[:2], "big")
            self.next_step()
        elif kind == REGISTER:
            self.send(packet(REGACK, body[:4] + b"\0"))
        elif kind == PUBLISH:
            self.on_command(body, now)
            self.send(packet(PUBACK, body[1:5] + b"\0"))
        elif kind == PUBACK and self.step == "publish" and body[2:4] == self.request[5:7]:
            if body[4] == 0:
                self.acknowledged[self.number], self.acknowledged_by[self.number] = now, self.place
                self.next_step()
            elif body[4] == 2:  # it does not know the topic id: begin anew
                self.refused_topics += 1
                self.has_session = False
                self.connect()
        elif kind == DISCONNECT:
            self.connect()

    def on_command(self, body, now):
        key, kind = (self.place, body[3:5]), body[5:].decode()
        if not (body[0] & DUP and self.heard.get(key) == kind):
            self.commands.append((now, self.place, kind))
        self.heard[key] = kind

    def end(self):
        """Whoever still waits has waited for so long at least. It says nothing more."""
        self.end_wait()
        self.ended = time.monotonic()
