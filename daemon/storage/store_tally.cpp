// SPDX-License-Identifier: Apache-2.0
#include "daemon/storage/store_tally.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <sqlite3.h>
#include <sys/file.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <sstream>
#include <thread>

#include "daemon/storage/sqlite.hpp"
#include "daemon/storage/store_file.hpp"

namespace slamgw {
namespace {

/// The line is padded, so that a shorter one never leaves the end of a longer one behind.
constexpr std::size_t line_bytes = 256;
constexpr const char* heading = "slam-gateway-store-tally-1";
constexpr std::chrono::milliseconds lock_poll{50};

std::string line_of(const StoreContents& contents) {
  return fmt::format("{} {} {} {} {} {} {} {} {}", heading, contents.file, contents.commits,
                     contents.messages, contents.dead_letters, contents.dead_letter_bytes,
                     contents.first_row, contents.last_row, checksum(contents));
}

bool lock(int file) {
  for (int waited_ms = 0; flock(file, LOCK_EX | LOCK_NB) != 0;
       waited_ms += static_cast<int>(lock_poll.count())) {
    if (errno != EWOULDBLOCK || waited_ms >= store_busy_wait_ms) return false;
    std::this_thread::sleep_for(lock_poll);
  }
  return true;
}

}  // namespace

StoreTally::StoreTally(const std::string& path)
    : file_(::open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0600)) {
  if (file_ < 0) {
    throw SqliteError(errno == EIO ? SQLITE_IOERR : SQLITE_CANTOPEN, std::strerror(errno));
  }
  if (lock(file_)) return;
  ::close(file_);
  throw SqliteError(SQLITE_BUSY, "locked");
}

StoreTally::~StoreTally() { ::close(file_); }

std::optional<StoreContents> StoreTally::read() const {
  std::array<char, line_bytes> buffer{};
  const ssize_t size = pread(file_, buffer.data(), buffer.size(), 0);
  if (size <= 0) return std::nullopt;
  std::istringstream line(std::string(buffer.data(), static_cast<std::size_t>(size)));
  std::string found_heading;
  StoreContents contents;
  std::uint32_t found_checksum = 0;
  line >> found_heading >> contents.file >> contents.commits >> contents.messages >>
      contents.dead_letters >> contents.dead_letter_bytes >> contents.first_row >>
      contents.last_row >> found_checksum;
  if (!line || found_heading != heading || found_checksum != checksum(contents)) {
    return std::nullopt;
  }
  return contents;
}

void StoreTally::write(const StoreContents& contents) {
  std::string line = line_of(contents);
  line.resize(line_bytes - 1, ' ');
  line += '\n';
  // Its checksum distinguishes a whole line from what a failure leaves.
  [[maybe_unused]] const ssize_t written = pwrite(file_, line.data(), line.size(), 0);
}

}  // namespace slamgw
