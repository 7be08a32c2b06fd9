// SPDX-License-Identifier: Apache-2.0
// How long one client's answers take, and so how long to wait before a request is repeated: the
// smoothed round trip and its variation (RFC 6298). Answers to repeated requests are ambiguous and
// teach no round trip (Karn's rule).
#pragma once

#include "daemon/core/round_trip.hpp"

namespace slamgw::mqttsn {

class RetransmissionTimeout {
 public:
  /// Before the first answer: what RFC 7252 waits in networks of this kind (ACK_TIMEOUT).
  static constexpr Duration initial = std::chrono::seconds{2};
  /// A Thread end device that sleeps between its polls hears a message up to a second late (the
  /// poll period of Nordic's sleepy MQTT-SN examples); RFC 6298 has the same lower bound.
  static constexpr Duration shortest = std::chrono::seconds{1};
  /// Differences between round trips that are no news (G of RFC 6298).
  static constexpr Duration granularity = std::chrono::milliseconds{100};

  /// The wait after the first transmission of a request, at most `longest`.
  Duration first(Duration longest) const;
  /// The wait after repetition number `repeats` (from 1), `last` having brought no answer. A lost
  /// datagram is the common reason of the first ones, so they come at an even pace; then it slows.
  static Duration next(Duration last, unsigned repeats, Duration longest);

  /// The client has answered a request that was sent once.
  void on_answer(Duration round_trip);
  /// It has answered a request that was repeated, so long after the first and the last copy. Where
  /// that is not how fast it answers a last copy, the next waits grow until they are long enough
  /// for an answer to the first one, which is not ambiguous.
  void on_ambiguous_answer(Duration since_first, Duration since_last);

 private:
  RoundTrip round_trip_{granularity};
  Duration timeout_ = initial;
};

}  // namespace slamgw::mqttsn
