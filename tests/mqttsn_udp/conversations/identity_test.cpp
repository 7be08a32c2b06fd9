// SPDX-License-Identifier: Apache-2.0
// A DTLS key proves which client speaks. It may speak only as itself, and its session follows it.
// Where an identity is required, clients without the key may not speak for it.
#include <gtest/gtest.h>

#include "adapters/mqttsn_udp/limits.hpp"
#include "tests/mqttsn_udp/sn_rig.hpp"

namespace slamgw::mqttsn {
namespace {

constexpr std::uint16_t topic_of_r2 = 7;

Settings requiring(RequireIdentity required) {
  Settings settings;
  settings.require_identity = required;
  settings.allow_unconnected_publish = true;
  settings.predefined_topics = {{topic_of_r2, "ntnu-slam/robot/r2/adv", {}}};
  return settings;
}

/// Robot r1 has a key, and client 1 has its key. Client 2 is on plain UDP.
struct Rig : SnRig {
  explicit Rig(RequireIdentity required = RequireIdentity::with_key,
               std::vector<RobotName> names = {})
      : SnRig(requiring(required), names) {
    are_addresses_validated = false;
    use_keys({"r1", "tank-client"});
    proven[1] = "r1";
  }
  bool has_notice(const std::string& text) const {
    return std::ranges::any_of(
        notices, [&](const Notice& notice) { return notice.text.find(text) != std::string::npos; });
  }
};

const Connect connect_r1{false, false, protocol_id, 60, "r1"};

TEST(Identity, IsProvenByTheHandshakeAlone) {
  Rig rig;
  rig.send(1, connect_r1);
  EXPECT_EQ(rig.last_to(1), "CONNACK code=0");
  EXPECT_EQ(rig.datagrams.back().identity, "r1");
  EXPECT_TRUE(rig.presence.back().is_proven) << "without an acknowledged message";
  EXPECT_NE(rig.presence.back().address.find("over DTLS"), std::string::npos);
  EXPECT_EQ(rig.counter("clients_unanswered"), 0U);
  rig.subscribe(1, "a/x");
  rig.broker("a/x", std::string(500, 'x'), 1);
  EXPECT_EQ(rig.counter("unvalidated"), 0U) << "the handshake has validated the address";
}

TEST(Identity, MayNotConnectPingOrPublishAsAnotherClient) {
  Rig rig(RequireIdentity::none);
  for (int i = 0; i < 3; ++i) {
    rig.send(1, Connect{false, true, protocol_id, 60, "r2"});
    EXPECT_EQ(rig.last_to(1), "CONNACK code=3");
  }
  EXPECT_EQ(rig.counter("connects_refused"), 3U);
  EXPECT_EQ(rig.notices.size(), 1U) << "one notice for a burst";
  EXPECT_TRUE(rig.has_notice("over DTLS may not connect as 'r2' (CONNACK 0x03): its key belongs"));
  EXPECT_FALSE(rig.gateway.presence_of("r2"));

  rig.connect(2, "r2", false);
  rig.sleep(2);
  rig.send(1, Pingreq{"r2"});
  EXPECT_EQ(rig.last_to(1), "DISCONNECT plain") << "as for an unknown client";
  rig.broker("ntnu-slam/server/r2/cmd");
  EXPECT_TRUE(rig.is_silent(1));

  const auto publish_unconnected = [&](TopicIdType type, std::uint16_t topic) {
    rig.send(1, Publish{false, WireQos::minus_one, false, type, topic, 0, to_bytes("hi")});
  };
  publish_unconnected(TopicIdType::predefined, topic_of_r2);
  EXPECT_TRUE(rig.reports.empty());
  EXPECT_EQ(rig.counter("unconnected_refused"), 1U);
  constexpr std::uint16_t ab = 'a' << 8 | 'b';
  publish_unconnected(TopicIdType::short_name, ab);
  EXPECT_EQ(rig.reports.size(), 1U) << "the topic of no robot is allowed";
}

TEST(Identity, PlainUdpMayNotSpeakForARobotWithAKey) {
  Rig rig;
  for (int i = 0; i < 3; ++i) {
    rig.send(2, connect_r1);
    rig.send(2, Pingreq{"r1"});
  }
  EXPECT_TRUE(rig.is_silent(2)) << "without any answer";
  EXPECT_EQ(rig.counter("identity_missing"), 6U);
  EXPECT_EQ(rig.notices.size(), 1U);
  EXPECT_TRUE(rig.has_notice("[fd00::2]:47193 as 'r1' gets no answer: it must come over DTLS"));
  EXPECT_FALSE(rig.gateway.presence_of("r1"));
  rig.send(2, Connect{false, true, protocol_id, 60, "r2"});
  EXPECT_EQ(rig.last_to(2), "CONNACK code=0") << "r2 has no key";
  rig.send(1, connect_r1);
  EXPECT_EQ(rig.last_to(1), "CONNACK code=0");
  rig.send(2, connect_r1);
  EXPECT_TRUE(rig.is_silent(2));
  EXPECT_EQ(rig.gateway.presence_of("r1"), Presence::online) << "the session was not taken over";
}

TEST(Identity, IsOptionalWhereItIsNotRequired) {
  Rig rig(RequireIdentity::none);
  rig.send(2, connect_r1);
  EXPECT_EQ(rig.last_to(2), "CONNACK code=0");
}

TEST(Identity, IsRequiredOfAllClientsWhenConfigured) {
  Rig rig(RequireIdentity::all);
  rig.broker_link(false);
  rig.broker_link(true);
  EXPECT_TRUE(rig.multicasts.empty()) << "the plain port is closed, so it is not advertised";
  rig.send(2, Connect{false, true, protocol_id, 60, "r2"});
  rig.send(2, SearchGw{1});
  rig.send(2, Disconnect{});
  rig.send(2, Publish{});
  EXPECT_TRUE(rig.is_silent(2));
  EXPECT_EQ(rig.counter("identity_missing"), 4U);
  rig.send(1, connect_r1);
  EXPECT_EQ(rig.last_to(1), "CONNACK code=0");
}

TEST(Identity, IsTheClientIdOfARobotThatIsRenamed) {
  Rig rig;
  rig.rename({{"tank", {}, "tank-client"}});
  rig.proven[3] = "tank-client";
  rig.send(3, Connect{false, true, protocol_id, 60, "tank-client"});
  EXPECT_EQ(rig.last_to(3), "CONNACK code=0");
  EXPECT_EQ(rig.gateway.presence_of("tank"), Presence::online);
  rig.send(2, Connect{false, true, protocol_id, 60, "tank-client"});
  EXPECT_TRUE(rig.is_silent(2));
}

TEST(Identity, MovesItsSessionToAnotherAddress) {
  Rig rig;
  rig.send(1, connect_r1);
  const auto topic = rig.register_topic(1, own_topic);
  rig.subscribe(1, "a/x");
  rig.proven[5] = "r1";
  rig.publish(5, topic, 1, 7, "from elsewhere");
  ASSERT_EQ(rig.reports.size(), 1U) << "without CONNECT and REGISTER";
  EXPECT_EQ(rig.reports.back().robot, "r1");
  rig.receipt(rig.reports.back().receipt.id);
  EXPECT_NE(rig.last_to(5).find("PUBACK"), std::string::npos);
  rig.broker("a/x", "hi", 0);
  EXPECT_FALSE(rig.is_silent(5));
  EXPECT_TRUE(rig.is_silent(1));

  rig.sleep(5, 100);
  rig.broker("a/x", "while asleep", 1);
  rig.proven[6] = "r1";
  rig.send(6, Pingreq{"r1"});
  EXPECT_FALSE(rig.is_silent(6));
}

TEST(Identity, EndsSessionsWhoseKeyIsRemovedOrAdded) {
  Rig rig;
  rig.send(1, connect_r1);
  rig.connect(2, "r2", false);
  rig.subscribe(2, "a/x");
  rig.sent_to(1);
  rig.use_keys({"r2"});
  EXPECT_NE(rig.gateway.presence_of("r1"), Presence::online) << "its key was removed";
  EXPECT_NE(rig.gateway.presence_of("r2"), Presence::online)
      << "it has a key now, and is on plain UDP";
  rig.broker("a/x", "hi", 1);
  EXPECT_TRUE(rig.is_silent(2)) << "no message leaves unencrypted";
  rig.send(1, Pingreq{});
  EXPECT_NE(rig.gateway.presence_of("r1"), Presence::online);
  rig.proven[3] = "r2";
  rig.send(3, Connect{false, false, protocol_id, 60, "r2"});
  rig.pass_s(3);
  EXPECT_EQ(rig.last_to(3), "REGISTER id=1 msg=1 topic=a/x");
  rig.send(3, Regack{1, 1, ReturnCode::accepted});
  EXPECT_TRUE(rig.last_to(3).ends_with("data=6869")) << "its kept session still has the message";
}

TEST(Identity, LeavesNoMessageOfASleeperToPlainUdpWhenItsKeyIsRemoved) {
  Rig rig;
  rig.send(1, Connect{false, false, protocol_id, 60, "r1"});
  rig.sent_to(1);
  rig.subscribe(1, "a/x", 1);
  rig.sleep(1, 100);
  rig.broker("a/x", "a secret", 1);
  rig.use_keys({});
  rig.sent_to(2);
  rig.send(2, Pingreq{"r1"});
  rig.send(2, Connect{false, false, protocol_id, 60, "r1"});
  rig.pass_s(3);
  for (const std::string& packet : rig.sent_to(2)) {
    EXPECT_EQ(packet.find("REGISTER"), std::string::npos) << packet;
    EXPECT_EQ(packet.find("PUBLISH"), std::string::npos) << packet;
  }
}

TEST(Identity, IsRequiredAfterARestart) {
  Rig before;
  before.send(1, connect_r1);
  before.connect(2, "r2", false);
  const auto r1 = before.gateway.snapshot("r1", before.now);
  const auto r2 = before.gateway.snapshot("r2", before.now);
  ASSERT_TRUE(r1 && r1->peer && r2);
  EXPECT_EQ(r1->peer->identity, "r1");
  Rig after;
  after.use_keys({"r1", "r2"});
  EXPECT_TRUE(after.gateway.restore(*r1, after.now));
  EXPECT_TRUE(after.gateway.restore(*r2, after.now));
  EXPECT_EQ(after.gateway.presence_of("r1"), Presence::online);
  EXPECT_NE(after.gateway.presence_of("r2"), Presence::online) << "it connected without its key";
  after.send(2, Pingreq{});
  EXPECT_NE(after.gateway.presence_of("r2"), Presence::online);
  after.send(1, Pingreq{});
  EXPECT_EQ(after.last_to(1), "PINGRESP");
}

TEST(Identity, LimitsMessagesToTheDtlsRecordSize) {
  Rig rig;
  rig.send(1, connect_r1);
  rig.subscribe(1, "a/x");
  constexpr std::size_t most = limits::max_dtls_record_octets - limits::max_dtls_overhead_octets;
  rig.broker("a/x", std::string(most, 'x'));
  EXPECT_EQ(rig.counter("too_large_down"), 1U);
  for (const SendDatagram& datagram : rig.datagrams) EXPECT_LE(datagram.bytes.size(), most);
}

}  // namespace
}  // namespace slamgw::mqttsn
