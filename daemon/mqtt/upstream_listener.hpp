// SPDX-License-Identifier: Apache-2.0
// Upstream's events about the broker; implemented by App.
#pragma once

#include <cstdint>
#include <string>

#include "daemon/core/broker_link.hpp"
#include "daemon/core/messages.hpp"
#include "daemon/mqtt/broker_limits.hpp"
#include "daemon/mqtt/user_properties.hpp"

namespace slamgw {

/// Called on the loop's thread, and never from inside a call to Upstream except reconfigure().
class UpstreamListener {
 public:
  virtual ~UpstreamListener() = default;
  /// Connected; the broker knows nothing of an earlier connection. Upstream keeps to all of the
  /// broker's `limits` except the receive maximum.
  virtual void on_link_up(const BrokerLimits& limits) = 0;
  /// Connection lost or refused; `why` names the reason in words. May repeat while attempts fail.
  virtual void on_link_down(const std::string& why) = 0;
  /// Upstream has ended a good connection to make another, so no message is the cause; `why` in
  /// words.
  virtual void on_link_left(const std::string& why) { on_link_down(why); }
  /// The broker has not answered for StallWatch::silent_after, or answers again. Messages that must
  /// not be late are not sent during the silence. Ends with on_link_down() at the latest.
  virtual void on_silence(bool is_silent) = 0;
  /// `sequence` was acknowledged by the broker (QoS 0: handed to the network).
  virtual void on_published(std::uint64_t sequence) = 0;
  /// The broker has answered `sequence` with a reason code of 0x80 or above, or would, because the
  /// packet is larger than its limit. on_link_down() reports a publish that merely failed.
  virtual void on_publish_refused(std::uint64_t sequence, const Refusal& refusal) = 0;
  virtual void on_subscribe_result(const std::string& filter, bool is_granted) = 0;
  virtual void on_message(BrokerMessage message, const UserProperties& said) = 0;
};

}  // namespace slamgw
