// SPDX-License-Identifier: Apache-2.0
// A recording at a real Mosquitto.
#include "ctl/host/recording.hpp"

#include <gtest/gtest.h>

#include <algorithm>

#include "ctl/connection.hpp"
#include "tests/support/eventually.hpp"
#include "tests/support/free_port.hpp"
#include "tests/support/mosquitto.hpp"
#include "tests/support/temp_dir.hpp"

namespace slamgw::test {
namespace {

using namespace std::chrono_literals;

ctl::RecordedMessage recorded(std::chrono::microseconds after, const std::string& topic,
                              Bytes payload, Qos qos) {
  return {after, {topic, std::move(payload), qos, false, {}}};
}

BrokerSettings at_port(std::uint16_t port) {
  BrokerSettings settings;
  settings.port = port;
  return settings;
}

/// A full disk truncates a line; the operator frees space and continues.
TEST(Recording, AppendsAfterTruncatedLine) {
  const TempDir directory;
  const std::string path = directory / "recording";
  const auto line = [](char robot) {
    return std::string(
               R"({"at":"2026-11-21T06:31:07Z","event":"arrived","payload":"00","qos":1,)") +
           R"("topic":"p/robot/)" + robot + "/a\"}\n";
  };
  ctl::open_recording(path) << line('a') << line('b').substr(0, 50);
  ctl::open_recording(path) << line('c');
  ctl::open_recording(path) << line('d');
  std::ifstream in(path);
  std::string topics;
  for (const auto& recorded : ctl::read_recording(in, path)) topics += recorded.message.topic + " ";
  EXPECT_EQ(topics, "p/robot/a/a p/robot/c/a p/robot/d/a ");
}

TEST(Replay, PublishesTopicsAndOctetsNoSoonerThanRecorded) {
  Mosquitto broker;
  const Subscriber subscriber(broker, "p/#", "%q %t %x");
  const auto begun = std::chrono::steady_clock::now();
  const ctl::Replayed done =
      ctl::replay({recorded(0us, "p/robot/a/x", {}, Qos::at_most_once),
                   recorded(100ms, "p/robot/b/x", {0x00, 0xff, 0x0a}, Qos::at_least_once),
                   recorded(400ms, "p/robot/a/y", {0x22}, Qos::at_least_once)},
                  at_port(broker.port()), 2);
  EXPECT_GE(std::chrono::steady_clock::now() - begun, 200ms);
  EXPECT_EQ(done.published, 3u);
  EXPECT_EQ(done.refused, 0u);
  EXPECT_TRUE(eventually([&] { return subscriber.lines().size() == 3; }));
  EXPECT_EQ(subscriber.lines(), (std::vector<std::string>{"0 p/robot/a/x ", "1 p/robot/b/x 00ff0a",
                                                          "1 p/robot/a/y 22"}));
}

/// All messages are due at once; their number is far above the receive maximum.
TEST(Replay, LosesNoMessageOfBurst) {
  constexpr std::size_t count = 500;
  Mosquitto broker;
  const Subscriber subscriber(broker, "p/#", "%x");
  std::vector<ctl::RecordedMessage> messages;
  std::vector<std::string> expected;
  for (std::size_t i = 0; i < count; ++i) {
    const auto octet = static_cast<std::uint8_t>(i % 10);
    messages.push_back(recorded(0us, "p/t", {octet}, Qos::at_least_once));
    expected.push_back("0" + std::to_string(octet));
  }
  EXPECT_EQ(ctl::replay(std::move(messages), at_port(broker.port()), 1).published, count);
  EXPECT_TRUE(eventually([&] { return subscriber.lines().size() == count; }));
  EXPECT_EQ(subscriber.lines(), expected);
}

TEST(Replay, UsesFirstBrokerInListThatAnswers) {
  Mosquitto broker;
  BrokerSettings settings = at_port(free_tcp_port());
  settings.others.push_back({settings.host, broker.port(), false});
  EXPECT_EQ(ctl::replay({recorded(0us, "p/t", {1}, Qos::at_least_once)}, settings, 1).published,
            1u);
}

TEST(Replay, NamesRemedyForRefusedUser) {
  const Mosquitto broker({}, "robots", "right");
  const auto complaint = [&](std::optional<Credentials> credentials, bool is_typed) {
    BrokerSettings settings = at_port(broker.port());
    settings.credentials = std::move(credentials);
    try {
      ctl::replay({recorded(0us, "p/t", {1}, Qos::at_least_once)}, settings, 1, is_typed);
    } catch (const ctl::Failure& failure) {
      return std::string(failure.what());
    }
    return std::string();
  };
  EXPECT_TRUE(complaint({}, false).ends_with("(no user name was sent): see --user"))
      << complaint({}, false);
  const Credentials wrong{"ada", "not it"};
  EXPECT_TRUE(complaint(wrong, true).ends_with(" ('ada')")) << complaint(wrong, true);
  EXPECT_NE(complaint(wrong, false).find("correct /etc/slam-gateway/credentials.json"),
            std::string::npos);
}

TEST(Replay, FailsWhenNoBrokerAnswers) {
  const std::uint16_t port = free_tcp_port();
  try {
    ctl::replay({recorded(0us, "p/t", {1}, Qos::at_least_once)}, at_port(port), 1);
    FAIL() << "replayed without a broker";
  } catch (const ctl::Failure& failure) {
    EXPECT_NE(std::string(failure.what()).find(std::to_string(port)), std::string::npos);
  }
}

}  // namespace
}  // namespace slamgw::test
