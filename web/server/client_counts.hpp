// SPDX-License-Identifier: Apache-2.0
// Counts each client's recent events, for delays and for log lines that are written once. A
// client's count begins again after a minute without an event. Pure.
#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <string>

#include "web/server/client.hpp"

namespace slamgw::web {

class ClientCounts {
 public:
  using TimePoint = std::chrono::steady_clock::time_point;

  static constexpr std::chrono::minutes quiet_time{1};
  /// Takes 100 KiB. Beyond it, the client that was quiet longest is forgotten.
  static constexpr std::size_t max_clients = 1024;

  /// Returns the client's count with this event.
  unsigned add(const Client& client, TimePoint now);
  void forget(const Client& client) { counts_.erase(client.name); }
  std::uint64_t total() const { return total_; }
  std::size_t clients() const { return counts_.size(); }

 private:
  struct Count {
    unsigned events = 0;
    TimePoint last{};
  };

  std::map<std::string, Count> counts_;
  std::uint64_t total_ = 0;
};

}  // namespace slamgw::web
