# SPDX-License-Identifier: Apache-2.0
"""The surroundings of the gateway in the system test: the broker, a listener, simulated robots, a faulty client."""
import collections
import json
import pathlib
import re
import signal
import socket
import subprocess
import tempfile

from machine import BOARD, GATEWAY, PATIENCE_S, demand, run, wait_for

# Must never appear in the journal.
PASSWORDS = {"slam-gateway": "Zwischen-den-Zeilen-7", "slam-server": "Unter-der-Hand-8",
             "slam-gateway-web": "Ueber-den-Zaun-6"}
WEB_RIGHTS = ["user slam-gateway-web", "topic read ntnu-slam/#"]  # docs/web.md
WRONG_PASSWORD = "Aus-der-Luft-9"
ACL = pathlib.Path("/etc/mosquitto/slam-gateway.acl")
EXAMPLES = pathlib.Path("/usr/share/doc/slam-gateway/examples")


def set_up_broker():
    """Sets up the shipped example: its text, the access control list in its comments, users with passwords."""
    example = (EXAMPLES / "mosquitto.example.conf").read_text(encoding="utf-8")
    acl = re.findall(r"^#   (user .*|topic .*)$", example, re.MULTILINE)
    named = [line.split()[1] for line in acl if line.startswith("user ")]
    demand(named == list(PASSWORDS)[:2], f"the example's access control list is for {named}")
    pathlib.Path("/etc/mosquitto/conf.d/slam-gateway.conf").write_text(example, encoding="utf-8")
    ACL.write_text("\n".join(acl + WEB_RIGHTS) + "\n", encoding="utf-8")
    users = "/etc/mosquitto/slam-gateway.passwd"
    pathlib.Path(users).touch()
    for user, password in PASSWORDS.items():
        run("mosquitto_passwd", "-b", users, user, password)
    run("systemctl", "restart", "mosquitto")


def as_server():
    return ["-u", "slam-server", "-P", PASSWORDS["slam-server"]]


def retained(topic):
    """Returns the state in a retained message of the gateway."""
    text = run("mosquitto_sub", *as_server(), "-t", f"ntnu-slam/gateway/{GATEWAY}/{topic}", "-C", "1", "-W", "20")
    return json.loads(text)["state"]


class Listener:
    """A subscriber with a persistent session that records every message under a filter. The next one with the same
    notebook continues its session."""

    def __init__(self, topics="ntnu-slam/robot/#", notebook=None):
        self.file = open(notebook, "a+", encoding="utf-8") if notebook else tempfile.NamedTemporaryFile("w+")
        self.process = subprocess.Popen(
            ["stdbuf", "-oL", "mosquitto_sub", *as_server(), "-q", "1", "-c", "-i", f"listener-{notebook.name if notebook else id(self)}", "-d", "-v",
             "-t", topics, "-F", "HEARD %t %x"], stdout=self.file, stderr=subprocess.STDOUT)
        wait_for("a subscription", lambda: "Subscribed" in self._text())

    def _text(self):
        return pathlib.Path(self.file.name).read_text(encoding="utf-8", errors="replace")

    def lines(self):
        """Returns topic and payload, in hexadecimal, of each message."""
        return [line.removeprefix("HEARD ") for line in self._text().splitlines() if line.startswith("HEARD ")]

    def heard(self):
        """Returns the number of messages of each topic."""
        return collections.Counter(line.split()[0] for line in self.lines())

    def wait_for(self, counts):
        """Waits until at least this many messages of each topic have arrived."""
        def missing():
            heard = self.heard()
            return {topic: count - heard[topic] for topic, count in counts.items() if heard[topic] < count}
        try:
            wait_for("messages", lambda: not missing())
        except Exception as failure:
            raise type(failure)(f"{failure}; missing: {missing()}") from failure

    def end(self):
        self.process.terminate()
        self.process.wait()


class Robots:
    """A running slam-gateway-sim."""

    def __init__(self, mesh, *options):
        self.output = tempfile.NamedTemporaryFile("w+")
        self.errors = tempfile.NamedTemporaryFile("w+")
        command = ["slam-gateway-sim", mesh, *map(str, options)]
        if mesh == "thread":
            command += ["--gateway", "127.0.0.1:47193"]
        else:  # the confined service opens pseudo-terminals of its own user only
            run("install", "-d", "-o", "slam-gateway", pathlib.Path(BOARD).parent)
            command = ["setpriv", "--reuid=slam-gateway", "--regid=slam-gateway", "--clear-groups",
                       *command, "--tty", BOARD]
        self.process = subprocess.Popen(command, stdout=self.output, stderr=self.errors)

    def result(self):
        """Waits for its end; returns its summary."""
        status = self.process.wait(2 * PATIENCE_S)
        text = pathlib.Path(self.output.name).read_text(encoding="utf-8")
        demand(status == 0 and text, f"slam-gateway-sim: status {status}: "
               + pathlib.Path(self.errors.name).read_text(encoding="utf-8")[-500:])
        return json.loads(text.splitlines()[-1])

    def end(self):
        self.process.send_signal(signal.SIGINT)
        return self.result()


def demand_nothing_lost(result):
    """Allows one message in flight for each robot that was interrupted."""
    under_way = result["sent"] - result["acknowledged"]
    demand(result["sent"] > 0 and result["lost"] == 0 and under_way <= len(result["robots"]), f"the robots report: {result}")


def publish_nonsense(client_id, payload):
    """Publishes an invalid `update` as an MQTT-SN client: CONNECT, REGISTER, PUBLISH at QoS 1, each answered."""
    topic = f"ntnu-slam/robot/{client_id}/update".encode()

    def exchange(kind, body, answer):
        link.send(bytes([len(body) + 2, kind]) + body)
        packet = link.recv(255)
        demand(packet[1] == answer, f"the answer to packet {kind:02x} is {packet.hex()}")
        return packet

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.settimeout(PATIENCE_S)
        link.connect(("127.0.0.1", 47193))
        exchange(0x04, b"\x04\x01\x00\x3c" + client_id.encode(), 0x05)
        topic_id = exchange(0x0A, b"\x00\x00\x00\x01" + topic, 0x0B)[2:4]
        exchange(0x0C, b"\x20" + topic_id + b"\x00\x02" + payload, 0x0D)
        link.send(b"\x02\x18")
