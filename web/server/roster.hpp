// SPDX-License-Identifier: Apache-2.0
// Who is alive: the state of each gateway and robot, since when, and which gateway tells it.
// Decided here once, for the page and for the metrics. Pure: documents of gateways and `now` in,
// both in Unix milliseconds of this program's clock.
//
// A gateway is `gone` once the broker has published its last will, and `silent` when it has sent
// nothing for a while though the broker still has its connection. What such a gateway said of its
// robots is out of date: they are `unknown`. So is everything while this program has no broker.
//
// Times in gateways' documents are of the gateways' clocks. One that is wrong by more than
// `clock_tolerance_ms` is reported, and times are corrected by it.
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

/// Unix milliseconds of "2026-11-21T13:57:43.613Z".
std::optional<std::int64_t> unix_ms(std::string_view iso8601);

struct GatewayLife {
  std::string_view state = "unknown";  ///< `online`, `silent`, `gone`, `unknown`
  std::int64_t since_ms = 0;           ///< of the state; 0: not known
  std::int64_t clock_ahead_ms = 0;     ///< 0 within the tolerance
  bool operator==(const GatewayLife&) const = default;
};

struct RobotLife {
  std::string state = "unknown";  ///< `online`, `asleep`, `offline`, `unknown`
  std::string gateway;            ///< which tells it
  std::string mesh;
  std::int64_t since_ms = 0;  ///< of the state; 0: not known
  std::int64_t heard_ms = 0;  ///< as its gateways say; 0: not known
  bool operator==(const RobotLife&) const = default;
};

class Roster {
 public:
  static constexpr std::int64_t silent_after_ms =
      35'000;  ///< three of a gateway's stats are missing
  static constexpr std::int64_t clock_tolerance_ms = 60'000;

  /// Of the topics that LastKnown holds, which bounds this; an empty payload takes one back.
  void on_document(const Topics::GatewayTopic& topic, std::string_view payload, std::int64_t at_ms,
                   bool is_retained);
  /// `received_at` by the gateway's clock. Without MQTT 5 both are empty: then it counts when this
  /// program got the message.
  void on_robot_message(std::string_view robot, std::string_view gateway,
                        std::string_view received_at, std::int64_t at_ms);
  void on_broker_lost(std::int64_t now_ms);
  void on_broker_found();  ///< all documents come again

  /// Decides again. Topics and texts for pages of all that has changed.
  std::map<std::string, SharedText> update(std::int64_t now_ms);
  /// For a page that comes.
  std::map<std::string, SharedText> texts() const;

  GatewayLife gateway(std::string_view id) const;
  RobotLife robot(std::string_view id) const;
  template <class Visitor>
  void each_robot(Visitor&& visit) const {
    for (const auto& [id, robot] : robots_) visit(id, robot.life);
  }
  /// As RobotLife::heard_ms, and by the newest message that came here; gateways report every 10 s
  /// only. What came last of a robot that is offline is its last will, and does not count.
  std::int64_t last_heard_ms(std::string_view id) const;

 private:
  /// How far a gateway's clock is ahead at least, of all that came within one to two periods.
  struct ClockEvidence {
    void add(std::int64_t ahead_ms);
    void turn(std::int64_t now_ms);
    std::optional<std::int64_t> most() const;
    std::array<std::optional<std::int64_t>, 2> periods{};
    std::int64_t turned_at_ms = 0;
  };
  struct Gateway {
    std::optional<std::string> state;  ///< as its document says
    std::int64_t state_at_ms = 0;      ///< 0: it stood before this program came
    std::int64_t sign_of_life_ms = 0;
    std::int64_t started_ms = 0;         ///< its clock
    std::int64_t retained_ahead_ms = 0;  ///< of retained documents, which may be old
    ClockEvidence messages;
    ClockEvidence documents;
    ClockEvidence stats;
    GatewayLife life;
  };
  struct Presence {
    std::string state;
    std::string mesh;
    std::int64_t since_ms = 0;  ///< its gateway's clock, as the next
    std::int64_t seen_ms = 0;
  };
  struct Message {
    std::string gateway;  ///< by whose clock `at_ms` is; empty: by this program's
    std::int64_t at_ms = 0;
  };
  struct Robot {
    std::map<std::string, Presence, std::less<>> presence;        ///< by gateway
    std::map<std::string, std::int64_t, std::less<>> heard_ms{};  ///< `numbers`, by gateway
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
  std::int64_t broker_lost_ms_ = 0;             ///< 0: it is there
};

}  // namespace slamgw::web
