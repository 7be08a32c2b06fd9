// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/nordic/resync.hpp"

#include <algorithm>

#include "adapters/ble_mesh_usb_cdc/nordic/commands.hpp"
#include "adapters/ble_mesh_usb_cdc/nordic/frame.hpp"

namespace slamgw::ble {
namespace {

constexpr std::size_t longest_frame_body = 255;
constexpr std::uint8_t echo_response = 0x82;
constexpr std::uint32_t refusal_of_zero = 0x03840084;  // as it comes over the wire

}  // namespace

Bytes Resync::start(TimePoint now) {
  attempts_ = 0;
  octets_seen_ = 0;
  last_octets_ = 0;
  has_seen_refusal_ = false;
  state_ = State::waiting;
  return flush(now);
}

Bytes Resync::flush(TimePoint now) {
  ++attempts_;
  phase_ = Phase::waiting_for_quiet;
  due_ = now + quiet_time;
  quiet_limit_ = now + max_wait_for_quiet;
  return Bytes(longest_frame_body, 0);
}

ByteView Resync::on_bytes(ByteView bytes, TimePoint now) {
  octets_seen_ += bytes.size();
  if (state_ != State::waiting) return {};
  for (const std::uint8_t octet : bytes) {
    last_octets_ = last_octets_ << 8 | octet;
    if (last_octets_ == refusal_of_zero) has_seen_refusal_ = true;
  }
  if (phase_ == Phase::waiting_for_quiet) {
    due_ = std::min(now + quiet_time, quiet_limit_);
    return {};
  }
  const std::size_t known = tail_.size();
  tail_.insert(tail_.end(), bytes.begin(), bytes.end());
  const auto found = std::search(tail_.begin(), tail_.end(), awaited_.begin(), awaited_.end());
  if (found != tail_.end()) {
    state_ = State::in_step;
    const auto border = static_cast<std::size_t>(found - tail_.begin()) + awaited_.size();
    return bytes.subspan(border - known);
  }
  if (tail_.size() >= awaited_.size())
    tail_.erase(tail_.begin(), tail_.end() - static_cast<std::ptrdiff_t>(awaited_.size() - 1));
  return {};
}

std::optional<TimePoint> Resync::deadline() const {
  return state_ == State::waiting ? std::optional(due_) : std::nullopt;
}

std::optional<Bytes> Resync::on_deadline(TimePoint now) {
  if (state_ != State::waiting || now < due_) return std::nullopt;
  if (phase_ == Phase::waiting_for_quiet) {
    phase_ = Phase::waiting_for_echo;
    due_ = now + echo_time_limits.at(attempts_ - 1);
    tail_.clear();
    const Bytes nonce = ByteWriter{}
                            .write_u32_le(static_cast<std::uint32_t>(random_()))
                            .write_u32_le(static_cast<std::uint32_t>(random_()))
                            .take();
    awaited_ = encode_frame(echo_response, nonce);
    return encode_echo(nonce);
  }
  if (attempts_ < echo_time_limits.size()) return flush(now);
  state_ = State::failed;
  return std::nullopt;
}

}  // namespace slamgw::ble
