// SPDX-License-Identifier: Apache-2.0
// Lists and discards dead letters in the log for operators, and gives them to the outbox page by
// page to be sent again, as operators order or the outbox asks. Part of DiskStore; on its thread
// only.
#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/steady_timer.hpp>
#include <functional>
#include <optional>
#include <set>
#include <vector>

#include "daemon/core/operator_order.hpp"
#include "daemon/delivery/message_store.hpp"
#include "daemon/storage/message_log.hpp"

namespace slamgw {

class DeadLetterDesk {
 public:
  /// One page of a list, and of what is given to the outbox at once.
  static constexpr std::size_t page_letters = 256;
  static constexpr std::size_t page_bytes = 256u << 10;

  /// `patience`: an outbox that has kept none of a page for so long has no room for it, or cannot
  /// store it.
  DeadLetterDesk(boost::asio::io_context& thread, std::chrono::milliseconds patience,
                 std::function<void(ResendDeadLetters)> resend)
      : patience_(patience), resend_(std::move(resend)), timer_(thread) {}

  /// These answer at once, or throw LogError.
  OrderAnswer perform(const ListDeadLetters& order, MessageLog& log) const;
  OrderAnswer perform(const DiscardOrder& order, MessageLog& log) const;
  /// Answers when the outbox has kept all, or takes no more.
  void perform(const ResendOrder& order, MessageLog& log, OrderDone done);
  /// Answers at once. Throws LogError.
  void perform(const RetryDeadLetters& retry, MessageLog& log) const;
  /// After each write: what the outbox has kept is sent again.
  void on_written(const WriteToStore& write, MessageLog& log);

 private:
  struct Resending {
    std::vector<std::uint64_t> ids;  ///< in the order of sending
    std::size_t next = 0;            ///< index of the first that was not given to the outbox
    std::set<std::uint64_t> given;   ///< to the outbox, which has not kept them yet
    std::size_t resent = 0;
    OrderDone done;
  };
  void give_page(MessageLog& log);
  void wait();
  void finish();

  const std::chrono::milliseconds patience_;
  const std::function<void(ResendDeadLetters)> resend_;
  boost::asio::steady_timer timer_;
  std::optional<Resending> resending_;
};

}  // namespace slamgw
