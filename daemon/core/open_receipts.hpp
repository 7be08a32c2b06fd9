// SPDX-License-Identifier: Apache-2.0
// Keeps the robot and the arrival time of each message whose receipt is open, for the latencies in
// a robot's numbers. Pure; part of Gateway.
#pragma once

#include <functional>
#include <map>
#include <optional>
#include <string>
#include <utility>

#include "daemon/core/messages.hpp"
#include "daemon/core/recycling_allocator.hpp"

namespace slamgw {

class OpenReceipts {
 public:
  /// Messages beyond this bound have no latency. It is far above what the meshes leave open.
  static constexpr std::size_t max_open = 65536;

  struct Open {
    std::string robot;
    TimePoint since{};
  };

  void add(const Receipt& receipt, const std::string& robot, TimePoint now) {
    if (receipt.is_owed() && open_.size() < max_open)
      open_.insert_or_assign({receipt.mesh, receipt.id}, Open{robot, now});
  }
  std::optional<Open> take(const Receipt& receipt) {
    const auto found = open_.find(Key{receipt.mesh, receipt.id});
    if (found == open_.end()) return std::nullopt;
    Open open = std::move(found->second);
    open_.erase(found);
    return open;
  }

 private:
  using Key = std::pair<Mesh, std::uint64_t>;
  std::map<Key, Open, std::less<>, RecyclingAllocator<std::pair<const Key, Open>>> open_;
};

}  // namespace slamgw
