// SPDX-License-Identifier: Apache-2.0
// Replay protection (Mesh Profile 1.0 section 3.8.8), as Nordic's firmware does it, for a fixed
// number of sources. The board has one, and each robot. It is in RAM. The IV index is the same for
// all here, so a source's sequence number alone tells.
#pragma once

#include <cstdint>
#include <map>

#include "simulation/ble/access.hpp"

namespace slamgw::sim::ble {

class ReplayList {
 public:
  static constexpr std::size_t capacity = 40;  ///< sources that can be heard

  /// False for a sequence number that is not above the last one of its source, and for a source
  /// for which there is no room.
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
