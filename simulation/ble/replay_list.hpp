// SPDX-License-Identifier: Apache-2.0
// Replay protection (Mesh Profile 1.0 section 3.8.8), as Nordic's firmware does it, for a fixed
// number of sources. The board has one, and each robot.
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
    const auto known = last_.find(source);
    if (known == last_.end()) {
      if (last_.size() >= capacity) return false;
      last_.emplace(source, sequence);
      return true;
    }
    if (sequence <= known->second) return false;
    known->second = sequence;
    return true;
  }

  void clear() { last_.clear(); }

 private:
  std::map<Address, std::uint32_t> last_;
};

}  // namespace slamgw::sim::ble
