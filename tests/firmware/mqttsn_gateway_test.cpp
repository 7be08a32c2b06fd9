// SPDX-License-Identifier: Apache-2.0
// slam_mqttsn.h and the daemon's MQTT-SN machine on one virtual clock, with a radio between them
// that loses datagrams.
#include <gtest/gtest.h>

#include <random>

#include "tests/firmware/headers.hpp"
#include "tests/mqttsn_udp/sn_rig.hpp"

namespace slamgw::firmware {
namespace {

using mqttsn::SnRig;
using std::chrono::milliseconds;

const std::string update_topic = "ntnu-slam/robot/r1/update";
const std::string command_topic = "ntnu-slam/server/r1/cmd";

class Link {
 public:
  explicit Link(std::uint64_t seed = 1, double loss = 0, bool is_clean = true)
      : random_(seed), loss_(loss) {
    rig.are_addresses_validated = false;
    settings_.client_id = "r1";
    settings_.will_topic = "ntnu-slam/robot/r1/will";
    settings_.will_message = "lost";
    settings_.will_flags = SLAM_SN_QOS1;
    settings_.topics = topics_;
    settings_.topic_count = 2;
    settings_.clean_session = is_clean;
    settings_.keep_alive_s = 20;
    settings_.retry_ms = 1000;
    settings_.retries = 5;
    EXPECT_TRUE(slam_sn_init(&client, &settings_, static_cast<std::uint16_t>(seed)));
    slam_sn_connect(&client, now_ms());
  }

  std::uint32_t now_ms() const {
    return static_cast<std::uint32_t>(rig.now.time_since_epoch() / milliseconds{1});
  }
  void pass(Duration time) {
    constexpr milliseconds step{10};
    for (Duration passed{}; passed < time; passed += step) {
      rig.pass(step);
      if (is_on) carry();
    }
  }
  bool publish(std::uint8_t flags, const std::string& data) {
    return slam_sn_publish(&client, now_ms(), 0, flags, data.data(), data.size());
  }
  /// Publishes one message after the other, as soon as there is room.
  void publish_all(std::uint8_t flags, int count) {
    for (int i = 0, waits = 0; i < count && waits < 10000; ++waits) {
      if (publish(flags, std::to_string(i))) ++i;
      pass(milliseconds{10});
    }
    pass(std::chrono::seconds{40});
  }
  std::vector<std::string> reported() const {
    std::vector<std::string> out;
    for (const Report& report : rig.reports) out.emplace_back(as_text(report.payload));
    return out;
  }

  SnRig rig;
  slam_sn_client client{};
  bool is_on = true;
  std::vector<std::string> heard;  ///< topics and payloads
  unsigned acknowledged = 0;

 private:
  bool is_lost() { return std::uniform_real_distribution<double>(0, 1)(random_) < loss_; }

  void carry() {
    for (const auto& datagram : std::exchange(rig.datagrams, {})) {
      if (is_lost()) continue;
      slam_sn_event event{};
      slam_sn_receive(&client, now_ms(), datagram.bytes.data(), datagram.bytes.size(), &event);
      take(event);
      send();
    }
    send();
    while (receipts_ < rig.reports.size()) {
      const auto& receipt = rig.reports[receipts_++].receipt;
      if (receipt.is_owed()) rig.receipt(receipt.id);
    }
  }
  void send() {
    while (true) {
      std::size_t size = 0;
      const std::uint8_t* octets = slam_sn_poll(&client, now_ms(), &size);
      if (size == 0) return;
      if (!is_lost()) rig.send_octets(1, ByteView(octets, size));
    }
  }
  void take(const slam_sn_event& event) {
    if (event.kind == SLAM_SN_PUBLISHED && event.code == SLAM_SN_ACCEPTED) ++acknowledged;
    if (event.kind == SLAM_SN_MESSAGE)
      heard.push_back(std::string(event.name, event.name_size) + " " +
                      std::string(as_text(ByteView(event.data, event.size))));
  }

  const slam_sn_topic topics_[2] = {{"ntnu-slam/robot/r1/update", 0, 0},
                                    {"ntnu-slam/server/r1/+", 0, SLAM_SN_SUBSCRIBE | SLAM_SN_QOS1}};
  slam_sn_settings settings_{};
  std::mt19937_64 random_;
  double loss_;
  std::size_t receipts_ = 0;
};

std::vector<std::string> numbers(int count) {
  std::vector<std::string> out;
  for (int i = 0; i < count; ++i) out.push_back(std::to_string(i));
  return out;
}

TEST(SnClientAtTheGateway, ConnectsAndPublishes) {
  for (const unsigned qos : {SLAM_SN_QOS1, SLAM_SN_QOS2}) {
    Link link;
    link.publish_all(static_cast<std::uint8_t>(qos), 10);
    EXPECT_TRUE(slam_sn_is_ready(&link.client));
    EXPECT_EQ(link.reported(), numbers(10));
    EXPECT_EQ(link.acknowledged, 10U);
    EXPECT_EQ(link.client.lost + link.client.invalid, 0U);
  }
}

TEST(SnClientAtTheGateway, LosesNothingOverALossyRadio) {
  for (std::uint64_t seed = 1; seed <= 6; ++seed) {
    Link link(seed, 0.25, seed % 2 == 0);
    const auto qos = static_cast<std::uint8_t>(seed <= 3 ? SLAM_SN_QOS1 : SLAM_SN_QOS2);
    link.publish_all(qos, 40);
    EXPECT_EQ(link.acknowledged, 40U) << seed;
    auto arrived = link.reported();
    if (link.client.lost > 0)  // a new session does not recognize repeats
      arrived.erase(std::unique(arrived.begin(), arrived.end()), arrived.end());
    std::erase(arrived, "lost");  // its will
    EXPECT_EQ(arrived, numbers(40)) << seed;
  }
}

TEST(SnClientAtTheGateway, HearsEachCommandOnceOverALossyRadio) {
  for (std::uint64_t seed = 1; seed <= 4; ++seed) {
    Link link(seed, 0.2);
    link.pass(std::chrono::seconds{30});
    ASSERT_TRUE(slam_sn_is_ready(&link.client)) << seed;
    for (int i = 0; i < 20; ++i) {
      link.rig.broker(command_topic, std::to_string(i), 1);
      link.pass(std::chrono::seconds{5});
    }
    std::vector<std::string> expected;
    for (const std::string& number : numbers(20)) expected.push_back(command_topic + " " + number);
    EXPECT_EQ(link.heard, expected) << seed;
    EXPECT_EQ(link.client.lost, 0U) << seed;
  }
}

TEST(SnClientAtTheGateway, StaysConnectedWithoutPublishing) {
  Link link;
  link.pass(std::chrono::minutes{10});
  EXPECT_TRUE(slam_sn_is_ready(&link.client));
  EXPECT_EQ(link.client.lost, 0U);
  EXPECT_TRUE(link.rig.reports.empty());
}

TEST(SnClientAtTheGateway, HasItsWillPublishedWhenItVanishes) {
  Link link;
  link.pass(std::chrono::seconds{1});
  link.is_on = false;
  link.pass(std::chrono::seconds{35});
  ASSERT_EQ(link.rig.reports.size(), 1U);
  EXPECT_EQ(link.rig.reports[0].topic, "ntnu-slam/robot/r1/will");
  EXPECT_EQ(as_text(link.rig.reports[0].payload), "lost");
}

TEST(SnClientAtTheGateway, DisconnectsWithoutPublishingItsWill) {
  Link link;
  link.pass(std::chrono::seconds{1});
  slam_sn_disconnect(&link.client, link.now_ms());
  link.pass(std::chrono::minutes{2});
  EXPECT_EQ(link.client.state, SLAM_SN_OFF);
  EXPECT_TRUE(link.rig.reports.empty());
}

TEST(SnClientAtTheGateway, ReconnectsAfterItWasOutOfReach) {
  for (const bool is_clean : {true, false}) {
    Link link(1, 0, is_clean);
    link.pass(std::chrono::seconds{1});
    EXPECT_TRUE(link.publish(SLAM_SN_QOS1, "before"));
    link.is_on = false;
    link.pass(std::chrono::minutes{2});
    link.rig.datagrams.clear();
    link.is_on = true;
    link.pass(std::chrono::seconds{10});
    EXPECT_TRUE(slam_sn_is_ready(&link.client));
    EXPECT_EQ(link.acknowledged, 1U);
    link.rig.broker(command_topic, "after", 1);
    link.pass(std::chrono::seconds{2});
    EXPECT_EQ(link.heard, std::vector<std::string>{command_topic + " after"});
  }
}

TEST(SnClientAtTheGateway, GetsQueuedCommandsWhileItSleeps) {
  for (const bool is_clean : {true, false}) {
    Link link(1, 0.1, is_clean);
    link.pass(std::chrono::seconds{20});
    for (int tries = 0; tries < 100 && link.client.state != SLAM_SN_ASLEEP; ++tries) {
      slam_sn_sleep(&link.client, link.now_ms(), 20);
      link.pass(std::chrono::seconds{1});
    }
    ASSERT_TRUE(slam_sn_is_dozing(&link.client));
    for (int i = 0; i < 3; ++i) link.rig.broker(command_topic, std::to_string(i), 1);
    EXPECT_TRUE(link.heard.empty());
    link.pass(std::chrono::seconds{28});
    EXPECT_EQ(link.heard.size(), 3U);
    link.pass(std::chrono::minutes{10});
    EXPECT_EQ(link.client.state, SLAM_SN_ASLEEP);
    slam_sn_wake(&link.client, link.now_ms());
    link.pass(std::chrono::seconds{20});
    EXPECT_TRUE(slam_sn_is_ready(&link.client));
    EXPECT_EQ(link.client.lost, 0U);
  }
}

}  // namespace
}  // namespace slamgw::firmware
