// SPDX-License-Identifier: Apache-2.0
// The messages that are passed to Paho.
#include "daemon/mqtt/paho/paho_message.hpp"

#include <gtest/gtest.h>
#include <mqtt/async_client.h>

#include <map>

namespace slamgw {
namespace {

using namespace std::chrono_literals;

std::map<std::string, std::string> user_properties(const mqtt::const_message_ptr& message) {
  std::map<std::string, std::string> found;
  const mqtt::properties& all = message->get_properties();
  for (std::size_t i = 0; i < all.count(mqtt::property::USER_PROPERTY); ++i) {
    const auto [name, value] = mqtt::get<mqtt::string_pair>(all, mqtt::property::USER_PROPERTY, i);
    found[name] = value;
  }
  return found;
}

BrokerMessage message_of(Mesh mesh, WallTime received_at) {
  return {"t/" + std::string(to_string(mesh)),
          {1, 2, 3},
          Qos::at_least_once,
          true,
          Provenance{mesh, received_at}};
}

/// Paho frees what it has allocated only while there is a client.
class PublishFormTest : public testing::Test {
 private:
  mqtt::async_client client_{"tcp://127.0.0.1:1", "test"};
};

TEST_F(PublishFormTest, AddsMeshGatewayAndTimeToEachMessage) {
  PublishForm form(MqttVersion::v5, "pi");
  const WallTime time{1'700'000'000'123ms};
  const auto first = form.fill(message_of(Mesh::ble, time));
  EXPECT_EQ(first->get_topic(), "t/ble");
  EXPECT_EQ(first->get_payload_str(), "\x01\x02\x03");
  EXPECT_EQ(first->get_qos(), 1);
  EXPECT_TRUE(first->is_retained());
  EXPECT_EQ(user_properties(first),
            (std::map<std::string, std::string>{
                {"mesh", "ble"}, {"gateway", "pi"}, {"received_at", "2023-11-14T22:13:20.123Z"}}));
  const auto second = form.fill(message_of(Mesh::thread, time + 1001ms));
  EXPECT_EQ(
      user_properties(second),
      (std::map<std::string, std::string>{
          {"mesh", "thread"}, {"gateway", "pi"}, {"received_at", "2023-11-14T22:13:21.124Z"}}));
}

TEST_F(PublishFormTest, AddsNoPropertiesToTheGatewaysOwnMessages) {
  PublishForm form(MqttVersion::v5, "pi");
  form.fill(message_of(Mesh::ble, WallTime{}));
  const auto own = form.fill({"own", {}, Qos::at_most_once, false, std::nullopt});
  EXPECT_TRUE(own->get_properties().empty());
  EXPECT_EQ(own->get_topic(), "own");
  EXPECT_EQ(own->get_qos(), 0);
  EXPECT_FALSE(own->is_retained());
}

TEST_F(PublishFormTest, HasNoPropertiesInMqtt311) {
  PublishForm form(MqttVersion::v3_1_1, "pi");
  const auto message = form.fill(message_of(Mesh::thread, WallTime{}));
  EXPECT_TRUE(message->get_properties().empty());
  EXPECT_EQ(message->get_topic(), "t/thread");
}

}  // namespace
}  // namespace slamgw
