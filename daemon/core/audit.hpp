// SPDX-License-Identifier: Apache-2.0
// The facts of the audit trail in the journal: who asked for what, and the result. They never hold
// a key or an OOB value. Pure.
#pragma once

#include <functional>
#include <memory>
#include <string>
#include <string_view>

namespace slamgw {

struct AuditFacts {
  std::string who;      ///< `uid 1000 (alice)`, `broker`, `broker: planner`, `SIGHUP`
  std::string what;     ///< `command cmd`, `forget`, `ble permit-join`
  std::string outcome;  ///< `delivered`, `refused`, `done`, `failed` ...
};

struct CommandOutcome;

/// The sender of a command.
struct Asker {
  std::string who;  ///< AuditFacts::who
  /// Gets the outcome: called once, when the command has ended here. May be empty.
  std::function<void(const CommandOutcome&)> done{};
};
/// Null: `broker`. Shared, because messages are copied into many queues.
using Sender = std::shared_ptr<const Asker>;

inline constexpr std::string_view broker_sender = "broker";
/// Longer names of senders are left out.
inline constexpr std::size_t max_sender_name = 64;

/// `name` is what the client calls itself; the gateway cannot check it. Returns null if the name is
/// empty or too long.
inline Sender sender_at_broker(std::string_view name) {
  if (name.empty() || name.size() > max_sender_name) return nullptr;
  return std::make_shared<const Asker>(Asker{"broker: " + std::string(name)});
}

inline std::string who_of(const Sender& sender) {
  return sender ? sender->who : std::string(broker_sender);
}

/// True for a sender on this host, false for a client of the broker.
inline bool is_operator(std::string_view who) { return !who.starts_with(broker_sender); }

}  // namespace slamgw
