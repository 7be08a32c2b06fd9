// SPDX-License-Identifier: Apache-2.0
// UDP sockets that systemd keeps over a restart: datagrams of devices are not refused while no
// daemon runs, and are answered afterwards. The test plays systemd.
#include <fmt/format.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <cstring>
#include <map>

#include "tests/e2e/device.hpp"
#include "tests/e2e/gateway_process.hpp"
#include "tests/support/mosquitto.hpp"

namespace slamgw::test {
namespace {

using nlohmann::json;
using sim::sn::Type;

/// systemd's side of sd_notify(3) and of sd_listen_fds(3), for programs started by launcher().
class ServiceManager {
 public:
  ServiceManager() : socket_(socket(AF_UNIX, SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0)) {
    const std::string path = directory_ / "notify";
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    std::strncpy(address.sun_path, path.c_str(), sizeof address.sun_path - 1);
    bind(socket_, reinterpret_cast<const sockaddr*>(&address), sizeof address);
    setenv("NOTIFY_SOCKET", path.c_str(), 1);
  }
  ~ServiceManager() {
    unsetenv("NOTIFY_SOCKET");
    for (const auto& [name, descriptor] : kept_) close(descriptor);
    close(socket_);
  }

  /// Returns the kept sockets by name after all notifications so far.
  const std::map<std::string, int>& kept() {
    while (hear()) {
    }
    return kept_;
  }

  /// Returns the number of reloads in all notifications so far.
  int reloads() {
    kept();
    return reloads_;
  }

  /// In front of a program and its arguments: starts it as systemd would.
  std::vector<std::string> launcher() {
    std::string moves;
    std::string names;
    int count = 0;
    for (const auto& [name, descriptor] : kept()) {
      moves += fmt::format("exec {0}<&{1} {1}<&-; ", 3 + count++, descriptor);
      names += (names.empty() ? "" : ":") + name;
      EXPECT_GE(descriptor, 3 + static_cast<int>(kept_.size())) << "overwrites another descriptor";
    }
    const std::string environment =
        fmt::format("LISTEN_PID=$$ LISTEN_FDS={} LISTEN_FDNAMES='{}'", count, names);
    return {"bash", "-c", moves + "export " + environment + R"(; exec "$@")", "bash"};
  }

 private:
  /// Reads one message. Returns false when there is none.
  bool hear() {
    char text[1024] = {};
    alignas(cmsghdr) char control[CMSG_SPACE(sizeof(int))] = {};
    iovec part{text, sizeof text};
    msghdr header{};
    header.msg_iov = &part;
    header.msg_iovlen = 1;
    header.msg_control = control;
    header.msg_controllen = sizeof control;
    const ssize_t size = recvmsg(socket_, &header, 0);
    if (size < 0) return false;
    int descriptor = -1;
    if (const cmsghdr* c = CMSG_FIRSTHDR(&header); c != nullptr && c->cmsg_type == SCM_RIGHTS)
      std::memcpy(&descriptor, CMSG_DATA(c), sizeof descriptor);
    obey({text, static_cast<std::size_t>(size)}, descriptor);
    return true;
  }

  void obey(const std::string& message, int descriptor) {
    if (message.starts_with("RELOADING=1")) ++reloads_;
    const std::size_t at = message.find("FDNAME=");
    const std::string name =
        at == std::string::npos ? "" : message.substr(at + 7, message.find('\n', at) - at - 7);
    if (message.find("FDSTOREREMOVE=1") != std::string::npos) {
      if (const auto found = kept_.find(name); found != kept_.end()) {
        close(found->second);
        kept_.erase(found);
      }
    } else if (message.find("FDSTORE=1") != std::string::npos) {
      kept_[name] = descriptor;
    } else if (descriptor >= 0) {
      close(descriptor);  // a barrier
    }
  }

  TempDir directory_;
  int socket_;
  std::map<std::string, int> kept_;
  int reloads_ = 0;
};

TEST(ServiceNotifications, ReportReloadOfOperator) {
  ServiceManager manager;
  Mosquitto broker;
  GatewayProcess gateway(json{{"broker", {{"uri", broker.uri()}}}});
  ASSERT_TRUE(eventually([&] { return gateway.ctl({"reload"}).is_object(); })) << gateway.log();
  EXPECT_TRUE(eventually([&] { return manager.reloads() == 1; }));
}

class KeptSockets : public testing::TestWithParam<int> {
 protected:
  void SetUp() override {
    ASSERT_TRUE(eventually([&] { return gateway.logs(" connected (MQTT"); })) << gateway.log();
    device.insist(sim::sn::connect("r1", 60, sim::sn::flag_clean_session), Type::connack);
    device.send(sim::sn::register_topic(1, "ntnu-slam/robot/r1/adv"));
    topic_id = device.expect(Type::regack).topic_id;
    ASSERT_TRUE(eventually([&] {
      return read_files(gateway / "store/sessions").find("r1/adv") != std::string::npos;
    }));
    ASSERT_EQ(manager.kept().size(), 1U);
  }

  void end(int signal) {
    gateway.process().send_signal(signal);
    ASSERT_TRUE(eventually([&] { return !gateway.process().is_running(); }));
  }

  ServiceManager manager;
  Mosquitto broker;
  GatewayProcess gateway{json{{"broker", {{"uri", broker.uri()}}}}};
  Device device{gateway.mqttsn_address()};
  std::uint16_t topic_id = 0;
};

TEST_P(KeptSockets, BufferDatagramsWhileNoDaemonRuns) {
  for (std::uint16_t msg_id = 3; msg_id < 6; ++msg_id) {  // over several restarts
    end(GetParam());
    EXPECT_TRUE(device.send(sim::sn::publish(1, topic_id, msg_id, {})));
    EXPECT_TRUE(device.send(sim::sn::pingreq(""))) << "the previous message was refused";
    gateway.start(manager.launcher());
    device.expect(Type::pingresp);  // comes at once; PUBACK waits for the broker
    EXPECT_EQ(device.expect(Type::puback).msg_id, msg_id);
  }
  EXPECT_EQ(manager.kept().size(), 1U);
}

INSTANTIATE_TEST_SUITE_P(After, KeptSockets, testing::Values(SIGTERM, SIGKILL),
                         [](const auto& how) {
                           return how.param == SIGTERM ? "Sigterm" : "Sigkill";
                         });

class OutdatedKeptSockets : public KeptSockets {};

TEST_P(OutdatedKeptSockets, AreReplacedAfterConfigurationChange) {
  const std::string before = manager.kept().begin()->first;
  end(SIGTERM);
  gateway.configure([](json& configuration) { configuration["mqttsn"]["interface"] = "lo"; });
  gateway.start(manager.launcher());
  ASSERT_TRUE(eventually([&] { return manager.kept().count(before) == 0; }));
  EXPECT_EQ(device.insist(sim::sn::publish(1, topic_id, 3, {}), Type::puback).return_code, 0);
  EXPECT_EQ(manager.kept().size(), 1U);

  end(SIGTERM);
  gateway.configure([](json& configuration) { configuration["mqttsn"]["enabled"] = false; });
  gateway.start(manager.launcher());
  EXPECT_TRUE(eventually([&] { return manager.kept().empty(); }));
}

INSTANTIATE_TEST_SUITE_P(After, OutdatedKeptSockets, testing::Values(SIGTERM));

}  // namespace
}  // namespace slamgw::test
