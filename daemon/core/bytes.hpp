// SPDX-License-Identifier: Apache-2.0
// Reading and writing bytes with explicit byte order. The reader never reads past its end: the
// first short read makes it fail for good, so a decoder reads all its fields and asks once at the
// end.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace slamgw {

using Bytes = std::vector<std::uint8_t>;
using ByteView = std::span<const std::uint8_t>;

/// Views the same octets as text (without a check of the encoding), or text as octets.
std::string_view as_text(ByteView bytes);
ByteView as_bytes(std::string_view text);
Bytes to_bytes(std::string_view text);
std::string to_hex(ByteView bytes);
/// Reads pairs of hex digits, any case; returns nothing for anything else.
std::optional<Bytes> from_hex(std::string_view text);

/// Sticky-failure reader. After a failed read every value is 0 or empty and `ok()` is false.
class ByteReader {
 public:
  explicit ByteReader(ByteView bytes) : rest_(bytes) {}

  std::uint8_t read_u8();
  std::uint16_t read_u16_be();
  std::uint16_t read_u16_le();
  std::int16_t read_i16_le();
  std::uint32_t read_u32_le();
  std::uint64_t read_u64_le();
  /// The next `count` octets, as a view into the input.
  ByteView read(std::size_t count);
  /// All remaining octets; never fails.
  ByteView read_rest();

  std::size_t remaining() const { return rest_.size(); }
  bool ok() const { return ok_; }
  /// True when every octet was read and none was missing.
  bool at_end() const { return ok_ && rest_.empty(); }

 private:
  ByteView rest_;
  bool ok_ = true;
};

/// Appends to a buffer of its own, which has room for a short message from the beginning.
class ByteWriter {
 public:
  /// Reuses the memory of `buffer` and drops its content.
  explicit ByteWriter(Bytes buffer = {}) : bytes_(std::move(buffer)) {
    bytes_.clear();
    bytes_.reserve(short_message);
  }

  ByteWriter& write_u8(std::uint8_t value);
  ByteWriter& write_u16_be(std::uint16_t value);
  ByteWriter& write_u16_le(std::uint16_t value);
  ByteWriter& write_i16_le(std::int16_t value);
  ByteWriter& write_u32_le(std::uint32_t value);
  ByteWriter& write_u64_le(std::uint64_t value);
  ByteWriter& write(ByteView bytes);
  ByteWriter& write(std::string_view text);

  const Bytes& bytes() const { return bytes_; }
  Bytes take() { return std::move(bytes_); }

 private:
  static constexpr std::size_t short_message = 32;

  Bytes bytes_;
};

}  // namespace slamgw
