// SPDX-License-Identifier: Apache-2.0
// An independent decoder reads what the gateway sends: tshark's MQTT-SN dissector finds nothing
// malformed.
#include <gtest/gtest.h>
#include <signal.h>

#include <sstream>

#include "tests/e2e/gateway_process.hpp"
#include "tests/support/eventually.hpp"
#include "tests/support/mosquitto.hpp"

namespace slamgw::test {
namespace {

using nlohmann::json;

/// Runs tshark on loopback. One line per datagram: source port, message type, "malformed" or empty.
class Dissector {
 public:
  explicit Dissector(const std::string& port)
      : process_({"tshark", "-l", "-n", "-i", "lo", "-f", "udp port " + port, "-d",
                  "udp.port==" + port + ",mqttsn", "-T", "fields", "-E", "separator=,", "-e",
                  "udp.srcport", "-e", "mqttsn.msg.type", "-e", "_ws.malformed"},
                 directory_ / "out", directory_ / "err") {}
  /// Ends tshark by SIGTERM, because a killed tshark leaves its dumpcap running.
  ~Dissector() {
    process_.send_signal(SIGTERM);
    process_.wait();
  }

  /// Returns false if tshark is missing or may not capture.
  bool is_capturing() {
    eventually([&] { return !process_.is_running() || errors().find("Capture started") != npos; });
    return process_.is_running();
  }
  std::vector<std::string> lines() const {
    std::vector<std::string> lines;
    std::istringstream text(read_file(directory_ / "out"));
    for (std::string line; std::getline(text, line);) lines.push_back(line);
    return lines;
  }
  std::string errors() const { return read_file(directory_ / "err"); }

 private:
  static constexpr auto npos = std::string::npos;
  TempDir directory_;
  ChildProcess process_;
};

TEST(EndToEnd, TsharkFindsNoMalformedMqttSnMessage) {
  Mosquitto broker;
  GatewayProcess gateway(json{{"broker", {{"uri", broker.uri()}}}});
  const std::string address = gateway.mqttsn_address();
  const std::string port = address.substr(address.find(':') + 1);
  Dissector dissector(port);
  if (!dissector.is_capturing()) {
    GTEST_SKIP() << "tshark is not installed or may not capture: " << dissector.errors();
  }
  ASSERT_TRUE(eventually([&] { return gateway.logs("connected (MQTT 5)"); })) << gateway.log();
  SimulatorProcess simulator({"thread", "--gateway", address, "--robots", "2", "--messages", "10",
                              "--rate", "20", "--qos", "2"});
  EXPECT_EQ(simulator.report()["lost"], 0);

  // Each robot: GWINFO, WILLTOPICREQ, WILLMSGREQ, CONNACK, 4 REGACK, 2 SUBACK, 11 PUBREC and
  // PUBCOMP, DISCONNECT.
  constexpr std::size_t expected_from_gateway = 2 * 33;
  std::size_t from_gateway = 0;
  ASSERT_TRUE(eventually([&] {
    from_gateway = 0;
    for (const std::string& line : dissector.lines()) from_gateway += line.starts_with(port + ",");
    return from_gateway >= expected_from_gateway;
  })) << from_gateway
      << gateway.log() << dissector.errors();
  for (const std::string& line : dissector.lines()) {
    const std::string malformed = line.substr(line.rfind(',') + 1);
    EXPECT_TRUE(malformed.empty()) << line;
    EXPECT_EQ(line.find(",,"), std::string::npos) << "not an MQTT-SN message: " << line;
  }
}

}  // namespace
}  // namespace slamgw::test
