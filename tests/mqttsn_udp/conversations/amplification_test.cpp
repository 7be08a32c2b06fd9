// SPDX-License-Identifier: Apache-2.0
// A forged source address gets less than three times the octets that the attacker sends, IP and
// UDP headers included. Clients that answer get all of their messages.
#include <gtest/gtest.h>

#include <map>
#include <random>

#include "adapters/mqttsn_udp/clients/session_snapshot.hpp"
#include "adapters/mqttsn_udp/limits.hpp"
#include "tests/mqttsn_udp/sn_rig.hpp"

namespace slamgw::mqttsn {
namespace {

const std::string all_robots = "ntnu-slam/robot/#";

RandomSource random_source(std::uint64_t seed) {
  return
      [random = std::mt19937_64(seed)]() mutable { return static_cast<std::uint16_t>(random()); };
}

/// Returns the size of a datagram with its IP and UDP headers.
std::size_t octets_on_the_wire(const Endpoint& endpoint, const Bytes& message) {
  return message.size() + (is_ipv4(endpoint.address) ? 28 : 48);
}

/// A gateway that trusts no address, and the octets in each direction between it and one address.
struct Victim {
  SnRig rig;
  unsigned number = 1;  // of the victim's address
  std::size_t in = 0;

  explicit Victim(const Settings& settings = {})
      : rig(settings, {}, {"w/#", "a/#", "ab"}, {"w/#", "a/#", "ab"}, random_source(7)) {
    rig.are_addresses_validated = false;
  }
  void send(const Packet& packet) { send_octets(encode(packet)); }
  void send_octets(const Bytes& octets) {
    in += octets_on_the_wire(SnRig::address(number), octets);
    rig.send_octets(number, octets);
  }
  void subscribe(const std::string& filter, WireQos qos = WireQos::zero) {
    send(Subscribe{false, qos, TopicIdType::normal, 7, filter, 0});
  }
  std::size_t out() const {
    std::size_t octets = 0;
    for (const SendDatagram& datagram : rig.datagrams) {
      if (datagram.to == SnRig::address(number))
        octets += octets_on_the_wire(datagram.to, datagram.bytes);
    }
    return octets;
  }
  std::size_t datagrams() const { return rig.datagrams.size(); }
};

std::uint16_t short_id(const char* name) {
  return static_cast<std::uint16_t>(name[0] << 8 | name[1]);
}

/// Answers every request to a client, as the specification demands. Collects the payloads in `got`.
void answer_all(SnRig& rig, std::size_t& seen, std::vector<std::string>& got) {
  for (; seen < rig.datagrams.size(); ++seen) {
    const Packet packet = *decode(rig.datagrams[seen].bytes);
    if (const auto* p = std::get_if<Register>(&packet))
      rig.send(1, Regack{p->topic_id, p->msg_id, ReturnCode::accepted});
    const auto* publish = std::get_if<Publish>(&packet);
    if (!publish) continue;
    got.emplace_back(as_text(publish->payload));
    if (publish->qos == WireQos::one)
      rig.send(1, Puback{publish->topic_id, publish->msg_id, ReturnCode::accepted});
  }
}

TEST(Amplification, AsksForTheWillOnceForEachConnect) {
  Victim victim;
  victim.send(Connect{true, true, 1, 60, "x"});
  victim.rig.pass_s(600);
  EXPECT_EQ(victim.datagrams(), 1U) << "WILLTOPICREQ is not repeated";
  victim.send(Connect{true, true, 1, 60, "x"});
  EXPECT_EQ(victim.datagrams(), 2U) << "a repeated CONNECT is answered again";
}

TEST(Amplification, FloodGuardLimitsAnswersToRefusedConnects) {
  Victim victim;
  for (int i = 0; i < 1000; ++i) victim.send(Connect{false, true, 1, 60, "no/level"});
  EXPECT_EQ(victim.datagrams(), limits::stranger_burst);
  EXPECT_EQ(victim.rig.counter("unanswered"), 1000U - limits::stranger_burst);
}

TEST(Amplification, EndsAStreamToAnAddressThatNeverAnswers) {
  for (const WireQos qos : {WireQos::zero, WireQos::one}) {
    Victim victim;
    victim.send(Connect{false, true, 1, 0xffff, "client-1"});
    victim.subscribe(all_robots, qos);
    for (int i = 0; i < 3000; ++i) {
      victim.rig.broker("ntnu-slam/robot/r" + std::to_string(i % 20) + "/update",
                        "00112233445566778899", 1);
      victim.rig.pass(std::chrono::milliseconds(200));
    }
    EXPECT_LT(victim.out(), 3 * victim.in);
    EXPECT_LE(victim.rig.gateway.queued_for("client-1"), limits::max_queued_unvalidated);
  }
}

TEST(Amplification, DeliversEverythingToAListenerThatAnswers) {
  for (const WireQos qos : {WireQos::zero, WireQos::one}) {
    for (const char* id : {"r", "mqtt-sn-tools-12345"}) {
      Victim client;
      client.send(Connect{false, true, 1, 60, id});
      client.subscribe(all_robots, qos);
      std::size_t seen = 0;
      std::vector<std::string> got;
      for (int i = 0; i < 50; ++i) {
        client.rig.broker("ntnu-slam/robot/ble-0100/a-rather-long-type-of-message",
                          std::to_string(i), 1);
        answer_all(client.rig, seen, got);
      }
      EXPECT_EQ(got.size(), 50U) << id;
    }
  }
}

TEST(Amplification, SendsALongMessageOnlyAfterAProbe) {
  Victim client;
  client.send(Connect{false, true, 1, 60, "r1"});
  client.subscribe("ntnu-slam/server/r1/map", WireQos::zero);
  const std::string map(900, 'm');
  client.rig.broker("ntnu-slam/server/r1/map", map, 1);
  EXPECT_EQ(client.rig.last_to(1).substr(0, 8), "REGISTER") << "REGISTER is the probe";
  EXPECT_LT(client.out(), 3 * client.in);
  std::size_t seen = 0;
  std::vector<std::string> got;
  answer_all(client.rig, seen, got);
  EXPECT_EQ(got, std::vector<std::string>{map});
  ASSERT_EQ(client.rig.outcomes.size(), 1U);
  EXPECT_EQ(client.rig.outcomes[0].result, CommandResult::sent);
}

TEST(Amplification, RejectsGuessedAcknowledgementsAsProof) {
  Victim victim;
  victim.send(Connect{false, true, 1, 0xffff, "client-1"});
  victim.subscribe(all_robots);
  for (std::uint16_t guess = 1; guess <= 200; ++guess) {
    victim.rig.broker("ntnu-slam/robot/r1/update", "0011", 1);
    victim.send(Regack{1, guess, ReturnCode::accepted});
    victim.send(Puback{1, guess, ReturnCode::accepted});
  }
  for (int i = 0; i < 2000; ++i) victim.rig.broker("ntnu-slam/robot/r1/update", "0011", 1);
  EXPECT_LT(victim.out(), 3 * victim.in);
}

/// The ids in a REGISTER or PUBLISH of the gateway; 0 in other packets.
struct Request {
  std::uint16_t topic_id = 0;
  std::uint16_t msg_id = 0;
};
Request last_request(const SnRig& rig) {
  const Packet packet = *decode(rig.datagrams.back().bytes);
  if (const auto* sent = std::get_if<Register>(&packet)) return {sent->topic_id, sent->msg_id};
  if (const auto* sent = std::get_if<Publish>(&packet)) return {sent->topic_id, sent->msg_id};
  return {};
}

bool is_proven(Victim& victim) {
  return victim.rig.gateway.snapshot("client-1", victim.rig.now)->is_validated;
}

/// A blind sender knows everything but the MsgId. A new CONNECT does not begin the count again.
TEST(Amplification, RejectsAllMsgIdsInTurnAsProof) {
  constexpr std::uint16_t again_after = 100;
  for (const unsigned qos : {0U, 1U, 2U}) {
    Victim victim;
    Request open;
    const auto begin = [&] {
      victim.send(Connect{false, true, 1, 0xffff, "client-1"});
      victim.send(Subscribe{
          false, static_cast<WireQos>(qos), TopicIdType::short_name, 7, {}, short_id("ab")});
      if (qos == 0) victim.subscribe(all_robots);
      victim.rig.broker(qos == 0 ? "ntnu-slam/robot/r1/update" : "ab", "0011", qos);
      open = last_request(victim.rig);
    };
    begin();
    for (std::uint16_t guess = 1; guess <= highest_msg_id; ++guess) {
      if (guess == again_after) begin();
      if (qos == 0) victim.send(Regack{open.topic_id, guess, ReturnCode::accepted});
      if (qos == 1) victim.send(Puback{open.topic_id, guess, ReturnCode::accepted});
      if (qos == 2) victim.send(Pubrec{guess});
    }
    EXPECT_GT(open.msg_id, again_after) << "the gateway awaits an answer that will be guessed";
    EXPECT_FALSE(is_proven(victim)) << "QoS " << qos;
    EXPECT_EQ(victim.rig.counter("clients_unanswered"), 1U);
  }
}

TEST(Amplification, RejectsARegackWithAnotherTopicIdAsProof) {
  Victim victim;
  victim.send(Connect{false, true, 1, 0xffff, "client-1"});
  victim.subscribe(all_robots);
  victim.rig.broker("ntnu-slam/robot/r1/update", "0011", 1);
  const Request open = last_request(victim.rig);
  const auto other_id = static_cast<std::uint16_t>(open.topic_id + 1);
  victim.send(Regack{other_id, open.msg_id, ReturnCode::accepted});
  EXPECT_FALSE(is_proven(victim));
}

TEST(Amplification, AcceptsARefusalWithoutTopicIdAsProof) {
  Victim client;
  client.send(Connect{false, true, 1, 0xffff, "client-1"});
  client.subscribe(all_robots);
  client.rig.broker("ntnu-slam/robot/r1/update", "0011", 1);
  client.send(Regack{0, last_request(client.rig).msg_id, ReturnCode::not_supported});
  EXPECT_TRUE(is_proven(client));
}

/// Late acknowledgements, as of requests that were given up.
TEST(Amplification, AcceptsAProofAfterWrongAnswersAndLaterAfterTooMany) {
  for (const unsigned wrong : {limits::max_wrong_answers - 1, limits::max_wrong_answers}) {
    Victim client;
    client.send(Connect{false, true, 1, 0xffff, "client-1"});
    client.subscribe(all_robots);
    for (unsigned i = 0; i < wrong; ++i) client.send(Puback{1, 5, ReturnCode::accepted});
    for (unsigned i = 0; i < 100; ++i) client.send(Puback{1, 0, ReturnCode::invalid_topic_id});
    std::size_t seen = 0;
    std::vector<std::string> got;
    client.rig.broker("ntnu-slam/robot/r1/update", "1", 1);
    answer_all(client.rig, seen, got);
    EXPECT_EQ(is_proven(client), wrong < limits::max_wrong_answers);
    client.rig.pass(limits::wrong_answer_memory);
    client.send(Connect{false, true, 1, 0xffff, "client-1"});
    client.subscribe(all_robots);
    client.rig.broker("ntnu-slam/robot/r2/update", "2", 1);
    answer_all(client.rig, seen, got);
    EXPECT_TRUE(is_proven(client)) << "wrong answers are forgotten";
    EXPECT_EQ(got.back(), "2");
  }
}

TEST(Amplification, RejectsMsgIdsGuessedFromAnotherAddressAsProof) {
  Victim attack;
  SnRig& rig = attack.rig;
  const auto own = [&](const Packet& packet) { rig.send(2, packet); };  // the attacker's address
  own(Connect{false, false, 1, 0xffff, "client-1"});
  own(Subscribe{false, WireQos::one, TopicIdType::normal, 7, all_robots, 0});
  rig.broker("ntnu-slam/robot/r1/update", "0011", 1);
  for (std::size_t i = 0; i < rig.datagrams.size(); ++i) {  // the probe's and the topic's REGISTER
    if (const Packet sent = *decode(rig.datagrams[i].bytes); std::holds_alternative<Register>(sent))
      own(Regack{1, std::get<Register>(sent).msg_id, ReturnCode::accepted});
  }
  const auto open = std::get<Publish>(*decode(rig.datagrams.back().bytes));
  rig.datagrams.clear();
  attack.send(Connect{false, false, 1, 0xffff, "client-1"});
  for (int i = 0; i < 500; ++i) {
    rig.broker("ntnu-slam/robot/r" + std::to_string(i) + "/update", "0011", 1);
    for (int j = 0; j < 4; ++j) {
      const auto guess = static_cast<std::uint16_t>(open.msg_id + j);
      attack.send(Puback{1, guess, ReturnCode::accepted});
      attack.send(Regack{1, guess, ReturnCode::accepted});
    }
  }
  for (int i = 0; i < 1000; ++i) rig.broker("ntnu-slam/robot/r1/update", std::string(200, 'x'), 1);
  EXPECT_LT(attack.out(), 3 * attack.in);
}

/// Returns a random packet of an attacker who knows the protocol, the topics and small MsgIds.
Packet random_packet(std::mt19937_64& random) {
  const auto below = [&](unsigned n) { return static_cast<std::uint16_t>(random() % n); };
  const auto id = "c" + std::to_string(below(3));
  const auto qos = static_cast<WireQos>(below(4));
  const auto type = static_cast<TopicIdType>(below(4));
  const std::vector<std::string> filters = {all_robots, "ab", "a/#", "ntnu-slam/server/c0/+",
                                            "a/x"};
  const std::string filter = filters[below(5)];
  switch (below(16)) {
    case 0: return Connect{false, below(2) == 0, 1, 600, id};
    case 1: return Connect{true, below(2) == 0, 1, 600, id};
    case 2: return Connect{false, true, 2, 600, id};
    case 3: return WillTopic{WireQos::one, false, below(2) == 0 ? "" : "ntnu-slam/robot/c0/will"};
    case 4: return WillMsg{Bytes(below(3))};
    case 5:
    case 6:
    case 7: return Subscribe{false, qos, type, below(9), filter, below(3)};
    case 8: return Regack{below(5), below(9), static_cast<ReturnCode>(below(4))};
    case 9: return Puback{below(5), below(9), static_cast<ReturnCode>(below(4))};
    case 10: return Pubrec{below(9)};
    case 11: return Pingreq{below(2) == 0 ? "" : id};
    case 12: return Disconnect{below(2) == 0 ? std::optional<std::uint16_t>(60) : std::nullopt};
    case 13:
      return Register{0, below(9), "ntnu-slam/robot/" + id + "/t" + std::to_string(below(9))};
    case 14: return Publish{false, qos, false, type, below(5), below(9), Bytes(below(4))};
    default: return below(2) == 0 ? Packet{WillTopicUpd{}} : Packet{SearchGw{}};
  }
}

/// Returns one datagram of the walk: sometimes of a session that subscribes, else a random one.
Bytes forged(std::mt19937_64& random, int step) {
  if (step % 12 == 0) return encode(Connect{false, true, 1, 600, step % 24 == 0 ? "c0" : "c1"});
  if (step % 12 == 1) {
    const auto qos = static_cast<WireQos>(random() % 3);
    return encode(Subscribe{false, qos, TopicIdType::short_name, 1, {}, short_id("ab")});
  }
  const Bytes octets = encode(random_packet(random));
  return random() % 8 == 0 ? encode_encapsulation(0, "node", octets) : octets;
}

void publish_something(SnRig& rig, std::mt19937_64& random) {
  const std::string robot = "c" + std::to_string(random() % 3);
  const std::vector<std::string> topics = {"ntnu-slam/robot/" + robot + "/update", "ab", "a/x",
                                           "ntnu-slam/server/" + robot + "/cmd"};
  rig.broker(topics[random() % 4], std::string(random() % 200, 'x'),
             static_cast<unsigned>(random() % 3), random() % 4 == 0);
}

/// The attacker forges datagrams of two victims, so sessions move between them as well.
TEST(Amplification, SendsLessThanThreeTimesTheOctetsOfARandomSequence) {
  std::size_t published = 0;
  Settings settings;
  settings.forwarders = true;
  for (std::uint64_t seed = 1; seed <= 100; ++seed) {
    std::mt19937_64 random(seed);
    Victim victim(settings);
    std::map<unsigned, std::size_t> spent;
    const auto check = [&] {
      for (const auto& [number, octets] : spent) {
        victim.number = number;
        ASSERT_LT(victim.out(), 3 * octets) << "seed " << seed << ", address " << number;
      }
    };
    for (int step = 0; step < 120; ++step) {
      victim.number = step / 2 % 2 == 0 ? 1 : SnRig::first_ipv4;
      victim.in = 0;
      victim.send_octets(forged(random, step));
      spent[victim.number] += victim.in;
      while (random() % 3 == 0) publish_something(victim.rig, random);
      if (random() % 4 == 0) victim.rig.pass_s(static_cast<int>(random() % 30));
      for (const Report& report : victim.rig.reports) {
        if (report.receipt.is_owed() && random() % 2 == 0) victim.rig.receipt(report.receipt.id);
      }
      victim.rig.reports.clear();
      ASSERT_NO_FATAL_FAILURE(check());
    }
    victim.rig.pass_s(4000);
    ASSERT_NO_FATAL_FAILURE(check());
    for (const SendDatagram& sent : victim.rig.datagrams) {
      const ByteView bytes = sent.bytes;
      const auto outer = decode_encapsulation(bytes);
      const auto packet = decode(is_encapsulated(bytes) ? outer->inner : bytes);
      published += packet && std::holds_alternative<Publish>(*packet) ? 1 : 0;
    }
  }
  EXPECT_GT(published, 1000U) << "the sequences cause enough messages";
}

/// A PINGREQ can be forged as easily as the CONNECT with the same client id.
TEST(Amplification, RejectsPingsWithTheClientIdAsProof) {
  for (const WireQos qos : {WireQos::zero, WireQos::one}) {
    Victim victim;
    victim.send(Connect{false, true, 1, 0xffff, "client-1"});
    victim.subscribe(all_robots, qos);
    for (int i = 0; i < 300; ++i) {
      victim.send(Pingreq{"client-1"});
      for (int j = 0; j < 5; ++j)
        victim.rig.broker("ntnu-slam/robot/r1/update", std::string(100, 'x'), 1);
      victim.rig.pass_s(1);
      ASSERT_LT(victim.out(), 3 * victim.in);
    }
    EXPECT_FALSE(victim.rig.gateway.snapshot("client-1", victim.rig.now)->is_validated);
  }
}

/// Many clients that use only predefined ids behave like this.
TEST(Amplification, SendsMoreQos0ToAListenerThatPingsByName) {
  for (const bool pings_by_name : {true, false}) {
    Victim client;
    client.send(Connect{false, true, 1, 60, "r1"});
    client.send(Subscribe{false, WireQos::zero, TopicIdType::short_name, 7, {}, short_id("ab")});
    for (int i = 0; i < 20; ++i) client.rig.broker("ab", "0123456789", 1);
    const auto count = [&] {
      return std::ranges::count_if(client.rig.datagrams, [](const SendDatagram& sent) {
        return std::holds_alternative<Publish>(*decode(sent.bytes));
      });
    };
    client.rig.pass_s(3);
    const auto before = count();
    for (int i = 0; i < 5; ++i) {
      client.send(Pingreq{pings_by_name ? "r1" : ""});
      client.rig.pass_s(1);
    }
    EXPECT_EQ(count() > before, pings_by_name);
  }
}

TEST(Amplification, NeedsNoNewProofOfARestoredSession) {
  Victim client;
  client.send(Connect{false, false, 1, 60, "r1"});
  client.subscribe(all_robots, WireQos::one);
  std::size_t seen = 0;
  std::vector<std::string> got;
  EXPECT_FALSE(client.rig.gateway.snapshot("r1", client.rig.now)->is_validated);
  client.rig.broker("ntnu-slam/robot/r2/adv", "1", 1);
  answer_all(client.rig, seen, got);
  const auto snapshot = client.rig.gateway.snapshot("r1", client.rig.now);
  EXPECT_TRUE(snapshot->is_validated);
  Victim after;
  ASSERT_TRUE(after.rig.gateway.restore(*snapshot, after.rig.now));
  after.rig.broker("ntnu-slam/robot/r2/adv", "2", 1);
  ASSERT_EQ(after.datagrams(), 1U);
  EXPECT_TRUE(std::holds_alternative<Publish>(*decode(after.rig.datagrams[0].bytes)));
}

TEST(Amplification, KeepsTheSendAllowanceOverARestart) {
  Victim client;
  client.send(Connect{false, true, 1, 60, "r1"});
  client.subscribe("ntnu-slam/server/r1/cmd");
  const auto snapshot = client.rig.gateway.snapshot("r1", client.rig.now);
  Victim after;
  ASSERT_TRUE(after.rig.gateway.restore(*decode_session(encode_session(*snapshot)), after.rig.now));
  for (int i = 0; i < 20; ++i) after.rig.broker("ntnu-slam/server/r1/cmd", "0011", 1);
  EXPECT_GE(after.datagrams(), 1U);
  EXPECT_LT(client.out() + after.out(), 3 * client.in);
}

}  // namespace
}  // namespace slamgw::mqttsn
