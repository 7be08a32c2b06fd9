# SPDX-License-Identifier: Apache-2.0
"""Faults on purpose. Pure: counts packets; the one that a fault names is lost or ends the connection."""
import dataclasses

from packets import Kind

THEN = ("drop", "cut", "cut_after")
DIRECTIONS = ("got", "gave")


@dataclasses.dataclass
class Fault:
    packet: str  # PUBACK, PUBREL ...
    direction: str  # got: from the client; gave: to it
    then: str  # drop: as if it was not sent; cut: the connection ends instead; cut_after: it ends when the packet was sent or handled
    nth: int = 1  # counted from now on
    times: int = 1  # this many, each the nth after the one before it
    client: str | None = None  # any

    def __post_init__(self):
        if self.packet not in Kind.__members__ or self.direction not in DIRECTIONS or self.then not in THEN:
            raise ValueError(f"a fault is one of {', '.join(DIRECTIONS)}; {', '.join(THEN)}; {', '.join(Kind.__members__)}")
        self.left = self.nth


class Faults:
    def __init__(self):
        self.faults = []

    def add(self, **fault):
        self.faults.append(Fault(**fault))

    def clear(self):
        self.faults.clear()

    def on_packet(self, direction, client, kind):
        """Returns the fault for this packet, or None."""
        then = None
        for fault in list(self.faults):
            if (fault.direction, fault.packet) != (direction, kind.name) or fault.client not in (None, client):
                continue
            fault.left -= 1
            if fault.left > 0 or then:
                continue
            then, fault.left, fault.times = fault.then, fault.nth, fault.times - 1
            if fault.times == 0:
                self.faults.remove(fault)
        return then
