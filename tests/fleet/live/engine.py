# SPDX-License-Identifier: Apache-2.0
"""The brokers of a run, from Debian's packages: one Mosquitto or ejabberd, or a cluster of three nodes of RabbitMQ or NATS. Used by
run."""
import datetime
import os
import re
import shutil
import signal
import socket
import sys
import time
import urllib.request

from program import Program, free_port

NODES = 3
START_S = 180  # for one node of Erlang, on a busy machine


class Engine:
    """A broker or a cluster. Node i listens at `ports[i]` of `host`."""

    package = program_of_package = None
    count = 1
    takes_qos2 = takes_mqtt5 = True
    rate, most_equal = 100, 10  # most messages a second of all robots, and most robots with equal commands, on a busy machine
    user = None  # (name of a client -> user name); None: clients need no user name
    subscribed_s = 1  # for the subscriptions of a gateway that connects
    change_s = 1.0  # from a robot's CONNECT until its session is at its new gateway, with its subscriptions
    settle_s = 12  # until the connections that a failed node has harmed have ended: two keep-alives of 6 s
    again_s = 0  # until it delivers messages that a former holder of a session has not acknowledged
    move_pause_s = 0.3  # between two takeovers of one session
    may_nodes_differ = False  # nodes may keep different retained messages once a node was down
    sends_retained_to_wildcards = True  # also messages that another node received
    repeats_in_a_connection = False  # unacknowledged messages, after a while; otherwise only to a client that reconnects

    def __init__(self, directory, host, prefix=()):
        if not shutil.which(self.program_of_package):
            sys.exit(f"this engine needs a package of Debian: apt-get install --no-install-recommends {self.package}")
        self.directory, self.host, self.prefix = directory, host, list(prefix)
        self.ports = [free_port(socket.SOCK_STREAM) for _ in range(self.count)]
        self.nodes = [self.make_node(i) for i in range(self.count)]

    def program(self, name, arguments):
        return Program(self.directory, name, self.prefix + list(arguments))

    def start(self):
        for node in self.nodes:
            node.start()

    def programs(self):
        return self.nodes

    def broken_connections(self):
        """Returns (when, client id) of connections that a node broke by its own fault."""
        return []

    def is_well(self, i):
        """Returns True if the node serves clients, and the cluster can lose another node."""
        return self.nodes[i].is_running()

    def accepts(self, i):
        try:
            with socket.create_connection((self.host, self.ports[i]), timeout=0.3):
                return True
        except OSError:
            return False

    def stop(self):
        """Kills all programs, because a clean shutdown of a cluster takes long."""
        for each in self.programs():
            if each.is_running():
                each.end(signal.SIGKILL)


class Mosquitto(Engine):
    package = program_of_package = "mosquitto"

    def make_node(self, i):
        path = self.directory / "mosquitto.conf"
        path.write_text(f"listener {self.ports[i]} {self.host}\nallow_anonymous true\nset_tcp_nodelay true\n"
                        "max_queued_messages 0\nuser root\n")
        return self.program("broker", ["mosquitto", "-c", path])


class Nats(Engine):
    """MQTT 3.1.1."""

    package = program_of_package = "nats-server"
    count = NODES
    takes_mqtt5 = False
    takes_qos2 = False  # it closes the connection
    rate, most_equal = 30, 2  # it handles some 100 messages a second with QoS 1 in all
    subscribed_s = 10  # measured: up to 6 s
    change_s = 3.0
    settle_s = Engine.settle_s + 4  # it waits 4 s for a stream before it closes a publisher's connection
    again_s = 30
    move_pause_s = 2  # it closes a client id that comes back within about a second
    may_nodes_differ = True
    repeats_in_a_connection = True  # after 30 s

    def __init__(self, directory, host, prefix=()):
        self.routes = [free_port(socket.SOCK_STREAM) for _ in range(NODES)]
        self.watched = [free_port(socket.SOCK_STREAM) for _ in range(NODES)]
        super().__init__(directory, host, prefix)

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
        """Returns True when the node's streams and consumers are up to date."""
        try:
            with urllib.request.urlopen(f"http://{self.host}:{self.watched[i]}/healthz", timeout=0.3) as answer:
                return answer.status == 200
        except OSError:
            return False


class Erlang(Engine):
    """Its nodes find each other by a private port mapper, which ends with them. They start one after another: when nodes started together,
    the Raft group of RabbitMQ's MQTT plug-in never worked."""

    def __init__(self, directory, host, prefix=()):
        self.environment = {"ERL_EPMD_PORT": free_port(socket.SOCK_STREAM), "ERL_EPMD_ADDRESS": "127.0.0.1", "HOME": directory,
                            "ERL_LIBS": f"/usr/lib/{os.uname().machine}-linux-gnu"}
        super().__init__(directory, host, prefix)
        self.mapper = self.program("epmd", self.with_environment(["epmd", "-port", self.environment["ERL_EPMD_PORT"],
                                                                  "-address", "127.0.0.1"]))

    def with_environment(self, arguments, **more):
        return ["env", *(f"{key}={value}" for key, value in {**self.environment, **more}.items()), *map(str, arguments)]

    def start(self):
        self.mapper.start()
        for i, node in enumerate(self.nodes):
            node.start()
            deadline = time.monotonic() + START_S
            while not (self.has_started(i) and self.accepts(i)):
                if not node.is_running() or time.monotonic() > deadline:
                    raise OSError(f"{node.name} does not start: {node.tail()}")
                time.sleep(0.2)

    def is_well(self, i):
        return self.accepts(i)

    def programs(self):
        return self.nodes + [self.mapper]


class RabbitMq(Erlang):
    """MQTT 3.1.1. Its MQTT plug-in keeps client ids in a Raft group; robots' queues are quorum queues, so that they outlive a node."""

    package, program_of_package = "rabbitmq-server", "rabbitmq-server"
    count = NODES
    takes_mqtt5 = False
    rate, most_equal = 60, 6
    change_s = 2.0
    sends_retained_to_wildcards = False

    def make_node(self, i):
        names = [f"r{node}@localhost" for node in range(NODES)]
        path = self.directory / f"rabbitmq{i}.conf"
        path.write_text(f"mqtt.listeners.tcp.1 = {self.host}:{self.ports[i]}\nmqtt.allow_anonymous = true\nloopback_users = none\n"
                        "listeners.tcp = none\nmqtt.durable_queue_type = quorum\nmqtt.prefetch = 1\nmqtt.subscription_ttl = 86400000\n"
                        "cluster_partition_handling = pause_minority\ncluster_formation.peer_discovery_backend = classic_config\n" +
                        "".join(f"cluster_formation.classic_config.nodes.{n} = {name}\n" for n, name in enumerate(names, 1)))
        plugins = self.directory / "rabbitmq.plugins"
        plugins.write_text("[rabbitmq_mqtt].\n")
        # As under systemd: the node itself replaces the script, so that it can be killed and stopped.
        return self.program(f"rabbitmq{i}", self.with_environment(
            ["/usr/lib/rabbitmq/bin/rabbitmq-server"], RUNNING_UNDER_SYSTEMD="true", RABBITMQ_NODENAME=names[i],
            RABBITMQ_CONFIG_FILE=path.with_suffix(""), RABBITMQ_ENABLED_PLUGINS_FILE=plugins,
            RABBITMQ_MNESIA_BASE=self.directory / f"rabbitmq{i}", RABBITMQ_LOG_BASE=self.directory,
            RABBITMQ_PID_FILE=self.directory / f"rabbitmq{i}.pid", RABBITMQ_DIST_PORT=free_port(socket.SOCK_STREAM),
            RABBITMQ_SERVER_ADDITIONAL_ERL_ARGS="-start_epmd false -setcookie slamgw"))

    def has_started(self, i):
        return "Starting broker... completed" in self.nodes[i].log.read_text()

    def broken_connections(self):
        """While a robot's queue is deleted for a clean session, a message to it can end its publisher's connection: the plug-in does not
        expect basic.nack."""
        found, to_monotonic = [], time.monotonic() - time.time()
        for i in range(NODES):
            clients = {}
            for line in (self.directory / f"r{i}@localhost.log").read_text(errors="replace").splitlines():
                if accepted := re.search(r"accepting MQTT connection (<[\d.]+>) .*client id: (.*)\)", line):
                    clients[accepted[1]] = accepted[2]
                elif (ended := re.search(r"Generic server (<[\d.]+>) terminating", line)) and ended[1] in clients:
                    when = datetime.datetime.fromisoformat(" ".join(line.split()[:2])).timestamp()
                    found.append((when + to_monotonic, clients[ended[1]]))
        return found


class Ejabberd(Erlang):
    """MQTT 5, one node: in a cluster it refuses a client id for good after this has moved between nodes. Clients need a user name that is
    an address of the host, and any password. Client ids belong to a user, so all gateways have the same user."""

    package, program_of_package = "ejabberd", "ejabberdctl"
    user = staticmethod("{}@localhost".format)

    def make_node(self, i):
        path = self.directory / "ejabberd.yml"
        path.write_text("hosts: [localhost]\nloglevel: warning\nauth_method: [anonymous]\nanonymous_protocol: both\n"
                        "allow_multiple_connections: true\nmodules:\n  mod_mqtt: {}\nlisten:\n"
                        f"  - {{port: {self.ports[i]}, ip: \"{self.host}\", module: mod_mqtt}}\n")
        database = self.directory / "ejabberd"
        return self.program("ejabberd", self.with_environment(
            ["erl", "-sname", "e@localhost", "-setcookie", "slamgw", "-start_epmd", "false", "-noinput", "+K", "true",
             "-mnesia", "dir", f'"{database}"', "-s", "ejabberd"],
            EJABBERD_CONFIG_PATH=path, EJABBERD_LOG_PATH=self.directory / "ejabberd.events.log"))

    def has_started(self, i):
        return True


ENGINES = {"mosquitto": Mosquitto, "rabbitmq": RabbitMq, "nats": Nats, "ejabberd": Ejabberd}
