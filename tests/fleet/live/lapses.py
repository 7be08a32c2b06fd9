# SPDX-License-Identifier: Apache-2.0
"""When gateways have lost their lease, as far as they say so: each is asked once a second, over its control socket, and is not waited
for, because it may be stopped. Used by run."""
import contextlib
import json
import socket

from bounds import Lapse

LOOK_S = 1


class Gateway:
    def __init__(self, number, path):
        self.number, self.path = number, path
        self.connection, self.answer = None, bytearray()
        self.count, self.known_until = 0, 0.0

    def ask(self, now):
        self.end()
        self.connection, self.asked = socket.socket(socket.AF_UNIX), now
        self.connection.setblocking(False)
        try:
            self.connection.connect(str(self.path))
            self.connection.send(b'{"command": "status"}\n')
        except OSError:
            self.end()  # it is dead, and its count with it

    def end(self):
        if self.connection:
            self.connection.close()
        self.connection, self.answer = None, bytearray()

    def receive(self):
        """How often it has lost its lease; nothing while it has not answered."""
        with contextlib.suppress(OSError):
            while self.connection and (octets := self.connection.recv(1 << 16)):
                self.answer += octets
        if not self.answer.endswith(b"\n"):
            return None
        status = json.loads(self.answer)
        self.end()
        return status["result"]["fleet"]["lease_lapses"]


class Lapses:
    def __init__(self, sockets):
        self.gateways = [Gateway(i, path) for i, path in enumerate(sockets)]
        self.next_look, self.found = 0.0, []

    def step(self, now):
        for gateway in self.gateways:
            count = gateway.receive()
            if count is None:
                continue
            before = gateway.count if count >= gateway.count else 0  # it was started anew
            self.found += [Lapse(gateway.number, gateway.known_until, now)] * (count - before)
            gateway.count, gateway.known_until = count, gateway.asked
        if now >= self.next_look:
            self.next_look = now + LOOK_S
            for gateway in self.gateways:
                gateway.ask(now)
