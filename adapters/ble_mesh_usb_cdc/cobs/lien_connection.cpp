// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/cobs/lien_connection.hpp"

#include <utility>

namespace slamgw::ble {
namespace {

constexpr std::uint8_t number_mask = 0x7f;
constexpr std::size_t length_octets = 2;

}  // namespace

std::optional<Bytes> LienConnection::on_simple(ByteView data) {
  ByteReader reader(data);
  const std::uint8_t part = reader.read_u8();
  const std::uint8_t last_part = reader.read_u8();
  if (!reader.ok() || part > last_part) return std::nullopt;
  if (part == 0) {
    parts_.clear();
    next_part_ = 0;
  }
  const ByteView content = reader.read_rest();
  if (part != next_part_ || parts_.size() + content.size() > max_message) {
    parts_.clear();
    next_part_ = 0;
    return std::nullopt;  // a part was lost: so is the message
  }
  parts_.insert(parts_.end(), content.begin(), content.end());
  ++next_part_;
  if (part != last_part) return std::nullopt;
  next_part_ = 0;
  Bytes message = std::exchange(parts_, {});
  if (message.empty()) return std::nullopt;
  return message;
}

LienConnection::ArqOutcome LienConnection::on_arq(ByteView data) {
  ByteReader reader(data);
  const std::uint8_t kind = reader.read_u8();
  if (!reader.ok()) return {};
  if (kind == static_cast<std::uint8_t>(Segment::syn)) {
    is_connected_ = true;
    is_open_ = false;
    expected_ = 0;
    stream_.clear();
    return {.reply = Bytes{static_cast<std::uint8_t>(Segment::synack)}, .is_new_connection = true};
  }
  const std::uint8_t number = reader.read_u8();
  // Without a connection the robot gets no answer, gives up after 1 s and connects again.
  if (!reader.ok() || !is_connected_) return {};
  if (kind == static_cast<std::uint8_t>(Segment::data))
    return on_segment(number & number_mask, reader.read_rest());
  if (kind == static_cast<std::uint8_t>(Segment::alive_test)) return {.reply = acknowledge()};
  return {};  // its ACK of our SYNACK
}

LienConnection::ArqOutcome LienConnection::on_segment(std::uint8_t number, ByteView payload) {
  if (is_open_) return {};
  if (number != expected_) return {.reply = acknowledge()};
  stream_before_ = stream_.size();
  stream_.insert(stream_.end(), payload.begin(), payload.end());
  if (stream_.size() > max_message + length_octets) {
    is_connected_ = false;  // no robot sends that: start over
    return {};
  }
  auto message = complete_message();
  is_open_ = message.has_value();
  if (is_open_) return {.message = std::move(message)};
  if (stream_.size() >= length_octets && stream_[0] == 0 && stream_[1] == 0)
    stream_.clear();  // an empty message
  expected_ = (expected_ + 1) & number_mask;
  return {.reply = acknowledge()};
}

std::optional<Bytes> LienConnection::complete_message() const {
  ByteReader reader(stream_);
  const std::uint16_t length = reader.read_u16_le();
  const ByteView message = reader.read(length);
  if (!reader.ok() || message.empty()) return std::nullopt;
  return Bytes(message.begin(), message.end());
}

Bytes LienConnection::on_safe() {
  is_open_ = false;
  stream_.clear();
  expected_ = (expected_ + 1) & number_mask;
  return acknowledge();
}

void LienConnection::on_refused() {
  is_open_ = false;
  stream_.resize(stream_before_);
}

Bytes LienConnection::acknowledge() const {
  return {static_cast<std::uint8_t>(Segment::ack), expected_};
}

}  // namespace slamgw::ble
