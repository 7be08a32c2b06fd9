// SPDX-License-Identifier: Apache-2.0
// Which of several gateways serves a robot that the boards of all of them hear, because they share
// one mesh. Its owner keeps it until another gateway hears it clearly better for a while, or hears
// it when the owner does not. Gateways tell each other what they hear (`Hears`); each decides for
// itself whether to claim. Pure; part of RobotClaims.
#pragma once

#include <array>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "daemon/core/time.hpp"
#include "daemon/fleet/fleet_message.hpp"

namespace slamgw::fleet {

/// How well a board hears a robot: the RSSI of the last hop in dBm, less `relay_cost_db` for each
/// relay before it, whose own signals nobody tells.
struct SignalLevel {
  static constexpr int relay_cost_db = 30;
  int db = 0;
};

class BoardChoice {
 public:
  /// RSSI flickers by a few dB, and by 10 dB where people walk: less is no reason to move.
  static constexpr int clearly_better_db = 10;
  static constexpr std::chrono::seconds better_for{5};
  /// An owner that misses so many messages in a row, for so long, does not hear the robot. A robot
  /// sends an acknowledged message four times within the first 1.2 s.
  static constexpr unsigned most_missed = 3;
  static constexpr std::chrono::seconds deaf_after{2};
  /// One that tells nothing of what it hears has no board in this mesh, or none that works.
  static constexpr std::chrono::seconds silent_after{3};
  static constexpr std::chrono::seconds hears_interval{1};
  /// What was heard longer ago is not claimed and not compared.
  static constexpr std::chrono::seconds recent{5};
  static constexpr std::chrono::seconds forget_after{60};
  /// As the BLE mesh has room for; more are not looked at.
  static constexpr std::size_t max_robots = 256;

  /// Whether this gateway's own board works. True when that has changed.
  bool on_board(bool is_up) {
    const bool is_news = std::exchange(is_board_up_, is_up) != is_up;
    if (!is_news) return false;
    hears_published_.reset();
    for (auto& [robot, here] : robots_) here.better_since.reset();
    return true;
  }
  /// This gateway's board has heard the robot. `level`: nothing where it is not known.
  void on_heard(const std::string& robot, std::optional<SignalLevel> level, TimePoint now);
  void on_hears(const std::string& gateway, const Hears& hears, TimePoint now);
  /// Robots that this gateway's board has heard lately; none while it does not work.
  std::vector<std::string> candidates(TimePoint now) const;
  bool knows(const std::string& robot) const { return robots_.contains(robot); }
  /// Whether this gateway should take the robot from its living owner. Asked again and again.
  bool should_take(const std::string& robot, const std::string& owner, TimePoint now);
  /// The gateway has told so lately.
  bool is_board_down(const std::string& gateway, TimePoint now) const;
  /// For the others, when it is time to.
  std::optional<Hears> next_hears(TimePoint now);
  /// Nobody else is about.
  void forget_others();

 private:
  /// What another gateway has told of a robot.
  struct Elsewhere {
    int level_db = Hears::lowest_level_db;
    TimePoint heard{};
    unsigned missed = 0;  ///< messages that this gateway has heard since
    TimePoint missed_since{};

    void miss(TimePoint when) {
      if (missed++ == 0) missed_since = when;
    }
  };
  struct Here {
    std::optional<double> level_db;               ///< smoothed
    std::array<TimePoint, most_missed> latest{};  ///< when it was heard, the newest last
    std::map<std::string, Elsewhere> elsewhere;   ///< by gateway
    std::string compared_with;                    ///< the owner that `better_since` is about
    std::optional<TimePoint> better_since;

    TimePoint last() const { return latest.back(); }
  };
  struct Board {
    bool is_up = false;
    TimePoint heard_from{};
  };

  bool is_deaf(const Elsewhere& owner, const Board* board, TimePoint now) const;
  bool is_better(const Here& here, const std::string& owner, TimePoint now) const;

  bool is_board_up_ = false;
  std::map<std::string, Here> robots_;
  std::map<std::string, Board> boards_;  ///< of other gateways
  std::optional<TimePoint> hears_published_;
};

}  // namespace slamgw::fleet
