// SPDX-License-Identifier: Apache-2.0
// Recorded transcripts of Nordic's serial board: tests/vectors/nordic_board/README.md describes the
// format.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace slamgw::test {

/// A packet from the board, its length octet first.
struct RecordedPacket {
  std::vector<std::uint8_t> octets;  ///< 0 where undefined
  std::vector<bool> is_defined;      ///< for each of them

  /// Undefined octets match any value.
  bool matches(std::span<const std::uint8_t> packet) const;
  /// As in the file.
  std::string text() const;
};

/// An access message that the board gives to its radio.
struct RecordedMessage {
  std::uint16_t source = 0;
  std::uint16_t destination = 0;
  std::uint8_t ttl = 0;
  bool is_device_key = false;  ///< else an application key
  std::vector<std::uint8_t> payload;

  bool operator==(const RecordedMessage&) const = default;
};

struct Exchange {
  std::string situation;
  std::size_t line = 0;  ///< in the file
  /// The packet that the host writes; empty when the board sends first, at power on.
  std::vector<std::uint8_t> command;
  std::vector<RecordedPacket> answers;  ///< answers and events, in their order; may be none
  std::optional<RecordedMessage> on_air;
};

/// From power on.
struct Transcript {
  std::string name;
  std::string title;
  std::vector<Exchange> exchanges;
};

/// The releases that the file is about, for example "2.2.0", "3.1.0", "5.0.0". `file` is a name in
/// tests/vectors/nordic_board, such as "board.txt". These three throw std::runtime_error when the
/// file cannot be read or breaks the format.
std::vector<std::string> releases_of(std::string_view file);
/// Returns all transcripts of the file for that release.
std::vector<Transcript> read_transcripts(std::string_view file, std::string_view release);
Transcript read_transcript(std::string_view file, std::string_view name, std::string_view release);

}  // namespace slamgw::test
