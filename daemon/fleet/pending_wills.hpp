// SPDX-License-Identifier: Apache-2.0
// Wills of robots whose keep-alive is over at this gateway, and which may live on at another one:
// all are asked whether they have heard the robot, and a will is published when nobody has. Pure.
#pragma once

#include <map>
#include <optional>
#include <string>
#include <vector>

#include "daemon/core/messages.hpp"
#include "daemon/fleet/membership.hpp"
#include "daemon/fleet/robot_claims.hpp"

namespace slamgw::fleet {

class PendingWills {
 public:
  static constexpr std::size_t max_robots = 4096;

  PendingWills(Membership& membership, const RobotClaims& claims)
      : membership_(membership), claims_(claims) {}

  /// Publishes it at once when those of `max_robots` wait.
  void add(Report will);
  /// The robot lives: some gateway has heard it.
  void drop(const std::string& robot) { questions_.erase(robot); }
  /// This gateway's own question came back from the broker.
  void on_own_question(const std::string& robot, TimePoint now);
  /// What was asked in a former life is asked again.
  void begin_life();
  /// Nobody else is about.
  void publish_all();
  /// Asks and publishes. `complete_since`: since when every gateway that is online hears the
  /// others; TimePoint::max() while one does not.
  void decide(TimePoint complete_since, TimePoint now);
  bool is_empty() const { return questions_.empty(); }

 private:
  struct Question {
    std::vector<Report> wills;
    std::optional<TimePoint> asked;
    std::optional<TimePoint> echoed;
  };

  void ask(const std::string& robot, Question& question, TimePoint now);
  bool is_answered(Question& question, TimePoint complete_since, TimePoint now);
  void publish(Question& question);

  Membership& membership_;
  const RobotClaims& claims_;
  std::map<std::string, Question> questions_;
};

}  // namespace slamgw::fleet
