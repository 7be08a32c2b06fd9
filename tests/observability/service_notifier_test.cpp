// SPDX-License-Identifier: Apache-2.0
// The daemon's side of sd_notify, against a socket that stands for systemd.
#include "daemon/observability/service_notifier.hpp"

#include <gtest/gtest.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <stdexcept>
#include <utility>
#include <vector>

#include "tests/support/eventually.hpp"
#include "tests/support/temp_dir.hpp"

namespace slamgw {
namespace {

using namespace std::chrono_literals;

/// Receives what a service says, as systemd would, and sets the service's environment.
class ServiceManager {
 public:
  explicit ServiceManager(std::chrono::microseconds watchdog = 0us) {
    const std::string path = directory_ / "notify";
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    std::strncpy(address.sun_path, path.c_str(), sizeof address.sun_path - 1);
    socket_ = socket(AF_UNIX, SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    const auto* generic = reinterpret_cast<const sockaddr*>(&address);
    if (bind(socket_, generic, sizeof address) != 0) throw std::runtime_error(std::strerror(errno));
    setenv("NOTIFY_SOCKET", path.c_str(), 1);
    if (watchdog > 0us) setenv("WATCHDOG_USEC", std::to_string(watchdog.count()).c_str(), 1);
  }
  ~ServiceManager() {
    unsetenv("NOTIFY_SOCKET");
    unsetenv("WATCHDOG_USEC");
    close(socket_);
  }

  /// Returns all notifications so far, in order.
  const std::vector<std::string>& heard() {
    char text[1024];
    for (ssize_t size = 0; (size = recv(socket_, text, sizeof text, 0)) >= 0;)
      heard_.emplace_back(text, static_cast<std::size_t>(size));
    return heard_;
  }
  std::ptrdiff_t count(const std::string& message) {
    heard();
    return std::count(heard_.begin(), heard_.end(), message);
  }

 private:
  test::TempDir directory_;
  int socket_ = -1;
  std::vector<std::string> heard_;
};

ServiceState state_of(bool broker, Mesh mesh, bool is_up, std::size_t robots,
                      std::uint64_t messages) {
  ServiceState state{broker, {}, robots, messages};
  state.mesh_is_up[mesh] = is_up;
  return state;
}

TEST(ServiceNotifier, SendsReadyThenStatus) {
  ServiceManager manager;
  boost::asio::io_context io;
  ServiceNotifier notifier(io, [] { return state_of(true, Mesh::thread, true, 2, 7); });
  notifier.ready();
  EXPECT_EQ(manager.heard(),
            (std::vector<std::string>{"READY=1",
                                      "STATUS=broker up, thread up, 2 robots online, 0 msg/s"}));
}

TEST(ServiceNotifier, SendsStatusOnlyWhenItChanges) {
  ServiceManager manager;
  boost::asio::io_context io;
  int asked = 0;
  ServiceNotifier notifier(io, [&asked] { return state_of(++asked >= 3, Mesh::ble, false, 0, 0); });
  notifier.ready();
  ASSERT_TRUE(test::eventually(io, [&] { return asked >= 4; }));
  EXPECT_EQ(
      manager.heard(),
      (std::vector<std::string>{"READY=1", "STATUS=broker down, ble down, 0 robots online, 0 msg/s",
                                "STATUS=broker up, ble down, 0 robots online, 0 msg/s"}));
}

TEST(ServiceNotifier, CountsMessagesPerSecondBetweenStatusLines) {
  ServiceManager manager;
  boost::asio::io_context io;
  std::uint64_t messages = 1000;
  ServiceNotifier notifier(io, [&messages] {
    return ServiceState{true, {}, 1, std::exchange(messages, 1030)};
  });
  notifier.ready();
  EXPECT_TRUE(test::eventually(
      io, [&] { return manager.count("STATUS=broker up, 1 robots online, 30 msg/s") == 1; }));
}

TEST(ServiceNotifier, FeedsTheWatchdogWhileTheLoopTurns) {
  ServiceManager manager(20ms);
  boost::asio::io_context io;
  ServiceNotifier notifier(io, [] { return ServiceState{}; });
  EXPECT_EQ(manager.count("WATCHDOG=1"), 0);
  notifier.ready();
  EXPECT_TRUE(test::eventually(io, [&] { return manager.count("WATCHDOG=1") >= 4; }));
}

TEST(ServiceNotifier, SendsNoWatchdogWhenSystemdSetsNoTime) {
  ServiceManager manager;
  boost::asio::io_context io;
  int asked = 0;
  ServiceNotifier notifier(io, [&asked] {
    ++asked;
    return ServiceState{};
  });
  notifier.ready();
  ASSERT_TRUE(test::eventually(io, [&] { return asked >= 2; }));
  EXPECT_EQ(manager.count("WATCHDOG=1"), 0);
}

TEST(ServiceNotifier, SendsReloadingThenReady) {
  ServiceManager manager;
  boost::asio::io_context io;
  ServiceNotifier notifier(io, [] { return ServiceState{}; });
  notifier.ready();
  manager.heard();
  notifier.reloading();
  notifier.ready();
  const auto& heard = manager.heard();
  ASSERT_EQ(heard.size(), 4u);
  EXPECT_TRUE(heard[2].starts_with("RELOADING=1\nMONOTONIC_USEC=")) << heard[2];
  EXPECT_EQ(heard[3], "READY=1");
}

TEST(ServiceNotifier, LeavesNoTimerAfterStopping) {
  ServiceManager manager(20ms);
  boost::asio::io_context io;
  ServiceNotifier notifier(io, [] { return ServiceState{}; });
  notifier.ready();
  ASSERT_TRUE(test::eventually(io, [&] { return manager.count("WATCHDOG=1") >= 2; }));
  notifier.stopping();
  io.run_for(test::patience);
  EXPECT_TRUE(io.stopped());  // no timer is left
  EXPECT_EQ(manager.heard().back(), "STOPPING=1");
}

TEST(ServiceNotifier, DoesNothingWithoutSystemd) {
  unsetenv("NOTIFY_SOCKET");
  boost::asio::io_context io;
  ServiceNotifier notifier(
      io, []() -> ServiceState { throw std::logic_error("asked without systemd"); });
  notifier.ready();
  notifier.reloading();
  notifier.stopping();
  EXPECT_EQ(io.run(), 0u);
}

}  // namespace
}  // namespace slamgw
