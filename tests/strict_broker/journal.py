# SPDX-License-Identifier: Apache-2.0
"""The packets that the broker received and sent, a JSON object a line, written at once: `at` (seconds since 1970), `event`, and its
facts. README.md lists the events."""
import json
import sys
import time


class Journal:
    def __init__(self, path):
        self.file = open(path, "w", encoding="utf-8") if path else sys.stderr

    def write(self, event, **facts):
        self.file.write(json.dumps({"at": round(time.time(), 6), "event": event, **facts}) + "\n")
        self.file.flush()

    def packet(self, event, client, packet):
        """`got` or `gave`"""
        facts = {"client": client, "packet": packet.kind.name}
        for name in ("packet_id", "reason", "qos", "dup", "retain", "topic"):
            if value := getattr(packet, name):
                facts[name] = value
        if packet.topic:
            facts["payload"] = packet.payload.hex()
        if packet.entries:
            facts["entries"] = packet.entries
        self.write(event, **facts)
