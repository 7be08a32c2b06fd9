// SPDX-License-Identifier: Apache-2.0
// Robots with an address on both meshes may say each message over both: it goes up once. A message
// counts as the other's copy when topic and payload are equal, it came over the other mesh, and at
// most `window` later. One message has one copy, so a robot that stands still and says the same
// each second is heard each second. Pure; part of Gateway, which asks for robots of `robots` only.
#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <string>

#include "daemon/core/messages.hpp"

namespace slamgw {

class CopyFilter {
 public:
  /// A robot repeats over either mesh for longer, but its first try is what counts.
  static constexpr std::chrono::seconds window{2};
  /// Of one robot; further ones are not looked at.
  static constexpr std::size_t max_kept = 64;

  /// What becomes of a copy's own acknowledgement.
  enum class Copy : std::uint8_t { none, safe, waits };

  /// `none`: it is no copy. `waits`: it has the fate of the first one, which on_receipt() tells.
  /// A message that waits for an acknowledgement is no copy of one that did not.
  Copy on_report(const Report& report, TimePoint now);
  /// The receipt of the copy, when it must fire with this one.
  std::optional<Receipt> on_receipt(const Receipt& receipt, ReceiptOutcome outcome);
  void forget(const std::string& robot) { robots_.erase(robot); }

 private:
  struct First {
    RequiredMesh mesh;
    std::size_t content = 0;  ///< of topic and payload
    TimePoint came{};
    Receipt receipt;
    bool is_open = false;  ///< its receipt has not fired
    bool has_copy = false;
    Receipt copy = no_receipt;
  };

  static void expire(std::deque<First>& kept, TimePoint now);

  std::map<std::string, std::deque<First>> robots_;
};

}  // namespace slamgw
