# SPDX-License-Identifier: Apache-2.0
"""The hardware of the virtual machine that a container lacks: a serial board at a USB port, 802.15.4 radios with 6LoWPAN."""
import json
import os
import pathlib
import re
import signal
import subprocess
import tempfile

from machine import demand, run, wait_for

GADGET = pathlib.Path("/sys/kernel/config/usb_gadget/board")
PORT = pathlib.Path("/dev/ttyACM0")
BOARD_END = pathlib.Path("/dev/ttyGS0")
RADIO = "radio0"
INTERFACE = "wpan0"  # the name that OpenThread's border router uses
SERIAL_NUMBER = "000683000001"
PREFIX = "fd00:db8:0:1"


class UsbBoard:
    """A development kit: SEGGER's USB ids, a CDC ACM port on a virtual bus, and behind it a simulated board."""

    def __init__(self, robots, *options):
        self.directory = pathlib.Path(tempfile.mkdtemp())
        self.output = self.directory / "output"
        with open(self.output, "w", encoding="utf-8") as output, open(self.directory / "errors", "w") as errors:
            self.simulator = subprocess.Popen(["slam-gateway-sim", "ble", "--tty", self.directory / "tty", "--robots",
                                               str(robots), "--id-prefix", "ble", *options], stdout=output, stderr=errors)
        wait_for("the simulated board", (self.directory / "tty").exists)
        self._make_gadget()
        self.cable = subprocess.Popen(["python3", pathlib.Path(__file__).with_name("cable.py"), BOARD_END,
                                       self.directory / "tty"])

    @staticmethod
    def _make_gadget():
        run("modprobe", "-a", "dummy_hcd", "libcomposite")
        if not GADGET.parent.exists():
            run("mount", "-t", "configfs", "none", "/sys/kernel/config")
        for directory in ("strings/0x409", "configs/c.1/strings/0x409", "functions/acm.0"):
            (GADGET / directory).mkdir(parents=True)
        for name, value in {"idVendor": "0x1366", "idProduct": "0x1015", "bcdUSB": "0x0200",
                            "strings/0x409/manufacturer": "SEGGER", "strings/0x409/product": "J-Link",
                            "strings/0x409/serialnumber": SERIAL_NUMBER,
                            "configs/c.1/strings/0x409/configuration": "CDC ACM"}.items():
            (GADGET / name).write_text(value + "\n", encoding="ascii")
        (GADGET / "configs/c.1/acm.0").symlink_to(GADGET / "functions/acm.0")
        wait_for("the board's end of the port", BOARD_END.exists)

    def plug_in(self):
        """Plugs the board in, which starts it."""
        self.simulator.send_signal(signal.SIGUSR2)
        controller = os.listdir("/sys/class/udc")[0]
        (GADGET / "UDC").write_text(controller + "\n", encoding="ascii")
        wait_for("the port", lambda: list(pathlib.Path("/dev").glob("ttyACM*")))

    def unplug(self):
        (GADGET / "UDC").write_text("\n", encoding="ascii")
        wait_for("the port's end", lambda: not list(pathlib.Path("/dev").glob("ttyACM*")))

    def stop_reading(self):
        self.cable.send_signal(signal.SIGSTOP)

    def read_again(self):
        self.cable.send_signal(signal.SIGCONT)

    def end(self):
        self.unplug()
        self.simulator.send_signal(signal.SIGINT)
        self.simulator.wait()
        self.cable.kill()
        self.cable.wait()


def in_namespace(node, *command):
    return [*(["ip", "netns", "exec", node] if node else []), *map(str, command)]


class Radios:
    """A radio here and one in each of some network namespaces, all within reach of each other; frames of 127 octets,
    compressed and fragmented by the kernel."""

    def __init__(self, nodes):
        self.nodes = ["", *nodes]
        run("modprobe", "ieee802154_6lowpan")
        run("modprobe", "fakelb", f"numlbs={len(self.nodes)}")
        phys = sorted(re.findall(r"^wpan_phy (\S+)$", run("iwpan", "phy"), re.MULTILINE), key=lambda name: int(name[3:]))
        # Radios of other namespaces move first: one that is still here may have the name of INTERFACE.
        for node, phy in zip(nodes, phys[1:]):
            run("ip", "netns", "add", node)
            run("ip", "-n", node, "link", "set", "lo", "up")
            run("iwpan", "phy", phy, "set", "netns", "name", node)
        for number, node in enumerate(self.nodes, 1):
            name = re.findall(r"Interface (wpan\d+)$", run(*in_namespace(node, "iwpan", "dev")), re.MULTILINE)[0]
            run(*in_namespace(node, "ip", "link", "set", name, "name", RADIO))
            run(*in_namespace(node, "iwpan", "dev", RADIO, "set", "pan_id", "0xface"))
            run(*in_namespace(node, "iwpan", "dev", RADIO, "set", "short_addr", f"0x{number:04x}"))
            run(*in_namespace(node, "ip", "link", "set", RADIO, "up"))
            self.make_interface(node)

    def address(self, node=""):
        return f"{PREFIX}::{self.nodes.index(node) + 1}"

    def make_interface(self, node=""):
        run(*in_namespace(node, "ip", "link", "add", "link", RADIO, "name", INTERFACE, "type", "lowpan"))
        run(*in_namespace(node, "sysctl", "-qw", f"net.ipv6.conf.{INTERFACE}.accept_dad=0"))
        run(*in_namespace(node, "ip", "link", "set", INTERFACE, "up"))
        run(*in_namespace(node, "ip", "address", "add", f"{self.address(node)}/64", "dev", INTERFACE, "nodad"))

    def delete_interface(self):
        run("ip", "link", "delete", INTERFACE)

    @staticmethod
    def interface_index():
        return int(pathlib.Path("/sys/class/net", INTERFACE, "ifindex").read_text(encoding="ascii"))

    def lose(self, percent):
        """Loses this part of the frames that each radio sends."""
        for node in self.nodes:
            run(*in_namespace(node, "tc", "qdisc", "replace", "dev", RADIO, "root", "netem", "loss",
                              f"{percent}%"))


class RecordedRobots:
    """Robots on Thread that record each update and its acknowledgement, optionally in a network namespace."""

    def __init__(self, gateway, *options, node=""):
        self.record = pathlib.Path(tempfile.mkdtemp()) / "record"
        self.output = self.record.with_name("output")
        with open(self.output, "w", encoding="utf-8") as output:
            self.process = subprocess.Popen(
                in_namespace(node, "slam-gateway-sim", "thread", "--gateway", gateway, "--record", self.record, *options),
                stdout=output, stderr=subprocess.DEVNULL)

    def acknowledged(self):
        """Returns the times of acknowledgements by robot, in seconds since 1970."""
        times = {}
        text = self.record.read_text(encoding="utf-8") if self.record.exists() else ""
        for line in text[:text.rfind("\n") + 1].splitlines():
            words = line.split()
            if words[0] == "acknowledged":
                times.setdefault(words[1], []).append(float(words[3]))
        return times

    def wait_for_each(self, count, since=0.0):
        """Waits until each robot has had `count` acknowledgements since then."""
        def have_all():
            later = [[when for when in times if when > since] for times in self.acknowledged().values()]
            return later and all(len(times) >= count for times in later)
        wait_for("acknowledged updates", have_all)

    def longest_gap(self, since, until):
        """Returns the longest time of any robot between acknowledgements, in seconds."""
        gaps = []
        for times in self.acknowledged().values():
            inside = [since, *(when for when in times if since < when < until), until]
            gaps += [later - earlier for earlier, later in zip(inside, inside[1:])]
        demand(gaps, "no acknowledgements at all")
        return max(gaps)

    def end(self):
        self.process.send_signal(signal.SIGINT)
        demand(self.process.wait(60) == 0, "slam-gateway-sim failed")
        return json.loads(self.output.read_text(encoding="utf-8").splitlines()[-1])
