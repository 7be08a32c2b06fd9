// SPDX-License-Identifier: Apache-2.0
// One robot's place at the broker: an MQTT session of the robot's own, which the broker gives to
// one gateway at a time (docs/fleet.md). Says when it is opened, which of its messages are this
// gateway's, and what is lost with it. Part of RobotSessions, which decides how many open at once.
#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <vector>

#include "daemon/core/protocol_machine.hpp"
#include "daemon/sessions/session_action.hpp"
#include "daemon/sessions/session_names.hpp"

namespace slamgw::sessions {

class RobotSession {
 public:
  /// Messages whose fence is not answered yet; more are dropped and counted. A fence takes one
  /// round trip to the broker.
  static constexpr std::size_t max_unfenced = 256;
  /// A session that is lost so soon, so many times in a row, is opened again ever later.
  static constexpr std::chrono::seconds quick_loss{10};
  static constexpr unsigned free_losses = 3;
  static constexpr std::chrono::seconds first_flap_wait{3};
  static constexpr std::chrono::seconds longest_flap_wait{60};
  /// After a CONNECT that failed.
  static constexpr std::chrono::seconds first_retry{1};
  static constexpr std::chrono::seconds longest_retry{30};
  /// What waited at the broker for longer than this while nobody held the session is refused.
  static constexpr std::chrono::seconds stale_after{25};
  /// For the marker to come back; then all that came before it counts as stale.
  static constexpr std::chrono::seconds marker_patience{10};
  /// Filters to unsubscribe at the next CONNECT; with more the session begins anew.
  static constexpr std::size_t max_given_up = 64;

  enum class State : std::uint8_t { detached, queued, opening, attached };

  /// Subscription identifiers (MQTT 5); the robot's own filters follow.
  static constexpr std::uint32_t command_id = 1;
  static constexpr std::uint32_t mailbox_id = 2;
  static constexpr std::uint32_t first_filter_id = 3;

  struct Counts {
    std::uint64_t fenced_off = 0;  ///< messages that came too late to be this gateway's
    std::uint64_t dropped = 0;     ///< beyond max_unfenced
  };

  RobotSession(std::string robot, const SessionNames& names, ActionQueue<SessionAction>& actions,
               Counts& counts)
      : robot_(std::move(robot)), names_(names), actions_(actions), counts_(counts) {}

  State state() const { return state_; }
  bool is_held() const { return state_ == State::attached; }
  /// The session is taken again and again while its robot talks here.
  bool is_contested() const { return quick_losses_ > 1 && was_heard_after_loss_; }
  /// When it may be opened; now, unless it failed or flaps.
  TimePoint opens_at() const { return opens_at_; }
  /// The robot was heard, or is to be answered for, and the session is not there.
  bool is_wanted() const { return is_wanted_ && state_ == State::detached; }

  /// The robot was heard by radio.
  void on_heard(TimePoint now);
  /// To be attached without having heard it. `unheld_since`: nobody has held the session since.
  void keep(std::optional<TimePoint> unheld_since);
  void set_queued() { state_ = State::queued; }
  /// Sends CONNECT.
  void open();
  /// Sends DISCONNECT. `is_forgotten`: the broker forgets the session too.
  void close(bool is_forgotten);

  /// What is said to the robot comes without its asking, too: a BLE robot's only filter, and on
  /// MQTT 5 how a command that a robot has not subscribed to gets its outcome.
  void hear_commands(bool wants_retained) {
    hears_commands_ = true;
    wants_retained_commands_ = wants_retained;
  }
  /// `is_standing`: the broker's session has it already (the robot has come from elsewhere).
  void subscribe(const std::string& filter, Qos qos, bool is_standing);
  void unsubscribe(const std::string& filter);
  /// The robot begins anew: nothing of its former session counts.
  void begin_clean();
  bool has_filter(const std::string& filter) const { return filters_.contains(filter); }

  void on_attached(bool is_present, bool is_v5, TimePoint now);
  void on_attach_failed(TimePoint now);
  /// `is_broker_gone`: it is not another gateway that has taken it.
  void on_detached(bool is_broker_gone, TimePoint now);
  void on_subscribed(const std::string& filter, bool is_granted);
  void on_message(BrokerMessage message, std::span<const std::uint32_t> ids, TimePoint now);
  void on_fence(std::uint64_t number, TimePoint now);

  std::optional<TimePoint> deadline() const { return marker_until_; }
  void on_deadline(TimePoint now);

 private:
  struct Filter {
    Qos qos = Qos::at_most_once;
    std::uint32_t id = 0;
    bool is_standing = false;  ///< the broker's session has it
    bool is_answer_due = false;
  };
  /// A message that came on this connection, until the broker shows that it is ours.
  struct Unfenced {
    std::uint64_t fence = 0;
    BrokerMessage message;
    bool is_unasked = false;
    bool is_stale = false;
    bool is_answered = false;
    TimePoint came{};
  };

  void subscribe_own();
  void ask(const std::string& filter, Filter& entry);
  bool is_copy(const BrokerMessage& message, std::span<const std::uint32_t> ids) const;
  bool is_marker(const BrokerMessage& message) const;
  void end_sorting();
  void release(TimePoint now);
  void count_loss(TimePoint now);

  const std::string robot_;
  const SessionNames& names_;
  ActionQueue<SessionAction>& actions_;
  Counts& counts_;
  State state_ = State::detached;
  bool is_wanted_ = false;
  bool is_v5_ = false;
  bool is_clean_due_ = false;  ///< the next CONNECT asks the broker to forget the session
  bool hears_commands_ = false;
  bool wants_retained_commands_ = false;
  std::map<std::string, Filter> filters_;
  std::set<std::string> given_up_;  ///< unsubscribed while the session was not here
  std::uint32_t next_id_ = first_filter_id;
  std::deque<Unfenced> unfenced_;  ///< in the order in which they came
  std::uint64_t last_fence_ = 0;
  std::optional<TimePoint> unheld_since_;
  std::string marker_;  ///< not empty: what comes before it is stale
  std::optional<TimePoint> marker_until_;
  TimePoint held_since_{};
  TimePoint opens_at_{};
  std::chrono::seconds retry_ = first_retry;
  unsigned quick_losses_ = 0;  ///< in a row
  bool was_heard_after_loss_ = false;
};

}  // namespace slamgw::sessions
