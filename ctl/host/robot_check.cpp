// SPDX-License-Identifier: Apache-2.0
#include "ctl/host/robot_check.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <map>
#include <optional>
#include <set>

#include "ctl/host/recording.hpp"
#include "ctl/show.hpp"

namespace slamgw::ctl {
namespace {

using nlohmann::json;

constexpr std::size_t enough_messages = 10;  ///< fewer messages do not show a habit
constexpr std::size_t max_reasons = 5;

class Judge {
 public:
  explicit Judge(const WatchedRobot& robot) : robot_(robot) {
    for (const json& event : robot.events) take(event);
  }

  std::vector<Finding> findings() {
    judge_messages();
    judge_refusals();
    judge_repeats();
    judge_payloads();
    judge_pace();
    judge_commands();
    judge_client();
    return std::move(findings_);
  }

 private:
  void take(const json& event) {
    const std::string kind = text_at(event, "event");
    if (kind == "arrived") {
      ++arrived_;
      unacknowledged_ += count_at(event, "qos") == 0 ? 1 : 0;
      strays_ += is_true(event, "stray_octet") ? 1 : 0;
      rejected_ += text_at(event, "why").empty() ? 0 : 1;
      largest_ = std::max(largest_, count_at(event, "bytes"));
      if (text_at(event, "type") == "update") update_times_.push_back(seconds_of(event));
      const json same{event.value("message_id", json()), event.value("payload", json())};
      const bool is_repeat = count_at(event, "message_id") > 0 && same == last_;
      if (is_repeat && !is_true(event, "dup")) ++passed_repeats_;
      last_ = same;
    } else if (kind == "repeat") {
      ++repeats_;
      const bool is_thread = text_at(event, "mesh") == "thread";
      if (is_thread && event.contains("dup") && !is_true(event, "dup")) ++unmarked_;
    } else if (kind == "refused") {
      reasons_[text_at(event, "why")]++;
    } else if (kind == "outcome") {
      ++commands_;
      unanswered_ += text_at(event, "outcome") == "timeout" ? 1 : 0;
      if (text_at(event, "outcome") == "timeout")
        unanswered_topics_.insert(text_at(event, "topic"));
    }
  }

  static double seconds_of(const json& event) {
    const auto at = parse_event_time(string_at(event, "at"));
    return std::chrono::duration<double>(at.value_or(std::chrono::microseconds{0})).count();
  }

  void add(const char* step, Health health, std::string detail, std::string remedy = {}) {
    findings_.push_back({step, health, std::move(detail), std::move(remedy)});
  }

  void judge_messages() {
    if (arrived_ == 0)
      return add("messages", Health::problem, fmt::format("none in {} s", robot_.watched.count()),
                 "slam-gatewayctl doctor ROBOT says why");
    add("messages", Health::well,
        fmt::format("{} in {} s, {} of them again", arrived_ + repeats_, robot_.watched.count(),
                    repeats_));
    if (2 * unacknowledged_ > arrived_)
      add("acknowledgement", Health::warning,
          fmt::format("{} of {} messages ask for none: a loss on the air is final", unacknowledged_,
                      arrived_),
          "publish at QoS 1 (Thread), or send SET in place of SET_UNRELIABLE (BLE)");
  }

  void judge_refusals() {
    std::size_t shown = 0;
    for (const auto& [why, times] : reasons_)
      if (++shown <= max_reasons)
        add("refused", Health::problem, counted(times, "time", "times") + ": " + why,
            "publish under robot/<its own id>/; the id is the MQTT-SN client id, or what `robots` "
            "says");
  }

  void judge_repeats() {
    if (unmarked_ > 0)
      add("DUP", Health::warning,
          fmt::format("{} of {} repeats do not set the DUP flag", unmarked_, repeats_),
          "set DUP in each repeat of a PUBLISH (MQTT-SN 1.2 section 5.2.3)");
    if (passed_repeats_ > 0)
      add("DUP", Health::problem,
          counted(passed_repeats_, "message", "messages") +
              " came again with the same message id and content, without DUP, and went up again",
          "set DUP in each repeat of a PUBLISH, and wait longer before it");
    if (is_lossy() && repeats_ <= arrived_)
      add("losses", Health::warning,
          fmt::format("{} of {} messages had to be repeated: the radio loses some of them, or of "
                      "their acknowledgements",
                      repeats_, arrived_),
          "slam-gatewayctl ping -c 10, and ble topology on BLE: move it, or add a relay");
    if (arrived_ < enough_messages || repeats_ <= arrived_) return;
    add("repeats", Health::problem,
        fmt::format("{} for {}: it does not hear the acknowledgements, or does not wait long "
                    "enough for them",
                    counted(repeats_, "copy", "copies"), counted(arrived_, "message", "messages")),
        "is it deaf (slam-gatewayctl robots)? else wait longer before the first repeat, and twice "
        "as long before each next one");
  }

  /// Returns whether more than one message in ten was repeated.
  bool is_lossy() const { return arrived_ >= enough_messages && 10 * repeats_ > arrived_; }

  void judge_payloads() {
    if (strays_ > 0)
      add("stray octet", Health::warning,
          fmt::format("{} updates end with an octet too many, which is cut off", strays_),
          "send exactly 4 + 4n octets: x, y and n obstacles");
    if (rejected_ > 0)
      add("payload", Health::problem,
          fmt::format("{} updates could not be read, and went up under rejected/", rejected_),
          "an update has 4 + 4n octets, n = 0 to 4 (docs/topics.md)");
    constexpr std::uint64_t unsegmented = 8;
    if (publishes_to_group() && largest_ > unsegmented)
      add("segments to a group", Health::problem,
          fmt::format("messages of {} octets go to a group in segments: each occupies its sender "
                      "for 2.5 s",
                      largest_),
          "keep them to 8 octets, or let it publish to the gateway's address");
  }

  bool publishes_to_group() const {
    return std::ranges::any_of(list_at(robot_.config, "models"), [](const json& model) {
      return text_at(model, "publishes_to") >= "0xc000" &&
             !text_at(model, "name").starts_with("Health");
    });
  }

  /// Judges the intervals of `update`: most should be near the median.
  void judge_pace() {
    std::vector<double> gaps;
    for (std::size_t i = 1; i < update_times_.size(); ++i)
      gaps.push_back(update_times_[i] - update_times_[i - 1]);
    if (gaps.size() < enough_messages || is_lossy()) return;  // repeats make gaps, too
    std::ranges::sort(gaps);
    const double median = gaps[gaps.size() / 2];
    const auto is_off = [&](double gap) { return gap < median / 2 || gap > 2 * median; };
    const auto off = std::ranges::count_if(gaps, is_off);
    if (10 * off <= static_cast<std::ptrdiff_t>(gaps.size()))
      return add("pace", Health::well, fmt::format("an update each {:.2f} s", median));
    add("pace", Health::warning,
        fmt::format("updates come irregularly: usually each {:.2f} s, but {} of {} pauses are half "
                    "or double that; the longest was {:.2f} s",
                    median, off, gaps.size(), gaps.back()),
        "send by a clock, not after an answer; on BLE start the next message only when the last "
        "one was acknowledged or given up");
  }

  void judge_commands() {
    if (commands_ == 0) return;
    if (unanswered_ == 0)
      return add("commands", Health::well, fmt::format("{}, all with an answer", commands_));
    const bool is_untold = std::ranges::any_of(
        unanswered_topics_, [&](const std::string& topic) { return is_unregistered_topic(topic); });
    add("commands", Health::problem,
        fmt::format("{} of {} were not acknowledged", unanswered_, commands_),
        is_untold ? "it never answers REGISTER: answer each with REGACK, which has its topic id"
                  : "answer each PUBLISH with PUBACK (Thread), each SET with STATUS (BLE)");
  }

  bool is_unregistered_topic(const std::string& name) const {
    return std::ranges::any_of(list_at(robot_.client, "topics"), [&](const json& topic) {
      return text_at(topic, "name") == name && !is_true(topic, "told");
    });
  }

  void judge_client() {
    if (!robot_.client.is_object()) return;
    const std::uint64_t keep_alive = count_at(robot_.client, "keep_alive_s");
    constexpr std::uint64_t shortest = 10;
    if (keep_alive == 0)
      add("keep-alive", Health::warning, "is 0: the gateway cannot notice a lost robot",
          "name 30 to 120 s in CONNECT");
    else if (keep_alive < shortest)
      add("keep-alive", Health::warning,
          fmt::format("is {} s: one lost ping or two make it lost, and its will is published",
                      keep_alive),
          "name 30 to 120 s in CONNECT");
    if (!is_true(robot_.client, "has_answered"))
      add("answers", Health::warning, "it has answered nothing yet, so it loses its place first",
          "answer REGISTER, PUBLISH and the questions for a will");
  }

  const WatchedRobot& robot_;
  std::vector<Finding> findings_;
  std::size_t arrived_ = 0;
  std::size_t unacknowledged_ = 0;
  std::size_t repeats_ = 0;
  std::size_t unmarked_ = 0;
  std::size_t strays_ = 0;
  std::size_t rejected_ = 0;
  std::size_t commands_ = 0;
  std::size_t unanswered_ = 0;
  std::uint64_t largest_ = 0;
  std::size_t passed_repeats_ = 0;
  json last_;  ///< message id and payload of the last message
  std::set<std::string> unanswered_topics_;
  std::map<std::string, std::size_t> reasons_;
  std::vector<double> update_times_;
};

/// Returns the daemon's answer; null when the daemon refuses, because it does not have the robot,
/// or is silent. Each question has its own connection: a late answer cannot be taken for the next
/// one.
json asked(const std::string& socket, const json& request,
           std::chrono::seconds patience = answer_patience) {
  try {
    return Connection(socket).ask(request, patience);
  } catch (const NotRunning&) {
    throw;
  } catch (const Failure&) {
    return nullptr;
  }
}

}  // namespace

WatchedRobot watch_robot(const std::string& robot, std::chrono::seconds time,
                         const std::string& socket) {
  using Clock = std::chrono::steady_clock;
  WatchedRobot watched;
  Connection events(socket);
  events.ask({{"command", "watch"}, {"robot", robot}});
  const auto start = Clock::now();
  while (watched.events.size() < WatchedRobot::max_events) {
    const auto left = time - (Clock::now() - start);
    if (left <= Clock::duration::zero()) break;
    if (auto event = events.next_event_within(std::chrono::ceil<std::chrono::seconds>(left)))
      watched.events.push_back(std::move(*event));
  }
  watched.watched = std::chrono::round<std::chrono::seconds>(Clock::now() - start);
  const json clients = asked(socket, {{"command", "mqttsn clients"}, {"robot", robot}});
  if (clients.is_array() && !clients.empty()) watched.client = clients.front();
  constexpr std::chrono::seconds config_patience{60};
  if (watched.client.is_null())
    watched.config = asked(socket, {{"command", "ble config"}, {"robot", robot}}, config_patience);
  return watched;
}

std::vector<Finding> judge_robot(const WatchedRobot& robot) { return Judge(robot).findings(); }

}  // namespace slamgw::ctl
