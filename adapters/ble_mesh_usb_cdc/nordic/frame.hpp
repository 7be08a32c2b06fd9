// SPDX-License-Identifier: Apache-2.0
// Nordic's serial framing: `len opcode params`, where len counts opcode and params (1..255). There
// is no checksum and no delimiter, so this only finds the borders and notices when they are lost;
// resync.hpp finds them again. Called by BoardLink.
#pragma once

#include <optional>
#include <vector>

#include "daemon/core/bytes.hpp"
#include "daemon/core/time.hpp"

namespace slamgw::ble {

inline constexpr std::size_t max_frame_params = 254;

/// The frame as it goes over the wire; `params` is at most `max_frame_params` octets.
Bytes encode_frame(std::uint8_t opcode, ByteView params);

class FrameDecoder {
 public:
  /// 255 octets take 22 ms at 115200 baud; a frame that takes longer than this is torn.
  static constexpr Duration max_partial_age = std::chrono::milliseconds{250};

  /// The frames that `bytes` completes, without their length octet (opcode first, never empty).
  std::vector<Bytes> on_bytes(ByteView bytes, TimePoint now);
  /// A zero length or a torn frame was seen: everything is ignored until `reset()`.
  bool has_lost_step() const { return has_lost_step_; }
  void reset();

  std::optional<TimePoint> deadline() const;
  void on_deadline(TimePoint now);

 private:
  Bytes partial_;  ///< length octet first; at most 256 octets
  TimePoint partial_since_{};
  bool has_lost_step_ = false;
};

}  // namespace slamgw::ble
