// SPDX-License-Identifier: Apache-2.0
// The facts of the audit trail in the journal: who asked for what, and the result. They never hold
// a key or an OOB value. Pure.
#pragma once

#include <memory>
#include <string>
#include <string_view>

namespace slamgw {

struct AuditFacts {
  std::string who;      ///< `uid 1000 (alice)`, `broker`, `broker: planner`, `SIGHUP`
  std::string what;     ///< `command cmd`, `forget`, `ble permit-join`
  std::string outcome;  ///< `delivered`, `refused`, `done`, `failed` ...
};

/// AuditFacts::who of a command; null: `broker`. Shared, because messages are copied into many
/// queues.
using Sender = std::shared_ptr<const std::string>;

inline constexpr std::string_view broker_sender = "broker";
/// Longer names of senders are left out.
inline constexpr std::size_t max_sender_name = 64;

/// `name` is what the client calls itself; the gateway cannot check it. Returns null if the name is
/// empty or too long.
inline Sender sender_at_broker(std::string_view name) {
  if (name.empty() || name.size() > max_sender_name) return nullptr;
  return std::make_shared<const std::string>("broker: " + std::string(name));
}

inline std::string who_of(const Sender& sender) {
  return sender ? *sender : std::string(broker_sender);
}

/// True for a sender on this host, false for a client of the broker.
inline bool is_operator(std::string_view who) { return !who.starts_with(broker_sender); }

}  // namespace slamgw
