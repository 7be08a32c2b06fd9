// SPDX-License-Identifier: Apache-2.0
// REGISTER from the gateway to a client, before the first PUBLISH on a topic whose id the client
// does not know (MQTT-SN 1.2 sections 6.5 and 6.10, R65-R69). A topic that the client does not
// answer is set aside for this client, with a growing pause, while other topics go on.
#pragma once

#include <string>

#include "adapters/mqttsn_udp/conversations/conversation.hpp"
#include "adapters/mqttsn_udp/conversations/retransmission.hpp"

namespace slamgw::mqttsn {

class TopicRegistration : Conversation {
 public:
  explicit TopicRegistration(const Conversation& common) : Conversation(common) {}

  enum class Readiness : std::uint8_t {
    ready,          ///< the client knows the id
    waits,          ///< for a REGACK that is late, for its turn, or for the end of a pause
    waits_shortly,  ///< for a REGACK that can come any moment
    is_held,        ///< the address must show that it receives first
    impossible,     ///< the client has no topic id left
  };
  /// Whether the client must learn the topic id of `outgoing` before it is published.
  static bool is_needed(const ClientSession& session, const Outgoing& outgoing);
  /// Whether `outgoing` can be published now. Sends the REGISTER that it needs.
  Readiness prepare(ClientSession& session, const Outgoing& outgoing, TimePoint now);
  /// Registers a short topic, only to learn whether the client receives.
  void probe(ClientSession& session, TimePoint now);
  /// Sends the repeats that the allowance has held back.
  void resume_withheld(ClientSession& session);
  /// Returns the size of the REGISTER that probe() sends.
  std::size_t probe_octets() const;
  /// Returns the topic id of a message that is ready, and marks the id as used.
  static std::optional<std::uint16_t> topic_id(ClientSession& session, const Outgoing& outgoing);

  /// Returns the topic of the answered REGISTER; nothing when no such REGISTER is open (R68) or the
  /// client is congested.
  std::optional<std::string> on_regack(ClientSession& session, const Regack& regack, TimePoint now);

  struct Unanswered {
    std::string topic;       ///< set aside from now on
    bool was_heard = false;  ///< the client sent something else since
  };
  /// Repeats REGISTERs that are due. Gives up and returns those that were repeated often enough.
  std::vector<Unanswered> on_time(ClientSession& session, TimePoint now);
  static std::optional<TimePoint> next_time(const Delivery& delivery);

  /// Sets aside a topic whose messages the client has left unanswered since `begun`. The first
  /// time, until the client is heard, if it was not heard since.
  void set_aside(ClientSession& session, const std::string& topic, TimePoint begun, TimePoint now);
  static bool is_set_aside(const Delivery& delivery, const std::string& topic);
  /// Whether messages on the topic were unanswered, and none was delivered since.
  static bool has_failed(const Delivery& delivery, const std::string& topic);
  static void on_delivered(Delivery& delivery, const std::string& topic);
  /// Call when the client is heard: topics that waited for any sign of life are tried again.
  static void on_heard(Delivery& delivery);

 private:
  std::string probe_topic() const;
  void begin(ClientSession& session, std::uint16_t topic_id, TimePoint now);
  void transmit(const ClientSession& session, Registering& registering);
  void notify_set_aside(ClientSession& session, const std::string& topic, Duration pause);
};

}  // namespace slamgw::mqttsn
