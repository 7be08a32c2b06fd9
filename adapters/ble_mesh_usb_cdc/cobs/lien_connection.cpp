// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/cobs/lien_connection.hpp"

#include <algorithm>
#include <array>
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

namespace {

constexpr std::uint8_t reflected_polynomial = 0x8c;
constexpr std::size_t shortest_frame = 4;  // no data

}  // namespace

std::uint8_t crc8_maxim(ByteView bytes) {
  unsigned crc = 0;
  for (const std::uint8_t byte : bytes) {
    crc ^= byte;
    for (int bit = 0; bit < 8; ++bit)
      crc = (crc & 1U) != 0 ? (crc >> 1) ^ reflected_polynomial : crc >> 1;
  }
  return static_cast<std::uint8_t>(crc);
}

Bytes encode_lien_frame(const LienFrame& frame) {
  ByteWriter raw;
  raw.write_u8(frame.destination)
      .write_u8(frame.source)
      .write_u8(static_cast<std::uint8_t>(frame.protocol))
      .write(frame.data);
  raw.write_u8(crc8_maxim(raw.bytes()));
  Bytes wire = encode_cobs(raw.bytes());
  wire.push_back(0);
  return wire;
}

Result<LienFrame, DecodeError> decode_lien_frame(ByteView raw) {
  if (raw.size() < shortest_frame) return DecodeError::too_short;
  const ByteView covered = raw.first(raw.size() - 1);
  if (crc8_maxim(covered) != raw.back() || covered[2] > 1) return DecodeError::bad_value;
  return LienFrame{covered[0], covered[1], LienProtocol{covered[2]},
                   Bytes(covered.begin() + 3, covered.end())};
}

std::optional<std::string_view> lien_type_name(std::uint8_t message_type) {
  constexpr std::array<std::string_view, 16> names{"handshake",
                                                   "lien_update",
                                                   "",
                                                   "idle",
                                                   "",
                                                   "",
                                                   "",
                                                   "",
                                                   "",
                                                   "ping_response",
                                                   "line",
                                                   "debug",
                                                   "drone_update",
                                                   "battery",
                                                   "line_update",
                                                   "repo_update"};
  if (message_type >= names.size() || names[message_type].empty()) return std::nullopt;
  return names[message_type];
}

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
