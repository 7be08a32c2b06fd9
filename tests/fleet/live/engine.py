# SPDX-License-Identifier: Apache-2.0
"""The brokers that the gateways of a run use: one Mosquitto or RabbitMQ, or a cluster of three nodes of NATS or ejabberd, from
Debian's packages. Used by run."""
import os
import shutil
import socket
import sys
import time
import urllib.request

from bounds import SETTLE_S
from program import Program, free_port

NODES = 3


class Engine:
    """One node: `ports[0]`. Where a node is reached is `host`, the same for all."""

    user = None  # (name of a client -> user name); None: clients need none
    subscribed_s = 1  # what it needs for the subscriptions of a gateway that connects
    settle_s = SETTLE_S  # after a node has come back, connections that it has harmed have ended
    keeps_retained_for_itself = False  # each node: what another one took is retained there only
    may_nodes_differ = False  # in what they retain, for good, once a node was away
    sends_retained_to_wildcards = True
    repeats_in_a_connection = False  # what a client has not acknowledged for a while; others repeat it to one that is back

    def __init__(self, directory, host, prefix=(), count=1):
        self.directory, self.host, self.prefix = directory, host, list(prefix)
        self.ports = [free_port(socket.SOCK_STREAM) for _ in range(count)]
        self.nodes = [self.make_node(i) for i in range(count)]

    def program(self, name, arguments):
        return Program(self.directory, name, self.prefix + list(arguments))

    def start(self):
        for node in self.nodes:
            node.start()

    def programs(self):
        return self.nodes

    def is_well(self, i):
        """Whether the node serves clients, and the cluster can do without another one."""
        return self.nodes[i].is_running()


class Mosquitto(Engine):
    def make_node(self, i):
        path = self.directory / "mosquitto.conf"
        path.write_text(f"listener {self.ports[i]} {self.host}\nallow_anonymous true\nset_tcp_nodelay true\n"
                        "max_queued_messages 0\nuser root\n")
        return self.program("broker", ["mosquitto", "-c", path])


class Nats(Engine):
    subscribed_s = 10  # 6 s were seen
    settle_s = SETTLE_S + 4  # so long it waits for a stream before it closes the connection of who published
    may_nodes_differ = True
    repeats_in_a_connection = True  # after 30 s

    def __init__(self, directory, host, prefix=()):
        self.routes = [free_port(socket.SOCK_STREAM) for _ in range(NODES)]
        self.watched = [free_port(socket.SOCK_STREAM) for _ in range(NODES)]
        super().__init__(directory, host, prefix, NODES)

    def make_node(self, i):
        path = self.directory / f"nats{i}.conf"
        urls = ", ".join(f'"nats://127.0.0.1:{route}"' for route in self.routes)
        path.write_text(f'server_name: n{i}\nlisten: "127.0.0.1:{free_port(socket.SOCK_STREAM)}"\n'
                        f'http: "{self.host}:{self.watched[i]}"\n'
                        f'jetstream {{store_dir: "{self.directory}/nats{i}"}}\n'
                        f'mqtt {{host: "{self.host}", port: {self.ports[i]}}}\n'
                        f'cluster {{name: c1, listen: "127.0.0.1:{self.routes[i]}", routes: [{urls}]}}\n')
        return self.program(f"nats{i}", ["nats-server", "-c", path])

    def is_well(self, i):
        """Its streams and consumers are where those of the others are."""
        try:
            with urllib.request.urlopen(f"http://{self.host}:{self.watched[i]}/healthz", timeout=0.3) as answer:
                return answer.status == 200
        except OSError:
            return False


class Erlang(Engine):
    """Its nodes find each other by a port mapper of their own, so that none is left behind. They start slowly: on a busy machine in more
    than a minute."""

    def __init__(self, directory, host, prefix=(), count=1):
        self.environment = {"ERL_EPMD_PORT": free_port(socket.SOCK_STREAM), "ERL_EPMD_ADDRESS": "127.0.0.1", "HOME": directory,
                            "ERL_LIBS": f"/usr/lib/{os.uname().machine}-linux-gnu"}
        super().__init__(directory, host, prefix, count)
        self.mapper = self.program("epmd", self.with_environment(["epmd", "-port", self.environment["ERL_EPMD_PORT"],
                                                                  "-address", "127.0.0.1"]))

    def with_environment(self, arguments, **more):
        return ["env", *(f"{key}={value}" for key, value in {**self.environment, **more}.items()), *map(str, arguments)]

    def start(self):
        self.mapper.start()
        super().start()
        while not all(self.has_started(i) for i in range(len(self.nodes))):
            for node in self.programs():
                if not node.is_running():
                    raise OSError(f"{node.name} does not start: {node.tail()}")
            time.sleep(0.2)

    def programs(self):
        return self.nodes + [self.mapper]


class RabbitMq(Erlang):
    """MQTT 3.1.1; one node, because a queue of QoS 1 is lost with its node."""

    sends_retained_to_wildcards = False

    def __init__(self, directory, host, prefix=()):
        if not shutil.which("rabbitmq-server"):
            sys.exit("--engine rabbitmq needs Debian's package: apt-get install --no-install-recommends rabbitmq-server")
        super().__init__(directory, host, prefix)

    def make_node(self, i):
        path = self.directory / "rabbitmq.conf"
        path.write_text(f"mqtt.listeners.tcp.1 = {self.host}:{self.ports[i]}\nmqtt.allow_anonymous = true\nloopback_users = none\n"
                        "listeners.tcp = none\n")
        plugins = self.directory / "rabbitmq.plugins"
        plugins.write_text("[rabbitmq_mqtt].\n")
        return self.program("rabbitmq", self.with_environment(
            ["/usr/lib/rabbitmq/bin/rabbitmq-server"], RABBITMQ_NODENAME="r@localhost", RABBITMQ_CONFIG_FILE=path.with_suffix(""),
            RABBITMQ_ENABLED_PLUGINS_FILE=plugins, RABBITMQ_MNESIA_BASE=self.directory / "rabbitmq",
            RABBITMQ_LOG_BASE=self.directory, RABBITMQ_PID_FILE=self.directory / "rabbitmq.pid",
            RABBITMQ_DIST_PORT=free_port(socket.SOCK_STREAM), RABBITMQ_SERVER_ADDITIONAL_ERL_ARGS="-start_epmd false"))

    def has_started(self, i):
        return "Starting broker... completed" in self.nodes[i].log.read_text()


class Ejabberd(Erlang):
    """MQTT 5. Clients need a user name that is an address of the host, and any password."""

    user = staticmethod("{}@localhost".format)
    keeps_retained_for_itself = True

    def __init__(self, directory, host, prefix=()):
        if not shutil.which("ejabberdctl"):
            sys.exit("--engine ejabberd needs Debian's package: apt-get install --no-install-recommends ejabberd")
        super().__init__(directory, host, prefix, NODES)

    def make_node(self, i):
        path = self.directory / f"ejabberd{i}.yml"
        path.write_text("hosts: [localhost]\nloglevel: warning\nauth_method: [anonymous]\nanonymous_protocol: both\n"
                        "allow_multiple_connections: true\nmodules:\n  mod_mqtt: {}\nlisten:\n"
                        f"  - {{port: {self.ports[i]}, ip: \"{self.host}\", module: mod_mqtt}}\n")
        return self.program(f"ejabberd{i}", self.arguments(i))

    def arguments(self, i):
        directory = self.directory / f"ejabberd{i}"
        return self.with_environment(
            ["erl", "-sname", f"e{i}@localhost", "-setcookie", "slamgw", "-start_epmd", "false", "-noinput", "+K", "true",
             "-mnesia", "dir", f'"{directory}"', "-s", "ejabberd", "-eval", self.join(i)],
            EJABBERD_CONFIG_PATH=self.directory / f"ejabberd{i}.yml", EJABBERD_LOG_PATH=self.directory / f"ejabberd{i}.events.log")

    def join(self, i):
        """Once in its life a node joins the first one, after the node before it; a file says that it has."""
        joined, before = self.directory / f"ejabberd{i}.joined", self.directory / f"ejabberd{i - 1}.joined"
        join = (f'W = fun F() -> filelib:is_file("{before}") orelse begin timer:sleep(200), F() end end, W(), '
                "ok = ejabberd_cluster:join('e0@localhost')" if i > 0 else "ok")
        return f'filelib:is_file("{joined}") orelse begin {join}, ok = file:write_file("{joined}", "") end.'

    def has_started(self, i):
        return (self.directory / f"ejabberd{i}.joined").exists()

    def is_well(self, i):
        try:
            with socket.create_connection((self.host, self.ports[i]), timeout=0.3):
                return True
        except OSError:
            return False


ENGINES = {"mosquitto": Mosquitto, "rabbitmq": RabbitMq, "nats": Nats, "ejabberd": Ejabberd}
