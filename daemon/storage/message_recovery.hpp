// SPDX-License-Identifier: Apache-2.0
// Saves what can be read from a damaged `messages.db` and its log into a new file: messages and
// dead letters whose checksum is right, under their numbers; those whose checksum is wrong become
// dead letters. Needs neither a whole page 1 nor a whole tree. Blocks; used on the store's thread
// while the damaged file is closed.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "daemon/storage/database_pages.hpp"
#include "daemon/storage/message_file.hpp"
#include "daemon/storage/message_row.hpp"
#include "daemon/storage/table_record.hpp"

namespace slamgw {

class MessageRecovery {
 public:
  /// Where the newest pages are lost, what is saved from older ones may have been delivered
  /// before; then only bounds are known.
  struct Lost {
    std::size_t at_least = 0;
    std::size_t at_most = 0;
  };
  struct Result {
    std::size_t messages = 0;           ///< saved
    std::size_t damaged = 0;            ///< set aside as dead letters
    std::size_t dead_letters = 0;       ///< saved, without the damaged
    std::optional<Lost> lost_messages;  ///< nothing: how many there were is not known
    std::optional<std::size_t> lost_dead_letters;
  };

  /// Looks for rows in every page. `tally`: what the file held when it was written last, if known.
  /// Throws SqliteError when a file cannot be opened.
  MessageRecovery(const std::string& path, const std::optional<StoreContents>& tally);

  /// Parts of the file that the disk could not read. A disk that fails for a moment reads them at
  /// the next attempt.
  std::size_t unreadable() const { return pages_.unreadable(); }
  bool has_found_anything() const { return !found_.empty(); }
  Result result() const;

  /// Writes a new file; `path` does not exist or is empty. Complete and durable when this returns.
  /// Throws SqliteError.
  void save_to(const std::string& path, std::uint64_t max_bytes);

 private:
  enum class Table : std::uint8_t { messages, dead_letters };
  /// A row as read, good or damaged.
  struct Row {
    Table table = Table::messages;
    DeadLetterRow values;  ///< of a message: the others are empty
    bool is_good = false;
  };
  struct Found {
    Table table = Table::messages;
    std::int64_t row = 0;
    bool is_good = false;
    bool is_current = false;
    std::uint32_t version = 0;  ///< index in pages_.versions()
    std::uint32_t cell = 0;
  };

  static std::optional<Row> row_in(const TableRecord& record);
  void on_record(std::uint32_t version, std::uint32_t cell, const TableRecord& record);
  void take_contents(const TableRecord& record);
  void choose();
  void drop_outdated(Table table, std::int64_t expected);
  SavedRow read_again(const Found& found);
  std::size_t count(Table table, bool is_good) const;
  Lost lost_messages(std::size_t found) const;

  DatabasePages pages_;
  std::optional<StoreContents> contents_;  // the newest that is known
  std::int64_t commits_in_file_ = 0;       // of the newest contents that the file itself holds
  std::vector<Found> found_;
};

}  // namespace slamgw
