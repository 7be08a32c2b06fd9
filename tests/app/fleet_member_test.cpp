// SPDX-License-Identifier: Apache-2.0
// One gateway among others, without a mesh: which robots' sessions it opens and when, and which
// robots it leaves to another gateway.
#include "daemon/app/fleet_member.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <boost/asio/post.hpp>
#include <mutex>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "daemon/app/status_collector.hpp"
#include "tests/support/eventually.hpp"
#include "tests/support/fake_broker.hpp"
#include "tests/support/memory_session_store.hpp"
#include "tests/support/temp_dir.hpp"

namespace slamgw {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;
using test::FakeBroker;

/// The gateway's own connection: it is up at once, carries nothing, and answers each SUBSCRIBE.
class OwnLink final : public MqttLink {
 public:
  OwnLink(boost::asio::io_context& io, MqttLinkListener& listener)
      : io_(io), listener_(&listener) {}
  void connect() override {
    boost::asio::post(io_, [this] {
      if (listener_) listener_->on_connected({});
    });
  }
  void publish(std::uint64_t, const BrokerMessage&) override {}
  void subscribe(std::string filter) override {
    boost::asio::post(io_, [this, filter] {
      if (listener_) listener_->on_subscribe_result(filter, true);
    });
  }
  void unsubscribe(std::string filter) override {
    boost::asio::post(io_, [this, filter] {
      if (listener_) listener_->on_unsubscribed(filter);
    });
  }
  void abandon(bool) override { listener_ = nullptr; }

 private:
  boost::asio::io_context& io_;
  MqttLinkListener* listener_;
};

class FleetMemberTest : public testing::Test, public UpstreamListener, public MeshListener {
 protected:
  FleetMemberTest() {
    broker.misbehave([this](FakeBroker::Connection&, const FakeBroker::Packet& packet) {
      const std::lock_guard lock(mutex_);
      if (packet.type() == FakeBroker::connect) opened_ = std::chrono::steady_clock::now();
      return false;
    });
  }
  ~FleetMemberTest() override {
    fleet.stop();
    gateway_driver.stop();
    upstream.stop();
  }

  Config make_config() const {
    Config made;
    made.gateway_id = "gw1";
    made.broker.host = "127.0.0.1";
    made.broker.port = broker.port();
    made.store.directory = directory.path();
    made.mqttsn.enabled = made.ble_mesh.enabled = false;
    return made;
  }
  bool comes_up() {
    upstream.start();
    return test::eventually(io, [&] { return link.is_up; });
  }
  void comes(const std::string& robot) {
    fleet.on_mesh_event(PresenceChange{Mesh::thread, robot, Presence::online, "fd00::1"});
  }
  void want(const std::string& robot) {
    WantSession wanted{robot};
    fleet.perform(wanted);
  }
  /// Receives the state of another gateway, and a robot's presence there as online.
  void other_says(const std::string& state, const std::string& robot) {
    EXPECT_TRUE(fleet.takes({"ntnu-slam/gateway/gw2/state", to_bytes(state)}));
    EXPECT_TRUE(fleet.takes({scheme.presence_topic_at("gw2", robot),
                             to_bytes(R"({"state":"online","since":"2026-11-28T10:00:00Z"})")}));
  }
  void passes(Duration time) {
    const TimePoint end = read_clocks().mono + time;
    ASSERT_TRUE(test::eventually(io, [&] { return read_clocks().mono >= end; }));
  }
  /// Returns when the broker received the last CONNECT of a robot's session.
  std::optional<TimePoint> opened() {
    const std::lock_guard lock(mutex_);
    return opened_;
  }
  nlohmann::json row_of(const std::string& robot) const {
    const auto rows = fleet.status().at("robots");
    for (const auto& row : rows)
      if (row.at("robot") == robot) return row;
    return {};
  }

  void on_link_up(const BrokerLimits&) override { set_up(true); }
  void on_link_down(const std::string&) override { set_up(false); }
  void on_silence(bool) override {}
  void on_published(std::uint64_t) override {}
  void on_publish_refused(std::uint64_t, const Refusal&) override {}
  void on_subscribe_result(const std::string&, bool) override {}
  void on_message(BrokerMessage, const UserProperties&) override {}
  void on_mesh_event(MeshEvent) override {}
  void set_up(bool is_up) {
    link.is_up = is_up;
    gateway_driver->on_broker_link(read_clocks());
    fleet.on_broker_link(is_up);
  }

 private:
  std::mutex mutex_;
  std::optional<TimePoint> opened_;

 protected:
  FakeBroker broker;
  test::TempDir directory;
  boost::asio::io_context io{1};
  const TopicScheme scheme{"ntnu-slam", "gw1"};
  const Config config = make_config();
  BrokerLink link;
  Gateway gateway{scheme, {"1", UpdateMode::positions, {}}, link, [](Mesh, const std::string&) {
                    return std::nullopt;
                  }};
  std::vector<std::string> uploads;  ///< their topics
  MachineDriver<Gateway> gateway_driver{io, gateway, [this](GatewayAction& action) {
                                          if (const auto* up = std::get_if<Upload>(&action))
                                            uploads.push_back(up->message.topic);
                                        }};
  test::MemorySessionStore store;
  DescriptorStore descriptors;
  Meshes meshes{io, config, scheme, store, descriptors, *this};
  Upstream upstream{io,
                    config.broker,
                    {[](boost::asio::io_context& loop, boost::asio::thread_pool&, LinkOptions,
                        MqttLinkListener& listener) -> std::shared_ptr<MqttLink> {
                      return std::make_shared<OwnLink>(loop, listener);
                    }},
                    *this};
  std::vector<BrokerMessage> submitted;
  FleetMember fleet{
      io, config, scheme, gateway, gateway_driver, meshes, upstream, [this](BrokerMessage message) {
        submitted.push_back(std::move(message));
      }};
};

/// The robot was heard while the broker was offline, so another gateway may already serve it.
TEST_F(FleetMemberTest, DelaysSessionOfRobotThatAnotherGatewayMayServe) {
  comes("r1");
  ASSERT_TRUE(comes_up());
  const TimePoint wanted = read_clocks().mono;
  want("r1");
  ASSERT_TRUE(test::eventually(io, [&] { return opened().has_value(); }));
  EXPECT_GE(*opened() - wanted, sessions::RobotSessions::unheard_delay);
}

TEST_F(FleetMemberTest, YieldsLostRobotToGatewayThatShowsItOnline) {
  comes("r1");
  ASSERT_TRUE(comes_up());
  want("r1");
  other_says(R"({"state":"online"})", "r1");
  EXPECT_EQ(row_of("r1").at("gateway"), "gw2");
  EXPECT_EQ(row_of("r1").at("served"), true);
  EXPECT_EQ(std::ranges::count(uploads, scheme.presence_topic("r1")), 1) << "withdrawn";
}

/// `doctor ROBOT` reads it.
TEST_F(FleetMemberTest, NamesSubscriptionThatTheBrokerRefuses) {
  broker.misbehave([](FakeBroker::Connection& connection, const FakeBroker::Packet& packet) {
    if (packet.type() != FakeBroker::subscribe) return false;
    connection.send(FakeBroker::suback << 4, {packet.body[0], packet.body[1], 0, 0x80});
    return true;
  });
  ASSERT_TRUE(comes_up());
  gateway_driver->on_mesh_event(PresenceChange{Mesh::thread, "r1", Presence::online, "fd00::1"},
                                read_clocks());
  fleet.on_mesh_event(SignOfLife{Mesh::thread, "r1"});
  ASSERT_TRUE(test::eventually(io, [&] { return row_of("r1").contains("refused"); }));
  const std::string refused = row_of("r1").at("refused");
  EXPECT_TRUE(refused.starts_with("the subscription to ntnu-slam/")) << refused;
}

/// The next CONNECT would take the robot's session from that gateway.
TEST_F(FleetMemberTest, StopsConnectingRobotThatAnotherGatewayShowsOnline) {
  broker.misbehave([](FakeBroker::Connection& connection, const FakeBroker::Packet&) {
    connection.close();
    return true;
  });
  ASSERT_TRUE(comes_up());
  fleet.on_mesh_event(SignOfLife{Mesh::thread, "r1"});
  ASSERT_TRUE(test::eventually(io, [&] { return broker.connections() == 3; })) << "0, 1, 3 s later";
  passes(milliseconds{500});
  other_says(R"({"state":"online"})", "r1");
  passes(milliseconds{500});
  const std::size_t tries = broker.connections();
  passes(seconds{4});  // the next one was due 4 s after the third
  EXPECT_EQ(broker.connections(), tries);
}

TEST_F(FleetMemberTest, PublishesRobotsOfDeadGatewayAsOffline) {
  ASSERT_TRUE(comes_up());
  other_says(R"({"state":"offline"})", "r1");
  EXPECT_EQ(row_of("r1").at("served"), false);
  want("r1");
  ASSERT_TRUE(test::eventually(io, [&] { return row_of("r1").at("gateway") == "gw1"; }));
  EXPECT_EQ(row_of("r1").at("served"), true);
  ASSERT_EQ(submitted.size(), 1U);
  EXPECT_EQ(submitted[0].topic, scheme.presence_topic("r1"));
  EXPECT_TRUE(submitted[0].retain);
  EXPECT_EQ(nlohmann::json::parse(submitted[0].payload).at("state"), "offline");
}

/// A robot that publishes without a session (QoS -1) has no presence.
TEST_F(FleetMemberTest, CountsRobotOfDeadGatewayOnceWhenItPublishesHere) {
  ASSERT_TRUE(comes_up());
  other_says(R"({"state":"offline"})", "r1");
  want("r1");
  ASSERT_TRUE(test::eventually(io, [&] { return row_of("r1").at("gateway") == "gw1"; }));
  EXPECT_EQ(fleet.status().at("gateways").at(0).at("robots"), 1);
  const Report report{.mesh = Mesh::thread,
                      .robot = "r1",
                      .topic = "ntnu-slam/robot/r1/update",
                      .payload = to_bytes("1234"),
                      .receipt = no_receipt};
  fleet.on_mesh_event(report);
  gateway_driver->on_mesh_event(report, read_clocks());
  EXPECT_EQ(fleet.status().at("gateways").at(0).at("robots"), 1);
}

TEST_F(FleetMemberTest, TakesMessagesOfOtherGatewaysOnly) {
  EXPECT_TRUE(fleet.takes({"ntnu-slam/gateway/gw2/state", to_bytes(R"({"state":"online"})")}));
  EXPECT_FALSE(fleet.takes({scheme.state_topic(), to_bytes(R"({"state":"online"})")}));
  EXPECT_FALSE(fleet.takes({scheme.presence_topic("r1"), {}}));
  EXPECT_FALSE(fleet.takes({"ntnu-slam/server/r1/cmd", {}}));
}

TEST_F(FleetMemberTest, IsInStatusWithTheNamesThatPeopleScriptAgainst) {
  const Outbox outbox(1, 1);
  const StatusCollector collector{config, link, gateway, outbox, meshes, upstream, fleet, {}};
  const nlohmann::json status = collector.status(collector.mesh_links(), {}, {});
  const auto names = [](const nlohmann::json& object) {
    std::set<std::string> found;
    for (const auto& [name, value] : object.items()) found.insert(name);
    return found;
  };
  EXPECT_EQ(names(status),
            (std::set<std::string>{"broker", "commands", "control", "fleet", "gateway",
                                   "memory_rss_bytes", "meshes", "messages", "queue", "retained",
                                   "robots", "store", "uptime_s", "version"}));
  EXPECT_EQ(names(status["broker"]),
            (std::set<std::string>{"missing_rights", "refused", "since", "state", "uri", "why"}));
  EXPECT_EQ(names(status["meshes"]), (std::set<std::string>{"ble", "thread"}));
  EXPECT_EQ(names(status["robots"]), (std::set<std::string>{"asleep", "contested", "deaf", "known",
                                                            "offline", "online", "untracked"}));
  EXPECT_EQ(names(status["commands"]), (std::set<std::string>{"late", "open"}));
  EXPECT_EQ(names(status["queue"]), (std::set<std::string>{"bytes", "depth", "max_bytes"}));
  EXPECT_TRUE(status["control"].is_object());
  EXPECT_TRUE(status["fleet"].is_object());
}

}  // namespace
}  // namespace slamgw
