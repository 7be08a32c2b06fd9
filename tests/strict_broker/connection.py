# SPDX-License-Identifier: Apache-2.0
"""One connection of a client: reads packets, answers them as the specification says, ends at the first forbidden one."""
import asyncio
import contextlib

import packets
from packets import Kind, Packet, ProtocolError, decode, encode
from session import Subscription, is_filter

MOST_UNWRITTEN = 1 << 20  # octets; QoS 0 is dropped beyond it
AUTHENTICATION_UNSUPPORTED = 0x8C
LARGEST_PACKET = 268435460  # octets, with type and length
WITH_WILL = 0x04  # DISCONNECT's reason that has the will published
OF_VERSION_4 = {packets.UNSUPPORTED_VERSION: 1, packets.BAD_CLIENT_ID: 2}  # CONNACK's return codes


class Connection:
    def __init__(self, broker, reader, writer):
        self.broker, self.journal, self.reader, self.writer = broker, broker.journal, reader, writer
        self.client, self.version, self.session, self.will = None, 5, None, None
        self.keep_alive = 0
        self.maximum_packet = LARGEST_PACKET
        self.is_over = self.is_mute = False
        self.is_running = asyncio.Event()
        self.is_running.set()
        self.held = []  # packets to the client while the connection stands still
        self.slow_s, self.is_pausing = 0.0, False  # between two messages with QoS 1 or 2 to the client

    async def serve(self):
        buffer = bytearray()
        try:
            while not self.is_over and await self.read(buffer):
                while not self.is_over and (taken := packets.take_packet(buffer)):
                    await self.is_running.wait()
                    if not self.is_over:
                        self.take(decode(*taken, self.version), len(taken[1]))
        except ProtocolError as error:
            self.refuse(error)
        except TimeoutError:
            self.end("keep-alive", packets.KEEP_ALIVE_TIMEOUT)
        except ConnectionError as error:
            self.end(str(error))
        self.end("closed by the client")

    async def read(self, buffer):
        async with asyncio.timeout(1.5 * self.keep_alive or None):
            octets = await self.reader.read(1 << 16)
        buffer += octets
        return bool(octets)

    def refuse(self, error):
        if self.client is None:  # no CONNECT was accepted
            code = error.reason if self.version == 5 else OF_VERSION_4.get(error.reason)
            if code:
                self.write(Packet(Kind.CONNACK, reason=code))
        self.end(f"refused: {error}", error.reason)

    def end(self, why, reason=None, is_cut=False):
        """Ends with DISCONNECT where there is a reason and the version has it. `is_cut`: unsent octets are lost."""
        if self.is_over:
            return
        if reason and self.client is not None and self.version == 5:
            self.write(Packet(Kind.DISCONNECT, reason=reason))
        self.is_over = True
        self.is_running.set()
        self.writer.transport.abort() if is_cut else self.writer.close()
        if self.client is not None:
            self.journal.write("closed", client=self.client, why=why)
            self.broker.on_end(self, self.will)
        else:
            self.journal.write("refused", why=why)

    # From the client

    def take(self, packet, size):
        if size > self.broker.options.maximum_packet:
            raise ProtocolError(packets.PACKET_TOO_LARGE, f"a packet of {size} octets")
        name = self.client if self.client is not None else packet.client_id
        self.journal.packet("got", name, packet)
        then = self.broker.faults.on_packet("got", name, packet.kind)
        if then:
            self.journal.write("fault", client=name, packet=packet.kind.name, direction="got", then=then)
        if then == "drop":
            return
        if then != "cut":
            self.is_mute = then == "cut_after"  # it is handled, and the answer is not sent
            self.handle(packet)
        if then:
            self.end(f"fault: {then} at {packet.kind.name}", is_cut=True)

    def handle(self, packet):
        if (self.client is None) != (packet.kind == Kind.CONNECT):
            raise ProtocolError(packets.PROTOCOL_ERROR, f"{packet.kind.name} {'before' if self.client is None else 'after'} CONNECT")
        handlers = {Kind.CONNECT: self.on_connect, Kind.PUBLISH: self.on_publish, Kind.SUBSCRIBE: self.on_subscribe,
                    Kind.UNSUBSCRIBE: self.on_unsubscribe, Kind.DISCONNECT: self.on_disconnect, Kind.PUBREL: self.on_pubrel,
                    Kind.PINGREQ: lambda _: self.send(Packet(Kind.PINGRESP)),
                    **dict.fromkeys((Kind.PUBACK, Kind.PUBREC, Kind.PUBCOMP), self.on_acknowledgement)}
        if packet.kind not in handlers:
            raise ProtocolError(packets.PROTOCOL_ERROR, f"{packet.kind.name} from a client")
        handlers[packet.kind](packet)

    def on_connect(self, packet):
        self.version, options = packet.version, self.broker.options
        if packet.version not in options.versions:
            raise ProtocolError(packets.UNSUPPORTED_VERSION, f"protocol level {packet.version}")
        if "auth_method" in packet.properties:
            raise ProtocolError(AUTHENTICATION_UNSUPPORTED, "extended authentication")
        said = {"shared_available": 0}
        if not packet.client_id:
            if packet.version == 4 and not packet.clean_start:
                raise ProtocolError(packets.BAD_CLIENT_ID, "a session without a client id")
            self.broker.assigned += 1
            packet.client_id = said["assigned_client_id"] = f"assigned-{self.broker.assigned}"
        if options.receive_maximum < 65535:
            said["receive_maximum"] = options.receive_maximum
        if options.maximum_packet < 268435455:
            said["maximum_packet"] = options.maximum_packet
        self.client, self.will, self.keep_alive = packet.client_id, packet.will, packet.keep_alive
        self.maximum_packet = packet.properties.get("maximum_packet", self.maximum_packet)
        is_present = self.broker.open_session(self, packet)
        self.journal.write("connected", client=self.client, version=self.version, clean=packet.clean_start, session_present=is_present,
                           open_incoming=sorted(self.session.incoming), open_outgoing=list(self.session.outgoing))
        self.send(Packet(Kind.CONNACK, session_present=is_present, properties=said))
        for again in self.session.unacknowledged():
            self.send(again)
        self.send_waiting()

    def on_publish(self, packet):
        if "subscription_id" in packet.properties:
            raise ProtocolError(packets.PROTOCOL_ERROR, "a subscription identifier from a client")
        if "topic_alias" in packet.properties:
            raise ProtocolError(packets.TOPIC_ALIAS_INVALID, "Topic Alias Maximum is 0")
        if packet.qos < 2:
            self.broker.publish(self.client, packet)
            if packet.qos == 1:
                self.send(Packet(Kind.PUBACK, packet.packet_id))
            return
        if first := self.session.on_publish_qos2(packet):
            differs = (first.topic, first.payload, first.retain) != (packet.topic, packet.payload, packet.retain)
            self.journal.write("repeat", client=self.client, packet_id=packet.packet_id, dup=packet.dup, differs=differs,
                               topic=packet.topic, payload=packet.payload.hex(), first_topic=first.topic, first_payload=first.payload.hex())
        elif self.version == 5 and len(self.session.incoming) > self.broker.options.receive_maximum:
            raise ProtocolError(packets.RECEIVE_MAXIMUM_EXCEEDED, "too many open handshakes")
        else:
            self.broker.publish(self.client, packet)
        self.send(Packet(Kind.PUBREC, packet.packet_id))

    def on_pubrel(self, packet):
        reason = self.session.on_pubrel(packet.packet_id)
        if reason:
            self.journal.write("unknown_id", client=self.client, packet=packet.kind.name, packet_id=packet.packet_id)
        self.send(Packet(Kind.PUBCOMP, packet.packet_id, reason))

    def on_acknowledgement(self, packet):
        answer, is_known = self.session.on_acknowledgement(packet)
        if not is_known:
            self.journal.write("unknown_id", client=self.client, packet=packet.kind.name, packet_id=packet.packet_id)
        if answer:
            self.send(answer)
        self.send_waiting()

    def on_subscribe(self, packet):
        """Delays the subscription with its SUBACK."""
        if self.broker.options.suback_delay_s:
            self.broker.after(self.broker.options.suback_delay_s, self.subscribe, packet)
        else:
            self.subscribe(packet)

    def subscribe(self, packet):
        if self.is_over:
            return
        identifier = packet.properties.get("subscription_id", [None])[0]
        reasons, accepted = [], []
        for topic_filter, options in packet.entries:
            if not is_filter(topic_filter):
                if self.version == 4:
                    raise ProtocolError(packets.FILTER_INVALID, f"the filter '{topic_filter}'")
                reasons.append(packets.FILTER_INVALID)
            elif self.version == 5 and topic_filter.startswith("$share/"):
                reasons.append(packets.SHARED_UNSUPPORTED)
            else:
                reasons.append(options & 3)
                accepted.append(Subscription(topic_filter, options, identifier))
        self.send(Packet(Kind.SUBACK, packet.packet_id, entries=reasons))
        for subscription in accepted:
            self.broker.subscribe(self.session, subscription)

    def on_unsubscribe(self, packet):
        found = [self.session.subscriptions.pop(topic_filter, None) for topic_filter in packet.entries]
        self.send(Packet(Kind.UNSUBACK, packet.packet_id, entries=[0 if one else packets.NO_SUBSCRIPTION for one in found]))

    def on_disconnect(self, packet):
        expiry = packet.properties.get("session_expiry")
        if expiry and self.session.expiry == 0:
            raise ProtocolError(packets.PROTOCOL_ERROR, "a session expiry for a session that has none")
        if expiry is not None:
            self.session.expiry = expiry
        if packet.reason != WITH_WILL:
            self.will = None
        self.end("DISCONNECT")

    # To the client

    def send_waiting(self):
        while not self.is_over and not self.is_pausing and (message := self.session.next_message()):
            self.give(message)
            if self.slow_s:
                self.is_pausing = True
                self.broker.after(self.slow_s, self.stop_pausing)

    def stop_pausing(self):
        self.is_pausing = False
        self.send_waiting()

    def give_qos0(self, message):
        if self.writer.transport.get_write_buffer_size() > MOST_UNWRITTEN:
            self.journal.write("dropped_qos0", client=self.client, topic=message.topic)
        else:
            self.give(message)

    def give(self, message):
        """Drops a message that is too large for the client, as if it had been sent (MQTT-3.1.2-25)."""
        if len(encode(message, self.version)) > self.maximum_packet:
            self.session.outgoing.pop(message.packet_id, None)
            self.journal.write("too_large", client=self.client, topic=message.topic)
        else:
            self.send(message)

    def send(self, packet):
        if self.is_over or self.is_mute:
            return
        then = self.broker.faults.on_packet("gave", self.client, packet.kind)
        if then:
            self.journal.write("fault", client=self.client, packet=packet.kind.name, direction="gave", then=then,
                               packet_id=packet.packet_id)
        if then in (None, "cut_after"):
            self.write(packet)
        if then in ("cut", "cut_after"):
            self.end(f"fault: {then} at {packet.kind.name}", is_cut=then == "cut")

    def write(self, packet):
        if not self.is_running.is_set():
            return self.held.append(packet)
        self.journal.packet("gave", self.client, packet)
        with contextlib.suppress(OSError):
            self.writer.write(encode(packet, self.version))

    # For the control interface

    def stand_still(self):
        self.is_running.clear()

    def go_on(self):
        self.is_running.set()
        held, self.held = self.held, []
        for packet in held:
            self.write(packet)
