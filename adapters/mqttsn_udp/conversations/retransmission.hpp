// SPDX-License-Identifier: Apache-2.0
// Repeats requests that a client does not answer (MQTT-SN 1.2 section 6.13, R133). The first wait
// is learned from the client's answers; later waits grow up to `retry_interval`. A request is given
// up after `retry_interval` times (`retry_count` + 1), however short the first waits are. So the
// keys of the configuration keep their meaning.
#pragma once

#include "adapters/mqttsn_udp/clients/delivery.hpp"
#include "adapters/mqttsn_udp/settings.hpp"

namespace slamgw::mqttsn {

/// Begins a request that is sent for the first time, or again after it has rested.
Attempt begin_attempt(const Settings& settings, const Delivery& delivery, std::uint16_t msg_id,
                      TimePoint now);

enum class Due : std::uint8_t {
  nothing,  ///< its time has not come
  repeat,   ///< it is to be sent once more
  give_up,  ///< it was sent often enough
};
/// Returns what is due, and counts a repetition that it asks for.
Due check_attempt(const Settings& settings, Attempt& attempt, TimePoint now);

/// Call when the client has answered this request.
void on_answered(Delivery& delivery, const Attempt& attempt, TimePoint now);

}  // namespace slamgw::mqttsn
