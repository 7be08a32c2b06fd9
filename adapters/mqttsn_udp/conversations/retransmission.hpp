// SPDX-License-Identifier: Apache-2.0
// Repeats requests that a client does not answer (MQTT-SN 1.2 section 6.13, R133): after the wait
// that the client's answers have taught, then ever more slowly, up to `retry_interval`. A request
// is given up after `retry_interval` times (`retry_count` + 1), so what the keys allow stays the
// same however short the first waits are.
#pragma once

#include "adapters/mqttsn_udp/clients/delivery.hpp"
#include "adapters/mqttsn_udp/conversations/conversation.hpp"

namespace slamgw::mqttsn {

/// The request leaves for the first time (or again, after it has rested).
Attempt begin_attempt(const Settings& settings, const Delivery& delivery, std::uint16_t msg_id,
                      TimePoint now);

enum class Due : std::uint8_t {
  nothing,  ///< its time has not come
  repeat,   ///< it is to be sent once more
  give_up,  ///< it was sent often enough
};
/// Takes note of the repetition that it asks for.
Due check_attempt(const Settings& settings, Attempt& attempt, TimePoint now);

/// The client has answered this request.
void on_answered(Delivery& delivery, const Attempt& attempt, TimePoint now);

/// The second half of a QoS 2 delivery: PUBREL until PUBCOMP (MQTT-SN 1.2 section 6.6). The client
/// has the message by then, so a PUBREL that stays unanswered holds nothing back.
class Release : Conversation {
 public:
  explicit Release(const Conversation& common) : Conversation(common) {}

  void begin(ClientSession& session, std::uint16_t msg_id, TimePoint now);
  /// A repeated PUBREC: answered, and the repetitions go on as they were. False when there is no
  /// such release.
  bool on_pubrec(ClientSession& session, std::uint16_t msg_id);
  /// False when there is no such release.
  static bool on_pubcomp(Delivery& delivery, std::uint16_t msg_id, TimePoint now);

  /// The next message waits for this PUBCOMP, as long as it can come any moment.
  static bool is_fresh(const Delivery& delivery);
  /// Nothing is sent until `resume()`.
  static void rest(Delivery& delivery);
  /// Sends what rests, once the client was heard since it was last sent.
  void resume(ClientSession& session, TimePoint now);

  /// Repeats what is due. True when the client has not answered and said nothing else meanwhile.
  bool on_time(ClientSession& session, TimePoint now);
  static std::optional<TimePoint> next_time(const Delivery& delivery);
};

}  // namespace slamgw::mqttsn
