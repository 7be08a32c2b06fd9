// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/provisioning/hearing_survey.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <nlohmann/json.hpp>
#include <utility>

namespace slamgw::ble {
namespace {

constexpr std::uint16_t all_nodes = 0xffff;
/// Places in the replay list of a robot on Nordic's stack by default; senders keep them for good.
constexpr std::size_t replay_list_size = 40;

// Heartbeat counts and periods are powers of two, encoded as the exponent plus one (Mesh Profile
// 1.0 table 4.1); 0 means none.

/// Number of heartbeats that a node publishes on request: the first at once, then one each second.
constexpr std::uint32_t heartbeats = 8;

/// The node counts heartbeats of this source to this group for 256 s. Zeros end the counting.
ConfigurationStep subscription_step(std::uint16_t source, std::uint16_t destination) {
  constexpr std::uint8_t period_log = 9;  // 256 s
  return config_step("the heartbeat subscription", heartbeat_subscription_set, source, destination,
                     destination != 0 ? period_log : std::uint8_t{0});
}

/// Publishes to this group, without features that trigger further heartbeats. Destination 0 stops
/// the publication. Robots with Nordic's code up to release 3.0 stop on a failed assertion when
/// they are asked to publish again before they have sent anything. So the request is not repeated
/// until the heartbeats would be over.
ConfigurationStep publication_step(std::uint16_t destination, std::uint8_t ttl) {
  constexpr std::uint8_t count_log = 4;  // eight
  static_assert(heartbeats == 1U << (count_log - 1));
  const bool is_on = destination != 0;
  const std::uint16_t features = 0;
  auto step = config_step("the heartbeat publication", heartbeat_publication_set, destination,
                          is_on ? count_log : std::uint8_t{0}, std::uint8_t{is_on},  // 1 s
                          std::min(ttl, max_publish_ttl), features, key_index_0);
  step.is_sent_once = is_on;
  return step;
}

ConfigurationStep count_step() {
  return config_step("the heartbeats that it has counted", heartbeat_subscription_get);
}

}  // namespace

// --- The order -----------------------------------------------------------------------------------

std::string HearingSurvey::begin(TimePoint now) {
  if (is_on()) return {};
  if (!link_.is_up) return "the BLE link is down: " + link_.down_reason;
  const NodeDatabase& database = *nodes_.database();
  std::vector<Robot> robots;
  for (const Node& node : database.nodes)
    if (node.state == NodeState::configured)
      robots.push_back({node.address, nodes_.id_of(node.address)});
  if (robots.size() < 2) return "a survey needs at least two configured robots in the mesh";
  const int former_lives = std::max(link_.source - settings_.address, 0);
  const std::size_t senders =
      robots.size() + static_cast<std::size_t>(former_lives) + database.gateways.size();
  if (senders + spare_places > replay_list_size)
    return fmt::format(
        "each robot would have to keep {} senders in a list of {}, and would hear no new gateway "
        "afterwards",
        senders, replay_list_size);
  robots_ = std::move(robots);
  rows_.clear();
  state_ = State::running;
  is_asking_ = false;
  due_ = now;
  go_to_source(0);
  return {};
}

void HearingSurvey::on_link_down() {
  if (!is_on()) return;
  state_ = State::failed;
  why_ = "the BLE link went down: " + link_.down_reason;
}

// --- Questions -----------------------------------------------------------------------------------

std::optional<TimePoint> HearingSurvey::due() const {
  return is_on() && !is_asking_ ? std::optional(due_) : std::nullopt;
}

std::vector<ConfigurationStep> HearingSurvey::next(TimePoint now) {
  if (!due() || *due() > now) return {};
  if (is_skipped()) {
    while (is_on() && is_skipped()) go_on();
    return {};
  }
  is_asking_ = true;
  if (phase_ == Phase::publishing) published_at_ = now;
  return steps();
}

bool HearingSurvey::is_skipped() const {
  if (at_ >= robots_.size() || nodes_.find(address()) == nullptr) return true;
  if (robots_[at_].misses >= max_misses) return true;
  return (phase_ == Phase::subscribing && at_ == source_) ||
         (phase_ == Phase::counting && !robots_[at_].counts);
}

/// Goes on to the next robot, or to the next phase after the last robot.
void HearingSurvey::go_on() {
  if (phase_ != Phase::publishing && ++at_ < robots_.size()) return;
  if (phase_ == Phase::subscribing) return go_to(Phase::publishing);
  if (phase_ != Phase::closing) return go_to_source(source_ + 1);
  state_ = State::done;
}

void HearingSurvey::go_to(Phase phase) {
  phase_ = phase;
  at_ = phase == Phase::publishing ? source_ : 0;
}

void HearingSurvey::go_to_source(std::size_t source) {
  while (source < robots_.size() && robots_[source].misses >= max_misses) ++source;
  source_ = source;
  attempts_ = 0;
  for (Robot& robot : robots_) robot.counts = false;
  go_to(source < robots_.size() ? Phase::subscribing : Phase::closing);
}

/// Heartbeats use one of `ble_mesh.groups`, to which robots' servers are subscribed: Nordic's code
/// up to release 3.0 hears a heartbeat only in the group of a model.
std::vector<ConfigurationStep> HearingSurvey::steps() const {
  const std::uint16_t group = settings_.groups.empty() ? all_nodes : settings_.groups.front();
  switch (phase_) {
    case Phase::subscribing: return {subscription_step(robots_[source_].address, group)};
    case Phase::publishing:
      return {publication_step(group, nodes_.find(address())->wishes.ttl.value_or(settings_.ttl))};
    case Phase::counting: return {count_step()};
    case Phase::closing: return {subscription_step(0, 0), publication_step(0, 0)};
  }
  return {};
}

// --- Answers -------------------------------------------------------------------------------------

void HearingSurvey::on_asked(const NodeConfiguration& question, TimePoint now) {
  is_asking_ = false;
  if (!is_on()) return;
  due_ = now;
  Robot& robot = robots_[at_];
  const bool is_answered = question.state() == NodeConfiguration::State::succeeded;
  if (phase_ == Phase::publishing) return on_published(is_answered);
  robot.misses = is_answered ? 0 : robot.misses + 1;
  robot.counts = phase_ == Phase::subscribing && is_answered;
  const bool is_kept = phase_ != Phase::counting || (is_answered && keep_count(question));
  if (!is_answered || !is_kept) robot.is_silent = true;
  go_on();
}

void HearingSurvey::on_published(bool is_answered) {
  due_ = published_at_ + heartbeat_time;
  if (is_answered) return go_to(Phase::counting);
  Robot& source = robots_[source_];
  if (source.misses == 0 && ++attempts_ < max_attempts) return go_to(Phase::subscribing);
  ++source.misses;
  source.is_silent = true;
  go_to_source(source_ + 1);
}

/// Returns false if the robot has not counted this source, because it was switched off and on.
bool HearingSurvey::keep_count(const NodeConfiguration& question) {
  const auto count = decode_heartbeat_count(question.answers().front().params);
  if (!count || count->source != robots_[source_].address) return false;
  rows_.push_back({source_, at_, *count});
  return true;
}

std::string HearingSurvey::json() const {
  nlohmann::ordered_json rows = nlohmann::ordered_json::array();
  nlohmann::ordered_json silent = nlohmann::ordered_json::array();
  for (const auto& [source, listener, count] : rows_) {
    if (is_on()) break;  // reported at the end
    rows.push_back({{"source", robots_[source].id},
                    {"listener", robots_[listener].id},
                    {"sent", heartbeats},
                    {"heard", std::min(count.least, heartbeats)},
                    {"heard_at_most", std::min(count.most, heartbeats)},
                    {"min_hops", nullptr},
                    {"max_hops", nullptr}});
    if (count.least == 0) continue;
    rows.back()["min_hops"] = count.min_hops;
    rows.back()["max_hops"] = count.max_hops;
  }
  for (const Robot& robot : robots_)
    if (robot.is_silent) silent.push_back(robot.id);
  const std::size_t robots = robots_.size();
  const Duration of_source = heartbeat_time + question_time * (2 * robots);
  const Duration left = of_source * (robots - source_) + question_time * (2 * robots);
  const auto seconds = std::chrono::ceil<std::chrono::seconds>(is_on() ? left : Duration{});
  nlohmann::ordered_json json{{"state", std::array{"none", "running", "done", "failed"}.at(
                                            static_cast<std::size_t>(state_))},
                              {"robots", robots},
                              {"measured", source_},
                              {"seconds_left", seconds.count()},
                              {"silent", std::move(silent)},
                              {"rows", std::move(rows)}};
  if (state_ == State::failed) json["why"] = why_;
  return json.dump();
}

}  // namespace slamgw::ble
