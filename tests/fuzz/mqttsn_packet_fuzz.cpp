// SPDX-License-Identifier: Apache-2.0
// Feeds any octets as an MQTT-SN message: a decoded message encodes, and decodes to the same again.
#include "adapters/mqttsn_udp/protocol/packet.hpp"

using namespace slamgw::mqttsn;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  slamgw::ByteView octets(data, size);
  if (is_encapsulated(octets)) {
    const auto outer = decode_encapsulation(octets);
    if (!outer) return 0;
    if (outer->node_id.empty() || outer->inner.size() >= size) __builtin_trap();
    octets = outer->inner;
  }
  const auto packet = decode(octets);
  if (!packet) return 0;
  const slamgw::Bytes written = encode(*packet);
  const auto again = decode(written);
  if (!again || encode(*again) != written || written.size() > size) __builtin_trap();
  return 0;
}
