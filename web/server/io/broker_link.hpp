// SPDX-License-Identifier: Apache-2.0
// The page's connection to the broker: uses the daemon's (Upstream, MosquittoLink), but only
// listens and sends commands. Subscribes again at each connection. Gathers messages for a few
// milliseconds and passes them on together. On the loop's thread.
#pragma once

#include <boost/asio/io_context.hpp>
#include <chrono>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "daemon/mqtt/upstream.hpp"
#include "daemon/runtime/timer.hpp"
#include "web/server/mirror.hpp"

namespace slamgw::web {

class BrokerLink final : private UpstreamListener {
 public:
  struct Listener {
    std::function<void(const BrokerMessage&)> on_message;
    std::function<void(bool is_up, const std::string& why)> on_state;
    /// `command`: as publish() returned it.
    std::function<void(std::uint64_t command, const std::string& why)> on_refused;
    /// Called when the broker refuses a filter: no message of it comes until the next connection.
    std::function<void(const std::string& filter, const std::string& why)> on_unreadable;
  };
  static constexpr std::uint32_t max_packet = 4 << 20;  ///< twice max_gateway_payload
  /// Messages that come within this time go to the pages together. A page draws a frame each 16 ms.
  static constexpr std::chrono::milliseconds gathering{10};

  BrokerLink(boost::asio::io_context& io, BrokerSettings settings, std::vector<std::string> filters,
             Listener listener);

  /// Publishes at QoS 1. Returns the command's number, or nothing without a connection.
  std::optional<std::uint64_t> publish(const CommandRequest& command);

 private:
  void on_link_up(const BrokerLimits& limits) override;
  void on_link_down(const std::string& why) override;
  void on_silence(bool /*is_silent*/) override {}
  void on_published(std::uint64_t /*sequence*/) override {}
  void on_publish_refused(std::uint64_t sequence, const Refusal& refusal) override;
  void on_subscribe_result(const std::string& filter, bool is_granted) override;
  void on_message(slamgw::BrokerMessage message, const UserProperties& said) override;
  void pass_on();

  const std::vector<std::string> filters_;
  Listener listener_;
  bool is_up_ = false;
  std::string last_failure_;  ///< the failure that the listener got last
  std::uint64_t commands_ = 0;
  std::vector<BrokerMessage> gathered_;
  bool is_gathering_ = false;
  Timer gather_;
  Upstream upstream_;
};

}  // namespace slamgw::web
