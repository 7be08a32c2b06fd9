# SPDX-License-Identifier: Apache-2.0
"""One robot on the Thread mesh that walks between gateways: an MQTT-SN 1.2 client of its own, which shares no code with the
gateway. One request at a time, repeated until it is answered. Used by run."""
import random
import socket
import time

CONNECT, CONNACK, WILLTOPICREQ, WILLTOPIC, WILLMSGREQ, WILLMSG = 0x04, 0x05, 0x06, 0x07, 0x08, 0x09
REGISTER, REGACK, PUBLISH, PUBACK, SUBSCRIBE, SUBACK, DISCONNECT = 0x0A, 0x0B, 0x0C, 0x0D, 0x12, 0x13, 0x18
DUP, QOS1, RETAIN, WILL, CLEAN = 0x80, 0x20, 0x10, 0x08, 0x04
REPEAT_S, TRIES, PERIOD_S, KEEP_ALIVE_S = 0.7, 4, 0.25, 4


def packet(kind, body):
    return bytes([len(body) + 2, kind]) + body


class Robot:
    def __init__(self, name, prefix, gateways, is_clean, seed):
        self.name, self.prefix, self.gateways, self.is_clean = name, prefix, gateways, is_clean
        self.random = random.Random(seed)
        self.place = self.random.randrange(len(gateways))
        self.socket = None
        self.sent, self.acknowledged, self.repeated = {}, {}, set()  # by number: when
        self.commands = []  # (time, type, is_repeated)
        self.outages = []  # seconds from the first try to the acknowledgement
        self.number, self.msg_id, self.moves, self.refused_topics = 0, 0, 0, 0
        self.topic_id = 0
        self.has_session = False  # its topic ids and subscriptions are believed to stand at the gateway
        self.move_to(self.place)

    def move_to(self, place):
        self.place = place
        if self.socket:
            self.socket.close()
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setblocking(False)
        self.socket.connect(("127.0.0.1", self.gateways[place]))
        self.moves += 1
        self.connect()

    def connect(self):
        flags = WILL | (CLEAN if self.is_clean else 0)
        if self.is_clean:
            self.has_session = False
        self.ask("connect", packet(CONNECT, bytes([flags, 1]) + KEEP_ALIVE_S.to_bytes(2, "big") + self.name.encode()))

    def ask(self, step, request):
        self.step, self.request, self.tries, self.repeat_at = step, request, 0, 0.0
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
        self.next_at = time.monotonic() + self.random.uniform(0.5, 1.5) * PERIOD_S
        if self.number in self.sent and self.number not in self.acknowledged:
            self.say()  # what was not acknowledged is said again

    def say(self):
        body = self.topic_id.to_bytes(2, "big") + self.next_id() + str(self.number).encode()
        if self.number in self.sent:
            self.repeated.add(self.number)
        self.ask("publish", packet(PUBLISH, bytes([QOS1]) + body))

    def on_time(self, now):
        if self.step == "idle":
            if now >= self.next_at:
                self.number += 1
                self.say()
            return
        if now < self.repeat_at:
            return
        if self.tries == TRIES:  # nobody answers: another gateway
            others = [place for place in range(len(self.gateways)) if place != self.place]
            return self.move_to(self.random.choice(others))
        if self.step == "publish" and self.tries > 0:
            self.repeated.add(self.number)
            self.request = self.request[:2] + bytes([self.request[2] | DUP]) + self.request[3:]
        self.tries += 1
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
            self.commands.append((now, body[5:].decode(), bool(body[0] & DUP)))
            self.send(packet(PUBACK, body[1:5] + b"\0"))
        elif kind == PUBACK and self.step == "publish" and body[2:4] == self.request[5:7]:
            if body[4] == 0:
                self.acknowledged[self.number] = now
                self.outages.append(now - self.sent[self.number])
                self.next_step()
            elif body[4] == 2:  # it does not know the topic id: begin anew
                self.refused_topics += 1
                self.has_session = False
                self.connect()
        elif kind == DISCONNECT:
            self.connect()
