// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/presence_publisher.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <utility>

#include "daemon/core/announcements.hpp"
#include "daemon/core/home_assistant.hpp"

namespace slamgw {
namespace {

/// Highest age of `last_seen` in a retained presence while its robot is heard.
constexpr std::chrono::minutes presence_refresh{5};

using Json = nlohmann::ordered_json;  // keys in the order of docs/topics.md

/// Topics that wait for the broker to be cleared: presence, and documents for Home Assistant.
constexpr std::size_t max_to_clear = 2 * RobotRegistry::max_robots;

/// The payload of our last will.
constexpr std::string_view last_will_state = R"({"state":"offline"})";

}  // namespace

PresencePublisher::PresencePublisher(const TopicScheme& scheme, GatewaySettings& settings,
                                     const BrokerLink& broker, RobotDirectory& directory,
                                     GatewayActions& actions)
    : scheme_(scheme),
      settings_(settings),
      broker_(broker),
      directory_(directory),
      actions_(actions),
      own_presence_(scheme_.presence_topic({})) {}

void PresencePublisher::on_broker_link(const Now& now) {
  is_state_heard_ = sends_retained_ = false;
  up_since_.reset();
  wills_due_.reset();
  announce_at_.reset();
  if (!broker_.is_up) return;
  up_since_ = now.mono;
  if (!waiting_wills_.empty()) wills_due_ = now.mono + will_patience;
  if (leftovers_ && !leftovers_due_) leftovers_due_ = now.mono + leftover_grace;
  publish_state();
  for (const std::string& topic : std::exchange(to_clear_, {})) clear_retained(topic);
  for (auto& [id, robot] : directory_.registry.robots()) robot.is_described_with_signal.reset();
  announce_at_ = now.mono + settling;
}

bool PresencePublisher::take(const BrokerMessage& message, const Now& now) {
  const bool is_presence = message.topic.starts_with(own_presence_);
  const bool is_state = message.topic == scheme_.state_topic();
  if (is_presence) on_own_presence(message);
  if (is_state) on_own_state(message, now);
  return is_presence || is_state;
}

void PresencePublisher::on_presence(const PresenceChange& change, const Now& now) {
  const Robot* known = directory_.registry.find(change.robot);
  const bool was_deaf = known != nullptr && known->on_mesh[change.mesh].is_deaf;
  const bool hears_again = was_deaf && !change.is_deaf && change.presence == Presence::online;
  Robot* robot = directory_.registry.on_presence(change, now);
  withdraw_evicted();
  if (!to_clear_.empty()) {
    to_clear_.erase(scheme_.presence_topic(change.robot));
    to_clear_.erase(home_assistant_topic(scheme_, change.robot));
  }
  if (robot) announce(change.robot, *robot, now.mono);
  if (change.presence != Presence::offline) waiting_wills_.erase(change.robot);
  const std::string& address = robot ? robot->on_mesh[change.mesh].address : change.address;
  actions_.push(Notice{.severity = change.is_deaf ? Severity::warning : Severity::info,
                       .text = fmt::format("{} {} is {} at {}{}", to_string(change.mesh),
                                           change.robot, to_string(change.presence), address,
                                           change.is_deaf ? ", but does not hear the gateway"
                                           : hears_again  ? ", and hears the gateway again"
                                                          : ""),
                       .robot = change.robot,
                       .occasion = Occasion::robot_presence,
                       .is_proven = change.is_proven,
                       .mesh = change.mesh});
}

/// Publishes the presence again when its `last_seen` is older than `presence_refresh`.
void PresencePublisher::on_heard(const std::string& id, Robot* robot, TimePoint now) {
  if (!waiting_wills_.empty()) waiting_wills_.erase(id);
  const bool is_due =
      robot && (robot->is_announcement_due || now - robot->announced >= presence_refresh);
  if (is_due) announce(id, *robot, now);
}

/// Publishes nothing while the broker is offline: everything is published again when it is back.
/// Waits for a robot whose session this gateway does not hold until it is known that no other
/// gateway shows the robot.
void PresencePublisher::announce(const std::string& id, Robot& robot, TimePoint now) {
  if (!robot.presence().is_known) return;
  robot.announced = now;
  if (!broker_.is_up) return;
  robot.is_announcement_due =
      !directory_.places.is_held(id) && (!knows_others(now) || directory_.places.is_elsewhere(id));
  if (robot.is_announcement_due) return;
  publish_retained(scheme_.presence_topic(id), presence_json(robot));
  describe(id, robot);
}

/// Publishes the robot's document for Home Assistant, unless the broker has it. Once the robot had
/// a signal, the document keeps it: a robot on two meshes has a signal only in some of its
/// messages.
void PresencePublisher::describe(const std::string& id, Robot& robot) {
  if (!settings_.describes_robots) return;
  auto& described = robot.is_described_with_signal;
  const bool has_signal = described.value_or(false) || robot.radio_now().rssi_dbm.has_value();
  if (described == has_signal) return;
  described = has_signal;
  publish_retained(home_assistant_topic(scheme_, id),
                   home_assistant_document(scheme_, id, settings_.update_mode, has_signal));
}

void PresencePublisher::describe_robots(bool is_wanted, const Now& now) {
  if (std::exchange(settings_.describes_robots, is_wanted) == is_wanted) return;
  if (is_wanted) return announce_all(now);
  for (auto& [id, robot] : directory_.registry.robots())
    if (std::exchange(robot.is_described_with_signal, std::nullopt))
      clear_retained(home_assistant_topic(scheme_, id));
}

void PresencePublisher::announce_all(const Now& now) {
  for (auto& [id, robot] : directory_.registry.robots()) announce(id, robot, now.mono);
}

void PresencePublisher::announce_unheld(const Now& now) {
  announce_at_.reset();
  for (auto& [id, robot] : directory_.registry.robots())
    if (robot.is_announcement_due || !directory_.places.is_held(id)) announce(id, robot, now.mono);
}

/// A broker that sends retained messages does so before this gateway's new `state` comes back.
bool PresencePublisher::knows_others(TimePoint now) const {
  return (sends_retained_ && is_state_heard_ && directory_.places.is_alone()) ||
         (up_since_ && now - *up_since_ >= settling);
}

/// A last will that comes after our `online` belongs to an earlier connection, so `online` is
/// published again. Our `online` overwrites a last will that comes before it.
void PresencePublisher::on_own_state(const BrokerMessage& message, const Now& now) {
  sends_retained_ = sends_retained_ || message.retain;
  if (as_text(message.payload) != last_will_state) {
    if (!message.retain) is_state_heard_ = true;
    if (knows_others(now)) announce_unheld(now);
  } else if (is_state_heard_ && !is_stopping_) {
    publish_state();
  }
}

/// While stopping, publishes `offline` even at a new connection: after a clean shutdown there is no
/// last will.
void PresencePublisher::publish_state() {
  if (is_stopping_)
    return publish_retained(scheme_.state_topic(), Json{{"state", "offline"}}.dump());
  Json state{{"state", "online"},
             {"version", settings_.version},
             {"since", to_iso8601(settings_.started)},
             {"connected", to_iso8601(broker_.since)}};
  if (is_store_full_) state["store"] = "full";
  publish_retained(scheme_.state_topic(), state.dump());
}

void PresencePublisher::on_store(bool is_full) {
  if (std::exchange(is_store_full_, is_full) != is_full && broker_.is_up) publish_state();
}

void PresencePublisher::on_stop() {
  is_stopping_ = true;
  if (broker_.is_up) publish_state();  // else the last will has said the same
}

/// The gateway that holds the robot's session publishes the will, when the broker has shown that it
/// still does. The robot may be alive at another gateway while the connection is stalled.
bool PresencePublisher::keep_will(Report& will, const Now& now) {
  if (directory_.places.is_alone() || waiting_wills_.size() >= max_waiting_wills) return false;
  if (!wills_due_ && up_since_) wills_due_ = now.mono + will_patience;
  const std::string robot = will.robot;
  waiting_wills_.insert_or_assign(robot, WaitingWill{std::move(will), now.mono});
  return true;
}

std::optional<Report> PresencePublisher::take_will(const std::string& robot) {
  auto will = waiting_wills_.extract(robot);
  if (!will) return std::nullopt;
  return std::move(will.mapped().report);
}

std::vector<Report> PresencePublisher::take_due_wills(const Now& now) {
  std::vector<Report> due;
  if (!broker_.is_up || !wills_due_ || now.mono < *wills_due_) return due;
  wills_due_.reset();
  std::erase_if(waiting_wills_, [&](auto& waiting) {
    auto& [robot, will] = waiting;
    const TimePoint due_at = std::max(will.came, *up_since_) + will_patience;
    if (now.mono < due_at) {
      wills_due_ = earlier(wills_due_, due_at);
      return false;
    }
    if (!directory_.places.is_elsewhere(robot)) due.push_back(std::move(will.report));
    return true;
  });
  return due;
}

void PresencePublisher::on_session_held(const std::string& robot, const std::string& dead_owner,
                                        const Now& now) {
  if (!dead_owner.empty()) publish_retained(scheme_.presence_topic_at(dead_owner, robot), {});
  Robot* known = directory_.registry.find(robot);
  if (!known) return;
  known->is_described_with_signal.reset();  // the document names the previous gateway
  announce(robot, *known, now.mono);
}

void PresencePublisher::on_given_up(const std::string& robot) {
  waiting_wills_.erase(robot);
  directory_.registry.forget(robot);
  clear_retained(scheme_.presence_topic(robot));
}

void PresencePublisher::on_contested(const std::string& robot, bool is_contested, const Now& now) {
  Robot* known = directory_.registry.find(robot);
  if (!known || std::exchange(known->is_session_contested, is_contested) == is_contested) return;
  announce(robot, *known, now.mono);
}

std::string PresencePublisher::drop(const std::string& robot) {
  if (!is_valid_level(robot)) return "a robot's id must be one topic level";
  const Robot* known = directory_.registry.find(robot);
  if (known && known->presence().presence != Presence::offline)
    return fmt::format("{} is {}: switch it off first, or it comes back at once", robot,
                       to_string(known->presence().presence));
  directory_.registry.forget(robot);
  withdraw(robot);
  actions_.push(RobotForgotten{robot});
  return {};
}

/// Clears the retained presence, and the document for Home Assistant unless another gateway shows
/// the robot: then the document is that gateway's.
void PresencePublisher::withdraw(const std::string& robot) {
  if (leftovers_) leftovers_->erase(robot);
  clear_retained(scheme_.presence_topic(robot));
  if (settings_.describes_robots && !directory_.places.is_elsewhere(robot))
    clear_retained(home_assistant_topic(scheme_, robot));
}

/// An empty retained message deletes the retained one at the broker.
void PresencePublisher::clear_retained(std::string topic) {
  if (broker_.is_up)
    publish_retained(std::move(topic), "");
  else if (to_clear_.size() < max_to_clear)
    to_clear_.insert(std::move(topic));
}

void PresencePublisher::withdraw_evicted() {
  for (const std::string& robot : directory_.registry.take_evicted()) {
    withdraw(robot);
    actions_.push(RobotForgotten{robot});
  }
}

std::optional<TimePoint> PresencePublisher::settled_at() const {
  if (!up_since_) return std::nullopt;
  return *up_since_ + settling;
}

std::optional<TimePoint> PresencePublisher::deadline() const {
  if (!broker_.is_up) return std::nullopt;
  return earlier(leftovers_due_, earlier(wills_due_, announce_at_));
}

void PresencePublisher::on_deadline(const Now& now) {
  if (!broker_.is_up) return;
  if (announce_at_ && now.mono >= *announce_at_) announce_unheld(now);
  end_leftovers(now);
}

void PresencePublisher::on_own_presence(const BrokerMessage& message) {
  if (!leftovers_) return;
  std::string robot = message.topic.substr(own_presence_.size());
  if (message.payload.empty())
    leftovers_->erase(robot);
  else if (message.retain && message.payload.size() <= max_leftover_octets &&
           leftovers_->size() < max_leftovers)
    leftovers_->insert_or_assign(std::move(robot), std::string(as_text(message.payload)));
}

/// Marks leftovers that were not heard as offline; the time is unknown.
void PresencePublisher::end_leftovers(const Now& now) {
  if (!leftovers_due_ || now.mono < *leftovers_due_) return;
  leftovers_due_.reset();
  const auto leftovers = std::exchange(leftovers_, std::nullopt);
  for (const auto& [id, text] : *leftovers) {
    if (directory_.registry.find(id)) continue;
    if (directory_.places.is_elsewhere(id)) {
      publish_retained(scheme_.presence_topic(id), {});
      continue;
    }
    Json presence = Json::parse(text, nullptr, false);
    if (!presence.is_object() || presence.value("state", Json{}) == "offline") continue;
    presence["state"] = "offline";
    presence["since"] = to_iso8601(now.wall);
    publish_retained(scheme_.presence_topic(id), presence.dump());
  }
}

void PresencePublisher::publish_retained(std::string topic, std::string_view payload) {
  actions_.push(
      Upload{{std::move(topic), to_bytes(payload), Qos::at_least_once, true}, no_receipt});
}

}  // namespace slamgw
