// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <stdlib.h>

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <string>

#include "ctl/connection.hpp"

namespace slamgw::ctl {

/// A directory that only this user can read, gone with this object.
class WorkDirectory {
 public:
  WorkDirectory() {
    std::string name = (std::filesystem::temp_directory_path() / "slam-gatewayctl-XXXXXX").string();
    if (mkdtemp(name.data()) == nullptr) throw Failure(name + ": " + std::strerror(errno));
    path_ = name;
  }
  ~WorkDirectory() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  WorkDirectory(const WorkDirectory&) = delete;
  WorkDirectory& operator=(const WorkDirectory&) = delete;
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

}  // namespace slamgw::ctl
