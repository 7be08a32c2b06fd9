// SPDX-License-Identifier: Apache-2.0
// A robot in foreign code, `openssl s_client`, authenticates with a key of `key add`. It loses its
// connection when the key is removed.
#include <gtest/gtest.h>

#include <fmt/format.h>

#include "tests/e2e/device.hpp"
#include "tests/e2e/gateway_process.hpp"
#include "tests/support/eventually.hpp"
#include "tests/support/free_port.hpp"
#include "tests/support/mosquitto.hpp"

namespace slamgw::test {
namespace {

using nlohmann::json;
using sim::sn::Type;

class OpensslClient {
 public:
  /// Sends one message, given in the syntax of printf(1), and stays connected.
  OpensslClient(std::uint16_t port, const std::string& identity, const std::string& key,
                const std::string& message)
      : process_({"sh", "-c",
                  fmt::format("mkfifo {0}/in; (printf '{1}'; sleep 60) > {0}/in & exec openssl "
                              "s_client -dtls1_2 -connect 127.0.0.1:{2} -psk_identity {3} -psk {4} "
                              "-quiet -no_ign_eof < {0}/in",
                              directory_.path(), message, port, identity, key)},
                 directory_ / "out", directory_ / "err") {}
  std::string heard() const { return read_file(directory_ / "out"); }
  std::string errors() const { return read_file(directory_ / "err"); }
  bool is_running() { return process_.is_running(); }

 private:
  TempDir directory_;
  ChildProcess process_;
};

constexpr const char* connect_as_r2 = R"(\010\004\004\001\000\074r2)";
const std::string connack_accepted("\x03\x05\x00", 3);
const std::string connack_refused("\x03\x05\x03", 3);

TEST(Dtls, OpensslClientConnectsOnlyAsRobotOfItsKey) {
  Mosquitto broker;
  const TempDir keys;
  write_file(keys / "keys.json", "{}", 0600);
  const std::uint16_t port = free_udp_port();
  GatewayProcess gateway(
      {{"broker", {{"uri", broker.uri()}}},
       {"mqttsn",
        {{"require_identity", true},
         {"dtls",
          {{"keys_file", keys / "keys.json"}, {"listen", {fmt::format("127.0.0.1:{}", port)}}}}}}});
  ASSERT_TRUE(eventually([&] { return gateway.ctl({"status"}).is_object(); })) << gateway.log();
  const auto key = [&](const std::string& verb, const std::string& robot) {
    return gateway.ctl({"key", verb, "--config", gateway / "gateway.json", robot});
  };
  const json added = key("add", "r2");
  ASSERT_TRUE(added.is_object()) << gateway.log();
  const std::string secret = added["key"];
  EXPECT_TRUE(key("add", "r2").is_null()) << "r2 has a key already";
  const std::string other = key("add", "r1")["key"];

  OpensslClient robot(port, "r2", secret, connect_as_r2);
  EXPECT_TRUE(eventually([&] { return robot.heard() == connack_accepted; }))
      << robot.errors() << gateway.log();
  EXPECT_TRUE(gateway.logs("r2 is online"));
  const json robots = gateway.ctl({"robots"});
  EXPECT_NE(robots.dump().find("over DTLS"), std::string::npos) << robots;
  OpensslClient liar(port, "r1", other, connect_as_r2);
  EXPECT_TRUE(eventually([&] { return liar.heard() == connack_refused; })) << liar.errors();
  Device plain(gateway.mqttsn_address());
  plain.send(sim::sn::connect("r2", 60, sim::sn::flag_clean_session));
  EXPECT_TRUE(eventually([&] { return gateway.logs("as 'r2' gets no answer: it must come over"); }))
      << gateway.log();

  ASSERT_TRUE(key("remove", "r2").is_object());
  EXPECT_TRUE(eventually([&] { return !robot.is_running(); })) << "the connection of r2 has ended";
  EXPECT_TRUE(liar.is_running()) << "the key of r1 still exists";
  EXPECT_TRUE(eventually([&] { return gateway.logs("r2 is offline"); })) << gateway.log();
  EXPECT_EQ(gateway.ctl({"key", "list", "--config", gateway / "gateway.json"})["robots"],
            json::array({"r1"}));
  for (const std::string& shown : {secret, other}) {
    EXPECT_FALSE(gateway.logs(shown));
    EXPECT_EQ(gateway.ctl({"status"}).dump().find(shown), std::string::npos);
  }
}

}  // namespace
}  // namespace slamgw::test
