// SPDX-License-Identifier: Apache-2.0
// What a failing disk and a damaged file do to the store: a disk that fails for a moment costs
// nothing; of a damaged file everything that can be read is delivered, and the rest is told.
#include <gtest/gtest.h>

#include <chrono>

#include <filesystem>
#include <fstream>

#include "daemon/storage/sqlite.hpp"
#include "daemon/storage/store_file.hpp"
#include "tests/storage/faulty_disk.hpp"
#include "tests/storage/store_user.hpp"
#include "tests/support/temp_dir.hpp"

namespace slamgw::test {
namespace {

constexpr std::size_t page_bytes = 4096;

std::size_t count_aside(const std::string& directory, const std::string& word = "corrupt") {
  std::size_t count = 0;
  for (const auto& file : std::filesystem::directory_iterator(directory)) {
    const std::string name = file.path().filename();
    if (name.starts_with("messages.db." + word + "-") && !name.ends_with("-wal")) ++count;
  }
  return count;
}

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

/// Every message that came is the one that was stored under its number.
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
  /// A store with these messages, all of them in the database file.
  void fill(std::uint64_t count, std::size_t payload_bytes = 100) {
    StoreUser user(directory.path());
    ASSERT_TRUE(user.keep(1, count, payload_bytes));
  }
  /// The same as a kill -9 leaves it: with a log.
  void fill_and_die(std::uint64_t count, std::size_t payload_bytes = 100) {
    const TempDir alive;
    StoreUser user(alive.path());
    for (std::uint64_t row = 1; row <= count; ++row) ASSERT_TRUE(user.keep(row, 1, payload_bytes));
    for (const char* const name : {"messages.db", "messages.db-wal", "messages.db-tally"})
      std::filesystem::copy(alive / name, directory / name);
  }

  FaultyDisk disk;
  TempDir directory;
  const std::string path = directory / "messages.db";
};

TEST_F(StoreDamage, ADiskThatCannotBeReadForAMomentCostsNothing) {
  fill(300);
  FaultyDisk::fails_reads = true;
  StoreUser user(directory.path());
  EXPECT_TRUE(eventually([] { return FaultyDisk::failed_reads > 50; }));
  FaultyDisk::fails_reads = false;
  const auto opened = user.await<StoreOpened>();
  ASSERT_TRUE(opened);
  EXPECT_EQ(opened->count, 300u);
  EXPECT_EQ(user.load(0)->messages.size(), 300u);
  EXPECT_EQ(count_aside(directory.path()), 0u);
  EXPECT_EQ(user.notices(), "");
}

TEST_F(StoreDamage, ADiskThatFailsWhileTheStoreIsOpenCostsNothingEither) {
  fill_and_die(300);
  StoreUser user(directory.path());
  ASSERT_TRUE(user.await<StoreOpened>());
  FaultyDisk::fails_reads = FaultyDisk::fails_writes = true;
  user.store().ask(WriteToStore{1, {{301, StoreUser::message(301, 100), {}}}, {}, {}});
  ASSERT_TRUE(user.await<StoreWriteFailed>());
  user.store().ask(LoadFromStore{1, 0, 1000, 1u << 20, {}});
  ASSERT_TRUE(user.await<StoreLoadFailed>());
  FaultyDisk::fails_reads = FaultyDisk::fails_writes = false;
  ASSERT_TRUE(user.keep(301, 1, 100));
  EXPECT_EQ(user.load(0)->messages.size(), 301u);
  EXPECT_EQ(count_aside(directory.path()), 0u);
}

TEST_F(StoreDamage, APartThatStaysUnreadableIsLostAndTheRestDelivered) {
  fill(600);
  FaultyDisk::make_unreadable(path, 6 * page_bytes, 6 * page_bytes + 512);
  StoreUser user(directory.path());
  const auto opened = user.await<StoreOpened>();
  ASSERT_TRUE(opened);
  EXPECT_LT(opened->count, 600u);
  EXPECT_GT(opened->count, 550u);
  const auto loaded = user.load(0);
  EXPECT_EQ(loaded->messages.size(), opened->count);
  expect_intact(*loaded, 100);
  const std::string lost = std::to_string(600 - opened->count) + " are lost";
  EXPECT_NE(user.notices().find(lost), std::string::npos) << user.notices();
  EXPECT_EQ(count_aside(directory.path()), 1u);
}

TEST_F(StoreDamage, ADiskThatIsAwayForLongIsNotTakenForDamage) {
  fill(300);
  FaultyDisk::fails_reads = true;
  StoreUser user(directory.path());
  ASSERT_TRUE(user.await<StoreAbsent>()) << "the daemon does not wait for ever";
  EXPECT_NE(user.notices().find("no store"), std::string::npos);
  FaultyDisk::fails_reads = false;
  EXPECT_EQ(user.await<StoreOpened>()->count, 300u);
  EXPECT_EQ(count_aside(directory.path()), 0u);
}

TEST_F(StoreDamage, AZeroedPageCostsWhatWasInIt) {
  for (const std::size_t bytes : {std::size_t{512}, page_bytes}) {
    for (const std::size_t page : {0, 1, 2, 7}) {
      std::filesystem::remove_all(directory.path());
      fill(600);
      overwrite(path, page * page_bytes, std::string(bytes, '\0'));
      StoreUser user(directory.path());
      const auto opened = user.await<StoreOpened>();
      ASSERT_TRUE(opened);
      const auto loaded = user.load(0);
      EXPECT_GE(loaded->messages.size(), 560u) << page;
      expect_intact(*loaded, 100);
      const std::string lost = std::to_string(600 - loaded->messages.size()) + " are lost";
      EXPECT_NE(user.notices().find(lost), std::string::npos) << user.notices();
      EXPECT_TRUE(user.keep(601, 1, 100));
    }
  }
}

TEST_F(StoreDamage, AFlippedOctetInAPayloadIsNotDelivered) {
  fill(100);
  const std::string file = read_file(path);
  const Bytes payload = StoreUser::message(40, 100).payload;
  const std::size_t at = file.find(std::string(as_text(payload)));
  ASSERT_NE(at, std::string::npos);
  overwrite(path, at + 50, "!");
  StoreUser user(directory.path());
  ASSERT_EQ(user.await<StoreOpened>()->count, 100u) << "SQLite does not see it";
  const auto loaded = user.load(0);
  EXPECT_EQ(loaded->messages.size(), 99u);
  EXPECT_EQ(loaded->damaged, std::vector<std::uint64_t>{40});
  expect_intact(*loaded, 100);
  EXPECT_EQ(user.await<DeadLettersChanged>()->dead_letters.count, 1u);
  EXPECT_NE(user.notices().find("1 messages in " + path + " are damaged"), std::string::npos)
      << user.notices();
}

TEST_F(StoreDamage, ALogThatLostItsEndIsNoticed) {
  fill_and_die(100);
  const auto size = std::filesystem::file_size(path + "-wal");
  std::filesystem::resize_file(path + "-wal", size / 3);
  StoreUser user(directory.path());
  const auto loaded = (user.await<StoreOpened>(), user.load(0));
  ASSERT_TRUE(loaded);
  EXPECT_LT(loaded->messages.size(), 100u);
  EXPECT_GT(loaded->messages.size(), 20u);
  expect_intact(*loaded, 100);
  const std::string lost = std::to_string(100 - loaded->messages.size()) + " are lost";
  EXPECT_NE(user.notices().find(lost), std::string::npos) << user.notices();
}

TEST_F(StoreDamage, DamageInTheMiddleOfTheLogDoesNotHideWhatIsBehindIt) {
  fill_and_die(100);
  const auto size = std::filesystem::file_size(path + "-wal");
  overwrite(path + "-wal", size / 2, std::string(512, '\xee'));
  StoreUser user(directory.path());
  ASSERT_TRUE(user.await<StoreOpened>());
  const auto loaded = user.load(0);
  EXPECT_GE(loaded->messages.size(), 98u) << user.notices();
  expect_intact(*loaded, 100);
}

TEST_F(StoreDamage, ALogWithoutItsBeginningIsReadAllTheSame) {
  fill_and_die(100);
  overwrite(path + "-wal", 0, std::string(32, '\0'));
  StoreUser user(directory.path());
  ASSERT_TRUE(user.await<StoreOpened>());
  const auto loaded = user.load(0);
  EXPECT_EQ(loaded->messages.size(), 100u) << user.notices();
  expect_intact(*loaded, 100);
}

TEST_F(StoreDamage, LargeMessagesAreSavedToo) {
  fill(50, 20000);
  overwrite(path, page_bytes, std::string(512, '\0'));  // the root of the messages
  StoreUser user(directory.path());
  const auto loaded = (user.await<StoreOpened>(), user.load(0, 1000, 1u << 24));
  EXPECT_EQ(loaded->messages.size(), 50u) << user.notices();
  expect_intact(*loaded, 20000);
}

TEST_F(StoreDamage, WhatWasPutAsideIsNeverOverwritten) {
  for (int i = 0; i < 3; ++i) {
    write_file(path, std::string(9000, static_cast<char>('x' + i)));
    std::filesystem::remove(path + "-wal");
    StoreUser user(directory.path());
    ASSERT_TRUE(user.await<StoreOpened>());
  }
  EXPECT_EQ(count_aside(directory.path()), 3u);
}

TEST_F(StoreDamage, AFailingDiskDoesNotFillItselfWithDamagedFiles) {
  for (int i = 0; i < 9; ++i) {
    const std::string aside = path + ".corrupt-20260101T00000" + std::to_string(i) + "Z";
    write_file(aside, "");
    write_file(aside + "-wal", "");
  }
  write_file(path, std::string(9000, 'x'));
  StoreUser user(directory.path());
  ASSERT_TRUE(user.await<StoreOpened>()) << user.notices();
  EXPECT_EQ(count_aside(directory.path()), max_damaged_files);
  EXPECT_FALSE(std::filesystem::exists(path + ".corrupt-20260101T000005Z")) << "the oldest go";
  EXPECT_FALSE(std::filesystem::exists(path + ".corrupt-20260101T000005Z-wal"));
  EXPECT_TRUE(std::filesystem::exists(path + ".corrupt-20260101T000006Z"));
}

TEST_F(StoreDamage, FilesOfOthersThatWerePutAsideAreNeverRemoved) {
  for (std::size_t i = 0; i < max_files_aside; ++i)
    write_file(path + ".replaced-20260101T0000" + std::to_string(10 + i) + "Z", "");
  write_file(path, std::string(9000, 'x'));
  StoreUser user(directory.path());
  ASSERT_TRUE(user.await<StoreAbsent>());
  EXPECT_NE(user.notices().find("move them away"), std::string::npos) << user.notices();
  std::filesystem::remove(path + ".replaced-20260101T000010Z");
  EXPECT_TRUE(user.await<StoreOpened>()) << "as soon as somebody has looked";
}

TEST_F(StoreDamage, DamageWhileTheStoreIsOpenIsMendedBehindTheOutbox) {
  fill(3000, 2000);  // more than SQLite's cache holds
  StoreUser user(directory.path());
  ASSERT_EQ(user.await<StoreOpened>()->count, 3000u);
  ASSERT_EQ(user.load(0, 100)->messages.size(), 100u);
  for (std::size_t page = 1400; page < 1410; ++page)
    overwrite(path, page * page_bytes, std::string(page_bytes, '\0'));
  std::uint64_t cursor = 100;
  std::size_t delivered = 100;
  const auto patience = std::chrono::steady_clock::now() + std::chrono::seconds{30};
  while (std::chrono::steady_clock::now() < patience) {  // it answers failures until it is whole
    user.store().ask(LoadFromStore{1, cursor, 100, 1u << 20, {}});
    const auto answer = user.await_either<StoreLoaded, StoreLoadFailed>();
    if (std::holds_alternative<StoreLoadFailed>(answer)) continue;
    const auto& loaded = std::get<StoreLoaded>(answer);
    if (loaded.messages.empty()) break;
    expect_intact(loaded, 2000);
    delivered += loaded.messages.size();
    EXPECT_GT(loaded.messages.front().row, cursor);
    cursor = loaded.messages.back().row;
  }
  EXPECT_LT(delivered, 3000u);
  EXPECT_GE(delivered, 2970u);
  EXPECT_NE(user.notices().find(std::to_string(3000 - delivered) + " are lost"), std::string::npos)
      << user.notices();
  EXPECT_FALSE(user.was_absent()) << "for the outbox it was never away";
}

TEST_F(StoreDamage, AWriteThatWasNotConfirmedIsNotDeliveredTwice) {
  fill(3000, 2000);
  StoreUser user(directory.path());
  ASSERT_TRUE(user.await<StoreOpened>());
  FaultyDisk::fails_syncs = true;
  user.store().ask(WriteToStore{1, {{3001, StoreUser::message(3001, 10), {}}}, {}, {}});
  ASSERT_TRUE(user.await<StoreWriteFailed>()) << "although its octets are in the log";
  FaultyDisk::fails_syncs = false;
  overwrite(path, 1400 * page_bytes, std::string(page_bytes, '\0'));
  user.store().ask(LoadFromStore{1, 1300, 1000, 1u << 24, {}});
  ASSERT_TRUE(user.await<StoreLoadFailed>());
  EXPECT_TRUE(user.says("was damaged"));
  const auto loaded = user.load(2900);
  ASSERT_TRUE(loaded);
  EXPECT_EQ(rows_of(*loaded).back(), 3000u);
  EXPECT_TRUE(user.keep(3001, 1)) << "the outbox tries again, under the same number or another";
}

TEST_F(StoreDamage, AFileThatIsRemovedWhileItIsOpenIsWrittenAgain) {
  StoreUser user(directory.path());
  ASSERT_TRUE(user.keep(1, 50, 100));
  std::filesystem::remove_all(directory.path());
  EXPECT_TRUE(user.says("is there again"));
  ASSERT_TRUE(user.keep(51, 1, 100));
  user.store().stop();
  StoreUser next(directory.path());
  EXPECT_EQ(next.await<StoreOpened>()->count, 51u);
  EXPECT_EQ(next.notices(), "");
}

TEST_F(StoreDamage, AFileThatIsReplacedWhileItIsOpenIsPutAside) {
  StoreUser user(directory.path());
  ASSERT_TRUE(user.keep(1, 50, 100));
  write_file(directory / "other", "what somebody put there");
  std::filesystem::rename(directory / "other", path);
  ASSERT_TRUE(user.keep(51, 1, 100));
  EXPECT_EQ(user.load(0)->messages.size(), 51u);
  EXPECT_EQ(count_aside(directory.path(), "replaced"), 1u);
  user.store().stop();
  EXPECT_EQ(StoreUser(directory.path()).await<StoreOpened>()->count, 51u);
}

TEST_F(StoreDamage, ALogThatIsRemovedWhileItIsOpenLosesNothing) {
  StoreUser user(directory.path());
  ASSERT_TRUE(user.keep(1, 50, 100));
  std::filesystem::remove(path + "-wal");
  ASSERT_TRUE(user.keep(51, 1, 100));
  for (const char* const name : {"messages.db", "messages.db-wal"})
    EXPECT_TRUE(std::filesystem::exists(directory / name)) << name;
  user.store().stop();
  EXPECT_EQ(StoreUser(directory.path()).await<StoreOpened>()->count, 51u);
}

TEST_F(StoreDamage, AFileThatIsGoneAtTheStartIsMissed) {
  fill(50);
  std::filesystem::remove(path);
  StoreUser user(directory.path());
  EXPECT_EQ(user.await<StoreOpened>()->count, 0u);
  EXPECT_NE(user.notices().find("50 messages and 0 dead letters that were stored are not in it"),
            std::string::npos)
      << user.notices();
}

TEST_F(StoreDamage, AnOldCopyOfTheFileIsNotTakenForTheFile) {
  fill(50);
  std::filesystem::copy(path, directory / "backup");
  {
    StoreUser user(directory.path());
    ASSERT_TRUE(user.await<StoreOpened>());
    ASSERT_TRUE(user.keep(51, 7, 100));
  }
  std::filesystem::rename(directory / "backup", path);
  StoreUser user(directory.path());
  EXPECT_EQ(user.await<StoreOpened>()->count, 50u);
  EXPECT_NE(user.notices().find("7 are lost"), std::string::npos) << user.notices();
}

TEST_F(StoreDamage, WhatAnEarlierProcessSavedIsPutInPlace) {
  fill(50);
  std::filesystem::rename(path, path + "-saved");
  write_file(path, std::string(9000, 'x'));
  StoreUser user(directory.path());
  EXPECT_EQ(user.await<StoreOpened>()->count, 50u);
  EXPECT_EQ(count_aside(directory.path()), 1u);
}

}  // namespace
}  // namespace slamgw::test
