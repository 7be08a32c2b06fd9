// SPDX-License-Identifier: Apache-2.0
// One process's message store on a real file: sends requests and records the answers.
#pragma once

#include <algorithm>
#include <deque>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "daemon/storage/disk_store.hpp"
#include "tests/support/eventually.hpp"

namespace slamgw::test {

inline constexpr std::uint64_t plenty = 1u << 28;
/// As in the daemon, but shorter: reopen, look, opening, unreadable.
inline constexpr StorePatience short_patience{
    std::chrono::milliseconds{200}, std::chrono::milliseconds{20}, std::chrono::milliseconds{2000},
    std::chrono::milliseconds{600}};

class StoreUser {
 public:
  explicit StoreUser(const std::string& directory, std::uint64_t max_bytes = plenty)
      : store_(
            io_, {directory, max_bytes},
            [this](StoreEvent event) {
              if (const auto* revived = std::get_if<DeadLettersRevived>(&event))
                for (const FormerLetter& message : revived->messages)
                  resent_.push_back(message.row);
              events_.push_back(std::move(event));
            },
            short_patience) {
    store_.start();
  }

  /// Returns the next event of this kind, or null when none comes. Drops earlier events.
  template <class Event>
  std::unique_ptr<Event> await() {
    std::unique_ptr<Event> found;
    eventually(io_, [&] {
      while (!events_.empty() && !found) {
        note(events_.front());
        if (auto* event = std::get_if<Event>(&events_.front())) {
          found = std::make_unique<Event>(std::move(*event));
        }
        events_.pop_front();
      }
      return found != nullptr;
    });
    return found;
  }
  /// Returns the next event of either kind.
  template <class One, class Other>
  StoreEvent await_either() {
    std::optional<StoreEvent> found;
    eventually(io_, [&] {
      while (!events_.empty() && !found) {
        note(events_.front());
        const bool is_wanted = std::holds_alternative<One>(events_.front()) ||
                               std::holds_alternative<Other>(events_.front());
        if (is_wanted) found = std::move(events_.front());
        events_.pop_front();
      }
      return found.has_value();
    });
    return found.value_or(Notice{});
  }
  bool keep(std::uint64_t first, std::uint64_t count, std::size_t payload_bytes = 10) {
    WriteToStore write;
    for (std::uint64_t row = first; row < first + count; ++row) {
      write.keep.push_back({row, message(row, payload_bytes), {}});
    }
    store_.ask(std::move(write));
    return await<StoreWritten>() != nullptr;
  }
  bool forget(std::uint64_t first, std::uint64_t count) {
    WriteToStore write;
    for (std::uint64_t row = first; row < first + count; ++row) write.forget.push_back(row);
    store_.ask(std::move(write));
    return await<StoreWritten>() != nullptr;
  }
  std::unique_ptr<StoreLoaded> load(std::uint64_t after, std::size_t max_messages = 1000,
                                    std::size_t max_bytes = 1u << 20) {
    store_.ask(LoadFromStore{after, max_messages, max_bytes});
    return await<StoreLoaded>();
  }
  bool make_dead_letters(const std::vector<std::uint64_t>& rows, const std::string& reason) {
    WriteToStore write;
    for (const std::uint64_t row : rows) write.dead_letters.push_back({row, reason, 0x87, 5});
    store_.ask(std::move(write));
    return await<StoreWritten>() != nullptr;
  }
  /// Returns the answer to an operator's order.
  OrderAnswer perform(StoreOrder order) {
    std::optional<OrderAnswer> answer;
    store_.perform(std::move(order), [&](OrderAnswer given) { answer = std::move(given); });
    eventually(io_, [&] { return answer.has_value(); });
    return answer.value_or(OrderAnswer{{}, "no answer"});
  }
  /// Dead letters that became messages again.
  const std::vector<std::uint64_t>& resent() const { return resent_; }

  /// Returns a message that differs for each row.
  static BrokerMessage message(std::uint64_t row, std::size_t payload_bytes) {
    Bytes payload(payload_bytes);
    for (std::size_t i = 0; i < payload.size(); ++i)
      payload[i] = static_cast<std::uint8_t>(row >> (i % 4 * 8));
    return {"ntnu-slam/robot/r" + std::to_string(row % 3) + "/update", std::move(payload),
            row % 2 ? Qos::at_least_once : Qos::exactly_once, row % 5 == 0};
  }
  /// Returns true once a notice contains this text.
  bool reports(const std::string& text) {
    return eventually(io_, [&] {
      while (!events_.empty()) {
        note(events_.front());
        events_.pop_front();
      }
      return notices_.find(text) != std::string::npos;
    });
  }
  const std::string& notices() const { return notices_; }
  bool was_absent() const { return was_absent_; }
  /// The newest segment of the messages in `directory`; empty when there is none.
  static std::string newest_segment(const std::string& directory,
                                    const std::string& log = "messages") {
    std::string newest;
    for (const auto& file : std::filesystem::directory_iterator(directory + "/" + log))
      if (file.path().extension() == ".log") newest = std::max(newest, file.path().string());
    return newest;
  }
  DiskStore& store() { return store_; }

 private:
  void note(const StoreEvent& event) {
    was_absent_ = was_absent_ || std::holds_alternative<StoreAbsent>(event);
    if (const auto* notice = std::get_if<Notice>(&event)) notices_ += notice->text + "\n";
    if (const auto* lost = std::get_if<MessagesLost>(&event)) notices_ += lost->text + "\n";
  }

  boost::asio::io_context io_;
  std::deque<StoreEvent> events_;
  std::string notices_;
  bool was_absent_ = false;
  std::vector<std::uint64_t> resent_;
  DiskStore store_;
};

}  // namespace slamgw::test
