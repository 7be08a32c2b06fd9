// SPDX-License-Identifier: Apache-2.0
// System calls that fail on command, for every file of this process while it exists. Its settings
// may be changed from any thread.
#pragma once

#include <atomic>
#include <cstdint>
#include <string>

namespace slamgw::test {

class FaultyDisk {
 public:
  FaultyDisk();
  ~FaultyDisk();
  FaultyDisk(const FaultyDisk&) = delete;
  FaultyDisk& operator=(const FaultyDisk&) = delete;

  /// Every pread() fails with EIO.
  static std::atomic<bool> fails_reads;
  /// Reads that touch these octets of the file fail, also when it was renamed.
  static void make_unreadable(const std::string& path, std::uint64_t from, std::uint64_t to);
  /// Every pwrite() fails with EIO.
  static std::atomic<bool> fails_writes;
  /// fdatasync() and fsync() fail with EIO; octets that were written before stay in the file.
  static std::atomic<bool> fails_syncs;
  /// No file can be opened for writing or removed (EROFS). Files that are open can be written.
  static std::atomic<bool> is_read_only;
  static std::atomic<std::uint64_t> failed_reads;  ///< the number of reads that failed
};

}  // namespace slamgw::test
