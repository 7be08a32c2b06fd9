// SPDX-License-Identifier: Apache-2.0
#include "simulation/ble/board/transmit_buffer.hpp"

#include <utility>

namespace slamgw::sim::ble {

/// Returns the size rounded up to whole words.
std::size_t TransmitBuffer::room_of(const Bytes& packet) {
  return header_size + (packet.size() + 3) / 4 * 4;
}

Duration TransmitBuffer::time_of(const Bytes& packet) const {
  return octet_time_ * static_cast<Duration::rep>(packet.size());
}

void TransmitBuffer::push(const Bytes& opcode_and_params) {
  Bytes packet{static_cast<std::uint8_t>(opcode_and_params.size())};
  put(packet, opcode_and_params);
  if (octets_ + room_of(packet) > capacity) {
    ++dropped_;
    return;
  }
  octets_ += room_of(packet);
  packets_.push_back(std::move(packet));
}

std::optional<Bytes> TransmitBuffer::pop(TimePoint now) {
  if (packets_.empty()) return std::nullopt;
  if (!sent_at_) sent_at_ = now + time_of(packets_.front());
  if (*sent_at_ > now) return std::nullopt;
  Bytes packet = std::move(packets_.front());
  packets_.pop_front();
  octets_ -= room_of(packet);
  is_over_ = false;
  if (packets_.empty()) {
    sent_at_.reset();
  } else {
    *sent_at_ += time_of(packets_.front());
  }
  return packet;
}

}  // namespace slamgw::sim::ble
