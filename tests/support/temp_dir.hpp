// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <string_view>

namespace slamgw::test {

/// A directory that is removed with its object.
class TempDir {
 public:
  TempDir();
  ~TempDir();
  TempDir(const TempDir&) = delete;
  TempDir& operator=(const TempDir&) = delete;

  std::string operator/(std::string_view name) const { return path_ + "/" + std::string(name); }
  const std::string& path() const { return path_; }

 private:
  std::string path_;
};

void write_file(const std::string& path, std::string_view text, unsigned mode = 0644);
/// Returns the current contents; empty when the file does not exist.
std::string read_file(const std::string& path);
/// Returns the contents of all files of a directory.
std::string read_files(const std::string& directory);

}  // namespace slamgw::test
