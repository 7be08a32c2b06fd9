// SPDX-License-Identifier: Apache-2.0
// SUBSCRIBE and UNSUBSCRIBE (MQTT-SN 1.2 section 6.9): the filters of a client, and the requests
// for them to its robot's session at the broker. Downlink delivers the messages.
#pragma once

#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "adapters/mqttsn_udp/clients/session_snapshot.hpp"
#include "adapters/mqttsn_udp/conversations/conversation.hpp"

namespace slamgw::mqttsn {

/// Answers to REGISTER, SUBSCRIBE and UNSUBSCRIBE, in the order of their requests (R64): behind a
/// SUBACK that waits for the broker, later answers wait too.
class Answers : Conversation {
 public:
  explicit Answers(const Conversation& common) : Conversation(common) {}

  /// Returns false when too many answers wait. Ignore the request then: its sender repeats it.
  bool has_room(const ClientSession& session) const;
  /// Sends the answer, or queues it behind answers that wait.
  void answer(ClientSession& session, Packet packet);
  /// Answers a request that finds no room with `congestion`, unless `when_full` is silent.
  void refuse_for_room(ClientSession& session, Packet congestion);
  /// Holds `suback` back until the broker has answered about `filter`.
  void hold(ClientSession& session, const std::string& filter, const Suback& suback);
  bool is_held(const ClientSession& session, std::uint16_t msg_id) const;
  /// Applies the broker's answer to all SUBACKs that wait for it.
  void release(ClientSession& session, const std::string& filter, bool granted);
};

class Subscriptions : Conversation {
 public:
  Subscriptions(const Conversation& common, Answers& answers)
      : Conversation(common), answers_(answers) {}

  void on_subscribe(ClientSession& session, const Subscribe& request, TimePoint now);
  /// Returns the filter that the client no longer has. The broker's session may have a filter from
  /// another gateway that is not known here.
  std::optional<std::string> on_unsubscribe(ClientSession& session, const Unsubscribe& request,
                                            TimePoint now);
  /// Handles the broker's answer about one of the session's filters.
  void on_subscribe_result(ClientSession& session, const std::string& filter, bool granted,
                           TimePoint now);

  /// Returns the matching subscription with the highest QoS (R87, R103); null if none matches.
  static const Subscription* best_match(const ClientSession& session, const std::string& topic);
  /// Ends the subscription, at the broker, too.
  void drop(ClientSession& session, const std::string& filter);
  void drop_all(ClientSession& session);
  /// Drops the filters that the topic policy does not allow any more.
  void drop_forbidden(ClientSession& session);
  /// Like drop_all(), but the broker keeps the filters.
  void forget_all(ClientSession& session);
  /// Asks the broker for the filters of a session that comes back: from the store, from another
  /// gateway, or under another name of its robot. `are_standing`: the robot's session at the broker
  /// has them already.
  void restore(ClientSession& session, bool are_standing, TimePoint now);
  /// Adds the filters of the former gateway's note that the client has not changed since.
  void add_noted(ClientSession& session, const std::vector<SubscriptionSnapshot>& noted,
                 const std::set<std::string>& dropped, TimePoint now);

 private:
  struct Requested {
    std::string filter;
    std::uint16_t topic_id = 0;
  };
  /// Returns the filter and id that the client asks for, or why it can't have them.
  Result<Requested, ReturnCode> read(ClientSession& session, const Subscribe& request,
                                     TimePoint now);
  std::optional<std::string> filter_of(ClientSession& session, TopicIdType type,
                                       std::uint16_t topic_id, const std::string& topic_name) const;
  void refuse(ClientSession& session, const Subscribe& request, ReturnCode code);
  bool is_repetition(const ClientSession& session, const Subscribe& request,
                     const std::string& filter, TimePoint now) const;
  void charge(ClientSession& session, const std::string& filter);
  void discharge(ClientSession& session, const std::string& filter);
  void ask(const ClientSession& session, const std::string& filter, Qos qos, bool is_standing);
  void notice_given_up(const ClientSession& session, std::vector<std::string> filters,
                       std::string_view why, TimePoint now);
  void notice_refusal(const ClientSession& session, const std::string& filter, TimePoint now);

  Answers& answers_;
};

}  // namespace slamgw::mqttsn
