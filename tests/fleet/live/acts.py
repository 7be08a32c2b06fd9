# SPDX-License-Identifier: Apache-2.0
"""Scenes of earlier faults on the running fleet, each with its own robots, which the judge watches like all others. An act is a
generator: it yields while it waits, and returns what is wrong, or None. Used by run."""
import json
import random
import re
import socket
import threading
import time

from client import Client
from commands import OUTCOME_S
from program import free_port
from robot import Robot

SOON_S = 10  # for events that happen at once on an idle machine
LISTENER_S = None
FLOOD_S = 4
CUTS = 6


def until(condition, most_s=SOON_S):
    """Waits for the condition. Returns its last value."""
    deadline = time.monotonic() + most_s
    while not (found := condition()) and time.monotonic() < deadline:
        yield
    return found


def pause(seconds):
    yield from until(lambda: False, seconds)


class Acts:
    def __init__(self, fleet):
        self.fleet = fleet
        self.running, self.results, self.failures = {}, {}, []
        self.clients, self.programs, self.cutter = [], [], None

    def start(self, wanted):
        plan = {"moves": [self.sleeper, self.hostile, self.dies], "contested": [self.contested]}
        if not self.fleet.options.netns:
            plan["lone"] = [self.lone]
        self.running = {name: self.play(scenes) for name, scenes in plan.items()} if wanted else {}

    def play(self, scenes):
        for scene in scenes:
            name = scene.__name__
            self.results[name] = "not ended"
            failure = yield from scene()
            self.results[name] = failure or "kept"
            if failure:
                self.failures.append((time.monotonic(), f"{name}: {failure}"))

    def step(self):
        for client in self.clients:
            if client.socket:
                client.receive()
        for name, act in list(self.running.items()):
            if next(act, self) is self:
                del self.running[name]

    def are_done(self):
        """Returns True when all acts have ended that faults would disturb."""
        return not self.running.keys() - {"lone"}

    def sockets(self):
        return [client for client in self.clients if client.socket]

    def end(self):
        for name in self.running:
            self.failures.append((time.monotonic(), f"{name}: has not ended"))
        for client in self.clients:
            client.end()

    def verdict(self):
        return self.results

    # --- Parts of acts ---

    def robot(self, name, place, is_clean=False, period_s=0.5):
        made = Robot(name, self.fleet.prefix, self.fleet.places, self.fleet.make_robot_socket, is_clean, period_s, 1, place=place)
        self.fleet.robots.append(made)
        return made

    def client(self, name, is_clean=True, user=None):
        made = Client(self.fleet.observers.live[0].address, name, self.fleet.engine.user, self.fleet.make_broker_socket, is_clean, user)
        self.clients.append(made)
        return made

    def command(self, robot, most_s=SOON_S):
        """Sends a command. Returns True if the robot obeys it in this time."""
        command = yield from self.send(robot)
        return (yield from until(lambda: robot.obeyed(command.kind), most_s))

    def command_after_a_move(self, robot):
        """Sends a command, and another one if the first is lost: it may be, while the session moves (bounds, 1)."""
        return (yield from self.command(robot)) or (yield from self.command(robot))

    def send(self, robot):
        return (yield from until(lambda: self.fleet.commands.send(time.monotonic(), robot.name)))

    # --- The acts ---

    def sleeper(self):
        """A command for a sleeping robot follows it to the gateway at which it wakes."""
        robot = self.robot("sleep0", 0)
        if not (yield from until(robot.is_served)):
            return "no session"
        yield from until(lambda: robot.step == "idle")
        robot.sleep(60)
        if not (yield from until(lambda: robot.step == "asleep")):
            return "its gateway did not let it sleep"
        yield from pause(0.5)
        command = yield from self.send(robot)
        yield from pause(1)
        if robot.obeyed(command.kind):
            return "it got a command while it slept"
        robot.move_to(1)
        if not (yield from until(lambda: robot.obeyed(command.kind))):
            return "it did not get the command at the other gateway"
        return None if (yield from self.command(robot)) else "it gets no command where it woke"

    def dies(self):
        """A robot with a kept session that only listens gets its commands at another gateway when its own dies, and at its own again
        later."""
        robot = self.robot("dying0", 0, period_s=LISTENER_S)
        robot.others = [1]
        if not (yield from until(robot.is_served)):
            return "no session"
        if not (yield from self.command(robot)):
            return "it gets no command"
        self.fleet.trouble.kill(self.fleet.daemons[0], "gateway", 0, time.monotonic())
        yield from until(lambda: robot.place == 1 and robot.is_served())
        was_heard = yield from self.command_after_a_move(robot)
        self.fleet.trouble.bring_back()
        yield from pause(3)
        if not was_heard:
            return "it gets no command at the other gateway"
        if not (yield from self.command(robot)):
            return "it gets no command at the other gateway since its own is back"
        robot.move_to(0)
        yield from until(robot.is_served)
        return None if (yield from self.command_after_a_move(robot)) else "it gets no command back at its own gateway"

    def contested(self):
        """A client with a robot's client id takes over its session. The gateway takes it back when the robot talks, and reports it."""
        robot = self.robot("taken0", 2)
        if not (yield from until(robot.is_served)):
            return "no session"
        thief = self.client(f"{self.fleet.prefix.replace('/', '-')}-robot-taken0", is_clean=False, user="gateways")
        said = f"{self.fleet.prefix}/gateway/gw-2/robots/taken0"
        for _ in range(3):
            thief.connect()
            if not (yield from until(lambda: thief.is_connected)):
                return "the broker does not let the other client in"
            if not (yield from until(lambda: not thief.socket)):
                return "the gateway has not taken its session back"
            yield from pause(self.fleet.engine.move_pause_s)
        if not (yield from until(lambda: any(b'"contested":true' in each for each in self.fleet.observers.retained(said)))):
            return "presence does not report contested"
        return None if (yield from self.command(robot, OUTCOME_S)) else "it gets no command afterwards"

    def hostile(self):
        """A client with write access below fleet/ and gateway/ can neither stop nor command robots by what it says as other gateways."""
        fleet, stranger = f"{self.fleet.prefix}/fleet", self.client("stranger")
        stranger.connect()
        if not (yield from until(lambda: stranger.is_connected)):
            return "the broker does not let the other client in"
        planted = self.plant(stranger, fleet)
        yield from until(lambda: not stranger.unconfirmed)
        victims = [self.robot("plant0", 1), self.robot("plant1", 1), self.robot("plant2", 2, is_clean=True)]
        if not (yield from until(lambda: all(victim.is_served() for victim in victims))):
            return "a robot with planted messages gets no session"
        numbers = [len(victim.acknowledged) for victim in victims]
        end, failure, flooded = time.monotonic() + FLOOD_S, None, {}
        while time.monotonic() < end and not failure:
            flooded = self.flood(stranger, fleet, victims)
            yield from pause(0.2)
            for victim in victims:
                if not (yield from self.command(victim)):
                    failure = f"{victim.name} gets no command"
        if not failure and any(len(victim.acknowledged) <= before for victim, before in zip(victims, numbers)):
            failure = "a robot's messages were not acknowledged"
        for topic in [*planted, *flooded]:
            stranger.publish(topic, b"", retain=True)
        yield from until(lambda: not stranger.unconfirmed)
        stranger.end()
        return failure

    def flood(self, stranger, fleet, victims):
        """Publishes once on all topics that gateways read of others: what two invented gateways say, one of them nonsense. Returns the topics
        of both."""
        root, now = f"{self.fleet.prefix}/gateway", time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
        asleep = json.dumps({"state": "asleep", "mesh": "thread", "since": now}).encode()
        online = json.dumps({"state": "online", "version": "0", "since": now, "connected": str(time.monotonic())}).encode()
        said = {}
        for robot in self.fleet.robots[:8] + victims:
            said |= {f"{root}/stranger/robots/{robot.name}": asleep, f"{root}/odd/robots/{robot.name}": b"[" * 1000}
        said |= {f"{root}/stranger/state": online, f"{root}/odd/state": b"[" * 100000}
        hears = {f"{fleet}/all/odd": b"[" * 100000, f"{fleet}/all/gw-0": b'{"up":true,"rows":[["plant0",-1,1]]}'}
        notes = {f"{fleet}/robots/{victim.name}{tail}": random.randbytes(300) for victim in victims for tail in ("", "/waiting")}
        for topic, payload in {**said, **hears, **notes}.items():
            stranger.publish(topic, payload, qos=0)
        return said

    def plant(self, stranger, fleet):
        """Publishes invalid messages, and gateways' messages about another robot, with the victims' names. All names are equally long."""
        note, waiting = [next(iter(filter(None, self.fleet.observers.retained(f"{fleet}/robots/sleep0{tail}"))), b"")
                         for tail in ("", "/waiting")]
        seen = [waiting] if waiting else [b'{"topic":"%s/server/plant1/c","payload":"YQ==","qos":1}' % self.fleet.prefix.encode()]
        planted = {f"{fleet}/robots/plant0": random.randbytes(300), f"{fleet}/robots/plant0/waiting": b"[" * 1000,
                   f"{fleet}/robots/plant1": note.replace(b"sleep0", b"plant1") or b"{}",
                   f"{fleet}/robots/plant1/waiting": seen[0].replace(b"sleep0", b"plant1"),
                   f"{fleet}/robots/plant2": b"{" * 100000}
        for topic, payload in planted.items():
            stranger.publish(topic, payload, retain=True)
        return planted

    def lone(self):
        """The connections of a single gateway break just after it has connected and a command has arrived. Each command has its outcome in
        time."""
        broker = self.fleet.observers.live[0].address
        self.cutter, port = Cutter(broker), free_port(socket.SOCK_DGRAM)
        daemon = self.fleet.make_lone_daemon(self.cutter.port, port)
        self.programs.append(daemon)
        daemon.start()
        listener, reported = self.client("lone-observer"), []
        listener.connect()
        yield from until(lambda: listener.is_connected)
        listener.subscribe("lone/gateway/#", 0)
        robot = Robot("solo", "lone", [("127.0.0.1", port)], lambda kind: socket.socket(socket.AF_INET, kind), False, 0.3, 1)
        self.fleet.lone_robots.append(robot)
        if not (yield from until(lambda: b'"online"' in dict(listener.heard).get("lone/gateway/lone/state", b"") and robot.is_served(), 60)):
            return "no session"
        listener.on_message = lambda topic, payload, *_: topic.endswith("/commands/solo") and reported.append((payload, self.cutter.cuts))
        chance, said = random.Random(self.fleet.options.seed), {}

        def outcomes(kind):
            return [(payload, cuts) for payload, cuts in reported if json.loads(payload)["type"] == kind]

        def is_taken(kind):
            return robot.obeyed(kind) or outcomes(kind)

        for number in range(CUTS):
            connections = self.cutter.accepted
            if not (yield from until(lambda: self.cutter.cut(is_taken), OUTCOME_S)):
                return f"commands without an outcome: {[kind for kind in said if not is_taken(kind)]}"
            yield from until(lambda before=connections: self.cutter.accepted > before)
            yield from pause(chance.uniform(0, 0.3))
            said[f"c{number}"] = self.cutter.cuts
            listener.publish(f"lone/server/solo/c{number}", f"c{number}".encode())
            yield from pause(chance.uniform(0, 0.3))
        yield from until(lambda: self.cutter.cut(is_taken), OUTCOME_S)
        yield from until(lambda: all(outcomes(kind) for kind in said), OUTCOME_S)
        missing = {kind for kind in said if not outcomes(kind)}
        doubled = {kind for kind, before in said.items() if robot.obeyed(kind) > 1 or has_second_outcome(outcomes(kind), before)}
        robot.end()
        daemon.end(15)
        return (f"no outcome: {sorted(missing)}; " if missing else "") + (f"doubled: {sorted(doubled)}" if doubled else "") or None


def has_second_outcome(outcomes, cuts_before):
    """Returns True if the copies, (payload, cuts before it came), are of more than one outcome. A cut that loses a PUBACK repeats one."""
    said, cuts = {payload for payload, _ in outcomes}, [cuts for _, cuts in outcomes]
    return len(said) > 1 or bool(cuts) and len(cuts) > 1 + max(cuts) - cuts_before


class Cutter:
    """A proxy before a broker that can break all connections at once."""

    def __init__(self, broker):
        self.broker, self.accepted, self.cuts, self.open, self.passed = broker, 0, 0, [], []
        self.lock = threading.Lock()
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.port = self.listener.getsockname()[1]
        threading.Thread(target=self.accept, daemon=True).start()

    def accept(self):
        while True:
            client, _ = self.listener.accept()
            broker = socket.create_connection(self.broker)
            from_broker = bytearray()
            with self.lock:
                self.open += [client, broker]
                self.passed.append(from_broker)
                self.accepted += 1
            for source, sink, passed in ((client, broker, bytearray()), (broker, client, from_broker)):
                source.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                threading.Thread(target=self.pump, args=(source, sink, passed), daemon=True).start()

    def pump(self, source, sink, passed):
        try:
            while octets := source.recv(1 << 16):
                with self.lock:
                    passed += octets
                    sink.sendall(octets)
        except OSError:
            pass
        for each in (source, sink):
            self.end(each)

    def cut(self, is_taken):
        """Breaks all connections. Returns False while a command at the gateway is not taken, because a command within a round trip before
        a cut may have no outcome. `is_taken`: by the command's type. The gateway's own connection also gets commands, at QoS 0."""
        with self.lock:
            come = {kind.decode() for octets in self.passed for kind in re.findall(rb"/server/solo/(c\d)(?!c)", octets)}
            if not all(map(is_taken, come)):
                return False
            for each in self.open:
                self.end(each)
            self.open, self.cuts = [], self.cuts + 1
        return True

    @staticmethod
    def end(one):
        try:
            one.shutdown(socket.SHUT_RDWR)
        except OSError:
            pass
