// SPDX-License-Identifier: Apache-2.0
#include "daemon/mqtt/version_choice.hpp"

#include <gtest/gtest.h>

namespace slamgw {
namespace {

TEST(VersionChoice, FallsBackAtOnceWhenTheBrokerRefusesTheVersion) {
  VersionChoice choice;
  EXPECT_EQ(choice.version(), MqttVersion::v5);
  EXPECT_TRUE(choice.on_failed(ConnectAnswer::version_refused)) << "at once";
  EXPECT_EQ(choice.version(), MqttVersion::v3_1_1);
  EXPECT_FALSE(choice.on_failed(ConnectAnswer::other));
  choice.on_lost();
  EXPECT_EQ(choice.version(), MqttVersion::v3_1_1) << "the broker has refused MQTT 5";
}

TEST(VersionChoice, ReturnsToTheNewVersionWhenTheBrokerRefusesTheOldOne) {
  VersionChoice choice;
  choice.on_failed(ConnectAnswer::version_refused);
  EXPECT_FALSE(choice.on_failed(ConnectAnswer::version_refused)) << "no race between the two";
  EXPECT_EQ(choice.version(), MqttVersion::v5);
}

TEST(VersionChoice, FallsBackAfterASecondSilentClosing) {
  VersionChoice choice;
  EXPECT_FALSE(choice.on_failed(ConnectAnswer::closed));
  EXPECT_EQ(choice.version(), MqttVersion::v5) << "a broker that was killed closes too";
  EXPECT_TRUE(choice.on_failed(ConnectAnswer::closed));
  EXPECT_EQ(choice.version(), MqttVersion::v3_1_1);
  EXPECT_FALSE(choice.on_failed(ConnectAnswer::closed));
  EXPECT_EQ(choice.version(), MqttVersion::v5) << "the version was not the cause";
  EXPECT_TRUE(choice.on_failed(ConnectAnswer::closed)) << "it alternates while connects fail";
}

TEST(VersionChoice, CountsOnlyConsecutiveClosings) {
  VersionChoice choice;
  choice.on_failed(ConnectAnswer::closed);
  choice.on_failed(ConnectAnswer::other);
  EXPECT_FALSE(choice.on_failed(ConnectAnswer::closed));
}

TEST(VersionChoice, CountsNoClosingFromBeforeAConnection) {
  VersionChoice choice;
  choice.on_failed(ConnectAnswer::closed);
  choice.on_connected();
  choice.on_lost();
  EXPECT_FALSE(choice.on_failed(ConnectAnswer::closed)) << "the broker has accepted MQTT 5";
  EXPECT_EQ(choice.version(), MqttVersion::v5);
}

TEST(VersionChoice, TriesTheNewVersionFirstAfterAGuess) {
  VersionChoice choice;
  choice.on_failed(ConnectAnswer::closed);
  choice.on_failed(ConnectAnswer::closed);
  choice.on_lost();
  EXPECT_EQ(choice.version(), MqttVersion::v5);
  EXPECT_TRUE(choice.on_failed(ConnectAnswer::closed)) << "the guess is confirmed at once";
}

}  // namespace
}  // namespace slamgw
