#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Plays Home Assistant: what it would show of the messages in FILE, one line "TOPIC HEX" each, in order.

Prints {device: {entity: state}} as JSON; for a button, its message. Status 1 and a message for a document that Home
Assistant would ignore. The rules follow its documentation ("MQTT", sections "Discovery topic", "MQTT device
discovery payload" and "Availability"; "MQTT sensor", "MQTT binary sensor", "MQTT button"; "Templating", `unpack`). Templates
are rendered by Jinja, as there. Read by tests/e2e/home_assistant_test.cpp.
"""
import json
import re
import struct
import sys

import jinja2

DISCOVERY_TOPIC = re.compile(r"homeassistant/device/(?:[a-zA-Z0-9_-]+/)?[a-zA-Z0-9_-]+/config")
ROOT_KEYS = {"device", "origin", "components", "availability", "availability_mode", "state_topic", "command_topic", "qos", "encoding"}
REQUIRED_ROOT_KEYS = {"device", "origin", "components"}
SHARED_KEYS = ("availability", "availability_mode", "command_topic", "state_topic")
ENTITY_KEYS = {"platform", "name", "unique_id", "qos", "encoding", "entity_category", *SHARED_KEYS}
PLATFORM_KEYS = {
    "binary_sensor": {"device_class", "value_template", "payload_on", "payload_off"},
    "sensor": {"device_class", "value_template", "unit_of_measurement", "state_class"},
    "button": {"payload_press", "retain"},
}
REQUIRED_KEYS = {"binary_sensor": {"state_topic"}, "sensor": {"state_topic"}, "button": {"command_topic"}}


def require(holds, why):
    if not holds:
        sys.exit(why)


def unpack(value, form, offset=0):
    """Home Assistant shows `unknown` when the bytes are too few, and writes a warning each time."""
    require(len(value) >= offset + struct.calcsize(form), f"no {form} at {offset} of {value.hex()!r}")
    return struct.unpack_from(form, value, offset)[0]


jinja = jinja2.Environment(undefined=jinja2.StrictUndefined)
jinja.filters["unpack"] = unpack


def render(template, payload, encoding):
    """`value` is text unless the encoding is empty; `value_json` is there only for JSON."""
    names = {"value": payload if encoding == "" else payload.decode(encoding)}
    try:
        names["value_json"] = json.loads(payload)
    except ValueError:
        pass
    return jinja.from_string(template).render(names).strip()


def check(topic, document):
    require(DISCOVERY_TOPIC.fullmatch(topic), f"{topic}: characters that are not allowed")
    require(ROOT_KEYS >= document.keys() >= REQUIRED_ROOT_KEYS, f"{topic}: unknown or missing keys")
    require(document["device"].get("identifiers"), f"{topic}: the device has no identifiers")
    require(document["origin"].get("name"), f"{topic}: the origin has no name")


def entities_of(topic, document):
    for key, entity in document["components"].items():
        platform = entity["platform"]
        for shared in SHARED_KEYS:
            if shared in document:
                entity.setdefault(shared, document[shared])
        allowed = ENTITY_KEYS | PLATFORM_KEYS[platform]
        require(entity.keys() <= allowed, f"{topic}: {key} has unknown keys: {entity.keys() - allowed}")
        require(entity.keys() >= REQUIRED_KEYS[platform] | {"unique_id"}, f"{topic}: {key} lacks keys")
        require(entity.get("availability_mode", "latest") == "all", f"{topic}: {key} needs each of its topics")
        yield entity


def is_available(entity, last):
    encoding = entity.get("encoding", "utf-8")
    for place in entity["availability"]:
        require(not set("+#") & set(place["topic"]), "availability takes no wildcards")
        payload = last.get(place["topic"])
        if payload is None or render(place["value_template"], payload, encoding) != "online":
            return False
    return True


def state_of(entity, last):
    if not is_available(entity, last):
        return "unavailable"
    if entity["platform"] == "button":
        return {entity["command_topic"]: entity["payload_press"]}
    payload = last.get(entity["state_topic"])
    if payload is None:
        return "unknown"
    state = render(entity["value_template"], payload, entity.get("encoding", "utf-8"))
    if entity["platform"] == "binary_sensor":
        return {entity["payload_on"]: "on", entity["payload_off"]: "off"}[state]
    return "unknown" if state == "None" else state


def main():
    last = {}
    for line in open(sys.argv[1], encoding="utf-8"):
        topic, _, payload = line.rstrip("\n").partition(" ")
        last[topic] = bytes.fromhex(payload)
    shown, ids = {}, []
    for topic, payload in last.items():
        if topic.startswith("homeassistant/") and payload:
            document = json.loads(payload)
            check(topic, document)
            entities = list(entities_of(topic, document))
            ids += [*document["device"]["identifiers"], *(entity["unique_id"] for entity in entities)]
            shown[document["device"]["name"]] = {entity["name"]: state_of(entity, last) for entity in entities}
    require(len(ids) == len(set(ids)), "two devices or entities share an id")
    print(json.dumps(shown))


main()
