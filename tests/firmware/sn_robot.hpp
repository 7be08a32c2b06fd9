// SPDX-License-Identifier: Apache-2.0
// A client of slam_mqttsn.h with its settings, without a gateway: a test writes the gateway's
// messages. The clock wraps soon after its start.
#pragma once

#include <gtest/gtest.h>

#include <string>
#include <utility>
#include <vector>

#include "tests/firmware/headers.hpp"
#include "tests/mqttsn_udp/describe.hpp"

namespace slamgw::firmware {

using mqttsn::hex;

class SnRobot {
 public:
  explicit SnRobot(std::vector<slam_sn_topic> table = {{"a/b", 0, 0}}) : topics(std::move(table)) {
    settings.client_id = "r1";
    settings.clean_session = true;
    settings.keep_alive_s = 60;
  }
  SnRobot(const SnRobot&) = delete;
  SnRobot& operator=(const SnRobot&) = delete;

  /// Sends CONNECT. It has the message id `random`, which is not on the wire.
  void start(std::uint16_t random = 0xffff) {
    settings.topics = topics.data();
    settings.topic_count = static_cast<std::uint8_t>(topics.size());
    ASSERT_TRUE(slam_sn_init(&client, &settings, random));
    slam_sn_connect(&client, now);
  }
  /// Connects, and receives all of the gateway's answers; topics get the ids 5, 6 ...
  void get_ready(std::uint16_t random = 0xffff) {
    start(random);
    sent();
    hear("03 05 00");
    for (std::uint8_t id = 5; id < 20 && !slam_sn_is_ready(&client); ++id) answer_setup(id);
    ASSERT_TRUE(slam_sn_is_ready(&client));
  }

  /// Accepts the one request that the client sends now, with this topic id.
  void answer_setup(std::uint8_t id) {
    const auto out = sent();
    ASSERT_EQ(out.size(), 1U);
    const Bytes request = hex(out[0]);
    Bytes answer{0x07, 0x0b, 0x00, id, request[4], request[5], 0x00};
    if (request[1] == 0x12) answer = {0x08, 0x13, 0x20, 0x00, id, request[3], request[4], 0x00};
    hear(to_hex(answer));
  }

  slam_sn_event hear(std::string_view octets) {
    datagram = hex(octets);
    slam_sn_event event{};
    slam_sn_receive(&client, now, datagram.data(), datagram.size(), &event);
    return event;
  }
  /// Returns the datagrams that the client sends now, as hex.
  std::vector<std::string> sent() {
    std::vector<std::string> out;
    while (true) {
      std::size_t size = 0;
      const std::uint8_t* octets = slam_sn_poll(&client, now, &size);
      if (size == 0) return out;
      out.push_back(to_hex(ByteView(octets, size)));
    }
  }
  struct Sent {
    std::uint32_t after_ms;
    std::string octets;
    bool operator==(const Sent&) const = default;
  };
  /// Lets time pass from deadline to deadline. Returns the datagrams sent.
  std::vector<Sent> pass(std::uint32_t ms) {
    std::vector<Sent> out;
    const std::uint32_t begin = now;
    while (true) {
      for (std::string& octets : sent()) out.push_back({now - begin, std::move(octets)});
      const std::uint32_t wait = slam_sn_wait_ms(&client, now);
      const std::uint32_t passed = now - begin;
      if (wait > ms - passed) break;
      now += wait;
    }
    now = begin + ms;
    return out;
  }
  /// Falls asleep, wakes and connects again; its one topic has the id 5.
  void sleep_and_wake() {
    EXPECT_TRUE(slam_sn_sleep(&client, now, 10));
    sent();
    hear("02 18");
    slam_sn_wake(&client, now);
    sent();
    hear("03 05 00");
    answer_setup(5);
  }
  bool publish(std::uint8_t flags, std::string_view data = "hi", std::uint8_t topic = 0) {
    return slam_sn_publish(&client, now, topic, flags, data.data(), data.size());
  }

  std::vector<slam_sn_topic> topics;
  slam_sn_settings settings{};
  slam_sn_client client{};
  std::uint32_t now = 0xffffff00;
  Bytes datagram;
};

}  // namespace slamgw::firmware
