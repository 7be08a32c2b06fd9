// SPDX-License-Identifier: Apache-2.0
// Replay protection (Mesh Profile 1.0 section 3.8.8), as Nordic's firmware does it, for a fixed
// number of sources. The board has one, and each robot. It is in RAM. All nodes have the same IV
// index here, so the sequence number of a source is sufficient.
#pragma once

#include <cstdint>
#include <map>

#include "simulation/ble/access.hpp"

namespace slamgw::sim::ble {

class ReplayList {
 public:
  static constexpr std::size_t capacity = 40;  ///< sources that can be heard

  /// Returns false for a sequence number that is not above the last one of its source, and for a
  /// new source when the list is full.
  bool accept(Address source, std::uint32_t sequence) {
    if (!would_accept(source, sequence)) return false;
    last_[source] = sequence;
    return true;
  }
  bool would_accept(Address source, std::uint32_t sequence) const {
    const auto known = last_.find(source);
    return known == last_.end() ? last_.size() < capacity : sequence > known->second;
  }

  void clear() { last_.clear(); }

 private:
  std::map<Address, std::uint32_t> last_;
};

}  // namespace slamgw::sim::ble
