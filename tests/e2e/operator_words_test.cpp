// SPDX-License-Identifier: Apache-2.0
// Messages to the operator when something is missing, taken, refused or full: fault and remedy,
// once in the log and in the status. trouble_test.cpp checks that the daemon goes on.
#include <fcntl.h>
#include <gtest/gtest.h>
#include <pty.h>
#include <signal.h>
#include <sys/file.h>
#include <sys/mount.h>
#include <sys/stat.h>
#include <unistd.h>

#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/udp.hpp>
#include <fstream>

#include "tests/e2e/gateway_process.hpp"
#include "tests/support/certificates.hpp"
#include "tests/support/eventually.hpp"
#include "tests/support/free_port.hpp"
#include "tests/support/mosquitto.hpp"

namespace slamgw::test {
namespace {

using nlohmann::json;

std::size_t count(const std::string& text, const std::string& what) {
  std::size_t found = 0;
  for (std::size_t at = text.find(what); at != text.npos; at = text.find(what, at + 1)) ++found;
  return found;
}

std::string mesh_detail(const GatewayProcess& gateway, const char* mesh) {
  const json status = gateway.ctl({"status"});
  return status.is_object() ? status["meshes"][mesh]["detail"].get<std::string>() : "";
}

std::string broker_trouble(const GatewayProcess& gateway) {
  const json status = gateway.ctl({"status"});
  return status.is_object() ? status["broker"]["why"].get<std::string>() : "";
}

/// Expects `what` in the status, and once in the log, as a warning.
void expect_said(const GatewayProcess& gateway, const std::function<std::string()>& status,
                 const std::string& what) {
  EXPECT_TRUE(eventually([&] { return status().find(what) != std::string::npos; }))
      << status() << gateway.log();
  EXPECT_EQ(count(gateway.log(), what), 1u) << gateway.log();
  const std::string log = gateway.log();
  const std::size_t line = log.rfind('\n', log.find(what)) + 1;
  EXPECT_NE(log.substr(line, log.find('\n', line) - line).find(" warning "), std::string::npos);
}

/// A terminal behind a link of the configured name.
class Terminal {
 public:
  explicit Terminal(const std::string& link) {
    if (openpty(&host_, &device_, nullptr, nullptr, nullptr) != 0 ||
        symlink(ttyname(device_), link.c_str()) != 0)
      throw std::runtime_error("no pty");
    fcntl(host_, F_SETFL, O_NONBLOCK);
  }
  ~Terminal() {
    close(host_);
    close(device_);
  }
  Terminal(const Terminal&) = delete;
  Terminal& operator=(const Terminal&) = delete;

  void take() { ASSERT_EQ(flock(device_, LOCK_EX | LOCK_NB), 0); }
  void say(const std::string& text) {
    char ignored[4096];
    while (read(host_, ignored, sizeof ignored) > 0) {
    }
    EXPECT_GT(write(host_, text.data(), text.size()), 0);
  }

 private:
  int host_ = -1;
  int device_ = -1;
};

const json no_broker{{"uri", "mqtt://127.0.0.1:" + std::to_string(free_tcp_port())}};

TEST(OperatorWords, RefusedPasswordNamesFileToCorrect) {
  Mosquitto broker({}, "gw", "right");
  const TempDir directory;
  const std::string file = directory / "credentials.json";
  write_file(file, R"({"username":"gw","password":"wrong"})", 0600);
  GatewayProcess gateway(json{{"broker", {{"uri", broker.uri()}, {"credentials_file", file}}}});
  expect_said(
      gateway, [&] { return broker_trouble(gateway); },
      "does not authorise this user (user 'gw' from " + file + "): correct that file");
}

TEST(OperatorWords, MissingUserNamesKeyOfCredentials) {
  Mosquitto broker({}, "gw", "right");
  GatewayProcess gateway(json{{"broker", {{"uri", broker.uri()}}}});
  expect_said(
      gateway, [&] { return broker_trouble(gateway); },
      "(no user name was sent): give one in broker.credentials_file");
}

TEST(OperatorWords, UnresolvableBrokerNameIsReportedAsSuch) {
  GatewayProcess gateway(json{{"broker", {{"uri", "mqtt://no-such-host.invalid"}}}});
  expect_said(
      gateway, [&] { return broker_trouble(gateway); }, "correct broker.uri, or this host's name");
}

TEST(OperatorWords, CertificateForAnotherNameIsReportedWithName) {
  const Certificates certificates("other.example");
  Mosquitto broker("certfile " + certificates.certificate() + "\nkeyfile " + certificates.key() +
                   "\n");
  GatewayProcess gateway(json{{"broker",
                               {{"uri", "mqtts://127.0.0.1:" + std::to_string(broker.port())},
                                {"tls", {{"ca_file", certificates.ca()}}}}}});
  expect_said(
      gateway, [&] { return broker_trouble(gateway); },
      "the broker's certificate is not for '127.0.0.1'");
  EXPECT_TRUE(gateway.logs("broker.uri must use a name that is in the certificate"));
}

TEST(OperatorWords, MissingTtyNamesPlaceOfBoards) {
  GatewayProcess gateway(json{{"broker", no_broker}, {"ble_mesh", {{"enabled", true}}}});
  expect_said(
      gateway, [&] { return mesh_detail(gateway, "ble"); },
      "plug it in, or set ble_mesh.device to one of /dev/serial/by-id/");
}

TEST(OperatorWords, BusyTtyNamesCommandThatFindsItsUser) {
  GatewayProcess gateway(json{{"broker", no_broker}, {"ble_mesh", {{"enabled", true}}}});
  Terminal terminal(gateway.tty());
  terminal.take();
  gateway.start();
  expect_said(
      gateway, [&] { return mesh_detail(gateway, "ble"); },
      "is busy: another program has it open; sudo fuser -v /dev/pts/");
}

TEST(OperatorWords, ForeignFirmwareIsReportedAsSuch) {
  GatewayProcess gateway(json{{"broker", no_broker}, {"ble_mesh", {{"enabled", true}}}});
  Terminal terminal(gateway.tty());
  gateway.start();
  const std::string what = "not Nordic's serial protocol: is it the right device?";
  ASSERT_TRUE(eventually([&] {
    terminal.say("login: ");
    return gateway.logs(what);
  })) << gateway.log();
  EXPECT_NE(mesh_detail(gateway, "ble").find(what), std::string::npos);
  EXPECT_EQ(count(gateway.log(), what), 1u) << gateway.log();
}

TEST(OperatorWords, ConfigurationProblemsAreErrorsInJournal) {
  const TempDir directory;
  write_file(directory / "gateway.json", R"({"brocker": {}})");
  write_file(directory / "journal", "");
  struct stat stream {};
  ASSERT_EQ(stat((directory / "journal").c_str(), &stream), 0);
  const std::string name = std::to_string(stream.st_dev) + ":" + std::to_string(stream.st_ino);
  ChildProcess daemon(
      {"env", "JOURNAL_STREAM=" + name, SLAMGW_DAEMON, "--config", directory / "gateway.json"}, {},
      directory / "journal");
  EXPECT_EQ(daemon.wait(), 78);
  EXPECT_EQ(
      read_file(directory / "journal"),
      "<3>" + directory.path() + "/gateway.json:1: brocker: unknown key; did you mean broker?\n");
}

TEST(OperatorWords, BusyPortNamesGatewayOfNordicsBorderRouter) {
  boost::asio::io_context io;
  boost::asio::ip::udp::socket holder(io, boost::asio::ip::udp::v6());
  boost::system::error_code taken_already;
  holder.bind({boost::asio::ip::address_v6::any(), 47193}, taken_already);
  const TempDir directory;
  write_file(directory / "gateway.json", json{{"broker", no_broker},
                                              {"control", {{"socket", directory / "control.sock"}}},
                                              {"store", {{"directory", directory / "store"}}}}
                                             .dump());
  const Finished finished = run_program({SLAMGW_DAEMON, "--config", directory / "gateway.json"});
  EXPECT_EQ(finished.status, 1);
  EXPECT_NE(finished.err.find("error   mqttsn.listen: can't use [::]:47193"), std::string::npos)
      << finished.err;
  EXPECT_NE(finished.err.find("systemctl disable --now paho-mqttsn-gateway"), std::string::npos);
}

TEST(OperatorWords, MissingThreadInterfaceNamesProgramThatCreatesIt) {
  GatewayProcess gateway(json{{"broker", no_broker}, {"mqttsn", {{"interface", "wpan77"}}}});
  expect_said(
      gateway, [&] { return mesh_detail(gateway, "thread"); },
      "there is no interface wpan77 yet: the Thread border router creates it");
}

TEST(OperatorWords, FullDiskIsLoggedAndShownInStatus) {
  GatewayProcess gateway(json{{"broker", no_broker}});
  ASSERT_TRUE(eventually([&] { return gateway.logs("cannot reach broker"); })) << gateway.log();
  gateway.process().send_signal(SIGTERM);
  ASSERT_EQ(gateway.process().wait(), 0);
  const std::string store = gateway / "store";
  if (mount("tmpfs", store.c_str(), "tmpfs", 0, "size=64k") != 0) GTEST_SKIP() << "needs root";
  std::ofstream(store + "/filler") << std::string(128 * 1024, 'x');
  gateway.start();
  const auto trouble = [&] {
    const json status = gateway.ctl({"status"});
    return status.is_object() ? status["store"]["why"].get<std::string>() : "";
  };
  EXPECT_TRUE(eventually([&] {
    return trouble().find("disk is full: free space there") != std::string::npos;
  })) << trouble();
  EXPECT_EQ(count(gateway.log(), "warning no store: "), 1u) << gateway.log();
  const Finished shown = run_program({SLAMGW_CTL, "--socket", gateway / "control.sock", "status"});
  EXPECT_NE(shown.out.find("disk is full: free space there"), std::string::npos) << shown.out;

  unlink((store + "/filler").c_str());
  EXPECT_TRUE(eventually([&] { return trouble().empty(); })) << trouble();
  gateway.process().send_signal(SIGTERM);
  gateway.process().wait();
  umount(store.c_str());
}

TEST(OperatorWords, ReadableSecretGivesWarningAndDoesNotStopDaemon) {
  const TempDir directory;
  const std::string file = directory / "gateway.json";
  write_file(file,
             json{{"ble_mesh", {{"provisioning", {{"static_oob", std::string(32, 'a')}}}}}}.dump(),
             0644);
  const Finished checked = run_program({SLAMGW_DAEMON, "--config", file, "--check-config"});
  EXPECT_EQ(checked.status, 0);
  EXPECT_EQ(checked.out, "OK\n");
  EXPECT_EQ(checked.err.find("warning: " + file + ":1: ble_mesh.provisioning.static_oob: "), 0u)
      << checked.err;
  EXPECT_EQ(checked.err.find("aaaa"), std::string::npos) << "never shown";

  GatewayProcess gateway(
      json{{"broker", no_broker},
           {"ble_mesh", {{"provisioning", {{"static_oob", std::string(32, 'a')}}}}}});
  EXPECT_TRUE(eventually([&] { return gateway.logs("static_oob: is a secret in a file"); }));
}

}  // namespace
}  // namespace slamgw::test
