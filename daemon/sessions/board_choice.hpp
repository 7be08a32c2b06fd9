// SPDX-License-Identifier: Apache-2.0
// Decides which of several gateways serves a robot, when all their boards hear it because they
// share one mesh. The holder of the robot's session keeps it until another gateway hears the robot
// clearly better for a while, or hears it when the holder does not. Gateways publish what they hear
// (`Hears`); each decides for itself whether to take the session. Pure; FleetMember asks it.
#pragma once

#include <array>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "daemon/core/bytes.hpp"
#include "daemon/core/time.hpp"

namespace slamgw::sessions {

/// How well a board hears a robot: the RSSI of the last hop in dBm, less `relay_cost_db` for each
/// relay before it. The RSSI at the relays is unknown.
struct SignalLevel {
  static constexpr int relay_cost_db = 30;
  int db = 0;
};

/// A gateway's report: the robots that its board hears in a mesh shared with other gateways.
struct Hears {
  /// The BLE mesh has room for this many robots.
  static constexpr std::size_t max_rows = 256;
  /// Twice the size of `max_rows` rows with the longest ids.
  static constexpr std::size_t max_octets = 64 * 1024;
  /// Stands for an unknown level.
  static constexpr int lowest_level_db = -1000;
  static constexpr int highest_level_db = 100;
  struct Row {
    std::string robot;
    int level_db = lowest_level_db;   ///< SignalLevel
    std::chrono::milliseconds age{};  ///< since the robot was heard last
  };
  bool is_board_up = false;
  std::vector<Row> rows;
};

/// `{"up":true,"rows":[["nr1",-60,120]]}`: robot, level in dB, age in ms.
std::string to_json_text(const Hears& hears);
/// Returns nothing when the payload is malformed, or larger than a gateway's report can be.
std::optional<Hears> read_hears(ByteView payload);

class BoardChoice {
 public:
  /// RSSI flickers by a few dB, and by 10 dB where people walk: a smaller gain does not count.
  static constexpr int clearly_better_db = 10;
  static constexpr std::chrono::seconds better_for{5};
  /// A holder that misses this many messages in a row, for this long, does not hear the robot. A
  /// robot sends an acknowledged message four times within the first 1.2 s.
  static constexpr unsigned most_missed = 3;
  static constexpr std::chrono::seconds deaf_after{2};
  /// A holder that publishes no Hears for this time has no working board in this mesh.
  static constexpr std::chrono::seconds silent_after{3};
  static constexpr std::chrono::seconds hears_interval{1};
  /// A robot that was heard longer ago is not taken, and its levels are not compared.
  static constexpr std::chrono::seconds recent{5};
  static constexpr std::chrono::seconds forget_after{60};
  /// More robots are ignored.
  static constexpr std::size_t max_robots = Hears::max_rows;
  /// Limit of other gateways' boards; more are ignored until one is silent for `forget_after`.
  static constexpr std::size_t max_boards = 1000;

  /// Call when this gateway's own board works or fails.
  void on_board(bool is_up) {
    if (std::exchange(is_board_up_, is_up) == is_up) return;
    hears_published_.reset();
    for (auto& [robot, here] : robots_) here.better_since.reset();
  }
  /// Call when this gateway's board has heard the robot. `level`: nothing when it is unknown.
  void on_heard(const std::string& robot, std::optional<SignalLevel> level, TimePoint now);
  /// Call when another gateway has published what it hears.
  void on_hears(const std::string& gateway, const Hears& hears, TimePoint now);
  /// Returns the robots that this gateway's board has heard lately; none while it does not work.
  std::vector<std::string> candidates(TimePoint now) const;
  /// Returns true when this gateway should take the robot's session from its living holder. An
  /// empty `holder` means that no living gateway has the session. Call at least every second.
  bool should_take(const std::string& robot, const std::string& holder, TimePoint now);
  /// Returns the report to publish, once every `hears_interval`.
  std::optional<Hears> next_hears(TimePoint now);

 private:
  /// How another gateway hears a robot.
  struct HeardElsewhere {
    int level_db = Hears::lowest_level_db;
    TimePoint heard{};
    unsigned missed = 0;  ///< messages that this gateway has heard since
    TimePoint missed_since{};

    void miss(TimePoint when) {
      if (missed++ == 0) missed_since = when;
    }
  };
  struct HeardHere {
    std::optional<double> level_db;                   ///< smoothed
    std::array<TimePoint, most_missed> latest{};      ///< when it was heard, the newest last
    std::map<std::string, HeardElsewhere> elsewhere;  ///< by gateway
    std::string compared_with;                        ///< the holder for `better_since`
    std::optional<TimePoint> better_since;

    TimePoint last() const { return latest.back(); }
  };
  struct Board {
    bool is_up = false;
    TimePoint heard_from{};
  };

  bool is_board_down(const std::string& gateway, TimePoint now) const;
  bool is_deaf(const HeardElsewhere& holder, const Board* board, TimePoint now) const;
  bool is_better(const HeardHere& here, const std::string& holder, TimePoint now) const;
  void forget_silent(TimePoint now);

  bool is_board_up_ = false;
  std::map<std::string, HeardHere> robots_;
  std::map<std::string, Board> boards_;  ///< of other gateways
  std::optional<TimePoint> hears_published_;
};

}  // namespace slamgw::sessions
