// SPDX-License-Identifier: Apache-2.0
// How this daemon treats its SQLite files in `store.directory`: readable by the service only,
// recognised by their `user_version`, never touched when they are somebody else's or newer, moved
// aside when they are damaged. Blocks; used by MessageFile and SessionFile on their threads.
#pragma once

#include <cstdint>
#include <stdexcept>
#include <string>

#include "daemon/storage/sqlite.hpp"

namespace slamgw {

/// The file is not ours to change; what() says why.
class ForeignFile : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// How long a predecessor that is still closing is waited for.
inline constexpr int store_busy_wait_ms = 3000;

/// What makes a file ours.
struct StoreFormat {
  int version = 0;          ///< `user_version`
  const char* create = "";  ///< the statement that makes `table`
  const char* table = "";
  const char* columns = "";  ///< quoted and separated by commas
  int column_count = 0;
  const char* upgrade = "";         ///< statements from the version before this one
  std::uint32_t page_bytes = 4096;  ///< of a new file
};

/// Makes an empty file (0600) and its directory (0700) where there is none. Throws
/// std::runtime_error.
void make_store_file(const std::string& directory, const std::string& path);

/// Opens it, locked for this process, with a write-ahead log; makes an empty one ours. Writes
/// nothing before it knows that the file is ours and sound. Throws SqliteError and ForeignFile.
SqliteDatabase open_store_file(const std::string& path, const StoreFormat& format);

/// Renames the file and its log to `<path>.corrupt-<time>`, and returns that name.
std::string move_store_file_aside(const std::string& path);

}  // namespace slamgw
