// SPDX-License-Identifier: Apache-2.0
// Lets each message go up once when a robot with an address on both meshes sends it over both. A
// message is a copy of another one when topic and payload are equal, it came over the other mesh,
// and at most `window` later. Each message has at most one copy, so a robot that stands still and
// repeats itself each second is heard each second. Pure; part of Gateway, which asks for robots of
// `robots` only.
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
  /// A robot may repeat a message for longer than this, but copies are recognised by their first
  /// try.
  static constexpr std::chrono::seconds window{2};
  /// Messages kept for one robot; further messages are not checked for copies.
  static constexpr std::size_t max_kept = 64;

  /// `none`: the message is not a copy. `safe`: it is a copy, and may be acknowledged at once.
  /// `waits`: its receipt fires together with that of the first message; see on_receipt().
  enum class Copy : std::uint8_t { none, safe, waits };

  /// A message that waits for an acknowledgement is never a copy of a message that did not.
  Copy on_report(const Report& report, TimePoint now);
  /// Returns the copy's receipt if it must fire together with this one.
  std::optional<Receipt> on_receipt(const Receipt& receipt, ReceiptOutcome outcome);
  void forget(const std::string& robot) { robots_.erase(robot); }

 private:
  struct First {
    RequiredMesh mesh;
    std::size_t content = 0;  ///< hash of topic and payload
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
