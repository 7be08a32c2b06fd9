// SPDX-License-Identifier: Apache-2.0
// The names of predefined and short topics, and the rules for the client id that a peer may use.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "adapters/mqttsn_udp/protocol/endpoint.hpp"
#include "adapters/mqttsn_udp/protocol/packet.hpp"
#include "adapters/mqttsn_udp/settings.hpp"
#include "daemon/core/robot_keys.hpp"
#include "daemon/core/robot_names.hpp"
#include "daemon/core/topic_scheme.hpp"

namespace slamgw::mqttsn {

/// The topic ids that `mqttsn.predefined_topics` gives out, a space of their own (R62). Immutable.
class PredefinedTopics {
 public:
  explicit PredefinedTopics(const std::vector<PredefinedTopic>& topics);
  /// Returns the client's own topic of this id, else the one for every client, else null.
  const std::string* name_of(std::string_view client_id, std::uint16_t id) const;

 private:
  using ByClient = std::map<std::string, std::string, std::less<>>;
  std::map<std::uint16_t, ByClient> topics_;  // client id "" is every client
};

/// Returns the name of a short topic: the two octets of the id field (section 6.7).
std::string short_name(std::uint16_t topic_id);
/// Returns true for two octets without a wildcard.
bool is_short_name(std::string_view name);
/// Returns the id field of a short topic; 0 if the name is not short.
std::uint16_t short_name_id(std::string_view name);

/// Returns true if a robot of another mesh has this name.
using NameCheck = std::function<bool(const std::string& robot)>;

/// The members that are not const may change (SnGateway::reconfigure).
struct NameRules {
  TopicPolicy policy;
  RobotNames names;
  const PredefinedTopics predefined;
  const RequireIdentity required = RequireIdentity::none;
  Identities identities{};   ///< client ids that have a key
  NameCheck is_elsewhere{};  ///< may be empty

  /// Returns the name of a predefined or short topic; nothing for an id that has none.
  std::optional<std::string> topic_of(std::string_view client_id, TopicIdType type,
                                      std::uint16_t id) const {
    if (type == TopicIdType::short_name) return short_name(id);
    const std::string* name =
        type == TopicIdType::predefined ? predefined.name_of(client_id, id) : nullptr;
    return name ? std::optional(*name) : std::nullopt;
  }
  /// Whether this client must come over DTLS.
  bool needs_identity(const std::string& client_id) const {
    return required == RequireIdentity::all ||
           (required == RequireIdentity::with_key && identities.contains(client_id));
  }
  /// Whether `peer` may use this client id, by its address and its identity.
  bool may_speak(const std::string& client_id, const Peer& peer) const {
    if (!names.may_come_from(client_id, peer.endpoint.address)) return false;
    if (peer.identity.empty()) return !needs_identity(client_id);
    return peer.identity == client_id && identities.contains(client_id);
  }
  /// Returns the name of this client's robot; nothing when the client may not connect.
  std::optional<std::string> robot_of(const std::string& client_id) const;
  /// Like robot_of(), but also returns nothing when `peer` may not use this client id.
  std::optional<std::string> robot_at(const Peer& peer, const std::string& client_id) const {
    return may_speak(client_id, peer) ? robot_of(client_id) : std::nullopt;
  }
  /// Returns the client id of the robot with this name; robot_of() says whether it exists.
  std::string client_of(const std::string& robot) const;
};

}  // namespace slamgw::mqttsn
