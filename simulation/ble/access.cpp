// SPDX-License-Identifier: Apache-2.0
#include "simulation/ble/access.hpp"

namespace slamgw::sim::ble {

using std::chrono::milliseconds;

Bytes vendor_message(Vendor opcode, ByteView parameters) {
  Bytes out{static_cast<std::uint8_t>(opcode), 0x59, 0x00};
  put(out, parameters);
  return out;
}

std::optional<Vendor> vendor_opcode(ByteView message) {
  if (message.size() < 3 || message[0] < 0xc0 || get_u16_le(message, 1) != 0x0059) {
    return std::nullopt;
  }
  return static_cast<Vendor>(message[0]);
}

std::optional<std::uint16_t> two_octet_opcode(ByteView message) {
  if (message.size() < 2 || (message[0] & 0xc0) != 0x80) return std::nullopt;
  return get_u16_be(message, 0);
}

std::size_t segment_count(std::size_t payload_octets) {
  return payload_octets <= 11 ? 1 : (payload_octets + 4 + 11) / 12;
}

Duration segmented_session(Address destination, std::uint8_t ttl) {
  return is_unicast(destination) ? milliseconds{150 + 50 * ttl} : milliseconds{2500};
}

Duration retry_interval(std::uint8_t ttl) { return milliseconds{500 + 50 * ttl}; }

Duration failed_session(std::uint8_t ttl) { return segmented_transmissions * retry_interval(ttl); }

std::uint32_t sequence_numbers(Address destination, std::size_t payload_octets, bool is_segmented) {
  if (!is_segmented) return 1;
  const auto segments = static_cast<std::uint32_t>(segment_count(payload_octets));
  return is_unicast(destination) ? segments : segments * segmented_transmissions;
}

Duration reliable_interval(std::uint8_t ttl, std::size_t payload_octets) {
  const std::size_t segments = segment_count(payload_octets);
  const milliseconds first{200 + 20 * ttl};
  return segments > 1 ? first + 20 * milliseconds{segments} : first;
}

}  // namespace slamgw::sim::ble
