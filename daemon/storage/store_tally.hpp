// SPDX-License-Identifier: Apache-2.0
// `messages.db-tally` beside the store: one line that says what `messages.db` held after its last
// commit. A log that lost its end is a valid shorter log for SQLite; the tally is how that shows.
// Written after each commit without a synchronisation: it survives the end of the process, and
// after a power cut it is older than the file at most, which raises no alarm. Its lock keeps a
// second daemon away from the store, also while this one has the database closed. Blocks; used on
// the store's thread.
#pragma once

#include <optional>
#include <string>

#include "daemon/storage/message_row.hpp"

namespace slamgw {

class StoreTally {
 public:
  /// Opens or makes the file (0600), and locks it. Throws SqliteError: locked when another process
  /// holds it for longer than `store_busy_wait_ms`, I/O errors.
  explicit StoreTally(const std::string& path);
  ~StoreTally();
  StoreTally(const StoreTally&) = delete;
  StoreTally& operator=(const StoreTally&) = delete;

  /// Nothing when there is none yet, or it is damaged or of another format.
  std::optional<StoreContents> read() const;
  /// After a failure the tally is older or missing; then lost commits may go unnoticed.
  void write(const StoreContents& contents);

 private:
  int file_ = -1;
};

}  // namespace slamgw
