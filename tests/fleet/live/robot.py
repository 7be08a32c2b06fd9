# SPDX-License-Identifier: Apache-2.0
"""One robot on the Thread mesh that roams between gateways: an independent MQTT-SN 1.2 client, which shares no code with the gateway.
One request at a time, repeated until it is answered. It records the commands that it obeys. Used by run and acts."""
import random
import socket
import time

CONNECT, CONNACK, WILLTOPICREQ, WILLTOPIC, WILLMSGREQ, WILLMSG = 0x04, 0x05, 0x06, 0x07, 0x08, 0x09
REGISTER, REGACK, PUBLISH, PUBACK, PUBCOMP, PUBREC, PUBREL = 0x0A, 0x0B, 0x0C, 0x0D, 0x0E, 0x0F, 0x10
SUBSCRIBE, SUBACK, PINGREQ, PINGRESP, DISCONNECT = 0x12, 0x13, 0x16, 0x17, 0x18
DUP, QOS2, QOS1, WILL, CLEAN = 0x80, 0x40, 0x20, 0x08, 0x04
REPEAT_S, TRIES, KEEP_ALIVE_S = 0.7, 4, 4
PING_S = 1  # of a robot that only listens
SAME_S = 30  # a gateway may repeat a command for this time


def packet(kind, body):
    return bytes([len(body) + 2, kind]) + body


class Robot:
    def __init__(self, name, prefix, gateways, make_socket, is_clean, period_s, seed, qos=1, place=None):
        """`period_s`: None for a robot that only listens, and pings its gateway."""
        self.name, self.prefix, self.gateways, self.is_clean, self.period_s = name, prefix, gateways, is_clean, period_s
        self.make_socket, self.qos, self.flags = make_socket, qos, QOS2 if qos == 2 else QOS1
        self.random = random.Random(seed)
        self.place = self.random.randrange(len(gateways)) if place is None else place
        self.places = []  # (since when, gateway)
        self.others = None  # gateways that it tries when its own does not answer; None: any
        self.socket = None
        self.sent, self.acknowledged = {}, {}  # by number: when
        self.tries = {}  # by number: (when, gateway, moves before) of each transmission
        self.acknowledged_by = {}  # by number: which gateway
        self.commands = []  # (time, gateway, payload) of each that it has obeyed
        self.heard = {}  # by (gateway, message id): payload and time of the last command
        # (seconds, [(time, gateway, what it asked)]) of each move and of each message that was not acknowledged at the first try
        self.interruptions, self.asked = [], []
        self.waits_since, self.is_interrupted = None, False
        self.number, self.msg_id, self.moves, self.refused_topics = 0, 0, 0, 0
        self.topic_id = 0
        self.ended = float("inf")
        self.has_session = False  # it expects its topic ids and subscriptions at the gateway
        self.bare = []  # [from, to] of each time without a subscription: from its CONNECT to its SUBACK
        self.move_to(self.place)

    def fileno(self):
        return self.socket.fileno()

    def acknowledged_messages(self):
        """Returns (topic, payload) of each acknowledged message."""
        return {(f"{self.prefix}/robot/{self.name}/note", str(number).encode()) for number in self.acknowledged}

    def place_at(self, when):
        return [place for since, place in self.places if since <= when][-1]

    def places_between(self, begin, end):
        """Returns each gateway that it was at."""
        return {self.place_at(begin if self.places[0][0] <= begin else end), self.place_at(end),
                *(place for since, place in self.places if begin <= since <= end)}

    def obeyed(self, payload):
        return sum(1 for _, _, each in self.commands if each == payload)

    def is_served(self):
        return self.has_session and self.step in ("idle", "publish", "release", "ping")

    def wait(self):
        if self.waits_since is None:
            self.waits_since = time.monotonic()

    def end_wait(self):
        """Ends the wait for service: the robot is served, or the run ends."""
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
        if self.is_clean:
            self.has_session = False
        if not self.bare or self.is_clean and self.bare[-1][1] != float("inf"):
            self.bare.append([time.monotonic(), float("inf")])
        flags = WILL | (CLEAN if self.is_clean else 0)
        self.ask("connect", packet(CONNECT, bytes([flags, 1]) + KEEP_ALIVE_S.to_bytes(2, "big") + self.name.encode()))

    def sleep(self, seconds):
        """Falls asleep: its gateway keeps messages until it connects again."""
        self.ask("sleep", packet(DISCONNECT, seconds.to_bytes(2, "big")))

    def ask(self, step, request):
        self.step, self.request, self.attempt, self.repeat_at = step, request, 0, 0.0
        self.asked.append((round(time.monotonic(), 3), f"gw{self.place}", step))
        if step == "publish" and self.number not in self.sent:
            self.sent[self.number] = time.monotonic()

    def next_id(self):
        self.msg_id = self.msg_id % 65535 + 1
        return self.msg_id.to_bytes(2, "big")

    def next_step(self):
        """Subscribes and registers if the session needs it, then continues with messages."""
        root = f"{self.prefix}/server/{self.name}/+".encode()
        if not self.has_session and self.step == "connect":
            return self.ask("subscribe", packet(SUBSCRIBE, bytes([self.flags]) + self.next_id() + root))
        if not self.has_session and self.step == "subscribe":
            topic = f"{self.prefix}/robot/{self.name}/note".encode()
            return self.ask("register", packet(REGISTER, b"\0\0" + self.next_id() + topic))
        self.has_session = True
        self.step, self.request = "idle", None
        self.next_at = time.monotonic() + (self.random.uniform(0.5, 1.5) * self.period_s if self.period_s else PING_S)
        if self.number in self.sent and self.number not in self.acknowledged:
            return self.say()  # repeats the unacknowledged message
        return self.end_wait()

    def say(self):
        self.wait()
        body = self.topic_id.to_bytes(2, "big") + self.next_id() + str(self.number).encode()
        self.ask("publish", packet(PUBLISH, bytes([self.flags]) + body))

    def on_time(self, now):
        if self.step == "asleep" or self.step == "idle" and now < self.next_at:
            return
        if self.step == "idle" and not self.period_s:
            return self.ask("ping", packet(PINGREQ, b""))
        if self.step == "idle":
            self.number += 1
            return self.say()
        if now < self.repeat_at:
            return
        if self.attempt == TRIES:  # no answer: tries another gateway
            others = self.others or [place for place in range(len(self.gateways)) if place != self.place] or [self.place]
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
            pass  # the gateway is down; repetitions will show it

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
            self.bare[-1][1] = min(now, self.bare[-1][1])
            self.next_step()
        elif kind == REGACK and self.step == "register" and body[-1] == 0:
            self.topic_id = int.from_bytes(body[:2], "big")
            self.next_step()
        elif kind == REGISTER:
            self.send(packet(REGACK, body[:4] + b"\0"))
        elif kind == PUBLISH:
            self.on_command(body, now)
        elif kind == PUBREL:
            self.heard.pop((self.place, body), None)
            self.send(packet(PUBCOMP, body))
        elif kind == PUBACK and self.step == "publish" and body[2:4] == self.request[5:7]:
            if body[4] == 0:
                self.on_acknowledged(now)
                self.next_step()
            elif body[4] == 2:  # unknown topic id: starts a new session
                self.refused_topics += 1
                self.has_session = False
                self.connect()
        elif kind == PUBREC and self.step == "publish" and body == self.request[5:7]:
            self.on_acknowledged(now)
            self.ask("release", packet(PUBREL, body))
        elif kind == PUBCOMP and self.step == "release" and body == self.request[2:] or kind == PINGRESP and self.step == "ping":
            self.next_step()
        elif kind == DISCONNECT and self.step == "sleep":
            self.step = "asleep"
        elif kind == DISCONNECT:
            self.connect()

    def on_acknowledged(self, now):
        """Records an acknowledgement. At QoS 2 PUBREC counts: the rest of the exchange only releases the id."""
        self.acknowledged[self.number], self.acknowledged_by[self.number] = now, self.place

    def on_command(self, body, now):
        """Obeys and acknowledges a command. A gateway repeats with DUP; a restarted one reuses message ids."""
        key, payload = (self.place, body[3:5]), body[5:].decode()
        if not (body[0] & DUP and key in self.heard and self.heard[key][0] == payload and now - self.heard[key][1] < SAME_S):
            self.commands.append((now, self.place, payload))
        self.heard[key] = payload, now
        self.send(packet(PUBREC, body[3:5]) if body[0] & QOS2 else packet(PUBACK, body[1:5] + b"\0"))

    def end(self):
        """Stops the robot. An open wait counts up to now."""
        self.end_wait()
        self.ended = time.monotonic()
