// SPDX-License-Identifier: Apache-2.0
// Clients that leave a REGISTER, a PUBLISH or a PUBREL unanswered, as RIOT's emcute and Zephyr's
// client do when their topic tables are full. All other messages are still delivered.
#include <gtest/gtest.h>

#include <random>
#include <utility>

#include "adapters/mqttsn_udp/limits.hpp"
#include "tests/mqttsn_udp/sn_rig.hpp"

namespace slamgw::mqttsn {
namespace {

using std::chrono::seconds;

const std::string others = "ntnu-slam/robot/+/update";

/// A client that subscribes to its commands by name and to all updates. It answers no REGISTER.
struct NoRegackRig : SnRig {
  explicit NoRegackRig(bool clean = true) {
    connect(1, "r1", clean, 6000);
    subscribe(1, r1_command, 1);
    subscribe(1, others, 1);
  }
  /// Sends one more command. Returns true if it is published at once.
  bool command_arrives() {
    sent_to(1);
    broker(r1_command, "go", 1);
    for (const std::string& line : sent_to(1)) {
      if (!line.starts_with("PUBLISH")) continue;
      const auto publish = std::get<Publish>(*decode(datagrams.back().bytes));
      send(1, Puback{publish.topic_id, publish.msg_id, ReturnCode::accepted});
      return true;
    }
    return false;
  }
};

TEST(SnGateway, SendsCommandsWhileARegisterStaysUnanswered) {
  for (const bool clean : {true, false}) {
    NoRegackRig rig(clean);
    for (int i = 0; i < 20; ++i) {
      rig.broker("ntnu-slam/robot/x" + std::to_string(i % 4) + "/update", "u", i % 2);
      EXPECT_TRUE(rig.command_arrives()) << i;
      rig.pass_s(7);
    }
    ASSERT_EQ(rig.outcomes.size(), 20U);
    for (const CommandOutcome& outcome : rig.outcomes)
      EXPECT_EQ(outcome.result, CommandResult::delivered);
  }
}

TEST(SnGateway, PausesAnUnansweredTopicEverLongerAndReportsItOnce) {
  NoRegackRig rig(false);
  std::vector<Duration> pauses;
  std::optional<TimePoint> last;
  for (int i = 0; i < 12 * 360; ++i) {
    rig.broker("ntnu-slam/robot/x/update", "u", 1);
    rig.send(1, Pingreq{});
    rig.pass_s(10);
    for (const std::string& line : rig.sent_to(1)) {
      if (!line.starts_with("REGISTER")) continue;
      if (last) pauses.push_back(rig.now - *last);
      last = rig.now;
    }
  }
  std::erase_if(pauses, [](Duration pause) { return pause <= seconds(30); });  // repetitions
  ASSERT_GE(pauses.size(), 8U);
  for (std::size_t i = 1; i < pauses.size(); ++i) EXPECT_GE(pauses[i], pauses[i - 1]);
  EXPECT_GE(pauses.back(), limits::longest_set_aside);
  EXPECT_LE(pauses.back(), limits::longest_set_aside + seconds(60));
  ASSERT_EQ(rig.notices.size(), 1U);
  EXPECT_NE(rig.notices[0].text.find("ntnu-slam/robot/x/update"), std::string::npos);
  EXPECT_GE(rig.counter("topics_set_aside"), 8U);
}

TEST(SnGateway, BoundsTheNumberOfPausedTopicsOfAClient) {
  NoRegackRig rig;
  const auto topic = [](std::size_t i) {
    return "ntnu-slam/robot/x" + std::to_string(i) + "/update";
  };
  const auto leave_unanswered = [&](std::size_t i) {
    rig.broker(topic(i), "u", 1);
    for (int part = 0; part < 5; ++part) {
      rig.pass_s(9);
      rig.send(1, Pingreq{});
    }
  };
  for (std::size_t i = 0; i <= limits::max_set_aside; ++i) leave_unanswered(i);
  leave_unanswered(0);
  rig.pass(limits::first_set_aside);
  rig.sent_to(1);
  rig.broker(topic(0), "u", 1);
  const Lines lines = rig.sent_to(1);
  ASSERT_FALSE(lines.empty()) << "its entry was dropped, so its pause is the shortest";
  EXPECT_TRUE(lines[0].starts_with("REGISTER")) << lines[0];
}

TEST(SnGateway, DeliversAPausedTopicOnceItsRegisterIsAnswered) {
  NoRegackRig rig(false);
  rig.broker("ntnu-slam/robot/x/update", "1", 1);
  rig.broker("ntnu-slam/robot/x/update", "2", 1);
  for (int i = 0; i < 45; ++i) {
    rig.pass_s(1);
    rig.send(1, Pingreq{});
  }
  rig.sent_to(1);
  rig.pass(limits::first_set_aside);
  const Lines lines = rig.sent_to(1);
  ASSERT_FALSE(lines.empty());
  ASSERT_EQ(lines[0], "REGISTER id=2 msg=2 topic=ntnu-slam/robot/x/update");
  rig.send(1, Regack{2, 2, ReturnCode::accepted});
  EXPECT_EQ(rig.last_to(1), "PUBLISH dup=0 qos=1 retain=0 normal id=2 msg=3 data=31");
  rig.send(1, Puback{2, 3, ReturnCode::accepted});
  EXPECT_EQ(rig.last_to(1), "PUBLISH dup=0 qos=1 retain=0 normal id=2 msg=4 data=32");
}

TEST(SnGateway, ForgetsPausesWhenTheClientConnectsAgain) {
  NoRegackRig rig(false);
  rig.broker("ntnu-slam/robot/x/update", "1", 1);
  for (int i = 0; i < 45; ++i) {
    rig.pass_s(1);
    rig.send(1, Pingreq{});
  }
  rig.sent_to(1);
  rig.send(1, Connect{false, false, 1, 6000, "r1"});
  EXPECT_EQ(rig.sent_to(1),
            (Lines{"CONNACK code=0", "REGISTER id=2 msg=2 topic=ntnu-slam/robot/x/update"}));
}

TEST(SnGateway, KeepsTheOrderOfCommandsBehindAPromptRegister) {
  ConnectedRig rig(true, 600);
  rig.subscribe(1, r1_command, 1);
  rig.subscribe(1, "ntnu-slam/server/r1/+", 1);
  rig.broker("ntnu-slam/server/r1/run", "stop", 1);
  rig.broker(r1_command, "1,1", 1);
  EXPECT_EQ(rig.sent_to(1), Lines{"REGISTER id=2 msg=1 topic=ntnu-slam/server/r1/run"});
  rig.send(1, Regack{2, 1, ReturnCode::accepted});
  rig.send(1, Puback{2, 2, ReturnCode::accepted});
  EXPECT_EQ(rig.sent_to(1), (Lines{"PUBLISH dup=0 qos=1 retain=0 normal id=2 msg=2 data=73746f70",
                                   "PUBLISH dup=0 qos=1 retain=0 normal id=1 msg=3 data=312c31"}));
}

TEST(SnGateway, ReportsNoAcknowledgementOnlyForSentCommands) {
  ConnectedRig rig(true, 6000);
  rig.subscribe(1, "ntnu-slam/server/r1/+", 1);
  rig.broker("ntnu-slam/server/r1/run", "1", 1);
  rig.pass_s(30);
  ASSERT_EQ(rig.outcomes.size(), 1U);
  EXPECT_EQ(rig.outcomes[0].result, CommandResult::timeout);
  EXPECT_EQ(rig.outcomes[0].why, "the robot did not answer the registration of this topic");
  for (const std::string& line : rig.sent_to(1)) EXPECT_FALSE(line.starts_with("PUBLISH")) << line;

  ConnectedRig second(true, 6000);
  second.subscribe(1, r1_command, 1);
  second.broker(r1_command, "1", 1);
  second.broker(r1_command, "2", 1);
  second.pass_s(30);
  ASSERT_EQ(second.outcomes.size(), 2U);
  EXPECT_EQ(second.outcomes[0].why, "no acknowledgement");
  EXPECT_EQ(second.outcomes[1].why, "earlier messages for the robot took too long");
}

TEST(SnGateway, NeverSendsACommandAfterItsTimeout) {
  for (const unsigned qos : {1U, 2U}) {
    for (const bool clean : {true, false}) {
      ConnectedRig rig(clean, 6000);
      rig.subscribe(1, r1_command, qos);
      rig.broker(r1_command, "1", qos);
      rig.broker(r1_command, "2", qos);
      rig.pass_s(30);
      EXPECT_EQ(rig.outcomes.size(), 2U);
      EXPECT_EQ(rig.gateway.queued_for("r1"), 0U);
      rig.sent_to(1);
      rig.send(1, Pingreq{});
      rig.pass_s(100);
      EXPECT_EQ(rig.sent_to(1), Lines{"PINGRESP"});
      rig.send(1, Pubrec{1});
      EXPECT_EQ(rig.last_to(1), qos == 2 ? "nothing" : "PUBREL msg=1")
          << "a PUBREL would release the command";
      EXPECT_EQ(rig.outcomes.size(), 2U);
    }
  }
}

TEST(SnGateway, SendsTheNextCommandWhileAPubrelStaysUnanswered) {
  ConnectedRig rig(true, 6000);
  rig.subscribe(1, r1_command, 2);
  rig.broker(r1_command, "1", 2);
  rig.send(1, Pubrec{1});
  ASSERT_EQ(rig.outcomes.size(), 1U) << "PUBREC counts as delivered";
  EXPECT_EQ(rig.outcomes[0].result, CommandResult::delivered);
  rig.sent_to(1);
  rig.broker(r1_command, "2", 2);
  EXPECT_TRUE(rig.is_silent(1)) << "the PUBCOMP may still arrive in time";
  rig.pass(RetransmissionTimeout::shortest);
  EXPECT_EQ(rig.sent_to(1),
            (Lines{"PUBREL msg=1", "PUBLISH dup=0 qos=2 retain=0 normal id=1 msg=2 data=32"}));
}

TEST(SnGateway, SendsTheNextCommandIfPubrelIsAnsweredWithPubrec) {
  ConnectedRig rig(true, 6000);
  rig.subscribe(1, r1_command, 2);
  rig.broker(r1_command, "1", 2);
  rig.broker(r1_command, "2", 2);
  rig.sent_to(1);
  rig.send(1, Pubrec{1});
  rig.send(1, Pubrec{1});
  EXPECT_EQ(rig.sent_to(1), (Lines{"PUBREL msg=1", "PUBREL msg=1",
                                   "PUBLISH dup=0 qos=2 retain=0 normal id=1 msg=2 data=32"}));
  for (int i = 0; i < 60; ++i) {
    rig.pass_s(1);
    rig.send(1, Pubrec{1});
  }
  rig.sent_to(1);
  rig.pass_s(60);
  EXPECT_TRUE(rig.is_silent(1)) << "the repetitions have ended";
}

TEST(SnGateway, AcceptsALatePubackOfARequeuedMessage) {
  ConnectedRig rig(false, 6000);
  rig.subscribe(1, "a/x", 1);
  rig.broker("a/x", "1", 1);
  rig.pass_s(100);
  rig.sent_to(1);
  rig.send(1, Puback{1, 1, ReturnCode::accepted});
  EXPECT_TRUE(rig.is_silent(1));
  EXPECT_EQ(rig.gateway.queued_for("r1"), 0U);
}

/// A client that acknowledges all messages except those on a/x.
struct PoisonRig : ConnectedRig {
  explicit PoisonRig(bool clean = false, std::uint16_t duration_s = 6000)
      : ConnectedRig(clean, duration_s) {
    subscribe(1, r1_command, 1);
    subscribe(1, "a/x", 1);
    subscribe(1, "a/y", 1);
    broker("a/x", "poison", 1);
  }
  void pass_a_second() {
    pass_s(1);
    while (!datagrams.empty()) {
      const Packet packet = *decode(datagrams.back().bytes);
      datagrams.pop_back();
      const auto* publish = std::get_if<Publish>(&packet);
      if (!publish) continue;
      if (publish->topic_id == 2) {
        ++poison_copies;
        continue;
      }
      others += publish->topic_id == 3 && !publish->dup ? 1 : 0;
      send(1, Puback{publish->topic_id, publish->msg_id, ReturnCode::accepted});
    }
  }
  void expect_delivered(std::size_t commands) const {
    ASSERT_EQ(outcomes.size(), commands);
    for (const CommandOutcome& outcome : outcomes) {
      EXPECT_EQ(outcome.result, CommandResult::delivered) << outcome.why;
      EXPECT_LE(outcome.after, seconds(4));
    }
  }
  unsigned poison_copies = 0;
  unsigned others = 0;
};

TEST(SnGateway, DeliversCommandsBesideAMessageNeverAcknowledged) {
  PoisonRig rig;
  for (int i = 0; i < 600; ++i) {
    rig.send(1, Pingreq{});
    if (i % 60 == 0) rig.broker(r1_command, "go", 1);
    rig.pass_a_second();
  }
  rig.expect_delivered(10);
  EXPECT_EQ(rig.gateway.queued_for("r1"), 1U) << "the message stays queued";
}

TEST(SnGateway, DeliversCommandsToAQuietClientBesideAMessageNeverAcknowledged) {
  for (const bool clean : {true, false}) {
    PoisonRig rig(clean, 60);
    for (int i = 1; i <= 600; ++i) {
      if (i % 60 == 0) rig.send(1, Pingreq{});
      if (i % 10 == 5) rig.broker(r1_command, "go", 1);
      rig.pass_a_second();
    }
    rig.expect_delivered(60);
    EXPECT_LE(rig.poison_copies, 100U) << "its topic pauses";
    EXPECT_EQ(rig.gateway.queued_for("r1"), 1U);
    ASSERT_EQ(rig.notices.size(), 1U);
    EXPECT_NE(rig.notices[0].text.find("'a/x'"), std::string::npos) << rig.notices[0].text;
  }
}

TEST(SnGateway, DeliversCommandsWhileAClientIsSilentAfterAMessageNeverAcknowledged) {
  for (const bool clean : {true, false}) {
    PoisonRig rig(clean);
    for (int i = 0; i < 100; ++i) rig.pass_a_second();
    rig.broker(r1_command, "go", 1);
    rig.pass_a_second();
    rig.expect_delivered(1);
  }
}

TEST(SnGateway, DeliversOtherMessagesToAQuietClientBesideOneNeverAcknowledged) {
  PoisonRig rig(false, 60);
  for (int i = 1; i <= 600; ++i) {
    if (i % 60 == 0) rig.send(1, Pingreq{});
    if (i % 20 == 0) rig.broker("a/y", "hi", 1);
    rig.pass_a_second();
  }
  EXPECT_GE(rig.others, 29U);
  EXPECT_EQ(rig.gateway.queued_for("r1"), 1U + 30U - rig.others);
}

TEST(SnGateway, DeliversAtOnceToAClientThatWasMerelyAway) {
  ConnectedRig rig(false, 6000);
  rig.subscribe(1, "a/x", 1);
  for (int i = 0; i < 3; ++i) {
    rig.broker("a/x", "1", 1);
    rig.pass_s(100);
    rig.sent_to(1);
    rig.send(1, Pingreq{});
    const Lines lines = rig.sent_to(1);
    ASSERT_EQ(lines.size(), 2U);
    EXPECT_TRUE(lines[1].starts_with("PUBLISH dup=1")) << lines[1];
    const auto publish = std::get<Publish>(*decode(rig.datagrams.back().bytes));
    rig.send(1, Puback{publish.topic_id, publish.msg_id, ReturnCode::accepted});
    EXPECT_EQ(rig.gateway.queued_for("r1"), 0U);
  }
  EXPECT_TRUE(rig.notices.empty());
}

/// One datagram in ten is lost, each way.
TEST(SnGateway, DropsNoMessageBesideCommandsOnABadRadio) {
  for (const bool clean : {true, false}) {
    std::minstd_rand random(1);
    const auto is_lost = [&] { return random() % 10 == 0; };
    ConnectedRig rig(clean, 6000);
    rig.subscribe(1, r1_command, 1);
    rig.subscribe(1, "a/x", 1);
    rig.datagrams.clear();
    for (int tenth = 0; tenth < 9000; ++tenth) {
      if (tenth < 8900 && tenth % 20 == 0) rig.broker("a/x", "m", 1);
      if (tenth < 8900 && tenth % 20 == 10) rig.broker(r1_command, "go", 1);
      rig.pass(milliseconds(100));
      for (const auto& each : std::exchange(rig.datagrams, {})) {
        const Packet packet = *decode(each.bytes);
        const auto* publish = std::get_if<Publish>(&packet);
        if (!publish || is_lost() || is_lost()) continue;
        rig.send(1, Puback{publish->topic_id, publish->msg_id, ReturnCode::accepted});
      }
    }
    EXPECT_EQ(rig.counter("queue_dropped"), 0U);
    EXPECT_EQ(rig.gateway.queued_for("r1"), 0U);
    EXPECT_TRUE(rig.notices.empty());
  }
}

/// A sleeping client asks with each PINGREQ, also after wakes in which it lost everything (R124).
TEST(SnGateway, SendsTheWaitingMessageAtEachWakeOfAClientThatNeverAnswers) {
  ConnectedRig rig(false, 6000);
  rig.subscribe(1, "a/x", 1);
  rig.send(1, Disconnect{100});
  rig.broker("a/x", "1", 1);
  for (int wake = 0; wake < 5; ++wake) {
    rig.sent_to(1);
    rig.send(1, Pingreq{"r1"});
    const Lines lines = rig.sent_to(1);
    ASSERT_FALSE(lines.empty());
    EXPECT_TRUE(lines[0].starts_with("PUBLISH")) << lines[0];
    rig.pass_s(80);
  }
}

}  // namespace
}  // namespace slamgw::mqttsn
