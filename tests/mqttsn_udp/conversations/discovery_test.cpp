// SPDX-License-Identifier: Apache-2.0
// Discovery (R11-R22). R16, R17, R19 and R22 are the shell's: mqttsn_adapter_test.cpp.
#include <gtest/gtest.h>

#include "adapters/mqttsn_udp/limits.hpp"
#include "tests/mqttsn_udp/sn_rig.hpp"

namespace slamgw::mqttsn {
namespace {

TEST(SnGateway, R11_AdvertisesOnceReadyAndThenEveryInterval) {
  SnRig rig;
  rig.broker_link(false);
  rig.broker_link(true);
  EXPECT_EQ(rig.multicasts, Lines{"ADVERTISE gw=1 duration=900"});
  rig.pass_s(899);
  EXPECT_EQ(rig.multicasts.size(), 1U);
  rig.pass_s(1);
  EXPECT_EQ(rig.multicasts.size(), 2U);
  rig.pass_s(2700);
  EXPECT_EQ(rig.multicasts.size(), 5U);
}

TEST(SnGateway, R12_DoesNotAdvertiseWithoutABroker) {
  SnRig rig;
  rig.broker_link(false);
  rig.pass_s(3600);
  EXPECT_TRUE(rig.multicasts.empty());
  rig.broker_link(true);
  EXPECT_EQ(rig.multicasts.size(), 1U);
}

TEST(SnGateway, R13_UsesTheConfiguredGatewayId) {
  Settings settings;
  settings.gateway_id = 255;
  SnRig rig(settings);
  rig.send(1, SearchGw{1});
  EXPECT_EQ(rig.last_to(1), "GWINFO gw=255 address=");
}

TEST(SnGateway, R14_AnswersSearchgwWithThreeOctets) {
  SnRig rig;
  rig.send_octets(1, hex("03 01 00"));
  EXPECT_EQ(to_hex(rig.datagrams.back().bytes), "030201");
  rig.sent_to(1);
  rig.send_octets(1, hex("02 01"));
  rig.send_octets(1, hex("04 01 00 00"));
  EXPECT_TRUE(rig.is_silent(1));
}

TEST(SnGateway, R15_AnswersSearchgwToItsSource) {
  SnRig rig;
  rig.send(7, SearchGw{1});
  EXPECT_EQ(rig.datagrams.back().to, SnRig::address(7));
  EXPECT_TRUE(rig.multicasts.empty());
}

TEST(SnGateway, R17_AnswersFromTheAddressThatWasAsked) {
  SnRig rig;
  rig.send(1, SearchGw{1});
  EXPECT_EQ(rig.datagrams.back().from, SnRig::local());
  rig.send(1, Connect{false, true, 1, 60, "r1"});
  EXPECT_EQ(rig.datagrams.back().from, SnRig::local());
}

TEST(SnGateway, R18_TakesAnyRadius) {
  SnRig rig;
  for (const unsigned radius : {0U, 1U, 3U, 255U}) {
    rig.send(1, SearchGw{static_cast<std::uint8_t>(radius)});
    EXPECT_EQ(rig.last_to(1), "GWINFO gw=1 address=");
  }
}

TEST(SnGateway, R20_IgnoresSearchesWhileItCannotServeClients) {
  Settings settings;
  settings.max_clients = 1;
  SnRig rig(settings);
  rig.broker_link(false);
  rig.send(1, SearchGw{1});
  EXPECT_TRUE(rig.is_silent(1));
  rig.broker_link(true);
  rig.connect(2, "r2");
  rig.send(1, SearchGw{1});
  EXPECT_TRUE(rig.is_silent(1)) << "all places are taken";
  rig.send(2, Disconnect{});
  rig.send(1, SearchGw{1});
  EXPECT_EQ(rig.last_to(1), "GWINFO gw=1 address=");
}

TEST(SnGateway, R21_LimitsAnswersPerSource) {
  SnRig rig;
  for (int i = 0; i < 500; ++i) rig.send(1, SearchGw{1});
  EXPECT_EQ(rig.sent_to(1).size(), limits::stranger_burst);
  EXPECT_EQ(rig.counter("unanswered"), 500U - limits::stranger_burst);
  rig.send(2, SearchGw{1});
  EXPECT_EQ(rig.sent_to(2).size(), 1U) << "other sources are not limited";
  rig.pass_s(1);
  rig.send(1, SearchGw{1});
  EXPECT_EQ(rig.sent_to(1).size(), 1U);
}

}  // namespace
}  // namespace slamgw::mqttsn
