// SPDX-License-Identifier: Apache-2.0
// The Thread robot's client on a virtual clock, against a scripted gateway.
#include "simulation/thread/client.hpp"

#include <gtest/gtest.h>

#include <map>

#include "tests/simulation/hex.hpp"
#include "tests/simulation/thread/client_fixture.hpp"

namespace slamgw::sim::sn {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

TEST_F(ClientTest, SearchesThenConnectsWithItsWill) {
  begin();
  EXPECT_EQ(to_hex(take().at(0)), "03 01 01");
  receive("03 02 01");
  EXPECT_EQ(to_hex(take().at(0)), "0c 04 0c 01 00 3c 72 6f 62 6f 74 31");
  receive("02 06");
  EXPECT_EQ(take().at(0), willtopic("ntnu-slam/robot/robot1/will", 0));
  receive("02 08");
  EXPECT_EQ(take().at(0), willmsg("Disconnected"));
  receive("03 05 00");
  EXPECT_TRUE(client_->was_connected());
}

TEST_F(ClientTest, RefusesGatewayZeroAndSearchesOn) {
  begin();
  take();
  receive("03 02 00");
  EXPECT_TRUE(take().empty());
  pass(search_time);
  EXPECT_EQ(to_hex(take().at(0)), "03 01 01");
}

TEST_F(ClientTest, SearchesAgainAfterThreeUnansweredConnects) {
  begin();
  take();
  receive("03 02 01");
  pass(milliseconds{23999});
  const std::vector<Bytes> connects = take();
  ASSERT_EQ(connects.size(), 3U);
  EXPECT_EQ(connects[0], connects[1]);
  EXPECT_EQ(connects[1], connects[2]);
  pass(milliseconds{1});
  EXPECT_EQ(to_hex(take().at(0)), "03 01 01");
}

TEST_F(ClientTest, IsStrandedByCongestionAtConnect) {
  begin();
  receive("03 02 01");
  receive("03 05 01");
  EXPECT_TRUE(client_->is_stranded());
  EXPECT_FALSE(client_->deadline().has_value());
}

TEST_F(ClientTest, RegistersAndSubscribesInOneBurstOfFour) {
  begin();
  connect_client();
  std::vector<Bytes> burst = take();
  ASSERT_EQ(burst.size(), 4U);
  EXPECT_EQ(burst[0], register_topic(1, "ntnu-slam/robot/robot1/adv"));
  EXPECT_EQ(burst[1], register_topic(2, "ntnu-slam/robot/robot1/update"));
  EXPECT_EQ(burst[2], register_topic(3, "ntnu-slam/server/robot1/cmd"));
  EXPECT_EQ(burst[3], register_topic(4, "ntnu-slam/server/robot1/run"));
  receive(regack(9, 1, 0));
  EXPECT_EQ(take().at(0), subscribe(1, 5, "ntnu-slam/server/robot1/cmd"));
}

TEST_F(ClientTest, RepeatsAfterEightSecondsTwiceByteIdentical) {
  begin();
  connect_client();
  register_topics();
  const Bytes adv = take(Type::publish).at(0);
  EXPECT_EQ(adv, publish(1, 1, get_u16_be(adv, 5), hex("01 00 0d 12 09 06")));
  pass(milliseconds{7999});
  std::map<Bytes, int> counts;
  for (const Bytes& datagram : take(Type::publish)) ++counts[datagram];
  EXPECT_EQ(counts[adv], 0);
  pass(milliseconds{1});
  for (const Bytes& datagram : take(Type::publish)) ++counts[datagram];
  EXPECT_EQ(counts[adv], 1);
  pass(seconds{15});
  for (const Bytes& datagram : take(Type::publish)) ++counts[datagram];
  EXPECT_EQ(counts[adv], 2);
  pass(seconds{60});
  for (const Bytes& datagram : take(Type::publish)) ++counts[datagram];
  EXPECT_EQ(counts[adv], 2);
  EXPECT_EQ(client_->tally(), (Tally{3, 0, 3, 0}));
  EXPECT_TRUE(client_->has_sent_everything());
}

TEST_F(ClientTest, KeepsFourOutstandingAndPausesWhenItsQueueIsFull) {
  begin(1, 100);
  connect_client();
  register_topics();
  pass(milliseconds{7900});  // 39 updates' time without any PUBACK
  const std::vector<Bytes> first = take(Type::publish);
  EXPECT_EQ(first.size(), 4U);  // adv and three updates; 25 more wait
  std::vector<Bytes> publishes = first;
  std::size_t total = 0;
  while (!client_->has_sent_everything()) {
    ASSERT_LT(total, 200U);
    total += publishes.size();
    acknowledge_all(publishes);
    if (sent_.empty()) pass(milliseconds{200});
    publishes = take(Type::publish);
  }
  EXPECT_EQ(client_->tally(), (Tally{100, 100, 0, 0}));
}

TEST_F(ClientTest, DropsUpdatesBeyondItsFullQueueWithoutLimit) {
  begin(1, std::nullopt);
  connect_client();
  register_topics();
  pass(milliseconds{7900});
  EXPECT_EQ(client_->tally().sent, 3U);
  EXPECT_EQ(client_->tally().lost, 40U - 28U);
}

TEST_F(ClientTest, PublishesAtMostOnceWithoutMessageIdsAtQos0) {
  begin(0, 2);
  connect_client();
  register_topics();
  pass(seconds{1});
  const std::vector<Bytes> publishes = take(Type::publish);
  ASSERT_EQ(publishes.size(), 3U);
  for (const Bytes& datagram : publishes) EXPECT_EQ(get_u16_be(datagram, 5), 0);
  EXPECT_EQ(client_->tally(), (Tally{2, 0, 0, 0}));
  EXPECT_TRUE(client_->has_sent_everything());
}

TEST_F(ClientTest, CompletesQos2OnPubcompOnly) {
  begin(2, 1);
  connect_client();
  register_topics();
  pass(milliseconds{100});
  for (const Bytes& datagram : take(Type::publish)) {
    const std::uint16_t msg_id = get_u16_be(datagram, 5);
    receive(qos2_step(Type::pubrec, msg_id));
    EXPECT_EQ(take().at(0), qos2_step(Type::pubrel, msg_id));
    EXPECT_FALSE(client_->has_sent_everything());
    pass(retransmission_interval);
    EXPECT_EQ(take(Type::pubrel).at(0), qos2_step(Type::pubrel, msg_id));
    receive(qos2_step(Type::pubcomp, msg_id));
  }
  EXPECT_EQ(client_->tally().sent, 1U);
}

TEST_F(ClientTest, DropsMessageRejectedForCongestion) {
  begin(1, 1);
  connect_client();
  register_topics();
  pass(milliseconds{100});
  const std::vector<Bytes> publishes = take(Type::publish);
  ASSERT_EQ(publishes.size(), 2U);
  for (const Bytes& p : publishes) receive(puback(get_u16_be(p, 3), get_u16_be(p, 5), congestion));
  EXPECT_EQ(client_->tally(), (Tally{1, 0, 1, 0}));
  pass(seconds{30});
  EXPECT_TRUE(take(Type::publish).empty());
}

TEST_F(ClientTest, AnswersCommandsWithPubackAndRecognizesTheirRegack) {
  begin();
  connect_client();
  register_topics();
  take();
  receive("0b 0c 20 00 03 00 11 0a 00 ec ff");
  EXPECT_EQ(to_hex(take().at(0)), "07 0d 00 03 00 11 00");
  receive("08 0c 00 00 04 00 00 31");
  EXPECT_TRUE(take().empty());
  receive("08 0c 20 00 63 00 12 31");  // an id without a REGACK
  EXPECT_EQ(to_hex(take().at(0)), "07 0d 00 63 00 12 00");
  EXPECT_EQ(client_->tally().commands_received, 2U);
  receive("09 0a 00 05 12 34 61 2f 62");
  EXPECT_EQ(to_hex(take().at(0)), "07 0b 00 05 12 34 00");
}

TEST_F(ClientTest, HearsTheUpdatesOfOthersAndNotItsOwn) {
  settings_.hears = true;
  begin();
  connect_client();
  register_topics();
  Bytes registered = register_topic(70, "ntnu-slam/robot/robot7/update");
  registered[3] = 9;  // the topic id, which the gateway gives
  receive(registered);
  take();
  receive(publish(1, 9, 71, hex("0a00ecff")));
  EXPECT_EQ(take(Type::puback).size(), 1U);
  receive(publish(1, 2, 72, hex("0a00ecff")));  // its own
  receive(publish(0, 8, 0, hex("0a00ecff")));   // an unknown topic id
  EXPECT_EQ(client_->tally().heard, (std::map<std::string, std::uint64_t>{{"robot7", 1}}));
}

TEST_F(ClientTest, PingsWithItsIdSixtySecondsAfterConnack) {
  begin(0, 1);
  connect_client();
  register_topics();
  take();
  pass(milliseconds{59999});
  EXPECT_TRUE(take(Type::pingreq).empty());
  pass(milliseconds{1});
  EXPECT_EQ(take().at(0), pingreq("robot1"));
  receive("02 17");
  pass(seconds{60});
  EXPECT_EQ(take(Type::pingreq).size(), 1U);
  pass(seconds{24});  // two repeats, 8 s apart, then it searches again
  const std::vector<Bytes> rest = take();
  ASSERT_EQ(rest.size(), 3U);
  EXPECT_EQ(to_hex(rest[2]), "03 01 01");
}

TEST_F(ClientTest, IgnoresUnexpectedDisconnectAndEndsWithOne) {
  begin(0, std::nullopt);
  connect_client();
  register_topics();
  take();
  receive("02 18");
  EXPECT_FALSE(client_->is_finished());
  client_->on_stop(now_);
  collect();
  EXPECT_EQ(to_hex(take().at(0)), "02 18");
  EXPECT_FALSE(client_->is_finished());
  receive("02 18");
  EXPECT_TRUE(client_->is_finished());
}

TEST_F(ClientTest, EndsWithoutAnswerToItsDisconnect) {
  begin();
  connect_client();
  client_->on_stop(now_);
  pass(goodbye_time);
  EXPECT_TRUE(client_->is_finished());
}

TEST_F(ClientTest, TriesTimedOutRegistrationsAgain) {
  begin();
  connect_client();
  take();
  pass(seconds{24});
  const std::vector<Bytes> all = take(Type::register_topic);
  EXPECT_EQ(all.size(), 12U - 2U);  // 4 x 2 repeats, then subscriptions and 2 new registrations
}

}  // namespace
}  // namespace slamgw::sim::sn
