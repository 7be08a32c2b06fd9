// SPDX-License-Identifier: Apache-2.0
// Robots that only listen, over real sockets. Each has its own loopback address, because the
// gateway validates IP addresses.
#include <gtest/gtest.h>

#include <fmt/format.h>

#include "tests/mqttsn_udp/io/udp_rig.hpp"

namespace slamgw::mqttsn {
namespace {

using boost::asio::ip::udp;

enum class Topic { name, predefined, short_name };
enum class Way { connects, kept_session, wakes };

/// A client that answers REGISTER and PUBLISH.
class Listener {
 public:
  Listener(UdpRig& rig, unsigned place)
      : rig_(rig), gateway_(boost::asio::ip::address_v4::loopback(), rig.core.port()) {
    bind(place);
  }
  /// Moves to 127.0.1.`place`.
  void bind(unsigned place) {
    const auto address = boost::asio::ip::make_address(fmt::format("127.0.1.{}", place));
    socket_.emplace(rig_.io, udp::endpoint(address, 0));
    socket_->connect(gateway_);
    socket_->non_blocking(true);
  }
  void send(const Packet& packet) { socket_->send(boost::asio::buffer(encode(packet))); }
  /// Waits for an answer of this kind.
  template <class Answer>
  bool awaits() {
    return test::eventually(rig_.io, [&] { return std::holds_alternative<Answer>(take()); });
  }
  /// Waits for a message with this payload.
  bool hears(const std::string& payload) {
    return test::eventually(rig_.io, [&] {
      const Packet packet = take();
      const auto* publish = std::get_if<Publish>(&packet);
      return publish && publish->payload == to_bytes(payload);
    });
  }

 private:
  /// Reads and answers a datagram. Returns a PINGREQ if none has come.
  Packet take() {
    Bytes buffer(2000);
    boost::system::error_code error;
    const std::size_t size = socket_->receive(boost::asio::buffer(buffer), 0, error);
    if (error) return Pingreq{};
    Packet packet = *decode(ByteView(buffer).first(size));
    if (const auto* p = std::get_if<Register>(&packet))
      send(Regack{p->topic_id, p->msg_id, ReturnCode::accepted});
    if (const auto* p = std::get_if<Publish>(&packet))
      send(Puback{p->topic_id, p->msg_id, ReturnCode::accepted});
    return packet;
  }

  UdpRig& rig_;
  udp::endpoint gateway_;
  std::optional<udp::socket> socket_;
};

struct Case {
  Topic topic = Topic::name;
  Way way = Way::connects;
  bool pings = false;
  unsigned number = 0;  ///< the robot's number
};

std::string robot_of(const Case& one) { return fmt::format("r{}", one.number); }

std::string topic_of(const Case& one) {
  if (one.topic == Topic::short_name) return "ab";
  return fmt::format("ntnu-slam/server/{}/cmd", robot_of(one));
}

Subscribe subscription_of(const Case& one) {
  Subscribe request{false, WireQos::one, TopicIdType::normal, 2, topic_of(one), 0};
  if (one.topic == Topic::name) return request;
  request.topic_name.clear();
  const bool is_short = one.topic == Topic::short_name;
  request.topic_id_type = is_short ? TopicIdType::short_name : TopicIdType::predefined;
  request.topic_id = is_short ? 'a' << 8 | 'b' : 7;
  return request;
}

bool gets_its_command(UdpRig& rig, const Case& one) {
  const std::string id = robot_of(one);
  const std::string payload = "for " + id;
  const bool is_command = one.topic != Topic::short_name;
  const auto publish = [&] {
    rig.adapter.on_broker_message({id,
                                   {topic_of(one), to_bytes(payload), Qos::at_least_once, false},
                                   is_command ? CommandId{one.number} : CommandId::none});
  };
  Listener robot(rig, 2 * one.number);
  robot.send(Connect{false, one.way != Way::kept_session, protocol_id, 60, id});
  bool is_well = robot.awaits<Connack>();
  robot.send(subscription_of(one));
  is_well = is_well && robot.awaits<Suback>();
  if (one.way == Way::kept_session) {
    robot.send(Disconnect{});
    is_well = is_well && robot.awaits<Disconnect>();
    robot.bind(2 * one.number + 1);
    robot.send(Connect{false, false, protocol_id, 60, id});
    is_well = is_well && robot.awaits<Connack>();
  }
  if (one.way == Way::wakes) {
    robot.send(Disconnect{60});
    is_well = is_well && robot.awaits<Disconnect>();
    publish();
    robot.bind(2 * one.number + 1);
    robot.send(Pingreq{id});
    return is_well && robot.hears(payload);
  }
  if (one.pings) robot.send(Pingreq{});
  if (one.pings) is_well = is_well && robot.awaits<Pingresp>();
  publish();
  return is_well && robot.hears(payload);
}

TEST(MqttsnAdapter, DeliversTheCommandToARobotThatOnlyListens) {
  std::vector<Case> cases;
  Settings settings;
  for (const Topic topic : {Topic::name, Topic::predefined, Topic::short_name}) {
    for (const Way way : {Way::connects, Way::kept_session, Way::wakes}) {
      for (const bool pings : {false, true}) {
        cases.push_back({topic, way, pings, static_cast<unsigned>(cases.size() + 1)});
        settings.predefined_topics.push_back(
            {7, topic_of({Topic::name, way, pings, cases.back().number}), robot_of(cases.back())});
      }
    }
  }
  UdpRig rig({"127.0.0.1:0"}, settings);
  for (const Case& one : cases) {
    EXPECT_TRUE(gets_its_command(rig, one))
        << "topic " << static_cast<int>(one.topic) << ", way " << static_cast<int>(one.way)
        << (one.pings ? ", pings" : ", silent");
  }
}

}  // namespace
}  // namespace slamgw::mqttsn
