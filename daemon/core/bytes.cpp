// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/bytes.hpp"

#include <array>
#include <boost/algorithm/hex.hpp>
#include <boost/endian/conversion.hpp>
#include <iterator>

namespace slamgw {

namespace {

using boost::endian::order;

template <class Number, order byte_order>
Number load(ByteReader& reader) {
  const ByteView octets = reader.read(sizeof(Number));
  return octets.empty()
             ? Number{0}
             : boost::endian::endian_load<Number, sizeof(Number), byte_order>(octets.data());
}

template <order byte_order, class Number>
ByteWriter& store(ByteWriter& writer, Number value) {
  std::array<std::uint8_t, sizeof(Number)> octets{};
  boost::endian::endian_store<Number, sizeof(Number), byte_order>(octets.data(), value);
  return writer.write(octets);
}

}  // namespace

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
  std::string text;
  text.reserve(bytes.size() * 2);
  boost::algorithm::hex_lower(bytes.begin(), bytes.end(), std::back_inserter(text));
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

std::uint8_t ByteReader::read_u8() { return load<std::uint8_t, order::big>(*this); }
std::uint16_t ByteReader::read_u16_be() { return load<std::uint16_t, order::big>(*this); }
std::uint16_t ByteReader::read_u16_le() { return load<std::uint16_t, order::little>(*this); }
std::int16_t ByteReader::read_i16_le() { return load<std::int16_t, order::little>(*this); }
std::uint32_t ByteReader::read_u32_le() { return load<std::uint32_t, order::little>(*this); }
std::uint64_t ByteReader::read_u64_le() { return load<std::uint64_t, order::little>(*this); }

ByteWriter& ByteWriter::write_u8(std::uint8_t value) { return store<order::big>(*this, value); }
ByteWriter& ByteWriter::write_u16_be(std::uint16_t value) {
  return store<order::big>(*this, value);
}
ByteWriter& ByteWriter::write_u16_le(std::uint16_t value) {
  return store<order::little>(*this, value);
}
ByteWriter& ByteWriter::write_i16_le(std::int16_t value) {
  return store<order::little>(*this, value);
}
ByteWriter& ByteWriter::write_u32_le(std::uint32_t value) {
  return store<order::little>(*this, value);
}
ByteWriter& ByteWriter::write_u64_le(std::uint64_t value) {
  return store<order::little>(*this, value);
}

ByteWriter& ByteWriter::write(ByteView bytes) {
  bytes_.insert(bytes_.end(), bytes.begin(), bytes.end());
  return *this;
}

ByteWriter& ByteWriter::write(std::string_view text) { return write(as_bytes(text)); }

}  // namespace slamgw
