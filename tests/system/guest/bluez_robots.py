#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Robots on BLE Mesh for ./dev system-test --vm bluez: each a bluetooth-meshd of its own, on a bus and a controller of its own.
They join, publish updates with the sensor_update client, each until it is acknowledged, and obey pos_cmd. FILE holds the
state of each as JSON, and they continue from it. Payloads by UUID in the file of that name with the suffix play are sent
in place of their own."""
import json
import os
import pathlib
import struct
import subprocess
import sys
import time

import dbus
import dbus.bus
import dbus.mainloop.glib
import dbus.service
from gi.repository import GLib

MESH = "org.bluez.mesh"
APPLICATION, ELEMENT, AGENT = (f"{MESH}.{name}1" for name in ("Application", "Element", "ProvisionAgent"))
PROPERTIES = "org.freedesktop.DBus.Properties"
MESHD = "/usr/libexec/bluetooth/bluetooth-meshd"
ROOT = "/robot"
COMPANY = 0x0059
UPDATE_CLIENT, POS_CMD_SERVER, ON_OFF_SERVER = 0x0006, 0x0009, 0x1000
SET, STATUS, COMMAND, OBEYED = b"\xc9\x59\x00", b"\xcc\x59\x00", b"\xcd\x59\x00", b"\xd0\x59\x00\x00"


def octets(data):
    return dbus.Array([dbus.Byte(octet) for octet in data], signature="y")


def no_options():
    return dbus.Dictionary({}, signature="sv")


class Objects(dbus.service.Object):
    """The application: one element with the models of a robot."""

    def __init__(self, robot):
        super().__init__(robot.bus, ROOT)
        self.robot = robot

    @dbus.service.method("org.freedesktop.DBus.ObjectManager", out_signature="a{oa{sa{sv}}}")
    def GetManagedObjects(self):
        versions = {name: dbus.UInt16(1) for name in ("CompanyID", "ProductID", "VersionID")}
        models = [(dbus.UInt16(COMPANY), dbus.UInt16(model), no_options()) for model in (UPDATE_CLIENT, POS_CMD_SERVER)]
        return {dbus.ObjectPath(ROOT): {APPLICATION: versions},
                dbus.ObjectPath(ROOT + "/agent"): {AGENT: {"Capabilities": dbus.Array([], signature="s")}},
                dbus.ObjectPath(ROOT + "/element"): {ELEMENT: {
                    "Index": dbus.Byte(0), "Location": dbus.UInt16(0),
                    "Models": dbus.Array([(dbus.UInt16(ON_OFF_SERVER), no_options())], signature="(qa{sv})"),
                    "VendorModels": dbus.Array(models, signature="(qqa{sv})")}}}

    @dbus.service.method(APPLICATION, in_signature="t")
    def JoinComplete(self, token):
        self.robot.facts["token"] = int(token)
        self.robot.facts["joined"] += 1
        GLib.idle_add(self.robot.attach, token)

    @dbus.service.method(APPLICATION, in_signature="s")
    def JoinFailed(self, _reason):
        GLib.timeout_add(1000, self.robot.join)


class Agent(dbus.service.Object):
    @dbus.service.method(PROPERTIES, in_signature="s", out_signature="a{sv}")
    def GetAll(self, _interface):
        return {"Capabilities": dbus.Array([], signature="s")}

    @dbus.service.method(AGENT)
    def Cancel(self):
        pass


class Element(dbus.service.Object):
    def __init__(self, robot):
        super().__init__(robot.bus, ROOT + "/element")
        self.robot = robot

    @dbus.service.method(ELEMENT, in_signature="qqvay", byte_arrays=True)
    def MessageReceived(self, source, key, _destination, data):
        self.robot.hear(source, key, bytes(data))

    @dbus.service.method(ELEMENT, in_signature="qbqay")
    def DevKeyMessageReceived(self, _source, _remote, _net_index, _data):
        pass

    @dbus.service.method(ELEMENT, in_signature="qa{sv}")
    def UpdateModelConfiguration(self, model, configuration):
        if model == UPDATE_CLIENT and "PublicationPeriod" in configuration:
            self.robot.may_publish = True


class Robot:
    def __init__(self, number, period_ms, path, earlier):
        self.uuid = bytes.fromhex("736c616d000040008000") + bytes([number] * 6)
        unused = {"uuid": self.uuid.hex(), "joined": 0, "sent": 0, "played": 0, "acknowledged": 0, "obeyed": []}
        self.facts = next((facts for facts in earlier if facts["uuid"] == self.uuid.hex()), unused)
        self.facts["sent"] = self.facts["acknowledged"]  # the one in flight is sent again
        self.node = None
        self.may_publish = False
        self.play = path.with_suffix(".play")
        self.update = None  # not acknowledged yet
        home = pathlib.Path(f"/run/robot{number}")
        home.mkdir()
        store = path.parent / f"robot{number}"
        store.mkdir(exist_ok=True)
        address = f"unix:path={home}/bus"
        subprocess.Popen(["dbus-daemon", "--session", "--nofork", "--nopidfile", f"--address={address}"])
        while not (home / "bus").exists():
            time.sleep(0.05)
        subprocess.Popen([MESHD, "--nodetach", "--io", f"generic:hci{number}", "--storage", store],
                         env=dict(os.environ, DBUS_SYSTEM_BUS_ADDRESS=address), stdout=subprocess.DEVNULL,
                         stderr=subprocess.DEVNULL)
        self.bus = dbus.bus.BusConnection(address)
        self.objects = [Objects(self), Agent(self.bus, ROOT + "/agent"), Element(self)]
        GLib.timeout_add(1000, *([self.attach, self.facts["token"]] if "token" in self.facts else [self.join]))
        GLib.timeout_add(period_ms, self.publish)

    def call(self, path, interface, method, signature, *arguments, done=None, failed=None):
        self.bus.call_async(MESH, path, f"{MESH}.{interface}", method, signature, arguments,
                            done or (lambda *_: None), failed or (lambda _: None), timeout=60)

    def join(self):
        self.call("/org/bluez/mesh", "Network1", "Join", "oay", ROOT, octets(self.uuid),
                  failed=lambda _: GLib.timeout_add(1000, self.join))
        return False

    def attach(self, token):
        def done(node, configuration):
            self.node = node
            self.may_publish |= any("PublicationPeriod" in model for _, models in configuration for _, model in models)
        self.call("/org/bluez/mesh", "Network1", "Attach", "ot", ROOT, token, done=done,
                  failed=lambda _: GLib.timeout_add(1000, self.attach, token))
        return False

    def next_update(self):
        """Returns None when all updates of a given list are acknowledged."""
        if not self.play.exists():
            self.facts["sent"] += 1
            return struct.pack("<hh", self.facts["sent"], 0)
        updates = json.loads(self.play.read_text(encoding="utf-8")).get(self.uuid.hex(), [])
        if self.facts["played"] == len(updates):
            return None
        self.facts["played"] += 1
        return bytes.fromhex(updates[self.facts["played"] - 1])

    def publish(self):
        if self.node and self.may_publish:
            self.update = self.update or self.next_update()
            if self.update:
                vendor = dbus.Dictionary({"Vendor": dbus.UInt16(COMPANY)}, signature="sv")
                self.call(self.node, "Node1", "Publish", "oqa{sv}ay", ROOT + "/element", dbus.UInt16(UPDATE_CLIENT), vendor,
                          octets(SET + self.update))
        return True

    def hear(self, source, key, data):
        if data.startswith(STATUS) and self.update:
            self.facts["acknowledged"] += 1
            self.update = None
        if data.startswith(COMMAND):
            self.facts["obeyed"].append(data[len(COMMAND):].hex())
            self.call(self.node, "Node1", "Send", "oqqa{sv}ay", ROOT + "/element", source, key, no_options(), octets(OBEYED))


def main():
    first, count, period_ms, path = int(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), pathlib.Path(sys.argv[4])
    dbus.mainloop.glib.DBusGMainLoop(set_as_default=True)
    earlier = json.loads(path.read_text(encoding="utf-8")) if path.exists() else []
    robots = [Robot(number, period_ms, path, earlier) for number in range(first, first + count)]

    def note():
        path.with_suffix(".new").write_text(json.dumps([robot.facts for robot in robots]), encoding="utf-8")
        path.with_suffix(".new").rename(path)
        return True
    GLib.timeout_add(500, note)
    GLib.MainLoop().run()


if __name__ == "__main__":
    main()
