// SPDX-License-Identifier: Apache-2.0
// From one broker message to the clients that get it: each once, at its highest matching QoS
// (R87, R103), retained ones only to those that wait for them (R102).
#pragma once

#include <deque>

#include "adapters/mqttsn_udp/downlink.hpp"

namespace slamgw::mqttsn {

/// The broker sends one copy for each of our filters that match; the machine wants one. Identical
/// messages that follow within `copy_window` are copies, at most one for each further filter.
class CopyFilter {
 public:
  bool is_copy(const BrokerMessage& message, std::size_t filters, TimePoint now);

 private:
  struct Seen {
    std::uint64_t fingerprint;
    TimePoint until;
    std::size_t copies_left;
  };
  std::deque<Seen> seen_;
};

class FanOut {
 public:
  FanOut(Context& context, Subscriptions& subscriptions, Downlink& downlink, CommandWatch& commands)
      : context_(context),
        subscriptions_(subscriptions),
        downlink_(downlink),
        commands_(commands) {}

  void on_broker_message(const BrokerMessage& message, TimePoint now);

 private:
  Context& context_;
  Subscriptions& subscriptions_;
  Downlink& downlink_;
  CommandWatch& commands_;
  CopyFilter copies_;
};

}  // namespace slamgw::mqttsn
