// SPDX-License-Identifier: Apache-2.0
#include "ctl/host/replay.hpp"

#include <unistd.h>

#include <boost/asio/executor_work_guard.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/steady_timer.hpp>
#include <optional>
#include <utility>

#include "ctl/connection.hpp"
#include "daemon/mqtt/upstream.hpp"

namespace slamgw::ctl {
namespace {

/// Under way to the broker at once; more wait here, and what comes late is published at once.
constexpr std::uint64_t max_under_way = 16;
/// No last will: a replay that breaks off needs none.
const LastWill no_will{};

class Replay final : private UpstreamListener {
 public:
  Replay(std::vector<RecordedMessage> messages, BrokerSettings broker, double speed)
      : messages_(std::move(messages)),
        speed_(speed),
        untried_(broker.others.size()),
        timer_(io_),
        upstream_(io_, std::move(broker), no_will, *this) {}

  Replayed run() {
    const auto until_stopped = boost::asio::make_work_guard(io_);  // links work elsewhere
    upstream_.start();
    io_.run();
    upstream_.stop();
    if (failure_) throw Failure(*failure_);
    return replayed_;
  }

 private:
  void on_link_up(const BrokerLimits&) override {
    untried_ = 0;
    begun_ = std::chrono::steady_clock::now();
    proceed();
  }
  void on_link_down(const std::string& why) override {
    if (untried_ == 0) return end("the broker: " + why);
    --untried_;
  }
  void on_published(std::uint64_t) override {
    ++replayed_.published;
    proceed();
  }
  void on_publish_refused(std::uint64_t, const Refusal& refusal) override {
    ++replayed_.refused;
    replayed_.why = refusal.why;
    proceed();
  }
  void on_silence(bool) override {}
  void on_subscribe_result(const std::string&, bool) override {}
  void on_message(BrokerMessage) override {}

  TimePoint due(const RecordedMessage& message) const {
    const std::chrono::duration<double, std::micro> after = message.after;
    return begun_ + std::chrono::duration_cast<Duration>(after / speed_);
  }

  void proceed() {
    const std::uint64_t done = replayed_.published + replayed_.refused;
    while (next_ < messages_.size() && next_ - done < max_under_way) {
      if (due(messages_[next_]) > std::chrono::steady_clock::now()) return wait();
      upstream_.publish(next_ + 1, messages_[next_].message);
      ++next_;
    }
    if (done == messages_.size()) io_.stop();
  }
  void wait() {
    timer_.expires_at(due(messages_[next_]));
    timer_.async_wait([this](boost::system::error_code error) {
      if (!error) proceed();
    });
  }
  void end(std::string failure) {
    failure_ = std::move(failure);
    io_.stop();
  }

  std::vector<RecordedMessage> messages_;
  double speed_;
  std::size_t untried_;  ///< brokers after this one
  boost::asio::io_context io_{1};
  boost::asio::steady_timer timer_;
  Upstream upstream_;
  TimePoint begun_{};
  std::uint64_t next_ = 0;
  Replayed replayed_;
  std::optional<std::string> failure_;
};

}  // namespace

Replayed replay(std::vector<RecordedMessage> messages, BrokerSettings broker, double speed) {
  if (messages.empty()) return {};
  if (broker.client_id.empty()) broker.client_id = "slam-gateway";
  broker.client_id += "-replay-" + std::to_string(getpid());
  return Replay(std::move(messages), std::move(broker), speed).run();
}

}  // namespace slamgw::ctl
