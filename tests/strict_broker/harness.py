# SPDX-License-Identifier: Apache-2.0
"""For tests: the strict broker as a program, with its control interface, and a client that sends the octets of a test."""
import json
import pathlib
import socket
import subprocess
import time

from packets import Kind, encode_properties, encode_varint, number_field, octets_field, take_packet, text_field

HERE = pathlib.Path(__file__).parent
PATIENCE_S = 60  # only a failure uses this up


def wait_for(condition, what="a condition"):
    end = time.monotonic() + PATIENCE_S
    while not (result := condition()):
        if time.monotonic() > end:
            raise AssertionError(f"{what}: not within {PATIENCE_S} s")
        time.sleep(0.01)
    return result


class StrictBroker:
    def __init__(self, directory, *options):
        self.path, self.position, self.entries = pathlib.Path(directory) / "journal", 0, []
        self.process = subprocess.Popen(["setpriv", "--pdeathsig", "KILL", HERE / "strict_broker", "--journal", self.path, *options],
                                        stdout=subprocess.PIPE)
        ports = json.loads(self.process.stdout.readline())
        self.port = ports["mqtt"]
        with socket.create_connection(("127.0.0.1", ports["control"])) as control:
            self.control = control.makefile("rw")

    def order(self, do, **what):
        self.control.write(json.dumps({"do": do, **what}) + "\n")
        self.control.flush()
        answer = json.loads(self.control.readline())
        assert answer.pop("ok"), answer
        return answer

    def journal(self, event=None, **facts):
        """Returns the entries of this kind that have these facts."""
        with open(self.path, "rb") as file:
            file.seek(self.position)
            lines = file.read().rpartition(b"\n")[0]
        if lines:
            self.position += len(lines) + 1
            self.entries += map(json.loads, lines.splitlines())
        return [one for one in self.entries if event in (None, one["event"]) and
                all(one.get(name) == value for name, value in facts.items())]

    def end(self):
        self.control.close()
        self.process.kill()
        self.process.wait()
        self.process.stdout.close()


class Client:
    """Sends the octets of a test, and answers nothing by itself."""

    def __init__(self, port, version=5):
        self.version, self.buffer = version, bytearray()
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S)

    def send(self, first, body=b""):
        self.socket.sendall(bytes([first]) + encode_varint(len(body)) + body)

    def connect(self, client_id, clean=True, keep_alive=0, will=None, will_properties=None, **properties):
        """`will`: (topic, payload, QoS, retain). Returns (session present, reason) of the CONNACK."""
        flags, end = clean << 1, b""
        if will:
            topic, payload, qos, retain = will
            flags |= 4 | qos << 3 | retain << 5
            end = self.properties(will_properties or {}) + text_field(topic) + octets_field(payload)
        self.send(0x10, text_field("MQTT") + bytes([self.version, flags]) + number_field(keep_alive) + self.properties(properties) +
                  text_field(client_id) + end)
        _, body = self.expect(Kind.CONNACK)
        return bool(body[0]), body[1]

    def properties(self, properties):
        return encode_properties(properties) if self.version == 5 else b""

    def subscribe(self, *filters, packet_id=1, **properties):
        """`filters`: (filter, options) each. Returns the SUBACK's reasons."""
        self.send(0x82, number_field(packet_id) + self.properties(properties) +
                  b"".join(text_field(topic_filter) + bytes([options]) for topic_filter, options in filters))
        _, body = self.expect(Kind.SUBACK)
        return list(body[3 if self.version == 5 else 2:])

    def publish(self, topic, payload, qos=0, packet_id=0, dup=False, retain=False, **properties):
        self.send(0x30 | dup << 3 | qos << 1 | retain, text_field(topic) + (number_field(packet_id) if qos else b"") +
                  self.properties(properties) + payload)

    def acknowledge(self, kind, packet_id):
        self.send(kind << 4 | (2 if kind == Kind.PUBREL else 0), number_field(packet_id))

    def next(self):
        """Returns (first octet, body), or None when the broker has closed the connection."""
        while not (taken := take_packet(self.buffer)):
            try:
                octets = self.socket.recv(1 << 16)
            except ConnectionError:
                octets = b""
            if not octets:
                return None
            self.buffer += octets
        return taken

    def expect(self, kind):
        taken = self.next()
        assert taken and taken[0] >> 4 == kind, f"{taken} instead of {kind.name}"
        return taken

    def expect_acknowledgement(self, kind):
        """Returns (packet id, reason)."""
        _, body = self.expect(kind)
        return int.from_bytes(body[:2], "big"), body[2] if len(body) > 2 else 0

    def expect_publish(self):
        """Returns (topic, payload, QoS, packet id, DUP, retain, properties as octets)."""
        first, body = self.expect(Kind.PUBLISH)
        qos, size = first >> 1 & 3, int.from_bytes(body[:2], "big")
        topic, rest = body[2:2 + size].decode(), body[2 + size:]
        packet_id, rest = (int.from_bytes(rest[:2], "big"), rest[2:]) if qos else (0, rest)
        properties = b""
        if self.version == 5:
            properties, rest = rest[1:1 + rest[0]], rest[1 + rest[0]:]
        return topic, rest, qos, packet_id, bool(first & 8), bool(first & 1), properties

    def expect_end(self):
        """Returns the reason of the DISCONNECT before the end, if any."""
        taken = self.next()
        if taken is None:
            return None
        assert taken[0] == Kind.DISCONNECT << 4, taken
        assert self.next() is None
        return taken[1][0]

    def close(self):
        self.socket.close()
