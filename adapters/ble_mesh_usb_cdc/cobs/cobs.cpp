// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/cobs/cobs.hpp"

#include <algorithm>
#include <utility>

namespace slamgw::ble {
namespace {

constexpr std::uint8_t full_block = 0xff;  // 254 octets and no zero after them

}  // namespace

// encoded = block ...; block = code data: `code - 1` octets without zero. A zero follows in the
// data after each block but the last and full ones.
Bytes encode_cobs(ByteView data) {
  Bytes encoded{1};
  std::size_t code_at = 0;
  for (std::size_t i = 0; i < data.size(); ++i) {
    if (data[i] != 0) {
      encoded.push_back(data[i]);
      ++encoded[code_at];
    }
    const bool is_last = i + 1 == data.size();
    if (data[i] == 0 || (encoded[code_at] == full_block && !is_last)) {
      code_at = encoded.size();
      encoded.push_back(1);
    }
  }
  return encoded;
}

Result<Bytes, DecodeError> decode_cobs(ByteView encoded) {
  Bytes data;
  if (encoded.empty()) return DecodeError::too_short;
  while (!encoded.empty()) {
    const std::uint8_t code = encoded.front();
    if (code == 0) return DecodeError::bad_value;
    if (encoded.size() < code) return DecodeError::too_short;
    const ByteView block = encoded.subspan(1, code - std::size_t{1});
    if (std::ranges::find(block, 0) != block.end()) return DecodeError::bad_value;
    data.insert(data.end(), block.begin(), block.end());
    encoded = encoded.subspan(code);
    if (code != full_block && !encoded.empty()) data.push_back(0);
  }
  return data;
}

std::vector<Bytes> CobsSplitter::on_bytes(ByteView bytes) {
  std::vector<Bytes> frames;
  for (const std::uint8_t byte : bytes) {
    if (byte != 0) {
      if (is_skipping_) continue;
      partial_.push_back(byte);
      if (partial_.size() <= max_frame) continue;
      ++oversize_;
      is_skipping_ = true;
      partial_.clear();
      continue;
    }
    if (!partial_.empty()) frames.push_back(std::exchange(partial_, {}));
    is_skipping_ = false;
  }
  return frames;
}

void CobsSplitter::reset() {
  partial_.clear();
  is_skipping_ = true;
}

}  // namespace slamgw::ble
