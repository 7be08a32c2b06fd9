// SPDX-License-Identifier: Apache-2.0
#include "daemon/fleet/pending_wills.hpp"

#include <algorithm>
#include <chrono>
#include <utility>

namespace slamgw::fleet {
namespace {

using namespace std::chrono_literals;
using std::chrono::milliseconds;

/// An answer takes two ways through the broker, of which each may take a second in a busy cluster.
constexpr milliseconds sign_patience{3000};
constexpr int sign_round_trips = 4;
constexpr std::size_t max_wills = 16;  // of one robot

}  // namespace

void PendingWills::add(Report will) {
  const bool is_full = questions_.size() >= max_robots && !questions_.contains(will.robot);
  if (is_full) return membership_.actions.push(PublishWill{std::move(will)});
  Question& question = questions_[will.robot];
  if (question.wills.size() < max_wills) question.wills.push_back(std::move(will));
}

void PendingWills::on_own_question(const std::string& robot, TimePoint now) {
  const auto question = questions_.find(robot);
  if (question != questions_.end() && question->second.asked && !question->second.echoed)
    question->second.echoed = now;
}

void PendingWills::begin_life() {
  for (auto& [robot, question] : questions_) question.asked.reset();
}

void PendingWills::publish_all() {
  for (auto& [robot, question] : std::exchange(questions_, {})) publish(question);
}

void PendingWills::decide(TimePoint complete_since, TimePoint now) {
  if (!membership_.may_act(now)) return;
  for (auto each = questions_.begin(); each != questions_.end();) {
    auto& [robot, question] = *each;
    const bool is_over =
        !claims_.speaks_for(robot, now) || is_answered(question, complete_since, now);
    const bool is_lost =
        question.asked && !question.echoed && now - *question.asked >= sign_patience;
    if (!is_over && (!question.asked || is_lost)) ask(robot, question, now);
    each = is_over ? questions_.erase(each) : std::next(each);
  }
}

void PendingWills::ask(const std::string& robot, Question& question, TimePoint now) {
  question.asked = now;
  question.echoed.reset();
  const auto heard = claims_.heard_at(robot);
  const Duration silent = heard ? now - *heard : Duration(1h);
  membership_.publish_to_all(AskForSign{
      robot, static_cast<std::uint64_t>(std::chrono::duration_cast<milliseconds>(silent).count())});
}

/// A will is published when nobody has heard the robot since, and this gateway could have learned
/// of it.
bool PendingWills::is_answered(Question& question, TimePoint complete_since, TimePoint now) {
  if (!question.asked || !question.echoed) return false;
  const Duration enough =
      std::max<Duration>(sign_patience, (*question.echoed - *question.asked) * sign_round_trips);
  if (now - *question.asked < enough || complete_since == TimePoint::max()) return false;
  if (complete_since > *question.asked) {  // a newcomer may have the robot, and was not asked
    question.asked.reset();
    return false;
  }
  publish(question);
  return true;
}

void PendingWills::publish(Question& question) {
  for (Report& will : question.wills) membership_.actions.push(PublishWill{std::move(will)});
}

}  // namespace slamgw::fleet
