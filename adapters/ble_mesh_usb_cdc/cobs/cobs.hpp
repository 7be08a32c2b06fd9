// SPDX-License-Identifier: Apache-2.0
// Consistent Overhead Byte Stuffing: frames without zero octets, so that a zero ends each of them.
// Unlike Nordic's framing it finds its own borders again. Called by CobsMesh.
#pragma once

#include <vector>

#include "adapters/ble_mesh_usb_cdc/errors.hpp"
#include "daemon/core/bytes.hpp"
#include "daemon/core/result.hpp"

namespace slamgw::ble {

/// Without the zero that ends it on the wire.
Bytes encode_cobs(ByteView data);
Result<Bytes, DecodeError> decode_cobs(ByteView encoded);

/// Cuts a stream at its zeros.
class CobsSplitter {
 public:
  /// Robots send at most 50 octets; anything much longer is no frame of theirs.
  static constexpr std::size_t max_frame = 512;

  /// The encoded frames that `bytes` completes, never empty. What comes before the first zero is
  /// the end of a frame whose start was missed, and is dropped.
  std::vector<Bytes> on_bytes(ByteView bytes);
  /// The stream starts anew.
  void reset();
  /// Frames dropped for their length since the splitter was made.
  std::uint64_t oversize() const { return oversize_; }

 private:
  Bytes partial_;
  bool is_skipping_ = true;  ///< until the next zero
  std::uint64_t oversize_ = 0;
};

}  // namespace slamgw::ble
