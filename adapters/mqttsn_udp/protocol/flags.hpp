// SPDX-License-Identifier: Apache-2.0
// The bits of the Flags octet (MQTT-SN 1.2 section 5.3.4), for the codec only.
#pragma once

#include <cstdint>

namespace slamgw::mqttsn {

constexpr unsigned flag_dup = 0x80;
constexpr unsigned flag_qos_shift = 5;
constexpr unsigned flag_retain = 0x10;
constexpr unsigned flag_will = 0x08;
constexpr unsigned flag_clean_session = 0x04;
constexpr unsigned flag_topic_id_type_bits = 0x03;

/// Ctrl of an encapsulated message (section 5.5); the other bits are reserved.
constexpr std::uint8_t encapsulation_radius_bits = 0x03;

}  // namespace slamgw::mqttsn
