// SPDX-License-Identifier: Apache-2.0
// No secret is ever shown: everything that the programs print, and everything that the gateway
// publishes about itself, is searched for the password and for every key, however written.
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/stat.h>

#include <algorithm>
#include <cctype>
#include <sstream>

#include "tests/e2e/gateway_process.hpp"
#include "tests/support/certificates.hpp"
#include "tests/support/eventually.hpp"
#include "tests/support/free_port.hpp"
#include "tests/support/mosquitto.hpp"

namespace slamgw::test {
namespace {

using nlohmann::json;

constexpr const char* user = "gateway-user";
constexpr const char* password = "pa55-w0rd-0f-the-broker";
constexpr const char* robot_key = "d71500d71501d71502d71503d71504d7";
constexpr const char* static_oob = "5ec2e7005ec2e7015ec2e7025ec2e703";

std::string lower(std::string text) {
  std::ranges::transform(text, text.begin(), [](unsigned char c) { return std::tolower(c); });
  return text;
}

/// The same octets from last to first.
std::string reversed(const std::string& hex) {
  std::string out;
  for (std::size_t i = hex.size(); i >= 2; i -= 2) out += hex.substr(i - 2, 2);
  return out;
}

/// Removes characters that may separate octets in a dump.
std::string without_separators(std::string text) {
  std::erase_if(text, [](char c) { return c == ' ' || c == ':' || c == '-' || c == ','; });
  return text;
}

/// Searches texts for secrets.
class Search {
 public:
  void add_text(const std::string& secret) { texts_.push_back(secret); }
  void add_octets(const std::string& hex) {
    octets_.push_back(lower(hex));
    octets_.push_back(reversed(lower(hex)));
  }
  void add_mesh(const json& mesh) {
    for (const char* key : {"net_key", "app_key", "device_key"})
      if (mesh.contains(key)) add_octets(mesh[key]);
    for (const json& node : mesh.value("nodes", json::array())) add_octets(node["device_key"]);
  }
  std::size_t size() const { return texts_.size() + octets_.size() / 2; }

  void expect_none_in(const std::string& what, const std::string& printed) const {
    for (const std::string& secret : texts_)
      EXPECT_EQ(printed.find(secret), std::string::npos) << what << ":\n" << printed;
    const std::string digits = without_separators(lower(printed));
    for (const std::string& secret : octets_)
      EXPECT_EQ(digits.find(secret), std::string::npos) << what << ":\n" << printed;
  }

 private:
  std::vector<std::string> texts_;
  std::vector<std::string> octets_;
};

/// Adds each line of the body of a PEM file.
void add_pem(Search& search, const std::string& path) {
  std::istringstream lines(read_file(path));
  for (std::string line; std::getline(lines, line);)
    if (line.size() > 20 && !line.starts_with("-----")) search.add_text(line);
}

class Secrets : public testing::Test {
 protected:
  Secrets() {
    write_file(directory / "credentials.json",
               json{{"username", user}, {"password", password}}.dump(), 0600);
    write_file(directory / "keys.json", json{{"robot1", robot_key}}.dump(), 0600);
    search.add_octets(robot_key);
    chmod(certificates.key().c_str(), 0600);
    search.add_text(password);
    search.add_octets(static_oob);
    add_pem(search, certificates.key());
  }

  json configuration() const {
    return {
        {"broker",
         {{"uri", "mqtts://localhost:" + std::to_string(tls_port)},
          {"credentials_file", directory / "credentials.json"},
          {"tls",
           {{"ca_file", certificates.ca()},
            {"certificate_file", certificates.certificate()},
            {"key_file", certificates.key()}}}}},
        {"ble_mesh",
         {{"enabled", true}, {"provisioning", {{"enabled", true}, {"static_oob", static_oob}}}}},
        {"mqttsn",
         {{"dtls", {{"keys_file", directory / "keys.json"}, {"listen", {"127.0.0.1:0"}}}}}},
        {"log", {{"level", "debug"}, {"traffic", "all"}}}};
  }
  void expect_none_in_output_of(const std::vector<std::string>& arguments) {
    const Finished finished = run_program(arguments);
    EXPECT_FALSE(finished.out.empty() && finished.err.empty()) << arguments.back();
    search.expect_none_in(arguments.back(), finished.out + finished.err);
  }

  const TempDir directory;
  const Certificates certificates{"localhost"};
  const std::uint16_t tls_port = free_tcp_port();
  Mosquitto broker{"listener " + std::to_string(tls_port) + " 127.0.0.1\ncertfile " +
                       certificates.certificate() + "\nkeyfile " + certificates.key(),
                   user, password};
  Search search;
};

TEST_F(Secrets, AreNeverPrintedOrPublished) {
  GatewayProcess gateway(configuration());
  chmod((gateway / "gateway.json").c_str(), 0600);  // it holds the OOB value
  SimulatorProcess board({"ble", "--tty", gateway.tty(), "--unprovisioned", "--static-oob",
                          static_oob, "--robots", "2"});
  SimulatorProcess robots({"thread", "--gateway", gateway.mqttsn_address(), "--robots", "1"});
  const auto socket = gateway / "control.sock";
  const auto is_alive = [&] {
    const json nodes = gateway.ctl({"ble", "nodes"});
    return nodes.is_array() && nodes.size() == 2 && nodes[0]["state"] == "configured" &&
           nodes[1]["state"] == "configured" && gateway.logs("robot1 update");
  };
  ASSERT_TRUE(eventually(is_alive, 2 * patience)) << gateway.log();
  const json mesh = json::parse(read_file(gateway / "store/mesh.json"));
  const std::size_t before = search.size();
  search.add_mesh(mesh);
  ASSERT_GE(search.size(), before + 4) << "the mesh's two keys and each robot's: " << mesh;
  ChildProcess watch({SLAMGW_CTL, "--socket", socket, "watch"}, directory / "watched");
  ASSERT_EQ(gateway.ctl({"send", "robot1", "cmd", "1,2"})["outcome"], "delivered");
  gateway.process().send_signal(SIGHUP);
  ASSERT_TRUE(eventually([&] { return gateway.logs("configuration read again"); }));
  ASSERT_TRUE(eventually([&] { return !read_file(directory / "watched").empty(); }));

  for (const char* option : {"--print-config", "--check-config"})
    expect_none_in_output_of({SLAMGW_DAEMON, "--config", gateway / "gateway.json", option});
  const std::vector<std::vector<std::string>> commands = {{"status"}, {"robots"}, {"ble", "nodes"}};
  for (const auto& command : commands) {
    std::vector<std::string> arguments{SLAMGW_CTL, "--socket", socket};
    arguments.insert(arguments.end(), command.begin(), command.end());
    expect_none_in_output_of(arguments);
    search.expect_none_in("--json", gateway.ctl(command).dump());
  }
  expect_none_in_output_of({SLAMGW_CTL, "--socket", socket, "ble", "scan"});
  gateway.process().send_signal(SIGTERM);
  EXPECT_EQ(gateway.process().wait(), 0);
  search.expect_none_in("watch", read_file(directory / "watched"));
  search.expect_none_in("log", gateway.log() + read_file(gateway / "out"));
}

/// Starts a daemon with the file `mesh` and returns its log once it complains about the file.
std::string complaint_about(const std::string& mesh, json configuration) {
  GatewayProcess gateway(std::move(configuration));
  EXPECT_TRUE(eventually([&] { return gateway.logs("ble link down"); })) << gateway.log();
  gateway.process().send_signal(SIGTERM);
  gateway.process().wait();
  write_file(gateway / "store/mesh.json", mesh, 0600);
  gateway.start();
  EXPECT_TRUE(eventually([&] { return gateway.logs("mesh.json"); })) << gateway.log();
  return gateway.log();
}

TEST_F(Secrets, AreNotInMessagesAboutFilesThatHoldThem) {
  const json mesh = {
      {"version", 2},
      {"net_key", "00112233445566778899aabbccddeeff"},
      {"app_key", "ffeeddccbbaa99887766554433221101"},
      {"nodes", json::array({{{"uuid", 5}, {"device_key", "0123456789abcdef0123456789abcdee"}}})}};
  search.add_mesh(mesh);
  const std::string good = mesh.dump();
  search.expect_none_in("mesh.json", complaint_about(good, configuration()));
  search.expect_none_in("mesh.json", complaint_about(good.substr(0, 120), configuration()));
  json longer = mesh;
  longer["net_key"] = mesh["net_key"].get<std::string>() + "0";
  search.expect_none_in("mesh.json", complaint_about(longer.dump(), configuration()));

  const std::string file = directory / "gateway.json";
  const auto check = [&](const json& wanted) {
    write_file(file, wanted.dump(2), 0600);
    expect_none_in_output_of({SLAMGW_DAEMON, "--config", file, "--check-config"});
    EXPECT_EQ(run_program({SLAMGW_DAEMON, "--config", file}).status, 78);
  };
  json wrong = configuration();
  wrong["ble_mesh"]["provisioning"]["static_oob"] = std::string(static_oob) + "00";
  check(wrong);
  wrong = configuration();
  wrong["broker"]["uri"] = std::string("mqtt://") + user + ":" + password + "@localhost";
  check(wrong);
  for (const std::string& text :
       {R"({"username":"u","password":")" + std::string(password) + "}",
        R"({"username":"u","password":)" + std::string(password) + "}",
        R"({"username":"u","password":[")" + std::string(password) + "\"]}",
        std::string(password)}) {
    write_file(directory / "credentials.json", text, 0600);
    check(configuration());
  }
  for (const std::string& text :
       {R"({"robot1":")" + std::string(robot_key) + "0\"}",
        R"({"robot1":")" + std::string(robot_key), R"({"robot1":)" + std::string(robot_key) + "}",
        R"({"robot1":[")" + std::string(robot_key) + "\"]}", std::string(robot_key)}) {
    write_file(directory / "keys.json", text, 0600);
    check(configuration());
  }
}

}  // namespace
}  // namespace slamgw::test
