// SPDX-License-Identifier: Apache-2.0
// Rows of `messages.db` as they are on disk, and their checksums.
#pragma once

#include <cstdint>
#include <optional>
#include <string_view>

#include "daemon/core/messages.hpp"
#include "daemon/storage/sqlite.hpp"

namespace slamgw {

/// A row of `messages`. Times are milliseconds since 1970; `mesh` is 0 for none, else 1 + Mesh.
struct MessageRow {
  std::int64_t row = 0;
  std::string_view topic{};
  ByteView payload{};
  std::int64_t qos = 0;
  std::int64_t retain = 0;
  std::int64_t stored_at = 0;
  std::int64_t mesh = 0;
  std::int64_t received_at = 0;
};

/// A row of `dead_letters`. `message.row` is its number: that of the message it was.
struct DeadLetterRow {
  MessageRow message{};
  std::string_view reason{};
  std::int64_t code = 0;
  std::int64_t tries = 0;
  std::int64_t set_aside_at = 0;
};

/// The reason of a dead letter whose message is not what was stored.
inline constexpr std::string_view damaged_on_disk = "damaged on disk: its checksum does not match";

/// A row that was saved from a damaged file.
struct SavedRow {
  Bytes octets;       ///< what the views in `row` are of
  DeadLetterRow row;  ///< of a message: only its `message`
  bool is_dead_letter = false;
};

/// What the file holds, as of its last commit; its one row of `contents`.
struct StoreContents {
  std::int64_t file = 0;  ///< a random number that identifies this file
  std::int64_t commits = 0;
  std::int64_t messages = 0;
  std::int64_t dead_letters = 0;
  std::int64_t dead_letter_bytes = 0;  ///< as counted against `store.max_bytes`
  std::int64_t first_row = 0;          ///< messages below it were delivered
  std::int64_t last_row = 0;           ///< the highest number that a message ever had
  bool operator==(const StoreContents&) const = default;
};

/// CRC-32 (ISO-HDLC) of every value, in the order above; numbers as 8 octets, little-endian; texts
/// and blobs after their length.
std::uint32_t checksum(const MessageRow& row);
std::uint32_t checksum(const DeadLetterRow& row);
std::uint32_t checksum(const StoreContents& contents);

/// The checksum of a row that was stored before rows had one. No row written since has it.
inline constexpr std::int64_t unchecked = -1;

/// The values of `message`, as views into it.
MessageRow row_of(std::uint64_t row, const BrokerMessage& message, std::int64_t stored_at);
BrokerMessage message_of(const MessageRow& row);
/// The first eight columns of the row that `statement` is at; valid until it moves on.
MessageRow message_row_at(const SqliteStatement& statement);

}  // namespace slamgw
