// SPDX-License-Identifier: Apache-2.0
// The memory that topic names and filters of all clients may take together. Each client has a small
// part for itself, so that others can't leave it none; beyond that they share.
#pragma once

#include <cstddef>

#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {

class NameBudget {
 public:
  /// Octets that a topic of this length takes with its place in the table.
  static constexpr std::size_t of_topic(std::size_t length) { return length + 128; }
  /// The same for a subscription, which stands here and in the robot's session at the broker
  /// (daemon/sessions).
  static constexpr std::size_t of_filter(std::size_t length) { return 2 * length + 512; }

  /// Whether a client that holds `held` octets may take `octets` more.
  bool may_take(std::size_t held, std::size_t octets) const {
    return held + octets <= limits::name_octets_for_each ||
           taken_ + octets <= limits::name_octets_together;
  }
  /// The same for what was taken before a restart, by so many `clients` that are back: they come in
  /// another order than then, and each had a small part of topics and one of filters for itself.
  bool may_restore(std::size_t clients, std::size_t octets) const {
    return taken_ + octets <=
           limits::name_octets_together + 2 * clients * limits::name_octets_for_each;
  }
  void take(std::size_t octets) { taken_ += octets; }
  void give_back(std::size_t octets) { taken_ -= octets; }

 private:
  std::size_t taken_ = 0;
};

}  // namespace slamgw::mqttsn
