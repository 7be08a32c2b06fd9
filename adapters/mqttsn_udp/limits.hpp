// SPDX-License-Identifier: Apache-2.0
// Bounds of the machine that are not configuration keys, each with its reason.
#pragma once

#include <chrono>
#include <cstddef>

#include "daemon/core/time.hpp"

namespace slamgw::mqttsn::limits {

/// Thread carries IPv6 packets of 1280 octets, less 48 of IPv6 and UDP headers (R8, R9).
constexpr std::size_t max_datagram_octets = 1232;
/// Largest DTLS record that we send, and the most octets that it adds to a message. AES-CBC adds
/// most: header, initialization vector, padding and the SHA-256 code.
constexpr std::size_t max_dtls_record_octets = 1200;
constexpr std::size_t max_dtls_overhead_octets = 80;
/// Most DTLS handshakes under way: in all, in one /64 (perhaps that of all robots), and at one
/// address. Each takes up to 300 KiB.
constexpr std::size_t max_dtls_handshakes = 256;
constexpr std::size_t max_dtls_handshakes_of_network = 128;
constexpr std::size_t max_dtls_handshakes_of_address = 8;
constexpr std::chrono::seconds dtls_handshake_patience{30};  ///< for one handshake
/// Topic ids of one client: enough for a server that listens to a few hundred robots.
constexpr std::size_t max_topics_per_client = 1024;
constexpr std::size_t max_subscriptions_per_client = 128;
/// Types that one robot may register below its own name: each takes an id of every client that
/// listens to all robots. The thesis's robots have three.
constexpr std::size_t max_types_per_robot = 128;
/// Memory for the names of all clients together, and the part that each client may have in any
/// case: a robot's two subscriptions and some 15 topics. So 10 000 clients stay far below the
/// service's 512 MiB.
constexpr std::size_t name_octets_together = 128U * 1024 * 1024;
constexpr std::size_t name_octets_for_each = 4096;
/// SUBSCRIBEs of one client that reach the broker: a burst of all its filters, then one a second.
constexpr unsigned subscribe_burst = max_subscriptions_per_client;
constexpr std::chrono::seconds subscribe_interval{1};
/// SUBACKs of one client that wait for the broker, and answers behind them that keep their order.
constexpr std::size_t max_pending_answers = 32;
/// Messages waiting for an active client (a sleeping one: `mqttsn.max_sleeping_messages`).
constexpr std::size_t max_queued_messages = 256;
constexpr std::size_t max_queued_octets = 256 * 1024;
/// Unanswered REGISTERs to one client: a fresh one, and the late ones.
constexpr std::size_t max_open_registers = 8;
/// Unanswered PUBRELs to one client.
constexpr std::size_t max_open_releases = 16;
/// Failed QoS 2 commands of one client. Far fewer can be open within `command_patience`.
constexpr std::size_t max_abandoned = 16;
/// Pause of a topic that a client does not answer: the first pause, then doubled up to the longest.
constexpr std::chrono::seconds first_set_aside{60};
constexpr std::chrono::seconds longest_set_aside{3600};
/// A message yields to others this often before its topic is set aside: on a bad radio several
/// copies in a row are lost.
constexpr unsigned max_yields = 10;
/// Remembered topics that one client left unanswered: enough for a client that listens to a fleet.
constexpr std::size_t max_set_aside = 128;
/// QoS 1 and 2 messages of one client that are not yet safe; Nordic's client has four.
constexpr std::size_t max_open_receipts = 64;
/// QoS 2 exchanges of one client between PUBLISH and PUBREL. A further one ends the oldest whose
/// message is safe, as its PUBREL may never come.
constexpr std::size_t max_inbound_qos2 = 64;
/// Remembered QoS 1 messages of one client: 30 a second for `repeat_window`, with room.
constexpr std::size_t max_repeats = 1024;
/// A QoS 1 message that is acknowledged makes its session worth a write while no more messages are
/// remembered. The sessions of a thousand faster robots would be some 6 MB a second.
constexpr std::size_t max_repeats_saved_at_once = 8;
/// Nordic's client repeats after 8 and 16 s, others after 10 and 20 (R76).
constexpr std::chrono::seconds repeat_window{25};
/// Nordic's client repeats 8 s after it has sent; 4 s of them may pass before the PUBACK leaves.
constexpr std::chrono::seconds shortest_client_retry{4};
/// N_retry is at most 5 (MQTT-SN 1.2 section 7.2): further equal messages are new, not copies.
constexpr std::uint8_t max_client_repeats = 5;
/// After this many small steps from one MsgId to the next, the client is believed to count them.
constexpr unsigned min_counted_ids = 4;
/// Will handshakes at one time; the only state that strangers can make (R10).
constexpr std::size_t max_handshakes = 1024;
/// A stored session may lose its place to another client after its client was away this long.
constexpr std::chrono::hours min_absence{24};
/// A client that sends nothing for this long after its CONNECT may lose its place. Real clients
/// register, subscribe or publish at once.
constexpr std::chrono::seconds crowd_patience{10};
/// Clients that lose their places together, so that the search for them is rare.
constexpr std::size_t crowd_step = 64;
/// T_WAIT, "more than 5 minutes": how long a client that said "congestion" is left alone.
constexpr std::chrono::seconds t_wait{310};
/// Ended sessions that were not written yet, beside one session for each of `mqttsn.max_clients`.
constexpr std::size_t max_changed = 65536;
/// Most sessions that are saved together for waiting answers, and most datagrams that wait: what a
/// fleet sends in a second. If more datagrams would wait, all of them are sent at once.
constexpr std::size_t max_sessions_for_answers = 128;
constexpr std::size_t max_unsaved_answers = 16384;
/// Assumed keep-alive of a client that gave Duration 0 (R38).
constexpr std::chrono::seconds max_supervision{3600};
/// Promise 6 of docs/topics.md gives 30 s; a second of them is for the way to the broker.
constexpr std::chrono::seconds command_patience{29};
/// Younger commands are not stored, as most end before this age. After a crash, a stored command
/// would be carried out or reported a second time.
constexpr std::chrono::milliseconds stored_command_age{300};
/// Remembered refusals, which are not logged again. Lines about new refusals are limited, too: a
/// burst, then a rate per second.
constexpr std::size_t max_logged_refusals = 4096;
/// Octets of a refused client id in the log.
constexpr std::size_t max_logged_id_octets = 64;
constexpr unsigned refusal_lines_burst = 100;
constexpr unsigned refusal_lines_per_second = 1;
/// A client id is contested after this many CONNECTs from other addresses while its client is
/// active, within this window.
constexpr unsigned contested_takeovers = 3;
constexpr std::chrono::seconds contest_window{60};
/// A CONNECT waits this long for the note of its robot.
constexpr std::chrono::seconds note_patience{2};
/// CONNECTs that wait for notes; further ones do not wait.
constexpr std::size_t max_waiting_connects = 256;
/// Notes that are made in one turn of the loop.
constexpr std::size_t notes_a_turn = 64;
/// Filters that a client unsubscribes while its former gateway's note cannot be read.
constexpr std::size_t max_dropped_before_note = 256;
/// Brokers limit messages, and a robot's session takes a few hundred octets.
constexpr std::size_t max_note_octets = 65536;
/// The core gets at most one sign of life of each client in this time.
constexpr std::chrono::seconds sign_of_life_interval{1};
/// Remembered addresses that have shown that they receive; each takes about 60 octets.
constexpr std::size_t max_validated_addresses = 65536;
/// Wrong answers of an address after which no answer validates it, and how long they count at most.
/// A blind sender who tries MsgIds then hits with a chance of 16 in 32767 a day at one address. Who
/// forges enough addresses for all 4096 records needs 65536 answers for two hits a day.
constexpr unsigned max_wrong_answers = 16;
constexpr std::chrono::hours wrong_answer_memory{24};
/// Messages waiting for a client whose address has not shown that it receives: what a robot
/// is sent while it answers its first REGISTER.
constexpr std::size_t max_queued_unvalidated = 16;
/// Answers to one stranger, and to all strangers: a burst, then a rate per second (R21, R39).
constexpr unsigned stranger_burst = 20;
constexpr unsigned stranger_per_second = 5;
constexpr unsigned strangers_burst = 2000;
constexpr unsigned strangers_per_second = 1000;

}  // namespace slamgw::mqttsn::limits
