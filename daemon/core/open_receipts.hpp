// SPDX-License-Identifier: Apache-2.0
// Whose message each open receipt is for, and since when: for the latencies in a robot's numbers.
// Pure; part of Gateway.
#pragma once

#include <map>
#include <optional>
#include <string>
#include <utility>

#include "daemon/core/messages.hpp"

namespace slamgw {

class OpenReceipts {
 public:
  /// Messages beyond that have no latency. Far above what the meshes leave open.
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
    const auto node = open_.extract({receipt.mesh, receipt.id});
    if (node.empty()) return std::nullopt;
    return std::move(node.mapped());
  }

 private:
  std::map<std::pair<Mesh, std::uint64_t>, Open> open_;
};

}  // namespace slamgw
