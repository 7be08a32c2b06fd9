// SPDX-License-Identifier: Apache-2.0
// What the broker is asked to subscribe. Each request makes it send all retained messages under the
// filter again, so there is one at a time for each filter, at a bounded rate; SUBSCRIBEs that come
// meanwhile share the next one.
#pragma once

#include <deque>
#include <memory>
#include <string>
#include <unordered_map>
#include <unordered_set>
#include <vector>

#include "adapters/mqttsn_udp/clients/timer_queue.hpp"
#include "adapters/mqttsn_udp/clients/token_bucket.hpp"
#include "adapters/mqttsn_udp/output.hpp"

namespace slamgw::mqttsn {

class SubscribeRequests {
 public:
  /// A SUBSCRIBE that awaits its SUBACK.
  struct Waiting {
    std::weak_ptr<ClientSession> session;  ///< empty: the gateway itself, or a restored session
    std::uint64_t ticket = 0;
    Suback answer;
  };

  SubscribeRequests(const std::optional<TimePoint>& broker_up_since, Output& output)
      : broker_up_since_(broker_up_since), output_(output) {}

  /// False when too many wait for an answer about this filter.
  bool has_room(const std::string& filter) const;
  void ask(const std::string& filter, Qos qos, Waiting waiting, TimePoint now,
           bool wants_retained = true);
  /// The broker's answer: to all these.
  std::vector<Waiting> on_result(const std::string& filter, TimePoint now);
  /// No client has the filter any more. Returns the SUBSCRIBEs that were still waiting.
  std::vector<Waiting> forget(const std::string& filter, TimePoint now);
  /// The sessions that still wait for an answer about this filter.
  std::unordered_set<const ClientSession*> sessions_waiting_for(const std::string& filter) const;

  std::optional<TimePoint> deadline() const { return timers_.earliest(); }
  void on_deadline(TimePoint now);

 private:
  struct Request {
    std::vector<Waiting> open;    // the broker thinks about these
    std::vector<Waiting> joined;  // these are asked together next
    Qos qos = Qos::at_most_once;  // the highest of `joined`
    bool wants_retained = false;  // one of `joined` does
    TokenBucket pace;
    std::optional<TimePoint> armed;
  };

  /// Asks for those who have joined, if that may be now.
  void advance(const std::string& filter, Request& request, TimePoint now);
  /// Looks again when the next may be asked, or the pace needs to be remembered no longer.
  void schedule(const std::string& filter, Request& request, TimePoint now);

  const std::optional<TimePoint>& broker_up_since_;
  Output& output_;
  std::unordered_map<std::string, Request> requests_;
  TimerQueue<std::string> timers_;
};

}  // namespace slamgw::mqttsn
