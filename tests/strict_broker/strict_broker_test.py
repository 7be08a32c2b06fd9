# SPDX-License-Identifier: Apache-2.0
"""The strict broker obeys MQTT, with Mosquitto's clients and with a client that violates it. Run as a test (ctest -R StrictBroker)."""
import pathlib
import subprocess
import sys
import tempfile
import unittest

sys.path.insert(0, str(pathlib.Path(__file__).parent))
from harness import PATIENCE_S, Client, StrictBroker, wait_for  # noqa: E402
from packets import Kind  # noqa: E402

BOTH = 4, 5


class WithBroker(unittest.TestCase):
    options = ()

    def setUp(self):
        directory = tempfile.TemporaryDirectory()
        self.addCleanup(directory.cleanup)
        self.directory = pathlib.Path(directory.name)
        self.broker = StrictBroker(directory.name, *self.options)
        self.addCleanup(self.broker.end)

    def client(self, name=None, version=5, **connect):
        client = Client(self.broker.port, version)
        self.addCleanup(client.close)
        if name:
            client.answer = client.connect(name, **connect)
        return client

    def round_trip(self, client):
        client.send(0xC0)
        client.expect(Kind.PINGRESP)


class MosquittosClients(WithBroker):
    def publish(self, *arguments, text=None):
        subprocess.run(["mosquitto_pub", "-p", str(self.broker.port), *arguments], input=text, timeout=PATIENCE_S, check=True)

    def subscriber(self, *arguments):
        out = self.directory / f"out{len(list(self.directory.iterdir()))}"
        subscribed = len(self.broker.journal("gave", packet="SUBACK"))
        with open(out, "wb") as file:
            process = subprocess.Popen(["mosquitto_sub", "-p", str(self.broker.port), *arguments], stdout=file)
        self.addCleanup(process.wait)
        self.addCleanup(process.kill)
        wait_for(lambda: len(self.broker.journal("gave", packet="SUBACK")) > subscribed)
        return process, lambda: out.read_text().splitlines()

    def test_pass_messages_of_each_qos_in_each_version(self):
        for version in "311", "5":
            for qos in "0", "1", "2":
                _, lines = self.subscriber("-V", version, "-q", qos, "-t", f"slam/{version}/{qos}/#", "-F", "%q %t %p")
                self.publish("-V", version, "-q", "2", "-t", f"slam/{version}/{qos}/x", "-l", text=b"1\n2\n3\n")
                wait_for(lambda lines=lines: len(lines()) == 3)
                self.assertEqual(lines(), [f"{qos} slam/{version}/{qos}/x {n}" for n in (1, 2, 3)])
        for client, state in self.broker.order("state")["sessions"].items():
            self.assertEqual((state["open_incoming"], state["open_outgoing"]), ([], []), client)

    def test_pass_thousands_of_qos_2_messages_without_a_repeat(self):
        _, lines = self.subscriber("-V", "5", "-q", "2", "-t", "many")
        self.publish("-V", "5", "-q", "2", "-t", "many", "-l", text="".join(f"{n}\n" for n in range(2000)).encode())
        wait_for(lambda: len(lines()) == 2000)
        self.assertEqual(lines(), [str(n) for n in range(2000)])
        self.assertEqual(self.broker.journal("repeat"), [])

    def test_receive_messages_that_came_while_they_were_away(self):
        for version, keep in ("311", ["-c"]), ("5", ["-c", "-x", "60"]):
            name = f"sleeper{version}"
            process, _ = self.subscriber("-V", version, *keep, "-i", name, "-q", "1", "-t", name)
            process.terminate()
            process.wait()
            self.publish("-q", "1", "-t", name, "-m", "waited")
            _, lines = self.subscriber("-V", version, *keep, "-i", name, "-q", "1", "-t", name)
            wait_for(lambda lines=lines: lines() == ["waited"])
            self.assertTrue(self.broker.journal("connected", client=name)[1]["session_present"])

    def test_get_retained_messages_and_wills(self):
        self.publish("-r", "-q", "1", "-t", "kept", "-m", "old")
        _, lines = self.subscriber("-V", "5", "-q", "1", "-t", "#", "-F", "%r %t %p")
        wait_for(lambda: lines() == ["1 kept old"])
        process, _ = self.subscriber("-V", "5", "--will-topic", "gone", "--will-payload", "bye", "-i", "mortal", "-t", "nothing")
        process.kill()
        wait_for(lambda: lines()[1:] == ["0 gone bye"])
        self.publish("-r", "-n", "-q", "1", "-t", "kept")
        _, later = self.subscriber("-V", "5", "-q", "1", "-t", "kept")
        self.publish("-q", "1", "-t", "kept", "-m", "new")
        wait_for(lambda: later() == ["new"])

    def test_repeat_unacknowledged_messages_after_a_cut(self):
        """libmosquitto keeps its packet ids as long as the program runs."""
        _, lines = self.subscriber("-V", "5", "-q", "2", "-t", "cut", "-x", "60", "-i", "listener", "-c")
        for packet in "PUBREC", "PUBCOMP":
            self.broker.order("fault", packet=packet, direction="gave", then="cut", nth=5, client="talker")
        self.publish("-V", "5", "-i", "talker", "-c", "-x", "60", "-q", "2", "-t", "cut", "-l", text="".join(f"{n}\n" for n in range(30)).encode())
        wait_for(lambda: len(lines()) >= 30)
        self.assertEqual(lines(), [str(n) for n in range(30)])
        self.assertEqual(len(self.broker.journal("fault")), 2)
        self.assertEqual([one["differs"] for one in self.broker.journal("repeat")], [False] * len(self.broker.journal("repeat")))


class Qos2(WithBroker):
    def test_a_publish_with_an_id_in_use_is_a_repeat_with_any_payload(self):
        for version in BOTH:
            client = self.client(f"c{version}", version)
            for payload, dup in (b"one", False), (b"one", True), (b"two", False):
                client.publish("t", payload, 2, 7, dup)
                self.assertEqual(client.expect_acknowledgement(Kind.PUBREC), (7, 0))
            client.acknowledge(Kind.PUBREL, 7)
            self.assertEqual(client.expect_acknowledgement(Kind.PUBCOMP), (7, 0))
            client.publish("t", b"three", 2, 7)
            client.expect(Kind.PUBREC)
            accepted = [one["payload"] for one in self.broker.journal("accepted", client=f"c{version}")]
            self.assertEqual(accepted, [b"one".hex(), b"three".hex()])
            self.assertEqual([one["differs"] for one in self.broker.journal("repeat", client=f"c{version}")], [False, True])

    def test_open_ids_outlive_the_connection_only_with_the_session(self):
        for clean, count in (False, 1), (True, 2):
            first = self.client("c", session_expiry=60)
            first.publish("t", b"one", 2, 1)
            first.expect(Kind.PUBREC)
            first.close()
            again = self.client("c", clean=clean, session_expiry=60)
            self.assertEqual(again.answer, (not clean, 0))
            before = len(self.broker.journal("accepted"))
            again.publish("t", b"two", 2, 1)
            again.expect(Kind.PUBREC)
            self.assertEqual(len(self.broker.journal("accepted")) - before, count - 1)

    def test_a_pubrel_for_an_unknown_id_is_answered(self):
        client = self.client("c")
        client.acknowledge(Kind.PUBREL, 9)
        self.assertEqual(client.expect_acknowledgement(Kind.PUBCOMP), (9, 0x92))

    def test_unacknowledged_messages_are_sent_again_at_the_next_connection(self):
        client = self.client("c", session_expiry=60)
        client.subscribe(("t", 2))
        talker = self.client("talker")
        for n in range(3):
            talker.publish("t", b"%d" % n, 2, n + 1)
            talker.expect(Kind.PUBREC)
        ids = [client.expect_publish()[3] for _ in range(3)]
        client.acknowledge(Kind.PUBREC, ids[0])
        client.expect(Kind.PUBREL)
        client.close()
        again = self.client("c", clean=False, session_expiry=60)
        self.assertEqual(again.expect_acknowledgement(Kind.PUBREL), (ids[0], 0))
        self.assertEqual([again.expect_publish()[1:5] for _ in range(2)], [(b"1", 2, ids[1], True), (b"2", 2, ids[2], True)])

    def test_at_most_the_receive_maximum_is_sent(self):
        client = self.client("c", receive_maximum=2)
        client.subscribe(("t", 1))
        talker = self.client("talker")
        for n in range(4):
            talker.publish("t", b"%d" % n, 1, n + 1)
            talker.expect(Kind.PUBACK)
        ids = [client.expect_publish()[3] for _ in range(2)]
        self.round_trip(client)
        client.acknowledge(Kind.PUBACK, ids[1])
        self.assertEqual(client.expect_publish()[1], b"2")
        self.round_trip(client)


class Sessions(WithBroker):
    def test_a_takeover_sends_a_disconnect_in_mqtt_5_only(self):
        for version, reason in (5, 0x8E), (4, None):
            old = self.client("c", version)
            self.client("c", version)
            self.assertEqual(old.expect_end(), reason)

    def test_a_session_ends_with_its_expiry(self):
        self.client("none").close()
        wait_for(lambda: self.broker.journal("session_ended", client="none"))
        self.client("short", session_expiry=1).close()
        wait_for(lambda: self.broker.journal("session_ended", client="short"))
        self.assertEqual(self.client("short", clean=False).answer, (False, 0))
        leaver = self.client("leaver", session_expiry=60)
        leaver.send(0xE0, b"\0\5\x11\0\0\0\0")
        wait_for(lambda: self.broker.journal("session_ended", client="leaver"))
        self.client("old", 4, clean=False).close()
        self.assertEqual(self.client("old", 4, clean=False).answer, (True, 0))

    def test_a_delayed_will_is_withdrawn_when_the_session_is_resumed(self):
        listener = self.client("listener")
        listener.subscribe(("gone/#", 0))
        for name, clean in ("back", False), ("clean", True):
            self.client(name, session_expiry=60, will=(f"gone/{name}", b"bye", 1, False), will_properties={"will_delay": 60}).close()
            wait_for(lambda name=name: self.broker.journal("closed", client=name))
            self.client(name, clean=clean, session_expiry=60)
        self.assertEqual(listener.expect_publish()[0], "gone/clean")
        self.assertEqual(len(self.broker.journal("will_withdrawn", client="back")), 1)
        polite = self.client("polite", will=("gone/polite", b"", 0, False))
        polite.send(0xE0)
        rude = self.client("rude", will=("gone/rude", b"", 0, False))
        rude.send(0xE0, b"\4")
        self.assertEqual(listener.expect_publish()[0], "gone/rude")

    def test_retain_handling_of_subscriptions_is_obeyed(self):
        self.client("talker").publish("kept", b"x", retain=True)
        wait_for(lambda: self.broker.journal("accepted"))
        for options, count in (0x00, 2), (0x10, 1), (0x20, 0):
            client = self.client("listener", session_expiry=0)
            for _ in range(2):
                client.subscribe(("kept", options), packet_id=3) if count == 0 else client.send(
                    0x82, b"\0\3\0\0\4kept" + bytes([options]))
            got = 0
            client.send(0xC0)
            while (taken := client.next())[0] >> 4 != Kind.PINGRESP:
                got += taken[0] >> 4 == Kind.PUBLISH and taken[0] & 1
            self.assertEqual(got, count, hex(options))

    def test_no_local_and_retain_as_published_are_obeyed(self):
        client = self.client("c")
        client.subscribe(("t/#", 0x04))
        other = self.client("other")
        other.subscribe(("t/#", 0x08))
        client.publish("t/1", b"x", retain=True)
        self.assertTrue(other.expect_publish()[5])
        self.round_trip(client)

    def test_overlapping_subscriptions_get_a_copy_each_with_its_identifier(self):
        client = self.client("c")
        client.subscribe(("t/#", 0), subscription_id=[3])
        client.subscribe(("t/+", 1), subscription_id=[4])
        self.client("talker").publish("t/1", b"x", 1, 1)
        self.assertEqual(sorted((one[2], one[6]) for one in (client.expect_publish(), client.expect_publish())), [(0, b"\x0b\3"), (1, b"\x0b\4")])

    def test_a_slowed_and_stopped_client_gets_all_messages_in_the_end(self):
        client = self.client("c")
        client.subscribe(("t", 1))
        self.broker.order("slow", client="c", seconds=0.01)
        self.broker.order("stop", client="c")
        talker = self.client("talker")
        for n in range(5):
            talker.publish("t", b"%d" % n, 1, n + 1)
            talker.expect(Kind.PUBACK)
        self.broker.order("continue", client="c")
        self.assertEqual([client.expect_publish()[1] for _ in range(5)], [b"0", b"1", b"2", b"3", b"4"])

    def test_a_delayed_suback_comes_after_later_answers(self):
        self.broker.order("suback_delay", seconds=0.2)
        client = self.client("c")
        client.send(0x82, b"\0\1\0\0\1t\0")
        self.round_trip(client)
        client.expect(Kind.SUBACK)


class OneCopy(WithBroker):
    options = "--overlap", "one", "--silent-takeover", "--mqtt", "5", "--receive-maximum", "2"

    def test_overlapping_subscriptions_get_one_copy_with_all_identifiers(self):
        client = self.client("c")
        client.subscribe(("t/#", 0), subscription_id=[3])
        client.subscribe(("t/+", 1), subscription_id=[4])
        self.client("talker").publish("t/1", b"x", 2, 1)
        self.assertEqual(client.expect_publish()[2::4], (1, b"\x0b\3\x0b\4"))

    def test_silent_takeover_receive_maximum_and_version_options(self):
        old = self.client("c")
        new = self.client("c")
        self.assertIsNone(old.expect_end())
        for packet_id in 1, 2, 3:
            new.publish("t", b"", 2, packet_id)
        self.assertEqual([new.expect_acknowledgement(Kind.PUBREC)[0] for _ in range(2)], [1, 2])
        self.assertEqual(new.expect_end(), 0x93)
        self.assertEqual(self.client("c", 4).answer, (False, 1))


class Faults(WithBroker):
    def test_an_acknowledgement_is_lost_alone_or_with_the_connection(self):
        client = self.client("c")
        self.broker.order("fault", packet="PUBACK", direction="gave", then="drop", nth=2)
        for packet_id in 1, 2, 3:
            client.publish("t", b"", 1, packet_id)
        self.assertEqual([client.expect_acknowledgement(Kind.PUBACK)[0] for _ in range(2)], [1, 3])
        for direction, then, accepted in ("gave", "cut", 1), ("got", "cut", 0), ("got", "cut_after", 1), ("got", "drop", 0):
            client = self.client("c")
            before = len(self.broker.journal("accepted"))
            self.broker.order("fault", packet="PUBACK" if direction == "gave" else "PUBLISH", direction=direction, then=then, client="c")
            client.publish("t", b"", 1, 9)
            if then == "drop":
                self.round_trip(client)
            else:
                self.assertIsNone(client.next())
            self.assertEqual(len(self.broker.journal("accepted")) - before, accepted, (direction, then))
        self.assertEqual(self.broker.order("clear_faults"), {"left": 0})

    def test_an_invalid_order_is_refused(self):
        with self.assertRaisesRegex(AssertionError, "a fault is one of"):
            self.broker.order("fault", packet="PUBACK", direction="up", then="drop")
        with self.assertRaisesRegex(AssertionError, "do_dance"):
            self.broker.order("dance")


class Forbidden(WithBroker):
    """(first octet, body, MQTT 5's reason)"""
    CASES = {
        "a second CONNECT": (0x10, b"\0\4MQTT\5\2\0\0\0\0\1c", 0x82),
        "packet id 0": (0x32, b"\0\1t\0\0\0", 0x82),
        "QoS 3": (0x36, b"\0\1t\0\1\0", 0x81),
        "DUP with QoS 0": (0x38, b"\0\1t\0", 0x81),
        "a wildcard in a topic name": (0x30, b"\0\1#\0", 0x90),
        "an empty topic name": (0x30, b"\0\0\0", 0x90),
        "invalid UTF-8": (0x30, b"\0\1\xff\0", 0x81),
        "U+0000": (0x30, b"\0\1\0\0", 0x81),
        "a topic alias": (0x30, b"\0\1t\3\x23\0\1", 0x94),
        "a subscription identifier from a client": (0x30, b"\0\1t\2\x0b\1", 0x82),
        "an unknown property": (0x30, b"\0\1t\2\x7f\1", 0x81),
        "a property twice": (0x30, b"\0\1t\4\1\0\1\0", 0x82),
        "a property of another packet": (0x30, b"\0\1t\5\x11\0\0\0\1", 0x82),
        "flags of PUBREL": (0x60, b"\0\1", 0x81),
        "flags of SUBSCRIBE": (0x80, b"\0\1\0\0\1t\0", 0x81),
        "SUBSCRIBE without a filter": (0x82, b"\0\1\0", 0x82),
        "reserved subscription options": (0x82, b"\0\1\0\0\1t\x40", 0x81),
        "a truncated packet": (0x82, b"\0", 0x81),
        "octets after the end": (0xC0, b"\0", 0x81),
        "a packet that only a broker sends": (0xD0, b"", 0x82),
        "packet type 0": (0x00, b"", 0x81),
        "a session expiry at the end of none": (0xE0, b"\0\5\x11\0\0\0\5", 0x82),
    }

    def test_is_refused_with_a_reason(self):
        for name, (first, body, reason) in self.CASES.items():
            with self.subTest(name):
                client = self.client("c")
                client.send(first, body)
                self.assertEqual(client.expect_end(), reason)

    def test_is_refused_in_mqtt_3_1_1(self):
        for first, body in (0x36, b"\0\1t\0\1"), (0x32, b"\0\1t\0\0"), (0x82, b"\0\1\0\1t\4"), (0x82, b"\0\1\0\3a#b\0"), (0x20, b"\0\0"):
            client = self.client("c", 4)
            client.send(first, body)
            self.assertIsNone(client.expect_end())

    def test_an_acknowledgement_of_the_wrong_kind_ends_the_connection(self):
        for qos, kind in (1, Kind.PUBREC), (2, Kind.PUBACK), (2, Kind.PUBCOMP):
            client = self.client("c")
            client.subscribe(("t", qos))
            client.publish("t", b"", qos, 1)
            answers = [client.next() for _ in range(2)]
            packet_id = next(int.from_bytes(body[3:5], "big") for first, body in answers if first >> 4 == Kind.PUBLISH)
            client.acknowledge(kind, packet_id)
            self.assertEqual(client.expect_end(), 0x82)

    def test_filters_are_answered_one_by_one(self):
        self.assertEqual(self.client("c").subscribe(("a/#/b", 0), ("$share/g/t", 1), ("a/+", 2)), [0x8F, 0x9E, 2])

    def test_an_invalid_connect_is_refused(self):
        for body, answer in ((b"\0\4MQTT\3\2\0\0\0\1c", b"\0\x84\0"), (b"\0\4MQTT\5\3\0\0\0\0\1c", b"\0\x81\0"),
                             (b"\0\4MQTT\4\0\0\0\0\0", b"\0\2"), (b"\0\4MQTT\5\2\0\0\3\x21\0\0\0\1c", b"\0\x82\0")):
            client = self.client()
            client.send(0x10, body)
            self.assertEqual(client.next()[1], answer)
            self.assertIsNone(client.next())
        client = self.client()
        client.send(0xC0)
        self.assertEqual(client.expect(Kind.CONNACK)[1][1], 0x82)

    def test_silence_beyond_the_keep_alive_ends_the_connection(self):
        client = self.client("c", keep_alive=1)
        self.assertEqual(client.expect_end(), 0x8D)


if __name__ == "__main__":
    unittest.main()
