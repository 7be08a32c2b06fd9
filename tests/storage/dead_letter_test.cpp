// SPDX-License-Identifier: Apache-2.0
// Messages that the broker refused stay on disk until they are resent or discarded.
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "tests/storage/store_user.hpp"
#include "tests/support/temp_dir.hpp"

namespace slamgw::test {
namespace {

using nlohmann::json;
using Ids = std::vector<std::uint64_t>;

json document(const OrderAnswer& answer) {
  EXPECT_EQ(answer.error, "");
  return json::parse(answer.json, nullptr, false);
}

Ids ids_in(const json& page) {
  Ids ids;
  for (const json& letter : page["letters"]) ids.push_back(letter["id"]);
  return ids;
}

class DeadLetters : public testing::Test {
 public:
  /// Stores messages 1 to 10 and makes dead letters of `rows`.
  void make_dead_letters(const Ids& rows) {
    ASSERT_TRUE(user->keep(1, 10, 20));
    ASSERT_TRUE(user->make_dead_letters(rows, "the broker refuses it: not authorised"));
  }
  void start_again() {
    user.reset();
    user = std::make_unique<StoreUser>(directory.path());
  }
  Ids messages() {
    Ids rows;
    const auto loaded = user->load(0);
    for (const StoredMessage& stored : loaded->messages) rows.push_back(stored.row);
    return rows;
  }

  TempDir directory;
  std::unique_ptr<StoreUser> user = std::make_unique<StoreUser>(directory.path());
};

TEST_F(DeadLetters, AreNotLoadedAsMessagesAndSurviveAReopen) {
  make_dead_letters({2, 5});
  EXPECT_EQ(user->await<DeadLettersChanged>()->dead_letters.count, 2u);
  EXPECT_EQ(messages(), (Ids{1, 3, 4, 6, 7, 8, 9, 10}));
  start_again();
  const auto opened = user->await<StoreOpened>();
  EXPECT_EQ(opened->count, 8u);
  EXPECT_EQ(opened->dead_letters.count, 2u);
  EXPECT_GT(opened->dead_letters.bytes, 100u);
  const json page = document(user->perform(ListDeadLetters{0, "", true}));
  EXPECT_EQ(page["count"], 2);
  EXPECT_EQ(ids_in(page), (Ids{2, 5}));
  const json& letter = page["letters"][1];
  EXPECT_EQ(letter["topic"], "ntnu-slam/robot/r2/update");
  EXPECT_EQ(letter["payload_hex"], to_hex(StoreUser::message(5, 20).payload));
  EXPECT_EQ(letter["qos"], 1);
  EXPECT_EQ(letter["retain"], true);
  EXPECT_EQ(letter["reason"], "the broker refuses it: not authorised");
  EXPECT_EQ(letter["code"], 0x87);
  EXPECT_EQ(letter["tries"], 5);
  EXPECT_FALSE(letter["stored_at"].get<std::string>().empty());
}

TEST_F(DeadLetters, CanBeMadeInTheWriteThatStoresTheMessage) {
  WriteToStore write{{{1, StoreUser::message(1, 10), {}}}, {}, {{1, "too large", 0x95, 1}}};
  user->store().ask(std::move(write));
  ASSERT_TRUE(user->await<StoreWritten>());
  EXPECT_EQ(ids_in(document(user->perform(ListDeadLetters{}))), Ids{1});
  EXPECT_TRUE(messages().empty());
}

TEST_F(DeadLetters, AreNotMadeOfUnknownRows) {
  ASSERT_TRUE(user->make_dead_letters({77}, "gone"));
  EXPECT_EQ(document(user->perform(ListDeadLetters{}))["count"], 0);
}

TEST_F(DeadLetters, AreListedByTopicAndByPages) {
  ASSERT_TRUE(user->keep(1, 600, 20));
  Ids rows;
  for (std::uint64_t row = 1; row <= 600; ++row) rows.push_back(row);
  ASSERT_TRUE(user->make_dead_letters(rows, "x"));
  Ids all;
  for (std::uint64_t after = 0;;) {
    const json page = document(user->perform(ListDeadLetters{after, "", false}));
    if (!page["more"].get<bool>()) break;
    EXPECT_LE(page["letters"].size(), MessageLog::page_letters);
    EXPECT_FALSE(page["letters"][0].contains("payload_hex"));
    for (const std::uint64_t id : ids_in(page)) all.push_back(id);
    after = all.back();
  }
  EXPECT_EQ(all, rows);
  const json page = document(user->perform(ListDeadLetters{0, "ntnu-slam/robot/r1/update", false}));
  EXPECT_EQ(page["letters"].size(), 200u);
}

TEST_F(DeadLetters, AreResentInTheirOldPlaces) {
  make_dead_letters({5, 2, 9});
  EXPECT_EQ(document(user->perform(ResendOrder{{{}, "", true}})),
            json({{"resent", 3}, {"left", 0}}));
  EXPECT_EQ(user->resent(), (Ids{2, 5, 9}));
  EXPECT_EQ(messages(), (Ids{1, 2, 3, 4, 5, 6, 7, 8, 9, 10}));
  EXPECT_EQ(document(user->perform(ListDeadLetters{}))["count"], 0);
}

TEST_F(DeadLetters, AreResentOrDiscardedByIdOrTopic) {
  make_dead_letters({2, 4, 5, 6, 7});
  EXPECT_EQ(document(user->perform(ResendOrder{{{4, 77}, "", false}}))["resent"], 1);
  EXPECT_EQ(document(user->perform(DiscardOrder{{{2, 77}, "", false}}))["discarded"], 1);
  EXPECT_EQ(
      document(user->perform(DiscardOrder{{{}, "ntnu-slam/robot/r0/update", false}}))["discarded"],
      1);
  EXPECT_EQ(ids_in(document(user->perform(ListDeadLetters{}))), (Ids{5, 7}));
  EXPECT_EQ(document(user->perform(DiscardOrder{{{}, "", true}}))["discarded"], 2);
  start_again();
  EXPECT_EQ(user->await<StoreOpened>()->dead_letters, DeadLetterCounts{});
}

TEST_F(DeadLetters, CountInTheirRobotsShareUntilTheyAreDiscarded) {
  make_dead_letters({2, 5});
  EXPECT_EQ(document(user->perform(DiscardOrder{{{2}, "", false}}))["discarded"], 1);
  std::unique_ptr<DeadLettersChanged> changed;
  do changed = user->await<DeadLettersChanged>();
  while (changed && changed->discarded.empty());
  ASSERT_TRUE(changed);
  const std::string topic = "ntnu-slam/robot/r2/update";
  EXPECT_EQ(changed->discarded[0].topic, topic);
  EXPECT_EQ(changed->discarded[0].bytes, stored_cost(topic.size(), 20));
  start_again();
  EXPECT_EQ(user->await<StoreOpened>()->shares.of(flow_of(topic)),
            2 * stored_cost(topic.size(), 20))
      << "of messages 5 and 8";
}

TEST_F(DeadLetters, AreAllResentThoughTheyExceedOnePage) {
  ASSERT_TRUE(user->keep(1, 600, 20));
  Ids rows;
  for (std::uint64_t row = 1; row <= 600; ++row) rows.push_back(row);
  ASSERT_TRUE(user->make_dead_letters(rows, "x"));
  EXPECT_EQ(document(user->perform(ResendOrder{{{}, "", true}}))["resent"], 600);
  EXPECT_EQ(user->resent(), rows);
}

TEST_F(DeadLetters, KeepTheTimeOfTheMessageWhenRefusedAgain) {
  make_dead_letters({2});
  const json before = document(user->perform(ListDeadLetters{}));
  EXPECT_EQ(document(user->perform(ResendOrder{{{2}, "", false}}))["resent"], 1);
  ASSERT_TRUE(user->make_dead_letters({2}, "again"));
  const json after = document(user->perform(ListDeadLetters{}));
  EXPECT_EQ(ids_in(after), Ids{2});
  EXPECT_EQ(after["letters"][0]["reason"], "again");
  EXPECT_EQ(after["letters"][0]["stored_at"], before["letters"][0]["stored_at"]);
}

/// Rows 2, 5 and 8 have one topic.
TEST_F(DeadLetters, OfATopicAreRetriedUnlessTheyWaitForAnOperator) {
  ASSERT_TRUE(user->keep(1, 10, 20));
  WriteToStore write;
  write.dead_letters = {{1, "not authorised", 0x87, 1},
                        {2, "the connection was lost each time", 0, losses_at_fault},
                        {5, "not authorised", 0x87, 0},
                        {8, "the connection is lost", 0, 1}};
  user->store().ask(std::move(write));
  ASSERT_TRUE(user->await<StoreWritten>());
  start_again();
  const auto opened = user->await<StoreOpened>();
  ASSERT_EQ(opened->dead_topics.size(), 2u);
  EXPECT_EQ(opened->dead_topics[0].topic, "ntnu-slam/robot/r1/update");
  EXPECT_EQ(opened->dead_topics[0].refusal.code, 0x87);
  EXPECT_EQ(opened->dead_topics[1].topic, "ntnu-slam/robot/r2/update");
  EXPECT_EQ(opened->dead_topics[1].refusal.code, 0) << "that of the first to be tried";
  EXPECT_EQ(opened->dead_topics[1].count, 2u) << "the other waits for an operator";

  const std::string topic = opened->dead_topics[1].topic;
  user->store().ask(RetryDeadLetters{topic, 1});
  const auto one = user->await<DeadLettersRevived>();
  ASSERT_EQ(one->messages.size(), 1u);
  EXPECT_EQ(one->messages[0].row, 8u) << "it may cost the connection, so it is tried first";
  EXPECT_EQ(one->messages[0].topic, topic);
  EXPECT_EQ(one->retried_topic, topic);
  user->store().ask(RetryDeadLetters{topic, 10});
  const auto all = user->await<DeadLettersRevived>();
  ASSERT_EQ(all->messages.size(), 1u);
  EXPECT_EQ(all->messages[0].row, 5u);
  EXPECT_EQ(messages(), (Ids{3, 4, 5, 6, 7, 8, 9, 10}));
  user->store().ask(RetryDeadLetters{"unknown", 10});
  const auto none = user->await<DeadLettersRevived>();
  EXPECT_TRUE(none->messages.empty());
  EXPECT_EQ(none->why_failed, "");
}

/// An access right may be missing for all of a thousand robots.
TEST_F(DeadLetters, OfManyTopicsAreReportedAfterARestart) {
  WriteToStore write;
  for (std::uint64_t row = 1; row <= 3000; ++row) {
    write.keep.push_back({row, StoreUser::message(row, 10), {}});
    write.keep.back().message.topic = "t/" + std::to_string(row);
    write.dead_letters.push_back({row, "not authorised", 0x87, 1});
  }
  user->store().ask(std::move(write));
  ASSERT_TRUE(user->await<StoreWritten>());
  start_again();
  EXPECT_EQ(user->await<StoreOpened>()->dead_topics.size(), 3000u);
}

TEST_F(DeadLetters, OrdersFailWithAReasonWithoutAStore) {
  ASSERT_TRUE(user->await<StoreOpened>());
  StoreUser second(directory.path());
  ASSERT_TRUE(second.await<StoreAbsent>());
  EXPECT_NE(second.perform(ListDeadLetters{}).error.find("there is no store: "), std::string::npos);
}

}  // namespace
}  // namespace slamgw::test
