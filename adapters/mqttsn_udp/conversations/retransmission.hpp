// SPDX-License-Identifier: Apache-2.0
// Repeats requests that a client does not answer (MQTT-SN 1.2 section 6.13, R133): after the wait
// that the client's answers have taught, then ever more slowly, up to `retry_interval`. A request
// is given up after `retry_interval` times (`retry_count` + 1), so what the keys allow stays the
// same however short the first waits are.
#pragma once

#include "adapters/mqttsn_udp/clients/delivery.hpp"
#include "adapters/mqttsn_udp/settings.hpp"

namespace slamgw::mqttsn {

class Retransmission {
 public:
  explicit Retransmission(const Settings& settings) : settings_(settings) {}

  /// The request leaves for the first time (or again, after it has rested).
  Attempt begin(const Delivery& delivery, std::uint16_t msg_id, TimePoint now) const;

  enum class Due : std::uint8_t {
    nothing,  ///< its time has not come
    repeat,   ///< it is to be sent once more
    give_up,  ///< it was sent often enough
  };
  /// Takes note of the repetition that it asks for.
  Due on_time(Attempt& attempt, TimePoint now) const;

  /// The client has answered this request.
  static void on_answer(Delivery& delivery, const Attempt& attempt, TimePoint now);

 private:
  TimePoint end_of(const Attempt& attempt) const;

  const Settings& settings_;
};

}  // namespace slamgw::mqttsn
