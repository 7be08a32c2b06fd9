// SPDX-License-Identifier: Apache-2.0
#include "simulation/ble/board/transmit_buffer.hpp"

#include <utility>

namespace slamgw::sim::ble {

void TransmitBuffer::push(const Bytes& opcode_and_params) {
  Bytes packet{static_cast<std::uint8_t>(opcode_and_params.size())};
  put(packet, opcode_and_params);
  if (octets_ + packet.size() > capacity) {
    ++dropped_;
    return;
  }
  octets_ += packet.size();
  packets_.push_back(std::move(packet));
}

std::optional<Bytes> TransmitBuffer::pop() {
  if (packets_.empty()) return std::nullopt;
  Bytes packet = std::move(packets_.front());
  packets_.pop_front();
  octets_ -= packet.size();
  return packet;
}

}  // namespace slamgw::sim::ble
