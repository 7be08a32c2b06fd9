// SPDX-License-Identifier: Apache-2.0
// The store on a failing disk or with damaged files. It loses nothing when the disk fails for a
// moment. It delivers all readable messages of a damaged file and reports the rest as lost.
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <algorithm>
#include <chrono>

#include <filesystem>
#include <fstream>

#include "tests/storage/faulty_disk.hpp"
#include "tests/storage/store_user.hpp"
#include "tests/support/temp_dir.hpp"

namespace slamgw::test {
namespace {

constexpr std::size_t page_bytes = 4096;

void overwrite(const std::string& path, std::size_t offset, const std::string& text) {
  std::fstream file(path, std::ios::in | std::ios::out | std::ios::binary);
  file.seekp(static_cast<std::streamoff>(offset));
  file << text;
}

std::vector<std::uint64_t> rows_of(const StoreLoaded& loaded) {
  std::vector<std::uint64_t> rows;
  for (const StoredMessage& stored : loaded.messages) rows.push_back(stored.row);
  return rows;
}

/// Expects each loaded message to be the one that was stored under its number.
void expect_intact(const StoreLoaded& loaded, std::size_t payload_bytes) {
  std::uint64_t last = 0;
  for (const StoredMessage& stored : loaded.messages) {
    EXPECT_GT(stored.row, last);
    last = stored.row;
    const BrokerMessage expected = StoreUser::message(stored.row, payload_bytes);
    EXPECT_EQ(stored.message.topic, expected.topic);
    EXPECT_EQ(stored.message.payload, expected.payload);
  }
}

class StoreDamage : public testing::Test {
 public:
  /// Writes these messages into one segment.
  void fill(std::uint64_t count, std::size_t payload_bytes = 100) {
    StoreUser user(directory.path());
    ASSERT_TRUE(user.keep(1, count, payload_bytes));
  }
  std::string segment() const { return StoreUser::newest_segment(directory.path()); }
  std::size_t segments() const {
    std::size_t count = 0;
    for (const auto& file : std::filesystem::directory_iterator(directory / "messages"))
      count += file.path().extension() == ".log" ? 1 : 0;
    return count;
  }
  static std::string loss_notice(std::size_t lost) {
    return ": " + std::to_string(lost) + " messages are lost";
  }

  FaultyDisk disk;
  TempDir directory;
};

TEST_F(StoreDamage, LosesNothingWhenTheDiskFailsToReadForAMoment) {
  fill(300);
  FaultyDisk::fails_reads = true;
  StoreUser user(directory.path());
  EXPECT_TRUE(eventually([] { return FaultyDisk::failed_reads > 10; }));
  FaultyDisk::fails_reads = false;
  const auto opened = user.await<StoreOpened>();
  ASSERT_TRUE(opened);
  EXPECT_EQ(opened->count, 300u);
  EXPECT_EQ(user.load(0)->messages.size(), 300u);
  EXPECT_EQ(user.notices(), "");
}

TEST_F(StoreDamage, LosesNothingWhenTheDiskFailsWhileTheStoreIsOpen) {
  fill(300);
  StoreUser user(directory.path());
  ASSERT_TRUE(user.await<StoreOpened>());
  FaultyDisk::fails_reads = FaultyDisk::fails_writes = true;
  user.store().ask(WriteToStore{{{301, StoreUser::message(301, 100), {}}}, {}, {}});
  ASSERT_TRUE(user.await<StoreWriteFailed>());
  user.store().ask(LoadFromStore{0, 1000, 1u << 20});
  ASSERT_TRUE(user.await<StoreLoadFailed>());
  FaultyDisk::fails_reads = FaultyDisk::fails_writes = false;
  ASSERT_TRUE(user.keep(301, 1, 100));
  EXPECT_EQ(user.load(0)->messages.size(), 301u);
  EXPECT_EQ(user.notices(), "");
}

TEST_F(StoreDamage, ReportsUnreadableMessagesAsLostAndDeliversTheRest) {
  fill(600);
  FaultyDisk::make_unreadable(segment(), 6 * page_bytes, 6 * page_bytes + 512);
  StoreUser user(directory.path());
  const auto opened = user.await<StoreOpened>();
  ASSERT_TRUE(opened);
  EXPECT_LT(opened->count, 600u);
  EXPECT_GT(opened->count, 570u);
  EXPECT_NE(user.notices().find(loss_notice(600 - opened->count)), std::string::npos)
      << user.notices();
  const auto loaded = user.load(0);
  EXPECT_EQ(loaded->messages.size(), opened->count);
  expect_intact(*loaded, 100);
}

TEST_F(StoreDamage, ReportsNoLossWhenTheDiskIsUnreadableForLong) {
  fill(300);
  FaultyDisk::fails_reads = true;
  StoreUser user(directory.path());
  ASSERT_TRUE(user.await<StoreAbsent>()) << "the daemon does not wait for ever";
  EXPECT_NE(user.notices().find("no store"), std::string::npos);
  FaultyDisk::fails_reads = false;
  EXPECT_EQ(user.await<StoreOpened>()->count, 300u);
  EXPECT_EQ(user.notices().find("lost"), std::string::npos) << user.notices();
}

TEST_F(StoreDamage, RetriesAnUnreadableDiskSeldom) {
  fill(1);
  FaultyDisk::fails_reads = true;
  StoreUser user(directory.path());
  ASSERT_TRUE(user.await<StoreAbsent>());
  const std::uint64_t before = FaultyDisk::failed_reads;
  const auto begin = std::chrono::steady_clock::now();
  ASSERT_TRUE(eventually([&] { return FaultyDisk::failed_reads >= before + 40; }));
  EXPECT_GE(std::chrono::steady_clock::now() - begin, 5 * short_patience.reopen)
      << "about four of them in each attempt";
}

TEST_F(StoreDamage, LosesOnlyTheMessagesOfAZeroedPage) {
  for (const std::size_t bytes : {std::size_t{512}, page_bytes}) {
    for (const std::size_t page : {0, 1, 2, 7}) {
      std::filesystem::remove_all(directory.path());
      fill(600);
      overwrite(segment(), page * page_bytes, std::string(bytes, '\0'));
      StoreUser user(directory.path());
      ASSERT_TRUE(user.await<StoreOpened>());
      const auto loaded = user.load(0);
      EXPECT_GE(loaded->messages.size(), 570u) << page;
      expect_intact(*loaded, 100);
      EXPECT_NE(user.notices().find(loss_notice(600 - loaded->messages.size())), std::string::npos)
          << user.notices();
      EXPECT_TRUE(user.keep(601, 1, 100));
    }
  }
}

TEST_F(StoreDamage, DeliversNoMessageWithAFlippedOctetInItsPayload) {
  fill(100);
  const std::string file = read_file(segment());
  const Bytes payload = StoreUser::message(40, 100).payload;
  const std::size_t at = file.find(std::string(as_text(payload)));
  ASSERT_NE(at, std::string::npos);
  overwrite(segment(), at + 50, "!");
  StoreUser user(directory.path());
  ASSERT_EQ(user.await<StoreOpened>()->count, 99u);
  EXPECT_NE(user.notices().find(loss_notice(1)), std::string::npos) << user.notices();
  expect_intact(*user.load(0), 100);
  user.store().stop();
  StoreUser next(directory.path());
  ASSERT_EQ(next.await<StoreOpened>()->count, 99u);
  EXPECT_EQ(next.notices(), "") << "reported once";
}

/// After kill -9, on a file system that has lost the end.
TEST_F(StoreDamage, ReportsTheMessagesOfATruncatedSegmentAsLost) {
  fill(100);
  std::filesystem::resize_file(segment(), std::filesystem::file_size(segment()) / 3);
  StoreUser user(directory.path());
  const auto loaded = (user.await<StoreOpened>(), user.load(0));
  ASSERT_TRUE(loaded);
  EXPECT_LT(loaded->messages.size(), 40u);
  EXPECT_GT(loaded->messages.size(), 20u);
  expect_intact(*loaded, 100);
  EXPECT_NE(user.notices().find(loss_notice(100 - loaded->messages.size())), std::string::npos)
      << user.notices();
}

TEST_F(StoreDamage, ReportsATruncatedEarlierSegmentWithoutTheTally) {
  fill(100);
  const std::string first = segment();
  {  // each process begins a segment
    StoreUser user(directory.path());
    ASSERT_TRUE(user.keep(101, 50, 100));
  }
  ASSERT_NE(segment(), first);
  std::filesystem::resize_file(first, std::filesystem::file_size(first) / 2);
  write_file(directory / "messages/tally", "nonsense", 0600);
  StoreUser user(directory.path());
  const auto loaded = (user.await<StoreOpened>(), user.load(0));
  EXPECT_LT(loaded->messages.size(), 110u);
  expect_intact(*loaded, 100);
  EXPECT_NE(user.notices().find(loss_notice(150 - loaded->messages.size())), std::string::npos)
      << user.notices();
}

TEST_F(StoreDamage, ReportsTheMessagesOfARemovedSegmentAsLost) {
  fill(100);
  const std::string first = segment();
  {
    StoreUser user(directory.path());
    ASSERT_TRUE(user.keep(101, 50, 100));
  }
  std::filesystem::remove(first);
  StoreUser user(directory.path());
  EXPECT_EQ(user.await<StoreOpened>()->count, 50u);
  EXPECT_NE(user.notices().find(loss_notice(100)), std::string::npos) << user.notices();
}

TEST_F(StoreDamage, ReadsASegmentWithoutItsHeader) {
  fill(100);
  overwrite(segment(), 0, std::string(32, '\0'));
  StoreUser user(directory.path());
  ASSERT_TRUE(user.await<StoreOpened>());
  const auto loaded = user.load(0);
  EXPECT_EQ(loaded->messages.size(), 100u) << user.notices();
  expect_intact(*loaded, 100);
}

TEST_F(StoreDamage, LosesNothingWhereTheListOfErasedRecordsIsDamaged) {
  {
    StoreUser user(directory.path());
    ASSERT_TRUE(user.keep(1, 100, 100));
    ASSERT_TRUE(user.forget(1, 50));
  }
  overwrite(segment() + ".erased", 80, std::string(8, '\xee'));
  StoreUser user(directory.path());
  EXPECT_EQ(user.await<StoreOpened>()->count, 51u);
  const auto loaded = user.load(0);
  expect_intact(*loaded, 100);
  const std::vector<std::uint64_t> rows = rows_of(*loaded);
  EXPECT_EQ(rows.size(), 51u) << "one of the erased messages is back";
  EXPECT_EQ(std::ranges::count_if(rows, [](std::uint64_t row) { return row > 50; }), 50);
  EXPECT_EQ(user.notices(), "") << "nothing is lost";
}

/// Holds also when nothing else is written after the disk works again.
TEST_F(StoreDamage, RetriesAFailedErasureSoThatNoMessageIsDeliveredTwice) {
  for (const bool stops_at_once : {true, false}) {
    const TempDir directory;
    {
      StoreUser user(directory.path());
      ASSERT_TRUE(user.keep(1, 10));
      const std::string list = StoreUser::newest_segment(directory.path()) + ".erased";
      std::filesystem::create_directory(list);  // so it cannot be written
      ASSERT_TRUE(user.forget(1, 5));
      std::filesystem::remove(list);
      if (!stops_at_once) {
        EXPECT_TRUE(eventually([&] { return std::filesystem::exists(list); }));
      }
    }
    StoreUser user(directory.path());
    EXPECT_EQ(user.await<StoreOpened>()->count, 5u);
  }
}

TEST_F(StoreDamage, ReportsLossesAsARangeWhereBothFilesAreDamaged) {
  {
    StoreUser user(directory.path());
    ASSERT_TRUE(user.keep(1, 100, 100));
    ASSERT_TRUE(user.forget(1, 50));
  }
  overwrite(segment() + ".erased", 80, std::string(8, '\xee'));
  overwrite(segment(), 3 * page_bytes, std::string(512, '\0'));
  StoreUser user(directory.path());
  const std::size_t count = user.await<StoreOpened>()->count;
  EXPECT_NE(user.notices().find(std::to_string(50 - count) + " to " + std::to_string(51 - count) +
                                " messages are lost"),
            std::string::npos)
      << user.notices();
}

/// A robot cannot forge a record: the checksums cover the log's secret id.
TEST_F(StoreDamage, DoesNotReadARecordInsideAPayload) {
  fill(1, 10);
  const std::string record = read_file(segment()).substr(32);
  std::filesystem::remove_all(directory.path());
  {
    StoreUser user(directory.path());
    WriteToStore write;
    BrokerMessage message = StoreUser::message(1, 0);
    message.payload.assign(record.begin(), record.end());
    write.keep.push_back({1, message, {}});
    user.store().ask(std::move(write));
    ASSERT_TRUE(user.await<StoreWritten>());
  }
  overwrite(segment(), 32, "!!!!");
  StoreUser user(directory.path());
  EXPECT_EQ(user.await<StoreOpened>()->count, 0u);
  EXPECT_NE(user.notices().find(loss_notice(1)), std::string::npos) << user.notices();
}

TEST_F(StoreDamage, LosesOneLargeMessageForADamagedPage) {
  fill(50, 20000);
  overwrite(segment(), page_bytes, std::string(512, '\0'));
  StoreUser user(directory.path());
  const auto loaded = (user.await<StoreOpened>(), user.load(0, 1000, 1u << 24));
  EXPECT_EQ(loaded->messages.size(), 49u) << user.notices();
  expect_intact(*loaded, 20000);
}

TEST_F(StoreDamage, LosesOnlyDamagedMessagesOfAnOpenStore) {
  fill(3000, 2000);
  StoreUser user(directory.path());
  ASSERT_EQ(user.await<StoreOpened>()->count, 3000u);
  for (std::size_t page = 600; page < 610; ++page)
    overwrite(segment(), page * page_bytes, std::string(page_bytes, '\0'));
  std::size_t delivered = 0;
  std::size_t damaged = 0;
  for (std::uint64_t cursor = 0;;) {
    const auto loaded = user.load(cursor, 100);
    ASSERT_TRUE(loaded);
    if (loaded->messages.empty() && loaded->damaged.empty()) break;
    expect_intact(*loaded, 2000);
    delivered += loaded->messages.size();
    damaged += loaded->damaged.size();
    for (const std::uint64_t row : loaded->damaged) cursor = std::max(cursor, row);
    for (const StoredMessage& stored : loaded->messages) cursor = std::max(cursor, stored.row);
  }
  EXPECT_EQ(delivered + damaged, 3000u);
  EXPECT_GE(delivered, 2970u);
  EXPECT_LT(delivered, 3000u);
  EXPECT_FALSE(user.was_absent()) << "the outbox saw no absent store";
  EXPECT_NE(user.notices().find("messages are lost"), std::string::npos);
}

TEST_F(StoreDamage, RetriesAnUnreadableMessageBeforeItReportsItAsLost) {
  fill(100);
  StoreUser user(directory.path());
  ASSERT_TRUE(user.await<StoreOpened>());
  FaultyDisk::make_unreadable(segment(), page_bytes, page_bytes + 512);
  user.store().ask(LoadFromStore{0, 1000, 1u << 20});
  ASSERT_TRUE(user.await<StoreLoadFailed>());
  std::unique_ptr<StoreLoaded> loaded;
  ASSERT_TRUE(eventually([&] {
    user.store().ask(LoadFromStore{0, 1000, 1u << 20});
    auto answer = user.await_either<StoreLoaded, StoreLoadFailed>();
    if (auto* const good = std::get_if<StoreLoaded>(&answer))
      loaded = std::make_unique<StoreLoaded>(std::move(*good));
    return loaded != nullptr;
  }));
  EXPECT_EQ(loaded->messages.size() + loaded->damaged.size(), 100u);
  EXPECT_LE(loaded->damaged.size(), 5u);
  EXPECT_TRUE(user.reports(loss_notice(loaded->damaged.size()))) << user.notices();
}

TEST_F(StoreDamage, DeliversAMessageOfAFailedWriteOnceAfterItsRetry) {
  fill(10);
  {
    StoreUser user(directory.path());
    ASSERT_TRUE(user.await<StoreOpened>());
    FaultyDisk::fails_syncs = true;
    user.store().ask(WriteToStore{{{11, StoreUser::message(11, 100), {}}}, {}, {}});
    ASSERT_TRUE(user.await<StoreWriteFailed>());
    FaultyDisk::fails_syncs = false;
    EXPECT_EQ(rows_of(*user.load(0)).back(), 10u);
    ASSERT_TRUE(user.keep(11, 1, 100))
        << "the outbox tries again, under the same number or another";
  }
  StoreUser user(directory.path());
  EXPECT_EQ(user.await<StoreOpened>()->count, 11u);
  EXPECT_EQ(user.notices(), "");
}

TEST_F(StoreDamage, FailedWriteLosesNoEarlierMessageOfItsSegment) {
  {
    StoreUser user(directory.path());
    ASSERT_TRUE(user.keep(1, 100, 200));
    FaultyDisk::fails_syncs = true;
    user.store().ask(WriteToStore{{{101, StoreUser::message(101, 200), {}}}, {}, {}});
    ASSERT_TRUE(user.await<StoreWriteFailed>());
    FaultyDisk::fails_syncs = false;
    EXPECT_EQ(user.load(0)->messages.size(), 100u);
  }
  StoreUser user(directory.path());
  EXPECT_EQ(user.await<StoreOpened>()->count, 100u);
  EXPECT_EQ(user.notices(), "");
}

TEST_F(StoreDamage, DeadLettersStayWhenTheDiskFailsToWriteThemAsMessages) {
  StoreUser user(directory.path());
  ASSERT_TRUE(user.keep(1, 3, 100));
  ASSERT_TRUE(user.make_dead_letters({1, 2}, "refused"));
  FaultyDisk::fails_writes = true;
  EXPECT_EQ(user.perform(ResendOrder{{{}, "", true}}).json, R"({"left":2,"resent":0})");
  user.store().ask(RetryDeadLetters{"ntnu-slam/robot/r1/update", 1});
  EXPECT_FALSE(user.await<DeadLettersRevived>()->why_failed.empty());
  FaultyDisk::fails_writes = false;
  EXPECT_EQ(rows_of(*user.load(0)), std::vector<std::uint64_t>{3});
  EXPECT_EQ(user.perform(ResendOrder{{{}, "", true}}).json, R"({"left":0,"resent":2})");
  EXPECT_EQ(user.load(0)->messages.size(), 3u);
}

TEST_F(StoreDamage, DamagedDeadLetterHidesNoOtherOfItsTopic) {
  StoreUser user(directory.path());
  ASSERT_TRUE(user.keep(1, 9, 100));
  ASSERT_TRUE(user.make_dead_letters({1, 4, 7}, "refused"));
  const std::string file = read_file(segment());
  const auto last = file.rfind(std::string(as_text(StoreUser::message(1, 100).payload)));
  ASSERT_NE(last, std::string::npos);
  overwrite(segment(), last + 50, "!");
  user.store().ask(RetryDeadLetters{"ntnu-slam/robot/r1/update", 1});
  const auto revived = user.await<DeadLettersRevived>();
  ASSERT_EQ(revived->messages.size(), 1u);
  EXPECT_EQ(revived->messages[0].row, 4u);
  EXPECT_EQ(user.await<DeadLettersChanged>()->dead_letters.count, 1u);
  EXPECT_NE(user.notices().find(loss_notice(1)), std::string::npos) << user.notices();
}

TEST_F(StoreDamage, UnreadableDeadLetterHidesNoOther) {
  const std::string topic = "ntnu-slam/robot/r1/update";
  StoreUser user(directory.path());
  ASSERT_TRUE(user.keep(1, 9, 100));
  WriteToStore write;
  for (const std::uint64_t row : {1U, 4U, 7U})
    write.dead_letters.push_back({row, "refused", 0x87, 1});
  user.store().ask(std::move(write));
  ASSERT_TRUE(user.await<StoreWritten>());
  const std::string file = read_file(segment());
  const auto last = file.rfind(std::string(as_text(StoreUser::message(1, 100).payload)));
  ASSERT_NE(last, std::string::npos);
  FaultyDisk::make_unreadable(segment(), last + 50, last + 51);

  const OrderAnswer listed = user.perform(ListDeadLetters{0, "", true});
  EXPECT_EQ(listed.error, "");
  for (const char* part : {"\"id\":1,", "\"id\":4,", "\"id\":7,", "Input/output error"})
    EXPECT_NE(listed.json.find(part), std::string::npos) << listed.json;
  user.store().ask(RetryDeadLetters{topic, 1});
  const auto revived = user.await<DeadLettersRevived>();
  ASSERT_EQ(revived->messages.size(), 1u) << revived->why_failed;
  EXPECT_EQ(revived->messages[0].row, 4u);
  EXPECT_EQ(user.perform(ResendOrder{{{}, "", true}}).json, R"({"left":1,"resent":1})");
  ASSERT_TRUE(user.await<DeadLettersRevived>());
  user.store().ask(RetryDeadLetters{topic, 1});
  EXPECT_FALSE(user.await<DeadLettersRevived>()->why_failed.empty());
  EXPECT_EQ(user.perform(DiscardOrder{{{1}, "", false}}).json, R"({"discarded":1})");
}

/// There are more of them than one commit resends.
TEST_F(StoreDamage, ResendsDeadLettersBehindUnreadableOnes) {
  StoreUser user(directory.path());
  ASSERT_TRUE(user.keep(1, 200, 100));
  std::vector<std::uint64_t> rows;
  for (std::uint64_t row = 1; row <= 200; ++row) rows.push_back(row);
  ASSERT_TRUE(user.make_dead_letters(rows, "refused"));
  const std::string file = read_file(segment());
  const auto end_of = [&](std::uint64_t row) {
    return file.rfind(std::string(as_text(StoreUser::message(row, 100).payload))) + 100;
  };
  FaultyDisk::make_unreadable(segment(), end_of(1) - 50, end_of(100));
  EXPECT_EQ(user.perform(ResendOrder{{{}, "", true}}).json, R"({"left":100,"resent":100})");
  EXPECT_EQ(user.load(0)->messages.size(), 100u);
  const std::string listed = user.perform(ListDeadLetters{0, "", true}).json;
  EXPECT_NE(listed.find(R"({"bytes":100,"code":null,"id":1,)"), std::string::npos)
      << listed.substr(0, 300);
  EXPECT_NE(listed.find(R"("qos":null)"), std::string::npos);
  EXPECT_EQ(listed.find("payload_hex"), std::string::npos);
}

TEST_F(StoreDamage, LeavesADeadLetterThatStaysUnreadableToAnOperator) {
  const std::string topic = "ntnu-slam/robot/r1/update";
  StoreUser user(directory.path());
  ASSERT_TRUE(user.keep(1, 1, 100));
  ASSERT_TRUE(user.make_dead_letters({1}, "refused"));
  const std::uint64_t size = std::filesystem::file_size(segment());
  FaultyDisk::make_unreadable(segment(), size - 50, size - 49);
  std::size_t failures = 0;
  ASSERT_TRUE(eventually([&] {
    user.store().ask(RetryDeadLetters{topic, 1});
    const auto revived = user.await<DeadLettersRevived>();
    EXPECT_TRUE(revived->messages.empty());
    failures += revived->why_failed.empty() ? 0 : 1;
    return revived->why_failed.empty();
  }));
  EXPECT_GT(failures, 1u) << "the disk may fail for a moment only";
  EXPECT_TRUE(user.reports("dead letters on " + topic + " wait for an operator")) << user.notices();
  FaultyDisk::make_unreadable(segment(), 0, 0);
  EXPECT_EQ(user.perform(ResendOrder{{{}, "", true}}).json, R"({"left":0,"resent":1})");
}

/// Letter 4 is read and refused each time in between.
TEST_F(StoreDamage, ReportsAnUnreadableDeadLetterBesideAReadableOne) {
  const std::string topic = "ntnu-slam/robot/r1/update";
  StoreUser user(directory.path());
  ASSERT_TRUE(user.keep(1, 4, 100));
  ASSERT_TRUE(user.make_dead_letters({1, 4}, "refused"));
  const std::string file = read_file(segment());
  const auto last = file.rfind(std::string(as_text(StoreUser::message(1, 100).payload)));
  ASSERT_NE(last, std::string::npos);
  FaultyDisk::make_unreadable(segment(), last + 50, last + 51);
  EXPECT_TRUE(eventually([&] {
    user.store().ask(RetryDeadLetters{topic, 1});
    const auto revived = user.await<DeadLettersRevived>();
    EXPECT_EQ(revived->messages.size(), 1u) << revived->why_failed;
    EXPECT_TRUE(user.make_dead_letters({4}, "refused"));
    return user.notices().find("dead letters on " + topic + " wait for an operator") !=
           std::string::npos;
  })) << user.notices();
}

TEST_F(StoreDamage, ReportsNoDeadLettersForAnOperatorWhereThereAreNone) {
  StoreUser user(directory.path());
  ASSERT_TRUE(user.keep(1, 1, 100));
  std::filesystem::remove(segment());
  FaultyDisk::fails_writes = true;
  user.store().ask(RetryDeadLetters{"ntnu-slam/robot/r1/update", 1});
  EXPECT_FALSE(user.await<DeadLettersRevived>()->why_failed.empty());
  FaultyDisk::fails_writes = false;
  ASSERT_TRUE(user.load(0));
  EXPECT_EQ(user.notices().find("wait for an operator"), std::string::npos) << user.notices();
}

TEST_F(StoreDamage, CountsNoDeadLetterForAMessageThatWasLost) {
  StoreUser user(directory.path());
  ASSERT_TRUE(user.keep(1, 3, 100));
  const std::string file = read_file(segment());
  const auto place = file.find(std::string(as_text(StoreUser::message(2, 100).payload)));
  ASSERT_NE(place, std::string::npos);
  overwrite(segment(), place + 50, "!");
  ASSERT_TRUE(user.make_dead_letters({2}, "refused"));
  const auto changed = user.await<DeadLettersChanged>();
  ASSERT_TRUE(changed) << "the outbox has counted a letter already";
  EXPECT_EQ(changed->dead_letters, DeadLetterCounts{});
}

TEST_F(StoreDamage, SetsAMessageAsideThatTheDiskFailsToReadWhenTheBrokerRefusesIt) {
  StoreUser user(directory.path());
  ASSERT_TRUE(user.keep(1, 3, 100));
  const auto place = read_file(segment()).find(as_text(StoreUser::message(2, 100).payload));
  ASSERT_NE(place, std::string::npos);
  FaultyDisk::make_unreadable(segment(), place + 50, place + 51);
  const BrokerMessage refused = StoreUser::message(2, 100);
  WriteToStore write{{{4, StoreUser::message(4, 100), {}}}, {}, {}};
  write.dead_letters.push_back({2, "refused", 0x87, 1, stored_cost(refused), refused.topic});
  user.store().ask(std::move(write));
  const auto written = user.await_either<StoreWritten, StoreWriteFailed>();
  ASSERT_TRUE(std::holds_alternative<StoreWritten>(written)) << "message 4 is stored";
  const auto changed = user.await<DeadLettersChanged>();
  EXPECT_EQ(changed->dead_letters.count, 1u);
  EXPECT_TRUE(user.reports("cannot be read")) << user.notices();
  const std::string listed = user.perform(ListDeadLetters{0, "", true}).json;
  EXPECT_NE(listed.find(R"("topic":")" + refused.topic), std::string::npos) << listed;
  EXPECT_EQ(user.perform(ResendOrder{{{}, "", true}}).json, R"({"left":1,"resent":0})");
  FaultyDisk::make_unreadable(segment(), 0, 0);
  EXPECT_NE(user.perform(ListDeadLetters{0, "", true}).json.find("payload_hex"), std::string::npos);
  EXPECT_EQ(user.perform(ResendOrder{{{}, "", true}}).json, R"({"left":0,"resent":1})");
  EXPECT_EQ(rows_of(*user.load(0)), (std::vector<std::uint64_t>{1, 2, 3, 4}));
}

TEST_F(StoreDamage, RestoresARemovedFileBeforeItResendsOrDiscardsDeadLetters) {
  StoreUser user(directory.path());
  ASSERT_TRUE(user.keep(1, 3, 100));
  ASSERT_TRUE(user.make_dead_letters({1, 2}, "refused"));
  const std::string path = segment();
  std::filesystem::remove(path);
  user.perform(ResendOrder{{{1}, "", false}});
  EXPECT_TRUE(std::filesystem::exists(path));
  std::filesystem::remove(path);
  user.perform(DiscardOrder{{{2}, "", false}});
  EXPECT_TRUE(std::filesystem::exists(path));
}

TEST_F(StoreDamage, CountsADeadLetterThatWasResentThreeTimesAsOneMessage) {
  {
    StoreUser user(directory.path());
    ASSERT_TRUE(user.keep(1, 10, 100));
    for (int times = 0; times < 3; ++times) {
      ASSERT_TRUE(user.make_dead_letters({4}, "refused"));
      user.perform(ResendOrder{{{}, "", true}});
    }
  }
  overwrite(segment(), std::filesystem::file_size(segment()) - 20, "!");
  StoreUser user(directory.path());
  EXPECT_EQ(user.await<StoreOpened>()->count, 9u);
  EXPECT_EQ(user.notices().find(" 1 messages are lost") == std::string::npos, false);
  expect_intact(*user.load(0), 100);
}

TEST_F(StoreDamage, RestoresAStoreThatIsRemovedWhileOpen) {
  StoreUser user(directory.path());
  ASSERT_TRUE(user.keep(1, 50, 100));
  std::filesystem::remove_all(directory.path());
  EXPECT_TRUE(user.reports("its contents are restored"));
  ASSERT_TRUE(user.keep(51, 1, 100));
  user.store().stop();
  StoreUser next(directory.path());
  EXPECT_EQ(next.await<StoreOpened>()->count, 51u);
  EXPECT_EQ(next.notices(), "");
}

TEST_F(StoreDamage, RestoresARemovedStoreWithItsErasures) {
  StoreUser user(directory.path());
  ASSERT_TRUE(user.keep(1, 50, 100));
  ASSERT_TRUE(user.forget(1, 49));
  std::filesystem::remove_all(directory.path());
  EXPECT_TRUE(user.reports("its contents are restored"));
  user.store().stop();
  StoreUser next(directory.path());
  EXPECT_EQ(next.await<StoreOpened>()->count, 1u);
  EXPECT_EQ(rows_of(*next.load(0)), std::vector<std::uint64_t>{50});
  EXPECT_EQ(next.notices(), "");
}

/// The file cannot be made again, because a directory has the name of its copy.
TEST_F(StoreDamage, WritesErasuresAlsoWhenARemovedFileCannotBeRestored) {
  fill(100);
  const std::string first = segment();
  {
    StoreUser user(directory.path());
    ASSERT_TRUE(user.keep(101, 50, 100));
    FaultyDisk::is_read_only = true;
    ASSERT_TRUE(user.forget(101, 2));
    FaultyDisk::is_read_only = false;
    std::filesystem::remove(first);
    std::filesystem::create_directory(first + ".new");
    user.store().stop();
  }
  StoreUser next(directory.path());
  EXPECT_EQ(next.await<StoreOpened>()->count, 48u);
}

TEST_F(StoreDamage, MovesAwayAFileThatReplacedAnOpenSegment) {
  StoreUser user(directory.path());
  ASSERT_TRUE(user.keep(1, 50, 100));
  write_file(directory / "other", "a foreign file");
  const std::string path = segment();
  std::filesystem::rename(directory / "other", path);
  ASSERT_TRUE(user.keep(51, 1, 100));
  EXPECT_EQ(user.load(0)->messages.size(), 51u);
  EXPECT_EQ(read_file(path + ".replaced"), "a foreign file");
  user.store().stop();
  EXPECT_EQ(StoreUser(directory.path()).await<StoreOpened>()->count, 51u);
}

TEST_F(StoreDamage, ReportsTheMessagesOfAMissingLogAsLost) {
  fill(50);
  std::filesystem::remove(segment());
  StoreUser user(directory.path());
  EXPECT_EQ(user.await<StoreOpened>()->count, 0u);
  EXPECT_NE(user.notices().find(loss_notice(50)), std::string::npos) << user.notices();
}

TEST_F(StoreDamage, ReportsMessagesThatAnOldCopyOfASegmentLacks) {
  StoreUser user(directory.path());
  ASSERT_TRUE(user.keep(1, 50, 100));
  std::filesystem::copy(segment(), directory / "backup");
  ASSERT_TRUE(user.keep(51, 7, 100));
  user.store().stop();
  std::filesystem::rename(directory / "backup", segment());
  StoreUser next(directory.path());
  EXPECT_EQ(next.await<StoreOpened>()->count, 50u);
  EXPECT_NE(next.notices().find(loss_notice(7)), std::string::npos) << next.notices();
}

/// The header of the copy states how many records another segment has.
TEST_F(StoreDamage, LosesNothingWhenASegmentIsCopiedUnderTheNextNumber) {
  fill(100);
  for (std::uint64_t first = 101; first < 400; first += 100) {
    StoreUser user(directory.path());  // each begins a new segment
    ASSERT_TRUE(user.keep(first, first == 101 ? 10 : 100, 100));
  }
  std::vector<std::string> paths;
  for (const auto& file : std::filesystem::directory_iterator(directory / "messages"))
    if (file.path().extension() == ".log") paths.push_back(file.path());
  std::ranges::sort(paths);
  ASSERT_EQ(paths.size(), 4u);
  std::string next = paths[3];
  ++next[next.rfind('/') + 8];
  std::filesystem::copy(paths[2], next);
  StoreUser user(directory.path());
  EXPECT_EQ(user.await<StoreOpened>()->count, 310u);
  EXPECT_EQ(user.notices().find("lost"), std::string::npos) << user.notices();
  EXPECT_NE(user.notices().find("1 files"), std::string::npos) << user.notices();
  ASSERT_TRUE(user.keep(401, 1, 100));
  EXPECT_TRUE(std::filesystem::exists(next + ".stray"));
  expect_intact(*user.load(0), 100);
}

TEST_F(StoreDamage, ReadsARenamedSegment) {
  fill(100);
  const std::string path = segment();
  const std::string other = (std::filesystem::path(path).parent_path() / "00000900").string() +
                            path.substr(path.rfind('/') + 9);
  std::filesystem::rename(path, other);
  StoreUser user(directory.path());
  EXPECT_EQ(user.await<StoreOpened>()->count, 100u);
  EXPECT_EQ(user.notices(), "");
  expect_intact(*user.load(0), 100);
}

TEST_F(StoreDamage, SegmentsOfAnotherStoreAreLeftAloneAndReported) {
  const TempDir others;
  {
    StoreUser other(others.path(), 1u << 20);
    for (std::uint64_t row = 1; row < 1000; row += 100) ASSERT_TRUE(other.keep(row, 100, 1000));
  }
  fill(10);
  for (const auto& file : std::filesystem::directory_iterator(others / "messages"))
    if (file.path().extension() == ".log")
      std::filesystem::copy(file.path(), directory / "messages");
  StoreUser user(directory.path());
  EXPECT_EQ(user.await<StoreOpened>()->count, 10u);
  EXPECT_NE(user.notices().find("belong to another store"), std::string::npos) << user.notices();
}

/// All records fail their checksums; none may look like the beginning of a long one.
TEST_F(StoreDamage, ReadsSwappedSegmentsQuickly) {
  for (std::uint64_t first = 1; first < 40000; first += 20000) {
    StoreUser user(directory.path());
    ASSERT_TRUE(user.keep(first, 20000, 20));
  }
  std::vector<std::string> paths;
  for (const auto& file : std::filesystem::directory_iterator(directory / "messages"))
    if (file.path().extension() == ".log") paths.push_back(file.path());
  ASSERT_EQ(paths.size(), 2u);
  std::string one = read_file(paths[0]);
  std::string other = read_file(paths[1]);
  std::swap_ranges(one.begin() + 32, one.begin() + 1500000, other.begin() + 32);
  write_file(paths[0], one, 0600);
  write_file(paths[1], other, 0600);
  StoreUser user(directory.path());
  const auto opened = user.await<StoreOpened>();
  ASSERT_TRUE(opened) << "within the time that a test waits";
  EXPECT_NE(user.notices().find(loss_notice(40000 - opened->count)), std::string::npos)
      << user.notices();
}

TEST_F(StoreDamage, LinksAndFifosAreNotFollowed) {
  fill(10);
  write_file(directory / "victim", "foreign file", 0600);
  std::filesystem::remove(directory / "messages/tally");
  std::filesystem::create_symlink(directory / "victim", directory / "messages/tally");
  {
    StoreUser user(directory.path());
    ASSERT_TRUE(user.await<StoreAbsent>());
  }
  std::filesystem::remove(directory / "messages/tally");
  mkfifo((segment() + ".erased").c_str(), 0600);
  StoreUser user(directory.path());
  ASSERT_TRUE(user.await<StoreAbsent>()) << "and it does not hang";
  EXPECT_EQ(read_file(directory / "victim"), "foreign file");
}

TEST_F(StoreDamage, RemovesSegmentsWhoseMessagesAreDelivered) {
  StoreUser user(directory.path(), 4u << 20);
  for (std::uint64_t row = 1; row <= 2000; row += 100) ASSERT_TRUE(user.keep(row, 100, 1000));
  EXPECT_GE(segments(), 20u);
  ASSERT_TRUE(user.forget(1, 1500));
  EXPECT_LT(segments(), 12u);
  EXPECT_EQ(rows_of(*user.load(0)).front(), 1501u);
}

/// One message in a hundred waits for ever, like those of a refused topic.
TEST_F(StoreDamage, WaitingMessagesDoNotKeepSegmentsOfDeliveredOnes) {
  {
    StoreUser user(directory.path(), 4u << 20);
    for (std::uint64_t row = 1; row <= 20000; row += 100) {
      ASSERT_TRUE(user.keep(row, 100, 1000));
      ASSERT_TRUE(user.forget(row + 1, 99));
    }
    EXPECT_LT(segments(), 20u) << "of 300 that were written";
    EXPECT_EQ(user.load(0)->messages.size(), 200u);
  }
  StoreUser user(directory.path(), 4u << 20);
  EXPECT_EQ(user.await<StoreOpened>()->count, 200u);
  const auto loaded = user.load(0);
  ASSERT_EQ(loaded->messages.size(), 200u);
  expect_intact(*loaded, 1000);
  EXPECT_EQ(rows_of(*user.load(10000)).front(), 10001u);
  ASSERT_TRUE(user.forget(1, 20000));
  EXPECT_EQ(user.load(0)->messages.size(), 0u);
  EXPECT_EQ(segments(), 1u);
}

}  // namespace
}  // namespace slamgw::test
