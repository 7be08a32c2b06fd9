// SPDX-License-Identifier: Apache-2.0
#include "ctl/host/archive_file.hpp"

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <charconv>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <optional>
#include <string_view>
#include <utility>

#include "ctl/connection.hpp"

namespace slamgw::ctl {
namespace {

std::optional<unsigned> number_in(const char* variable) {
  const char* const value = std::getenv(variable);
  if (value == nullptr) return std::nullopt;
  const std::string_view text = value;
  unsigned number = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
  if (error != std::errc{} || end != text.data() + text.size()) return std::nullopt;
  return number;
}

/// sudo(8) sets SUDO_UID and SUDO_GID.
void give_to_caller(int file) {
  const auto user = number_in("SUDO_UID");
  const auto group = number_in("SUDO_GID");
  if (geteuid() != 0 || !user || !group) return;
  if (fchown(file, *user, *group) != 0) return;  // then it stays root's
}

}  // namespace

ArchiveFile::ArchiveFile(std::string file)
    : file_(std::move(file)), unfinished_(file_ + ".unfinished") {
  std::error_code error;
  if (std::filesystem::is_directory(file_, error))
    throw Failure(file_ + " is a directory; name a file in it");
  unlink(unfinished_.c_str());
  made_ = open(unfinished_.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0600);
  if (made_ < 0) throw Failure(file_ + ": " + std::strerror(errno));
}

ArchiveFile::~ArchiveFile() {
  close(made_);
  unlink(unfinished_.c_str());
}

/// Not before: in /tmp the kernel does not let root write to another user's file
/// (fs.protected_regular in proc_sys_fs(5)).
void ArchiveFile::finish() {
  give_to_caller(made_);
  if (rename(unfinished_.c_str(), file_.c_str()) != 0)
    throw Failure(file_ + ": " + std::strerror(errno));
}

}  // namespace slamgw::ctl
