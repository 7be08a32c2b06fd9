// SPDX-License-Identifier: Apache-2.0
// Optional actions of Thread robots (sleep, move, change their wills, vanish, publish without a
// session), on a virtual clock, against a scripted gateway.
#include <gtest/gtest.h>

#include "tests/simulation/hex.hpp"
#include "tests/simulation/thread/client_fixture.hpp"

namespace slamgw::sim::sn {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

class LifeTest : public ClientTest {
 protected:
  /// Connects and registers, and acknowledges `adv` and the first update; an update each 100 s.
  void settle(int qos = 1) {
    settings_.period = seconds{100};
    begin(qos, std::nullopt);
    connect_client();
    register_topics();
    pass(milliseconds{0});
    acknowledge_all(take(Type::publish));
  }
  void settle_asleep() {
    settings_.sleep = seconds{50};
    settings_.resumes = true;
    settle();
    take();
    receive("02 18");
  }
};

TEST_F(LifeTest, AsksForSleepWhenEverythingIsAnswered) {
  settings_.sleep = seconds{50};
  settle();
  EXPECT_EQ(to_hex(take().at(0)), "04 18 00 32");
  pass(seconds{8});
  EXPECT_EQ(to_hex(take().at(0)), "04 18 00 32");  // 6.13: repeated until it is answered
  receive("02 18");
  pass(seconds{39});
  EXPECT_TRUE(take().empty());
}

TEST_F(LifeTest, HearsNothingWhileAsleep) {
  settle_asleep();
  receive("0b 0c 20 00 03 00 11 0a 00 ec ff");
  EXPECT_TRUE(take().empty());
  EXPECT_EQ(client_->tally().commands_received, 0U);
}

TEST_F(LifeTest, WakesReceivesBufferedMessagesAndSleepsAgainOnPingresp) {
  settle_asleep();
  pass(seconds{40});  // 4/5 of the duration
  EXPECT_EQ(take().at(0), pingreq("robot1"));
  receive("09 0a 00 05 12 34 61 2f 62");
  EXPECT_EQ(to_hex(take().at(0)), "07 0b 00 05 12 34 00");
  receive("0b 0c 20 00 03 00 11 0a 00 ec ff");
  EXPECT_EQ(to_hex(take().at(0)), "07 0d 00 03 00 11 00");
  receive("02 17");
  EXPECT_TRUE(take().empty());
  receive("0b 0c 20 00 03 00 12 0a 00 ec ff");
  EXPECT_EQ(client_->tally().commands_received, 1U);
  pass(seconds{40});
  EXPECT_EQ(take().at(0), pingreq("robot1"));
  EXPECT_EQ(client_->tally().wakes, 2U);
}

TEST_F(LifeTest, RepeatsPingreqWithinTheToleranceThenSearches) {
  settle_asleep();
  pass(seconds{40 + 23});
  EXPECT_EQ(take(Type::pingreq).size(), 3U);
  pass(seconds{1});
  EXPECT_EQ(take().at(0), searchgw(1));
}

TEST_F(LifeTest, ConnectsToPublishWithoutCleanSessionAndWithoutWill) {
  settle_asleep();
  pass(seconds{40});
  receive("02 17");
  pass(seconds{40});
  receive("02 17");
  take();
  pass(seconds{40});  // the update of second 100 waits
  receive("02 17");
  EXPECT_EQ(to_hex(take().back()), "0c 04 00 01 00 3c 72 6f 62 6f 74 31");
  receive("03 05 00");
  const std::vector<Bytes> sent = take();
  ASSERT_EQ(sent.size(), 1U) << "no registrations: its session continues";
  EXPECT_EQ(ByteView(sent[0])[1], 0x0c);
  acknowledge_all(sent);
  EXPECT_EQ(to_hex(take().at(0)), "04 18 00 32");
  EXPECT_EQ(client_->tally().acknowledged, 2U);
}

TEST_F(LifeTest, SearchesAgainWhenGatewayForgotSleeper) {
  settle_asleep();
  pass(seconds{40});
  take();
  receive("02 18");
  EXPECT_EQ(take().at(0), searchgw(1));
}

TEST_F(LifeTest, ShortSleepsAreRepeatedSooner) {
  settings_.sleep = seconds{2};
  settle();
  take();
  pass(milliseconds{400});
  EXPECT_EQ(to_hex(take().at(0)), "04 18 00 02");
}

TEST_F(LifeTest, DisconnectsFromSleep) {
  settle_asleep();
  client_->on_stop(now_);
  collect();
  EXPECT_EQ(to_hex(take().at(0)), "02 18");
  receive("02 18");
  EXPECT_TRUE(client_->is_finished());
}

TEST_F(LifeTest, ResumesItsSessionOnDisconnectAtNewAddress) {
  settings_.resumes = true;
  begin(1, 1);
  connect_client();
  register_topics();
  pass(milliseconds{0});
  const std::vector<Bytes> publishes = take(Type::publish);
  ASSERT_EQ(publishes.size(), 2U);
  client_->on_moved();
  collect();
  EXPECT_TRUE(take().empty()) << "it sends nothing";
  receive("02 18");  // the answer to unknown clients (section 6.12)
  EXPECT_EQ(to_hex(take().at(0)), "0c 04 00 01 00 3c 72 6f 62 6f 74 31");
  receive("02 18");
  EXPECT_TRUE(take().empty());
  receive("03 05 00");
  EXPECT_EQ(take(), publishes) << "at once, byte-identical";
  acknowledge_all(publishes);
  Tally expected{1, 1, 0, 0};
  expected.roamed = 1;
  EXPECT_EQ(client_->tally(), expected);
}

TEST_F(LifeTest, SearchesAgainWhenItsTopicIdsAreUnknown) {
  settings_.resumes = true;
  begin(1, 1);
  connect_client();
  register_topics();
  const Bytes published = take(Type::publish).at(0);
  receive(puback(get_u16_be(published, 3), get_u16_be(published, 5), invalid_topic_id));
  EXPECT_EQ(take().at(0), searchgw(1));
}

TEST_F(LifeTest, LearnsTheIdsOfItsCommandsFromTheGateway) {
  settings_.resumes = true;
  settle();
  Bytes registration = hex("00 0a 00 63 12 34");
  put(registration, std::string_view("ntnu-slam/server/robot1/cmd"));
  registration[0] = static_cast<std::uint8_t>(registration.size());
  receive(registration);
  receive("0b 0c 20 00 63 00 11 0a 00 ec ff");
  EXPECT_EQ(client_->tally().commands_received, 1U);
}

TEST_F(LifeTest, ChangesItsWillTopicFirstThenItsMessage) {
  settings_.will_interval = seconds{10};
  settle();
  take();
  pass(seconds{10});
  EXPECT_EQ(take().at(0), willtopicupd("ntnu-slam/robot/robot1/will-updated", 1));
  pass(seconds{8});
  EXPECT_EQ(take().at(0), willtopicupd("ntnu-slam/robot/robot1/will-updated", 1));
  receive("03 1d 00");  // the other answer
  EXPECT_TRUE(take().empty());
  receive("03 1b 00");
  EXPECT_EQ(take().at(0), willmsgupd("Disconnected after 1"));
  EXPECT_EQ(client_->tally().will_updates, 0U);
  receive("03 1d 00");
  EXPECT_EQ(client_->tally().will_updates, 1U);
  pass(seconds{10});
  receive("03 1b 00");
  EXPECT_EQ(take(Type::willmsgupd).at(0), willmsgupd("Disconnected after 2"));
}

TEST_F(LifeTest, HasOneChangeOfItsWillOpenAtATime) {
  settings_.will_interval = seconds{5};
  settle();
  take();
  pass(seconds{12});
  EXPECT_EQ(take(Type::willtopicupd).size(), 1U);
  pass(seconds{13});
  EXPECT_EQ(take(Type::willtopicupd).size(), 2U) << "repeats, but no second change";
}

TEST_F(LifeTest, HasOneRequestOutstandingOnRequest) {
  settings_.outstanding = 1;
  settings_.retry_interval = seconds{1};
  begin(1, 3);
  connect_client();
  EXPECT_EQ(take().size(), 1U);
  pass(seconds{1});
  EXPECT_EQ(take().size(), 1U) << "a repeat";
}

TEST_F(LifeTest, RecordsUpdatesAndTheirAcknowledgements) {
  settings_.is_recorded = true;
  begin(1, 2);
  connect_client();
  register_topics();
  pass(milliseconds{200});
  const std::vector<Bytes> publishes = take(Type::publish);
  ASSERT_EQ(publishes.size(), 3U);
  acknowledge_all({publishes[0], publishes[2]});
  RobotBody body(1, 1);
  for (const std::uint64_t number : {1U, 2U}) {
    const auto event = client_->next_event();
    EXPECT_FALSE(event->is_acknowledged());
    EXPECT_EQ(event->number, number);
    EXPECT_EQ(event->payload, body.next_update());
  }
  const auto acknowledged = client_->next_event();
  EXPECT_TRUE(acknowledged->is_acknowledged());
  EXPECT_EQ(acknowledged->number, 2U);
  EXPECT_FALSE(client_->next_event().has_value()) << "the other update was not acknowledged";
}

TEST_F(LifeTest, RecordsCommandsAndTheirRepeats) {
  settings_.is_recorded = true;
  begin(1, 2);
  connect_client();
  register_topics();
  for (int copy = 0; copy < 2; ++copy) receive("0b 0c 20 00 03 00 11 0a 00 ec ff");
  for (int copy = 0; copy < 2; ++copy) {
    const auto event = client_->next_event();
    ASSERT_TRUE(event.has_value());
    EXPECT_EQ(event->kind, UpdateEvent::Kind::command);
    EXPECT_EQ(event->number, 0x11U) << "its message id";
    EXPECT_EQ(event->type, "cmd");
    EXPECT_EQ(to_hex(event->payload), "0a 00 ec ff");
  }
  EXPECT_FALSE(client_->next_event().has_value());
}

TEST_F(LifeTest, VanishesWithoutDisconnect) {
  settings_.vanishes = true;
  settle();
  take();
  client_->on_stop(now_);
  collect();
  EXPECT_TRUE(take().empty());
  EXPECT_TRUE(client_->is_finished());
}

TEST_F(LifeTest, KeepsTheSessionAtTheGatewayWithoutCleanSession) {
  settings_.is_clean = false;
  settings_.keep_alive = seconds{5};
  begin();
  take();
  receive("03 02 01");
  EXPECT_EQ(to_hex(take().at(0)), "0c 04 08 01 00 05 72 6f 62 6f 74 31");
}

TEST_F(LifeTest, PublishesWithoutASessionOnItsPredefinedTopic) {
  settings_.predefined_id = 7;
  begin(-1, 3);
  pass(seconds{1});
  const std::vector<Bytes> sent = take();
  ASSERT_EQ(sent.size(), 3U);
  for (const Bytes& datagram : sent) {
    EXPECT_EQ(to_hex(ByteView(datagram).subspan(1, 6)), "0c 61 00 07 00 00");
  }
  EXPECT_EQ(sent[0], publish_unconnected(7, RobotBody(1, 1).next_update()));
  EXPECT_TRUE(client_->has_sent_everything());
  client_->on_stop(now_);
  EXPECT_TRUE(client_->is_finished());
  EXPECT_EQ(client_->tally(), (Tally{3, 0, 0, 0}));
}

}  // namespace
}  // namespace slamgw::sim::sn
