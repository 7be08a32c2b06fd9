// SPDX-License-Identifier: Apache-2.0
// Repeats requests that a client does not answer (MQTT-SN 1.2 section 6.13, R133). The first wait
// is learned from the client's answers; later waits grow up to `retry_interval`. A request is given
// up after `retry_interval` times (`retry_count` + 1), however short the first waits are. So the
// keys of the configuration keep their meaning.
#pragma once

#include "adapters/mqttsn_udp/clients/delivery.hpp"
#include "adapters/mqttsn_udp/conversations/conversation.hpp"

namespace slamgw::mqttsn {

/// Begins a request that is sent for the first time, or again after it has rested.
Attempt begin_attempt(const Settings& settings, const Delivery& delivery, std::uint16_t msg_id,
                      TimePoint now);

enum class Due : std::uint8_t {
  nothing,  ///< its time has not come
  repeat,   ///< it is to be sent once more
  give_up,  ///< it was sent often enough
};
/// Returns what is due, and counts a repetition that it asks for.
Due check_attempt(const Settings& settings, Attempt& attempt, TimePoint now);

/// Call when the client has answered this request.
void on_answered(Delivery& delivery, const Attempt& attempt, TimePoint now);

/// The second half of a QoS 2 delivery: PUBREL until PUBCOMP (MQTT-SN 1.2 section 6.6). The client
/// has the message already, so a PUBREL that stays unanswered holds nothing back.
class Release : Conversation {
 public:
  explicit Release(const Conversation& common) : Conversation(common) {}

  /// Sends the first PUBREL.
  void begin(ClientSession& session, std::uint16_t msg_id, TimePoint now);
  /// Answers a repeated PUBREC; the repetitions go on as they were. Returns false if there is no
  /// such release.
  bool on_pubrec(ClientSession& session, std::uint16_t msg_id);
  /// Returns false if there is no such release.
  static bool on_pubcomp(Delivery& delivery, std::uint16_t msg_id, TimePoint now);

  /// True while a PUBCOMP can come at any moment: the next message waits for it.
  static bool is_fresh(const Delivery& delivery);
  /// Sends nothing until `resume()`.
  static void rest(Delivery& delivery);
  /// Sends the resting PUBRELs, once the client was heard since their last transmission.
  void resume(ClientSession& session, TimePoint now);

  /// Repeats PUBRELs that are due. Returns true if one was given up and the client sent nothing
  /// since it began.
  bool on_time(ClientSession& session, TimePoint now);
  static std::optional<TimePoint> next_time(const Delivery& delivery);
};

}  // namespace slamgw::mqttsn
