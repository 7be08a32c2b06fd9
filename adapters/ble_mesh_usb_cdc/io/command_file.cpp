// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/io/command_file.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <fstream>
#include <iterator>

namespace slamgw::ble {
namespace {

/// In one call, so that a process that is killed leaves the old line or the new one.
bool replace_content(int file, const std::string& text) {
  const ssize_t written = ::pwrite(file, text.data(), text.size(), 0);
  if (written >= 0 && static_cast<std::size_t>(written) != text.size()) errno = ENOSPC;
  return written == static_cast<ssize_t>(text.size()) &&
         ::ftruncate(file, static_cast<off_t>(text.size())) == 0;
}

}  // namespace

std::optional<std::vector<OpenCommand>> CommandFile::load(const Now& now) const {
  if (::access(path_.c_str(), F_OK) != 0) return std::vector<OpenCommand>();
  std::ifstream file(path_, std::ios::binary);
  const std::string text{std::istreambuf_iterator<char>(file), {}};
  if (text.empty() && file) return std::vector<OpenCommand>();  // killed before the first write
  return decode_open_commands(text, now);
}

std::string CommandFile::write(const std::string& text) const {
  const int file = ::open(path_.c_str(), O_WRONLY | O_CREAT | O_CLOEXEC, 0600);
  const bool is_written = file >= 0 && replace_content(file, text);
  const int error = errno;
  if (file >= 0) ::close(file);
  if (is_written) return {};
  return fmt::format(
      "{} can't be written ({}): after a crash, commands that are under way over BLE would have no "
      "outcome",
      path_, std::strerror(error));
}

}  // namespace slamgw::ble
