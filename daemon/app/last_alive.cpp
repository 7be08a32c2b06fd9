// SPDX-License-Identifier: Apache-2.0
#include "daemon/app/last_alive.hpp"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <boost/asio/post.hpp>

#include "daemon/runtime/machine_driver.hpp"

namespace slamgw {

LastAlive::LastAlive(boost::asio::io_context& io, const std::string& directory)
    : path_(directory + "/alive"), timer_(io) {
  struct stat file {};
  if (::stat(path_.c_str(), &file) != 0) return;
  const Now now = read_clocks();
  const auto changed = std::chrono::system_clock::from_time_t(file.st_mtime);
  const auto age = std::max<WallTime::duration>(now.wall - changed, {});
  before_start_ = now.mono - std::chrono::duration_cast<Duration>(age);
}

void LastAlive::start() {
  touch();
  timer_.expires_after(interval);
  timer_.async_wait([this](boost::system::error_code error) {
    if (!error) start();
  });
}

void LastAlive::touch() {
  boost::asio::post(disk_, [path = path_] {
    const int file = ::open(path.c_str(), O_WRONLY | O_CREAT | O_CLOEXEC, 0600);
    if (file < 0) return;
    ::futimens(file, nullptr);
    ::close(file);
  });
}

void LastAlive::stop() {
  timer_.cancel();
  touch();
  disk_.join();
}

}  // namespace slamgw
