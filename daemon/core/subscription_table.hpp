// SPDX-License-Identifier: Apache-2.0
// Who wants which filter, so that the broker sees one subscription for all meshes (MQTT-SN 1.2
// section 4.2, R101), and which of the copies that the broker sends for overlapping subscriptions
// is the one to take (R103).
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <vector>

#include "daemon/core/messages.hpp"
#include "daemon/core/topic_tree.hpp"

namespace slamgw {

/// MQTT 5 section 3.8.2.1.2: tells which of our subscriptions a message is for. From 1; 0 is none.
using SubscriptionId = std::uint32_t;
/// For what the gateway itself wants to hear; no filter of a mesh gets it.
inline constexpr SubscriptionId own_subscription = 268435455;

/// A subscription as the broker has it.
struct StandingSubscription {
  SubscriptionId id = 0;
  Qos qos = Qos::at_most_once;
};

class SubscriptionTable {
 public:
  struct Wanted {
    SubscriptionId id = 0;        ///< made from the filter: the same after a restart
    Qos qos = Qos::at_most_once;  ///< the highest that anybody asked for
    bool is_covered = false;      ///< another subscription brings it: not for the broker
    bool is_own = false;          ///< the gateway itself wants it, to hear other gateways
    PerMesh<bool> by_mesh;
    PerMesh<unsigned> waiting;  ///< answers that the mesh waits for
  };

  const Wanted& add(Mesh mesh, const std::string& filter, Qos qos);
  const Wanted& add_own(const std::string& filter, Qos qos);
  /// True when the filter has lost its last subscriber.
  bool remove(Mesh mesh, const std::string& filter);
  /// True when the filter has no subscriber now, also if it had none before.
  bool remove_own(const std::string& filter);
  const std::map<std::string, Wanted>& wanted() const { return wanted_; }

  /// `mesh` waits for the broker's answer about `filter`.
  void await(Mesh mesh, const std::string& filter);
  /// The broker has answered: one mesh for each answer that was waited for. A refused filter is
  /// forgotten, and each mesh that wanted it without waiting is named too.
  std::vector<Mesh> on_answer(const std::string& filter, bool granted);
  void cover(const std::string& filter);
  /// Those that are covered or not from now on and were not before; neither stands at the broker.
  std::vector<std::string> set_cover(
      const std::function<bool(const std::string& filter)>& is_covered);
  struct Waiting {
    Mesh mesh;
    std::string filter;
  };
  /// The broker is gone, and with it all subscriptions there.
  void on_broker_gone() {
    standing_.clear();
    sends_copies_.reset();
  }
  bool is_standing(const std::string& filter) { return standing_.find(filter) != nullptr; }
  /// True when `filter` is wanted, and no other filter that stands brings the topic.
  bool is_only_of(const std::string& filter, const std::string& topic) const;
  /// What was learned of a broker that names no `ids`: whether it sends a message once for each
  /// subscription, as Mosquitto does, or once only, as RabbitMQ does. MQTT 3.1.1 allows both
  /// (section 3.3.5). Until then it is taken to send copies.
  void set_sends_copies(bool sends_copies) { sends_copies_ = sends_copies; }
  /// Those who still wait for an answer, and now no longer do.
  std::vector<Waiting> take_all_waiting();

  /// A message that matches several of our subscriptions comes once for each, one after the other.
  /// Exactly one copy is to be taken: that of the highest QoS, and then of the lowest id, among the
  /// subscriptions that stand.
  /// While none of them stands (the broker sends what it kept for us while we restarted), the
  /// first. Where the broker names no `ids` (MQTT 3.1.1), the first of as many equal messages in a
  /// row as there are such subscriptions. Not for retained messages: they come for one subscription
  /// each.
  bool is_copy_to_take(const BrokerMessage& message, std::span<const SubscriptionId> ids);

 private:
  Wanted& row(const std::string& filter, Qos qos);
  bool forget_if_unwanted(std::map<std::string, Wanted>::iterator wanted);
  void forget(std::map<std::string, Wanted>::iterator wanted);
  SubscriptionId make_id(std::string_view filter) const;
  bool is_first_in_row(const BrokerMessage& message, std::size_t copies);
  bool is_copy_of_last(const BrokerMessage& message, std::span<const SubscriptionId> ids);

  std::map<std::string, Wanted> wanted_;
  TopicTree<StandingSubscription> standing_;  // at the broker
  std::set<SubscriptionId> used_ids_;
  /// The last message that had copies and no id, and how many of them are still to come.
  BrokerMessage repeated_;
  std::size_t copies_to_come_ = 0;
  std::optional<bool> sends_copies_;  ///< of this connection's broker; nothing: not known
  /// Of the last message that came while none of its subscriptions stood: what copies of it named.
  std::vector<SubscriptionId> ids_of_last_;
};

}  // namespace slamgw
