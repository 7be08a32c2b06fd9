// SPDX-License-Identifier: Apache-2.0
// Replaces a store's file by a new one, safely even if the process ends meanwhile: the new one is
// written beside it, gets another name when it is complete, and from then on it is the file; the
// former one is put aside. Blocks; used on the stores' threads. All members throw SqliteError or
// std::runtime_error.
#pragma once

#include <string>

namespace slamgw {

class FileReplacement {
 public:
  explicit FileReplacement(const std::string& path);

  /// An empty file to write the new content to, without a log beside it in the end.
  const std::string& begin() const;
  /// It is complete and durable: puts it in place. Returns where the former file is now, if there
  /// was one; its name has `word` in it.
  std::string finish(const char* word) const;
  /// The same for what an earlier process has completed; nothing when there is none.
  std::string finish_what_was_begun(const char* word) const;

 private:
  const std::string path_;
  const std::string unfinished_path_;
  const std::string finished_path_;
};

}  // namespace slamgw
