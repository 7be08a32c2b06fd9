// SPDX-License-Identifier: Apache-2.0
#include "daemon/storage/file_replacement.hpp"

#include <filesystem>

#include "daemon/storage/store_file.hpp"

namespace slamgw {

namespace fs = std::filesystem;

FileReplacement::FileReplacement(const std::string& path)
    : path_(path), unfinished_path_(path + "-saving"), finished_path_(path + "-saved") {}

const std::string& FileReplacement::begin() const {
  std::error_code ignored;
  fs::remove(unfinished_path_ + "-wal", ignored);
  fs::remove(unfinished_path_, ignored);
  make_room_for_copy(path_);
  make_store_file(fs::path(path_).parent_path(), unfinished_path_);
  return unfinished_path_;
}

std::string FileReplacement::finish(const char* word) const {
  fs::rename(unfinished_path_, finished_path_);
  synchronise_directory_of(path_);
  return finish_what_was_begun(word);
}

std::string FileReplacement::finish_what_was_begun(const char* word) const {
  if (!fs::exists(finished_path_)) return {};
  const std::string aside = put_store_file_aside(path_, word);
  fs::rename(finished_path_, path_);
  synchronise_directory_of(path_);
  return aside;
}

}  // namespace slamgw
