// SPDX-License-Identifier: Apache-2.0
// Decides the state of each gateway and robot, since when, and which gateway reports it; once, for
// the page and for the metrics. Pure: takes gateways' documents and `now`, in Unix milliseconds of
// this program's clock.
//
// A gateway is `gone` once the broker has published its last will, and `silent` when it has sent
// nothing for a while though the broker still has its connection. The reports of such a gateway are
// out of date: its robots are `unknown`. Without a broker, everything is `unknown`.
//
// Times in a gateway's documents are by its own clock. A clock that is wrong by more than
// `clock_tolerance_ms` is reported, and the times are corrected.
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <set>
#include <string>
#include <string_view>

#include "web/server/page_queue.hpp"
#include "web/server/topics.hpp"

namespace slamgw::web {

/// Returns the Unix milliseconds of a time like "2026-11-21T13:57:43.613Z".
std::optional<std::int64_t> unix_ms(std::string_view iso8601);

struct GatewayLife {
  std::string_view state = "unknown";  ///< `online`, `silent`, `gone`, `unknown`
  std::int64_t since_ms = 0;           ///< when the state began; 0: not known
  std::int64_t clock_ahead_ms = 0;     ///< 0 within the tolerance
  bool operator==(const GatewayLife&) const = default;
};

struct RobotLife {
  std::string state = "unknown";  ///< `online`, `asleep`, `offline`, `unknown`
  std::string gateway;            ///< the gateway that reports the state
  std::string mesh;
  std::int64_t since_ms = 0;  ///< when the state began; 0: not known
  std::int64_t heard_ms = 0;  ///< as the gateways report; 0: not known
  bool operator==(const RobotLife&) const = default;
};

class Roster {
 public:
  /// Three of a gateway's stats are missing then.
  static constexpr std::int64_t silent_after_ms = 35'000;
  static constexpr std::int64_t clock_tolerance_ms = 60'000;

  /// LastKnown keeps at most this many topics. Documents of further gateways, or about further
  /// robots, are ignored.
  static constexpr std::size_t max_gateways = 25'000;
  static constexpr std::size_t max_robots = 25'000;

  /// Call for the topics that LastKnown keeps. An empty payload withdraws a document. A gateway
  /// without a `state` is forgotten with any of its documents.
  void on_document(const Topics::GatewayTopic& topic, std::string_view payload, std::int64_t at_ms,
                   bool is_retained);
  /// `received_at`: by the gateway's clock. Without MQTT 5, `gateway` and `received_at` are empty,
  /// and the time at which this program got the message counts.
  void on_robot_message(std::string_view robot, std::string_view gateway,
                        std::string_view received_at, std::int64_t at_ms);
  void on_broker_lost(std::int64_t now_ms);
  void on_broker_found();  ///< forgets everything, because all documents come again

  /// Decides again. Returns the topics and texts for pages of all changed states.
  std::map<std::string, SharedText> update(std::int64_t now_ms);
  /// Returns the topics and texts of all states, for a new page.
  std::map<std::string, SharedText> texts() const;

  GatewayLife gateway(std::string_view id) const;
  RobotLife robot(std::string_view id) const;
  template <class Visitor>
  void each_robot(Visitor&& visit) const {
    for (const auto& [id, robot] : robots_) visit(id, robot.life);
  }
  /// Returns RobotLife::heard_ms, or the time of a newer message: gateways report only every 10 s.
  /// The last message of an offline robot is its last will and does not count.
  std::int64_t last_heard_ms(std::string_view id) const;

 private:
  /// The least by which a gateway's clock is ahead, by the messages of the last one to two periods.
  struct ClockEvidence {
    void add(std::int64_t ahead_ms);
    void turn(std::int64_t now_ms);
    std::optional<std::int64_t> most() const;
    std::array<std::optional<std::int64_t>, 2> periods{};
    std::int64_t turned_at_ms = 0;
  };
  struct Gateway {
    std::optional<std::string> state;  ///< as in the gateway's document
    std::int64_t state_at_ms = 0;      ///< 0: older than this program's connection
    std::int64_t sign_of_life_ms = 0;
    std::int64_t started_ms = 0;         ///< by the gateway's clock
    std::int64_t retained_ahead_ms = 0;  ///< by retained documents, which may be old
    ClockEvidence messages;
    ClockEvidence documents;
    ClockEvidence stats;
    GatewayLife life;
  };
  struct Presence {
    std::string state;
    std::string mesh;
    std::int64_t since_ms = 0;  ///< by its gateway's clock, as the other times
    std::int64_t seen_ms = 0;
    std::int64_t heard_ms = 0;  ///< in `numbers`; 0: not known
  };
  struct Message {
    std::string gateway;  ///< `at_ms` is by its clock; empty: by this program's
    std::int64_t at_ms = 0;
  };
  struct Robot {
    std::map<std::string, Presence, std::less<>> presence;  ///< by gateway
    Message newest{};
    RobotLife life;
  };

  void on_state(Gateway& gateway, const nlohmann::json& document, std::int64_t at_ms, bool is_old);
  void on_presence(std::string_view gateway, std::string_view robot, const nlohmann::json& document,
                   std::int64_t at_ms, bool is_old);
  void on_numbers(std::string_view gateway, const nlohmann::json& document, std::int64_t at_ms);
  void on_clock(Gateway& gateway, std::int64_t time_ms, std::int64_t at_ms, bool is_old);
  void forget(std::string_view gateway, std::string_view rest);

  GatewayLife judge(const Gateway& gateway, std::int64_t now_ms) const;
  RobotLife judge(const Robot& robot, std::int64_t now_ms) const;
  std::int64_t local(std::string_view gateway, std::int64_t time_ms, std::int64_t now_ms) const;

  std::map<std::string, Gateway, std::less<>> gateways_;
  std::map<std::string, Robot, std::less<>> robots_;
  std::set<std::string, std::less<>> touched_;  ///< robots to judge again
  std::int64_t broker_lost_ms_ = 0;             ///< 0: connected
};

}  // namespace slamgw::web
