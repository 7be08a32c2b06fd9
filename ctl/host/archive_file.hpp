// SPDX-License-Identifier: Apache-2.0
// The file that backup and report leave.
#pragma once

#include <string>

namespace slamgw::ctl {

/// A file with mode 0600 that gets its name only when it is whole. Made by root through sudo, it
/// belongs to the user who typed sudo: otherwise that user could neither copy nor send it.
class ArchiveFile {
 public:
  /// Throws Failure when it can't be made.
  explicit ArchiveFile(std::string file);
  /// Removes what was not finished.
  ~ArchiveFile();
  ArchiveFile(const ArchiveFile&) = delete;
  ArchiveFile& operator=(const ArchiveFile&) = delete;

  /// Where to write until finish().
  const std::string& path() const { return unfinished_; }
  void finish();

 private:
  std::string file_;
  std::string unfinished_;
  int made_ = -1;  ///< the unfinished file
};

}  // namespace slamgw::ctl
