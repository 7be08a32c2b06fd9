// SPDX-License-Identifier: Apache-2.0
// Damage at random places in files of a process that was killed or stopped. Each message is loaded
// unchanged, is a dead letter, or is reported as lost. The reported numbers are right.
// SLAMGW_WALKS=n walks longer than the default.
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <random>
#include <regex>

#include "tests/storage/store_user.hpp"
#include "tests/support/temp_dir.hpp"

namespace slamgw::test {
namespace {

namespace fs = std::filesystem;

class Walk {
 public:
  explicit Walk(std::uint64_t seed) : random_(seed) {}

  void run() {
    store_messages();
    const std::string damage = do_damage();
    SCOPED_TRACE(damage);
    judge();
  }

 private:
  std::uint64_t below(std::uint64_t limit) {
    return std::uniform_int_distribution<std::uint64_t>(0, limit - 1)(random_);
  }

  /// Stores messages, erases some, makes dead letters of others; stops or kills the process.
  void store_messages() {
    const TempDir alive;
    StoreUser user(alive.path(), 1u << 20);
    std::uint64_t row = 0;
    const std::uint64_t steps = 5 + below(25);
    for (std::uint64_t step = 0; step < steps; ++step) {
      WriteToStore write;
      for (std::uint64_t i = below(12); i > 0; --i) {
        const std::size_t size = below(10) == 0 ? below(20000) : below(300);
        write.keep.push_back({++row, StoreUser::message(row, size), {}});
        kept_[row] = size;
      }
      for (std::uint64_t i = below(6); i > 0 && !kept_.empty(); --i) {
        const auto one = std::next(kept_.begin(), static_cast<std::ptrdiff_t>(below(kept_.size())));
        if (below(4) == 0) {
          write.dead_letters.push_back({one->first, "refused", 0x87, 3});
          dead_[one->first] = one->second;
        } else {
          write.forget.push_back(one->first);
          forgotten_.insert(*one);
        }
        kept_.erase(one);
      }
      user.store().ask(std::move(write));
      ASSERT_TRUE(user.await<StoreWritten>());
    }
    if (below(3) == 0) user.store().stop();
    fs::copy(alive.path(), directory_.path(), fs::copy_options::recursive);
  }

  std::string do_damage() {
    std::vector<std::string> files;
    for (const auto& file : fs::directory_iterator(directory_ / "messages"))
      files.push_back(file.path());
    std::ranges::sort(files);
    const std::string victim = files[below(files.size())];
    const std::uint64_t size = fs::file_size(victim);
    if (size == 0) return "none";
    std::string octets = read_file(victim);
    const std::uint64_t kind = below(6);
    std::uint64_t at = below(size);
    std::string what = "a flipped bit";
    if (kind == 0) {
      what = "cut off";
      octets.resize(at);
    } else if (kind < 3) {
      octets[at] = static_cast<char>(octets[at] ^ (1 << below(8)));
    } else {
      const std::uint64_t length = kind == 3 ? 512 : 4096;
      at -= at % length;
      what = kind == 5 ? "a page of nonsense" : "zeroes";
      for (std::uint64_t i = at; i < std::min(size, at + length); ++i)
        octets[i] = kind == 5 ? static_cast<char>(below(256)) : '\0';
    }
    write_file(victim, octets, 0600);
    return what + " at " + std::to_string(at) + " of " + std::to_string(size) + " in " +
           fs::path(victim).filename().string();
  }

  void judge() {
    StoreUser user(directory_.path(), 1u << 20);
    ASSERT_TRUE(user.await<StoreOpened>()) << user.notices();
    std::map<std::uint64_t, std::size_t> delivered;
    for (std::uint64_t cursor = 0;;) {
      const auto loaded = user.load(cursor, 100);
      ASSERT_TRUE(loaded);
      EXPECT_TRUE(loaded->damaged.empty());
      for (const StoredMessage& stored : loaded->messages) {
        check(stored);
        delivered[stored.row] = stored.message.payload.size();
        cursor = std::max(cursor, stored.row);
      }
      if (loaded->messages.empty()) break;
    }
    std::set<std::uint64_t> letters;
    for (std::uint64_t after = 0;;) {
      const auto page = nlohmann::json::parse(user.perform(ListDeadLetters{after, "", false}).json);
      if (!page["more"].get<bool>()) break;
      for (const auto& letter : page["letters"]) letters.insert(after = letter["id"]);
    }
    std::size_t missing = 0;
    for (const auto& [row, size] : kept_) missing += delivered.contains(row) ? 0 : 1;
    const std::size_t again = delivered.size() - (kept_.size() - missing);
    for (const auto& [row, size] : dead_) missing += letters.contains(row) ? 0 : 1;
    const std::size_t at_most = reported(user.notices(), "([0-9]+) messages are lost");
    const std::size_t at_least =
        reported(user.notices(), "([0-9]+)( to [0-9]+)? messages are lost");
    EXPECT_LE(missing, at_most) << user.notices();
    EXPECT_GE(missing, at_least) << user.notices();
    EXPECT_TRUE(user.keep(1000000, 1));
    totals().missing += missing;
    totals().again += again;
    totals().messages += kept_.size() + dead_.size();
  }

  void check(const StoredMessage& stored) {
    const auto known = [&](const std::map<std::uint64_t, std::size_t>& rows) {
      const auto found = rows.find(stored.row);
      return found != rows.end() && found->second == stored.message.payload.size();
    };
    ASSERT_TRUE(known(kept_) || known(forgotten_) || known(dead_)) << stored.row;
    const BrokerMessage expected = StoreUser::message(stored.row, stored.message.payload.size());
    EXPECT_EQ(stored.message.topic, expected.topic);
    EXPECT_EQ(stored.message.payload, expected.payload);
    EXPECT_EQ(stored.message.qos, expected.qos);
    EXPECT_EQ(stored.message.retain, expected.retain);
  }

  static std::size_t reported(const std::string& notices, const char* pattern) {
    std::smatch match;
    return std::regex_search(notices, match, std::regex(pattern)) ? std::stoul(match[1]) : 0;
  }

 public:
  struct Totals {
    std::size_t messages = 0;
    std::size_t missing = 0;
    std::size_t again = 0;
  };
  static Totals& totals() {
    static Totals totals;
    return totals;
  }

 private:
  std::mt19937_64 random_;
  TempDir directory_;
  std::map<std::uint64_t, std::size_t> kept_;  // payload sizes by row
  std::map<std::uint64_t, std::size_t> forgotten_;
  std::map<std::uint64_t, std::size_t> dead_;
};

TEST(StoreWalk, DeliversEachMessageUnchangedOrReportsItAsLost) {
  const char* const walks = std::getenv("SLAMGW_WALKS");
  const std::uint64_t count = walks ? std::stoull(walks) : 15;
  for (std::uint64_t seed = 1; seed <= count && !testing::Test::HasFailure(); ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    Walk(seed).run();
  }
  const Walk::Totals& totals = Walk::totals();
  EXPECT_LT(totals.missing * 10, totals.messages) << "damage to one place costs little";
  RecordProperty("missing", static_cast<int>(totals.missing));
  std::cout << totals.messages << " messages, " << totals.missing << " missing, " << totals.again
            << " delivered again\n";
}

}  // namespace
}  // namespace slamgw::test
