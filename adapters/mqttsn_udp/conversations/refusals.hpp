// SPDX-License-Identifier: Apache-2.0
// Logs for an operator what clients are refused: once for each client and kind of refusal, however
// often it tries. There is a budget of lines for proven clients and one for all others. Each
// refusal is counted.
#pragma once

#include <cstdint>
#include <deque>
#include <string>
#include <string_view>
#include <unordered_set>

#include "adapters/mqttsn_udp/clients/client_table.hpp"
#include "adapters/mqttsn_udp/output.hpp"
#include "daemon/core/token_bucket.hpp"

namespace slamgw::mqttsn {

class Refusals {
 public:
  Refusals(const ClientTable& clients, Output& output) : clients_(clients), output_(output) {}

  /// `who` is the client's id, or its address if the id is not known; `robot` may be empty. `what`
  /// is counted in any case; `text` says what was refused and what would allow it.
  void on_refusal(Count what, std::string_view who, std::string text, const std::string& robot,
                  TimePoint now);
  /// Call when there is no room for another topic or subscription of the client.
  void on_full_tables(const ClientSession& session, const std::string& name, TimePoint now);
  /// Call when the rules have changed: refusals by the new rules are logged again.
  void forget_all();

 private:
  struct Lines {
    TokenBucket budget;
    std::uint64_t left_out = 0;
  };

  const ClientTable& clients_;
  Output& output_;
  Lines lines_[2];  // index: whether the client is proven
  // Hashes of kind and client; at most max_logged_refusals.
  std::unordered_set<std::uint64_t> logged_;
  std::deque<std::uint64_t> oldest_first_;
};

}  // namespace slamgw::mqttsn
