// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/nordic/frame.hpp"

#include <cassert>

namespace slamgw::ble {

Bytes encode_frame(std::uint8_t opcode, ByteView params) {
  assert(params.size() <= max_frame_params);
  ByteWriter frame;
  frame.write_u8(static_cast<std::uint8_t>(params.size() + 1)).write_u8(opcode).write(params);
  return frame.take();
}

std::vector<Bytes> FrameDecoder::on_bytes(ByteView bytes, TimePoint now) {
  std::vector<Bytes> frames;
  for (const std::uint8_t byte : bytes) {
    if (has_lost_step_) break;
    if (partial_.empty()) {
      has_lost_step_ = byte == 0;  // the board never sends length 0
      partial_since_ = now;
    }
    partial_.push_back(byte);
    if (partial_.size() == std::size_t{partial_.front()} + 1) {
      if (!has_lost_step_) frames.emplace_back(partial_.begin() + 1, partial_.end());
      partial_.clear();
    }
  }
  return frames;
}

void FrameDecoder::reset() {
  partial_.clear();
  has_lost_step_ = false;
}

std::optional<TimePoint> FrameDecoder::deadline() const {
  if (partial_.empty() || has_lost_step_) return std::nullopt;
  return partial_since_ + max_partial_age;
}

void FrameDecoder::on_deadline(TimePoint now) {
  const auto due = deadline();
  if (due && now >= *due) has_lost_step_ = true;
}

}  // namespace slamgw::ble
