// SPDX-License-Identifier: Apache-2.0
// Puts work off to the end of the loop's present handler, so that all that one wake-up brings is
// written together. A post to the loop would cost another epoll_wait. One for each io_context.
#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/post.hpp>
#include <functional>
#include <utility>
#include <vector>

namespace slamgw {

class LoopTurn final : public boost::asio::execution_context::service {
 public:
  using key_type = LoopTurn;
  static inline boost::asio::execution_context::id id;

  explicit LoopTurn(boost::asio::execution_context& io)
      : service(io), io_(static_cast<boost::asio::io_context&>(io)) {}
  static LoopTurn& of(boost::asio::io_context& io) {
    return boost::asio::use_service<LoopTurn>(io);
  }

  /// Calls `handler`, then the tasks that it put off. What these put off is posted, so that a long
  /// queue leaves room for other handlers.
  template <class Handler>
  void run(Handler handler) {
    if (std::exchange(is_running_, true)) return handler();
    handler();
    is_running_ = false;
    for (const Task& task : std::exchange(tasks_, {})) task();
  }
  /// Calls `task` at the end of the present run(); outside of one, after the present handler.
  void at_end(std::function<void()> task) {
    if (!is_running_) return boost::asio::post(io_, std::move(task));
    tasks_.push_back(std::move(task));
  }

 private:
  using Task = std::function<void()>;

  void shutdown() override { tasks_.clear(); }

  boost::asio::io_context& io_;
  std::vector<Task> tasks_;
  bool is_running_ = false;
};

}  // namespace slamgw
