// SPDX-License-Identifier: Apache-2.0
// The bounds of the machine that are no configuration keys, each with its reason.
#pragma once

#include <chrono>
#include <cstddef>

#include "daemon/core/time.hpp"

namespace slamgw::mqttsn::limits {

/// Thread carries IPv6 packets of 1280 octets, less 48 of IPv6 and UDP headers (R8, R9).
constexpr std::size_t max_datagram_octets = 1232;
/// A DTLS record that we send, and what it adds to a message at most: with AES-CBC its header, the
/// initialization vector, the padding and the code of SHA-256.
constexpr std::size_t max_dtls_record_octets = 1200;
constexpr std::size_t max_dtls_overhead_octets = 80;
/// DTLS handshakes that are under way, each up to 300 KiB: in all, in one /64, which may be that of
/// all robots, and at one address; and how long one may take.
constexpr std::size_t max_dtls_handshakes = 256;
constexpr std::size_t max_dtls_handshakes_of_network = 128;
constexpr std::size_t max_dtls_handshakes_of_address = 8;
constexpr std::chrono::seconds dtls_handshake_patience{30};
/// Topic ids of one client. A server that listens to a few hundred robots fits.
constexpr std::size_t max_topics_per_client = 1024;
constexpr std::size_t max_subscriptions_per_client = 128;
/// Types that one robot may register below its own name: each takes an id of every client that
/// listens to all robots. The thesis's robots have three.
constexpr std::size_t max_types_per_robot = 128;
/// Memory for the names of all clients together, and what each may have in any case (a robot's two
/// subscriptions and some 15 topics): 10 000 clients stay far below the service's 512 MiB.
constexpr std::size_t name_octets_together = 128U * 1024 * 1024;
constexpr std::size_t name_octets_for_each = 4096;
/// SUBSCRIBEs of one client that reach the broker: all that it may have at once, then one a second.
constexpr unsigned subscribe_burst = max_subscriptions_per_client;
constexpr std::chrono::seconds subscribe_interval{1};
/// SUBACKs that wait for the broker, and answers that wait behind them to keep their order.
constexpr std::size_t max_pending_answers = 32;
/// Messages waiting for an active client (a sleeping one: `mqttsn.max_sleeping_messages`).
constexpr std::size_t max_queued_messages = 256;
constexpr std::size_t max_queued_octets = 256 * 1024;
/// REGISTERs to one client that it has not answered: one, and those that are late.
constexpr std::size_t max_open_registers = 8;
/// PUBRELs to one client that it has not answered.
constexpr std::size_t max_open_releases = 16;
/// Failed QoS 2 commands of one client; as many as can be open in `command_patience` is far less.
constexpr std::size_t max_abandoned = 16;
/// How long a client is spared a topic that it does not answer: at first, doubled, at most.
constexpr std::chrono::seconds first_set_aside{60};
constexpr std::chrono::seconds longest_set_aside{3600};
/// Topics that one client left unanswered and whose failures are remembered: a listener to a fleet.
constexpr std::size_t max_set_aside = 128;
/// QoS 1 and 2 messages of one client that are not yet safe; Nordic's client has four.
constexpr std::size_t max_open_receipts = 64;
/// QoS 2 exchanges of one client between PUBLISH and PUBREL.
constexpr std::size_t max_inbound_qos2 = 64;
/// Remembered QoS 1 messages of one client: 30 a second for `repeat_window`, with room.
constexpr std::size_t max_repeats = 1024;
/// Nordic's client repeats after 8 and 16 s, others after 10 and 20 (R76).
constexpr std::chrono::seconds repeat_window{25};
/// Nordic's client repeats 8 s after it has sent; 4 s of them may pass before the PUBACK leaves.
constexpr std::chrono::seconds shortest_client_retry{4};
/// N_retry is at most 5 (MQTT-SN 1.2 section 7.2): more copies are messages that equal each other.
constexpr std::uint8_t max_client_repeats = 5;
/// Small steps from one MsgId to the next, after which a client is believed to count them.
constexpr unsigned min_counted_ids = 4;
/// Will handshakes at one time; the only state that strangers can make (R10).
constexpr std::size_t max_handshakes = 1024;
/// A stored session may make room for another client after so long without a word.
constexpr std::chrono::hours min_absence{24};
/// A client that says nothing after its CONNECT for so long may have to give way. Real ones
/// register, subscribe or publish at once.
constexpr std::chrono::seconds crowd_patience{10};
/// Clients that give way together, so that all are looked through only now and then.
constexpr std::size_t crowd_step = 64;
/// T_WAIT, "more than 5 minutes": how long a client that said "congestion" is left alone.
constexpr std::chrono::seconds t_wait{310};
/// Changed sessions that were not written yet.
constexpr std::size_t max_dirty = 65536;
/// Sessions that are saved together for the answers that wait, and datagrams that wait: what a
/// fleet asks in a second. With more of them none waits any longer.
constexpr std::size_t max_sessions_for_answers = 128;
constexpr std::size_t max_unsaved_answers = 16384;
/// Supervision of a client that gave Duration 0 (R38).
constexpr std::chrono::seconds max_supervision{3600};
/// Promise 6 of docs/topics.md gives 30 s; a second of them is for the way to the broker.
constexpr std::chrono::seconds command_patience{29};
constexpr std::size_t max_tracked_commands = 65536;
/// Most commands have ended by then. A younger one is not stored: after a crash it would be told,
/// or carried out, a second time.
constexpr std::chrono::milliseconds stored_command_age{300};
/// Clients whose refusals were logged and are not logged again, and how many of such lines are
/// written at most: a burst, then so many a second.
constexpr std::size_t max_logged_refusals = 4096;
/// Octets of a refused client id in the log.
constexpr std::size_t max_logged_id_octets = 64;
constexpr unsigned refusal_lines_burst = 100;
constexpr unsigned refusal_lines_per_second = 1;
/// CONNECTs from another address while a client is active: with so many in so much time its id is
/// contested.
constexpr unsigned contested_takeovers = 3;
constexpr std::chrono::seconds contest_window{60};
/// A CONNECT waits so long for the note of its robot.
constexpr std::chrono::seconds note_patience{2};
/// CONNECTs that wait for notes; more do not wait.
constexpr std::size_t max_waiting_connects = 256;
/// From a change to the note about it; and notes that are made in one turn of the loop.
constexpr std::chrono::seconds note_interval{1};
constexpr std::size_t notes_a_turn = 64;
/// Brokers limit messages, and a robot's session takes a few hundred octets.
constexpr std::size_t max_note_octets = 65536;
/// One sign of life of each client is reported to the core in so much time.
constexpr std::chrono::seconds sign_of_life_interval{1};
/// Addresses that have shown that they receive; an IPv6 one takes about 60 octets here.
constexpr std::size_t max_validated_addresses = 65536;
/// Messages waiting for a client whose address has not shown that it receives: what a robot
/// is sent while it answers its first REGISTER.
constexpr std::size_t max_queued_unvalidated = 16;
/// Answers to one stranger, and to all: a burst, then so many a second (R21, R39).
constexpr unsigned stranger_burst = 20;
constexpr unsigned stranger_per_second = 5;
constexpr unsigned strangers_burst = 2000;
constexpr unsigned strangers_per_second = 1000;

}  // namespace slamgw::mqttsn::limits
