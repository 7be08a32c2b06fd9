// SPDX-License-Identifier: Apache-2.0
// PUBLISH from clients (MQTT-SN 1.2 section 6.6): goes up as a Report with a receipt, and is
// acknowledged when the receipt fires, never before. Repetitions do not go up again (R75, R76).
// Also REGISTER, with which a client asks for the ids of its topics.
#pragma once

#include <functional>
#include <string>
#include <unordered_map>
#include <utility>

#include "adapters/mqttsn_udp/conversations/subscriptions.hpp"
#include "daemon/core/recycling_allocator.hpp"

namespace slamgw::mqttsn {

class Uplink : Conversation {
 public:
  Uplink(const Conversation& common, Answers& answers) : Conversation(common), answers_(answers) {}

  /// Handles REGISTER (MQTT-SN 1.2 section 6.5). TopicRegistration is the opposite direction.
  void on_register(ClientSession& session, const Register& request, TimePoint now);
  void on_publish(ClientSession& session, Publish publish, TimePoint now);
  void on_pubrel(ClientSession& session, const Pubrel& pubrel, TimePoint now);
  /// Handles QoS -1 from any address; `session` may be null. Never answered (R81).
  void on_unconnected_publish(const Peer& peer, const ClientSession* session, Publish publish,
                              TimePoint now);
  /// Unknown receipts (of a session that is gone) are ignored.
  void on_receipt(std::uint64_t receipt_id, ReceiptOutcome outcome, TimePoint now);

 private:
  bool may_publish(ClientSession& session, const std::string& topic, TimePoint now);
  bool may_listen_to(const ClientSession& session, const std::string& topic) const;
  std::string own_root(const ClientSession& session) const;
  bool makes_too_many_types(ClientSession& session, const std::string& topic, TimePoint now);
  std::string name_of(ClientSession& session, const Publish& publish) const;
  void refuse_topic_id(const ClientSession& session, const Publish& publish, TimePoint now);
  Result<std::string, ReturnCode> topic_of(ClientSession& session, const Publish& publish,
                                           TimePoint now);
  void publish_with_receipt(ClientSession& session, Publish publish, std::string topic,
                            TimePoint now);
  void report(const ClientSession& session, Publish publish, std::string topic, Receipt receipt);
  void on_safe(ClientSession& session, std::uint64_t receipt_id, TimePoint now);
  void on_refused(ClientSession& session, std::uint64_t receipt_id);
  void acknowledge(const ClientSession& session, const RepeatFilter::Entry& message, bool is_qos2);
  void refuse(ClientSession& session, const Publish& publish, ReturnCode code);
  void report_repeat(const ClientSession& session, const Publish& publish, std::string topic);

  Answers& answers_;
  std::uint64_t last_receipt_ = 0;
  /// The sessions of open receipts; bounded by max_open_receipts for each client.
  std::unordered_map<
      std::uint64_t, std::weak_ptr<ClientSession>, std::hash<std::uint64_t>, std::equal_to<>,
      RecyclingAllocator<std::pair<const std::uint64_t, std::weak_ptr<ClientSession>>>>
      open_;
};

}  // namespace slamgw::mqttsn
