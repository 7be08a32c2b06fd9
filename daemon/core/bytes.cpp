// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/bytes.hpp"

#include <boost/algorithm/hex.hpp>
#include <iterator>

namespace slamgw {

std::string_view as_text(ByteView bytes) {
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

ByteView as_bytes(std::string_view text) {
  return {reinterpret_cast<const std::uint8_t*>(text.data()), text.size()};
}

Bytes to_bytes(std::string_view text) {
  const ByteView view = as_bytes(text);
  return {view.begin(), view.end()};
}

std::string to_hex(ByteView bytes) {
  constexpr std::string_view digits = "0123456789abcdef";
  std::string text;
  text.reserve(bytes.size() * 2);
  for (const std::uint8_t byte : bytes) {
    text += digits[byte >> 4];
    text += digits[byte & 0x0f];
  }
  return text;
}

std::optional<Bytes> from_hex(std::string_view text) {
  try {
    Bytes bytes;
    boost::algorithm::unhex(text.begin(), text.end(), std::back_inserter(bytes));
    return bytes;
  } catch (const boost::algorithm::hex_decode_error&) {
    return std::nullopt;
  }
}

ByteView ByteReader::read(std::size_t count) {
  if (!ok_ || count > rest_.size()) {
    ok_ = false;
    rest_ = {};
    return {};
  }
  const ByteView taken = rest_.first(count);
  rest_ = rest_.subspan(count);
  return taken;
}

ByteView ByteReader::read_rest() { return read(rest_.size()); }

std::uint8_t ByteReader::read_u8() {
  const ByteView b = read(1);
  return b.empty() ? std::uint8_t{0} : b[0];
}

std::uint16_t ByteReader::read_u16_be() {
  const ByteView b = read(2);
  return b.empty() ? std::uint16_t{0} : static_cast<std::uint16_t>(b[0] << 8 | b[1]);
}

std::uint16_t ByteReader::read_u16_le() {
  const ByteView b = read(2);
  return b.empty() ? std::uint16_t{0} : static_cast<std::uint16_t>(b[1] << 8 | b[0]);
}

std::int16_t ByteReader::read_i16_le() { return static_cast<std::int16_t>(read_u16_le()); }

std::uint32_t ByteReader::read_u32_le() {
  const std::uint32_t low = read_u16_le();
  const std::uint32_t high = read_u16_le();
  return ok_ ? high << 16 | low : 0;
}

std::uint64_t ByteReader::read_u64_le() {
  const std::uint64_t low = read_u32_le();
  return std::uint64_t{read_u32_le()} << 32 | low;
}

ByteWriter& ByteWriter::write_u8(std::uint8_t value) {
  bytes_.push_back(value);
  return *this;
}

ByteWriter& ByteWriter::write_u16_be(std::uint16_t value) {
  bytes_.push_back(static_cast<std::uint8_t>(value >> 8));
  bytes_.push_back(static_cast<std::uint8_t>(value));
  return *this;
}

ByteWriter& ByteWriter::write_u16_le(std::uint16_t value) {
  bytes_.push_back(static_cast<std::uint8_t>(value));
  bytes_.push_back(static_cast<std::uint8_t>(value >> 8));
  return *this;
}

ByteWriter& ByteWriter::write_i16_le(std::int16_t value) {
  return write_u16_le(static_cast<std::uint16_t>(value));
}

ByteWriter& ByteWriter::write_u32_le(std::uint32_t value) {
  write_u16_le(static_cast<std::uint16_t>(value));
  return write_u16_le(static_cast<std::uint16_t>(value >> 16));
}

ByteWriter& ByteWriter::write_u64_le(std::uint64_t value) {
  write_u32_le(static_cast<std::uint32_t>(value));
  return write_u32_le(static_cast<std::uint32_t>(value >> 32));
}

ByteWriter& ByteWriter::write(ByteView bytes) {
  bytes_.insert(bytes_.end(), bytes.begin(), bytes.end());
  return *this;
}

ByteWriter& ByteWriter::write(std::string_view text) { return write(as_bytes(text)); }

}  // namespace slamgw
