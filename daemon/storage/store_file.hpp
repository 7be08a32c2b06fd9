// SPDX-License-Identifier: Apache-2.0
// How this daemon treats its SQLite files in `store.directory`: readable by the service only,
// recognised by their `user_version`, never touched when they are another program's or newer, put
// aside and never overwritten when they are damaged. Blocks; used on the stores' threads.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>

#include "daemon/core/time.hpp"
#include "daemon/storage/sqlite.hpp"

namespace slamgw {

// Decides whether a file that cannot be used is damaged, or its disk only fails for a moment
// (SQLite calls both "malformed"). Pure; asked by the stores after each check of the file. Also how
// long they wait for a disk.

/// How long the stores wait for a disk.
struct StorePatience {
  /// Between attempts to open a file that could not be opened.
  std::chrono::milliseconds reopen{10000};
  /// Between checks of a file that seems damaged or cannot be read.
  std::chrono::milliseconds check{1000};
  /// How long such checks may hold up the start before the daemon continues without the store.
  std::chrono::milliseconds opening{10000};
  /// Parts of the file that the disk could not read for so long are lost.
  std::chrono::milliseconds unreadable{60000};
  /// How long the outbox may take to keep a page of dead letters that are sent again.
  std::chrono::milliseconds resend{10000};
};

class DamageVerdict {
 public:
  /// A file counts as damaged when it was unusable so many times in a row and all of it could be
  /// read.
  static constexpr int checks_needed = 3;

  /// `unreadable_patience`: parts that could not be read for so long are lost.
  explicit DamageVerdict(Duration unreadable_patience)
      : unreadable_patience_(unreadable_patience) {}

  /// The disk failed to read something.
  void on_read_error(TimePoint now) {
    if (!failing_since_) failing_since_ = now;
  }
  /// It has failed for so long that the whole file is to be checked.
  bool is_persistent(TimePoint now) const {
    return failing_since_ && now - *failing_since_ >= unreadable_patience_;
  }
  /// The file was found unusable, and `unreadable` of its parts could not be read. True when what
  /// is left of it is to be saved.
  bool is_damaged(std::size_t unreadable, TimePoint now) {
    if (unreadable == 0) return ++failed_checks_ >= checks_needed;
    failed_checks_ = 0;
    on_read_error(now);
    return is_persistent(now);
  }
  /// The file can be used.
  void reset() {
    failed_checks_ = 0;
    failing_since_.reset();
  }

 private:
  Duration unreadable_patience_;
  int failed_checks_ = 0;
  std::optional<TimePoint> failing_since_;
};

/// The file is not ours to change; what() says why.
class ForeignFile : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// Time given to an earlier process that is still closing the file.
inline constexpr int store_busy_wait_ms = 3000;
/// Damaged files that are kept beside one store: all that could be read of them was saved, so only
/// the newest are of use to an expert.
inline constexpr std::size_t max_damaged_files = 4;
/// Files of others that were found in the store's place and put aside. They are never removed: when
/// there are so many, the store stays closed until an operator has removed some.
inline constexpr std::size_t max_files_aside = 16;
/// The word in a damaged file's name.
inline constexpr const char* damaged_word = "corrupt";

struct StoreTable {
  const char* name = "";
  const char* columns = "";  ///< quoted and separated by commas
  int column_count = 0;
};

/// How a file of ours is recognised and made.
struct StoreFormat {
  int version = 0;          ///< `user_version`
  const char* create = "";  ///< statements that make the tables
  std::span<const StoreTable> tables{};
  std::span<const char* const> upgrades{};  ///< statements from version 1 to 2, 2 to 3, ...
  std::uint32_t page_bytes = 4096;          ///< of a new file
};

/// Makes an empty file (0600) and its directory (0700) where there is none. Throws
/// std::runtime_error.
void make_store_file(const std::string& directory, const std::string& path);
void make_store_directory(const std::string& directory);

/// Opens it, locked for this process, with a write-ahead log; makes an empty one ours. Writes
/// nothing before it knows that the file is ours and sound, and leaves the log as it is on close
/// until `keep_log_on_close(false)`. `is_known`: the file was ours when it was last seen, so that
/// another version number in it is damage. Throws SqliteError and ForeignFile.
SqliteDatabase open_store_file(const std::string& path, const StoreFormat& format,
                               bool is_known = false);

/// Renames the file and its log to a free name, `<path>.<word>-<time>`, and returns that name;
/// nothing when there is no file. Of damaged ones the oldest go.
/// Throws std::runtime_error when that fails or there are `max_files_aside` already.
std::string put_store_file_aside(const std::string& path, const char* word);
/// Removes the oldest damaged files beside `path` while the disk has no room for one more copy.
void make_room_for_copy(const std::string& path);

/// The error in words for people, and what to do where that is known.
std::string words_for(const SqliteError& error);

/// Makes renames in the directory of `path` durable.
void synchronise_directory_of(const std::string& path);

}  // namespace slamgw
