// SPDX-License-Identifier: Apache-2.0
// A SQLite file or its log as octets, read past SQLite's cache and checks but through its file
// system layer, so that SQLite's own locks on the file stay. Only while the database is closed.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "daemon/core/bytes.hpp"

struct sqlite3_file;

namespace slamgw {

class RawFile {
 public:
  enum class Kind : std::uint8_t { database, log };

  /// A file that is not there is an empty one. Throws SqliteError when it cannot be opened.
  RawFile(const std::string& path, Kind kind);

  std::uint64_t size() const { return size_; }
  /// `count` octets; zeroes beyond the end. Nothing when the disk cannot read them.
  bool read(std::uint64_t offset, std::size_t count, Bytes& into) const;

 private:
  struct Close {
    void operator()(sqlite3_file* file) const;
  };
  std::unique_ptr<sqlite3_file, Close> file_;
  std::uint64_t size_ = 0;
};

}  // namespace slamgw
