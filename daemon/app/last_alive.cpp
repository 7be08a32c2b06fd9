// SPDX-License-Identifier: Apache-2.0
#include "daemon/app/last_alive.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <boost/asio/post.hpp>
#include <fstream>

#include "daemon/runtime/machine_driver.hpp"
#include "daemon/runtime/owned_file.hpp"

namespace slamgw {

LastAlive::LastAlive(boost::asio::io_context& io, const std::string& directory)
    : path_(directory + "/alive"), timer_(io) {
  read();
}

/// Takes the larger of the ages by two clocks: the steady clock begins again at a reboot, and the
/// wall clock of a host without a battery may stand still while the power is off.
void LastAlive::read() {
  struct stat file {};
  std::int64_t seconds = 0;
  std::string uri;
  if (::stat(path_.c_str(), &file) != 0) return;
  online_ = Online{};  // of a time and a broker that are not known
  if (!(std::ifstream(path_) >> seconds >> uri)) return;
  const Now now = read_clocks();
  const auto up = std::chrono::floor<std::chrono::seconds>(now.mono.time_since_epoch());
  const auto changed = std::chrono::system_clock::from_time_t(file.st_mtime);
  if (seconds < 0 || seconds > up.count() || changed > now.wall) return;
  const Duration wall_age = std::chrono::duration_cast<Duration>(now.wall - changed);
  const Duration age = std::max<Duration>(up - std::chrono::seconds{seconds}, wall_age);
  before_start_ = online_ = {now.mono - age, std::move(uri)};
}

void LastAlive::on_broker_up(const std::string& uri) {
  const TimePoint now = read_clocks().mono;
  const bool was_elsewhere = online_ && (now - online_->time > 2 * interval || uri != online_->uri);
  write_from_ = was_elsewhere ? now + 2 * interval : now;
  broker_uri_ = uri;
  write();
  timer_.every(interval, [this] { write(); });
}

void LastAlive::on_broker_down() {
  broker_uri_.clear();
  timer_.cancel();
}

void LastAlive::write() {
  const TimePoint now = read_clocks().mono;
  if (broker_uri_.empty() || now < write_from_) return;
  online_ = {now, broker_uri_};
  const auto up = std::chrono::floor<std::chrono::seconds>(now.time_since_epoch());
  std::string text = fmt::format("{} {}\n", up.count(), broker_uri_);
  boost::asio::post(disk_, [path = path_, text = std::move(text)] {
    const OwnedFile file(::open(path.c_str(), O_WRONLY | O_CREAT | O_CLOEXEC, 0600));
    if (file.get() < 0) return;
    const auto size = static_cast<ssize_t>(text.size());
    if (::pwrite(file.get(), text.data(), text.size(), 0) != size ||
        ::ftruncate(file.get(), size) != 0)
      ::unlink(path.c_str());
  });
}

void LastAlive::stop() {
  timer_.cancel();
  write();
  disk_.join();
}

}  // namespace slamgw
