// SPDX-License-Identifier: Apache-2.0
// The sessions of all robots of this gateway, as a pure machine. It decides which robot is attached
// when, how many CONNECTs are open at once, and what a lost broker or gateway means (docs/fleet.md
// names the rules). The broker decides which gateway holds a session; gateways do not negotiate.
// The shell is io/SessionHost.
#pragma once

#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <unordered_map>

#include "daemon/core/log_throttle.hpp"
#include "daemon/sessions/robot_session.hpp"

namespace slamgw::sessions {

class RobotSessions {
 public:
  static constexpr std::size_t default_max_sessions = 10000;
  /// Limit of CONNECTs without an answer. Brokers accept 2500 a second, and fewer with TLS.
  static constexpr std::size_t max_opening = 32;
  /// Limit of sessions that the broker has yet to forget; it keeps further ones until they expire.
  static constexpr std::size_t max_forgetting = 1000;
  /// After the broker is back, robots that were not heard are attached this much later, so that a
  /// gateway that hears them comes first.
  static constexpr std::chrono::seconds unheard_delay{5};
  /// A gateway that has taken a session shows the robot to the others within this time.
  static constexpr std::chrono::seconds showing{2};
  /// Between two calls of on_tick(): after a longer pause, sessions may have been lost long ago,
  /// and another gateway may serve the robots. Most losses are noticed within `waking`, and all
  /// within `catching_up`.
  static constexpr std::chrono::seconds longest_pause{2};
  static constexpr std::chrono::seconds waking{1};
  static constexpr std::chrono::seconds catching_up{5};
  /// Between two warnings about subscriptions that the broker refuses.
  static constexpr std::chrono::minutes refusal_interval{10};

  /// Returns true when another living gateway shows the robot as its own.
  using ServedElsewhere = std::function<bool(const std::string& robot)>;

  /// `last_alive`: when the gateway's former process was last online; nothing if that may be long
  /// ago.
  RobotSessions(SessionNames names, ServedElsewhere is_served_elsewhere,
                std::optional<TimePoint> last_alive = {},
                std::size_t max_sessions = default_max_sessions);

  // From the meshes.
  /// Call at a sign of life from the board, or from an address that has proved that it receives.
  void on_heard(const std::string& robot, const Now& now);
  /// Subscribes for the robot, which FilterAnswered answers. `is_standing`: restores a subscription
  /// that the robot has made before (RobotSession::resume), without an answer.
  void subscribe(const std::string& robot, const std::string& filter, Qos qos, bool is_standing,
                 const Now& now);
  void unsubscribe(const std::string& robot, const std::string& filter);
  void begin_clean(const std::string& robot, const Now& now);
  /// Asks the broker whether the robot's session is still held here. SessionProven says so; nothing
  /// is said when it is not.
  void prove(const std::string& robot);
  /// Call when another gateway newly shows the robot: it is not tried again before it is heard
  /// here.
  void on_shown_elsewhere(const std::string& robot, const Now& now);
  /// Call when another gateway serves the robot. Has no effect while the session is held here.
  void on_given_up(const std::string& robot);
  /// Takes the session and reads the robot's note. Answered by NoteRead, at once and without a note
  /// when the broker is away.
  void read_note(const std::string& robot, const Now& now);
  /// Attaches a robot that was not heard, because it was this gateway's before a restart, or its
  /// gateway has died. `after`: a delay, so that a gateway that hears the robot comes first.
  /// `unheld_since`: no gateway has held its session since then; nothing: unknown. A later time
  /// that is known already stands.
  void keep(const std::string& robot, std::optional<TimePoint> unheld_since, Duration after,
            const Now& now);
  /// Attaches the robots that wait in keep() at once. Call when there is no other gateway.
  void attach_kept(const Now& now);
  /// Forgets the robot, and has the broker forget its session, unless another gateway serves it.
  void forget(const std::string& robot);

  // From the shell.
  /// Call when the gateway's own connection is up; no session is opened earlier. `is_other`: it is
  /// another broker than before, so that all sessions start again.
  void on_broker_up(bool is_v5, bool is_other, const Now& now);
  void on_broker_down(const Now& now);
  /// Call when the broker becomes silent or answers again. Subscribers do not wait for a silent
  /// broker.
  void on_silence(bool is_silent);
  void on_attached(const std::string& robot, bool is_present, const Now& now);
  /// `is_refused`: the broker does not let this gateway use the robot's client id.
  void on_attach_failed(const std::string& robot, const Now& now, bool is_refused = false);
  void on_detached(const std::string& robot, const Now& now, LossReason why = LossReason::taken);
  void on_subscribed(const std::string& robot, const std::string& filter, bool is_granted,
                     const Now& now);
  void on_message(const std::string& robot, BrokerMessage message,
                  std::span<const std::uint32_t> ids, const Now& now);
  void on_fence(const std::string& robot, std::uint64_t number, const Now& now);
  /// Closes the connections at the daemon's end; the broker keeps the sessions. A session with a
  /// message that waits for its fence stays open, so call this until it returns true.
  bool on_stop();

  /// Call each second: a longer pause means that the process stood still.
  void on_tick(TimePoint now);
  /// Returns true for a while after the process stood still, while it may hold fewer sessions than
  /// it knows.
  bool is_waking(TimePoint now) const { return has_stood_still(now) || now < goes_on_at_ + waking; }
  /// Returns since when no gateway may have held a session that is lost now.
  TimePoint lost_since(TimePoint now) const;

  std::optional<SessionAction> next_action() { return actions_.pop(); }
  std::optional<TimePoint> deadline() const;
  void on_deadline(const Now& now);

  bool is_held(const std::string& robot) const;
  /// Returns true while the client that has taken the session from here may be a gateway that has
  /// not shown the robot yet.
  bool was_just_taken(const std::string& robot, TimePoint now) const;
  bool is_contested(const std::string& robot) const;
  bool is_refused(const std::string& robot) const;
  /// Returns a filter of the robot's session that the broker refuses; nothing when it refuses none.
  std::optional<std::string> refused_filter(const std::string& robot) const;
  /// Returns false if the robot's session is held and has no subscription to this topic.
  bool may_want(const std::string& robot, const std::string& topic) const;
  std::size_t held() const { return counts_.held; }
  Counters counters() const;

 private:
  RobotSession* find(const std::string& robot) const;
  RobotSession* find_or_make(const std::string& robot, TimePoint now);
  void open_next();
  bool has_stood_still(TimePoint now) const;
  void end_forgetting(const std::string& robot);
  void report_refusal(const std::string& robot, const std::string& filter, TimePoint now);
  void report_grant(const std::string& robot);
  /// Has on_deadline() visit the session at `when`, or earlier.
  void wake_at(const std::string& robot, TimePoint when);
  /// Sets the session's next visit, queues it if it is wanted, and opens the next session of the
  /// queue. Call after each input of it.
  void settle(const std::string& robot, RobotSession& session, TimePoint now);

  const SessionNames names_;
  const ServedElsewhere is_served_elsewhere_;
  std::optional<TimePoint> last_alive_;  ///< at the present broker
  const std::size_t max_sessions_;
  ActionQueue<SessionAction> actions_;
  RobotSession::Counts counts_;
  struct Entry {
    std::unique_ptr<RobotSession> session;
    std::optional<TimePoint> wake{};  ///< its one entry in `wakes_`
  };
  std::unordered_map<std::string, Entry> sessions_;
  std::deque<std::string> queue_;  ///< robots whose CONNECT waits for its turn
  bool is_broker_up_ = false;
  bool is_silent_ = false;
  bool is_v5_ = false;
  bool is_stopping_ = false;
  std::optional<TimePoint> last_tick_;
  TimePoint stood_still_since_{};
  TimePoint goes_on_at_{};                             ///< when the last standstill was noticed
  std::set<std::pair<TimePoint, std::string>> wakes_;  ///< sessions to visit again, each once
  /// Robots whose sessions the broker must forget: each is opened clean, and then closed. True
  /// while that is under way.
  std::map<std::string, bool> forgetting_;
  LogThrottle full_throttle_{std::chrono::minutes{10}};
  LogThrottle refusal_throttle_{refusal_interval};
};

}  // namespace slamgw::sessions
