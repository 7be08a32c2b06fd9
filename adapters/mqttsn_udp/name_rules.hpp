// SPDX-License-Identifier: Apache-2.0
// What clients and topics may be called, and who may go by a name.
#pragma once

#include <algorithm>
#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "adapters/mqttsn_udp/protocol/endpoint.hpp"
#include "adapters/mqttsn_udp/settings.hpp"
#include "daemon/core/robot_keys.hpp"
#include "daemon/core/robot_names.hpp"
#include "daemon/core/topic_scheme.hpp"

namespace slamgw::mqttsn {

/// The topic ids that `mqttsn.predefined_topics` gives out, a space of their own (R62). Immutable.
class PredefinedTopics {
 public:
  explicit PredefinedTopics(const std::vector<PredefinedTopic>& topics);
  /// The topic of this id: from the client's own entry, else from the one for every client.
  const std::string* name_of(std::string_view client_id, std::uint16_t id) const;

 private:
  using ByClient = std::map<std::string, std::string, std::less<>>;
  std::map<std::uint16_t, ByClient> topics_;  // client id "" is every client
};

/// The two octets in the id field are the name (section 6.7).
std::string short_name(std::uint16_t topic_id);
/// The way back; `name` has exactly two octets.
std::uint16_t short_name_id(std::string_view name);

/// Those that are not const may change (SnGateway::reconfigure).
struct NameRules {
  TopicPolicy policy;
  RobotNames names;
  const PredefinedTopics predefined;
  const RequireIdentity required = RequireIdentity::none;
  Identities identities{};  ///< client ids that have a key

  /// Whether this client must come over DTLS.
  bool needs_identity(const std::string& client_id) const {
    return required == RequireIdentity::all ||
           (required == RequireIdentity::with_key && identities.contains(client_id));
  }
  /// Whether `peer` may go by this client id: from its address, with its identity.
  bool may_speak(const std::string& client_id, const Peer& peer) const {
    if (!names.may_come_from(client_id, peer.endpoint.address)) return false;
    if (peer.identity.empty()) return !needs_identity(client_id);
    return peer.identity == client_id && identities.contains(client_id);
  }
  /// The same of the client whose robot has this name.
  bool may_speak_for(const std::string& robot, const Peer& peer) const {
    const auto& configured = names.configured();
    const auto known = std::ranges::find(configured, robot, &RobotName::id);
    const bool is_renamed = known != configured.end() && known->mqttsn_client_id;
    return may_speak(is_renamed ? *known->mqttsn_client_id : robot, peer);
  }
};

}  // namespace slamgw::mqttsn
