// SPDX-License-Identifier: Apache-2.0
// What an operator wants done with dead letters (`slam-gatewayctl store ...`): messages that were
// set aside because they could not be delivered. Plain values between the control socket and the
// message store; answered as orders about a mesh are (OrderDone).
#pragma once

#include <cstdint>
#include <string>
#include <variant>
#include <vector>

#include "daemon/core/ble_order.hpp"

namespace slamgw {

/// Which dead letters are meant: those with these ids, or of this topic, or all.
struct DeadLetterChoice {
  std::vector<std::uint64_t> ids;
  std::string topic;
  bool is_all = false;
};

/// A page of them, by rising id. Answer: `{"count", "bytes", "letters": [...], "more"}`; `count`
/// and `bytes` are of all.
struct ListDeadLetters {
  std::uint64_t after = 0;  ///< the last id of the page before
  std::string topic;        ///< empty: any
  bool with_payloads = false;
};
/// Puts them back among the undelivered messages, behind the others, oldest first; damaged ones
/// only when their ids are named. Answer: `{"resent", "left"}`.
struct ResendOrder {
  DeadLetterChoice choice;
};
/// Deletes them. Answer: `{"discarded"}`.
struct DiscardOrder {
  DeadLetterChoice choice;
};

using StoreOrder = std::variant<ListDeadLetters, ResendOrder, DiscardOrder>;

}  // namespace slamgw
