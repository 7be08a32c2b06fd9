// SPDX-License-Identifier: Apache-2.0
// Every page that is left of a SQLite database, from its file and its write-ahead log, also when
// SQLite refuses both (file format: https://www.sqlite.org/fileformat2.html, sections 1 and 4).
// Trusts nothing that it reads. Reads once through the log when it is made.
#pragma once

#include <cstdint>
#include <string>
#include <unordered_map>
#include <vector>

#include "daemon/storage/raw_file.hpp"

namespace slamgw {

class DatabasePages {
 public:
  /// One version of a page.
  struct Version {
    std::uint32_t page = 0;  ///< counted from 1
    std::uint64_t offset = 0;
    bool is_in_log = false;
    bool is_current = false;  ///< what SQLite would see, were nothing damaged
  };

  /// Throws SqliteError when a file cannot be opened. `page_bytes`: of the database.
  DatabasePages(const std::string& path, std::uint32_t page_bytes);

  /// The current version of each page; and when the log is damaged all other versions behind them,
  /// because the version that should have followed may be lost.
  const std::vector<Version>& versions() const { return versions_; }
  /// False, and counted, when the disk cannot read all of it. `into` then has the readable parts
  /// and zeros for the rest.
  bool read(const Version& version, Bytes& into);
  /// The current version of `page`. False when there is none or it cannot be read.
  bool read(std::uint32_t page, Bytes& into);

  std::size_t unreadable() const { return unreadable_; }
  bool is_log_damaged() const { return is_log_damaged_; }

 private:
  struct Frame {
    std::uint32_t page = 0;
    std::uint32_t pages_after_commit = 0;  ///< 0: no commit
    std::uint64_t salts = 0;
    std::uint64_t stored_checksum = 0;
    bool is_verified = false;
  };
  std::vector<Frame> read_log();
  bool read_all(const RawFile& file, std::uint64_t offset, std::size_t count, Bytes& into);
  void add_versions(const std::vector<Frame>& frames);

  const std::uint32_t page_bytes_;
  RawFile database_;
  RawFile log_;
  bool is_log_damaged_ = false;
  std::size_t unreadable_ = 0;
  std::vector<Version> versions_;
  std::unordered_map<std::uint32_t, std::size_t> current_;  // page to index in versions_
};

}  // namespace slamgw
