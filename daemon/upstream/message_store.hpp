// SPDX-License-Identifier: Apache-2.0
// The border between the outbox and whatever keeps undelivered messages. The outbox says what
// should be kept; a store that can make it durable answers with `on_stored`, and only then does a
// receipt fire without the broker.
#pragma once

#include <cstdint>

#include "daemon/core/messages.hpp"

namespace slamgw {

class MessageStore {
 public:
  virtual ~MessageStore() = default;
  /// Keep `message` until `forget(sequence)`. Does not block; answers, if ever, through
  /// Outbox::on_stored on the loop's thread. Sequences rise.
  virtual void keep(std::uint64_t sequence, const BrokerMessage& message) = 0;
  /// The broker has it.
  virtual void forget(std::uint64_t sequence) = 0;
};

/// Keeps nothing beyond the outbox's own memory and never says that anything is safe: robots keep
/// what the broker has not acknowledged.
class VolatileStore final : public MessageStore {
 public:
  void keep(std::uint64_t, const BrokerMessage&) override {}
  void forget(std::uint64_t) override {}
};

}  // namespace slamgw
