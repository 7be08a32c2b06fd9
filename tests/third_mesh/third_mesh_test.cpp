// SPDX-License-Identifier: Apache-2.0
// A third mesh, "zigbee", made as ARCHITECTURE.md says ("How to add a mesh"): a value in mesh.hpp,
// a machine, a shell. The rest of the daemon is unchanged, and messages pass both ways.
#include <gtest/gtest.h>
#include <mqtt/async_client.h>

#include <map>
#include <nlohmann/json.hpp>

#include "daemon/app/status.hpp"
#include "daemon/core/gateway.hpp"
#include "daemon/core/result.hpp"
#include "daemon/mqtt/paho/paho_message.hpp"
#include "daemon/observability/log_fields.hpp"
#include "daemon/observability/service_notifier.hpp"
#include "daemon/runtime/mesh_shell.hpp"
#include "daemon/storage/message_log.hpp"

namespace slamgw {
namespace {

using nlohmann::json;
using namespace std::chrono_literals;

static_assert(all_meshes.size() == 3);
static_assert(to_string(Mesh::zigbee) == "zigbee");

/// A message to a robot by radio.
struct Transmit {
  std::string robot;
  std::string text;
};
using ZigbeeAction = std::variant<Transmit, MeshEvent>;

class ZigbeeMachine {
 public:
  explicit ZigbeeMachine(TopicScheme topics) : topics_(std::move(topics)) {}

  void on_frame(const std::string& robot, Bytes payload) {
    if (!robots_.contains(robot)) {
      robots_[robot] = CommandId::none;
      actions_.push(PresenceChange{Mesh::zigbee, robot, Presence::online, "0x1a2b"});
      actions_.push(
          SubscribeRequest{Mesh::zigbee, robot, topics_.command_filter(robot), Qos::at_least_once});
    }
    waits_for_receipt_[++last_receipt_] = robot;
    actions_.push(Report{.mesh = Mesh::zigbee,
                         .robot = robot,
                         .topic = topics_.robot_topic(robot, "update"),
                         .payload = std::move(payload),
                         .qos = Qos::at_least_once,
                         .receipt = {Mesh::zigbee, last_receipt_}});
  }
  void on_acknowledgement(const std::string& robot, const Now&) {
    const CommandId command = std::exchange(robots_[robot], CommandId::none);
    actions_.push(
        CommandOutcome{Mesh::zigbee, command, robot, "cmd", CommandResult::delivered, 3ms, ""});
  }

  void on_receipt(std::uint64_t id, ReceiptOutcome outcome, const Now&) {
    actions_.push(Transmit{waits_for_receipt_[id], outcome == ReceiptOutcome::safe ? "ack" : ""});
  }
  void on_broker_message(const RobotMessage& what, const Now&) {
    if (what.command == CommandId::none) return;
    robots_[what.robot] = what.command;
    actions_.push(Transmit{what.robot, std::string(as_text(what.message.payload))});
  }
  void on_subscribe_result(const std::string& robot, const std::string&, bool granted, const Now&) {
    granted_ += granted && robots_.contains(robot);
  }
  void on_broker_link(bool, const Now&) {}
  void on_trace(bool) {}
  void on_stop(const Now&) {}
  std::optional<Presence> presence_of(const std::string& robot) const {
    return robots_.contains(robot) ? std::optional(Presence::online) : std::nullopt;
  }
  std::size_t queued_for(const std::string&) const { return 0; }
  Counters counters() const { return {{"granted", granted_}}; }

  std::optional<ZigbeeAction> next_action() { return actions_.pop(); }
  std::optional<TimePoint> deadline() const { return std::nullopt; }
  void on_deadline(const Now&) {}

 private:
  TopicScheme topics_;
  std::map<std::string, CommandId> robots_;
  std::map<std::uint64_t, std::string> waits_for_receipt_;
  std::uint64_t last_receipt_ = 0;
  std::uint64_t granted_ = 0;
  ActionQueue<ZigbeeAction> actions_;
};

class ZigbeeShell final : public MeshShell<ZigbeeMachine> {
 public:
  ZigbeeShell(boost::asio::io_context& io, TopicScheme topics, MeshListener& listener)
      : machine_(std::move(topics)), driver_(io, machine_, [&](ZigbeeAction& action) {
          std::visit(overloaded{[&](Transmit& it) { sent.push_back(it.robot + " " + it.text); },
                                [&](MeshEvent& it) { listener.on_mesh_event(std::move(it)); }},
                     action);
        }) {}

  void start() override {}
  void stop() override { driver_.stop(); }
  MachineDriver<ZigbeeMachine>& driver() override { return driver_; }
  const MachineDriver<ZigbeeMachine>& driver() const override { return driver_; }
  std::vector<std::string> sent;

 private:
  ZigbeeMachine machine_;
  MachineDriver<ZigbeeMachine> driver_;
};

/// The core wired as in App, and a broker that accepts everything.
class ThirdMesh : public testing::Test, private MeshListener {
 protected:
  void SetUp() override {
    broker.is_up = true;
    driver->on_broker_link(read_clocks());
  }
  void on_mesh_event(MeshEvent event) override {
    if (const auto* request = std::get_if<SubscribeRequest>(&event))
      mesh.on_subscribe_result(request->robot, request->filter, true);
    driver->on_mesh_event(std::move(event), read_clocks());
  }
  void perform(GatewayAction& action) {
    std::visit(overloaded{[&](PassUp& it) {
                            traffic.push_back(traffic_text(it.event, {}));
                            give_to_broker(it.upload());
                          },
                          [&](Upload& it) { give_to_broker(std::move(it)); },
                          [&](DeliverToMesh& it) {
                            EXPECT_EQ(it.mesh, Mesh::zigbee);
                            mesh.on_broker_message(it.message);
                          },
                          [&](TrafficEvent& it) { traffic.push_back(traffic_text(it, {})); },
                          [](auto&) {}},
               action);
  }
  void give_to_broker(Upload upload) {
    if (upload.receipt.is_owed()) mesh.on_receipt(upload.receipt.id, ReceiptOutcome::safe);
    at_broker.push_back(std::move(upload.message));
  }
  void robot_says(const std::string& robot, Bytes payload) {
    mesh.driver()->on_frame(robot, std::move(payload));
  }
  json last_at(const std::string& topic) const {
    for (auto message = at_broker.rbegin(); message != at_broker.rend(); ++message)
      if (message->topic == topic) return json::parse(as_text(message->payload));
    return {};
  }

  boost::asio::io_context io;
  TopicScheme topics{"p", "g"};
  BrokerLink broker;
  ZigbeeShell mesh{io, topics, *this};
  Gateway gateway{topics,
                  {"1", UpdateMode::positions, {}},
                  broker,
                  [this](Mesh which, const std::string& robot) {
                    return which == Mesh::zigbee ? mesh.presence_of(robot) : std::nullopt;
                  }};
  MachineDriver<Gateway> driver{io, gateway, [this](GatewayAction& action) { perform(action); }};
  std::vector<BrokerMessage> at_broker;
  std::vector<std::string> traffic;
};

TEST_F(ThirdMesh, CarriesReportsUpAndTheirReceiptsBack) {
  robot_says("z1", {0x0a, 0x00, 0xec, 0xff});
  EXPECT_EQ(mesh.sent, std::vector<std::string>{"z1 ack"});
  ASSERT_EQ(at_broker.back().topic, "p/robot/z1/update");
  ASSERT_TRUE(at_broker.back().provenance);
  EXPECT_EQ(at_broker.back().provenance->mesh, Mesh::zigbee);
  EXPECT_EQ(traffic, std::vector<std::string>{"zigbee z1 update x=10 y=-20 obstacles=0"});
  const json presence = last_at("p/gateway/g/robots/z1");
  EXPECT_EQ(presence["mesh"], "zigbee");
  EXPECT_EQ(presence["state"], "online");
}

TEST_F(ThirdMesh, CarriesCommandsDownAndTheirOutcomesBack) {
  robot_says("z1", {0x0a, 0x00, 0xec, 0xff});
  EXPECT_EQ(mesh.counters().at(0).value, 1u) << "its subscription is granted";
  const auto server_sends = [&](const std::string& robot) {
    driver->commands().on_robot_message(
        {robot, {"p/server/" + robot + "/cmd", to_bytes("go"), Qos::at_least_once}}, read_clocks());
  };
  server_sends("z1");
  EXPECT_EQ(mesh.sent.back(), "z1 go");
  mesh.driver()->on_acknowledgement("z1", read_clocks());
  EXPECT_EQ(last_at("p/gateway/g/commands/z1")["outcome"], "delivered");
  server_sends("unknown");
  EXPECT_EQ(mesh.sent.back(), "z1 go");
  EXPECT_EQ(last_at("p/gateway/g/commands/unknown")["outcome"], "refused");
}

TEST(ThirdMeshParts, HandleNewMesh) {
  ServiceState state;
  state.mesh_is_up[Mesh::zigbee] = true;
  EXPECT_EQ(service_status(state, 0), "broker down, zigbee up, 0 robots online, 0 msg/s");

  PerMesh<MeshLink> links;
  links[Mesh::zigbee] = {true, true, "channel 15", {}};
  EXPECT_EQ(to_json(links)["zigbee"]["state"], "up");

  Robot robot;
  robot.last_mesh = Mesh::zigbee;
  robot.last_seen = WallTime{10s};
  robot.on_mesh[Mesh::zigbee].since = WallTime{50s};
  EXPECT_EQ(why_absent(robot, {.link = {true, true, "", {}}}), "had not been heard for 40 s");

  for (const Mesh mesh : all_meshes) {
    const BrokerMessage before{"t", {}, Qos::at_least_once, false, Provenance{mesh, WallTime{7s}}};
    const BrokerMessage after = decode_message(encode_message({{}, before})).value().message;
    ASSERT_TRUE(after.provenance);
    EXPECT_EQ(after.provenance->mesh, mesh) << "after it was stored";
  }
  Bytes record =
      encode_message({{}, {"t", {}, Qos::at_least_once, false, Provenance{Mesh::ble, {}}}});
  record[16] = static_cast<std::uint8_t>(all_meshes.size() + 1);  // written by a later version
  EXPECT_FALSE(decode_message(record).value().message.provenance);

  RobotRegistry registry;
  registry.on_presence({Mesh::zigbee, "z1", Presence::online, "0x1a2b"}, {});
  EXPECT_EQ(registry.find("z1")->mesh(), Mesh::zigbee);

  const mqtt::async_client client("tcp://127.0.0.1:1", "test");  // PublishForm wants one
  PublishForm form(MqttVersion::v5, "g");
  const auto message =
      form.fill({"t", {}, Qos::at_most_once, false, Provenance{Mesh::zigbee, WallTime{}}});
  const auto [name, value] =
      mqtt::get<mqtt::string_pair>(message->get_properties(), mqtt::property::USER_PROPERTY, 0);
  EXPECT_EQ(name + " " + value, "mesh zigbee");
}

}  // namespace
}  // namespace slamgw
