// SPDX-License-Identifier: Apache-2.0
#include "ctl/host/recording.hpp"

#include <nlohmann/json.hpp>

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <boost/asio/executor_work_guard.hpp>
#include <boost/asio/io_context.hpp>
#include <cerrno>
#include <cstring>
#include <ctime>
#include <filesystem>
#include <optional>
#include <utility>

#include "ctl/connection.hpp"
#include "ctl/show.hpp"
#include "daemon/control/wire.hpp"
#include "daemon/core/topic_scheme.hpp"
#include "daemon/mqtt/mosquitto/mosquitto_link.hpp"
#include "daemon/mqtt/upstream.hpp"
#include "daemon/runtime/timer.hpp"

namespace slamgw::ctl {
namespace {

using nlohmann::json;
using std::chrono::microseconds;

std::optional<BrokerMessage> message_of(const json& event) {
  const auto payload = from_hex(text_at(event, "payload"));
  const std::string topic = string_at(event, "topic");
  const std::uint64_t qos = count_at(event, "qos");
  if (!event.contains("payload") || !payload || !is_valid_topic_name(topic) || qos > 2)
    return std::nullopt;
  return BrokerMessage{topic, *payload, static_cast<Qos>(qos), false, {}};
}

/// Throws Failure for a very long gap: the clock was set during the recording, for instance on a
/// host that starts without the time. To wait for its end would look like a replay that hangs.
void check_gaps(const std::vector<RecordedMessage>& messages, const std::string& name) {
  constexpr std::chrono::days longest{30};
  for (std::size_t i = 1; i < messages.size(); ++i) {
    const auto gap = messages[i].after - messages[i - 1].after;
    if (gap > longest)
      throw Failure(
          fmt::format("{}: {} days lie between messages {} and {} in order of time, so the "
                      "clock was set meanwhile; remove the lines on one side of it",
                      name, std::chrono::floor<std::chrono::days>(gap).count(), i, i + 1));
  }
}

/// The most messages under way to the broker; others wait here, and go at once when overdue.
constexpr std::uint64_t max_under_way = 16;

ConnectionTraits traits(bool is_user_typed) {
  ConnectionTraits traits{.make_link = make_mosquitto_link,
                          .without_credentials = "(no user name was sent): see --user"};
  if (is_user_typed) traits.credentials_file.clear();
  return traits;
}

class Replay final : private UpstreamListener {
 public:
  Replay(std::vector<RecordedMessage> messages, BrokerSettings broker, double speed,
         bool is_user_typed)
      : messages_(std::move(messages)),
        speed_(speed),
        untried_(broker.others.size()),
        timer_(io_),
        upstream_(io_, std::move(broker), traits(is_user_typed), *this) {}

  Replayed run() {
    const auto until_stopped = boost::asio::make_work_guard(io_);  // links use other threads
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
  void on_message(BrokerMessage, const UserProperties&) override {}

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
    timer_.at(due(messages_[next_]), [this] { proceed(); });
  }
  void end(std::string failure) {
    failure_ = std::move(failure);
    io_.stop();
  }

  std::vector<RecordedMessage> messages_;
  double speed_;
  std::size_t untried_;  ///< number of brokers that are not tried yet
  boost::asio::io_context io_{1};
  Timer timer_;
  Upstream upstream_;
  TimePoint begun_{};
  std::uint64_t next_ = 0;
  Replayed replayed_;
  std::optional<std::string> failure_;
};

}  // namespace

std::optional<microseconds> parse_event_time(const std::string& text) {
  std::tm time{};
  const char* rest = strptime(text.c_str(), "%Y-%m-%dT%H:%M:%S", &time);
  if (rest == nullptr) return std::nullopt;
  microseconds parsed = std::chrono::seconds(timegm(&time));
  microseconds unit{100000};
  if (*rest == '.')
    for (++rest; *rest >= '0' && *rest <= '9'; ++rest, unit /= 10) parsed += unit * (*rest - '0');
  return std::string_view(rest) == "Z" ? std::optional(parsed) : std::nullopt;
}

bool is_recorded(const json& event) {
  const std::string kind = text_at(event, "event");
  return kind == "arrived" || kind == "command" || kind == "lost";
}

std::ofstream open_recording(const std::string& path) {
  std::error_code error;
  std::ifstream former;
  if (std::filesystem::is_regular_file(path, error))
    former.open(path, std::ios::binary | std::ios::ate);
  const bool is_cut =
      former.is_open() && former.tellg() > 0 && former.seekg(-1, std::ios::end).get() != '\n';
  std::ofstream file(path, std::ios::app | std::ios::binary);
  if (!file.is_open()) throw Failure(path + " can't be written: " + std::strerror(errno));
  if (is_cut) file << '\n' << std::flush;
  return file;
}

std::vector<RecordedMessage> read_recording(std::istream& in, const std::string& name) {
  std::vector<RecordedMessage> messages;
  std::size_t number = 0;
  for (std::string line; std::getline(in, line);) {
    ++number;
    if (line.empty()) continue;
    const json event = json::parse(line, nullptr, false);
    const auto at = event.is_object() ? parse_event_time(text_at(event, "at")) : std::nullopt;
    // A message with a reason was not published unchanged: no server has seen it on its topic.
    const bool is_message =
        event.is_object() && text_at(event, "event") == "arrived" && text_at(event, "why").empty();
    const auto message = is_message ? message_of(event) : std::nullopt;
    // The program that wrote it was killed, or its disk was full; it may have continued later.
    const bool is_cut =
        event.is_discarded() && (in.eof() || (line.starts_with('{') && !line.ends_with('}')));
    if (is_cut && (number > 1 || !in.eof())) continue;
    if (!at || (is_message && !message))
      throw Failure(
          fmt::format("{}:{}: is not a line that slam-gatewayctl record writes", name, number));
    if (message) messages.push_back({*at, *message});
  }
  std::ranges::stable_sort(messages, {}, &RecordedMessage::after);
  check_gaps(messages, name);
  if (!messages.empty()) {
    const microseconds first = messages.front().after;
    for (RecordedMessage& message : messages) message.after -= first;
  }
  return messages;
}

Replayed replay(std::vector<RecordedMessage> messages, BrokerSettings broker, double speed,
                bool is_user_typed) {
  if (messages.empty()) return {};
  if (broker.client_id.empty()) broker.client_id = "slam-gateway";
  broker.client_id += "-replay-" + std::to_string(getpid());
  return Replay(std::move(messages), std::move(broker), speed, is_user_typed).run();
}

}  // namespace slamgw::ctl
