// SPDX-License-Identifier: Apache-2.0
// A session's snapshot as octets for the store, and back. CBOR (RFC 8949) of a map with a
// `version`; members that this version does not know are ignored. Pure; called by SessionKeeper.
#pragma once

#include <concepts>
#include <cstdint>
#include <optional>
#include <string_view>
#include <utility>

#include "adapters/mqttsn_udp/clients/session_snapshot.hpp"
#include "daemon/core/bytes.hpp"

namespace slamgw::mqttsn {

/// CBOR (RFC 8949) as it is written, without a tree of values before: each connection saves a
/// session. Maps and arrays have no length in front (section 3.2.2); end() closes the innermost.
class CborWriter {
 public:
  CborWriter() { out_.reserve(short_text); }

  void begin_array() { out_.push_back(0x9f); }
  void begin_map() { out_.push_back(0xbf); }
  void end() { out_.push_back(0xff); }

  void write(bool value) { out_.push_back(value ? 0xf5 : 0xf4); }
  template <std::unsigned_integral Number>
  void write(Number value) {
    write_head(unsigned_type, value);
  }
  void write(std::string_view text) {
    write_head(text_type, text.size());
    append(as_bytes(text));
  }
  void write(const char* text) { write(std::string_view(text)); }
  void write(ByteView octets) {
    write_head(octets_type, octets.size());
    append(octets);
  }

  /// A member of a map.
  template <class Value>
  void write(std::string_view name, const Value& value) {
    write(name);
    write(value);
  }

  /// In no more memory than it needs: thousands may wait for the disk.
  Bytes take() {
    out_.shrink_to_fit();
    return std::move(out_);
  }

 private:
  /// What a session of one topic takes, so that it is written into one piece of memory.
  static constexpr std::size_t short_text = 512;
  // Major types, section 3.1
  static constexpr std::uint8_t unsigned_type = 0x00;
  static constexpr std::uint8_t octets_type = 0x40;
  static constexpr std::uint8_t text_type = 0x60;

  void write_head(std::uint8_t type, std::uint64_t argument) {
    constexpr unsigned in_head = 24;  // smaller ones are part of the first octet
    unsigned size_code = 0;           // 2 to the power of it: octets that follow
    while (size_code < 3 && argument >> (8U << size_code) != 0) ++size_code;
    if (argument < in_head) return out_.push_back(static_cast<std::uint8_t>(type | argument));
    out_.push_back(static_cast<std::uint8_t>(type | (in_head + size_code)));
    for (unsigned shift = 8U << size_code; shift > 0; shift -= 8)
      out_.push_back(static_cast<std::uint8_t>(argument >> (shift - 8)));
  }
  void append(ByteView octets) { out_.insert(out_.end(), octets.begin(), octets.end()); }

  Bytes out_;
};

Bytes encode_session(const SessionSnapshot& snapshot);
/// Nothing when the octets are damaged or of a newer version.
std::optional<SessionSnapshot> decode_session(ByteView content);

}  // namespace slamgw::mqttsn
