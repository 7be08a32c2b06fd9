# SPDX-License-Identifier: Apache-2.0
"""The broker: sessions, routing, retained messages and wills, over asyncio. What each packet does is in Connection (connection.py)."""
import asyncio
import dataclasses

from packets import Kind, Packet, TAKEN_OVER
from session import FOREVER, Session, matches

PASSED_ON = ("payload_format", "message_expiry", "content_type", "response_topic", "correlation", "user_property")


@dataclasses.dataclass
class Options:
    versions: tuple = (4, 5)
    receive_maximum: int = 65535  # QoS 2 handshakes of a client that may be open at once, MQTT 5
    maximum_packet: int = 268435455
    most_queued: int = 100000  # messages that wait for one client
    overlap: str = "each"  # a copy for each subscription that matches, or "one" for all of them (section 3.3.4)
    announces_takeover: bool = True  # DISCONNECT 0x8E at a takeover; Mosquitto 2.0.11 does not
    suback_delay_s: float = 0.0


class Broker:
    def __init__(self, options, journal, faults):
        self.options, self.journal, self.faults = options, journal, faults
        self.sessions = {}  # by client id
        self.connections = {}  # by client id, open ones
        self.retained = {}  # by topic
        self.wills = {}  # by client id: (a timer, the will), of disconnected clients
        self.ends = {}  # by client id: the timer that ends the session
        self.assigned = 0

    # Start and end of connections

    def open_session(self, connection, packet):
        """Handles a CONNECT. Returns True when a session is resumed."""
        client = connection.client
        if before := self.connections.get(client):
            self.journal.write("takeover", client=client, announced=self.options.announces_takeover and before.version == 5)
            before.end("taken over by a new connection",
                       TAKEN_OVER if self.options.announces_takeover else None)
        self.connections[client] = connection
        if timer := self.ends.pop(client, None):
            timer.cancel()
        self.revoke_or_publish_will(client, packet.clean_start)
        if packet.clean_start:
            self.sessions.pop(client, None)
        is_present = client in self.sessions
        session = connection.session = self.sessions.setdefault(client, Session(client, self.options.most_queued))
        session.expiry = FOREVER if packet.version == 4 and not packet.clean_start else packet.properties.get("session_expiry", 0)
        session.receive_maximum = packet.properties.get("receive_maximum", 65535)
        return is_present

    def on_end(self, connection, will):
        """Handles the end of a connection. `will`: to publish, perhaps later, or None."""
        client, session = connection.client, connection.session
        if self.connections.get(client) is connection:
            del self.connections[client]
        if session is None or self.sessions.get(client) is not session:
            return
        if will:
            delay = min(will.properties.get("will_delay", 0), session.expiry)
            self.wills[client] = self.after(delay, self.publish_will, client), will
            if delay == 0:
                self.publish_will(client)
        if session.expiry == 0:
            self.end_session(client)
        elif session.expiry != FOREVER:
            self.ends[client] = self.after(session.expiry, self.end_session, client)

    def end_session(self, client):
        self.ends.pop(client, None)
        self.publish_will(client)
        self.sessions.pop(client, None)
        self.journal.write("session_ended", client=client)

    def revoke_or_publish_will(self, client, is_clean):
        """Withdraws a delayed will when the session is resumed (section 3.1.3.2.2)."""
        if client not in self.wills:
            return
        if is_clean:
            return self.publish_will(client)
        timer, _ = self.wills.pop(client)
        timer.cancel()
        self.journal.write("will_withdrawn", client=client)

    def publish_will(self, client):
        timer, will = self.wills.pop(client, (None, None))
        if timer:
            timer.cancel()
            self.journal.write("will", client=client, topic=will.topic)
            self.publish(client, dataclasses.replace(will, packet_id=0))

    @staticmethod
    def after(seconds, call, *arguments):
        return asyncio.get_running_loop().call_later(seconds, call, *arguments)

    # Messages

    def publish(self, publisher, packet):
        """Publishes an accepted message of a client, or its will."""
        properties = {name: packet.properties[name] for name in PASSED_ON if name in packet.properties}
        message = Packet(Kind.PUBLISH, topic=packet.topic, payload=packet.payload, qos=packet.qos, retain=packet.retain,
                         properties=properties)
        self.journal.write("accepted", client=publisher, topic=message.topic, payload=message.payload.hex(), qos=message.qos,
                           retain=message.retain)
        if message.retain:
            self.retained[message.topic] = message
            if not message.payload:
                del self.retained[message.topic]
        for session in list(self.sessions.values()):
            self.route(message, session, publisher)

    def route(self, message, session, publisher):
        found = [one for one in session.subscriptions.values() if matches(one.topic_filter, message.topic) and
                 not (one.is_no_local and session.client_id == publisher)]
        if self.options.overlap == "each":
            for one in found:
                self.deliver(message, session, [one], keeps_retain=one.keeps_retain_flag)
        elif found:
            self.deliver(message, session, found, keeps_retain=any(one.keeps_retain_flag for one in found))

    def deliver(self, message, session, subscriptions, keeps_retain):
        """Delivers one copy for these subscriptions."""
        identifiers = [one.identifier for one in subscriptions if one.identifier]
        properties = message.properties | ({"subscription_id": identifiers} if identifiers else {})
        qos = min(message.qos, max(one.qos for one in subscriptions))
        copy = dataclasses.replace(message, qos=qos, retain=message.retain and keeps_retain, properties=properties)
        connection = self.connections.get(session.client_id)
        if qos == 0:
            if connection:
                connection.give_qos0(copy)
        elif not session.add(copy):
            self.journal.write("no_room", client=session.client_id, topic=copy.topic)
        elif connection:
            connection.send_waiting()

    def subscribe(self, session, subscription):
        """Sends retained messages as section 3.8.3.1 says, independent of "retain as published"."""
        is_new = subscription.topic_filter not in session.subscriptions
        session.subscriptions[subscription.topic_filter] = subscription
        if subscription.retain_handling == 2 or subscription.retain_handling == 1 and not is_new:
            return
        for topic, message in sorted(self.retained.items()):
            if matches(subscription.topic_filter, topic):
                self.deliver(message, session, [subscription], keeps_retain=True)

    # For the control interface

    def state(self):
        return {client: {"connected": client in self.connections, "open_incoming": sorted(session.incoming),
                         "open_outgoing": list(session.outgoing), "waiting": len(session.waiting),
                         "subscriptions": sorted(session.subscriptions)} for client, session in self.sessions.items()}
