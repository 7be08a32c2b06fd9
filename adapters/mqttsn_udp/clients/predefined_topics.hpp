// SPDX-License-Identifier: Apache-2.0
// The topic ids that `mqttsn.predefined_topics` gives out, a space of their own (R62), and short
// names. Immutable.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "adapters/mqttsn_udp/settings.hpp"

namespace slamgw::mqttsn {

class PredefinedTopics {
 public:
  explicit PredefinedTopics(const std::vector<PredefinedTopic>& topics);
  /// What the id means to this client: its own entry first, else the one for every client.
  const std::string* name_of(std::string_view client_id, std::uint16_t id) const;

 private:
  using ByClient = std::map<std::string, std::string, std::less<>>;
  std::map<std::uint16_t, ByClient> topics_;  // client id "" is every client
};

/// The two octets in the id field are the name (section 6.7).
std::string short_name(std::uint16_t topic_id);
/// The way back; `name` has exactly two octets.
std::uint16_t short_name_id(std::string_view name);

}  // namespace slamgw::mqttsn
