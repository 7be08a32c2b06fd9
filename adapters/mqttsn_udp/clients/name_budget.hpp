// SPDX-License-Identifier: Apache-2.0
// The memory that topic names and filters of all clients may take together. Each client has a small
// part for itself, so that others can't leave it none; beyond that they share.
#pragma once

#include <cstddef>

#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {

class NameBudget {
 public:
  /// Octets that a topic of this length takes with its place in two tables.
  static constexpr std::size_t of_topic(std::size_t length) { return 2 * length + 128; }
  /// The same for a subscription, with its levels in the common tree.
  static constexpr std::size_t of_filter(std::size_t length) { return 2 * length + 512; }

  /// Whether a client that holds `held` octets may take `octets` more.
  bool may_take(std::size_t held, std::size_t octets) const {
    return held + octets <= limits::name_octets_for_each ||
           taken_ + octets <= limits::name_octets_together;
  }
  void take(std::size_t octets) { taken_ += octets; }
  void give_back(std::size_t octets) { taken_ -= octets; }

 private:
  std::size_t taken_ = 0;
};

}  // namespace slamgw::mqttsn
