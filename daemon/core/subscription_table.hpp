// SPDX-License-Identifier: Apache-2.0
// Which mesh wants which filter, so that the broker sees one subscription for all meshes (MQTT-SN
// 1.2 section 4.2, R101), and which of the copies that the broker sends for overlapping
// subscriptions is the one to take (R103).
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "daemon/core/messages.hpp"
#include "daemon/core/topic_tree.hpp"

namespace slamgw {

/// MQTT 5 section 3.8.2.1.2: names the subscription of ours that a message is for. From 1; 0 is
/// none.
using SubscriptionId = std::uint32_t;
/// The id of the gateway's own subscriptions; no filter of a mesh gets it.
inline constexpr SubscriptionId own_subscription = 268435455;

/// A subscription as the broker has it.
struct StandingSubscription {
  SubscriptionId id = 0;
  Qos qos = Qos::at_most_once;
  bool is_own = false;
};

class SubscriptionTable {
 public:
  struct Wanted {
    SubscriptionId id = 0;             ///< made from the filter: the same after a restart
    Qos mesh_qos = Qos::at_most_once;  ///< the highest that a mesh has asked for
    Qos qos = Qos::at_most_once;       ///< at the broker
    bool is_covered = false;           ///< another one brings it: not subscribed at the broker
    bool wants_retained = false;       ///< who wants it needs the retained messages too
    bool is_own = false;               ///< the gateway itself wants it, to hear other gateways
    PerMesh<bool> by_mesh;
    PerMesh<unsigned> waiting;  ///< answers that the mesh waits for
  };

  /// A new filter that need not bring retained messages is covered until set_cover().
  const Wanted& add(Mesh mesh, const std::string& filter, Qos qos, bool wants_retained = true);
  const Wanted& add_own(const std::string& filter);
  /// True when the filter has lost its last subscriber.
  bool remove(Mesh mesh, const std::string& filter);
  /// True when the filter has no subscriber now, also if it had none before.
  bool remove_own(const std::string& filter);
  const std::map<std::string, Wanted>& wanted() const { return wanted_; }

  /// `mesh` waits for the broker's answer about `filter`.
  void await(Mesh mesh, const std::string& filter);
  /// The broker has answered. Returns a mesh for each request that waited. A refused filter is
  /// forgotten, and the other meshes that wanted it are returned too.
  std::vector<Mesh> on_answer(const std::string& filter, bool granted);
  void set_cover(const std::string& filter, bool is_covered);
  /// Updates which filters are covered. Returns those that changed; none stands at the broker.
  std::vector<std::string> set_cover(
      const std::function<bool(const std::string& filter, const Wanted& wanted)>& is_covered);
  /// Those that another one brings.
  std::vector<std::string> covered() const;
  struct Waiting {
    Mesh mesh;
    std::string filter;
  };
  /// The broker is gone, and with it all subscriptions there; or it has just come. Filters that
  /// need not bring retained messages are covered until set_cover(). The gateway's own have QoS 0
  /// unless the broker keeps a session for it: then QoS 1 is worth little, NATS takes half a
  /// second for each such subscription, and does not bring all to it (docs/fleet.md).
  void on_connection_changed(bool is_session_kept);
  bool is_standing(const std::string& filter) { return standing_.find(filter) != nullptr; }
  /// True when `filter` is wanted, and no other filter that stands brings the topic.
  bool is_only_of(const std::string& filter, const std::string& topic) const;
  /// What was learned of a broker that names no `ids`: whether it sends a message once for each
  /// subscription, as Mosquitto does, or once only, as RabbitMQ does. MQTT 3.1.1 allows both
  /// (section 3.3.5). Until then it is taken to send copies.
  void set_sends_copies(bool sends_copies) { sends_copies_ = sends_copies; }
  /// Takes all requests that still wait for an answer.
  std::vector<Waiting> take_all_waiting();

  /// A message that matches several of our subscriptions comes once for each, one after the other.
  /// Exactly one copy is to be taken: that of the highest QoS, then of the gateway's own, and then
  /// of the lowest id, among the subscriptions that stand. The gateway's own is there on each
  /// connection, so what the broker has kept meanwhile came for it, too.
  /// While none of them stands (the broker sends what it kept for us while we restarted), the
  /// first. Where the broker names no `ids` (MQTT 3.1.1), the first of as many equal messages in a
  /// row as there are such subscriptions. Not for retained messages: they come for one subscription
  /// each.
  bool is_copy_to_take(const BrokerMessage& message, std::span<const SubscriptionId> ids);

 private:
  Wanted& row(const std::string& filter);
  void set_qos(Wanted& wanted) const;
  bool forget_if_unwanted(std::map<std::string, Wanted>::iterator wanted);
  void forget(std::map<std::string, Wanted>::iterator wanted);
  SubscriptionId take_id(std::string_view filter);
  SubscriptionId make_id(std::string_view filter) const;
  bool is_first_in_row(const BrokerMessage& message, std::size_t copies);
  bool is_copy_of_last(const BrokerMessage& message, std::span<const SubscriptionId> ids);

  std::map<std::string, Wanted> wanted_;
  TopicTree<StandingSubscription> standing_;  // at the broker
  std::vector<SubscriptionId> used_ids_;      // sorted
  /// The last message that had copies and no id, and how many of them are still to come.
  BrokerMessage repeated_;
  std::size_t copies_to_come_ = 0;
  std::optional<bool> sends_copies_;  ///< of this connection's broker; nothing: not known
  Qos own_qos_ = Qos::at_least_once;
  /// Of the last message that came while none of its subscriptions stood: what copies of it named.
  std::vector<SubscriptionId> ids_of_last_;
};

}  // namespace slamgw
