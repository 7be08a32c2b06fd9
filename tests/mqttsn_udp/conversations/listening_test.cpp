// SPDX-License-Identifier: Apache-2.0
// Robots that subscribe and then only listen, at addresses that are not validated. Their commands
// arrive within seconds, for each kind of topic id and each way to connect.
#include <gtest/gtest.h>

#include <algorithm>
#include <random>

#include "tests/mqttsn_udp/sn_rig.hpp"

namespace slamgw::mqttsn {
namespace {

enum class Topic { name, predefined, short_name };
/// How the robot comes to the address at which it listens.
enum class Way { connects, kept_session, second_gateway, wakes };

struct Case {
  Topic topic = Topic::name;
  Way way = Way::connects;
  bool pings = false;
  bool is_ipv4 = false;
  std::size_t payload_octets = 0;
};

const std::string command_topic = "ntnu-slam/server/r1/cmd";
constexpr std::uint16_t predefined_id = 7;

/// A gateway that trusts no address.
struct Gateway : SnRig {
  Gateway() : SnRig(settings(), {}, {}, {"ab"}, random_source()) {
    are_addresses_validated = false;
  }
  static Settings settings() {
    Settings settings;
    settings.predefined_topics = {{predefined_id, "ntnu-slam/server/r1/run", "r1"}};
    return settings;
  }
  static RandomSource random_source() {
    return [random = std::mt19937_64(3)]() mutable { return static_cast<std::uint16_t>(random()); };
  }
};

/// A robot that behaves like real clients: it answers REGISTER and PUBLISH, and sends only pings of
/// its own accord.
class Listener {
 public:
  Listener(Gateway& gateway, unsigned number) : gateway_(&gateway), number_(number) {}

  void move_to(Gateway& gateway, unsigned number) {
    gateway_ = &gateway;
    number_ = number;
    seen_ = gateway.datagrams.size();
  }
  void connect(bool is_clean) { send(Connect{false, is_clean, protocol_id, 60, "r1"}); }
  void subscribe(Topic topic) {
    Subscribe request;
    request.qos = WireQos::one;
    request.msg_id = 2;
    switch (topic) {
      case Topic::name: request.topic_name = command_topic; break;
      case Topic::predefined:
        request.topic_id_type = TopicIdType::predefined;
        request.topic_id = predefined_id;
        break;
      case Topic::short_name:
        request.topic_id_type = TopicIdType::short_name;
        request.topic_id = 'a' << 8 | 'b';
        break;
    }
    send(request);
  }
  void send(const Packet& packet) {
    gateway_->send(number_, packet);
    answer();
  }
  /// Lets time pass. The robot pings every 3 s if `ping` is given.
  void listen_s(int seconds, const std::optional<Pingreq>& ping) {
    for (int second = 1; second <= seconds; ++second) {
      gateway_->pass_s(1);
      answer();
      if (ping && second % 3 == 0) send(*ping);
    }
  }
  std::vector<std::string> got;

 private:
  void answer() {
    for (; seen_ < gateway_->datagrams.size(); ++seen_) {
      if (gateway_->datagrams[seen_].to != SnRig::address(number_)) continue;
      const Packet packet = *decode(gateway_->datagrams[seen_].bytes);
      if (const auto* p = std::get_if<Register>(&packet))
        gateway_->send(number_, Regack{p->topic_id, p->msg_id, ReturnCode::accepted});
      const auto* publish = std::get_if<Publish>(&packet);
      if (!publish) continue;
      got.emplace_back(as_text(publish->payload));
      gateway_->send(number_, Puback{publish->topic_id, publish->msg_id, ReturnCode::accepted});
    }
  }

  Gateway* gateway_;
  unsigned number_;
  std::size_t seen_ = 0;
};

std::string topic_of(Topic topic) {
  switch (topic) {
    case Topic::name: return command_topic;
    case Topic::predefined: return "ntnu-slam/server/r1/run";
    case Topic::short_name: return "ab";
  }
  return {};
}

/// Returns the payloads that the robot gets within 5 s.
std::vector<std::string> play(const Case& one) {
  Gateway gateway;
  Gateway second;
  const unsigned first_number = one.is_ipv4 ? SnRig::first_ipv4 + 1 : 1;
  Listener robot(gateway, first_number);
  const bool is_clean = one.way == Way::connects || one.way == Way::wakes;
  robot.connect(is_clean);
  robot.subscribe(one.topic);
  const std::string payload(one.payload_octets, 'c');
  const auto ping = one.pings ? std::optional(Pingreq{}) : std::nullopt;
  switch (one.way) {
    case Way::connects: break;
    case Way::kept_session:
      robot.send(Disconnect{});
      robot.move_to(gateway, first_number + 1);
      robot.connect(false);
      break;
    case Way::second_gateway: {
      gateway.pass_s(2);
      robot.move_to(second, first_number + 1);
      second.gateway.ask_where_served([](const std::string&) { return true; });
      robot.connect(false);
      second.note("r1", gateway.notes.at(0).note);
      second.broker(topic_of(one.topic), payload, 1);
      robot.listen_s(5, ping);
      return robot.got;
    }
    case Way::wakes:
      robot.send(Disconnect{60});
      gateway.broker(topic_of(one.topic), payload, 1);
      robot.move_to(gateway, first_number + 1);
      robot.send(Pingreq{"r1"});
      robot.listen_s(5, one.pings ? std::optional(Pingreq{"r1"}) : std::nullopt);
      return robot.got;
  }
  gateway.broker(topic_of(one.topic), payload, 1);
  robot.listen_s(5, ping);
  return robot.got;
}

TEST(Listening, DeliversTheCommandToARobotThatOnlyListens) {
  for (const Topic topic : {Topic::name, Topic::predefined, Topic::short_name}) {
    for (const Way way : {Way::connects, Way::kept_session, Way::second_gateway, Way::wakes}) {
      for (const bool pings : {false, true}) {
        for (const bool is_ipv4 : {false, true}) {
          for (const std::size_t octets : {5U, 60U, 400U, 1000U}) {
            EXPECT_EQ(play({topic, way, pings, is_ipv4, octets}),
                      std::vector<std::string>{std::string(octets, 'c')})
                << "topic " << static_cast<int>(topic) << ", way " << static_cast<int>(way)
                << (pings ? ", pings" : ", silent") << (is_ipv4 ? ", IPv4, " : ", IPv6, ")
                << octets;
          }
        }
      }
    }
  }
}

/// The allowance covers a few repeats. Each ping adds enough for the next one.
TEST(Listening, RepeatsAfterAPingWhenTheAllowanceWasSpent) {
  for (const std::size_t octets : {60U, 200U}) {
    Gateway gateway;
    gateway.send(1, Connect{false, true, protocol_id, 60, "r1"});
    gateway.send(1, Subscribe{false, WireQos::one, TopicIdType::normal, 2, command_topic, 0});
    gateway.broker(command_topic, std::string(octets, 'c'), 1);
    EXPECT_NE(gateway.last_to(1).find("PUBLISH"), std::string::npos);
    gateway.pass_s(18);  // all repeats are lost
    gateway.sent_to(1);
    gateway.send(1, Pingreq{});
    const Packet packet = *decode(gateway.datagrams.back().bytes);
    const auto* probe = std::get_if<Register>(&packet);
    EXPECT_EQ(probe != nullptr, octets == 200) << "a large command needs a probe first";
    if (probe) gateway.send(1, Regack{probe->topic_id, probe->msg_id, ReturnCode::accepted});
    EXPECT_EQ(gateway.last_to(1).substr(0, 13), "PUBLISH dup=1");
  }
}

}  // namespace
}  // namespace slamgw::mqttsn
