# SPDX-License-Identifier: Apache-2.0
"""The attacks. Each returns a description of what it did, and raises Failure at a broken promise. fortress.py has the common bounds."""
import contextlib
import os
import re
import signal
import socket
import threading
import time
import tty

from fortress import PATIENCE_S, PREFIX, count_lines, resident
from program import Failure
from stranger import POISON, Stranger, connect_packet, packet

CONNACK, REGISTER, REGACK, PUBLISH, PUBACK, SUBSCRIBE, PINGREQ = 0x05, 0x0A, 0x0B, 0x0C, 0x0D, 0x12, 0x16
MOST_RETAINED = 4096  # topics that robots may retain, docs/security.md
RETAIN_QOS_1 = 0x30


def all_of(siege):
    return {name: getattr(siege, name) for name in (
        "crowd", "noise", "poison", "retainers", "refused", "control", "documents", "browsers", "board", "broker", "again")}


class Siege:
    def __init__(self, fortress, chance, divisor):
        self.fortress, self.chance, self.divisor = fortress, chance, divisor

    def share(self, count):
        return max(1, count // self.divisor)

    # ---- devices

    def crowd(self):
        """Takes every place from one address without answering. New robots must be served, also after a restart."""
        count = self.share(11000)
        with device(self.fortress, "127.0.0.3") as one:
            for n in range(count):
                send(one, connect_packet(f"crowd{n}"))
        self.fortress.serve_newcomer()
        self.fortress.restart_daemon()
        return f"{count} CONNECTs of one address, and a restart"

    def noise(self):
        """Sends random octets, and valid packets with some changed octets."""
        count = self.share(60000)
        good = [connect_packet("noise"), packet(REGISTER, b"\0\0\0\1" + b"ntnu-slam/robot/noise/x"), packet(PINGREQ, b"noise"),
                packet(PUBLISH, b"\x20\0\1\0\1" + b"x" * 20), packet(SUBSCRIBE, b"\x20\0\1" + b"ntnu-slam/server/noise/#")]
        with device(self.fortress, "127.0.0.4") as one:
            for _ in range(count):
                octets = bytearray(self.chance.choice(good)) if self.chance.random() < 0.7 else bytearray(
                    self.chance.randbytes(self.chance.randrange(0, 64)))
                for _ in range(self.chance.randrange(0, 4)):
                    if octets:
                        octets[self.chance.randrange(len(octets))] = self.chance.randrange(256)
                send(one, bytes(octets))
        return f"{count} datagrams"

    def poison(self):
        """Sends names for which brokers close the connection, as ids, topics and filters."""
        rounds = self.share(40)
        for _ in range(rounds):
            Stranger(self.fortress.mqttsn_port).send_poison(PREFIX)
        return f"{rounds} x {len(POISON)} names"

    def retainers(self):
        """Sends retained messages of many types under many names. The broker must keep no more than docs/security.md promises."""
        names, types = self.share(500), 30
        for n in range(names):
            with device(self.fortress, "127.0.0.5") as one:
                ask(one, connect_packet(f"keeper{n}"), CONNACK)
                for kind in range(1, types + 1):
                    topic = f"{PREFIX}/robot/keeper{n}/t{kind}".encode()
                    topic_id = ask(one, packet(REGISTER, b"\0\0\0\1" + topic), REGACK)[2:4]
                    ask(one, packet(PUBLISH, bytes([RETAIN_QOS_1]) + topic_id + b"\0\2keep me"), PUBACK)
        kept = self.fortress.status()["retained"]["topics"]
        if not 0 < kept <= MOST_RETAINED:
            raise Failure(f"robots retain {kept} topics; docs/security.md promises at most {MOST_RETAINED}")
        return f"{names} names with {types} types each, {kept} topics retained"

    def refused(self):
        """Sends messages that the broker refuses. They must not delay other robots."""
        rounds = self.share(400)
        self.fortress.refuse_topics_of("outlaw")
        with device(self.fortress, "127.0.0.6") as one:
            ask(one, connect_packet("outlaw"), CONNACK)
            topic_id = ask(one, packet(REGISTER, b"\0\0\0\1" + f"{PREFIX}/robot/outlaw/update".encode()), REGACK)[2:4]
            for n in range(rounds):
                send(one, packet(PUBLISH, b"\x20" + topic_id + (n + 2).to_bytes(2, "big") + b"\0\0\0\0"))
        self.fortress.wait_for_honest_robots()
        self.fortress.refuse_topics_of(None)
        return f"{rounds} messages that the broker refuses"

    # ---- programs on the host

    def control(self):
        """Attacks the control socket with random octets, endless lines and idle connections."""
        count = self.share(3000)
        path = str(self.fortress.directory / "gateway.sock")
        idle = [unix_connection(path) for _ in range(200)]
        inputs = [b'{"request":"status"}\n', b'{"request":"send","robot":"x"}\n', b"{" * 5000 + b"\n", b"[1,2\n", b"\xff\xfe\n",
                  b'{"request":{"request":1}}\n', b'"' + b"a" * 100000]
        for _ in range(count):
            with contextlib.suppress(OSError), unix_connection(path) or contextlib.nullcontext() as one:
                if one:
                    one.sendall(self.chance.choice(inputs) if self.chance.random() < 0.7
                                else self.chance.randbytes(self.chance.randrange(1, 300)))
        for one in idle:
            if one:
                one.close()
        self.fortress.wait_for("slam-gatewayctl status", lambda: self.fortress.ctl("status").returncode == 0)
        return f"{count} inputs beside 200 idle connections"

    # ---- the page

    def documents(self):
        """Publishes invalid documents under other gateways' topics. They must not change the metrics of the honest gateway."""
        hostile = ['{"broker":{"state":{"toString":1}}}', '{"state":{"a":[]},"mesh":7}', "[]", "null", "7", '"x"', "{", "",
                   '{"robots":"many","messages":[1,2]}', '{"state":"online","version":{"toString":"x"}}', "[" * 900,
                   '{"a":' * 400 + "1" + "}" * 400, '{"latency":{"p50":"NaN"},"robots":-1e999}']
        rounds = 0
        for document in hostile:
            for topic in ("gateway/x/stats", "gateway/x/numbers", "gateway/x/state", "gateway/x/robots/r", "gateway/x/hears"):
                if rounds % self.divisor == 0:
                    self.fortress.publish(topic, document, retain=True)
                rounds += 1
        for n in range(self.share(150)):
            self.fortress.publish(f"gateway/invented{n}/state", '{"state":"online"}', retain=True)
        status, metrics = self.fortress.get("/metrics", "127.2.0.1")
        if status != 200 or 'gateway="gateway"' not in metrics:
            raise Failure(f"the metrics of the honest gateway are missing (HTTP {status})")
        if re.search(r" (NaN|inf|-inf)$", metrics, re.IGNORECASE | re.MULTILINE):
            raise Failure("the metrics have a value that is not a finite number")
        return "documents of wrong types, invented gateways"

    def browsers(self):
        """Sends incomplete and invalid requests, and opens pages, from two addresses. Other addresses must get the page."""
        taken = []
        for n in range(self.share(400)):
            with contextlib.suppress(OSError):
                one = socket.create_connection(("127.0.0.1", self.fortress.web_port), 5, source_address=("127.0.0.7", 0))
                one.sendall(b"GET / HTTP/1.1\r\nHo" if n % 2 else web_socket_request())
                taken.append(one)
        for _ in range(self.share(300)):
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", self.fortress.web_port), 5,
                                                                        source_address=("127.0.0.8", 0)) as one:
                one.sendall(self.chance.choice([b"GET " + b"a" * 9000, b"\x16\x03\x01\x02\x00", b"POST /api HTTP/1.1\r\n\r\n",
                                                b"GET /../../etc/passwd HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
                                                self.chance.randbytes(200)]))
        status, _ = self.fortress.get("/", "127.2.0.2")
        if status != 200:
            raise Failure(f"the page answers {status} to another address")
        for one in taken:
            one.close()
        return f"{len(taken)} connections and {self.share(300)} bad requests"

    # ---- boards and brokers

    def board(self):
        """Sends random octets and frames with random content as a board, then plugs in the working board again."""
        board = self.fortress.robots[1]
        board.end(signal.SIGTERM)
        path = self.fortress.directory / "board"
        master, slave = os.openpty()
        tty.setraw(slave)
        with contextlib.suppress(FileNotFoundError):
            path.unlink()
        path.symlink_to(os.ttyname(slave))
        os.set_blocking(master, False)
        sent, end = 0, time.monotonic() + 200 / self.divisor
        while sent < self.share(1 << 20) and time.monotonic() < end:
            size = self.chance.randrange(1, 40)
            octets = bytes([size]) + self.chance.randbytes(size) if self.chance.random() < 0.5 else self.chance.randbytes(size)
            with contextlib.suppress(BlockingIOError):
                sent += os.write(master, octets)
            with contextlib.suppress(BlockingIOError):
                os.read(master, 4096)
        os.close(slave)
        os.close(master)
        path.unlink()
        board.start()
        return f"{sent >> 10} KiB from the board"

    def broker(self):
        """Connects further gateways and pages to hostile brokers. They must keep running, and end at SIGTERM."""
        ends = [self.meet(client, attack) for client in ("paho", "mosquitto") for attack in HOSTILE_BROKERS
                if client == "paho" or attack not in ENDS_LIBMOSQUITTO]
        return f"{len(ends)} hostile brokers; libmosquitto is not tried with: {', '.join(ENDS_LIBMOSQUITTO)}"

    def meet(self, client, attack):
        with HostileBroker(attack, self.chance) as hostile:
            path = self.fortress.write_configuration("other.json", hostile.port, client=client)
            programs = [self.fortress.program("slam-gatewayd", f"daemon-{client}-{attack}", "--config", path)]
            if attack not in ENDS_LIBMOSQUITTO:
                programs.append(self.fortress.program("slam-gateway-web", f"page-{client}-{attack}", "--config", path))
            for program in programs:
                program.start()
            self.fortress.wait_for(f"connections to a broker that sends {attack}", lambda: hostile.connections >= 2 * len(programs))
            for program in programs:
                name = f"{program.name}"
                if not program.is_running():
                    raise Failure(f"{name} has ended by itself: {program.tail()}")
                if resident(program) > 192 << 20:
                    raise Failure(f"{name} takes {resident(program) >> 20} MiB")
                if count_lines(program) > 220:
                    raise Failure(f"{name} has logged {count_lines(program)} lines")
                if program.end(signal.SIGTERM) != 0:
                    raise Failure(f"{name} did not shut down cleanly: {program.tail()}")

    def again(self):
        """Restarts the daemon after all attacks."""
        self.fortress.restart_daemon()
        return "a restart"


# ---- helpers

@contextlib.contextmanager
def device(fortress, address):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind((address, 0))
        one.connect(("127.0.0.1", fortress.mqttsn_port))
        yield one


def ask(one, octets, kind):
    """Returns the answer of this kind. Repeats the request, as MQTT-SN clients do."""
    one.settimeout(1)
    for _ in range(PATIENCE_S):
        with contextlib.suppress(OSError):
            one.send(octets)
            while True:
                answer = one.recv(2048)
                if answer[1] == kind:
                    return answer
    raise Failure(f"no answer {kind:#x} to a valid request")


def send(one, octets):
    """Sends a datagram. Pauses regularly, so that the kernel does not drop the attack."""
    with contextlib.suppress(OSError):
        one.send(octets)
    send.count += 1
    if send.count % 50 == 0:
        time.sleep(0.002)


send.count = 0


def unix_connection(path):
    one = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    one.settimeout(5)
    try:
        one.connect(path)
        return one
    except OSError:
        one.close()
        return None


def web_socket_request():
    return (b"GET /api HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n")


# Octets that a hostile broker sends after a client's CONNECT. CONNACK of MQTT 5: length, flags, reason, length of properties.
GOOD = bytes([0x20, 3, 0, 0, 0])
HOSTILE_BROKERS = {
    "nothing": lambda chance: b"",
    "noise": lambda chance: chance.randbytes(3000),
    "an unknown property": lambda chance: bytes([0x20, 6, 0, 0, 3, 0x7F, 1, 1]),
    "an endless length": lambda chance: GOOD + b"\x30\xff\xff\xff\x7f" + chance.randbytes(100000),
    "a length of five octets": lambda chance: GOOD + b"\x30\xff\xff\xff\xff\x7f",
    "a topic with invalid UTF-8": lambda chance: GOOD + bytes([0x30, 7, 0, 2, 0xC3, 0x28, 0, 1, 2]),
    "unexpected acknowledgements": lambda chance: GOOD + bytes([0x40, 2, 0, 9]) * 2000 + bytes([0x90, 4, 0, 9, 0, 0]) * 100,
    "a packet of MQTT 3.1.1": lambda chance: bytes([0x20, 2, 0, 0]),
    "packets of a client": lambda chance: GOOD + bytes([0x82, 6, 0, 1, 0, 0, 0, 0, 0xC0, 0, 0xE0, 0]),
}
# libmosquitto 2.0 ends its program at an unknown MQTT 5 property; systemd restarts the program (docs/broker.md).
ENDS_LIBMOSQUITTO = ("an unknown property", "noise")


class HostileBroker:
    """Accepts connections, sends the octets of its attack, and closes them a moment later."""

    def __init__(self, attack, chance):
        self.octets, self.chance, self.connections = HOSTILE_BROKERS[attack], chance, 0

    def __enter__(self):
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.port = self.listener.getsockname()[1]
        threading.Thread(target=self.accept, daemon=True).start()
        return self

    def __exit__(self, *_):
        self.listener.close()

    def accept(self):
        with contextlib.suppress(OSError):
            while True:
                client, _ = self.listener.accept()
                threading.Thread(target=self.serve, args=(client,), daemon=True).start()

    def serve(self, client):
        with client, contextlib.suppress(OSError):
            client.settimeout(5)
            client.recv(4096)
            self.connections += 1
            client.sendall(self.octets(self.chance))
            time.sleep(0.3)
