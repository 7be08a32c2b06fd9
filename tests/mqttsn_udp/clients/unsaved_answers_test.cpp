// SPDX-License-Identifier: Apache-2.0
// An answer on which a client relies waits until the client's session is saved. Messages to one
// client keep their order. Without a working disk, answers leave unsaved.
#include <gtest/gtest.h>

#include "adapters/mqttsn_udp/limits.hpp"
#include "tests/mqttsn_udp/sn_rig.hpp"

namespace slamgw::mqttsn {
namespace {

constexpr std::size_t all = 100000;

/// A rig with a store that writes when the test calls end_save().
class UnsavedAnswers : public testing::Test {
 protected:
  UnsavedAnswers() {
    rig.gateway.answer_when_saved();
    rig.gateway.on_saved(true, rig.now);
  }
  /// Begins a write, as the shell does. Returns the sessions that it includes.
  Lines begin_save() { return rig.gateway.take_changed(all); }
  void end_save(bool is_saved = true) {
    rig.gateway.on_saved(is_saved, rig.now);
    rig.pass(Duration::zero());
    rig.broker_link(true);  // drains
  }
  Lines save() {
    Lines ids = begin_save();
    end_save();
    return ids;
  }
  void connect_and_save(unsigned n, const std::string& id) {
    rig.send(n, Connect{false, true, protocol_id, 60, id});
    save();
    rig.sent_to(n);
  }

  SnRig rig;
};

TEST_F(UnsavedAnswers, WaitUntilTheirSessionIsSaved) {
  Subscribe subscribe;
  subscribe.msg_id = 2;
  subscribe.topic_name = "ntnu-slam/server/r1/cmd";
  Unsubscribe unsubscribe;
  unsubscribe.msg_id = 3;
  unsubscribe.topic_name = subscribe.topic_name;
  const std::pair<Packet, const char*> exchanges[] = {
      {Connect{false, false, protocol_id, 60, "r1"}, "CONNACK"},
      {Register{0, 1, own_topic}, "REGACK"},
      {subscribe, "SUBACK"},
      {unsubscribe, "UNSUBACK"},
      {WillTopicUpd{WireQos::zero, false, own_topic}, "WILLTOPICRESP"},
      {WillMsgUpd{to_bytes("bye")}, "WILLMSGRESP"},
      {Disconnect{60}, "DISCONNECT"},
  };
  for (const auto& [request, answer] : exchanges) {
    rig.send(1, request);
    EXPECT_TRUE(rig.is_silent(1)) << answer;
    EXPECT_EQ(begin_save(), Lines{"r1"}) << answer;
    EXPECT_TRUE(rig.is_silent(1)) << answer;
    end_save();
    EXPECT_TRUE(rig.last_to(1).starts_with(answer)) << answer;
  }
  EXPECT_FALSE(rig.gateway.has_unsaved_answers());
  EXPECT_EQ(rig.counter("answered_unsaved"), 0U);
}

TEST_F(UnsavedAnswers, LeaveTogetherAfterOneSave) {
  for (unsigned n = 1; n <= 3; ++n)
    rig.send(n, Connect{false, true, protocol_id, 60, "r" + std::to_string(n)});
  EXPECT_EQ(begin_save(), (Lines{"r1", "r2", "r3"}));
  rig.send(4, Connect{false, true, protocol_id, 60, "r4"});
  end_save();
  for (unsigned n = 1; n <= 3; ++n) EXPECT_EQ(rig.last_to(n), "CONNACK code=0");
  EXPECT_TRUE(rig.is_silent(4)) << "the save had begun";
  EXPECT_EQ(save(), Lines{"r4"});
  EXPECT_EQ(rig.last_to(4), "CONNACK code=0");
}

TEST_F(UnsavedAnswers, AreNotOvertakenByLaterMessagesToTheClient) {
  connect_and_save(1, "r1");
  connect_and_save(2, "r2");
  Subscribe subscribe;
  subscribe.msg_id = 2;
  subscribe.topic_id_type = TopicIdType::short_name;
  subscribe.topic_id = 'a' << 8 | 'b';
  rig.send(1, subscribe);
  rig.broker("ab");
  rig.send(1, Pingreq{});
  rig.send(2, Pingreq{});
  EXPECT_TRUE(rig.is_silent(1));
  EXPECT_EQ(rig.last_to(2), "PINGRESP") << "its own session is saved";
  save();
  const Lines sent = rig.sent_to(1);
  ASSERT_EQ(sent.size(), 3U);
  EXPECT_TRUE(sent[0].starts_with("SUBACK")) << sent[0];
  EXPECT_TRUE(sent[1].starts_with("PUBLISH")) << sent[1];
  EXPECT_EQ(sent[2], "PINGRESP");
}

TEST_F(UnsavedAnswers, KeepTheirOrderOverTwoSaves) {
  rig.send(1, Connect{false, true, protocol_id, 60, "r1"});
  begin_save();
  rig.send(1, Register{0, 1, own_topic});
  rig.send(1, Pingreq{});
  end_save();
  EXPECT_EQ(rig.sent_to(1), Lines{"CONNACK code=0"});
  save();
  const Lines sent = rig.sent_to(1);
  ASSERT_EQ(sent.size(), 2U);
  EXPECT_TRUE(sent[0].starts_with("REGACK")) << sent[0];
  EXPECT_EQ(sent[1], "PINGRESP");
}

TEST_F(UnsavedAnswers, DelayNoRefusalPingrespOrDisconnect) {
  connect_and_save(1, "r1");
  rig.send(1, Register{0, 1, "nowhere/x"});
  EXPECT_TRUE(rig.last_to(1).ends_with("code=3")) << "refused";
  rig.send(1, Pingreq{});
  EXPECT_EQ(rig.last_to(1), "PINGRESP");
  rig.send(2, Register{0, 1, own_topic});
  EXPECT_EQ(rig.last_to(2), "DISCONNECT plain") << "an unknown client has no session";
}

TEST_F(UnsavedAnswers, LeaveUnsavedOnlyWhileTheStoreFails) {
  rig.send(1, Connect{false, true, protocol_id, 60, "r1"});
  begin_save();
  rig.send(2, Connect{false, true, protocol_id, 60, "r2"});
  end_save(false);
  EXPECT_EQ(rig.last_to(1), "CONNACK code=0");
  EXPECT_EQ(rig.last_to(2), "CONNACK code=0");
  EXPECT_EQ(rig.counter("answered_unsaved"), 2U);
  EXPECT_EQ(rig.notices.size(), 1U);
  rig.send(3, Connect{false, true, protocol_id, 60, "r3"});
  EXPECT_EQ(rig.last_to(3), "CONNACK code=0") << "no answer waits for a failing store";
  EXPECT_EQ(rig.counter("answered_unsaved"), 3U);
  EXPECT_EQ(begin_save(), (Lines{"r2", "r3"})) << "they are still to be saved";
  end_save(false);
  end_save();
  rig.send(4, Connect{false, true, protocol_id, 60, "r4"});
  EXPECT_TRUE(rig.is_silent(4));
  save();
  EXPECT_EQ(rig.last_to(4), "CONNACK code=0");
  rig.send(5, Connect{false, true, protocol_id, 60, "r5"});
  end_save(false);
  EXPECT_EQ(rig.notices.size(), 1U) << "at most one notice an hour";
}

TEST_F(UnsavedAnswers, IncludeThePingrespToASleeperAtANewAddress) {
  connect_and_save(1, "r1");
  rig.send(1, Disconnect{60});
  save();
  rig.sent_to(1);
  rig.send(2, Pingreq{"r1"});
  EXPECT_TRUE(rig.is_silent(2));
  save();
  EXPECT_EQ(rig.last_to(2), "PINGRESP");
}

TEST_F(UnsavedAnswers, IncludeTheGatewaysOwnRegister) {
  connect_and_save(1, "r1");
  rig.send(1, Subscribe{false, WireQos::one, TopicIdType::normal, 2, "ntnu-slam/robot/+/live", 0});
  rig.gateway.on_subscribe_result("r1", "ntnu-slam/robot/+/live", true, rig.now);
  save();
  rig.sent_to(1);
  rig.broker("ntnu-slam/robot/r2/live", "x", 1);
  EXPECT_TRUE(rig.is_silent(1));
  save();
  EXPECT_TRUE(rig.last_to(1).starts_with("REGISTER"));
}

TEST_F(UnsavedAnswers, LeaveAtOnceWithoutAStore) {
  SnRig without;
  without.send(1, Connect{false, true, protocol_id, 60, "r1"});
  EXPECT_EQ(without.last_to(1), "CONNACK code=0");
}

TEST_F(UnsavedAnswers, LeaveUnsavedWhenTheirQueueIsFull) {
  connect_and_save(1, "r1");
  rig.send(1, Register{0, 1, own_topic});
  begin_save();
  for (std::size_t i = 2; i < limits::max_unsaved_answers; ++i) rig.send(1, Pingreq{});
  EXPECT_TRUE(rig.is_silent(1));
  rig.send(1, Pingreq{});
  const Lines sent = rig.sent_to(1);
  EXPECT_EQ(sent.size(), limits::max_unsaved_answers);
  EXPECT_TRUE(sent.front().starts_with("REGACK"));
  EXPECT_EQ(rig.counter("answered_unsaved"), limits::max_unsaved_answers);
}

TEST_F(UnsavedAnswers, AreSavedInBoundedBatches) {
  constexpr unsigned clients = 2 * limits::max_sessions_for_answers + 1;
  for (unsigned n = 1; n <= clients; ++n)
    rig.send(n, Connect{false, true, protocol_id, 60, "r" + std::to_string(n)});
  unsigned answered = 0;
  for (unsigned saves = 1; saves <= 3; ++saves) {
    EXPECT_LE(rig.gateway.take_changed(limits::max_sessions_for_answers).size(),
              limits::max_sessions_for_answers);
    end_save();
    answered = 0;
    for (const SendDatagram& datagram : rig.datagrams)
      answered += describe_octets(datagram.bytes) == "CONNACK code=0" ? 1 : 0;
    EXPECT_EQ(answered, std::min<std::size_t>(clients, saves * limits::max_sessions_for_answers));
  }
}

/// `mqttsn.max_clients` may exceed `max_changed`, the bound for the ids of ended sessions.
TEST(ChangedSessions, HaveRoomForAllClientsAndABoundedRest) {
  constexpr std::size_t clients = limits::max_changed;
  ChangedSessions changed(clients);
  ClientSession session;
  for (std::size_t i = 0; i < 2 * clients + 10; ++i) {
    session.client_id = std::to_string(i);
    changed.mark(session);
  }
  EXPECT_EQ(changed.take(3 * clients).size(), 2 * clients);
}

}  // namespace
}  // namespace slamgw::mqttsn
